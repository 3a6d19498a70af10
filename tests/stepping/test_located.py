"""Test the located and the smoothed stepper: order, slips that end at once, and agreement."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.compile.native import Kernel
from vibrojax.scenes.rotary import Rotary
from vibrojax.scenes.vibro_impact import VibroImpact
from vibrojax.stepping import Accuracy, Goal, Located, Smoothed, lane_at
from vibrojax.studies.trajectory import feature_lines

DRILL = VibroImpact()
FINE = Accuracy(tolerance=1e-12, stride=1.0, step=np.inf)


def constants(scene, shape=(1,), **values):
    return scene.constants(
        {name: jnp.full(shape, float(values.get(name, q.default))) for name, q in scene.parameters().items()}
    )


def step_to(scene, method, p, state, settings, end):
    """Return the states (states, lanes) at `end`, and the number of trial steps of each lane."""

    def is_unfinished(carry):
        lane, steps = carry
        return jnp.any((lane.clock.until(end) > 0) & (steps < 1e5))

    def take_step(carry):
        lane, steps = carry
        moving = lane.clock.until(end) > 0
        lane, _ = method.step(scene, p, lane, settings, Goal(end, moving))
        return lane, jnp.where(moving, steps + 1, steps)

    lane, steps = jax.lax.while_loop(is_unfinished, take_step, (lane_at(scene, p, state), jnp.zeros_like(state[0])))
    return jnp.stack(lane.state), steps


KERNELS = {}


def end_states(scene, method, *given):
    """Return the results of `step_to`, by a kernel as in sweeps: XLA takes several times as long to compile it."""
    given = jax.tree.map(np.asarray, given)
    key = scene, method, tuple((x.dtype, x.ndim) for x in jax.tree.leaves(given))
    if key not in KERNELS:
        KERNELS[key] = Kernel(partial(step_to, scene, method), *given)
    return KERNELS[key](*given)


def final_states(scene, method, p, start, end, **settings):
    shape = scene.speed_scale(p).shape
    settings = Accuracy(*map(jnp.asarray, FINE._replace(**settings)))
    states, steps = end_states(scene, method, p, scene.start(p, start, shape), settings, jnp.asarray(end))
    return np.asarray(states), np.asarray(steps)


def fitted_order(errors, strides):
    """Return the slope of a line through log error over log stride."""
    return np.polyfit(np.log(strides), np.log(errors), 1)[0]


@pytest.mark.parametrize(
    ("order", "strides"), [(2, (0.08, 0.04, 0.02)), (4, (0.25, 0.12, 0.06)), (8, (1.0, 0.7, 0.5, 0.35))]
)
def test_order_through_stick_slip_and_impacts(order, strides):
    """|y(h) - y| = C h^order at 0.5 s from `stuck`. At an infinite tolerance, only the series sets the error."""
    p = constants(DRILL, (len(strides),))
    exact, _ = final_states(DRILL, Located(8), p, "stuck", 0.5, tolerance=1e30, stride=np.full(len(strides), 0.08))
    states, _ = final_states(DRILL, Located(order), p, "stuck", 0.5, tolerance=1e30, stride=np.array(strides))
    errors = np.max(np.abs(states / exact - 1), axis=0)
    assert fitted_order(errors, strides) > order - 0.3, errors
    assert errors[-1] < 1e-2


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("touching", [False, True])
def test_slip_that_ends_immediately(dtype, touching):
    """A spring force exceeds the stick limit and falls below it at once. This takes few steps for any excess."""
    excess = 10.0 ** np.arange(-17, -1, dtype=float)
    lanes = excess.shape
    p = constants(DRILL, lanes, delta=0.0 if touching else 1.0)
    c = jax.tree.map(lambda value: jnp.asarray(value, dtype), p)
    impact, k1, k2 = 1000.0 * touching, 156250.0, 0.4 * 156250.0 * 0.75**2
    x2 = np.full(lanes, impact / 50e6)
    x1 = (0.4 * (250.0 * 9.81 + impact) * (1 + excess) + k2 * x2) / (k1 + k2)
    state = tuple(jnp.asarray(x, dtype) for x in (x1, np.full(lanes, -1.5), x2, np.zeros(lanes)))
    settings = Accuracy(*(jnp.asarray(value, dtype) for value in FINE._replace(tolerance=3e-6)))
    reached, steps = end_states(DRILL, Located(), c, state, settings, jnp.asarray(0.004, dtype))
    assert np.all(np.isfinite(reached))
    assert np.max(steps) < 100


@pytest.mark.parametrize("scene", [Rotary(), DRILL], ids=["rotary", "vibro-impact"])
def test_fourth_order_in_step(scene):
    """|y(h) - y| = C h⁴ at one width, through stick and slip, and through impacts, on which steps end.

    In the contact the step is `stride` over the contact's rate. Here it shrinks with h.
    """
    h = np.array([1e-3, 5e-4, 2.5e-4, 1.25e-4, 2e-5])
    p = constants(scene, h.shape)
    states, _ = final_states(scene, Smoothed(), p, "stuck", 0.5, step=h, stride=200 * h, smoothing=0.05)
    errors = np.max(np.abs(states / states[:, -1:] - 1), axis=0)[:-1]
    assert errors[-1] < 1e-7
    order = np.polyfit(np.log(h[:-1]), np.log(errors), 1)[0]
    assert order > 3.7, errors


# The steppers against each other, over a transient too short for chaos

STATES = ("x1", "v1", "x2", "v2")
STUCK = {"start": "stuck"}  # sticks, slips both ways, impacts; settles on a periodic orbit
IRREGULAR = {"k1": 625000.0, "gamma": 1.2, "start": "drive"}  # settles on a chaotic attractor (Fig. 5.77c)
WIDTHS = (1e-2, 1e-3, 1e-4)


def position_motion(point, **how):
    return vj.simulate("vibro-impact", **point, **how, duration=0.8, sampling=1e-3, progress=False)


@pytest.fixture(scope="module")
def located():
    return {"stuck": position_motion(STUCK), "irregular": position_motion(IRREGULAR)}


def position_error(trajectory, reference):
    """Return the largest difference of the positions, relative to the largest position."""
    return max(float(abs(trajectory[x] - reference[x]).max() / abs(reference[x]).max()) for x in ("x1", "x2"))


def mean_state_error(trajectory, reference):
    """Return the mean difference of all states, relative to their largest values.

    The maximum would be large, since velocities reverse within an impact of 4 ms.
    """
    return max(float(abs(trajectory[y] - reference[y]).mean() / abs(reference[y]).max()) for y in STATES)


def bound_of_width(width):
    """Return the order of the smoothing error: w^(4/5) in units of 1 m/s (see `test_fourth_order_in_step`)."""
    return width**0.8


@pytest.mark.parametrize("width", WIDTHS)
def test_smoothed_matches_located(located, width):
    """The error stays below the bound of the width, which shrinks with the width."""
    smoothed = position_motion(STUCK, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(smoothed, located["stuck"]) < bound_of_width(width)
    assert mean_state_error(smoothed, located["stuck"]) < bound_of_width(width)
    irregular = position_motion(IRREGULAR, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(irregular, located["irregular"]) < bound_of_width(width)


def test_smoothed_matches_diffrax():
    """Both solve the same equations, so at equal widths only their step errors differ. These are far smaller."""
    smoothed = position_motion(STUCK, method="smoothed", smoothing=1e-2, step=1e-4)
    adaptive = position_motion(STUCK, solver="Tsit5", smoothing=1e-2, error=1e-6)
    assert position_error(smoothed, adaptive) < 1e-2 * bound_of_width(1e-2)
    assert "regime" not in adaptive and feature_lines(adaptive) == []
