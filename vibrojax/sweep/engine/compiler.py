"""Compiled programs of lanes. Kernels of foreign scenes are compared with XLA on their first steps."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

import jax.numpy as jnp
import llvmlite
import numpy as np
from jaxlib import version as jaxlib

from vibrojax import compile as compilation
from vibrojax.compile import run_kernel
from vibrojax.compile.arithmetic import check
from vibrojax.compile.kernels import Kernel, native
from vibrojax.compile.xla import compiler_options, evaluation, run_in_blocks
from vibrojax.measures.recorder import Features
from vibrojax.measures.run import Effort, Underway
from vibrojax.models.arrays import Array, Lanes
from vibrojax.models.physics import elementary
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import Lane
from vibrojax.sweep.engine.agreement import scene_subject
from vibrojax.sweep.engine.programs import Given, Kind, lanes_on_orbit, observe_lanes, settle_lanes, start_lanes

R = TypeVar("R")

KERNEL_REGISTERS = {settle_lanes: 2}
"""Registers per value of a group of lanes, 1 by default. With two, the processor works on one while sums of the other
are under way. The observation has too many values for that."""

KERNEL_LANES_PER_CALL = 512
"""Lanes per call of a kernel: enough that the call itself costs little, few enough that all threads have work."""

XLA_BLOCK = 64
"""Lanes that XLA steps together on a CPU core: a step's arrays stay in cache, and few lanes wait for others. Every
block has this size, and one thread, so that no bit of a lane depends on what is computed beside it."""

XLA_BLOCKS_PER_CALL = 8
"""Blocks per call of a program, one after the other: a call costs as much as some hundred steps of a block."""

XLA_BLOCK_ON_ACCELERATOR = 16384
"""Lanes that step together on an accelerator, where a step of few lanes costs as much as one of many."""

EQUATION_FUNCTIONS = (*(x for x in vars(elementary).values() if hasattr(x, "registry")), jnp.arctan2)
"""Functions that equations and measures are written in: those that number types can register with, and arctan2."""


def lane_function(static: int, derives: bool = False) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Return a decorator that compiles a function of lanes; see [vibrojax.compile.lane_function][].

    Kernels of a foreign scene run only if its first steps agree with XLA. `derives`: the function takes derivatives of
    a scene's equations.
    """
    return compilation.lane_function(static, derives=derives, policy=scene_subject)


class Programs(ABC):
    """The compiled programs of one kind. They take and return arrays whose last axis is the lanes', of any length.

    - `block`: lanes that step together, so that each waits for the slowest.
    - `hand`: lanes per call, enough that the call itself costs little.
    - `compiler`: its name.
    """

    block: int
    hand: int
    compiler: str

    def __init__(self, kind: Kind) -> None:
        self.kind = kind

    def start(self, given: Given) -> tuple[Lane, Any]:
        """Run `start_lanes`."""
        return self._run(start_lanes, given)

    def settle(self, given: Given, underway: Underway, until: Lanes, effort: Effort) -> Underway:
        """Run `settle_lanes`."""
        return self._run(settle_lanes, given, underway, until, effort)

    def observe(self, given: Given, underway: Underway, begin: Lanes, duration: Lanes, effort: Effort) -> Features:
        """Run `observe_lanes`."""
        return self._run(observe_lanes, given, underway, begin, duration, effort)

    def on_orbit(self, given: Given, state: Values, states: Array, times: Array, period: Lanes) -> tuple[Lane, Any]:
        """Run `lanes_on_orbit`."""
        return self._run(lanes_on_orbit, given, state, states, times, period)

    @abstractmethod
    def check_arithmetic(self, dtype: np.dtype) -> None:
        """Compare `EQUATION_FUNCTIONS` with numpy, compiled as lanes are; raise `InputError` if one is wrong."""

    @abstractmethod
    def _run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        """Return the results of a program of lanes, on the device and in the precision in use."""


class ByLlvm(Programs):
    """Programs as kernels, for the CPU. They raise `Untranslatable` if no kernel can be made or trusted."""

    compiler = "llvm"
    hand = KERNEL_LANES_PER_CALL

    def __init__(self, kind: Kind, dtype: np.dtype) -> None:
        super().__init__(kind)
        self.block = max(KERNEL_REGISTERS.values()) * native.vector_bytes() // dtype.itemsize

    def check_arithmetic(self, dtype: np.dtype) -> None:
        check(_evaluate_by_kernel, EQUATION_FUNCTIONS, f"llvmlite {llvmlite.__version__}", dtype, self.block)

    def _run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        registers = KERNEL_REGISTERS.get(program, 1)
        return run_kernel(program, (self.kind,), *arguments, registers=registers, policy=scene_subject)


def _evaluate_by_kernel(function: Callable[..., Any], *x: Any) -> Any:
    return Kernel(function, *x)(*x)


class ByXla(Programs):
    """Programs compiled by XLA for the devices of a `platform`, such as "cpu"."""

    compiler = "xla"

    def __init__(self, kind: Kind, platform: str) -> None:
        super().__init__(kind)
        self._platform = platform
        self.block, self._blocks = (
            (XLA_BLOCK, XLA_BLOCKS_PER_CALL) if platform == "cpu" else (XLA_BLOCK_ON_ACCELERATOR, 1)
        )
        self.hand = self.block * self._blocks

    def check_arithmetic(self, dtype: np.dtype) -> None:
        evaluate = evaluation(tuple(compiler_options(self._platform).items()))
        check(evaluate, EQUATION_FUNCTIONS, f"jaxlib {jaxlib.__version__}", dtype, self.block)

    def _run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        return run_in_blocks(program, (self.kind,), self.block, self._blocks, *arguments)
