"""What lanes run on: the devices of this computer, and in which precision."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

import jax

THREADS = ("VIBROJAX_THREADS", "SLURM_CPUS_PER_TASK")
"""Of the environment: threads that compute lanes, where not one for each core; the first that is a number counts."""

_THREADS: ContextVar[int | None] = ContextVar("threads", default=None)


def workers() -> list[jax.Device]:
    """The device that each of the threads that compute lanes uses.

    A jitted loop keeps one CPU core busy, so there are as many threads as cores; all share the first CPU device and so
    one compiled program. Of accelerators, each has a thread.
    """
    devices = jax.local_devices()
    return devices[:1] * threads() if devices[0].platform == "cpu" else devices


@contextmanager
def with_threads(count: int | None) -> Iterator[None]:
    """In this context so many threads compute lanes, where one process is one of several; None: as without."""
    before = _THREADS.set(count)
    try:
        yield
    finally:
        _THREADS.reset(before)


def threads() -> int:
    """How many threads compute lanes: as many as are asked for, else as there are cores."""
    asked = [os.environ.get(name, "") for name in THREADS]
    return _THREADS.get() or next((int(one) for one in asked if one.isdecimal() and int(one)), usable_cores())


def usable_cores() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def precision(name: str) -> AbstractContextManager[object]:
    """A context in which this thread's JAX computes in "float64" or "float32", whatever it does outside."""
    return jax.enable_x64(name == "float64")
