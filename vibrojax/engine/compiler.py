"""What lanes are compiled with, and whether its arithmetic can be trusted on this machine."""

from collections.abc import Callable, Iterator
from functools import cache, wraps
from inspect import signature
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib import version as jaxlib
from jaxtyping import Float

from vibrojax.errors import InputError
from vibrojax.physics import elementary

WIDE_VECTORS_CHECKED = ("0.10.0", "0.12.0.1")
"""Versions of jaxlib whose functions are right with the widest registers (AVX-512). In 0.10.2, 0.11.0 and 0.11.2 arctan
of more than 16 values returns them in the wrong places."""

P = ParamSpec("P")
R = TypeVar("R")

ROUNDINGS = 4
"""Roundings of the value, or of 1 where it is smaller, that a function may be off."""


def compiler_options(platform: str) -> dict[str, int | str]:
    """What XLA compiles lanes with for the devices of a platform, such as "cpu"."""
    options: dict[str, int | str] = {}
    if platform == "cpu":
        if jaxlib.__version__ in WIDE_VECTORS_CHECKED:
            # A block fills the widest registers there are; where they are narrower this says nothing.
            options["xla_cpu_prefer_vector_width"] = 512
        if jax.__version_info__ < (0, 11, 2):
            # It takes barriers out before values are fused, and then works them out again and again: eight times the
            # arithmetic. Later versions do without.
            options["xla_disable_hlo_passes"] = "cse_barrier_expander"
    return options


def jitted(static: tuple[str, ...] = ()) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator: `jax.jit` with the options of the platform in use; the arguments named in `static` are static."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @cache
        def program(platform: str) -> Callable[P, R]:
            return jax.jit(function, static_argnames=static, compiler_options=compiler_options(platform))

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            return program(jax.default_backend())(*args, **kwargs)

        return call

    return decorate


@cache
def check_arithmetic(platform: str, dtype: np.dtype, lanes: int) -> None:
    """Compare every function that equations are written in with numpy, compiled as a block of `lanes` is; once.

    **Raises:** `InputError` where one is wrong.
    """
    wrong = wrong_functions(compiler_options(platform), dtype, lanes)
    if wrong:
        raise InputError(
            f"jaxlib {jaxlib.__version__} computes {' and '.join(wrong)} wrongly on this machine, {lanes} values of "
            f"{dtype} at a time: nothing was computed; install another version of jax"
        )


def wrong_functions(options: dict[str, int | str], dtype: np.dtype, lanes: int) -> list[str]:
    """The names of the functions that are off by more than a few roundings when compiled with `options`.

    Each is evaluated at `lanes` numbers of both signs over 15 octaves; where numpy has no finite value, it has none.
    """
    x = np.geomspace(2.0**-10, 2.0**5, lanes).astype(dtype)
    x[: lanes // 2] *= -1
    given = (x, np.abs(x[::-1]))
    functions = dict(_functions())

    def evaluate(*given: Float[jax.Array, " lanes"]) -> dict[str, jax.Array]:
        return {name: function(*given[:arguments]) for name, (function, arguments) in functions.items()}

    # NaN is what some functions have of a negative number: no debugger is to stop there.
    with jax.debug_nans(False):
        found = jax.jit(evaluate, compiler_options=options)(*given)
    return [name for name, (_, count) in functions.items() if _is_wrong(found[name], name, given[:count])]


def _functions() -> Iterator[tuple[str, tuple[Callable, int]]]:
    """Name, function and number of arguments of all that `elementary` offers, and of what is measured with besides."""
    for name, function in vars(elementary).items():
        if hasattr(function, "registry"):  # takes arrays, and the number types that register with it
            yield name, (function, len(signature(function).parameters))
    yield "arctan2", (jnp.arctan2, 2)


def _is_wrong(values: jax.Array, name: str, given: tuple[np.ndarray, ...]) -> bool:
    with np.errstate(all="ignore"):
        exact = getattr(np, name)(*(x.astype(np.float64) for x in given))
    known = np.isfinite(exact)
    off = np.abs(np.asarray(values, np.float64) - exact)[known]
    within = off <= ROUNDINGS * np.finfo(given[0].dtype).eps * np.maximum(1, np.abs(exact[known]))
    return not bool(np.all(within))
