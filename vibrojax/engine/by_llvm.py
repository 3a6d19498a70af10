"""Programs of lanes as kernels: what a CPU runs."""

import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import llvmlite
import numpy as np

from vibrojax.engine.arithmetic import check
from vibrojax.engine.programs import Kind, Programs, settle_lanes
from vibrojax.kernels import Kernel, vector_bytes

REGISTERS = {settle_lanes: 2}
"""Registers for each value of a group of lanes, where not one: of two the processor works on one while the other's
sums are on their way. While lanes are observed too much is at hand for that."""

LANES_PER_CALL = 512


class _Key(NamedTuple):
    program: Callable[..., Any]
    kind: Kind
    types: tuple[Any, ...]


class ByLlvm(Programs):
    """Programs for the CPU."""

    compiler = "llvm"
    hand = LANES_PER_CALL

    def __init__(self, kind: Kind, dtype: np.dtype) -> None:
        super().__init__(kind)
        self.block = max(REGISTERS.values()) * vector_bytes() // dtype.itemsize

    def check_arithmetic(self, dtype: np.dtype) -> None:
        check(_evaluated, f"llvmlite {llvmlite.__version__}", dtype, self.block)

    def _run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        leaves, tree = jax.tree.flatten(arguments)
        types = (tree, *((np.result_type(x), np.shape(x)[:-1], np.ndim(x)) for x in leaves))
        return _kernel(_Key(program, self.kind, types), arguments)(*arguments)


def _evaluated(function: Callable[..., Any], *x: Any) -> Any:
    return Kernel(function, *x)(*x)


_kernels: dict[_Key, Kernel] = {}
_making: dict[_Key, threading.Lock] = {}
_lock = threading.Lock()


def _kernel(key: _Key, examples: tuple[Any, ...]) -> Kernel:
    """The kernel of a program: made once, by whichever thread comes first, while others that want it wait."""
    with _lock:
        making = _making.setdefault(key, threading.Lock())
    with making:
        if key not in _kernels:
            program, kind = key.program, key.kind
            registers = REGISTERS.get(program, 1)
            _kernels[key] = Kernel(lambda *given: program(kind, *given), *examples, registers=registers)
        return _kernels[key]
