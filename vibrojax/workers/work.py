"""The chunks of a sweep, each computed once it is asked for, with the time that it took."""

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from vibrojax.devices import with_threads
from vibrojax.engine.batch import Features, Report, unreported
from vibrojax.engine.chunks import Chunks
from vibrojax.input.definition import Sweep
from vibrojax.periodic import Orbits

SECONDS = "seconds"
"""The feature of a chunk, (), that says how long it took."""


class Work:
    """The chunks of a sweep; orbits are found in them where it asks for any.

    `threads`: by how many threads each is computed; None: as many as there are cores.
    """

    def __init__(self, sweep: Sweep, threads: int | None = None) -> None:
        with with_threads(threads):
            self.chunks = Chunks(sweep, Orbits(sweep) if sweep.run.orbits else None)

    def compute(self, index: int, report: Report = unreported) -> Features:
        """A chunk's features, see [vibrojax.engine.chunks.Chunks.compute][], and the `seconds` that they took."""
        began = time.monotonic()
        with quiet():
            features = self.chunks.compute(index, report)
        return features | {SECONDS: np.array(time.monotonic() - began)}


@contextmanager
def quiet() -> Iterator[None]:
    """Lanes that blow up are flagged: numpy's warnings beside, from any thread, would be a storm."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield
