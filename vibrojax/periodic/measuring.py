"""Measurement of lanes on periodic orbits: the features of one period, with the compiled programs of a run."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.compile.xla import workers
from vibrojax.lanes.engine import Batch, Engine
from vibrojax.lanes.inputs import Features, Index, LaneInputs, PerLane
from vibrojax.lanes.programs import LaneArguments
from vibrojax.lazy import jax
from vibrojax.measures import recorder_for
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Located

ORBIT_ACCURACY = Accuracy(tolerance=1e-10, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps with which orbits are measured."""

DRIVEN_RETURNS = 4
"""Section crossings after which a driven part has settled on the motion that the orbit imposes."""

Times = Float[np.ndarray, "lanes cycles"]
"""Time from each section crossing of an orbit to the next [s]."""


def past_times(times: Float[np.ndarray, "lanes cycles *by"]) -> Float[np.ndarray, "8 lanes *by"]:
    """Return the times [s] of the last crossings, newest first, the last of which is at time 0; or their slopes."""
    cycles, length = times.shape[1], times.sum(axis=1)
    ago = np.concatenate([np.zeros_like(times[:, :1]), np.cumsum(times[:, ::-1], axis=1)], axis=1)
    return -np.stack([ago[:, k % cycles] + (k // cycles) * length for k in range(MOST_CYCLES)])


def past_states(states: Float[np.ndarray, "lanes cycles states"]) -> Float[np.ndarray, "8 states lanes"]:
    """Return the states at the last crossings, newest first, of which the first state of each orbit is the last."""
    return np.moveaxis(states[:, -np.arange(MOST_CYCLES) % states.shape[1]], 0, -1)


def observation(scene: Scene[Any], times: Times) -> tuple[PerLane, PerLane, str]:
    """Return settling time [s], duration [s], and the name of the feature that counts section crossings (or pulses).

    The observation covers one period of the orbit. It ends between two section crossings, so that rounding errors do
    not affect their number.
    """
    driving, cycles, length = scene.driving_part(), times.shape[1], times.sum(axis=1)
    first, second, last = times[:, 0], times[:, 1 % cycles], times[:, -1]
    settle, duration, counted = np.zeros(len(times)), length + first + second / 2, "returns"
    if driving.section is None:  # the pulse that begins at t = 0 counts
        duration, counted = length + first / 2, "pulses"
    if scene is not driving:
        settle, duration = -(-DRIVEN_RETURNS // cycles) * length - last / 2, length + (last + first) / 2
    return settle, duration, counted


class Measuring:
    """Measurement of lanes on their orbits, with the compiled programs of their run, whose settings are `run`."""

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...]) -> None:
        self._scene, self._driving = scene, scene.driving_part()
        exact = replace(run, precision="float64", method="located")
        recorder = recorder_for(scene, run.keep_returns)
        self._engine = Engine(scene, exact, start_names, Located(), recorder, workers())

    def __call__(
        self,
        inputs: LaneInputs | LaneArguments,
        lanes: Index,
        states: Float[np.ndarray, "lanes cycles states"],
        times: Times,
        steps: PerLane,
        accuracy: Accuracy = ORBIT_ACCURACY,
    ) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Return the features over one period, and a mask of lanes with the expected number of section crossings.

        **Arguments:** `inputs`: lanes of a chunk; `lanes`: indices of those that are measured; `states`, `times` [s]:
        of their orbits at the section; `steps`: approximate number of steps of one period.
        """
        scene, cycles = self._scene, times.shape[1]
        known = dict(zip(self._driving.return_states, states[:, 0].T, strict=True))
        zero = np.zeros(len(lanes))
        state = tuple(np.ascontiguousarray(known.get(name, zero)) for name in scene.state_names)
        settle, duration, counted = observation(scene, times)
        given = self._engine.given(inputs) if isinstance(inputs, LaneInputs) else inputs
        given = jax.tree.map(lambda x: np.take(x, lanes).astype(float if x.dtype.kind == "f" else x.dtype), given)
        batch = Batch(accuracy, lanes, given, settle, duration, None, steps.astype(np.int32))
        period = times.sum(axis=1) / cycles
        batch = self._engine.on_orbit(batch, state, past_states(states), past_times(times), period)
        [features] = self._engine.observe(self._engine.settle([batch]) if np.any(settle) else [batch])
        # The observation is too short to detect a period, so `impacts` is per section crossing, and means are taken
        # over the complete observation.
        number = features[counted] == cycles + (counted == "returns")
        return features, features["finished"] & features["finite"] & number
