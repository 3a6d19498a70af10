"""The machine that times were taken on."""

import platform
from importlib.metadata import version
from pathlib import Path

from vibrojax.devices import usable_cores, workers


def machine() -> dict[str, str | int]:
    """Processor, cores, accelerator if any, and the versions of Python, jax and diffrax."""
    device = workers()[0]
    found: dict[str, str | int] = {"processor": processor(), "cores": usable_cores()}
    if device.platform != "cpu":
        found["accelerator"] = device.device_kind
    return found | {"python": platform.python_version()} | {name: version(name) for name in ("jax", "diffrax")}


def processor() -> str:
    """The name of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
