"""Comparison of the memory, disk and time that a sweep needs with what is available, before the sweep runs."""

import os
import shutil
from pathlib import Path
from typing import TypedDict

from vibrojax.errors import Place
from vibrojax.io.formatting import size_text, time_text
from vibrojax.sweep.input.definition import Sweep

SWEEP_MAX_SECONDS = 10 * 365.25 * 86400.0
"""Longest accepted time of a sweep [s]: ten years."""


class Cost(TypedDict):
    """Estimated cost of a sweep: numbers of lanes and chunks, bytes of memory and disk, seconds.

    - `file_bytes`: the part of `disk_bytes` that remains after the sweep.
    - `time_s`: wall time on an idle machine, the sum of `compile_s` and `step_s`. `compile_s` does not depend on the
      number of lanes.
    - `processor_s`: processor time of all cores together.
    - `hour_workers`: number of single-core processes that together finish within an hour, or 0 if no number does.
    """

    lanes: int
    chunks: int
    memory_bytes: float
    disk_bytes: float
    file_bytes: float
    hour_workers: int
    time_s: float
    compile_s: float
    step_s: float
    processor_s: float


def check_size(sweep: Sweep, cost: Cost, out: Path | None = None) -> None:
    """Raise `InputError` if the sweep needs more memory, disk or time than is available.

    `cost`: estimated cost. `out`: output file, or None if the result stays in memory.
    """
    limits = [
        (cost["memory_bytes"], memory(), size_text, "memory"),
        (cost["disk_bytes"], None if out is None else _free(out), size_text, "disk"),
        (cost["time_s"], SWEEP_MAX_SECONDS, time_text, "time"),
    ]
    short = {name: f"{text(most)} of {name}" for need, most, text, name in limits if most is not None and need > most}
    if not short:
        return
    if set(short) == {"time"} and sweep.run.settle + sweep.run.observe > 1e6:
        key, advice = "run", "settle and observe for a shorter time"
    elif sweep.run.keep_returns > 1000:
        key, advice = "run.keep_returns", "keep fewer returns, or run fewer lanes"
    else:
        key, advice = ("points", "give fewer of them") if sweep.points is not None else ("grid", "give shorter axes")
    needs = ", ".join(f"{text(need)} of {name}" for need, _, text, name in limits)
    lanes = "1 lane needs" if sweep.lanes == 1 else f"{sweep.lanes} lanes need"
    available = " and ".join(short.values())
    raise Place(sweep.file).at(key).error(f"{lanes} about {needs}; there is {available}: {advice}")


def _free(out: Path) -> int:
    """Return the free space on the disk of `out`, including the space of chunks already stored for it [bytes]."""
    chunks = out.with_name(f"{out.name}.chunks")
    taken = sum(path.stat().st_size for path in chunks.iterdir()) if chunks.is_dir() else 0
    return shutil.disk_usage(out.parent).free + taken


def memory() -> float | None:
    """Return the memory available to this process [bytes], or None if it is unknown."""
    try:
        total = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return None
    try:  # a container may have less
        return min(total, float(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):
        return total
