"""The first half of the lanes' work, common to both accuracies; lanes that have settled leave early."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.repeats import REPEATS_WITHIN, scales
from vibrojax.measures.section import Settling
from vibrojax.models.arrays import Array
from vibrojax.stepping import Accuracy
from vibrojax.sweep.engine.batch import Batch, Engine, Features, Index, Report
from vibrojax.sweep.input.run_settings import RunSettings

OBSERVING = 2.0
"""Work of a second under observation, relative to that of a second before."""

CHECKPOINTS = ((0.25,), (0.5,), (1.0,))
"""Shares of the first half at which lanes are checked for having settled, and the others sorted by their pace."""

CHECKPOINTS_ON_ORBITS = ((0.16, 0.21, 0.28), (0.38, 0.5), (0.7, 1.0))
"""The same if lanes end on orbits, in rounds. At the end of a round, all lanes near an orbit are examined together,
because a few cost as much as many."""

SETTLED = 0.01
"""Part of the accepted error that a lane observed early may still be away from its limit, if steps have no tolerance;
else the tolerance counts."""

CHECK_SETTLES = 0.5
"""Additional settling of the check run of a settled lane, as part of the time that the lane took."""

LONGEST_EARLY_REPEAT = 3
"""Longest repeat, in returns, that the last eight returns show several times."""

LanesBool = Bool[np.ndarray, " lanes"]
LanesFloat = Float[np.ndarray, " lanes"]


def repeats_lately(returns: Settling, now: float) -> LanesBool:
    """Return the lanes that repeat within the tolerance of labels, by their last eight returns before `now` [s].

    Repeats of up to half of these returns are seen.
    """
    states, times, passed = returns.seen.states, returns.seen.times, returns.passed
    repeating = np.zeros(times.shape[-1], bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.stack(scales(passed.amplitudes, passed.since))
        for repeat in range(1, len(times) // 2 + 1):
            changes = np.abs(states[:-repeat, : len(scale)] - states[repeat:, : len(scale)]) / scale
            repeating |= np.max(changes, axis=(0, 1)) < REPEATS_WITHIN
        return repeating & _returned_lately(times, now)


def _returned_lately(times: Array, now: float) -> Array:
    return now - times[0] < 1.5 * np.max(times[:-1] - times[1:], axis=0)


def settled(
    returns: Settling, now: float, end: float, observe: float, tolerance: float
) -> tuple[LanesBool, LanesFloat]:
    """Return the lanes that may be observed at once, and for how long.

    All future differences between their repeats add up to less than `tolerance`. The differences are taken as a
    geometric series; if that falls slowly, only those until the lane's `end` count.

    **Arguments:**

    - `returns`: the last returns, see [vibrojax.measures.section][]: arrays whose last axis is lanes.
    - `now`, `end`, `observe` [s]: the time, that at which the lane would be done, and the length of its observation.
    - `tolerance`: the relative distance from its limit at which a lane has settled.

    **Returns:** a mask, and the time [s] in which a lane makes the returns that labels need; each (lanes,).
    """
    states, times, passed = returns.seen.states, returns.seen.times, returns.passed
    lanes = times.shape[-1]
    done, duration = np.zeros(lanes, bool), np.zeros(lanes)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.stack(scales(passed.amplitudes, passed.since))
        states = states[:, : len(scale)]
        lately = _returned_lately(times, now)
        for repeat in range(1, LONGEST_EARLY_REPEAT + 1):
            seconds = times[:-repeat] - times[repeat:]
            moved = np.max(np.abs(states[:-repeat] - states[repeat:]) / scale, axis=1)
            change = np.maximum(moved[:-1], np.abs(seconds[:-1] - seconds[1:]) / seconds[0])
            # The maximum of half of them: a single one may be small by chance, if the distance turns in its plane.
            half = len(change) // 2
            newer, older = change[:half].max(axis=0), change[-half:].max(axis=0)
            ratio = (newer / older) ** (repeat / (len(change) - half))
            repeats_left = (end - now) / seconds[0]
            remaining = newer * np.where(ratio < 1, np.minimum(ratio / (1 - ratio), repeats_left), repeats_left)
            needed = (max(FEWEST_RETURNS, 3 * repeat + 1) + 1.5) * seconds[0] / repeat
            new = ~done & (newer < REPEATS_WITHIN) & lately & (needed <= observe) & (remaining <= tolerance)
            duration = np.where(new, needed, duration)
            # A repeat of one return is also one of two: the shortest counts.
            done |= new
    return done, duration


class ReadyLanes(NamedTuple):
    """Lanes of a chunk, by index, at the end of their common run, with the batch of either accuracy."""

    lanes: Index
    fine: Batch
    check: Batch


class Ended(NamedTuple):
    """Lanes of a chunk, by index, that need no more steps, and their certified features."""

    lanes: Index
    features: Features


@runtime_checkable
class EarlyStopping(Protocol):
    """Search for lanes that need no more steps, each at its own time."""

    def of_chunk(self) -> "EarlyStopping":
        """Return the search for the lanes of one chunk, independent of other chunks."""
        ...

    def near(self, batch: Batch) -> Bool[np.ndarray, " lanes"]:
        """Return the lanes worth a closer look; this costs almost nothing."""
        ...

    def __call__(self, batch: Batch) -> list[Ended]:
        """Return the lanes of a batch that need no more steps, by their index in it."""
        ...


class ActiveLanes(NamedTuple):
    """Lanes underway, by index, and their batch."""

    lanes: Index
    batch: Batch

    def split(self, mask: LanesBool) -> "tuple[ActiveLanes, ActiveLanes]":
        """Return the lanes of the mask, and the others."""
        inside, outside = (ActiveLanes(self.lanes[x], self.batch.of(np.flatnonzero(x))) for x in (mask, ~mask))
        return inside, outside

    def joined(self, others: "list[ActiveLanes]") -> "ActiveLanes":
        """Return these lanes and the others."""
        others = [other for other in others if len(other.lanes)]
        if not others:
            return self
        lanes = np.concatenate([self.lanes, *(other.lanes for other in others)])
        return ActiveLanes(lanes, self.batch.joined([other.batch for other in others]))


def looks(run: RunSettings, on_orbits: bool = False) -> list[list[float]]:
    """Return the times [s] at which lanes are checked, in rounds, also for ends on orbits.

    The last is that after which half of the work is left, or the begin of the observation.
    """
    half = min(run.settle, (run.settle + OBSERVING * run.observe) / 2)
    rounds = CHECKPOINTS_ON_ORBITS if on_orbits else CHECKPOINTS
    return [[share * half for share in shares] for shares in rounds] if half > 0 else []


def run_together(
    engine: Engine,
    start: Batch,
    coarse: Accuracy,
    tolerance: float,
    early: bool,
    search: EarlyStopping | None,
    report: Callable[[float], Report],
) -> Iterator[ReadyLanes | Ended]:
    """Step lanes from t = 0 until both accuracies need runs of their own; yield first those that leave early.

    Lanes stop as often if they do not end early, so that lanes that never settle have the same values.

    **Arguments:**

    - `coarse`: the accuracy of the check run; `tolerance`: see `settled`.
    - `early`: True if lanes end early; `search`: for lanes that need no more steps.
    - `report(seconds)`: reports lanes that have settled for that time.
    """
    run = engine.sweep.run
    ends = search.of_chunk() if early and search is not None else None
    active, before = ActiveLanes(np.arange(len(start.begin)), start), 0.0
    for times in looks(run, search is not None):
        near: list[ActiveLanes] = []
        for now in times:
            if len(active.lanes):
                active = active._replace(batch=engine.settle([active.batch], now, report(now - before))[0])
            before = now
            if ends is not None:
                candidates, active = active.split(ends.near(active.batch))
                near.append(candidates)
        if early:
            assert active.batch.underway is not None
            returns = active.batch.underway.carry
            done, duration = settled(returns, now, run.settle + run.observe, run.observe, tolerance)
            if done.any():
                leaving, active = active.split(done)
                fine = leaving.batch.observed(now, duration[done])
                check = replace(fine, accuracy=coarse).observed((1 + CHECK_SETTLES) * now, duration[done])
                yield ReadyLanes(leaving.lanes, fine, check)
        if ends is not None:
            candidates = near[0].joined(near[1:])
            remaining = np.ones(len(candidates.lanes), bool)
            for ended in ends(candidates.batch):
                remaining[ended.lanes] = False
                yield ended._replace(lanes=candidates.lanes[ended.lanes])
            active = active.joined([candidates.split(remaining)[0]])
        if not len(active.lanes):
            return
    yield ReadyLanes(active.lanes, active.batch, replace(active.batch, accuracy=coarse))
