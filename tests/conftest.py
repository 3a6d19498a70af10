"""Settings of the whole test run, made before JAX starts: float64, checked types, no promotion not asked for."""

import atexit
import os
import shutil
import tempfile
from importlib.metadata import version
from pathlib import Path

CACHES = ("JAX_COMPILATION_CACHE_DIR", "VIBROJAX_CACHE")
"""What one process has compiled, no other compiles again: neither the other worker nor the commands that tests run."""

FOR_CACHES = {name: tempfile.mkdtemp(prefix="vibrojax-tests-") for name in CACHES if name not in os.environ}
os.environ |= FOR_CACHES
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
atexit.register(lambda: [shutil.rmtree(folder, ignore_errors=True) for folder in FOR_CACHES.values()])

# Threads of linear algebra wait for one another in a busy loop, which where cores are shared takes forty times as long
# as the work. (Workers of pytest-xdist and commands begin with this; numpy is here already where there is one process.)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if tuple(int(part) for part in version("jax").split(".")[:3]) < (0, 11, 2):
    # As `vibrojax.compile.xla` does for the package's own programs: those that tests compile for themselves
    # take a quarter of the time without it.
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_disable_hlo_passes=cse_barrier_expander"

import jax  # noqa: E402
import jaxtyping  # noqa: E402
import pytest  # noqa: E402
from checked_types import checked  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Annotations, shapes of arrays among them, are checked in the tests; users pay nothing for them. Functions that users
# call with anything (modules `run`, sweep.input.read and source) are not: their errors name the argument that is wrong.
# Nor is sweep.input.values, whose warnings count the frames up to the caller.
# Nor are kernels, which call their functions a hundred thousand times to be written: two minutes of checking.
UNCHECKED = ("run.py", "joining.py", "catalogue.py")
ANALYSES = Path(__file__).parents[1] / "vibrojax" / "analyses"
CHECKED = [
    *(
        ".".join(file.relative_to(ANALYSES.parents[1]).with_suffix("").parts)
        for file in sorted(ANALYSES.rglob("[a-z]*.py"))
        if file.name not in UNCHECKED
    ),
    "vibrojax.cli",
    "vibrojax.compile.agreement",
    "vibrojax.compile.trust",
    "vibrojax.compile.xla",
    "vibrojax.errors",
    "vibrojax.explorer",
    "vibrojax.io",
    "vibrojax.measures",
    "vibrojax.models",
    "vibrojax.periodic",
    "vibrojax.plot",
    "vibrojax.progress",
    "vibrojax.reproduce",
    "vibrojax.stepping",
    "vibrojax.sweep.engine",
    "vibrojax.sweep.input.definition",
    "vibrojax.sweep.input.names",
    "vibrojax.sweep.input.points",
    "vibrojax.sweep.input.run_settings",
    "vibrojax.sweep.simulation.dense_output",
    "vibrojax.sweep.simulation.trajectory",
]
install_import_hook(CHECKED, "beartype.beartype")
jaxtyping.jaxtyped = checked  # the decorator that the hook writes into these modules

LONGEST = ("test_reproduce.py", "test_derivatives.py", "test_exact.py", "test_accuracy.py", "test_hard_faults.py")
"""Files that take longest: they begin first, so that no process is left alone with one of them."""


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: item.path.name not in LONGEST)


@pytest.fixture(autouse=True, scope="module")
def few_mappings():
    """Every compiled program keeps some memory mapped, and a process may have only so many (65,530) of them."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > 30_000:
        jax.clear_caches()


@pytest.fixture(params=[16, 32, 64])
def width(request, monkeypatch):
    """Bytes of a vector, forced: SSE2 or NEON, AVX2, AVX-512. LLVM splits those that the processor does not have."""
    from vibrojax.compile.kernels import native

    monkeypatch.setattr(native, "vector_bytes", lambda: request.param)
    return request.param
