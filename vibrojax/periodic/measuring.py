"""Measurement of lanes on periodic orbits: the features of one period, with the compiled programs of a run."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.compile.xla import workers
from vibrojax.lanes.engine import Batch, Engine
from vibrojax.lanes.inputs import Features, Index, LaneInputs, PerLane
from vibrojax.lanes.programs import LaneArguments
from vibrojax.measures import recorder_for
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Located

ORBIT_ACCURACY = Accuracy(tolerance=1e-10, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps with which orbits are measured."""

DRIVEN_RETURNS = 4
"""Section crossings after which a driven part has settled on the motion that the orbit imposes."""


class OrbitStart(NamedTuple):
    """Initial conditions of lanes on their orbits, at the section; the last axis of all arrays is the lane.

    - `lanes`: indices in their chunk; `state`: state of the return map; `cycles`: section crossings per period.
    - `past`, `when` [s]: states and times of the last crossings, newest first: `state` at time 0.
    - `steps`, `length` [s]: approximate number of steps, and duration, of one period.
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


def start_on_orbit(
    lanes: Index,
    states: Float[np.ndarray, "lanes cycles states"],
    times: Float[np.ndarray, "lanes cycles"],
    steps: PerLane,
) -> OrbitStart:
    """Return initial conditions at the first of the `states` of each orbit; `times`: time to the next state [s]."""
    cycles, length = states.shape[1], times.sum(axis=1)
    ago = np.concatenate([np.zeros((len(lanes), 1)), np.cumsum(times[:, ::-1], axis=1)], axis=1)
    when = [-(ago[:, k % cycles] + (k // cycles) * length) for k in range(MOST_CYCLES)]
    past = np.moveaxis(states[:, -np.arange(MOST_CYCLES) % cycles], 0, -1)
    between = times[:, 0], times[:, 1 % cycles], times[:, -1]
    return OrbitStart(lanes, states[:, 0].T, past, np.stack(when), np.full(len(lanes), cycles), steps, length, *between)


def joined(parts: list[OrbitStart]) -> OrbitStart:
    """Concatenate the lanes of all `parts`."""
    return OrbitStart(*(np.concatenate(fields, axis=-1) for fields in zip(*parts, strict=True)))


def observation(scene: Scene[Any], start: OrbitStart) -> tuple[PerLane, PerLane, str]:
    """Return settling time [s], duration [s], and the name of the feature that counts section crossings (or pulses).

    The observation covers one period of the orbit. It ends between two section crossings, so that rounding errors do
    not affect their number.
    """
    driving = scene.driving_part()
    settle, duration, counted = np.zeros(len(start.lanes)), start.length + start.first + start.second / 2, "returns"
    if driving.section is None:  # the pulse that begins at t = 0 counts
        duration, counted = start.length + start.first / 2, "pulses"
    if scene is not driving:
        settle = -(-DRIVEN_RETURNS // start.cycles) * start.length - start.last / 2
        duration = start.length + (start.last + start.first) / 2
    return settle, duration, counted


class Measuring:
    """Measurement of lanes on their orbits, with the compiled programs of their run, whose settings are `run`."""

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...]) -> None:
        self._scene, self._driving = scene, scene.driving_part()
        exact = replace(run, precision="float64", method="located")
        recorder = recorder_for(scene, run.keep_returns)
        self._engine = Engine(scene, exact, start_names, Located(), recorder, workers())

    def __call__(
        self, inputs: LaneInputs | LaneArguments, start: OrbitStart, steps: Accuracy = ORBIT_ACCURACY
    ) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Return the features over one period, and a mask of lanes with the expected number of section crossings.

        `inputs`: lanes of the chunk, of which `start` holds some.
        """
        lanes, scene = start.lanes, self._scene
        known = dict(zip(self._driving.return_states, start.state, strict=True))
        zero = np.zeros(len(lanes))
        state = tuple(np.ascontiguousarray(known.get(name, zero)) for name in scene.state_names)
        settle, duration, counted = observation(scene, start)
        given = self._engine.given(inputs) if isinstance(inputs, LaneInputs) else inputs
        given = jax.tree.map(lambda x: np.take(x, lanes).astype(float if x.dtype.kind == "f" else x.dtype), given)
        batch = Batch(steps, lanes, given, settle, duration, None, start.steps.astype(np.int32))
        batch = self._engine.on_orbit(batch, state, start.past, start.when, start.length / start.cycles)
        [features] = self._engine.observe(self._engine.settle([batch]) if np.any(settle) else [batch])
        # The observation is too short to detect a period, so `impacts` is per section crossing, and means are taken
        # over the complete observation.
        number = features[counted] == start.cycles + (counted == "returns")
        return features, features["finished"] & features["finite"] & number
