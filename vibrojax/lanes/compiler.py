"""Compiled functions and programs of lanes: kernels, or compiled by XLA where no kernel can be made."""

from collections.abc import Callable
from functools import wraps
from importlib.metadata import version
from inspect import isfunction, signature
from typing import Any, TypeVar

import llvmlite
import numpy as np

from vibrojax.compile import native
from vibrojax.compile.agreement import check
from vibrojax.compile.assembly import Untranslatable
from vibrojax.compile.native import BoundKernel, kernel_for
from vibrojax.compile.xla import BoundProgram, evaluation, jitted
from vibrojax.lanes.programs import ProgramKey, settle_lanes
from vibrojax.lazy import jnp
from vibrojax.physics import elementary

R = TypeVar("R")

KERNEL_REGISTERS = {settle_lanes: 2}
"""Vector registers per value of a group of lanes, by default 1. With two, the processor starts an operation on one
register while that on the other is still in progress. The observation has too many values for two."""

XLA_BLOCK = 64
"""Lanes that XLA steps together on a CPU core. The arrays of a step fit into the cache, and few lanes wait for others.
Every block has this size and runs in one thread, so that no bit of a lane depends on the other lanes."""

XLA_BLOCKS_PER_CALL = 8
"""Blocks per call of a program, computed one after another. A call costs as much as some hundred steps of a block."""

XLA_BLOCK_ON_ACCELERATOR = 16384
"""Lanes that step together on an accelerator, where a step of few lanes costs as much as a step of many."""


def arctan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y), which measures use and equations do not."""
    return jnp.arctan2(y, x)


EQUATION_FUNCTIONS = (*(x for x in vars(elementary).values() if isfunction(x) and hasattr(x, "registry")), arctan2)
"""Elementary functions that equations and measures use: the generic functions of `elementary`, and arctan2."""


def lane_function(static: int) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Return a decorator that compiles a function of lanes, whose first `static` arguments are static and hashable.

    The other arguments and the results are pytrees of scalars and of arrays whose last axis is the lane axis. The
    function is compiled on its first call with each combination of argument types.
    """

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        by_xla = jitted(tuple(signature(function).parameters)[:static])(function)

        @wraps(function)
        def call(*args: Any) -> Any:
            try:
                return kernel_for(function, args[:static], *args[static:])(*args[static:])
            except Untranslatable:
                return by_xla(*args)

        return call

    return decorate


class Programs:
    """Compiled programs with one `ProgramKey`, of arrays of any length whose last axis is the lane axis.

    The programs are kernels for the CPU, which raise `Untranslatable` if no kernel can be made, or compiled by XLA
    for the devices of a `platform`, such as "cpu".

    - `block`: number of lanes that step together, so that each waits for the slowest.
    - `lanes_per_call`: number of lanes per call, large enough for a small overhead of the call.
    - `compiler`: name of the compiler.
    - `compiles_check`: whether check runs have a program of their own. XLA would take long to compile it.
    """

    def __init__(self, kind: ProgramKey, dtype: np.dtype, platform: str | None = None) -> None:
        self.kind, self._dtype, self._platform = kind, dtype, platform
        self.compiler = "llvm" if platform is None else "xla"
        self.compiles_check = platform is None and kind.recorder.for_check() != kind.recorder
        self.block = XLA_BLOCK if platform == "cpu" else XLA_BLOCK_ON_ACCELERATOR
        self.lanes_per_call = XLA_BLOCKS_PER_CALL * XLA_BLOCK if platform == "cpu" else XLA_BLOCK_ON_ACCELERATOR
        if platform is None:
            self.block = max(KERNEL_REGISTERS.values()) * native.vector_bytes() // dtype.itemsize
            self.lanes_per_call = 1024  # few enough for all threads to have work

    def check_arithmetic(self) -> None:
        """Compile `EQUATION_FUNCTIONS` like the programs; raise `InputError` if one of them differs from numpy."""
        evaluate, compiler = _evaluate_by_kernel, f"llvmlite {llvmlite.__version__}"
        if self._platform is not None:
            evaluate, compiler = evaluation(self._platform), f"jaxlib {version('jaxlib')}"
        check(evaluate, EQUATION_FUNCTIONS, compiler, self._dtype, self.block)

    def bind(self, program: Callable[..., Any], *arguments: Any) -> BoundKernel | BoundProgram:
        """Return a program of lanes bound to arguments, to compute some lanes at a time.

        Uses the current device and precision, in which calls of a `BoundProgram` must be made as well.
        """
        if self._platform is None:
            registers = KERNEL_REGISTERS.get(program, 1)
            return kernel_for(program, (self.kind,), *arguments, registers=registers).bind(*arguments)
        return BoundProgram(program, (self.kind,), self.block, self.lanes_per_call // self.block, *arguments)


def _evaluate_by_kernel(function: Callable[..., Any], *x: Any) -> Any:
    return kernel_for(function, (), *x)(*x)
