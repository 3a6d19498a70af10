"""Functions of lanes compiled: by LLVM where a kernel can do it, else by XLA, and with what options."""

from collections.abc import Callable
from functools import cache, wraps
from inspect import signature
from typing import Any, ParamSpec, TypeVar

import jax
from jaxlib import version as jaxlib

from vibrojax.compile.kernels import Untranslatable
from vibrojax.sweep.engine.trust import run

WIDE_VECTORS_CHECKED = ("0.10.0", "0.12.0.1")
"""Versions of jaxlib whose functions are right with the widest registers (AVX-512). In 0.10.2, 0.11.0 and 0.11.2 arctan
of more than 16 values returns them in the wrong places."""

P = ParamSpec("P")
R = TypeVar("R")


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


def lane_function(static: int, derives: bool = False) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Return a decorator that compiles a function of lanes, whose first `static` arguments are static.

    Other arguments and results are pytrees of arrays whose last axis is the lanes', or without axes. `derives`: the
    function takes derivatives of a scene's equations.
    """

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        names = tuple(signature(function).parameters)[:static]
        by_xla = jitted(names)(function)

        @wraps(function)
        def call(*args: Any) -> R:
            try:
                return run(function, args[:static], *args[static:], derives=derives)
            except Untranslatable:
                return by_xla(*args)

        return call

    return decorate
