"""Compiled programs of lanes. Kernels of scenes from outside the package are first compared with XLA."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from queue import SimpleQueue
from typing import Any, TypeVar

import jax.numpy as jnp
import llvmlite
import numpy as np
from jaxlib import version as jaxlib

from vibrojax import compile as compilation
from vibrojax.compile import run_kernel
from vibrojax.compile.agreement import check
from vibrojax.compile.kernels import Kernel, native
from vibrojax.compile.xla import compiler_options, evaluation, run_in_blocks
from vibrojax.models.physics import elementary
from vibrojax.sweep.engine.agreement import scene_subject
from vibrojax.sweep.engine.programs import Kind, settle_lanes

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

EQUATION_FUNCTIONS = (*(x for x in vars(elementary).values() if hasattr(x, "registry")), jnp.arctan2)
"""Elementary functions that equations and measures use: the generic functions of `elementary`, and arctan2."""


def lane_function(static: int, derives: bool = False) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Return a decorator that compiles a function of lanes; see [vibrojax.compile.lane_function][].

    Kernels of a scene from outside the package run only if the first steps of this scene agree with XLA. `derives`:
    whether the function computes derivatives of a scene's equations.
    """
    return compilation.lane_function(static, derives=derives, policy=scene_subject)


class Programs(ABC):
    """Compiled programs of one `Kind`. They take and return arrays whose last axis is the lane axis, of any length.

    - `block`: number of lanes that step together, so that each waits for the slowest.
    - `lanes_per_call`: number of lanes per call, large enough for a small overhead of the call.
    - `compiler`: name of the compiler.
    """

    block: int
    lanes_per_call: int
    compiler: str

    def __init__(self, kind: Kind) -> None:
        self.kind = kind

    @abstractmethod
    def check_arithmetic(self, dtype: np.dtype) -> None:
        """Compile `EQUATION_FUNCTIONS` like the programs; raise `InputError` if one of them differs from numpy."""

    @abstractmethod
    def run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        """Run a program of lanes on the current device and in the current precision, and return its results."""


class ByLlvm(Programs):
    """Programs compiled as kernels for the CPU. They raise `Untranslatable` if no kernel can be made or trusted."""

    compiler = "llvm"
    lanes_per_call = 512  # enough for a small overhead of the call, few enough for all threads to have work

    def __init__(self, kind: Kind, dtype: np.dtype) -> None:
        super().__init__(kind)
        self.block = max(KERNEL_REGISTERS.values()) * native.vector_bytes() // dtype.itemsize

    def check_arithmetic(self, dtype: np.dtype) -> None:
        check(_evaluate_by_kernel, EQUATION_FUNCTIONS, f"llvmlite {llvmlite.__version__}", dtype, self.block)

    def run(self, program: Callable[..., Any], *arguments: Any) -> Any:
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
        self.lanes_per_call = self.block * self._blocks

    def check_arithmetic(self, dtype: np.dtype) -> None:
        evaluate = evaluation(tuple(compiler_options(self._platform).items()))
        check(evaluate, EQUATION_FUNCTIONS, f"jaxlib {jaxlib.__version__}", dtype, self.block)

    def run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        return run_in_blocks(program, (self.kind,), self.block, self._blocks, *arguments)


Worker = TypeVar("Worker")
Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(
    work: Callable[[Worker, Item], Result], items: Sequence[Item], workers: Sequence[Worker]
) -> Iterator[tuple[int, Result]]:
    """Call `work(worker, item)` for every item, in one thread per worker. A free thread takes the next item.

    **Returns:** an iterator over (index of the item, result), in the order of completion.

    **Raises:** the exception of a call of `work`. After an exception, and if the iterator is closed early (by an
    interrupt), the threads stop after their current item. The caller does not wait for them.
    """
    done: SimpleQueue[tuple[int, Result] | BaseException] = SimpleQueue()
    waiting = iter(range(len(items)))
    taking = threading.Lock()
    stopped = threading.Event()

    def run(worker: Worker) -> None:
        while not stopped.is_set():
            with taking:
                index = next(waiting, None)
            if index is None:
                return
            try:
                done.put((index, work(worker, items[index])))
            except BaseException as error:
                done.put(error)
                return

    for worker in workers[: len(items)]:
        threading.Thread(target=run, args=(worker,), daemon=True).start()
    try:
        for _ in items:
            result = done.get()
            if isinstance(result, BaseException):
                raise result
            yield result
    finally:
        stopped.set()
