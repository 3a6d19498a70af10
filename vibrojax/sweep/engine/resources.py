"""Whether this machine can take a sweep, asked before any work."""

import os
import shutil
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Literal, NamedTuple, TypedDict

from vibrojax.errors import Place
from vibrojax.io.formatting import size_text, time_text
from vibrojax.sweep.input.definition import Sweep


class Cost(TypedDict):
    """What a sweep will take: its lanes and chunks, bytes of memory and disk, seconds.

    `time_s` is by the clock, of an idle machine: `compile_s`, which other lanes would take as well, and `step_s`;
    `processor_s` is what all cores spend on it together. `file_bytes` are those of `disk_bytes` that stay;
    `hour_workers`: processes of one core each that bring it under an hour, 0 where none do.
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


LONGEST = 10 * 365.25 * 86400.0
"""Seconds that nobody waits for."""


class _Limit(NamedTuple):
    """What may run short: its key in `Cost`, its name, how to write an amount, and how much there is."""

    key: Literal["memory_bytes", "disk_bytes", "time_s"]
    name: str
    text: Callable[[float], str]
    most: float | None


def check_size(sweep: Sweep, cost: Cost, out: Path | None = None) -> None:
    """Raise `InputError` where the sweep needs more memory, disk or time than there is.

    **Arguments:**

    - `cost`: what `estimate` says of the sweep: `memory_bytes`, `disk_bytes`, `time_s`.
    - `out`: the file to write; None where the result stays in memory.
    """
    limits = [
        _Limit("memory_bytes", "memory", size_text, memory()),
        _Limit("disk_bytes", "disk", size_text, None if out is None else _free(out)),
        _Limit("time_s", "time", time_text, LONGEST),
    ]
    beyond = {limit.key: limit.most for limit in limits if limit.most is not None and cost[limit.key] > limit.most}
    if not beyond:
        return
    needs = ", ".join(f"{limit.text(cost[limit.key])} of {limit.name}" for limit in limits)
    allowed = " and ".join(f"{one.text(beyond[one.key])} of {one.name}" for one in limits if one.key in beyond)
    key, advice = _reason(sweep, set(beyond))
    lanes = "1 lane needs" if sweep.lanes == 1 else f"{sweep.lanes} lanes need"
    raise Place(sweep.file).at(key).error(f"{lanes} some {needs}; there is {allowed}: {advice}")


def _reason(sweep: Sweep, beyond: AbstractSet[str]) -> tuple[str, str]:
    """The key that asks for too much, and what to do about it."""
    if beyond == {"time_s"} and sweep.run.settle + sweep.run.observe > 1e6:
        return "run", "settle and observe for a shorter time"
    if sweep.run.keep_returns > 1000:
        return "run.keep_returns", "keep fewer returns, or run fewer lanes"
    return ("points", "give fewer of them") if sweep.points is not None else ("grid", "give shorter axes")


def _free(out: Path) -> int:
    """Free bytes on the disk of `out`, with what its chunks have already taken."""
    chunks = out.with_name(f"{out.name}.chunks")
    taken = sum(path.stat().st_size for path in chunks.iterdir()) if chunks.is_dir() else 0
    return shutil.disk_usage(out.parent).free + taken


def memory() -> float | None:
    """Memory [bytes] that this process may fill; None where the system does not say."""
    try:
        found = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return None
    try:  # a container may have less
        return min(found, float(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):
        return found
