"""Recognition of lanes that converge to a stable periodic orbit, from their last section crossings.

Scaled distances are in units of the states' scales: half the peak-to-peak range of a
position, and for its velocity half that range times 2 pi/period.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.lanes.inputs import Index
from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.repeats import SETTLED_WITHIN
from vibrojax.measures.section import Settling
from vibrojax.periodic.newton import PeriodicOrbits, PerLane, States

NEAR_ORBIT = SETTLED_WITHIN / 2
"""Scaled distance within which the last section crossings must repeat."""

LINEAR_MISFIT = 0.25
"""Largest error of the linearised map within its range of validity, relative to the distance from the orbit."""

STEP_NOISE = 30.0
"""Bound of the numerical noise in section crossings, as a multiple of the tolerance of the step-size control."""

LEFT_OF_ERROR, LEFT_OF_LABELS = 0.3, 1e-4
"""Largest scaled distance from the orbit during the observation. The first bound is relative to the error tolerance;
the second bound ensures equal labels."""

MAX_CONTRACTION = 0.5
"""Largest norm of the derivative over the remaining periods. It ensures that a lane reaches the orbit because of the
multipliers, not by chance."""

DISTINCT_STATES = 2e-3
"""Scaled distance up to which two states of an orbit might be equal."""

EXTRAPOLATION_MAX_ORDER = 3
"""Largest order of the linear recurrence used to extrapolate section crossings; the usual drill has three
multipliers."""

CHECKED_REPEATS = 8
"""Number of predicted periods whose successive differences must stay within the tolerance of labels."""

Away = Float[np.ndarray, "returns states lanes"]


class Approach(NamedTuple):
    """Lanes whose last section crossings converge to an orbit.

    `lanes`: their indices; `scale`: NaN for states that labels do not compare; `returns`: states at the section
    crossings, newest first; `limit`: extrapolated limits of the crossings in the last period, newest last.
    """

    lanes: Index
    scale: Float[np.ndarray, "lanes states"]
    returns: Away
    limit: States

    def of(self, lanes: Index, since: int = 0) -> "Approach":
        """Return a subset of the lanes, by index, without their `since` newest section crossings."""
        return Approach(self.lanes[lanes], self.scale[lanes], self.returns[since:, :, lanes], self.limit[lanes])


def approaches_repeat(
    returns: Settling, repeat: int, now: PerLane, observe: float, tolerance: float
) -> Bool[np.ndarray, " lanes"]:
    """Return a mask of lanes that seem to converge to an orbit with `repeat` section crossings per period.

    **Arguments:** `returns`: recorded crossings, see [vibrojax.measures.section][]; `now` [s]: current time of each
    lane; `observe` [s]: duration of the observation, which must cover the crossings that labels need; `tolerance`:
    relative tolerance of the step-size control.
    """
    scale = np.stack(returns.passed.scales)
    states, times = returns.seen.states[:, : len(scale)], returns.seen.times
    near = np.max(np.abs(states[0] - states[repeat]) / scale, axis=0) < NEAR_ORBIT
    for shorter in range(1, repeat):
        now_apart = np.max(np.abs(states[0] - states[shorter]) / scale, axis=0)
        # A lane that approaches an orbit with a shorter period converges to that orbit.
        before = np.max(np.abs(states[-1 - shorter] - states[-1]) / scale, axis=0)
        near &= now_apart > np.maximum(DISTINCT_STATES, before / 2)
    lanes = np.flatnonzero(near)
    states, times, scale = states[..., lanes], times[:, lanes], scale[:, lanes]
    moved = np.max(np.abs(states[:-repeat] - states[repeat:]) / scale, axis=1)
    half = len(moved) // 2
    newer, older = moved[:half].max(axis=0), moved[-half:].max(axis=0)
    length = times[0] - times[repeat]
    enough = (max(FEWEST_RETURNS, 3 * repeat + 1) + 1.5) * length / repeat <= observe
    recent = now[lanes] - times[0] < 1.5 * np.max(times[:-1] - times[1:], axis=0)
    near[lanes] = (newer < NEAR_ORBIT) & ((newer < older) | (newer < STEP_NOISE * tolerance)) & enough & recent
    return near


def read_approach(returns: Settling, lanes: Index, repeat: int, tolerance: float) -> Approach:
    """Return the approach of `lanes` to orbits with `repeat` section crossings per period, with extrapolated limits."""
    scale = np.stack(returns.passed.scales)[:, lanes].astype(float)
    states = np.asarray(returns.seen.states)[..., lanes].astype(float)
    limit = [extrapolate(states[phase::repeat], scale, STEP_NOISE * tolerance) for phase in range(repeat)]
    unknown = np.full((states.shape[1] - len(scale), len(lanes)), np.nan)
    return Approach(lanes, np.concatenate([scale, unknown]).T, states, np.stack(limit[::-1]).transpose(2, 0, 1))


def extrapolate(
    series: Away, scale: Float[np.ndarray, "compared lanes"], noise: float
) -> Float[np.ndarray, "states lanes"]:
    """Return the limits of series of states that obey a linear recurrence; each series is ordered newest first.

    The limit is a weighted mean of the states, with the weights for which the same mean of the successive differences
    is minimal (reduced rank extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2). Only the first state
    variables, those with a `scale`, enter the differences.
    """
    order = min(EXTRAPOLATION_MAX_ORDER, len(series) - 2)
    differences = (series[:-1] - series[1:])[: order + 1, : len(scale)] / scale
    gram = np.einsum("isl,jsl->lij", differences, differences)
    # Regularise at the level of the noise, below which differences carry no information.
    gram += (1e-2 * noise**2 + 1e-14 * np.trace(gram, axis1=1, axis2=2))[:, None, None] * np.eye(order + 1)
    weights = np.linalg.solve(gram, np.ones((*gram.shape[:2], 1)))[..., 0]
    weights /= weights.sum(axis=1, keepdims=True)
    limit = np.einsum("li,isl->sl", weights, series[: order + 1])
    sound = np.max(np.abs(limit - series[0])[: len(scale)] / scale, axis=0) < 3 * NEAR_ORBIT
    return np.where(sound, limit, series[0])


def distance(near: Approach, orbit: PeriodicOrbits) -> PerLane:
    """Return the distance of each lane's last section crossings from its `orbit`, in units of the orbit's scales."""
    on_orbit = np.moveaxis(orbit.states[:, ::-1], 0, -1)  # newest first
    apart = np.abs(near.returns[: len(on_orbit)] - on_orbit) / orbit.scales.T
    return np.asarray(np.max(apart, axis=(0, 1)))


def will_reach(
    near: Approach, orbit: PeriodicOrbits, repeats: PerLane, tolerance: float, error: float
) -> Bool[np.ndarray, " lanes"]:
    """Return a mask of lanes in the linear range of their `orbit` that will be on the orbit after `repeats` periods."""
    scale, cycles = orbit.scales, orbit.states.shape[1]
    derivative = orbit.product * scale[:, None, :] / scale[:, :, None]
    on_orbit = np.moveaxis(orbit.states, 0, -1)
    away = np.moveaxis((near.returns[cycles - 1 :: cycles] - on_orbit[0]) / scale.T, -1, 0)
    noise = STEP_NOISE * tolerance
    # Only the first state of an orbit is propagated, so lanes must be closer to an orbit with several states.
    reached = distance(near, orbit) < (NEAR_ORBIT if cycles == 1 else NEAR_ORBIT / 10)
    linear = np.einsum("lij,lrj->lri", derivative, away[:, 1:])
    off, far = np.max(np.abs(away[:, :-1] - linear), axis=2), np.max(np.abs(away[:, 1:]), axis=2)
    reached &= np.all((off < LINEAR_MISFIT * far + noise)[:, : EXTRAPOLATION_MAX_ORDER + 1], axis=1)
    last = away[:, 0]
    for _ in range(CHECKED_REPEATS):
        following = np.einsum("lij,lj->li", derivative, last)
        reached &= np.max(np.abs(following - last), axis=1) < 0.8 * SETTLED_WITHIN
        last = following
    remaining, contraction = _propagate(derivative, away[:, 0], repeats)
    remaining = remaining + noise * contraction
    return reached & (contraction < MAX_CONTRACTION) & (remaining < min(LEFT_OF_ERROR * error, LEFT_OF_LABELS))


def _propagate(
    derivative: Float[np.ndarray, "lanes states states"], away: Float[np.ndarray, "lanes states"], repeats: PerLane
) -> tuple[PerLane, PerLane]:
    """Return the norm of `away` after the given number of periods, and a bound of the derivative's norm.

    The bound is the norm of the derivative over n periods, where n is the largest power of two up to `repeats`.
    """
    power, number = derivative, 1
    contraction = np.full(len(power), np.inf)
    while number <= np.max(repeats, initial=0):
        size = np.max(np.sum(np.abs(power), axis=2), axis=1)
        contraction = np.where(number <= repeats, size, contraction)
        odd = (repeats // number) % 2 == 1
        away = np.where(odd[:, None], np.einsum("lij,lj->li", power, away), away)
        # Clipping keeps powers that have diverged finite, so that no NaN appears.
        power = np.clip(power @ power, -1e100, 1e100)
        number *= 2
    return np.max(np.abs(away), axis=1), contraction
