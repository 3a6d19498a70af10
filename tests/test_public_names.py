"""The public names: the same for Python, which imports them late, and for editors, which read the stub."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

import vibrojax as vj

ROOT = Path(__file__).parents[1]
STUB = ast.parse((ROOT / "vibrojax" / "__init__.pyi").read_text())
IMPORTED = [(node.module, name) for node in STUB.body if isinstance(node, ast.ImportFrom) for name in node.names]
DECLARED = [node.target.id for node in STUB.body if isinstance(node, ast.AnnAssign)]


def test_the_stub_has_the_names_of_the_package():
    names = sorted([name.asname for _, name in IMPORTED] + DECLARED)
    assert names == sorted([*vj.__all__, "__version__"]) == dir(vj)


def test_every_name_is_found():
    assert all(name.asname == name.name for _, name in IMPORTED)  # without `as` a stub does not hand a name on
    assert all(getattr(vj, name) is not None for name in vj.__all__)


def test_unknown_names_are_refused():
    with pytest.raises(AttributeError, match="'vibrojax' has no attribute 'swep'"):
        _ = vj.swep


def test_the_version_is_the_installed_one():
    assert vj.__version__ == version("vibrojax")
    done = subprocess.run([sys.executable, "-m", "vibrojax", "--version"], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == f"vibrojax {vj.__version__}\n"


def test_one_version_everywhere():
    """The release's number stands in `pyproject.toml`; the citation repeats it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text()


def test_imports_are_lazy():
    heavy = "{'jax', 'numpy', 'xarray', 'matplotlib', 'scipy', 'diffrax', 'tqdm', 'filelock'}"
    code = (
        f"import sys, vibrojax as vj; vj.__version__, dir(vj), vj.InputError; print(sorted({heavy} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "[]\n", done.stdout + done.stderr
