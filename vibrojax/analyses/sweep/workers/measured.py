"""Computing time and size of some lanes of a sweep, measured for an accurate cost estimate."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from vibrojax.analyses.sweep.workers.work import SECONDS, Work
from vibrojax.io.dataset import Sizes
from vibrojax.io.shards import Shards
from vibrojax.sweep.engine.labelled import labelled
from vibrojax.sweep.input.definition import Sweep

MEASURED_CHUNKS, MEASURING_SECONDS = 8, 20.0
"""Number of evenly spaced chunks that are computed, and the time [s] after which no further chunk begins."""


class MeasuredCosts(NamedTuple):
    """Measured costs of a sweep.

    - `compile_s`: processor time [s] that does not depend on the number of lanes.
    - `lane_s`: processor time [s] per lane.
    - `chunk_bytes`, `file_bytes`: bytes per lane in a finished chunk, and in the uncompressed dataset.
    - `packed`: compressed size of the dataset divided by its uncompressed size.
    """

    compile_s: float
    lane_s: float
    chunk_bytes: float
    file_bytes: float
    packed: float


def measured(sweep: Sweep) -> MeasuredCosts:
    """Measure the costs of a sweep: compute, store and label some chunks one by one, and discard them."""
    work = Work(sweep)
    chunks = work.chunks
    processor = time.process_time()
    work.compute(chunks.count - 1)  # includes compilation, so it does not count as time of the lanes
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
