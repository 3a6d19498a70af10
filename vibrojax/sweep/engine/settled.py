"""Lanes that have settled long before they are to be observed, by their returns to the section."""

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.repeats import REPEATS_WITHIN, scales
from vibrojax.measures.section import Settling

LONGEST_REPEAT = 3
"""Returns of a repeat up to which the last eight show it several times over."""


Settled = Bool[np.ndarray, " lanes"]
PerLane = Float[np.ndarray, " lanes"]


def repeats_lately(returns: Settling, now: float) -> Settled:
    """Return which lanes repeat within the tolerance of labels, by their last eight returns before `now` [s].

    Repeats of up to half of these returns are seen.
    """
    states, times, passed = returns.seen.states, returns.seen.times, returns.passed
    repeating = np.zeros(times.shape[-1], bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.stack(scales(passed.amplitudes, passed.since))
        for repeat in range(1, len(times) // 2 + 1):
            changes = np.abs(states[:-repeat, : len(scale)] - states[repeat:, : len(scale)]) / scale
            repeating |= np.max(changes, axis=(0, 1)) < REPEATS_WITHIN
        return repeating & (now - times[0] < 1.5 * np.max(times[:-1] - times[1:], axis=0))


def settled(returns: Settling, now: float, end: float, observe: float, close: float) -> tuple[Settled, PerLane]:
    """Which lanes may be observed at once, and for how long.

    Those whose repeats differ by so little that all differences still to come add up to less than `close`. They are
    taken to fall as a geometric series; where that falls slowly, only those until the lane's `end` count.

    **Arguments:**

    - `returns`: what has been seen of returns, see [vibrojax.measures.section][]: arrays whose last axis is lanes.
    - `now`, `end`, `observe` [s]: the time; that at which the lane would be done; and how long it would be observed.
    - `close`: the relative distance from where a lane settles at which it has.

    **Returns:** a mask, and the time [s] in which a lane makes the returns that labels ask for; each (lanes,).
    """
    states, times, passed = returns.seen.states, returns.seen.times, returns.passed
    lanes = times.shape[-1]
    done, duration = np.zeros(lanes, bool), np.zeros(lanes)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.stack(scales(passed.amplitudes, passed.since))
        states = states[:, : len(scale)]
        lately = now - times[0] < 1.5 * np.max(times[:-1] - times[1:], axis=0)
        for repeat in range(1, LONGEST_REPEAT + 1):
            seconds = times[:-repeat] - times[repeat:]
            moved = np.max(np.abs(states[:-repeat] - states[repeat:]) / scale, axis=1)
            change = np.maximum(moved[:-1], np.abs(seconds[:-1] - seconds[1:]) / seconds[0])
            # Half of them together: one alone may be small by chance, where the distance turns in its plane.
            half = len(change) // 2
            newer, older = change[:half].max(axis=0), change[-half:].max(axis=0)
            ratio = (newer / older) ** (repeat / (len(change) - half))
            repeats_left = (end - now) / seconds[0]
            still = newer * np.where(ratio < 1, np.minimum(ratio / (1 - ratio), repeats_left), repeats_left)
            needed = (max(FEWEST_RETURNS, 3 * repeat + 1) + 1.5) * seconds[0] / repeat
            new = ~done & (newer < REPEATS_WITHIN) & lately & (needed <= observe) & (still <= close)
            duration = np.where(new, needed, duration)
            # A repeat of one return is one of two as well: the shortest holds.
            done |= new
    return done, duration
