"""What is measured of a lane that repeats, over one repeat of its periodic orbit."""

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

STEPS = Accuracy(tolerance=1e-10, stride=LOCATED_STRIDE, step=np.inf)
"""Of the steps in which an orbit is measured."""

DRIVEN_RETURNS = 4
"""Returns that what is only driven has to come to the motion that the orbit drives."""

PerLane = Float[np.ndarray, " lanes"]


class Begun(NamedTuple):
    """Lanes at the section of their orbits; the last axis is lanes.

    - `lanes`: by index in their chunk; `state` (states, lanes): of the return map.
    - `past` (8, states, lanes), `when` (8, lanes) [s]: the last returns, the newest, which is `state` at 0, first.
    - `cycles`: returns of a repeat; `steps` of it, roughly.
    - `length` [s] of a repeat; `first`, `second`, `last` [s]: from the state to the next return, and so on.
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
    """Lanes at the first of the `states` of their orbits, from each of which the next is reached after `times` [s]."""
    cycles, length = states.shape[1], times.sum(axis=1)
    ago = np.concatenate([np.zeros((len(lanes), 1)), np.cumsum(times[:, ::-1], axis=1)], axis=1)
    when = [-(ago[:, k % cycles] + (k // cycles) * length) for k in range(MOST_CYCLES)]
    past = np.moveaxis(states[:, -np.arange(MOST_CYCLES) % cycles], 0, -1)
    between = times[:, 0], times[:, 1 % cycles], times[:, -1]
    return Begun(lanes, states[:, 0].T, past, np.stack(when), np.full(len(lanes), cycles), steps, length, *between)


def joined(parts: list[Begun]) -> Begun:
    """The lanes of all `parts`."""
    return Begun(*(np.concatenate(some, axis=-1) for some in zip(*parts, strict=True)))


class Measuring:
    """Measures lanes of a sweep over their orbits, by the sweep's own programs."""

    def __init__(self, sweep: Sweep) -> None:
        self._scene = sweep.system
        self._driving = sweep.system.driving_part()
        exact = replace(sweep, run=replace(sweep.run, precision="float64", method="located"))
        self._engine = Engine(exact, Located(), recorder_for(sweep.system, sweep.run.keep_returns), workers())

    def given(self, first: int, end: int) -> Given:
        """Parameters and starts of the lanes from `first` to before `end`."""
        return self._engine.given(first, end)

    def __call__(self, first: int, end: int, begun: Begun) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Features of lanes of the chunk from `first` to before `end`, and which of them went round as they should."""
        return self.of(self.given(first, end), begun)

    def of(self, given: Given, begun: Begun, steps: Accuracy = STEPS) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Features of some of the lanes that are `given`, and which of them went round as they should."""
        lanes, scene = begun.lanes, self._scene
        known = dict(zip(self._driving.return_states, begun.state, strict=True))
        zero = np.zeros(len(lanes))
        state = tuple(np.ascontiguousarray(known.get(name, zero)) for name in scene.state_names)
        # One repeat between returns, and to between two returns, so that it is clear how many are seen.
        settle, duration, seen = zero, begun.length + begun.first + begun.second / 2, "returns"
        if self._driving.section is None:  # the pulse that begins at t = 0 is one of them
            duration, seen = begun.length + begun.first / 2, "pulses"
        if scene is not self._driving:
            settle = -(-DRIVEN_RETURNS // begun.cycles) * begun.length - begun.last / 2
            duration = begun.length + (begun.last + begun.first) / 2
        given = jax.tree.map(lambda x: np.take(x, lanes).astype(float if x.dtype.kind == "f" else x.dtype), given)
        batch = Batch(steps, given, settle, duration, None, begun.steps.astype(np.int32))
        batch = self._engine.on_orbit(batch, state, begun.past, begun.when, begun.length / begun.cycles)
        [features] = self._engine.observe(self._engine.settle([batch]) if np.any(settle) else [batch])
        # So short an observation shows no repeat: means are over all of it, and impacts are per return.
        number = features[seen] == begun.cycles + (seen == "returns")
        whole = features["finished"] & features["finite"] & number
        return features, whole
