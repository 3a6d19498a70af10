"""Lanes that converge to a stable periodic orbit, recognised by their last returns and the orbit's multipliers."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.repeats import SETTLED_WITHIN, scales
from vibrojax.measures.section import Settling
from vibrojax.periodic.newton import PeriodicOrbits, States

NEAR_ORBIT = SETTLED_WITHIN / 2
"""Distance over the scales within which the last returns must repeat."""

LINEAR_MISFIT = 0.25
"""Largest error of the linearised map, relative to the distance from the orbit, within its linear reach."""

STEP_NOISE = 30.0
"""Bound of the noise in returns, in tolerances of the steps."""

LEFT_OF_ERROR, LEFT_OF_LABELS = 0.3, 1e-4
"""Largest distance from the orbit during the observation: relative to the accepted error, and for equal labels."""

MAX_CONTRACTION = 0.5
"""Largest norm of the derivative over the remaining repeats: the multipliers, not chance, bring a lane to the orbit."""

DISTINCT_STATES = 2e-3
"""Distance over the scales up to which two states of an orbit might be equal."""

EXTRAPOLATION_MAX_ORDER = 3
"""Order of the linear recurrence that returns are extrapolated by: the usual drill has three multipliers."""

CHECKED_REPEATS = 8
"""Coming repeats whose successive differences must stay within the label's tolerance."""

Index = Int[np.ndarray, " some"]
PerLane = Float[np.ndarray, " lanes"]
Away = Float[np.ndarray, "returns states lanes"]


class Approach(NamedTuple):
    """Lanes whose last returns converge to an orbit.

    - `lanes`: indices; `scale` (lanes, states): NaN for states that labels do not compare.
    - `returns` (returns, states, lanes): at the section, the newest first.
    - `limit` (lanes, repeat, states): extrapolated limits of the returns of the last repeat, the newest last.
    """

    lanes: Index
    scale: Float[np.ndarray, "lanes states"]
    returns: Away
    limit: States

    def of(self, lanes: Index, since: int = 0) -> "Approach":
        """Return the given lanes, without their `since` newest returns."""
        return Approach(self.lanes[lanes], self.scale[lanes], self.returns[since:, :, lanes], self.limit[lanes])


def approaches_repeat(
    returns: Settling, repeat: int, now: PerLane, observe: float, tolerance: float
) -> Bool[np.ndarray, " lanes"]:
    """Return which lanes seem to converge to an orbit of `repeat` returns.

    **Arguments:**

    - `returns`: recorded returns, see [vibrojax.measures.section][]; the last axis of its arrays is that of the lanes.
    - `now` [s]: current time of each lane; `observe` [s]: duration of the observation, which labels need.
    - `tolerance`: relative tolerance of the steps.
    """
    scale = np.stack(scales(returns.passed.amplitudes, returns.passed.since))
    states, times = returns.seen.states[:, : len(scale)], returns.seen.times
    near = np.max(np.abs(states[0] - states[repeat]) / scale, axis=0) < NEAR_ORBIT
    for shorter in range(1, repeat):
        now_apart = np.max(np.abs(states[0] - states[shorter]) / scale, axis=0)
        # A lane that comes closer to a shorter repeat converges to that.
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
    """Return the approach of `lanes` to orbits of `repeat` returns, with extrapolated limits."""
    scale = np.stack(scales(returns.passed.amplitudes, returns.passed.since))[:, lanes].astype(float)
    states = np.asarray(returns.seen.states)[..., lanes].astype(float)
    limit = [extrapolate(states[phase::repeat], scale, STEP_NOISE * tolerance) for phase in range(repeat)]
    unknown = np.full((states.shape[1] - len(scale), len(lanes)), np.nan)
    return Approach(lanes, np.concatenate([scale, unknown]).T, states, np.stack(limit[::-1]).transpose(2, 0, 1))


def extrapolate(
    series: Away, scale: Float[np.ndarray, "compared lanes"], noise: float
) -> Float[np.ndarray, "states lanes"]:
    """Return the limits of series of states, the newest first, that obey a linear recurrence.

    The limit is the weighted mean of the states for which the same mean of their differences is minimal (reduced rank
    extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2). Differences are taken of the first states,
    those with a `scale`.
    """
    order = min(EXTRAPOLATION_MAX_ORDER, len(series) - 2)
    differences = (series[:-1] - series[1:])[: order + 1, : len(scale)] / scale
    gram = np.einsum("isl,jsl->lij", differences, differences)
    # Regularise by the noise, below which differences carry no information.
    gram += (1e-2 * noise**2 + 1e-14 * np.trace(gram, axis1=1, axis2=2))[:, None, None] * np.eye(order + 1)
    weights = np.linalg.solve(gram, np.ones((*gram.shape[:2], 1)))[..., 0]
    weights /= weights.sum(axis=1, keepdims=True)
    limit = np.einsum("li,isl->sl", weights, series[: order + 1])
    sound = np.max(np.abs(limit - series[0])[: len(scale)] / scale, axis=0) < 3 * NEAR_ORBIT
    return np.where(sound, limit, series[0])


def distance(near: Approach, orbit: PeriodicOrbits) -> PerLane:
    """Return the distance of each lane's last returns from its `orbit`, over the orbit's scales."""
    on_orbit = np.moveaxis(orbit.states[:, ::-1], 0, -1)  # the newest first
    apart = np.abs(near.returns[: len(on_orbit)] - on_orbit) / orbit.scales.T
    return np.asarray(np.max(apart, axis=(0, 1)))


def will_reach(
    near: Approach, orbit: PeriodicOrbits, repeats: PerLane, tolerance: float, error: float
) -> Bool[np.ndarray, " lanes"]:
    """Return which lanes are within the linear reach of their `orbit` and on it after the given number of `repeats`.

    **Arguments:** `tolerance`: of the steps; `error`: accepted error; both relative.
    """
    scale, cycles = orbit.scales, orbit.states.shape[1]
    derivative = orbit.product * scale[:, None, :] / scale[:, :, None]
    on_orbit = np.moveaxis(orbit.states, 0, -1)
    away = np.moveaxis((near.returns[cycles - 1 :: cycles] - on_orbit[0]) / scale.T, -1, 0)
    noise = STEP_NOISE * tolerance
    # Only the first state of an orbit is propagated, so an orbit of several states must be closer.
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
    """Return the norm of `away` after the given number of repeats, and a bound of the derivative's norm.

    The bound is that after the largest power of two of repeats that is not above their number.
    """
    power, number = derivative, 1
    contraction = np.full(len(power), np.inf)
    while number <= np.max(repeats, initial=0):
        size = np.max(np.sum(np.abs(power), axis=2), axis=1)
        contraction = np.where(number <= repeats, size, contraction)
        odd = (repeats // number) % 2 == 1
        away = np.where(odd[:, None], np.einsum("lij,lj->li", power, away), away)
        # Clipped, so that what has vanished or diverged stays so without NaN.
        power = np.clip(power @ power, -1e100, 1e100)
        number *= 2
    return np.max(np.abs(away), axis=1), contraction
