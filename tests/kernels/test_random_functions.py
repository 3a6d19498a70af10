"""Tests that random functions over all accepted primitives give the same by a kernel and by XLA.

`VIBROJAX_FUNCTIONS` sets their number (400 in `.ci/run`), `VIBROJAX_FUNCTIONS_SEED` which ones are drawn.
"""

import os
from typing import Any
from unittest.mock import patch

import jax
import numpy as np
import pytest
import writers
from hypothesis import HealthCheck, Phase, given, seed, settings
from planted_faults import FAULTS
from processor_modes import as_xla
from random_functions import Function, functions, random_function
from scopes import ROUNDED, Scope, Value
from writers import WRITERS, write

from vibrojax.compile import native
from vibrojax.compile.assembly import Untranslatable
from vibrojax.compile.native import Kernel
from vibrojax.compile.translation import primitives

COUNT = int(os.environ.get("VIBROJAX_FUNCTIONS", 100))
SEED = int(os.environ.get("VIBROJAX_FUNCTIONS_SEED", 0))

QUICK: dict[str, Any] = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    # This pass rearranges sums and products, which changes their roundings.
    "xla_disable_hlo_passes": "algsimp",
}
"""XLA's options: compile fast, and follow the function literally."""

if jax.__version_info__ < (0, 11):
    QUICK["xla_cpu_use_fusion_emitters"] = False  # later versions have no choice

ROUNDINGS = 512
"""Roundings by which functions of two libraries may differ. XLA's exp2 is up to 321 off at ends of its range, atanh
and log1p up to 115; those of kernels are within four of numpy's (test_compiler.py, test_kernel.py)."""


def disagreement(function: Function) -> str | None:
    """Return which result of a function differs between a kernel and XLA, or None."""
    arguments = function.arguments()
    # One group holds all lanes, so that loops of a group are loops of all lanes.
    with patch.object(native, "vector_bytes", lambda: function.width):
        kernel = Kernel(function, *arguments)
    with as_xla():
        results = kernel(*arguments)
    expected = jax.jit(function, compiler_options=QUICK)(*arguments)
    signs = not any(_subnormal(x).any() for x in arguments if x.dtype.kind == "f")
    for value, result, correct in zip(function.results, results, map(np.asarray, expected), strict=True):
        if result.dtype != correct.dtype or result.shape != correct.shape or not _agree(value, result, correct, signs):
            return f"{value.name} is {result}, by XLA {correct}"
    return None


def _subnormal(x: Any) -> Any:
    return (x != 0) & (np.abs(x) < np.finfo(x.dtype).tiny)


def _agree(value: Value, result: Any, correct: Any, signs: bool) -> bool:
    """Return whether a result is that of XLA; `signs`: whether zeros have the same sign.

    Subnormal numbers count as 0. XLA simplifies x + 0 to x, and flushes a subnormal x to a 0 of its sign.
    """
    if value.kind != "f":
        return np.array_equal(result, correct)
    limits = np.finfo(value.dtype)
    small = [_subnormal(x) for x in (result, correct)]
    same_sign = (np.signbit(result) == np.signbit(correct)) | np.isnan(correct) | small[0] | small[1]
    result, correct = (np.where(tiny, 0, x) for tiny, x in zip(small, (result, correct), strict=True))
    if value.accuracy < ROUNDED:
        return np.array_equal(result, correct, equal_nan=True) and (not signs or bool(np.all(same_sign)))
    return np.allclose(result, correct, rtol=ROUNDINGS * limits.eps, atol=2 * limits.tiny, equal_nan=True)


def first_disagreement(count: int, number: int, drawn: Any = None, shrink: bool = False) -> str | None:
    """Return the first of `count` random functions on which kernel and XLA disagree, and in what, or None."""

    @seed(number)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[Phase.generate] + [Phase.shrink] * shrink,
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
    )
    @given(functions() if drawn is None else drawn)
    def search(function: Function) -> None:
        try:
            difference = disagreement(function)
        except Untranslatable as error:
            difference = f"refused: {error}"
        assert difference is None, f"{difference}\n{function!r}"

    try:
        search()
    except AssertionError as error:
        return str(error)
    return None


def test_every_primitive_has_a_writer():
    assert set(WRITERS) == primitives()


def test_functions_do_not_depend_on_loaded_modules():
    """Hypothesis mixes constants of the loaded modules into draws of all types but booleans."""
    random, strategies = np.random.default_rng(0), set()

    def draw(strategy: Any) -> bool:
        strategies.add(repr(strategy))
        return bool(random.integers(2))

    drawn = [random_function(Scope(draw, write, [], [0])) for _ in range(20)]
    assert strategies == {"booleans()"} and len({function.source for function in drawn}) == 20


def test_random_functions():
    assert first_disagreement(COUNT, SEED, shrink=True) is None


@pytest.mark.parametrize("fault", FAULTS)
def test_planted_fault_is_found(fault, monkeypatch):
    """The functions have more of the primitives with the fault, and take a tenth of the time of those above."""
    plant, primitives = FAULTS[fault]
    plant(monkeypatch)
    monkeypatch.setattr(writers, "FAVOURED", primitives)
    # A loop along an argument would write beyond the end of its results.
    drawn = functions(along=fault != "a loop without turns")
    assert first_disagreement(1000, SEED, drawn) is not None
