"""Features of a smoothed motion, computed from samples for solvers that do not measure features while stepping.

The package's own gauges measure the motion. Its steps lead from each sample to the next on cubic Hermite interpolants,
and end on events between the samples.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from vibrojax.measures import recorder_for
from vibrojax.measures.recorder import Effort, run_block
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import Scene
from vibrojax.stepping import Accuracy, Goal, Lane, Step
from vibrojax.stepping.event import Event, Trial, locate
from vibrojax.stepping.series import known
from vibrojax.stepping.smoothed import STICK_WIDTHS, Smoothed, hermite
from vibrojax.stepping.stepper import taken, trial_length

STEPS_PER_SAMPLE = 10
"""Greatest mean number of steps from one sample to the next: one, and one for each event."""

_ROUNDING = 1e-6  # fraction of a sampling interval by which the clock may be off

Constants = Any
"""A scene's constants, each of shape (lanes,)."""


@dataclass(frozen=True)
class _Replayed(Smoothed):
    """A stepper along samples.

    `Accuracy.step` holds the samples (samples, states, lanes), `Accuracy.stride` their interval [s].
    """

    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        samples, interval, width = accuracy.step, accuracy.stride, accuracy.smoothing
        mode = scene.smoothed_mode(constants, lane.mode, lane.state, STICK_WIDTHS * width)
        lane = lane._replace(mode=mode)
        following = jnp.floor(lane.clock.high / interval + _ROUNDING) + 1
        remaining = lane.clock.until(following * interval)
        index = jnp.minimum(following.astype(int), len(samples) - 1)
        target = tuple(samples[index, state, jnp.arange(index.size)] for state in range(samples.shape[1]))
        h = trial_length(lane, remaining, interval, goal)

        def rates(state: tuple[Array, ...]) -> tuple[Array, ...]:
            return scene.smoothed_field(constants, mode, state, width)

        ends = zip(lane.state, target, rates(lane.state), rates(target), strict=True)
        curves = (hermite(y, z, remaining * dy, remaining * dz) for y, z, dy, dz in ends)
        polynomials = tuple([x * (h / remaining) ** power for power, x in enumerate(curve)] for curve in curves)
        event = Event(scene, constants, mode, marked, smooths=True)
        series = event.functions(tuple(known(polynomial) for polynomial in polynomials))
        trial = Trial(polynomials, [f.arrays(self.degree, h) for f in series], h, jnp.ones_like(h), goal.moving)
        return taken(event, lane, trial, h, locate(event, trial))


def features_of(
    scene: Scene[Any],
    p: Constants,
    sampling: float,
    states: Float[np.ndarray, "states lanes samples"],
    width: float,
) -> dict[str, Shaped[np.ndarray, " lanes"]]:
    """Return the features of a motion, among them period, cycles, impacts and impact_velocity, by name.

    **Arguments:** `p`: the scene's constants (lanes,); `sampling`: sampling interval [s]; `width`: width [m/s] of the
    friction switch.
    """
    samples = jnp.asarray(np.moveaxis(states, 2, 0), scene.speed_scale(p).dtype)
    features = _measured(scene, p, samples, *(jnp.asarray(x, samples.dtype) for x in (sampling, width)))
    return {name: np.asarray(x) for name, x in features.items() if x.ndim == 1}


@partial(jax.jit, static_argnames="scene")
def _measured(
    scene: Scene[Any], p: Constants, samples: Array, sampling: Array, width: Array
) -> dict[str, Shaped[Array, "..."]]:
    count = len(samples) - 1
    effort = Effort(Accuracy(0.0, sampling, samples, width), STEPS_PER_SAMPLE * count)
    return run_block(scene, _Replayed(), recorder_for(scene), p, tuple(samples[0]), effort, 0.0, count * sampling)
