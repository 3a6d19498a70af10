"""Progress of a sweep, its workers and its failures, read from the folder of its chunks alone."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from vibrojax.errors import InputError
from vibrojax.io.claims import Claims, Held, is_locked
from vibrojax.io.manifest import MANIFEST
from vibrojax.io.shards import LOCK, SHARD

CHUNKS = ".chunks"
"""Suffix of the folder beside an output."""

_PACE_SECONDS = 10.0
"""Shortest time between the first and the last chunk from which a pace is computed."""

_MALFORMED = (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError)
"""Errors of reading a JSON file that may come from anywhere."""


@dataclass(frozen=True)
class Failure:
    """A chunk that could not be computed, the process that tried, and the reason."""

    chunk: int
    by: str
    why: str


@dataclass(frozen=True)
class Standing:
    """The state of a folder of chunks.

    `title`, `lanes` and `chunks` describe the whole sweep; `size` counts the lanes of a chunk. `finished` lists the
    existing chunks, `nbytes` is their size, `per_second` their pace. `whole_held`: whether a process has locked it.
    """

    folder: Path
    title: str
    lanes: int
    chunks: int
    size: int
    finished: tuple[int, ...]
    nbytes: int
    per_second: float | None
    held: list[Held]
    whole_held: bool
    failures: list[Failure]

    @property
    def finished_lanes(self) -> int:
        """Lanes of the existing chunks."""
        last = self.chunks - 1 in self.finished
        return len(self.finished) * self.size - last * (self.chunks * self.size - self.lanes)


def standing(folder: Path) -> Standing:
    """Read the state of a folder of chunks; raise `InputError` if it is something else."""
    try:
        about = json.loads((folder / MANIFEST).read_bytes())["about"]
        title, (lanes, chunks, size) = str(about["title"]), (int(about[key]) for key in ("lanes", "chunks", "size"))
    except _MALFORMED:
        raise InputError(
            f"{folder}: is not a folder of a sweep's chunks (it has no whole {MANIFEST}); give OUT.nc or OUT.nc{CHUNKS}"
        ) from None
    finished, times, nbytes, failures = [], [], 0, []
    for entry in os.scandir(folder):
        if match := SHARD.fullmatch(entry.name):
            finished.append(int(match[1]))
            times.append(entry.stat().st_mtime)
            nbytes += entry.stat().st_size
        elif entry.name.endswith(".failed"):
            try:
                values = json.loads(Path(entry.path).read_bytes())
                failures.append(Failure(int(values["chunk"]), str(values["by"]), str(values["why"])))
            except _MALFORMED:
                continue
    passed = max(times) - min(times) if times else 0.0
    return Standing(
        folder=folder,
        title=title,
        lanes=lanes,
        chunks=chunks,
        size=size,
        finished=tuple(sorted(finished)),
        nbytes=nbytes,
        per_second=(len(times) - 1) / passed if passed > _PACE_SECONDS else None,
        held=Claims(folder).held(),
        whole_held=is_locked(folder / LOCK),
        failures=sorted(failures, key=lambda failure: failure.chunk),
    )
