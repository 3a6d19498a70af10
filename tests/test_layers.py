"""Test imports: only from folders above, in the order of CONTRIBUTING, of public names, and of few large libraries."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from small_map import small_map

import vibrojax as vj

PACKAGE = Path(__file__).parents[1] / "vibrojax"
LIST = "compile physics scenes systems stepping io measures settings lanes periodic maps pictures studies explorer cli"
ORDER = tuple(LIST.split(" "))
EXCEPTIONS = {}
"""Number of imports in the wrong direction, by folders. It may only fall."""


def imported_modules(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            yield from [alias.name for alias in node.names]


def test_order_lists_all_folders():
    assert set(ORDER) == {path.parent.name for path in PACKAGE.glob("*/*.py")}
    assert not list(PACKAGE.glob("*/*/*.py"))


@pytest.mark.parametrize("folder", ORDER)
def test_imports_point_upwards(folder):
    imports = {
        (path.name, module.rpartition(".")[0])
        for path in (PACKAGE / folder).glob("*.py")
        for module in imported_modules(path)
    }
    for other in ORDER[ORDER.index(folder) + 1 :]:
        wrong = sorted(pair for pair in imports if f"{pair[1]}.".startswith(f"vibrojax.{other}."))
        assert len(wrong) <= EXCEPTIONS.get((folder, other), 0), wrong


ROOT = Path(__file__).parents[1]
STUB = ast.parse((ROOT / "vibrojax" / "__init__.pyi").read_text())
IMPORTED = [(node.module, name) for node in STUB.body if isinstance(node, ast.ImportFrom) for name in node.names]


def test_every_public_name_resolves():
    assert all(name.asname == name.name for _, name in IMPORTED)  # a stub re-exports only names written with `as`
    assert all(getattr(vj, name) is not None for name in vj.__all__)


def test_version_is_installed_version():
    assert vj.__version__ == version("vibrojax")


def test_citation_has_same_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text()


CODE = "import sys; sys.modules |= dict.fromkeys({!r}); from vibrojax.cli import main; sys.exit(main({!r}))"
"""Code of a process in which some modules cannot be imported."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("light")
    vj.write_dataset(small_map(), path / "map.nc")
    return path


@pytest.mark.parametrize(
    ("words", "absent"),
    [
        (["scenes"], ["jax", "jaxlib", "matplotlib", "pandas", "scipy", "xarray"]),
        (["info", "map.nc", "--json"], ["jax", "jaxlib", "matplotlib"]),
        (["plot", "map.nc"], ["jax", "jaxlib", "matplotlib.pyplot"]),
    ],
    ids=" ".join,
)
def test_without(folder, words, absent):
    code = [sys.executable, "-c", CODE.format(absent, words)]
    completed = subprocess.run(code, capture_output=True, text=True, cwd=folder)
    assert (completed.returncode, completed.stderr) == (0, "")
    assert completed.stdout
