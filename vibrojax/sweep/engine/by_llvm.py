"""Programs of lanes as kernels: what a CPU runs."""

from collections.abc import Callable
from typing import Any

import llvmlite
import numpy as np

from vibrojax.compile.arithmetic import check
from vibrojax.compile.kernels import Kernel, native
from vibrojax.sweep.engine.programs import Kind, Programs, settle_lanes
from vibrojax.sweep.engine.trust import run

REGISTERS = {settle_lanes: 2}
"""Registers for each value of a group of lanes, where not one: of two the processor works on one while the other's
sums are on their way. While lanes are observed too much is at hand for that."""

LANES_PER_CALL = 512


class ByLlvm(Programs):
    """Programs for the CPU."""

    compiler = "llvm"
    hand = LANES_PER_CALL

    def __init__(self, kind: Kind, dtype: np.dtype) -> None:
        super().__init__(kind)
        self.block = max(REGISTERS.values()) * native.vector_bytes() // dtype.itemsize

    def check_arithmetic(self, dtype: np.dtype) -> None:
        check(_evaluated, f"llvmlite {llvmlite.__version__}", dtype, self.block)

    def _run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        return run(program, (self.kind,), *arguments, registers=REGISTERS.get(program, 1))


def _evaluated(function: Callable[..., Any], *x: Any) -> Any:
    return Kernel(function, *x)(*x)
