"""Lanes that end before their time because a stable orbit is where they will be.

A lane whose last returns are near a stable periodic orbit, and come closer to it as the orbit's multipliers say, is
within its linear reach: the rest of the way follows from the derivative of the return map. Where that way is over
before the lane is to be observed, what would be observed is the orbit, and it is measured instead.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from vibrojax.periodic.approach import SPLIT, Approach, approach, approaching, comes_closer
from vibrojax.periodic.measured import Measuring, begun
from vibrojax.periodic.newton import Found, orbits, repeats_after
from vibrojax.periodic.segments import STEPS, Segments
from vibrojax.stepping import Located
from vibrojax.sweep.engine.batch import Batch, Features, Index, PerLane
from vibrojax.sweep.engine.chunks import certified
from vibrojax.sweep.engine.underway import Ended
from vibrojax.sweep.input.definition import Sweep

REPEATS = (1, 2, 3)
"""Returns of a repeat up to which the last eight show it several times over."""

FAR = 2e-2
"""Distance over the scales that Newton's method may go from where the last returns lead."""

MOST_ITERATIONS = 3

CLOSE = 1e-6
"""Residual after which one more step, by the derivative there is, leaves nothing that counts."""

MARGIN = 1e-4
"""Least grazing margin: Newton's steps fall as their squares over it."""

FINER = 1e-2
"""Tolerance of the return map, in that of the sweep's steps."""

MEASURED = 1e-7
"""Tolerance at which orbits are measured, at most: at a coarser one most steps end at events or are the longest, and
the difference from another run does not tell of the error."""

SHARE, LEAST = 0.25, 0.04
"""Part of the two runs' difference that the error is taken for, and that of the tolerance which it has at least. Only
one repeat adds to it, because the orbit that lanes begin on is nearly exact."""


class OnOrbits(NamedTuple):
    """Lanes that will be on orbits: which, by index; their orbits, and what is measured over these at two accuracies,
    certified: all features but those that are the lane's own."""

    lanes: Index
    orbits: Found
    features: Features


