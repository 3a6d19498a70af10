"""What some lanes of a sweep take: measured, for plans that hold."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from vibrojax.analyses.sweep.workers.work import SECONDS, Work
from vibrojax.io.packing import Sizes
from vibrojax.io.shards import Shards
from vibrojax.sweep.engine.labelled import labelled
from vibrojax.sweep.input.definition import Sweep

CHUNKS, LONGEST = 8, 20.0
"""So many chunks are computed, from all over the sweep; fewer where they take longer than so many seconds."""


class Measured(NamedTuple):
    """Of a lane: `lane_s`, seconds of processor time; bytes in a finished chunk, and in the dataset before any of it is
    packed; `packed`: what is left of these. `compile_s`: processor time that it takes whatever the lanes."""

    compile_s: float
    lane_s: float
    chunk_bytes: float
    file_bytes: float
    packed: float


def measured(sweep: Sweep) -> Measured:
    """Compute some chunks of a sweep, one by one, to see what they take, with storing and labelling; they are not
    kept."""
    work = Work(sweep)
    chunks = work.chunks
    processor = time.process_time()
    work.compute(chunks.count - 1)  # what is compiled is no part of what lanes take
    first = time.process_time() - processor
    sizes, lanes, chunk_bytes = Sizes(), 0, 0
    began, spent = time.monotonic(), 0.0
    with TemporaryDirectory(prefix="vibrojax-") as folder, Shards(Path(folder) / "measured.chunks", {}) as shards:
        shards.open(resume=False)
        for index in dict.fromkeys(np.linspace(0, chunks.count - 1, CHUNKS + 2).astype(int)[1:-1].tolist()):
            processor = time.process_time()
            shards.write(index, work.compute(index))
            features = shards.read(index)
            del features[SECONDS]
            variables = labelled(sweep, *chunks.lanes(index), features, whole=False)
            spent += time.process_time() - processor
            lanes += chunks.width(index)
            chunk_bytes += shards.size(index)
            sizes.add(variables)
            if time.monotonic() - began > LONGEST:
                break
    compiling = max(0.0, first - chunks.width(chunks.count - 1) * spent / lanes)
    return Measured(compiling, spent / lanes, chunk_bytes / lanes, sizes.lane_bytes, sizes.left(sweep.lanes))
