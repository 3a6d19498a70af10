"""Compilation of a function of lanes: a kernel if possible, else XLA."""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any, TypeVar

from vibrojax.compile.kernels import Untranslatable
from vibrojax.compile.trust import Policy, run_kernel
from vibrojax.compile.xla import jitted

R = TypeVar("R")


def lane_function(
    static: int, *, derives: bool = False, registers: int = 1, policy: Policy | None = None
) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Return a decorator that compiles a function of lanes, whose first `static` arguments are static and hashable.

    The other arguments and the results are pytrees of scalars and of arrays whose last axis is the lane axis. The
    function is compiled on its first call with each combination of argument types.

    **Arguments:**

    - `static`: number of static arguments.
    - `derives`: whether the function computes derivatives.
    - `registers`: number of vector registers that hold one value of a group of lanes.
    - `policy`: callable that decides which calls require a comparison with XLA first. By default, all kernels are
      trusted.
    """

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        by_xla = jitted(tuple(signature(function).parameters)[:static])(function)

        @wraps(function)
        def call(*args: Any) -> R:
            options: dict[str, Any] = {"registers": registers, "derives": derives, "policy": policy}
            try:
                return run_kernel(function, args[:static], *args[static:], **options)
            except Untranslatable:
                return by_xla(*args)

        return call

    return decorate
