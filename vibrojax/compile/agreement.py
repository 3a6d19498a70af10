"""Comparison of compiled elementary functions with those of numpy."""

from collections.abc import Callable
from functools import cache
from inspect import signature
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.errors import InputError
from vibrojax.lazy import jax

ELEMENTARY_ROUNDINGS = 4
"""Error tolerance in units of machine epsilon times max(1, |value|). numpy's own functions err by up to one unit."""

Evaluate = Callable[..., Any]
"""`evaluate(function, *arrays)` compiles a function like any function of lanes and returns its results."""

Functions = tuple[Callable[..., Any], ...]
"""Elementary functions. Each is compared with numpy's function of the same name."""


@cache
def check(evaluate: Evaluate, functions: Functions, compiler: str, dtype: np.dtype, lanes: int) -> None:
    """Compare functions with numpy, `lanes` values at a time, once per process.

    **Raises:** `InputError` if a function is wrong. The message contains `compiler` (package and version).
    """
    wrong = wrong_functions(evaluate, functions, dtype, lanes)
    if wrong:
        raise InputError(
            f"{compiler} computes {' and '.join(wrong)} wrongly on this machine, {lanes} values of {dtype} at a time: "
            f"nothing was computed; install another version of {compiler.split()[0]}"
        )


def wrong_functions(evaluate: Evaluate, functions: Functions, dtype: np.dtype, lanes: int) -> list[str]:
    """Return the names of functions whose error exceeds `ELEMENTARY_ROUNDINGS`.

    Each function is evaluated at `lanes` numbers of both signs, with magnitudes from 2^-10 to 2^5. Its results are
    compared wherever numpy's value is finite.
    """
    x = np.geomspace(2.0**-10, 2.0**5, lanes).astype(dtype)
    x[: lanes // 2] *= -1
    arguments = (x, np.abs(x[::-1]))
    counts = {function.__name__: len(signature(function).parameters) for function in functions}

    def evaluate_all(*arrays: "Float[jax.Array, ' lanes']") -> "dict[str, jax.Array]":
        return {function.__name__: function(*arrays[: counts[function.__name__]]) for function in functions}

    values = evaluate(evaluate_all, *arguments)  # NaN where functions are undefined for negative numbers
    wrong = []
    for name, count in counts.items():
        with np.errstate(all="ignore"):
            exact = getattr(np, name)(*(array.astype(np.float64) for array in arguments[:count]))
        known = np.isfinite(exact)
        error = np.abs(np.asarray(values[name], np.float64) - exact)[known]
        accepted = ELEMENTARY_ROUNDINGS * np.finfo(x.dtype).eps * np.maximum(1, np.abs(exact[known]))
        if not np.all(error <= accepted):
            wrong.append(name)
    return wrong
