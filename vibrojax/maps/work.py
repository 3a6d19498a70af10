"""The chunks of a sweep: computing them, and measuring their cost."""

import time
import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from vibrojax.compile.xla import with_threads
from vibrojax.lanes.batch import Features, Report, unreported
from vibrojax.lanes.chunks import Carried, Chunks, PostProcessor
from vibrojax.lanes.labelled import labelled
from vibrojax.lanes.parallel import in_parallel
from vibrojax.maps.costs import lane_steps
from vibrojax.maps.shards import Shards
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic import Nearby, Orbits, early_stopping_of
from vibrojax.periodic.natures import Natures

SECONDS = "seconds"
"""Name of the feature, of shape (), that holds the computing time of a chunk [s]."""

COST_SAMPLES = 3
"""Number of evenly spaced lanes of a chunk from which its number of steps is estimated."""

COST_CHUNKS = 8192
"""Number of chunks whose steps are estimated together, so that memory does not grow with the sweep."""

MEASURED_CHUNKS, MEASURING_SECONDS = 8, 20.0
"""Number of evenly spaced chunks that `measured` computes, and the time [s] after which no further chunk begins."""


class Work:
    """The chunks of a sweep, with periodic orbits and Lyapunov exponents if the sweep requests them.

    `threads`: number of threads that compute a chunk; None: one per core.
    """

    def __init__(self, sweep: Sweep, threads: int | None = None) -> None:
        with with_threads(threads):
            if sweep.run.carry is None:
                self.chunks = Chunks(sweep, _beyond(sweep), early_stopping_of(sweep))
            else:
                self.chunks = Carried(sweep, _beyond(sweep))

    def compute(self, index: int, report: Report = unreported) -> Features:
        """Return a chunk's features, see [vibrojax.lanes.chunks.Chunks.compute][], and its computing time."""
        return next(self.compute_each([index], report))[1]

    def compute_each(self, indices: Sequence[int], report: Report = unreported) -> Iterator[tuple[int, Features]]:
        """Yield (index of the chunk, its features) for each chunk as soon as it is finished, in any order.

        Each thread computes a chunk of its own. Threads for which none is left help the others.
        """
        with quiet():
            self.chunks.compile()
            workers = self.chunks.engine.workers
            at_once = max(min(len(workers), len(indices)), 1)

            def work(_: object, index: int) -> Features:
                began = time.monotonic()
                features = self.chunks.compute(index, report)
                return features | {SECONDS: np.array((time.monotonic() - began) / at_once)}

            for place, features in in_parallel(work, indices, workers):
                yield indices[place], features


def by_cost(chunks: Chunks, indices: Collection[int]) -> list[int]:
    """Sort the `indices` of chunks by decreasing number of steps, so that no worker begins a long chunk at the end."""
    numbers = np.array(sorted(indices), int)
    if len(numbers) <= 2:
        return numbers.tolist()
    costs = []
    for part in np.split(numbers, range(COST_CHUNKS, len(numbers), COST_CHUNKS)):
        firsts, ends = part * chunks.size, np.minimum((part + 1) * chunks.size, chunks.sweep.lanes)
        lanes = np.linspace(firsts, ends - 1, COST_SAMPLES).astype(int)
        costs.append(lane_steps(chunks, lanes.ravel()).reshape(lanes.shape).mean(axis=0) * (ends - firsts))
    return numbers[np.argsort(-np.concatenate(costs), kind="stable")].tolist()


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress numpy's warnings in all threads: diverging lanes are flagged instead."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _beyond(sweep: Sweep) -> PostProcessor | None:
    """Return one function that applies all analyses requested by the sweep to observed lanes; None without any."""
    parts: list[PostProcessor] = [Orbits(sweep), Nearby(sweep)] if sweep.run.orbits else []
    parts += [Natures(sweep)] if sweep.run.lyapunov else []

    def analyse(first: int, end: int, features: Features) -> Features:
        results: Features = {}
        for part in parts:
            results |= part(first, end, features | results)
        return results

    return analyse if parts else None


class MeasuredCosts(NamedTuple):
    """Measured costs of a sweep.

    - `compile_s`: processor time [s] that does not depend on the number of lanes.
    - `lane_s`: processor time [s] per lane.
    - `chunk_bytes`, `file_bytes`: bytes per lane in a finished chunk, and in the uncompressed dataset.
    """

    compile_s: float
    lane_s: float
    chunk_bytes: float
    file_bytes: float


def measured(sweep: Sweep) -> MeasuredCosts:
    """Measure the costs of a sweep: compute, store and label some chunks one by one, and discard them."""
    work = Work(sweep)
    chunks = work.chunks
    processor = time.process_time()
    work.compute(chunks.count - 1)  # includes compilation, so it does not count as time of the lanes
    first = time.process_time() - processor
    lanes = chunk_bytes = file_bytes = 0
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
            lanes += chunks.width(index)
            file_bytes += sum(x.nbytes for x in variables.values())
            if time.monotonic() - began > MEASURING_SECONDS:
                break
    compiling = max(0.0, first - chunks.width(chunks.count - 1) * spent / lanes)
    return MeasuredCosts(compiling, spent / lanes, chunk_bytes / lanes, file_bytes / lanes)
