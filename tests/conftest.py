"""Settings of the whole test run, made before JAX starts: float64, and no promotion that was not asked for."""

from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

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
