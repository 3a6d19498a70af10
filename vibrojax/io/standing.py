"""Progress, workers and failures of a sweep, read only from the folder of its chunks."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from vibrojax.errors import InputError
from vibrojax.io.claims import Claims, Held, is_locked
from vibrojax.io.manifest import MANIFEST
from vibrojax.io.shards import LOCK, SHARD

CHUNKS = ".chunks"
"""Suffix of the folder of chunks next to an output file."""

_PACE_SECONDS = 10.0
"""Shortest time [s] between the first and the last chunk from which a rate of progress is computed."""

_MALFORMED = (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError)
"""Exceptions raised when reading a JSON file of unknown origin."""


@dataclass(frozen=True)
class Failure:
    """A chunk that could not be computed, the process that attempted it (`by`), and the reason (`why`)."""

    chunk: int
    by: str
    why: str


@dataclass(frozen=True)
class Standing:
    """The state of a folder of chunks.

    `title`, `lanes` and `chunks` describe the complete sweep; `size` is the number of lanes per chunk. `finished` lists
    the indices of the existing chunks and `nbytes` is their total size. `per_second` is their rate, None if unknown.
    `whole_held`: whether a process has locked the folder.
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
        last = self.chunks - 1 in self.finished
        return len(self.finished) * self.size - last * (self.chunks * self.size - self.lanes)


def standing(folder: Path) -> Standing:
    """Read the state of a folder of chunks; raise `InputError` if the folder is something else."""
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
