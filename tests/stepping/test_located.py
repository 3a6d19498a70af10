"""Test the located and the smoothed stepper: order, where steps land, corner cases of events, and agreement."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_kernels import by_kernels
from flat import Flat

import vibrojax as vj
from vibrojax.lanes.record import record
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


@by_kernels(static=2)
def end_states(scene, method, p, state, settings, end):
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


def final_states(scene, method, p, start, end, **settings):
    shape = scene.speed_scale(p).shape
    settings = Accuracy(*map(jnp.asarray, FINE._replace(**settings)))
    states, steps = end_states(scene, method, p, scene.start(p, start, shape), settings, jnp.asarray(end))
    return np.asarray(states), np.asarray(steps)


def run_lane(start, duration, **values):
    """Return the constants and the record of one lane of the vibro-impact scene."""
    p = constants(DRILL, **values)
    settings = Accuracy(*map(jnp.asarray, FINE))
    steps = record(DRILL, Located(), p, DRILL.start(p, start, (1,)), settings, float(duration))[0]
    return Flat(p), steps


def hits(steps):
    """Return the events at the ends of steps, by name."""
    return dict(zip(DRILL.event_names, steps.hits.T, strict=True))


def impact_begins(p, steps):
    """Return the steps at whose end an impact begins."""
    return np.asarray(DRILL.impact_begins(p.constants, tuple(steps.mode.T), tuple(steps.after.T), hits(steps)))


@pytest.fixture(scope="module")
def motion():
    """Return a run of 2 s from `stuck` that sticks, slips in both directions and has impacts."""
    return run_lane("stuck", 2.0)


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


def test_steps_land_exactly_on_surfaces(motion):
    """u = 0 after friction events, x2 = delta as an impact begins, J = 0 as it ends, and x1', x2' = 0 at the turns."""
    p, steps = motion
    _, v1, x2, v2 = steps.after.T
    friction, contact, bit_turns, striker_turns = steps.hits.T
    assert np.all(v1[friction] + float(p["v"][0]) == 0)
    assert np.all(x2[impact_begins(p, steps)] == float(p["delta"][0]))
    releases = contact & (steps.mode[:, 1] == 1)
    assert releases.sum() >= 5
    np.testing.assert_allclose(
        x2[releases] - float(p["delta"][0]), -float(p["relaxation"][0]) * v2[releases], atol=1e-17
    )
    assert np.all(v1[bit_turns & ~friction] == 0)
    assert np.all(v2[striker_turns] == 0)


@pytest.fixture(scope="module")
def free_top():
    """Return the time of the striker's first turn at the top without contact, with x1 and x2 there."""
    _, steps = run_lane("stuck", 2.0, delta=1.0)
    first = np.flatnonzero(steps.hits[:, 3] & steps.falling[:, 1])[0]
    x1, _, x2, _ = steps.after[first]
    return steps.start[first] + steps.dt[first], x1, x2


@pytest.mark.parametrize("above", [1e-9, 1e-12, 0.0, -1e-15, -1e-12, -1e-9])
def test_impact_at_grazing(free_top, above):
    """The gap lies `above` the free striker's turn: no impact, or one at x2' = sqrt(2 a |above|), and no stall."""
    when, x1, top = free_top
    p, steps = run_lane("stuck", when + 0.02, delta=top + above)
    _, free = run_lane("stuck", when + 0.02, delta=1.0)
    impacts = steps.after[impact_begins(p, steps)][:, 3]
    deceleration = float(p["k2"][0] * p["inverse_m2"][0]) * (top - x1)
    expected = np.sqrt(2 * deceleration * max(-above, 0))
    if abs(above) >= 1e-12:
        assert len(impacts) == (above < 0)
    np.testing.assert_allclose(impacts, expected, rtol=1e-2, atol=1e-6)
    assert len(steps.dt) < len(free.dt) + 30
    np.testing.assert_allclose(steps.after[-1], free.after[-1], rtol=0, atol=20 * expected + 1e-6)


@pytest.mark.parametrize("start", [(0.003, -1.495, 0.0, 1.0), (0.03, -1.4, 0.0, 1.0)])  # the bit stays, or turns back
@pytest.mark.parametrize("shift", [0.0, 1e-15, -1e-12, 1e-9])
def test_simultaneous_switches(start, shift):
    """The gap equals the striker's position where the bit stops, so the two switches coincide, in either order."""
    _, free = run_lane(start, 0.5, delta=1.0)
    stop = np.flatnonzero(free.hits[:, 0])[0]
    end, gap = free.start[stop] + free.dt[stop] + 0.02, free.after[stop, 2]
    assert gap > 0
    assert free.after[stop, 3] > 0.5
    assert free.mode[stop + 1, 0] == (0 if start[0] < 0.01 else -1)
    p, steps = run_lane(start, end, delta=gap + shift)
    nearby_p, nearby = run_lane(start, end, delta=gap + 1e-7)
    assert impact_begins(p, steps).sum() == impact_begins(nearby_p, nearby).sum() == 1
    assert len(steps.dt) < len(nearby.dt) + 20
    np.testing.assert_allclose(steps.after[-1], nearby.after[-1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("touching", [False, True])
def test_slip_that_ends_immediately(dtype, touching):
    """A spring force exceeds the stick limit and falls below it at once. This takes few steps for any excess."""
    excess = 10.0 ** np.arange(-17, -1, dtype=float)
    lanes = excess.shape
    p = constants(DRILL, lanes, delta=0.0 if touching else 1.0)
    c = jax.tree.map(lambda value: jnp.asarray(value, dtype), p)
    p = Flat(c)
    impact = 1000.0 * touching
    limit = p["stick_limit"] + p["stick_gain"] * impact
    x2 = jnp.full(lanes, impact / 5e7, dtype)
    x1 = (limit * (1 + jnp.asarray(excess, dtype)) + p["k2"] * x2) / (p["k1"] + p["k2"])
    zero = jnp.zeros(lanes, dtype)
    state = (x1, -p["v"], x2, zero)
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
