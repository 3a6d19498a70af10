"""A recorded velocity of the bit, compared with motions at its times, which have exact derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.compile.xla import workers
from vibrojax.lanes.compiler import lane_function
from vibrojax.lazy import jax, jnp, lax
from vibrojax.maps.read import Point
from vibrojax.periodic.return_map import in_calls
from vibrojax.periodic.tangent_loop import with_derivatives
from vibrojax.periodic.variations import DERIVATIVE_ACCURACY
from vibrojax.physics.arrays import Array, Flags, Lanes
from vibrojax.scenes import Scene
from vibrojax.scenes.declared import Values as States
from vibrojax.stepping import Accuracy, Goal, Lane, Varied, lane_at

VELOCITY = "v1"  # state that a history records: the velocity of the bit relative to the drive
SAMPLES_PER_CALL = 64  # number of samples per call of the compiled program, which is compiled for this number only
SAME_TIME = 1e-9  # difference of times [s] that rounding may cause

MOST_STEPS_PER_SAMPLE = 2_000
"""Limit of steps from one sample to the next, far more than between two returns to the section."""

Moving = tuple[Lane, Lane]
"""Lanes, and their derivatives along one direction each."""

Begin = tuple[dict[str, Lanes], States]
"""Parameters by name, and initial states (ignored if the initial condition is a name)."""


@dataclass(frozen=True, eq=False)
class History:
    """A recorded velocity of the bit.

    - `point`: parameters and initial condition of the motion; the unknown parameters are replaced.
    - `begin` [s]: time of the first sample; `times` [s] since then; `velocity` [m/s].
    - `states`: names of the states at the first sample that are unknown too; `guess`, `bound`: their first values and
      greatest magnitudes.
    """

    point: Point
    begin: float
    times: Float[np.ndarray, " samples"]
    velocity: Float[np.ndarray, " samples"]
    states: tuple[str, ...]
    guess: Float[np.ndarray, " states"]
    bound: Float[np.ndarray, " states"]

    def predict(
        self, by: Sequence[str], values: Float[np.ndarray, "draws unknown"]
    ) -> tuple[Float[np.ndarray, "draws samples"], Float[np.ndarray, "draws samples unknown"]]:
        """Return the velocities at the sampling times, and their derivatives; NaN where a motion does not get there.

        `values`: values of the parameters `by`, and then of the unknown `states`. Each derivative has a lane of its
        own.
        """
        scene, start = self.point.system, self.point.start
        draw, direction = (index.ravel() for index in np.indices(values.shape))
        unknown = {name: (values[draw, k], (direction == k) + 0.0) for k, name in enumerate((*by, *self.states))}
        zero = np.zeros(len(draw))
        p = {name: (zero + x, zero) for name, x in self.point.parameters.items()}
        p |= {name: unknown[name] for name in by}
        given = () if start is None or isinstance(start, str) else zip(scene.start_states, start, strict=True)
        state = {name: (zero, zero) for name in scene.state_names} | {name: (zero + x, zero) for name, x in given}
        state |= {name: unknown[name] for name in self.states}
        calls = -(-len(self.times) // SAMPLES_PER_CALL)
        times = np.pad(self.times, (0, calls * SAMPLES_PER_CALL - len(self.times)), "edge")

        def pick(part: np.ndarray, k: int) -> Begin:
            return {name: x[k][part] for name, x in p.items()}, tuple(x[k][part] for x in state.values())

        def work(part: np.ndarray) -> np.ndarray:
            named, accuracy = start if isinstance(start, str) else None, Accuracy(*map(np.float64, DERIVATIVE_ACCURACY))
            begin, along = pick(part, 0), pick(part, 1)
            both, rows = _begun(scene, named, begin, along), []
            for block in times.reshape(calls, SAMPLES_PER_CALL, 1):
                until = np.broadcast_to(block, (SAMPLES_PER_CALL, len(part))).copy()
                both, *sampled = _sampled(scene, named, begin, along, both, until, accuracy)
                velocity, clock, rate, slope, late = map(np.asarray, sampled)
                # Steps have fixed lengths, so that the end of the last one moves with the times of events.
                rows.append([np.where(clock >= until - SAME_TIME, velocity, np.nan), slope - rate * late])
            return np.concatenate(rows, axis=1)[:, : len(self.times)]

        velocity, slopes = in_calls(work, len(draw), workers()).reshape(2, len(self.times), *values.shape)
        return velocity[..., 0].T, np.moveaxis(slopes, 0, 1)


def _constants(scene: Scene[Any], start: str | None, begin: Begin) -> tuple[Any, States]:
    p, state = begin
    c = scene.constants(p)
    state = state if start is None else scene.start(c, start, state[0].shape)
    return scene.scaled(c, lax.stop_gradient(state)), state


@lane_function(static=2)
def _begun(scene: Scene[Any], start: str | None, begin: Begin, along: Begin) -> Moving:
    """Return lanes at t = 0, and their derivatives along the direction `along`."""
    return jax.jvp(lambda begin: with_derivatives(lane_at(scene, *_constants(scene, start, begin))), (begin,), (along,))


@lane_function(static=2)
def _sampled(
    scene: Scene[Any], start: str | None, begin: Begin, along: Begin, both: Moving, times: Array, accuracy: Accuracy
) -> tuple[Moving, Array, Array, Array, Array, Array]:
    """Step lanes with their derivatives to each of the `times` (samples, lanes).

    **Returns:** lanes and derivatives at the last time; at each time the velocity, the clock and the acceleration, and
    the derivatives of velocity and clock (samples, lanes).
    """
    place = scene.place(VELOCITY)

    def to(both: Moving, time: Any) -> Any:
        def moving(lane: Lane, steps: Any) -> Flags:
            return (lane.clock.until(time) > 0) & (steps < MOST_STEPS_PER_SAMPLE)

        def motion(begin: Begin, lane: Lane) -> Any:
            c, _ = _constants(scene, start, begin)

            def step(now: tuple[Lane, Any]) -> tuple[Lane, Any]:
                active = moving(*now)
                lane, _ = Varied().step(scene, c, now[0], accuracy, Goal(time, active), marked=False)
                return lane, now[1] + active.astype(time.dtype)

            first = with_derivatives(lane), jnp.zeros_like(time)
            lane, _ = lax.while_loop(lambda now: jnp.any(moving(*now)), step, first)
            return lane, scene.field(c, lane.mode, lane.state)[place]

        (lane, rate), (moved, _) = jax.jvp(motion, (begin, both[0]), (along, both[1]))
        return (lane, moved), (lane.state[place], lane.clock.high, rate, moved.state[place], moved.clock.high)

    both, rows = lax.scan(to, both, times)
    return both, *rows
