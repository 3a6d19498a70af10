"""Devices of this computer, threads per process, and precision."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

import jax

THREAD_VARIABLES = ("VIBROJAX_THREADS", "SLURM_CPUS_PER_TASK")
"""Environment variables for the number of threads. The first that holds a positive integer applies."""

_THREADS: ContextVar[int | None] = ContextVar("threads", default=None)


def workers() -> list[jax.Device]:
    """Return a list with the jax device of each thread that computes lanes.

    A compiled loop keeps one CPU core busy, so by default there is one thread per core. All threads share the first CPU
    device and thus one compiled program. On accelerators there is one thread per device.
    """
    devices = jax.local_devices()
    return devices[:1] * threads() if devices[0].platform == "cpu" else devices


@contextmanager
def with_threads(count: int | None) -> Iterator[None]:
    """Set the number of threads that compute lanes within the context; None keeps the default.

    Processes that share one computer use this context to divide its cores.
    """
    before = _THREADS.set(count)
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


def precision(name: str) -> AbstractContextManager[object]:
    """Return a context in which jax computes in "float64" or "float32" in this thread, whatever its configuration."""
    return jax.enable_x64(name == "float64")
