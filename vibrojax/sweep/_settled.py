"""Lanes that have settled long before they are to be observed, told by their returns to the section."""

import numpy as np

from vibrojax.label import FEWEST_RETURNS
from vibrojax.measure.section import REPEATS_WITHIN

LONGEST_REPEAT = 3
"""Returns of a repeat up to which those that are kept show it several times over."""


def settled(returns: dict, now: float, end: float, observe: float, close: float) -> tuple:
    """Which lanes may be observed at once, for how long, and how far they still are from where they settle.

    A lane may where the differences of its repeats add up to next to nothing from now on: as the geometric series that
    they fall like, or, of a lane that creeps, as many of the last ones as there are repeats left until its `end`.

    **Arguments:**

    - `returns`: what has been seen of returns, see [vibrojax.measure.section][]: arrays whose last axis is lanes.
    - `now`, `end`, `observe` [s]: the time; that at which the lane would be done; and how long it would be observed.
    - `close`: the relative distance from where a lane settles at which it has.

    **Returns:** a mask, the time [s] in which a lane makes the returns that labels ask for, and its relative distance;
    each (lanes,).
    """
    states, times, passed = returns["states"], returns["times"], returns["passed"]
    bit, striker, since = (passed[name] for name in ("bit", "striker", "since"))
    lanes = times.shape[-1]
    found, lasts, away = np.zeros(lanes, bool), np.zeros(lanes), np.zeros(lanes)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.stack([bit, striker, striker * 2 * np.pi / since])
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
            new = ~found & (newer < REPEATS_WITHIN) & lately & (needed <= observe) & (still <= close)
            lasts, away = np.where(new, needed, lasts), np.where(new, still, away)
            # A repeat of one return is one of two as well: the first that is found holds.
            found |= new
    return found, lasts, away
