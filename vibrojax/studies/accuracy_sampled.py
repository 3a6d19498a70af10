"""Features of a smoothed motion, computed from samples for solvers that do not measure features while stepping.

The package's own gauges measure the motion. Events between samples are located by one integration step from the
preceding sample, in the mode at that sample. Event times have the order of accuracy of this step, independent of the
sampling.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from vibrojax.measures.impacts import Impacts
from vibrojax.measures.motion import Shares, Swings
from vibrojax.measures.recorder import Effort, Recorder, run_block
from vibrojax.physics.arrays import Array
from vibrojax.scenes import HasImpacts, Scene
from vibrojax.stepping import Accuracy, Goal, Lane, Smoothed, Step

STEPS_PER_SAMPLE = 10
"""Greatest mean number of steps from one sample to the next: one, and one for each event."""

_ROUNDING = 1e-6  # fraction of a sampling interval by which the clock may be off

Constants = Any
"""A scene's constants, each of shape (lanes,)."""


@dataclass(frozen=True)
class _Replayed(Smoothed):
    """A stepper that continues from the next sample wherever it reaches its time.

    `Accuracy.step` holds the samples (samples, states, lanes), `Accuracy.stride` their interval [s].
    """

    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        samples, interval = accuracy.step, accuracy.stride
        following = jnp.floor(lane.clock.high / interval + _ROUNDING) + 1
        to_sample = accuracy._replace(step=lane.clock.until(following * interval), stride=jnp.inf)
        lane, step = super().step(scene, constants, lane, to_sample, goal, marked)
        reached = lane.clock.until(following * interval) < _ROUNDING * interval
        reached &= ~jnp.stack(list(step.hits.values())).any(axis=0)
        index = jnp.minimum(following.astype(int), len(samples) - 1)
        state = tuple(
            jnp.where(reached, samples[index, k, jnp.arange(index.size)], y) for k, y in enumerate(lane.state)
        )
        return lane._replace(state=state), step._replace(after=state)


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
    gauges = (Swings(), Shares(), Impacts()) if isinstance(scene, HasImpacts) else (Swings(), Shares())
    effort = Effort(Accuracy(0.0, sampling, samples, width), STEPS_PER_SAMPLE * count)
    return run_block(scene, _Replayed(), Recorder(gauges), p, tuple(samples[0]), effort, 0.0, count * sampling)
