"""Settings of the whole test run, made before JAX starts: float64, checked types, only explicit type promotion."""

import atexit
import os
import re
import shutil
import tempfile
from importlib.metadata import version
from pathlib import Path
from types import FunctionType

CACHES = ("JAX_COMPILATION_CACHE_DIR", "VIBROJAX_CACHE")
"""Caches that share compiled programs between test processes and the commands that tests run."""

FOR_CACHES = {name: tempfile.mkdtemp(prefix="vibrojax-tests-") for name in CACHES if name not in os.environ}
os.environ |= FOR_CACHES
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
atexit.register(lambda: [shutil.rmtree(folder, ignore_errors=True) for folder in FOR_CACHES.values()])

# Threads of linear algebra wait for each other in a busy loop. On shared cores this takes forty times as long as the
# work. (It takes effect in workers of pytest-xdist and in commands. In a single process, numpy is already loaded.)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# XLA compiles without optimization, in half of the time, as kernels do.
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"

if tuple(int(part) for part in version("jax").split(".")[:3]) < (0, 11, 2):
    # The package sets the same flag for its own programs (`vibrojax.compile.xla`). Programs that tests compile
    # themselves take a quarter of the time with it.
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_disable_hlo_passes=cse_barrier_expander"

import jax  # noqa: E402
import jaxtyping  # noqa: E402
import pytest  # noqa: E402
from browser import chromium  # noqa: E402
from checked_types import checked, load_in_threads  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# The tests check annotations, including array shapes. Exceptions are functions that users call with any argument,
# because their errors name the wrong argument; settings/values.py, whose warnings count the frames up to the caller;
# and kernels, which call their functions a hundred thousand times while they are written.
PACKAGE = Path(__file__).parents[1] / "vibrojax"
UNCHECKED = re.compile(
    r"(compile/(?!agreement|xla)|maps/(run|read|joining|bounds|starts|rerun)|settings/(toml|values|code_identity)"
    r"|studies/((accuracy|attractors|borders|curves|family|trajectory)\.|catalogue)).*"
)
CHECKED = [
    f"vibrojax.{file.removesuffix('.py').replace('/', '.')}"
    for path in sorted(PACKAGE.rglob("[a-z]*.py"))
    if not UNCHECKED.fullmatch(file := path.relative_to(PACKAGE).as_posix())
]
load_in_threads()
install_import_hook(CHECKED, "beartype.beartype")
jaxtyping.jaxtyped = checked  # the import hook writes this decorator into the modules

from vibrojax.compile import identity, native  # noqa: E402

visit = identity._Walk.visit


def visit_unchecked(walk, x):
    """Identify a function that no module names, such as that of a property, without its checks of types. Otherwise its
    kernels have no digest, and each process traces them."""
    has_checks = isinstance(x, FunctionType) and x.__code__.co_filename == checked.__code__.co_filename
    visit(walk, x.__wrapped__ if has_checks and identity._known_name(x) is None else x)


visit_unchecked.__module__ = identity.__name__  # otherwise, the package counts as changed
identity._Walk.visit = visit_unchecked

LONGEST = re.compile(
    r"test_(plots|systems_events|explore_page|sensitivity|datasets_on_disk|systems|sealed_datasets|explore_served"
    r"|design|orbits|follow|follow_rigid|finished_results|workers|workers_slurm)\.py"
)
"""Slowest files. They start first, so that no process is left alone with one of them at the end."""


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: not LONGEST.fullmatch(item.path.name))


def pytest_addoption(parser):
    parser.addoption("--vector-bytes", type=int, help="width of the kernels' vectors, in place of the processor's")
    parser.addoption("--code-level", type=int, default=0, help="LLVM's level of code generation; users' kernels have 2")


def pytest_configure(config):
    if width := config.getoption("--vector-bytes"):
        native.vector_bytes = lambda: width


OPTIMIZED = ("test_hard_faults.py",)
"""Files whose kernels are compiled with optimization, as those of the processes that they start."""


def pytest_runtest_setup(item):
    of_kernels = item.path.name in OPTIMIZED or item.path.parent.name == "kernels"
    native.CODE_LEVEL = 2 if of_kernels else item.config.getoption("--code-level")


def pytest_terminal_summary(terminalreporter):
    """Say in one line how many tests a browser would add."""
    reports = terminalreporter.stats.get("skipped", ())
    skipped = [report for report in reports if re.search("playwright|Chromium|axe is|be started", str(report.longrepr))]
    if skipped:
        terminalreporter.write_line(
            f"{len(skipped)} tests of pages in a browser are skipped; for these, install chromium (as by apt-get), and "
            'pip install "vibrojax[browser]".'
        )


@pytest.fixture(autouse=True, scope="module")
def few_mappings():
    """Clear caches if a process has many memory mappings. Each compiled program keeps some, and the limit is 65,530."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > 30_000:
        jax.clear_caches()


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Return an empty folder, in which the test runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def browser():
    with chromium() as instance:
        yield instance


@pytest.fixture(params=[16, 32, 64])
def width(request, monkeypatch):
    """Force the bytes of a vector: SSE2 or NEON, AVX2, AVX-512. LLVM splits vectors that the processor lacks."""
    monkeypatch.setattr(native, "vector_bytes", lambda: request.param)
    return request.param
