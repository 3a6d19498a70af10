"""Time and size of some lanes of a sweep, measured for an accurate plan."""

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

MEASURED_CHUNKS, MEASURING_SECONDS = 8, 20.0
"""Number of chunks, evenly spaced, that are computed, and the time [s] after which no further one begins."""


class MeasuredCosts(NamedTuple):
    """Measured costs of a sweep.

    - `compile_s`: processor time [s] that does not depend on the number of lanes.
    - `lane_s`, `chunk_bytes`, `file_bytes`: processor time [s] of a lane, its bytes in a finished chunk, and its bytes
      in the uncompressed dataset.
    - `packed`: compressed size of the dataset over its uncompressed size.
    """

    compile_s: float
    lane_s: float
    chunk_bytes: float
    file_bytes: float
    packed: float


def measured(sweep: Sweep) -> MeasuredCosts:
    """Compute, store and label some chunks of a sweep, one by one, and discard them."""
    work = Work(sweep)
    chunks = work.chunks
    processor = time.process_time()
    work.compute(chunks.count - 1)  # compiles, and is left out of the lanes' time
    first = time.process_time() - processor
    sizes, chunk_bytes = Sizes(), 0
    began, spent = time.monotonic(), 0.0
    with TemporaryDirectory(prefix="vibrojax-") as folder, Shards(Path(folder) / "measured.chunks", {}) as shards:
        shards.open(resume=False)
        for index in dict.fromkeys(np.linspace(0, chunks.count - 1, MEASURED_CHUNKS + 2).astype(int)[1:-1].tolist()):
            processor = time.process_time()
            shards.write(index, work.compute(index))
            features = shards.read(index)
            chunk_bytes += sum(x.nbytes for x in features.values())
            del features[SECONDS]
            variables = labelled(sweep, *chunks.lanes(index), features, whole=False)
            spent += time.process_time() - processor
            sizes.add(variables)
            if time.monotonic() - began > MEASURING_SECONDS:
                break
    lanes = sizes.lanes
    compiling = max(0.0, first - chunks.width(chunks.count - 1) * spent / lanes)
    return MeasuredCosts(compiling, spent / lanes, chunk_bytes / lanes, sizes.lane_bytes, sizes.left(sweep.lanes))
