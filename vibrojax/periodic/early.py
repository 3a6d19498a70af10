"""Early stopping of lanes that will be on a stable orbit when they are observed.

A lane is in the linear range of a stable periodic orbit if its last section crossings converge to the orbit at the
rate given by the multipliers. The derivative of the return map then predicts the rest of the transient. If the
transient ends before the observation begins, the lane would be observed on the orbit. Then the orbit is measured
instead of the lane.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from vibrojax.periodic.approach import DISTINCT_STATES, Approach, approaches_repeat, read_approach, will_reach
from vibrojax.periodic.margin import Measuring, begun
from vibrojax.periodic.newton import PeriodicOrbits, orbits, repeats_after
from vibrojax.periodic.return_map import STEPS, Segments
from vibrojax.stepping import Located
from vibrojax.sweep.engine.batch import Batch, Features, Index, PerLane
from vibrojax.sweep.engine.chunks import certified
from vibrojax.sweep.engine.underway import Ended
from vibrojax.sweep.input.definition import Sweep

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

    Features that depend on the lane's transient, such as the settling time, are not included.
    """

    lanes: Index
    orbits: PeriodicOrbits
    features: Features


class EarlyEnds:
    """Search for lanes of a sweep that can stop early; Newton's method is run for every such lane."""

    def __init__(self, sweep: Sweep) -> None:
        self._run, self._accuracy = sweep.run, sweep.run.accuracy(sweep.system)
        self._scene = sweep.system.driving_part()
        finer = max(MAP_TOLERANCE * self._accuracy.tolerance, STEPS.tolerance)
        self._map = Segments(self._scene, steps=STEPS._replace(tolerance=finer))
        self._measure = Measuring(sweep)
        tolerance = min(self._accuracy.tolerance, MEASURE_MAX_TOLERANCE)
        self._measure_accuracy = self._accuracy._replace(tolerance=tolerance)

    def of_chunk(self) -> "EarlyEnds":
        """Return this object, which keeps no data of a chunk."""
        return self

    def near(self, batch: Batch) -> Bool[np.ndarray, " lanes"]:
        """Return a mask of the lanes that seem to converge to an orbit: only these are passed to Newton's method."""
        return np.any([self._approaches(batch, repeat) for repeat in EARLY_REPEATS], axis=0)

    def __call__(self, batch: Batch) -> list[Ended]:
        """Return the lanes of the `batch` that can stop early, by index; the shortest periods are tried first."""
        assert batch.underway is not None
        free = np.ones(len(batch.begin), bool)
        ended = []
        with np.errstate(all="ignore"):
            for repeat in EARLY_REPEATS:
                lanes = np.flatnonzero(free & self._approaches(batch, repeat))
                if len(lanes):
                    near = read_approach(batch.underway.carry, lanes, repeat, self._accuracy.tolerance)
                    for part in self._find(near, batch.of(lanes)):
                        free[part.lanes] = False
                        ended.append(part)
        return ended

    def _find(self, near: Approach, batch: Batch) -> list[Ended]:
        result = self.on_orbits(near, batch)
        if not len(result.lanes):
            return []
        return [self.ended(near.lanes[result.lanes], result.features, batch.of(result.lanes))]

    def _approaches(self, batch: Batch, repeat: int) -> Bool[np.ndarray, " lanes"]:
        assert batch.underway is not None
        now = np.asarray(batch.underway.lane.clock.high)
        with np.errstate(all="ignore"):
            return approaches_repeat(batch.underway.carry, repeat, now, self._run.observe, self._accuracy.tolerance)

    def on_orbits(self, near: Approach, batch: Batch) -> OnOrbits:
        """Return the lanes of the `batch` that will be on orbits; Newton's method starts from the limits in `near`."""
        parameters = {name: np.asarray(batch.given.parameters[name], float) for name in self._scene.parameters()}
        reach = np.full(len(near.lanes), NEWTON_REACH)
        orbit = orbits(near.limit, near.scale, reach, self._map.of(parameters), LAST_STEP, EARLY_MAX_ITERATIONS)
        step = np.max(np.abs(orbit.step) / orbit.scales[:, None], axis=(1, 2))
        orbit = orbit._replace(states=orbit.states + orbit.step)
        sure = (step < 10 * LAST_STEP) & (orbit.margin > MIN_MARGIN)
        sure &= repeats_after(orbit, DISTINCT_STATES) == orbit.states.shape[1]
        lanes = np.flatnonzero(sure & self.will_be_there(near, orbit, batch))
        orbit = orbit.of(lanes)
        return self._measured(lanes, orbit, step[lanes] ** 2 / orbit.margin, batch.of(lanes))

    def will_be_there(self, near: Approach, orbit: PeriodicOrbits, batch: Batch) -> Bool[np.ndarray, " lanes"]:
        """Return a mask of lanes in the linear range of their `orbit` that will be on it when they are observed."""
        assert batch.underway is not None
        repeats = np.floor((self._run.settle - batch.underway.lane.clock.high) / orbit.times.sum(axis=1))
        return will_reach(near, orbit, repeats, self._accuracy.tolerance, self._run.error)

    def ended(self, lanes: Index, features: Features, batch: Batch) -> Ended:
        """Return the `lanes` of the `batch` with the `features` of their orbits and those of the lanes themselves."""
        assert batch.underway is not None
        settled, precision = np.asarray(batch.underway.carry.seen.settled), np.dtype(self._run.precision)
        repeat = features["cycles"].astype(int) - 1
        own = {
            "settling_time": settled[repeat, np.arange(len(lanes))].astype(precision),
            "steps": features["steps"] + batch.underway.steps,
        }
        return Ended(lanes, features | own)

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
        kept = np.flatnonzero(right)
        return OnOrbits(lanes[kept], orbit.of(kept), {name: x[kept] for name, x in features.items()})
