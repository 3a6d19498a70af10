"""Early stopping of lanes that will be on a stable orbit when they are observed.

A lane is in the linear range of a stable periodic orbit if its last section crossings converge to the orbit at the
rate given by the multipliers. The derivative of the return map then predicts the rest of the transient. If the
transient ends before the observation begins, the lane would be observed on the orbit. Then the orbit is measured
instead of the lane.

Of hundreds of initial conditions at a parameter point, most lead to one of a few orbits. Newton's method is then run
for a few lanes only. The other lanes are compared with the orbits found. Orbits are shared only within a chunk of
lanes, so that results depend on the sweep alone.
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from vibrojax.lanes.certificate import certified
from vibrojax.lanes.engine import Batch
from vibrojax.lanes.inputs import Features, Index, Mask, PerLane
from vibrojax.lanes.settled import Ended
from vibrojax.lazy import jax
from vibrojax.measures import since_start
from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.repeats import SETTLED_WITHIN
from vibrojax.measures.section import Settling
from vibrojax.periodic.measuring import Measuring
from vibrojax.periodic.orbits import Orbits, States
from vibrojax.periodic.return_map import STEPS, Segments
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import Located

EARLY_REPEATS = (1, 2, 3)
"""Section crossings per period of the orbits that are searched. The last eight crossings cover several periods of such
orbits."""

NEWTON_REACH = 2e-2
"""Largest scaled distance between an orbit and the extrapolated limit."""

EARLY_MAX_ITERATIONS = 3
"""Largest number of Newton iterations; extrapolated limits are close to the orbits."""

LAST_STEP = 1e-6
"""Residual at which the iteration stops. One more Newton step with the known derivative then leaves a negligible
error."""

MIN_MARGIN = 1e-4
"""Smallest accepted grazing margin. The error after a Newton step is about the squared step divided by the margin."""

MAP_TOLERANCE = 1e-2
"""Step tolerance of the return map, relative to the step tolerance of the sweep."""

MEASURE_MAX_TOLERANCE = 1e-7
"""Largest step tolerance with which orbits are measured. With coarser tolerances most steps end at events or have the
maximum length, so the difference between two runs does not show the error."""

ERROR_SHARE, MIN_ERROR_SHARE = 0.25, 0.04
"""Error estimate as a fraction of the difference between the two runs, and its lower bound as a fraction of the
tolerance. Only one period of the motion adds to the error, because the initial state is nearly exact."""

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

    Scaled distances are in units of the states' scales: half the peak-to-peak range of a position, and for its velocity
    half that range times 2 pi/period.

    - `lanes`: indices of the lanes; `scale`: NaN for states that labels do not compare.
    - `returns`: states at the section crossings, newest first; `time`: time until the observation begins [s].
    - `limit`: extrapolated limits of the crossings in the last period, newest last.
    """

    lanes: Index
    scale: Float[np.ndarray, "lanes states"]
    returns: Away
    limit: States
    time: PerLane

    def of(self, lanes: Index, since: int = 0) -> "Approach":
        """Return a subset of the lanes, by index, without their `since` newest section crossings."""
        lanes_, scale, limit, time = (x[lanes] for x in (self.lanes, self.scale, self.limit, self.time))
        return Approach(lanes_, scale, self.returns[since:, :, lanes], limit, time)

    def distance(self, orbit: Orbits) -> PerLane:
        """Return the distance of the last section crossings from the orbits, in units of their scales."""
        on_orbit = np.moveaxis(orbit.states[:, ::-1], 0, -1)  # newest first
        apart = np.abs(self.returns[: len(on_orbit)] - on_orbit) / orbit.scales.T
        return np.asarray(np.max(apart, axis=(0, 1)))


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


