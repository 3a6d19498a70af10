"""Early stopping: when lanes are checked, which of them have settled, and rules by which others end."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from vibrojax.lanes.engine import Batch
from vibrojax.lanes.inputs import Features, Index, Mask, PerLane
from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.repeats import REPEATS_WITHIN
from vibrojax.measures.section import Settling
from vibrojax.physics.arrays import Array
from vibrojax.settings.run_settings import RunSettings

OBSERVING = 2.0
"""Work per simulated second during the observation, relative to that before the observation."""

CHECKPOINTS = ((0.25,), (0.5,), (1.0,))
"""Fractions of the first half after which lanes are checked for having settled. The others are sorted by pace."""

CHECKPOINTS_ON_ORBITS = ((0.16, 0.21, 0.28), (0.38, 0.5), (0.7, 1.0))
"""The same fractions if lanes stop on known orbits, grouped in rounds. After each round, all lanes near an orbit are
examined together, because a few lanes cost as much as many."""

SETTLED = 0.01
"""Largest distance from its limit at which a lane is observed early, as a fraction of the accepted error. It applies
only to steppers without an error tolerance. Otherwise this tolerance is the largest distance."""

LONGEST_EARLY_REPEAT = 3
"""Longest period, in section crossings, of which the last eight crossings contain several."""


def repeats_lately(returns: Settling, now: float) -> Mask:
    """Return a mask of the lanes that are periodic within the tolerance of labels.

    The last eight section crossings before `now` [s] are compared. Periods of up to four crossings are detected.
    """
    states, times, passed = returns.seen.states, returns.seen.times, returns.passed
    repeating = np.zeros(times.shape[-1], bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.stack(passed.scales)
        for repeat in range(1, len(times) // 2 + 1):
            changes = np.abs(states[:-repeat, : len(scale)] - states[repeat:, : len(scale)]) / scale
            repeating |= np.max(changes, axis=(0, 1)) < REPEATS_WITHIN
        return repeating & _returned_lately(times, now)


def _returned_lately(times: Array, now: float) -> Array:
    return now - times[0] < 1.5 * np.max(times[:-1] - times[1:], axis=0)


def settled(returns: Settling, now: float, end: float, observe: float, tolerance: float) -> tuple[Mask, PerLane]:
    """Return the lanes that have settled and may be observed at once, and how long to observe them.

    In a settled lane, all future differences between successive periods add up to less than `tolerance`. The
    differences are extrapolated as a geometric series. If the series decreases slowly, only its terms until the lane's
    `end` count.

    **Arguments:** `returns`: last section crossings, see [vibrojax.measures.section][]; `now`: current time [s]; `end`,
    `observe`: end and length of the observation without early stopping [s]; `tolerance`: relative distance from the
    limit at which a lane has settled.

    **Returns:** a mask, and the time [s] in which a lane makes the section crossings that labels need; each (lanes,).
    """
    states, times, passed = returns.seen.states, returns.seen.times, returns.passed
    lanes = times.shape[-1]
    done, duration = np.zeros(lanes, bool), np.zeros(lanes)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.stack(passed.scales)
        remaining = np.flatnonzero(_returned_lately(times, now))
        for repeat in range(1, LONGEST_EARLY_REPEAT + 1):
            # The maximum of half of the changes: a single one may be small by chance if the distance vector rotates.
            half, changes = (len(times) - repeat - 1) // 2, len(times) - repeat - 1

            def change(first: int, end: int, lanes: Index, repeat: int = repeat) -> PerLane:
                """Return the greatest change from one period to the next, of those numbered `first` to `end`."""
                x, t = (np.take(array[first : end + repeat + 1], lanes, axis=-1) for array in (states, times))
                x = x[:, : len(scale)]
                moved = np.max(np.abs(x[: end - first] - x[repeat : end - first + repeat]) / scale[:, lanes], axis=1)
                seconds = t[:-repeat] - t[repeat:]
                newest = times[0, lanes] - times[repeat, lanes]
                return np.max(np.maximum(moved, np.abs(seconds[:-1] - seconds[1:]) / newest), axis=0)

            newer = change(0, half, remaining)
            similar = newer < REPEATS_WITHIN
            newer, near = newer[similar], remaining[similar]
            older = change(changes - half, changes, near)
            seconds = times[0, near] - times[repeat, near]
            ratio = (newer / older) ** (repeat / (changes - half))
            repeats_left = (end - now) / seconds
            changing = newer * np.where(ratio < 1, np.minimum(ratio / (1 - ratio), repeats_left), repeats_left)
            needed = (max(FEWEST_RETURNS, 3 * repeat + 1) + 1.5) * seconds / repeat
            new = (needed <= observe) & (changing <= tolerance)
            duration[near[new]] = needed[new]
            # A motion with a period of one crossing also has a period of two: the shortest applies.
            done[near[new]] = True
            remaining = remaining[~done[remaining]]
    return done, duration


class Ended(NamedTuple):
    """Lanes that need no more steps: their indices in the chunk, and their features with error estimates."""

    lanes: Index
    features: Features


@runtime_checkable
class StopRule(Protocol):
    """Ends lanes before their time, in the thread that computes their chunk, between calls of compiled programs.

    It reads batches and may integrate orbits; it neither changes a batch nor keeps it.
    """

    def for_chunk(self) -> "StopRule":
        """Return the rule for one chunk of lanes, which knows nothing of other chunks."""

    def near(self, batch: Batch) -> Mask:
        """Return a mask of the lanes that deserve a closer examination, from a test of negligible cost."""

    def ended(self, batch: Batch) -> list[Ended]:
        """Return the lanes that need no more steps."""


def checkpoints(run: RunSettings, on_orbits: bool = False) -> list[list[float]]:
    """Return the times [s] at which lanes are checked for early stopping, grouped in rounds.

    At the last time, half of the work remains or the observation begins. `on_orbits`: whether lanes also stop on known
    orbits.
    """
    half = min(run.settle, (run.settle + OBSERVING * run.observe) / 2)
    rounds = CHECKPOINTS_ON_ORBITS if on_orbits else CHECKPOINTS
    return [[share * half for share in shares] for shares in rounds] if half > 0 else []
