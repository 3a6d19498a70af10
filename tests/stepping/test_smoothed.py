"""The smoothed stepper: fourth order in the step, how it tends to the sharp motion, and its derivatives."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_kernels import by_kernels

from vibrojax.models.scenes.rotary import Rotary
from vibrojax.models.scenes.vibro_impact import VibroImpact
from vibrojax.stepping import Accuracy, Goal, Located, Smoothed, lane_at
from vibrojax.stepping.smoothed import smoothed_trajectory

ROTARY, DRILL = Rotary(), VibroImpact()


def constants(scene, shape=(1,), **values):
    defaults = {name: one.default for name, one in scene.parameters().items()}
    return scene.constants({name: jnp.full(shape, values.get(name, x)) for name, x in defaults.items()})


@by_kernels(static=3)
def end_states(scene, method, start, p, settings, end):
    """States (states, lanes) at `end`."""
    lane = lane_at(scene, p, scene.start(p, start, scene.speed_scale(p).shape))

    def one(lane):
        return method.step(scene, p, lane, settings, Goal(end, lane.clock.until(end) > 0))[0]

    return jnp.stack(jax.lax.while_loop(lambda lane: jnp.any(lane.clock.until(end) > 0), one, lane).state)


def ends(scene, method, start, **settings):
    """States at 0.5 s of lanes that differ in their settings."""
    settings = Accuracy(*map(jnp.asarray, Accuracy(tolerance=0.0, stride=0.0, step=0.0)._replace(**settings)))
    return np.asarray(end_states(scene, method, start, constants(scene, settings.step.shape), settings, 0.5))


def slopes(errors, sizes):
    return np.diff(np.log(errors)) / np.diff(np.log(sizes))


@pytest.mark.parametrize("scene", [ROTARY, DRILL], ids=["rotary", "vibro-impact"])
def test_order_4_in_the_step(scene):
    """|y(h) - y| = C h⁴ at one width, through stick and slip, and through impacts, on which it lands.

    In the contact the step is `stride` over the contact's rate, which shrinks with h here.
    """
    h = np.array([1e-3, 5e-4, 2.5e-4, 1.25e-4, 2e-5])
    states = ends(scene, Smoothed(), "stuck", step=h, stride=200 * h, smoothing=0.05)
    errors = np.max(np.abs(states / states[:, -1:] - 1), axis=0)[:-1]
    assert errors[-1] < 1e-7
    order = np.polyfit(np.log(h[:-1]), np.log(errors), 1)[0]
    assert order > 3.7, errors


def distance_to_the_sharp_motion(scene, start, widths):
    """Greatest relative difference of the states at 0.5 s from those of the located stepper."""
    smoothed = ends(scene, Smoothed(), start, step=0.02 * widths, stride=np.minimum(4 * widths, 0.1), smoothing=widths)
    located = ends(scene, Located(), start, step=np.full_like(widths, np.inf), stride=1.0, tolerance=1e-12)
    return np.max(np.abs(smoothed / located - 1), axis=0)


@pytest.mark.parametrize("scene", [ROTARY, DRILL], ids=["rotary", "vibro-impact"])
def test_width_where_the_bit_slides(scene):
    """From `drive` it does not stop in 0.5 s: the distance falls as 1 - u/sqrt(u² + w²) = w²/(2 u²) + ..."""
    widths = np.array([1e-2, 3e-3, 1e-3])
    distances = distance_to_the_sharp_motion(scene, "drive", widths)
    assert np.all(slopes(distances, widths) > 1.9), distances


@pytest.mark.parametrize("scene", [ROTARY, DRILL], ids=["rotary", "vibro-impact"])
@pytest.mark.long
def test_width_where_the_bit_sticks_and_breaks_away(scene):
    """The distance falls about as the width: with its power 4/5, which the breakaway gives.

    A creeping bit moves on by O(w). As it breaks away, the springs' pull beyond the stick limit grows like t and u like
    t², and friction is short of its limit by w²/(2 u²): the layer is u of the order of w^(4/5) wide.
    """
    widths = np.array([3e-3, 1e-3, 3e-4])
    distances = distance_to_the_sharp_motion(scene, "stuck", widths)
    assert np.all(slopes(distances, widths) > 0.65), distances
    assert np.all(slopes(distances, widths) < 1.1), distances
    assert distances[-1] < 0.01


AT = {name: jnp.asarray(ROTARY.parameters()[name].default) for name in ("mu", "v_cr", "k1")}


@partial(jax.jit, static_argnums=(2,))
def x2_at_the_end(values, h=1e-3, steps=60):
    """x2 [m] after 60 ms of the rotary scene with its friction switch 0.1 m/s wide, from `stuck`: it breaks away."""
    p = ROTARY.constants({name: jnp.asarray(one.default) for name, one in ROTARY.parameters().items()} | values)
    start = (jnp.asarray(-0.004), -p.drill.slip.v, jnp.asarray(0.01), jnp.asarray(0.5))
    return smoothed_trajectory(ROTARY, p, start, h, steps, 0.1)[2][-1]


@partial(jax.jit, static_argnums=(1,))
def gradient(h, steps):
    return jax.grad(x2_at_the_end)(AT, h, steps)


@jax.jit
def forwards(along):
    return jax.jvp(x2_at_the_end, (AT,), (along,))[1]


@pytest.mark.parametrize("name", AT)
def test_derivatives(name):
    """d x2/d parameter, backwards and forwards, against the central difference (y(q + e) - y(q - e))/(2 e)."""
    e = 1e-5 * AT[name]
    up, down = (x2_at_the_end(AT | {name: AT[name] + sign * e}) for sign in (1.0, -1.0))
    difference = (up - down) / (2 * e)
    assert abs(difference * AT[name]) > 1e-6
    np.testing.assert_allclose(gradient(1e-3, 60)[name], difference, rtol=1e-6)
    np.testing.assert_allclose(forwards({one: jnp.asarray(float(one == name)) for one in AT}), difference, rtol=1e-6)


def test_derivatives_converge_with_the_step():
    """At half the step the derivative differs by next to nothing: it is the motion's, not the steps'."""
    np.testing.assert_allclose(gradient(1e-3, 60)["mu"], gradient(5e-4, 120)["mu"], rtol=1e-4)


def test_trajectory_is_what_the_stepper_gives():
    """Plain steps of the rotary scene, as the stepper's, but for its landing on turns: both of fourth order."""
    p = constants(ROTARY)
    plain = smoothed_trajectory(ROTARY, p, ROTARY.start(p, "stuck", (1,)), 5e-4, 1000, 0.05)
    stepped = ends(ROTARY, Smoothed(), "stuck", step=np.array([5e-4]), stride=1.0, smoothing=0.05)
    np.testing.assert_allclose(np.stack([y[-1] for y in plain]), stepped, rtol=0, atol=1e-6)