def will_reach(near: Approach, orbit: Orbits, tolerance: float, error: float) -> Bool[np.ndarray, " lanes"]:
    """Return a mask of lanes in the linear range of their `orbit` that will be on it when they are observed."""
    scale, cycles = orbit.scales, orbit.states.shape[1]
    derivative = orbit.product * scale[:, None, :] / scale[:, :, None]
    on_orbit = np.moveaxis(orbit.states, 0, -1)
    away = np.moveaxis((near.returns[cycles - 1 :: cycles] - on_orbit[0]) / scale.T, -1, 0)
    noise = STEP_NOISE * tolerance
    # Only the first state of an orbit is propagated, so lanes must be closer to an orbit with several states.
    reached = near.distance(orbit) < (NEAR_ORBIT if cycles == 1 else NEAR_ORBIT / 10)
    linear = np.einsum("lij,lrj->lri", derivative, away[:, 1:])
    off, far = np.max(np.abs(away[:, :-1] - linear), axis=2), np.max(np.abs(away[:, 1:]), axis=2)
    reached &= np.all((off < LINEAR_MISFIT * far + noise)[:, : EXTRAPOLATION_MAX_ORDER + 1], axis=1)
    last = away[:, 0]
    for _ in range(CHECKED_REPEATS):
        following = np.einsum("lij,lj->li", derivative, last)
        reached &= np.max(np.abs(following - last), axis=1) < 0.8 * SETTLED_WITHIN
        last = following
    repeats = np.floor(near.time / orbit.times.sum(axis=1))
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


class OnOrbits(NamedTuple):
    """Lanes that will be on orbits: the orbits, whose `lane` holds their indices, and the certified features.

    Features of the transient, such as the settling time, are not included. In a pool of known orbits, `lane` holds the
    number of each orbit's parameter point instead.
    """

    orbits: Orbits
    features: Features

    def of(self, subset: Index) -> "OnOrbits":
        """Return a subset, by index."""
        return OnOrbits(*jax.tree.map(lambda x: x[subset], tuple(self)))

    def at(self, lanes: Index) -> "OnOrbits":
        """Return the same orbits for other lanes or points."""
        return self._replace(orbits=replace(self.orbits, lane=lanes))


