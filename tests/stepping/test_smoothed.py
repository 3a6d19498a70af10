"""Test the smoothed stepper: its fourth order. (`test_honesty.py` compares it with the sharp motion.)"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_kernels import by_kernels

from vibrojax.scenes.rotary import Rotary
from vibrojax.scenes.vibro_impact import VibroImpact
from vibrojax.stepping import Accuracy, Goal, Smoothed, lane_at

ROTARY, DRILL = Rotary(), VibroImpact()


def constants(scene, shape=(1,), **values):
    defaults = {name: parameter.default for name, parameter in scene.parameters().items()}
    return scene.constants({name: jnp.full(shape, values.get(name, x)) for name, x in defaults.items()})


@by_kernels(static=3)
def end_states(scene, method, start, p, settings, end):
    """Return the states (states, lanes) at `end`."""
    lane = lane_at(scene, p, scene.start(p, start, scene.speed_scale(p).shape))

    def take_step(lane):
        return method.step(scene, p, lane, settings, Goal(end, lane.clock.until(end) > 0))[0]

    return jnp.stack(jax.lax.while_loop(lambda lane: jnp.any(lane.clock.until(end) > 0), take_step, lane).state)


def final_states(scene, method, start, **settings):
    """Return the states at 0.5 s of lanes that differ in their settings."""
    settings = Accuracy(*map(jnp.asarray, Accuracy(tolerance=0.0, stride=0.0, step=0.0)._replace(**settings)))
    return np.asarray(end_states(scene, method, start, constants(scene, settings.step.shape), settings, 0.5))


@pytest.mark.parametrize("scene", [ROTARY, DRILL], ids=["rotary", "vibro-impact"])
def test_fourth_order_in_step(scene):
    """|y(h) - y| = C h⁴ at one width, through stick and slip, and through impacts, on which steps end.

    In the contact the step is `stride` over the contact's rate. Here it shrinks with h.
    """
    h = np.array([1e-3, 5e-4, 2.5e-4, 1.25e-4, 2e-5])
    states = final_states(scene, Smoothed(), "stuck", step=h, stride=200 * h, smoothing=0.05)
    errors = np.max(np.abs(states / states[:, -1:] - 1), axis=0)[:-1]
    assert errors[-1] < 1e-7
    order = np.polyfit(np.log(h[:-1]), np.log(errors), 1)[0]
    assert order > 3.7, errors
