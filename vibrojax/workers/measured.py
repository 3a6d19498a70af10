"""What some lanes of a sweep take: measured, for plans that hold."""

import time
from typing import NamedTuple

import numpy as np

from vibrojax.engine.labelled import labelled
from vibrojax.input.definition import Sweep
from vibrojax.store.packing import Sizes
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
    sizes, lanes, chunk_bytes = Sizes(), 0, 0
    began, spent = time.monotonic(), 0.0
    for index in dict.fromkeys(np.linspace(0, chunks.count - 1, CHUNKS + 2).astype(int)[1:-1].tolist()):
        processor = time.process_time()
        features = work.compute(index)
        spent += time.process_time() - processor
        del features[SECONDS]
        lanes += chunks.width(index)
        chunk_bytes += sum(x.nbytes for x in features.values())
        sizes.add(labelled(sweep, *chunks.lanes(index), features, whole=False))
        if time.monotonic() - began > LONGEST:
            break
    return Measured(spent / lanes, chunk_bytes / lanes, sizes.lane_bytes, sizes.left(sweep.lanes))
