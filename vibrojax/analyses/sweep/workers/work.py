"""The chunks of a sweep: computing and timing one chunk, and the order in which to compute many."""

import time
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager

import numpy as np

from vibrojax.analyses.chaos.natures import Natures
from vibrojax.compile.xla import with_threads
from vibrojax.periodic import Nearby, Orbits, early_stopping_of
from vibrojax.sweep.engine.batch import Features, Report, unreported
from vibrojax.sweep.engine.chunks import Carried, Chunks, PostProcessor
from vibrojax.sweep.engine.costs import lane_steps
from vibrojax.sweep.input.definition import Sweep

SECONDS = "seconds"
"""Name of the feature, of shape (), that holds the computing time of a chunk [s]."""

COST_SAMPLES = 3
"""Number of evenly spaced lanes of a chunk from which its number of steps is estimated."""

COST_CHUNKS = 8192
"""Number of chunks whose steps are estimated together, so that memory does not grow with the sweep."""


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
        """Return a chunk's features, see [vibrojax.sweep.engine.chunks.Chunks.compute][], and its computing time."""
        began = time.monotonic()
        with quiet():
            features = self.chunks.compute(index, report)
        return features | {SECONDS: np.array(time.monotonic() - began)}


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
