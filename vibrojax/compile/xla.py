"""Devices and precision, and functions of lanes compiled by XLA, for accelerators and where no kernel can be made."""

import os
import sys
import threading
from collections.abc import Callable, Hashable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from functools import cache, partial, wraps
from importlib.metadata import entry_points, version
from importlib.util import find_spec
from typing import Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Int

from vibrojax.lazy import jax, jnp, pending

WIDE_VECTORS_CHECKED = ("0.10.0", "0.12.0.1")
"""Versions of jaxlib whose functions are correct with AVX-512 registers. In 0.10.2, 0.11.0 and 0.11.2, arctan of more
than 16 values returns its results in the wrong order."""

P = ParamSpec("P")
R = TypeVar("R")


def compiler_options(platform: str) -> dict[str, int | str]:
    """Return XLA's options for functions of lanes on the devices of a platform, such as "cpu"."""
    options: dict[str, int | str] = {}
    if platform == "cpu":
        if version("jaxlib") in WIDE_VECTORS_CHECKED:
            # Use the widest registers. On processors with narrower registers this option has no effect.
            options["xla_cpu_prefer_vector_width"] = 512
        if jax.__version_info__ < (0, 11, 2):
            # This pass removes barriers before fusion. The fusions then recompute shared values: eight times the
            # arithmetic. Later versions of jax do not have this pass.
            options["xla_disable_hlo_passes"] = "cse_barrier_expander"
    return options


def jitted(static: tuple[str, ...] = ()) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator like `jax.jit`, with the options of the current platform and the static arguments `static`."""

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
def evaluation(platform: str) -> Callable[..., Any]:
    """Return `evaluate(function, *arrays)`, which compiles a function with a platform's options and calls it."""
    return lambda function, *arrays: jax.jit(function, compiler_options=compiler_options(platform))(*arrays)


class BoundProgram:
    """`function(*static, *arguments)` compiled by XLA, which computes some of its `lanes` at a time, block by block.

    Arguments and results are pytrees of scalars and of arrays whose last axis is the lane axis. The lanes of a call are
    padded to `blocks` blocks of `block` lanes, so that one compiled program runs any number of lanes.

    `results`: pytree of numpy arrays, which hold the lanes computed so far.
    """

    def __init__(
        self, function: Callable[..., Any], static: tuple[Hashable, ...], block: int, blocks: int, *arguments: Any
    ) -> None:
        self._run = partial(_run_blocks, function, static, block)
        self._block, self._blocks, self._arguments = block, blocks, arguments
        self.lanes = max(np.shape(x)[-1] for x in jax.tree.leaves(arguments) if np.ndim(x))
        self.results: Any = None
        self._storing = threading.Lock()

    def whole(self) -> Any:
        """Compute all lanes and return the results."""
        most = self._block * self._blocks
        for first in range(0, self.lanes, most):
            self(np.arange(first, min(first + most, self.lanes)))
        return self.results

    def __call__(self, lanes: Int[np.ndarray, " _"]) -> None:
        """Compute the lanes with these indices, at most `blocks` blocks."""
        repeated = np.resize(lanes, self._block * self._blocks)  # padding repeats the lanes from the first on
        padded = jax.tree.map(lambda x: np.take(x, repeated, axis=-1) if np.ndim(x) else x, self._arguments)
        part = jax.tree.map(np.asarray, self._run(np.int32(-(-len(lanes) // self._block)), *padded))
        with self._storing:
            if self.results is None:
                self.results = jax.tree.map(lambda x: np.empty((*x.shape[:-1], self.lanes), x.dtype), part)
            for whole, x in zip(jax.tree.leaves(self.results), jax.tree.leaves(part), strict=True):
                whole[..., lanes] = x[..., : len(lanes)]


@jitted(static=("function", "static", "block"))
def _run_blocks(
    function: Callable[..., Any], static: tuple[Hashable, ...], block: int, count: Int[Any, ""], *arguments: Any
) -> Any:
    """Return the results of the first `count` blocks, and zeros for the others. `count` is traced."""

    def cut(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x.reshape(*x.shape[:-1], -1, block), -2, 0) if x.ndim else x

    def join(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)

    def run_block(index: Any) -> Any:
        return function(*static, *jax.tree.map(lambda x: x[index] if x.ndim else x, in_blocks))

    def turn(index: Any, results: Any) -> Any:
        return jax.tree.map(lambda whole, part: whole.at[index].set(part), results, run_block(index))

    in_blocks = jax.tree.map(cut, arguments)
    number = next(len(x) for x in jax.tree.leaves(in_blocks) if x.ndim)
    shapes = jax.eval_shape(lambda: run_block(0))
    zeros = jax.tree.map(lambda x: jnp.zeros((number, *x.shape), x.dtype), shapes)
    return jax.tree.map(join, jax.lax.fori_loop(0, count, turn, zeros))


THREAD_VARIABLES = ("VIBROJAX_THREADS", "SLURM_CPUS_PER_TASK")
"""Environment variables for the number of threads. The first that holds a positive integer applies."""

DEVICE_VARIABLES = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME", "PJRT_NAMES_AND_LIBRARY_PATHS", "TPU_LIBRARY_PATH")
"""Environment variables with which jax may have other devices than the CPU, even without a plugin."""

_THREADS: ContextVar[int | None] = ContextVar("threads", default=None)


def workers() -> "list[jax.Device | None]":
    """Return a list with the accelerator of each thread that computes lanes, or None for each thread on the CPU.

    A compiled loop keeps one CPU core busy, so by default there is one thread per core. On accelerators there is one
    thread per device.
    """
    devices = jax.local_devices() if "jax" in sys.modules or _may_have_accelerator() else []
    return [*devices] if devices and devices[0].platform != "cpu" else [None] * threads()


@cache
def _may_have_accelerator() -> bool:
    """Return whether jax, which takes a second to import, may find an accelerator: by a plugin or a variable."""
    if os.environ.get("JAX_PLATFORMS") == "cpu":
        return False
    plugins = [*filter(find_spec, ("jax_plugins", "libtpu")), *entry_points(group="jax_plugins")]
    return bool(plugins) or any(os.environ.get(name) for name in DEVICE_VARIABLES)


@contextmanager
def with_threads(count: int | None) -> Iterator[None]:
    """Set the number of threads that compute lanes within the context; None keeps the current number.

    Processes that share one computer use this context to divide its cores.
    """
    before = _THREADS.set(_THREADS.get() if count is None else count)
    try:
        yield
    finally:
        _THREADS.reset(before)


def threads() -> int:
    """Return the number of threads that compute lanes.

    It is set by `with_threads` or by the environment, and defaults to the number of usable cores.
    """
    values = [os.environ.get(name, "") for name in THREAD_VARIABLES]
    return _THREADS.get() or next((int(value) for value in values if value.isdecimal() and int(value)), usable_cores())


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def precision(name: str) -> Iterator[None]:
    """Compute in "float64" or "float32" in this thread, whatever the configuration of jax.

    If jax has not been imported, its settings are made when the thread first uses it; see [vibrojax.lazy][].
    Numbers are computed at once, even if jax traces the function that calls the package. Settings for debugging the
    user's functions do not apply: lanes that fail hold NaN, programs need jit, and checks for leaks take minutes.
    """

    def enter() -> None:
        check_leaks: Any = jax.checking_leaks.func  # `jax.checking_leaks` itself is this setting with the argument True
        for setting in (jax.disable_jit, jax.debug_nans, jax.debug_infs, check_leaks):
            stack.enter_context(setting(False))
        stack.enter_context(jax.core.eval_context())
        stack.enter_context(jax.enable_x64(name == "float64"))

    before = pending.precision, pending.enter
    with ExitStack() as stack:
        pending.precision, pending.enter = name, None if "jax" in sys.modules else enter
        try:
            if pending.enter is None:
                enter()
            yield
        finally:
            pending.precision, pending.enter = before


def float_type() -> np.dtype:
    """Return the type of floats in this thread's precision."""
    return np.dtype(jnp.result_type(float) if pending.enter is None else pending.precision)
