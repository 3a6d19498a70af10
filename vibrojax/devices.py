"""What lanes run on: the devices of this computer, and in which precision."""

import os
from contextlib import AbstractContextManager

import jax


def workers() -> list[jax.Device]:
    """The device that each of the threads that compute lanes uses.

    A jitted loop keeps one CPU core busy, so there are as many threads as cores; all share the first CPU device and so
    one compiled program. Of accelerators, each has a thread.
    """
    devices = jax.local_devices()
    return devices[:1] * usable_cores() if devices[0].platform == "cpu" else devices


def usable_cores() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def precision(name: str) -> AbstractContextManager[object]:
    """A context in which this thread's JAX computes in "float64" or "float32", whatever it does outside."""
    return jax.enable_x64(name == "float64")