class EarlyEnds:
    """Finds lanes of a sweep that are where they will be."""

    def __init__(self, sweep: Sweep) -> None:
        self._run, self._accuracy = sweep.run, sweep.run.accuracy(sweep.system)
        self._scene = sweep.system.driving_part()
        finer = max(FINER * self._accuracy.tolerance, STEPS.tolerance)
        self._map = Segments(self._scene, steps=STEPS._replace(tolerance=finer))
        self._measure = Measuring(sweep)
        self._measured_at = self._accuracy._replace(tolerance=min(self._accuracy.tolerance, MEASURED))

    def near(self, batch: Batch) -> Bool[np.ndarray, " lanes"]:
        """Which lanes may be within the reach of an orbit, so that they are to be looked at."""
        return np.any([self._approaching(batch, repeat) for repeat in REPEATS], axis=0)

    def of_chunk(self) -> "EarlyEnds":
        """Itself: nothing is known of other lanes."""
        return self

    def __call__(self, batch: Batch) -> list[Ended]:
        """Those lanes of the `batch` that need no more steps, by their index in it."""
        return self.among(batch, self._each)

    def among(self, batch: Batch, find: Callable[[Approach, Batch], list[Ended]]) -> list[Ended]:
        """What `find(approach, batch)` finds of those lanes of the `batch` that approach repeats, the shortest first;
        by their index in it."""
        assert batch.underway is not None
        free = np.ones(len(batch.begin), bool)
        found = []
        with np.errstate(all="ignore"):
            for repeat in REPEATS:
                lanes = np.flatnonzero(free & self._approaching(batch, repeat))
                if len(lanes):
                    near = approach(batch.underway.carry, lanes, repeat, self._accuracy.tolerance)
                    for ended in find(near, batch.of(lanes)):
                        free[ended.lanes] = False
                        found.append(ended)
        return found

    def _each(self, near: Approach, batch: Batch) -> list[Ended]:
        """Each lane on an orbit of its own."""
        found = self.on_orbits(near, batch)
        if not len(found.lanes):
            return []
        return [self.ended(near.lanes[found.lanes], found.features, batch.of(found.lanes))]

    def _approaching(self, batch: Batch, repeat: int) -> Bool[np.ndarray, " lanes"]:
        assert batch.underway is not None
        now = np.asarray(batch.underway.lane.clock.high)
        with np.errstate(all="ignore"):
            return approaching(batch.underway.carry, repeat, now, self._run.observe, self._accuracy.tolerance)

    def on_orbits(self, near: Approach, batch: Batch) -> OnOrbits:
        """Of lanes that approach orbits, and their `batch`, those that will be there; by Newton's method for each."""
        assert batch.underway is not None
        given = {name: np.asarray(batch.given.parameters[name], float) for name in self._scene.parameters()}
        orbit = orbits(
            near.limit,
            near.scale,
            np.full(len(near.lanes), FAR),
            self._map.of(given),
            enough=CLOSE,
            most=MOST_ITERATIONS,
        )
        step = np.max(np.abs(orbit.step) / orbit.scales[:, None], axis=(1, 2))
        orbit = orbit._replace(states=orbit.states + orbit.step)
        sure = (step < 10 * CLOSE) & (orbit.margin > MARGIN) & (repeats_after(orbit, SPLIT) == orbit.states.shape[1])
        lanes = np.flatnonzero(sure & self.will_be_there(near, orbit, batch))
        orbit = orbit.of(lanes)
        return self._measured(lanes, orbit, step[lanes] ** 2 / orbit.margin, batch.of(lanes))

    def will_be_there(self, near: Approach, orbit: Found, batch: Batch) -> Bool[np.ndarray, " lanes"]:
        """Which lanes are within the linear reach of an `orbit` each, and will be on it when they are observed."""
        assert batch.underway is not None
        repeats = np.floor((self._run.settle - batch.underway.lane.clock.high) / orbit.times.sum(axis=1))
        return comes_closer(near, orbit, repeats, self._accuracy.tolerance, self._run.error)

    def ended(self, lanes: Index, features: Features, batch: Batch) -> Ended:
        """The `lanes`, whose `batch` this is, with what was measured over their orbits, and what is their own."""
        assert batch.underway is not None
        settled, precision = np.asarray(batch.underway.carry.seen.settled), np.dtype(self._run.precision)
        repeat = features["cycles"].astype(int) - 1
        own = {
            "settling_time": settled[repeat, np.arange(len(lanes))].astype(precision),
            "steps": features["steps"] + batch.underway.steps,
        }
        return Ended(lanes, features | own)

    def _measured(self, lanes: Index, orbit: Found, still: PerLane, batch: Batch) -> OnOrbits:
        """The `lanes`, measured over their orbits at the accuracy of the sweep, and at that of the check run."""
        cycles, precision = orbit.states.shape[1], np.dtype(self._run.precision)
        if not len(lanes):
            return OnOrbits(lanes, orbit, {})
        one = begun(np.arange(len(lanes)), orbit.states, orbit.times, orbit.steps)
        right, runs = np.ones(len(lanes), bool), []
        for accuracy in (self._measured_at, Located().coarser(self._measured_at)):
            features, whole = self._measure.of(batch.given, one, accuracy)
            right &= whole
            if "impacts" in features:
                features["impacts"] = np.round(features["impacts"] * cycles)
                right &= features["impacts"] == orbit.impacts
            # As if it had been observed for as long as the others.
            features["returns"] = np.floor(self._run.observe / features["period"])
            features["cycles"] = np.full(len(lanes), float(cycles))
            features["trend"] = np.zeros(len(lanes))
            # In the precision of lanes that are stepped to their end, since they are stored beside each other.
            runs.append({name: x.astype(precision) if x.dtype.kind == "f" else x for name, x in features.items()})
        fine, check = runs
        least = 4 * float(np.finfo(precision).eps) + LEAST * self._measured_at.tolerance
        found = certified(fine | {"drift_estimate": still}, check, SHARE, least)
        some = np.flatnonzero(right)
        return OnOrbits(lanes[some], orbit.of(some), {name: x[some] for name, x in found.items()})
