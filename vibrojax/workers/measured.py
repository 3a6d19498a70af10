"""What some lanes of a sweep take: measured, for plans that hold."""

import time
import zlib
from typing import NamedTuple

import numpy as np

from vibrojax.engine.labelled import labelled
from vibrojax.input.definition import Sweep
from vibrojax.workers.work import SECONDS, Work

CHUNKS, LONGEST = 8, 20.0
"""So many chunks are computed, from all over the sweep; fewer where they take longer than so many seconds."""


class Measured(NamedTuple):
    """Of a lane: `lane_s`, seconds of processor time; bytes in a finished chunk, and in the dataset before it is
    compressed; `packed`: what is left of these."""

    lane_s: float
    chunk_bytes: float
    file_bytes: float
    packed: float


def measured(sweep: Sweep) -> Measured:
    """Compute some chunks of a sweep, one by one, to see what they take; they are not kept."""
    work = Work(sweep)
    chunks = work.chunks
    work.compute(chunks.count - 1)  # what is compiled is no part of what lanes take
    lanes, labelled_lanes, chunk_bytes, file_bytes, packed = 0, 0, 0, 0, 0
    began, spent = time.monotonic(), 0.0
    for index in dict.fromkeys(np.linspace(0, chunks.count - 1, CHUNKS + 2).astype(int)[1:-1].tolist()):
        processor = time.process_time()
        features = work.compute(index)
        spent += time.process_time() - processor
        del features[SECONDS]
        first, end = _whole_points(sweep, *chunks.lanes(index))
        begin = chunks.lanes(index)[0]
        lanes += chunks.width(index)
        chunk_bytes += sum(x.nbytes for x in features.values())
        if end > first:
            some = {name: x[first - begin : end - begin] for name, x in features.items()}
            labelled_lanes += end - first
            variables = list(labelled(sweep, first, end, some).values())
            file_bytes += sum(x.nbytes for x in variables)
            packed += sum(len(zlib.compress(_shuffled(x), 1)) for x in variables)
        if time.monotonic() - began > LONGEST:
            break
    return Measured(
        spent / lanes, chunk_bytes / lanes, file_bytes / max(labelled_lanes, 1), packed / max(file_bytes, 1)
    )


def _whole_points(sweep: Sweep, first: int, end: int) -> tuple[int, int]:
    """The lanes of a run of them whose points are whole."""
    starts = sweep.shape[-1] if sweep.crosses_starts else 1
    return -(-first // starts) * starts, end // starts * starts


def _shuffled(x: np.ndarray) -> bytes:
    """The bytes of numbers as HDF5 has them before it compresses: all first ones, all second ones, ..."""
    return x.reshape(-1).view(np.uint8).reshape(-1, x.dtype.itemsize).T.tobytes()
