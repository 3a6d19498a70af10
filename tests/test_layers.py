"""Test imports: only from folders above, in the order of CONTRIBUTING, of public names, and of few large libraries."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from drawn import lanes, square

import vibrojax as vj

PACKAGE = Path(__file__).parents[1] / "vibrojax"
LIST = "compile physics scenes systems stepping io measures settings lanes periodic maps pictures studies explorer cli"
ORDER = tuple(LIST.split(" "))


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
        assert sorted(pair for pair in imports if f"{pair[1]}.".startswith(f"vibrojax.{other}.")) == []


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


CODE = """
import sys
sys.modules |= dict.fromkeys(["jax", "jaxlib", "matplotlib", "pandas", "scipy", "xarray"])
from vibrojax.cli import main
for words, needed in (
    (["scenes"], []),
    (["info", "map.nc", "--json"], ["pandas", "scipy", "xarray"]),
    (["plot", "map.nc"], ["matplotlib"]),
):
    for name in needed:
        del sys.modules[name]
    assert main(words) == 0, words
sys.exit("matplotlib.pyplot" in sys.modules)
"""
"""Code of a process in which a module cannot be imported before the first command that needs it."""


def test_commands_import_no_library_that_they_do_not_need(tmp_path):
    vj.write_dataset(lanes(square(3)).assign_attrs(source="vibrojax 0"), tmp_path / "map.nc")
    completed = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, cwd=tmp_path)
    assert (completed.returncode, completed.stderr) == (0, "")
    assert completed.stdout
