"""The machine that lanes run on: how many CPU devices, and in which precision."""

import os
from contextlib import AbstractContextManager

import jax


def use_cores(devices: int | None = None) -> None:
    """Make every CPU core a device of its own, where JAX has not been used yet; later its devices stay as they are.

    A jitted loop uses one core, so lanes are spread over as many CPU devices as there are cores. Running a sweep calls
    this; importing the package does not.

    **Arguments:** `devices`: number of CPU devices; by default the cores this process may use.
    """
    try:
        jax.config.update("jax_num_cpu_devices", devices or usable_cores())
    except RuntimeError:
        return


def usable_cores() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def precision(name: str) -> AbstractContextManager:
    """A context in which JAX computes in "float64" or "float32", whatever it does outside."""
    return jax.enable_x64(name == "float64")
