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
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd

from vibrojax.lanes.certificate import certified
from vibrojax.lanes.engine import Batch
from vibrojax.lanes.inputs import Features, Index, Mask, PerLane
from vibrojax.lanes.settled import Ended
from vibrojax.measures import since_start
from vibrojax.periodic.approach import (
    DISTINCT_STATES,
    NEAR_ORBIT,
    Approach,
    approaches_repeat,
    distance,
    read_approach,
    will_reach,
)
from vibrojax.periodic.margin import Measuring, begun
from vibrojax.periodic.newton import PeriodicOrbits, orbits, repeats_after
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


class OnOrbits(NamedTuple):
    """Lanes (by index) that will be on orbits, with these orbits and their certified features.

    Features of the transient, such as the settling time, are not included. In a pool of known orbits, `lanes` holds the
    number of each orbit's parameter point instead.
    """

    lanes: Index
    orbits: PeriodicOrbits
    features: Features

    def of(self, subset: Index) -> "OnOrbits":
        """Return a subset, by index."""
        return OnOrbits(*jax.tree.map(lambda x: x[subset], tuple(self)))

    def joined(self, other: "OnOrbits") -> "OnOrbits":
        """Return these orbits and the others, which have the same number of section crossings per period."""
        return OnOrbits(*jax.tree.map(lambda *x: np.concatenate(x), tuple(self), tuple(other)))


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
        assert batch.underway is not None
        free = np.ones(len(batch.begin), bool)
        ended = []
        with np.errstate(all="ignore"):
            for repeat in EARLY_REPEATS:
                lanes = np.flatnonzero(free & self._approaches(batch, repeat))
                if len(lanes):
                    near = read_approach(batch.underway.carry, lanes, repeat, self._accuracy.tolerance)
                    for orbits in self._find(near, batch.of(lanes)):
                        if len(orbits.lanes):
                            lanes = near.lanes[orbits.lanes]
                            free[lanes] = False
                            ended.append(self._ended(orbits.features, batch.of(lanes)))
        return ended

    def _approaches(self, batch: Batch, repeat: int) -> Mask:
        assert batch.underway is not None
        now = np.asarray(batch.underway.lane.clock.high)
        with np.errstate(all="ignore"):
            return approaches_repeat(batch.underway.carry, repeat, now, self._run.observe, self._accuracy.tolerance)

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
        known, remaining = self._compare(near, batch, points, 0, np.arange(len(points)))
        per_point = 1
        while len(remaining):
            pool = self._pools.get(repeat)
            first = rank_in_point(points[remaining]) < per_point
            solved, remaining = remaining[first], remaining[~first]
            orbits = self.on_orbits(near.of(solved), batch.of(solved))
            orbits = orbits._replace(lanes=solved[orbits.lanes])
            if len(orbits.lanes):
                new = orbits._replace(lanes=points[orbits.lanes])
                self._pools[repeat] = new if pool is None else pool.joined(new)
            more, remaining = self._compare(near, batch, points, 0 if pool is None else len(pool.lanes), remaining)
            known += [orbits, *more]
            per_point *= 2
        return known

    def _compare(
        self, near: Approach, batch: Batch, points: Index, since: int, remaining: Index
    ) -> tuple[list[OnOrbits], Index]:
        """Return the `remaining` lanes that will be on known orbits, and the lanes near none of these orbits.

        Only orbits with numbers from `since` on are considered.
        """
        repeat = near.limit.shape[1]
        pool, matches = self._pools.get(repeat), []
        if pool is None:
            return [], remaining
        for number in candidates(pool.lanes, points, since):
            # The newest section crossing of a lane may correspond to any state of the orbit.
            for late in range(repeat):
                lanes = remaining[number[remaining] >= 0]
                if not len(lanes):
                    break
                orbit, approach = pool.orbits.of(number[lanes]), near.of(lanes, late)
                there = self._will_be_there(approach, orbit, batch.of(lanes))
                matches.append(pool.of(number[lanes[there]])._replace(lanes=lanes[there]))
                # For a lane that is near the orbit but not yet on it, Newton's method would find the same orbit.
                remaining = remaining[~np.isin(remaining, lanes[there | (distance(approach, orbit) < NEAR_ORBIT)])]
        return matches, remaining

    def on_orbits(self, near: Approach, batch: Batch) -> OnOrbits:
        """Return the lanes of the `batch` that will be on orbits; Newton's method starts from the limits in `near`."""
        parameters = {name: np.asarray(batch.given.parameters[name], float) for name in self._scene.parameters()}
        reach = np.full(len(near.lanes), NEWTON_REACH)
        orbit = orbits(near.limit, near.scale, reach, self._map.of(parameters), LAST_STEP, EARLY_MAX_ITERATIONS)
        step = np.max(np.abs(orbit.step) / orbit.scales[:, None], axis=(1, 2))
        orbit = orbit._replace(states=orbit.states + orbit.step)
        sure = (step < 10 * LAST_STEP) & (orbit.margin > MIN_MARGIN)
        sure &= repeats_after(orbit, DISTINCT_STATES) == orbit.states.shape[1]
        lanes = np.flatnonzero(sure & self._will_be_there(near, orbit, batch))
        orbit = orbit.of(lanes)
        return self._measured(lanes, orbit, step[lanes] ** 2 / orbit.margin, batch.of(lanes))

    def _will_be_there(self, near: Approach, orbit: PeriodicOrbits, batch: Batch) -> Mask:
        """Return a mask of lanes in the linear range of their `orbit` that will be on it when they are observed."""
        assert batch.underway is not None
        repeats = np.floor((self._run.settle - batch.underway.lane.clock.high) / orbit.times.sum(axis=1))
        return will_reach(near, orbit, repeats, self._accuracy.tolerance, self._run.error)

    def _measured(self, lanes: Index, orbit: PeriodicOrbits, still: PerLane, batch: Batch) -> OnOrbits:
        """Measure orbits at the accuracies of the sweep and of the check run; keep those that close after one period.

        `still`: estimated distance of the computed orbits from the exact orbits.
        """
        cycles, precision = orbit.states.shape[1], np.dtype(self._run.precision)
        if not len(lanes):
            return OnOrbits(lanes, orbit, {})
        begin = begun(np.arange(len(lanes)), orbit.states, orbit.times, orbit.steps)
        right, runs = np.ones(len(lanes), bool), []
        for accuracy in (self._measure_accuracy, Located().coarser(self._measure_accuracy)):
            features, whole = self._measure.of(batch.given, begin, accuracy)
            right &= whole
            if "impacts" in features:
                features["impacts"] = np.round(features["impacts"] * cycles)
                right &= features["impacts"] == orbit.impacts
            # The values that a full observation would give.
            features["returns"] = np.floor(self._run.observe / features["period"])
            features["cycles"] = np.full(len(lanes), float(cycles))
            features["trend"] = np.zeros(len(lanes))
            # The features are stored together with those of fully simulated lanes, hence in the same precision.
            runs.append({name: x.astype(precision) if x.dtype.kind == "f" else x for name, x in features.items()})
        fine, check = runs
        least = 4 * float(np.finfo(precision).eps) + MIN_ERROR_SHARE * self._measure_accuracy.tolerance
        features = certified(fine | {"drift_estimate": still}, check, ERROR_SHARE, least)
        return OnOrbits(lanes, orbit, features).of(np.flatnonzero(right))

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
