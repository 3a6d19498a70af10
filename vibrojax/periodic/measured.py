"""Measurement of lanes over one repeat of their periodic orbits."""

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
"""Accuracy of the steps over an orbit."""

DRIVEN_RETURNS = 4
"""Returns after which a driven part has settled on the motion that the orbit imposes."""

PerLane = Float[np.ndarray, " lanes"]


class Begun(NamedTuple):
    """Initial conditions of lanes at the section of their orbits; the last axis is that of the lanes.

    - `lanes`: indices in their chunk; `state` (states, lanes): of the return map.
    - `past` (8, states, lanes), `when` (8, lanes) [s]: the last returns, newest first; the newest is `state` at time 0.
    - `cycles`: returns of a repeat; `steps`: their approximate number in a repeat.
    - `length` [s] of a repeat; `first`, `second`, `last` [s]: times between returns, from the state on.
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
    """Return initial conditions at the first of the `states` of orbits; `times` [s] lead to the next states."""
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
    """Measures lanes of a sweep over their orbits, with the sweep's own programs."""

    def __init__(self, sweep: Sweep) -> None:
        self._scene = sweep.system
        self._driving = sweep.system.driving_part()
        exact = replace(sweep, run=replace(sweep.run, precision="float64", method="located"))
        self._engine = Engine(exact, Located(), recorder_for(sweep.system, sweep.run.keep_returns), workers())

    def __call__(self, first: int, end: int, begun: Begun) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Measure lanes of the chunk from `first` to before `end`, see `of`."""
        return self.of(self._engine.given(first, end), begun)

    def of(
        self, given: Given, begun: Begun, steps: Accuracy = ORBIT_ACCURACY
    ) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Return the features over one repeat, and which lanes had the expected number of returns.

        **Arguments:** `given`: parameters and starts of the chunk; `begun`: initial conditions of some of its lanes.
        """
        lanes, scene = begun.lanes, self._scene
        known = dict(zip(self._driving.return_states, begun.state, strict=True))
        zero = np.zeros(len(lanes))
        state = tuple(np.ascontiguousarray(known.get(name, zero)) for name in scene.state_names)
        # The observation ends between two returns, so that their number does not depend on rounding.
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
        # The observation is too short to show a repeat, so impacts are per return and means over all of it.
        number = features[counted] == begun.cycles + (counted == "returns")
        return features, features["finished"] & features["finite"] & number
