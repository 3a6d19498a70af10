"""Lanes that approach a stable periodic orbit, told by their last returns and by the orbit's multipliers."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.repeats import SETTLED_WITHIN, scales
from vibrojax.measures.section import Settling
from vibrojax.periodic.newton import Found, States

NEAR = SETTLED_WITHIN / 2
"""Distance over the scales within which the last returns must repeat."""

FOLLOWS = 0.25
"""Part of its distance from the orbit by which a return may be off where the derivative of the map leads."""

NOISE = 30.0
"""The same in tolerances of the steps."""

LEFT, LABELLED = 0.3, 1e-4
"""Part of the accepted error that a lane may still be away from its orbit when it would be observed; and the distance
by which no label differs."""

WEAKEST = 0.5
"""What is left by then of any distance, at most: it is the multipliers that bring a lane there, and no chance."""

SPLIT = 2e-3
"""States of an orbit that are no farther apart, over the scales, might count as one."""

HIGHEST_ORDER = 3
"""Of the recurrence by which returns are extrapolated."""

NEXT = 8
"""Repeats to come that are looked at one by one."""

Index = Int[np.ndarray, " some"]
PerLane = Float[np.ndarray, " lanes"]
Away = Float[np.ndarray, "returns states lanes"]


class Approach(NamedTuple):
    """Lanes whose last returns come closer to a repeat of so many.

    - `lanes`: by index; `scale` (lanes, states): NaN of states that labels do not compare.
    - `returns` (returns, states, lanes): at the section, the newest first.
    - `limit` (lanes, repeat, states): where those of the last repeat seem to lead, the newest last.
    """

    lanes: Index
    scale: Float[np.ndarray, "lanes states"]
    returns: Away
    limit: States

    def of(self, lanes: Index, since: int = 0) -> "Approach":
        """Some of the lanes, by index; their returns without the newest, as many as `since`."""
        return Approach(self.lanes[lanes], self.scale[lanes], self.returns[since:, :, lanes], self.limit[lanes])


def approaching(
    returns: Settling, repeat: int, now: PerLane, observe: float, tolerance: float
) -> Bool[np.ndarray, " lanes"]:
    """Which lanes seem to come closer to an orbit of `repeat` returns.

    **Arguments:**

    - `returns`: what has been seen of them, see [vibrojax.measures.section][]: arrays whose last axis is lanes.
    - `now` [s]: the time, of each lane.
    - `observe` [s]: the time that a lane is observed for, in which labels ask for so many returns.
    - `tolerance`: of the steps, relative.
    """
    scale = np.stack(scales(returns.passed.amplitudes, returns.passed.since))
    states, times = returns.seen.states[:, : len(scale)], returns.seen.times
    found = np.max(np.abs(states[0] - states[repeat]) / scale, axis=0) < NEAR
    for fewer in range(1, repeat):
        now_apart = np.max(np.abs(states[0] - states[fewer]) / scale, axis=0)
        # What comes closer to a shorter repeat is on its way there.
        before = np.max(np.abs(states[-1 - fewer] - states[-1]) / scale, axis=0)
        found &= now_apart > np.maximum(SPLIT, before / 2)
    some = np.flatnonzero(found)
    states, times, scale = states[..., some], times[:, some], scale[:, some]
    moved = np.max(np.abs(states[:-repeat] - states[repeat:]) / scale, axis=1)
    half = len(moved) // 2
    newer, older = moved[:half].max(axis=0), moved[-half:].max(axis=0)
    length = times[0] - times[repeat]
    enough = (max(FEWEST_RETURNS, 3 * repeat + 1) + 1.5) * length / repeat <= observe
    lately = now[some] - times[0] < 1.5 * np.max(times[:-1] - times[1:], axis=0)
    found[some] = (newer < NEAR) & ((newer < older) | (newer < NOISE * tolerance)) & enough & lately
    return found


def approach(returns: Settling, lanes: Index, repeat: int, tolerance: float) -> Approach:
    """Of `lanes` that seem to come closer to an orbit of `repeat` returns, by index: where these lead."""
    scale = np.stack(scales(returns.passed.amplitudes, returns.passed.since))[:, lanes].astype(float)
    states = np.asarray(returns.seen.states)[..., lanes].astype(float)
    limit = [_extrapolated(states[phase::repeat], scale, NOISE * tolerance) for phase in range(repeat)]
    unknown = np.full((states.shape[1] - len(scale), len(lanes)), np.nan)
    return Approach(lanes, np.concatenate([scale, unknown]).T, states, np.stack(limit[::-1]).transpose(2, 0, 1))


def _extrapolated(
    series: Away, scale: Float[np.ndarray, "compared lanes"], noise: float
) -> Float[np.ndarray, "states lanes"]:
    """Where a series of states leads, the newest first, if they obey a linear recurrence; the first have a `scale`.

    That weighted mean of the states for which the same mean of their differences is the least (reduced rank
    extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2).
    """
    order = min(HIGHEST_ORDER, len(series) - 2)
    differences = (series[:-1] - series[1:])[: order + 1, : len(scale)] / scale
    gram = np.einsum("isl,jsl->lij", differences, differences)
    # What is smaller than noise says nothing.
    gram += (1e-2 * noise**2 + 1e-14 * np.trace(gram, axis1=1, axis2=2))[:, None, None] * np.eye(order + 1)
    weights = np.linalg.solve(gram, np.ones((*gram.shape[:2], 1)))[..., 0]
    weights /= weights.sum(axis=1, keepdims=True)
    found = np.einsum("li,isl->sl", weights, series[: order + 1])
    sound = np.max(np.abs(found - series[0])[: len(scale)] / scale, axis=0) < 3 * NEAR
    return np.where(sound, found, series[0])


def distance(near: Approach, orbit: Found) -> PerLane:
    """How far the last returns of lanes are from an `orbit` each, over its scales."""
    on_orbit = np.moveaxis(orbit.states[:, ::-1], 0, -1)  # the newest first
    apart = np.abs(near.returns[: len(on_orbit)] - on_orbit) / orbit.scales.T
    return np.asarray(np.max(apart, axis=(0, 1)))


def comes_closer(
    near: Approach, orbit: Found, repeats: PerLane, tolerance: float, error: float
) -> Bool[np.ndarray, " lanes"]:
    """Which lanes are within the linear reach of their `orbit`, and will be on it after so many `repeats`.

    **Arguments:** `tolerance`: of the steps; `error`: what is accepted, both relative.
    """
    scale, cycles = orbit.scales, orbit.states.shape[1]
    derivative = orbit.product * scale[:, None, :] / scale[:, :, None]
    on_orbit = np.moveaxis(orbit.states, 0, -1)
    away = np.moveaxis((near.returns[cycles - 1 :: cycles] - on_orbit[0]) / scale.T, -1, 0)
    noise = NOISE * tolerance
    # Only the first of an orbit's states is followed, so that of several all must be close.
    found = distance(near, orbit) < (NEAR if cycles == 1 else NEAR / 10)
    led = np.einsum("lij,lrj->lri", derivative, away[:, 1:])
    off, far = np.max(np.abs(away[:, :-1] - led), axis=2), np.max(np.abs(away[:, 1:]), axis=2)
    found &= np.all((off < FOLLOWS * far + noise)[:, : HIGHEST_ORDER + 1], axis=1)
    last = away[:, 0]
    for _ in range(NEXT):
        then = np.einsum("lij,lj->li", derivative, last)
        found &= np.max(np.abs(then - last), axis=1) < 0.8 * SETTLED_WITHIN
        last = then
    left, weakest = _after(derivative, away[:, 0], repeats)
    return found & (weakest < WEAKEST) & (left + noise * weakest < min(LEFT * error, LABELLED))


def _after(
    derivative: Float[np.ndarray, "lanes states states"], away: Float[np.ndarray, "lanes states"], repeats: PerLane
) -> tuple[PerLane, PerLane]:
    """What is left of a distance after so many repeats, and of any, at most, after a power of two of them."""
    power, number = derivative, 1
    weakest = np.full(len(power), np.inf)
    while number <= np.max(repeats, initial=0):
        size = np.max(np.sum(np.abs(power), axis=2), axis=1)
        weakest = np.where(number <= repeats, size, weakest)
        this = (repeats // number) % 2 == 1
        away = np.where(this[:, None], np.einsum("lij,lj->li", power, away), away)
        # What has vanished or grown beyond all bounds stays there.
        power = np.clip(power @ power, -1e100, 1e100)
        number *= 2
    return np.max(np.abs(away), axis=1), weakest
