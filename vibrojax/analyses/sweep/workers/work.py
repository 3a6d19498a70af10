"""The chunks of a sweep, each computed once it is asked for, with the time that it took."""

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from vibrojax.analyses.chaos import Natures
from vibrojax.compile.devices import with_threads
from vibrojax.periodic import Nearby, Orbits, early_ends
from vibrojax.sweep.engine.batch import Features, Report, unreported
from vibrojax.sweep.engine.carried import Carried
from vibrojax.sweep.engine.chunks import Beyond, Chunks
from vibrojax.sweep.input.definition import Sweep

SECONDS = "seconds"
"""The feature of a chunk, (), that says how long it took."""


class Work:
    """The chunks of a sweep; orbits are found in them where it asks for any.

    `threads`: by how many threads each is computed; None: as many as there are cores.
    """

    def __init__(self, sweep: Sweep, threads: int | None = None) -> None:
        with with_threads(threads):
            self.chunks = _chunks(sweep)

    def compute(self, index: int, report: Report = unreported) -> Features:
        """A chunk's features, see [vibrojax.sweep.engine.chunks.Chunks.compute][], and the `seconds` that they took."""
        began = time.monotonic()
        with quiet():
            features = self.chunks.compute(index, report)
        return features | {SECONDS: np.array(time.monotonic() - began)}


def _chunks(sweep: Sweep) -> Chunks:
    if sweep.run.carry is None:
        return Chunks(sweep, _beyond(sweep), early_ends(sweep))
    return Carried(sweep, _beyond(sweep))


def _beyond(sweep: Sweep) -> Beyond | None:
    """What is to be found of lanes that have been observed."""
    parts: list[Beyond] = [Orbits(sweep), Nearby(sweep)] if sweep.run.orbits else []
    parts += [Natures(sweep)] if sweep.run.lyapunov else []

    def found(first: int, end: int, features: Features) -> Features:
        more: Features = {}
        for part in parts:
            more |= part(first, end, features | more)
        return more

    return found if parts else None


@contextmanager
def quiet() -> Iterator[None]:
    """Lanes that blow up are flagged: numpy's warnings beside, from any thread, would be a storm."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield
