"""Devices of this computer, threads per process, and precision."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

import jax

THREAD_VARIABLES = ("VIBROJAX_THREADS", "SLURM_CPUS_PER_TASK")
"""Environment variables with the number of threads; the first that holds a positive number counts."""

_THREADS: ContextVar[int | None] = ContextVar("threads", default=None)


def workers() -> list[jax.Device]:
    """Return the device of each thread that computes lanes.

    A compiled loop keeps one CPU core busy, so there are as many threads as cores. All of them share the first CPU
    device and thus one compiled program. Each accelerator has one thread.
    """
    devices = jax.local_devices()
    return devices[:1] * threads() if devices[0].platform == "cpu" else devices


@contextmanager
def with_threads(count: int | None) -> Iterator[None]:
    """Set the number of threads that compute lanes, for one of several processes; None leaves the default."""
    before = _THREADS.set(count)
    try:
        yield
    finally:
        _THREADS.reset(before)


def threads() -> int:
    """Return the number of threads that compute lanes: that of the context or environment, else of the cores."""
    values = [os.environ.get(name, "") for name in THREAD_VARIABLES]
    return _THREADS.get() or next((int(value) for value in values if value.isdecimal() and int(value)), usable_cores())


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def precision(name: str) -> AbstractContextManager[object]:
    """Return a context in which this thread's jax computes in "float64" or "float32", regardless of its settings."""
    return jax.enable_x64(name == "float64")