class EarlyEnds:
    """Rule that ends lanes that will be on a stable orbit when they are observed.

    Newton's method is run for every such lane, or, with `shared` orbits, for a few lanes of each parameter point.
    """

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...], shared: bool = False) -> None:
        self.shared = shared
        self._run, self._accuracy = run, run.accuracy(scene)
        self._scene = scene.driving_part()
        finer = max(MAP_TOLERANCE * self._accuracy.tolerance, STEPS.tolerance)
        self._map = Segments(self._scene, steps=STEPS._replace(tolerance=finer))
        self._measure = Measuring(scene, run, start_names)
        tolerance = min(self._accuracy.tolerance, MEASURE_MAX_TOLERANCE)
        self._measure_accuracy = self._accuracy._replace(tolerance=tolerance)
        self._bounds = self._accuracy.tolerance, run.error
        self._pools: dict[int, OnOrbits] = {}  # known orbits; keys: section crossings per period
        self._numbers: dict[bytes, int] = {}  # numbers of points; keys: their parameter values

    def for_chunk(self) -> "EarlyEnds":
        """Return a copy without known orbits."""
        chunk = copy(self)
        chunk._pools, chunk._numbers = {}, {}
        return chunk

    def near(self, batch: Batch) -> Mask:
        """Return a mask of the lanes that seem to converge to an orbit: only these are passed to Newton's method."""
        return np.any([self._approaches(batch, repeat) for repeat in EARLY_REPEATS], axis=0)

    def ended(self, batch: Batch) -> list[Ended]:
        """Return the lanes of the `batch` that can stop early; the shortest periods are tried first."""
        free = np.ones(len(batch.begin), bool)
        ended = []
        with np.errstate(all="ignore"):
            for repeat in EARLY_REPEATS:
                lanes = np.flatnonzero(free & self._approaches(batch, repeat))
                if not len(lanes):
                    continue
                for group in self._find(self._read(batch, lanes, repeat), batch.of(lanes)):
                    if len(group.orbits):
                        own = lanes[group.orbits.lane]
                        free[own] = False
                        ended.append(self._ended(group.features, batch.of(own)))
        return ended

    def _approaches(self, batch: Batch, repeat: int) -> Mask:
        assert batch.underway is not None
        now = np.asarray(batch.underway.lane.clock.high)
        with np.errstate(all="ignore"):
            return approaches_repeat(batch.underway.carry, repeat, now, self._run.observe, self._accuracy.tolerance)

    def _read(self, batch: Batch, lanes: Index, repeat: int) -> Approach:
        """Return the approach of some `lanes` to orbits with `repeat` section crossings per period."""
        assert batch.underway is not None
        carry, noise = batch.underway.carry, STEP_NOISE * self._accuracy.tolerance
        scale = np.stack(carry.passed.scales)[:, lanes].astype(float)
        states = np.asarray(carry.seen.states)[..., lanes].astype(float)
        limit = [extrapolate(states[phase::repeat], scale, noise) for phase in range(repeat)]
        unknown = np.full((states.shape[1] - len(scale), len(lanes)), np.nan)
        limits, time = np.stack(limit[::-1]).transpose(2, 0, 1), self._run.settle - batch.underway.lane.clock.high
        return Approach(lanes, np.concatenate([scale, unknown]).T, states, limits, np.asarray(time)[lanes])

    def _find(self, near: Approach, batch: Batch) -> list[OnOrbits]:
        """Compare lanes with known orbits, then alternate between Newton's method for a few lanes and new comparisons.

        Newton's method is run for one lane of each point at first, then for two, four, and so on. If orbits are not
        shared, there are no known orbits, and the method is run for all lanes.
        """
        if not self.shared:
            return [self.on_orbits(near, batch)]
        repeat = near.limit.shape[1]
        values = np.stack([np.asarray(x, float) for x in batch.given.parameters.values()], axis=1)
        points = np.array([self._numbers.setdefault(row.tobytes(), len(self._numbers)) for row in values], int)
        known, remaining = self._compare(near, points, 0, np.arange(len(points)))
        per_point = 1
        while len(remaining):
            pool = self._pools.get(repeat)
            first = rank_in_point(points[remaining]) < per_point
            solved, remaining = remaining[first], remaining[~first]
            group = self.on_orbits(near.of(solved), batch.of(solved))
            lanes = solved[group.orbits.lane]
            if len(lanes):
                parts = [] if pool is None else [pool]
                self._pools[repeat] = jax.tree.map(lambda *x: np.concatenate(x), *parts, group.at(points[lanes]))
            more, remaining = self._compare(near, points, 0 if pool is None else len(pool.orbits), remaining)
            known += [group.at(lanes), *more]
            per_point *= 2
        return known

    def _compare(self, near: Approach, points: Index, since: int, remaining: Index) -> tuple[list[OnOrbits], Index]:
        """Return the `remaining` lanes that will be on known orbits, and the lanes near none of these orbits.

        Only orbits with numbers from `since` on are considered.
        """
        repeat = near.limit.shape[1]
        pool, matches = self._pools.get(repeat), []
        if pool is None:
            return [], remaining
        for number in candidates(pool.orbits.lane, points, since):
            # The newest section crossing of a lane may correspond to any state of the orbit.
            for late in range(repeat):
                lanes = remaining[number[remaining] >= 0]
                if not len(lanes):
                    break
                orbit, approach = pool.orbits.of(number[lanes]), near.of(lanes, late)
                there = will_reach(approach, orbit, *self._bounds)
                matches.append(pool.of(number[lanes[there]]).at(lanes[there]))
                # For a lane that is near the orbit but not yet on it, Newton's method would find the same orbit.
                remaining = remaining[~np.isin(remaining, lanes[there | (approach.distance(orbit) < NEAR_ORBIT)])]
        return matches, remaining

    def on_orbits(self, near: Approach, batch: Batch) -> OnOrbits:
        """Return the lanes of the `batch` that will be on orbits; Newton's method starts from the limits in `near`.

        Orbits are measured at the accuracies of the sweep and of the check run, and must close after one period.
        """
        parameters = {name: np.asarray(batch.given.parameters[name], float) for name in self._scene.parameters()}
        guess = near.limit, near.scale, NEWTON_REACH
        orbit = Orbits.find(self._scene, parameters, *guess, self._map, LAST_STEP, EARLY_MAX_ITERATIONS)
        step = np.max(np.abs(orbit.step) / orbit.scales[:, None], axis=(1, 2))
        orbit = orbit.refined(np.ones(len(orbit), bool))
        cycles, precision = orbit.states.shape[1], np.dtype(self._run.precision)
        sure = (step < 10 * LAST_STEP) & (orbit.margin > MIN_MARGIN)
        sure &= orbit.minimal_cycles(DISTINCT_STATES) == cycles
        lanes = np.flatnonzero(sure & will_reach(near, orbit, *self._bounds))
        orbit = replace(orbit.of(lanes), lane=lanes)
        if not len(lanes):
            return OnOrbits(orbit, {})
        right, runs = np.ones(len(orbit), bool), []
        for accuracy in (self._measure_accuracy, Located().coarser(self._measure_accuracy)):
            features, whole = orbit.measured(self._measure, batch.given, accuracy)
            right &= whole
            # The values that a full observation would give.
            features["returns"] = np.floor(self._run.observe / features["period"])
            features |= {"cycles": np.full(len(orbit), float(cycles)), "trend": np.zeros(len(orbit))}
            # The features are stored together with those of fully simulated lanes, hence in the same precision.
            runs.append({name: x.astype(precision) if x.dtype.kind == "f" else x for name, x in features.items()})
        fine, check = runs
        fine["drift_estimate"] = step[lanes] ** 2 / orbit.margin  # distance from the exact orbit
        least = 4 * float(np.finfo(precision).eps) + MIN_ERROR_SHARE * self._measure_accuracy.tolerance
        return OnOrbits(orbit, certified(fine, check, ERROR_SHARE, least)).of(np.flatnonzero(right))

    def _ended(self, features: Features, batch: Batch) -> Ended:
        """Return the lanes of the `batch` with the `features` of their orbits, and their own times and steps."""
        assert batch.underway is not None
        settled, precision = np.asarray(batch.underway.carry.seen.settled), np.dtype(self._run.precision)
        repeat = features["cycles"].astype(int) - 1
        own = {
            "settling_time": settled[repeat, np.arange(len(repeat))].astype(precision),
            "steps": features["steps"] + batch.underway.steps,
        }
        ranges = tuple((np.asarray(low), np.asarray(high)) for low, high in batch.underway.carry.seen.since_start)
        own |= since_start.features(self._scene, None, features, ranges, np)
        return Ended(batch.lanes, features | own)


def candidates(known: Index, points: Index, since: int) -> Iterator[Index]:
    """Yield the number of one known orbit for each of `points`, until every orbit from `since` on has been yielded.

    The number is -1 for a point without a further orbit. `known`: the point of each known orbit.
    """
    numbers = np.arange(since, len(known))
    rank = rank_in_point(known[since:])
    for nth in range(int(rank.max(initial=-1)) + 1):
        of_point = np.full(max(known.max(), points.max(initial=0)) + 1, -1)
        of_point[known[numbers[rank == nth]]] = numbers[rank == nth]
        yield of_point[points]


def rank_in_point(points: Index) -> Index:
    """Return, for each lane, the number of earlier lanes at the same point."""
    return pd.Series(points).groupby(points).cumcount().to_numpy()
