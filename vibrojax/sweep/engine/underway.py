"""Lanes on the way to half of their work; those found meanwhile to be where they will be leave it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from vibrojax.stepping import Accuracy
from vibrojax.sweep.engine.batch import Batch, Engine, Features, Index, Report
from vibrojax.sweep.engine.settled import settled
from vibrojax.sweep.input.run_settings import RunSettings

OBSERVING = 2.0
"""Work of a second under observation, that of a second before being 1."""

LOOKS = ((0.25,), (0.5,), (1.0,))
"""Parts of the way at which lanes are looked at, and the others sorted by their pace."""

LOOKS_NEAR = ((0.16, 0.21, 0.28), (0.38, 0.5), (0.7, 1.0))
"""The same where lanes end on orbits: in rounds, at the end of which those are looked at closely that seemed to be
worth it, because a few cost as much as many."""

SETTLED = 0.01
"""Part of the accepted error that a lane observed early may still be away from where it settles, where steps have no
tolerance; else it may be as much as that."""

CHECKED = 0.5
"""The check run of a lane that has settled settles anew for this part of the time that it took."""


class Part(NamedTuple):
    """Some lanes of a chunk as far as one run serves both: which, by index, and the batches of either run."""

    lanes: Index
    fine: Batch
    check: Batch


class Ended(NamedTuple):
    """Some lanes that need no more steps: which, by index, and their features, certified."""

    lanes: Index
    features: Features


@runtime_checkable
class Ends(Protocol):
    """Finds lanes that need no more steps, each at whatever time it has come to."""

    def of_chunk(self) -> "Ends":
        """The same for the lanes of one chunk, whatever may become known of them."""
        ...

    def near(self, batch: Batch) -> Bool[np.ndarray, " lanes"]:
        """Which lanes are worth a closer look; this costs next to nothing."""
        ...

    def __call__(self, batch: Batch) -> list[Ended]:
        """Those lanes of a batch that need no more steps, by their index in it."""
        ...


class Going(NamedTuple):
    """Lanes underway: which, by index, and their batch."""

    lanes: Index
    batch: Batch

    def split(self, some: Bool[np.ndarray, " lanes"]) -> "tuple[Going, Going]":
        """Some of the lanes, and the others."""
        if not some.any():
            return Going(self.lanes[some], self.batch.of(np.flatnonzero(some))), self
        first, second = (Going(self.lanes[one], self.batch.of(np.flatnonzero(one))) for one in (some, ~some))
        return first, second

    def and_also(self, others: "list[Going]") -> "Going":
        """These lanes and the others."""
        others = [one for one in others if len(one.lanes)]
        if not others:
            return self
        lanes = np.concatenate([self.lanes, *(one.lanes for one in others)])
        return Going(lanes, self.batch.joined([one.batch for one in others]))

    def at(self, engine: Engine, now: float, report: Report) -> "Going":
        """The lanes at the time `now` [s]."""
        return Going(self.lanes, engine.settle([self.batch], now, report)[0]) if len(self.lanes) else self


def looks(run: RunSettings, near: bool = False) -> list[list[float]]:
    """Times [s] at which lanes are looked at, in rounds, also for being `near` an orbit; the last is half-way, or when
    they are observed.

    Half-way half of the work is left.
    """
    half = min(run.settle, (run.settle + OBSERVING * run.observe) / 2)
    return [[share * half for share in shares] for shares in (LOOKS_NEAR if near else LOOKS)] if half > 0 else []


class Underway:
    """How the lanes of a sweep go on their way.

    - `coarse`: the accuracy of the check run; `close`: the relative distance from where a lane settles at which it has.
    - `early`: whether lanes end early; `ends`: finds those that are where they will be. Lanes are looked at as often
      where they do not, so that the way of those that never settle is the same.
    """

    def __init__(self, run: RunSettings, coarse: Accuracy, close: float, early: bool, ends: Ends | None) -> None:
        self._run, self._coarse, self._close, self._early = run, coarse, close, early
        self._ends, self._near = ends if early else None, ends is not None

    def __call__(self, engine: Engine, start: Batch, report: Callable[[float], Report]) -> Iterator[Part | Ended]:
        """The lanes as far as one run serves both; those that leave the way come first.

        `report(seconds)` reports lanes that have been settled for so long.
        """
        going, before = Going(np.arange(len(start.begin)), start), 0.0
        ends = self._ends.of_chunk() if self._ends is not None else None
        for times in looks(self._run, self._near):
            near = []
            for now in times:
                going = going.at(engine, now, report(now - before))
                before = now
                if ends is not None:
                    some, going = going.split(ends.near(going.batch))
                    near.append(some)
            if self._early:
                settled, going = self._settled(going, now)
                yield from settled
            if ends is not None:
                looked = near[0].and_also(near[1:])
                still = np.ones(len(looked.lanes), bool)
                for ended in ends(looked.batch):
                    still[ended.lanes] = False
                    yield ended._replace(lanes=looked.lanes[ended.lanes])
                going = going.and_also([looked.split(still)[0]])
            if not len(going.lanes):
                return
        yield Part(going.lanes, going.batch, replace(going.batch, accuracy=self._coarse))

    def _settled(self, going: Going, now: float) -> tuple[list[Part], Going]:
        """Those of the lanes that have settled at `now` [s], to be observed at once, and the others."""
        underway, run = going.batch.underway, self._run
        assert underway is not None
        done, duration = settled(underway.carry, now, run.settle + run.observe, run.observe, self._close)
        if not done.any():
            return [], going
        some, going = going.split(done)
        fine = some.batch.observed(now, duration[done])
        check = replace(fine, accuracy=self._coarse).observed((1 + CHECKED) * now, duration[done])
        return [Part(some.lanes, fine, check)], going
