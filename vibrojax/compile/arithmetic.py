"""Whether the functions that equations are written in can be trusted on this machine, compiled as lanes are."""

from collections.abc import Callable, Iterator
from functools import cache
from inspect import signature
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax.errors import InputError
from vibrojax.models.physics import elementary

ROUNDINGS = 4
"""Roundings of the value, or of 1 where it is smaller, that a function may be off."""

Evaluate = Callable[..., Any]
"""`evaluate(function, *arrays)`: what a function of lanes gives, compiled as lanes are."""


@cache
def check(evaluate: Evaluate, compiler: str, dtype: np.dtype, lanes: int) -> None:
    """Compare every function that equations are written in with numpy, `lanes` values at a time; once.

    **Raises:** `InputError` where one is wrong; it names the `compiler` and its version.
    """
    wrong = wrong_functions(evaluate, dtype, lanes)
    if wrong:
        package = compiler.split()[0]
        raise InputError(
            f"{compiler} computes {' and '.join(wrong)} wrongly on this machine, {lanes} values of {dtype} at a time: "
            f"nothing was computed; install another version of {package}"
        )


def wrong_functions(evaluate: Evaluate, dtype: np.dtype, lanes: int) -> list[str]:
    """The names of the functions that are off by more than a few roundings.

    Each is evaluated at `lanes` numbers of both signs over 15 octaves; where numpy has no finite value, it has none.
    """
    x = np.geomspace(2.0**-10, 2.0**5, lanes).astype(dtype)
    x[: lanes // 2] *= -1
    given = (x, np.abs(x[::-1]))
    functions = dict(_functions())

    def all_of_them(*given: Float[jax.Array, " lanes"]) -> dict[str, jax.Array]:
        return {name: function(*given[:arguments]) for name, (function, arguments) in functions.items()}

    # NaN is what some functions have of a negative number: no debugger is to stop there.
    with jax.debug_nans(False):
        found = evaluate(all_of_them, *given)
    return [name for name, (_, count) in functions.items() if _is_wrong(found[name], name, given[:count])]


def _functions() -> Iterator[tuple[str, tuple[Callable, int]]]:
    """Name, function and number of arguments of all that `elementary` offers, and of what is measured with besides."""
    for name, function in vars(elementary).items():
        if hasattr(function, "registry"):  # takes arrays, and the number types that register with it
            yield name, (function, len(signature(function).parameters))
    yield "arctan2", (jnp.arctan2, 2)


def _is_wrong(values: Any, name: str, given: tuple[np.ndarray, ...]) -> bool:
    with np.errstate(all="ignore"):
        exact = getattr(np, name)(*(x.astype(np.float64) for x in given))
    known = np.isfinite(exact)
    off = np.abs(np.asarray(values, np.float64) - exact)[known]
    within = off <= ROUNDINGS * np.finfo(given[0].dtype).eps * np.maximum(1, np.abs(exact[known]))
    return not bool(np.all(within))
