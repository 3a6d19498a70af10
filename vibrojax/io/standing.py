"""How far a sweep is, who holds what, and what failed: told from the folder of its chunks alone."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vibrojax.errors import InputError
from vibrojax.io.claims import Claims, Held
from vibrojax.io.folder import LOCK, shard_index
from vibrojax.io.lock import is_held
from vibrojax.io.manifest import MANIFEST

CHUNKS = ".chunks"
"""How the name of the folder beside an output ends."""

_SHORTEST = 10.0
"""Seconds over which chunks must have come for a pace to be told."""


@dataclass(frozen=True)
class Failure:
    """A chunk that could not be computed: by whom, and why."""

    chunk: int
    by: str
    why: str


@dataclass(frozen=True)
class Standing:
    """What a folder of chunks tells.

    - `title`; `lanes`, `chunks`: of the whole sweep; `size`: lanes of a chunk.
    - `finished`: the numbers of chunks that are there; `nbytes`: what they take; `per_second`: chunks that come.
    - `held`: the claims; `whole_held`: whether a process has the folder for itself; `failures`.
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
        """Lanes of the chunks that are there."""
        last = self.chunks - 1 in self.finished
        return len(self.finished) * self.size - last * (self.chunks * self.size - self.lanes)


def standing(folder: Path) -> Standing:
    """What the folder beside an output tells; raises `InputError` where it is none."""
    try:
        about = json.loads((folder / MANIFEST).read_bytes())["about"]
        title, lanes, chunks, size = str(about["title"]), int(about["lanes"]), int(about["chunks"]), int(about["size"])
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{folder}: is no folder of a sweep's chunks (it has no whole {MANIFEST}); give OUT.nc or OUT.nc{CHUNKS}"
        ) from None
    finished, times, nbytes, failures = [], [], 0, []
    for entry in os.scandir(folder):
        index = shard_index(entry.name)
        if index is not None:
            about_it = entry.stat()
            finished.append(index)
            times.append(about_it.st_mtime)
            nbytes += about_it.st_size
        elif entry.name.endswith(".failed"):
            failures += _failure(Path(entry.path))
    passed = max(times) - min(times) if times else 0.0
    return Standing(
        folder=folder,
        title=title,
        lanes=lanes,
        chunks=chunks,
        size=size,
        finished=tuple(sorted(finished)),
        nbytes=nbytes,
        per_second=(len(times) - 1) / passed if passed > _SHORTEST else None,
        held=Claims(folder).held(),
        whole_held=is_held(folder / LOCK),
        failures=sorted(failures, key=lambda one: one.chunk),
    )


def _failure(path: Path) -> list[Failure]:
    try:
        found: dict[str, Any] = json.loads(path.read_bytes())
        return [Failure(int(found["chunk"]), str(found["by"]), str(found["why"]))]
    except (OSError, ValueError, KeyError, TypeError):
        return []
