"""Measurement of the features of lanes over one period of their periodic orbits."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.compile.devices import workers
from vibrojax.measures import recorder_for
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Located
from vibrojax.sweep.engine.batch import Batch, Engine, Features, Index
from vibrojax.sweep.engine.programs import Given
from vibrojax.sweep.input.definition import Sweep

ORBIT_ACCURACY = Accuracy(tolerance=1e-10, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps with which orbits are measured."""

DRIVEN_RETURNS = 4
"""Section crossings after which a driven part has settled on the motion that the orbit imposes."""

PerLane = Float[np.ndarray, " lanes"]


class Begun(NamedTuple):
    """Initial conditions of lanes on their orbits, at the section; the last axis of all arrays is the lane.

    - `lanes`: indices in their chunk; `state` (states, lanes): state of the return map.
    - `past` (8, states, lanes), `when` (8, lanes) [s]: states and times of the last section crossings, newest first.
      The newest crossing is `state` at time 0.
    - `cycles`: number of section crossings per period; `steps`: approximate number of steps per period.
    - `length`: duration of one period [s].
    - `first`, `second`, `last`: durations between crossings [s], for the first, second and last segment from `state`.
    """

    lanes: Index
    state: Float[np.ndarray, "states lanes"]
    past: Float[np.ndarray, "8 states lanes"]
    when: Float[np.ndarray, "8 lanes"]
    cycles: Int[np.ndarray, " lanes"]
    steps: PerLane
    length: PerLane
    first: PerLane
    second: PerLane
    last: PerLane


def begun(
    lanes: Index,
    states: Float[np.ndarray, "lanes cycles states"],
    times: Float[np.ndarray, "lanes cycles"],
    steps: PerLane,
) -> Begun:
    """Return initial conditions at the first of the `states` of each orbit; `times`: time to the next state [s]."""
    cycles, length = states.shape[1], times.sum(axis=1)
    ago = np.concatenate([np.zeros((len(lanes), 1)), np.cumsum(times[:, ::-1], axis=1)], axis=1)
    when = [-(ago[:, k % cycles] + (k // cycles) * length) for k in range(MOST_CYCLES)]
    past = np.moveaxis(states[:, -np.arange(MOST_CYCLES) % cycles], 0, -1)
    between = times[:, 0], times[:, 1 % cycles], times[:, -1]
    return Begun(lanes, states[:, 0].T, past, np.stack(when), np.full(len(lanes), cycles), steps, length, *between)


def joined(parts: list[Begun]) -> Begun:
    """Concatenate the lanes of all `parts`."""
    return Begun(*(np.concatenate(fields, axis=-1) for fields in zip(*parts, strict=True)))


class Measuring:
    """Measurement of a sweep's lanes on their orbits, with the compiled programs of the sweep."""

    def __init__(self, sweep: Sweep) -> None:
        self._scene = sweep.system
        self._driving = sweep.system.driving_part()
        exact = replace(sweep, run=replace(sweep.run, precision="float64", method="located"))
        self._engine = Engine(exact, Located(), recorder_for(sweep.system, sweep.run.keep_returns), workers())

    def __call__(self, first: int, end: int, begun: Begun) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Measure lanes of the chunk `first` (inclusive) to `end` (exclusive), see `of`."""
        return self.of(self._engine.given(first, end), begun)

    def of(
        self, given: Given, begun: Begun, steps: Accuracy = ORBIT_ACCURACY
    ) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Return the features over one period, and a mask of lanes with the expected number of section crossings.

        **Arguments:** `given`: parameters and initial conditions of the chunk; `begun`: initial conditions on the
        orbits, for some lanes of the chunk; `steps`: accuracy of the steps.
        """
        lanes, scene = begun.lanes, self._scene
        known = dict(zip(self._driving.return_states, begun.state, strict=True))
        zero = np.zeros(len(lanes))
        state = tuple(np.ascontiguousarray(known.get(name, zero)) for name in scene.state_names)
        # The observation ends between two section crossings, so that rounding errors do not affect their number.
        settle, duration, counted = zero, begun.length + begun.first + begun.second / 2, "returns"
        if self._driving.section is None:  # the pulse that begins at t = 0 counts
            duration, counted = begun.length + begun.first / 2, "pulses"
        if scene is not self._driving:
            settle = -(-DRIVEN_RETURNS // begun.cycles) * begun.length - begun.last / 2
            duration = begun.length + (begun.last + begun.first) / 2
        given = jax.tree.map(lambda x: np.take(x, lanes).astype(float if x.dtype.kind == "f" else x.dtype), given)
        batch = Batch(steps, given, settle, duration, None, begun.steps.astype(np.int32))
        batch = self._engine.on_orbit(batch, state, begun.past, begun.when, begun.length / begun.cycles)
        [features] = self._engine.observe(self._engine.settle([batch]) if np.any(settle) else [batch])
        # The observation is too short to detect a period, so `impacts` is per section crossing, and means are taken
        # over the complete observation.
        number = features[counted] == begun.cycles + (counted == "returns")
        return features, features["finished"] & features["finite"] & number
