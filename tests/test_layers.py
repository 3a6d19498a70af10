"""Test imports: only from folders above, of public names, of few large libraries; and that annotations are checked."""

import ast
import os
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from checked_types import CALLS_PER_CHECK
from drawn import lanes, square

import vibrojax as vj
from vibrojax.lanes.drift import _means

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


RUN = """
import sys
import vibrojax as vj
from vibrojax.compile import native
native.CODE_LEVEL = 0
vj.write_dataset(vj.run_sweep("map.toml", progress=False), sys.argv[1])
print("jax" in sys.modules)
"""
"""Code of a process that says whether a sweep has imported jax."""

MAP = 'scene = "rotary"\n[grid]\nbeta = [0.3, 0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n'


def test_cached_kernels_run_without_jax(tmp_path):
    """A process that traces makes jax's settings late, and has the same results as the next, which needs no trace."""
    (tmp_path / "map.toml").write_text(MAP)
    environment = os.environ | {"VIBROJAX_CACHE": str(tmp_path / "cache"), "JAX_PLATFORMS": "cpu"}
    for name, imports_jax in (("traced.nc", True), ("cached.nc", False)):
        command = [sys.executable, "-c", RUN, name]
        completed = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment)
        assert completed.stdout.splitlines()[-1:] == [str(imports_jax)], completed.stderr
    xr.testing.assert_equal(*(vj.open_dataset(tmp_path / name) for name in ("traced.nc", "cached.nc")))


THREADS = """
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from threading import Barrier
from vibrojax.compile.xla import float_type, precision
from vibrojax.lazy import jax, jnp, lax
together = Barrier(4)
def work(module, attribute, name):
    with precision("float64") if name else nullcontext():
        with precision(name) if name else nullcontext():
            together.wait()
            getattr(module, attribute)
            assert float_type() == jnp.zeros(1).dtype == (name or "float32")
        assert float_type() == jnp.zeros(1).dtype == ("float64" if name else "float32")
    assert float_type() == jnp.zeros(1).dtype == "float32"
calls = ((jax, "tree", "float32"), (jnp, "exp", "float32"), (jnp, "sin", ""), (lax, "scan", ""))
with ThreadPoolExecutor(4) as pool:
    list(pool.map(lambda call: work(*call), calls))
"""
"""Code of a process whose threads import jax at once, of which two compute in a precision of their own."""


def test_threads_import_jax_at_once_each_with_its_precision():
    completed = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True)
    assert (completed.returncode, completed.stderr) == (0, "")


def test_shapes_in_annotations_are_checked():
    """Of 4 lanes, then 5."""
    errors = []
    for _ in range(CALLS_PER_CHECK):
        try:
            _means(np.zeros((3, 4)), None, np.zeros(5, int), np.zeros((2, 4), int))
        except Exception as error:
            errors.append(str(error))
    assert any("violates type hint" in error for error in errors)
