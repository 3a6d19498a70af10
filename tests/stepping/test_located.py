"""The located stepper: its order, where it lands, and the corners in which event location goes wrong."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_kernels import by_kernels
from flat import Flat

from vibrojax.models.physics.friction import FRICTION_LAWS
from vibrojax.models.scenes.rotary import Rotary
from vibrojax.models.scenes.vibro_impact import VibroImpact
from vibrojax.stepping import Accuracy, Goal, Located, lane_at
from vibrojax.sweep.simulation.dense_output import record

DRILL = VibroImpact()
FINE = Accuracy(tolerance=1e-12, stride=1.0, step=np.inf)


def constants(scene, shape=(1,), **values):
    return scene.constants(
        {name: jnp.full(shape, float(values.get(name, q.default))) for name, q in scene.parameters().items()}
    )


@by_kernels(static=2)
def end_states(scene, method, p, state, settings, end):
    """States (states, lanes) at `end`, and the trial steps of each lane."""

    def goes_on(carry):
        lane, steps = carry
        return jnp.any((lane.clock.until(end) > 0) & (steps < 1e5))

    def one(carry):
        lane, steps = carry
        moving = lane.clock.until(end) > 0
        lane, _ = method.step(scene, p, lane, settings, Goal(end, moving))
        return lane, jnp.where(moving, steps + 1, steps)

    lane, steps = jax.lax.while_loop(goes_on, one, (lane_at(scene, p, state), jnp.zeros_like(state[0])))
    return jnp.stack(lane.state), steps


def ends(scene, method, p, start, end, **settings):
    shape = scene.speed_scale(p).shape
    settings = Accuracy(*map(jnp.asarray, FINE._replace(**settings)))
    states, steps = end_states(scene, method, p, scene.start(p, start, shape), settings, jnp.asarray(end))
    return np.asarray(states), np.asarray(steps)


def run(start, duration, **values):
    """Constants and record of one lane of the vibro-impact scene."""
    p = constants(DRILL, **values)
    settings = Accuracy(*map(jnp.asarray, FINE))
    taken = record(DRILL, Located(), p, DRILL.start(p, start, (1,)), settings, float(duration))[0]
    return Flat(p), taken


def hits(taken):
    """What steps ended on, by name."""
    return dict(zip(DRILL.event_names, taken.hits.T, strict=True))


def begins(p, taken):
    """Steps at whose end an impact begins."""
    return np.asarray(DRILL.impact_begins(p.constants, tuple(taken.mode.T), tuple(taken.after.T), hits(taken)))


@pytest.fixture(scope="module")
def motion():
    """2 s from `stuck`: sticks, slips both ways, impacts."""
    return run("stuck", 2.0)


def slope_of(errors, strides):
    """The order in h that a line through log error over log stride has."""
    return np.polyfit(np.log(strides), np.log(errors), 1)[0]


@pytest.mark.parametrize(
    ("order", "strides"), [(2, (0.08, 0.04, 0.02)), (4, (0.25, 0.12, 0.06)), (8, (1.0, 0.7, 0.5, 0.35))]
)
def test_order_through_stick_slip_and_impacts(order, strides):
    """|y(h) - y| = C h^order at 0.5 s from `stuck`, with the series alone setting the error (tolerance infinite)."""
    p = constants(DRILL, (len(strides),))
    exact, _ = ends(DRILL, Located(8), p, "stuck", 0.5, tolerance=1e30, stride=np.full(len(strides), 0.08))
    states, _ = ends(DRILL, Located(order), p, "stuck", 0.5, tolerance=1e30, stride=np.array(strides))
    errors = np.max(np.abs(states / exact - 1), axis=0)
    assert slope_of(errors, strides) > order - 0.3, errors
    assert errors[-1] < 1e-2


@pytest.mark.parametrize("law", ["popp-exponential", "popp-arctan", "hyperbolic-quadratic"])
@pytest.mark.long
def test_order_with_laws_that_are_no_polynomials(law):
    """The series' quotient, exponential and arc tangent, in a stretch of sliding without events, 0.1 s from u = v."""
    scene, strides = Rotary(FRICTION_LAWS[law]), np.array([0.5, 0.25, 0.125])
    p = constants(scene, (3,))
    exact, _ = ends(scene, Located(8), p, "drive", 0.1, tolerance=1e30, stride=np.full(3, 0.05))
    states, _ = ends(scene, Located(4), p, "drive", 0.1, tolerance=1e30, stride=strides)
    errors = np.max(np.abs(states / exact - 1), axis=0)
    assert slope_of(errors, strides) > 3.7, errors


def test_tolerance_governs_the_error():
    """Each step keeps its last terms under the tolerance: a hundred times tighter is at least fifty times closer."""
    tolerances = np.array([1e-4, 1e-6, 1e-8, 1e-14])
    states, _ = ends(DRILL, Located(), constants(DRILL, (4,)), "stuck", 0.5, stride=4.0, tolerance=tolerances)
    errors = np.max(np.abs(states / states[:, -1:] - 1), axis=0)[:-1]
    assert errors[-1] < 1e-7
    assert errors[0] / errors[-1] > 50**2


def test_the_motion_has_everything(motion):
    p, taken = motion
    slip, touching = taken.mode.T
    assert {-1.0, 0.0, 1.0} == set(slip)
    assert begins(p, taken).sum() >= 5
    assert np.any((slip == 0) & (touching == 1))


def test_lands_exactly(motion):
    """u = 0 after each friction event, x2 = delta as an impact begins, J = 0 as it ends, x1', x2' = 0 at the turns."""
    p, taken = motion
    _, v1, x2, v2 = taken.after.T
    friction, contact, bit_turns, striker_turns = taken.hits.T
    assert np.all(v1[friction] + float(p["v"][0]) == 0)
    assert np.all(x2[begins(p, taken)] == float(p["delta"][0]))
    parts = contact & (taken.mode[:, 1] == 1)
    assert parts.sum() >= 5
    np.testing.assert_allclose(x2[parts] - float(p["delta"][0]), -float(p["relaxation"][0]) * v2[parts], atol=1e-17)
    assert np.all(v1[bit_turns & ~friction] == 0)
    assert np.all(v2[striker_turns] == 0)


def test_steps_follow_one_another(motion):
    """Each starts where and when the last ended: events are in the order of time, and nothing is left out."""
    _, taken = motion
    np.testing.assert_array_equal(taken.polynomials[1:, :, 0], taken.after[:-1])
    np.testing.assert_allclose(taken.start[1:], (taken.start + taken.dt)[:-1], rtol=0, atol=1e-15)
    assert taken.start[-1] + taken.dt[-1] == pytest.approx(2.0, abs=1e-15)


def test_no_surface_is_crossed_unseen(motion):
    """Inside each step, at 64 instants: sliding keeps its sign, stick holds (5.11), and J > 0 just where they touch."""
    p, taken = motion
    p = {name: float(np.ravel(value)[0]) for name, value in p.items()}
    moved = taken.dt > 0
    tau = (taken.dt / taken.h)[moved, None] * np.linspace(0, 1, 64)
    x1, v1, x2, v2 = sum(
        c[:, :, None] * tau[:, None] ** k for k, c in enumerate(np.moveaxis(taken.polynomials[moved], 2, 0))
    ).transpose(1, 0, 2)
    slip, touching = (m[:, None] for m in taken.mode[moved].T)
    force = touching * (p["k0"] * (x2 - p["delta"]) + p["c0"] * v2)
    pull = p["k2"] * (x2 - x1) - p["k1"] * x1
    in_hand = p["mu"] * p["m1"] * p["g"] + p["mu"] * force - np.abs(pull)
    assert np.all(slip * (v1 + p["v"]) > -1e-12)
    assert np.all(np.where(slip == 0, in_hand, 0) > -1e-7)
    assert np.all(force > -1e-7)
    # Let go, the striker is above delta while it gets away: contact needs x2 >= delta and a positive force.
    could_touch = np.minimum(x2 - p["delta"], x2 - p["delta"] + p["relaxation"] * v2)
    assert np.all((1 - touching) * could_touch < 1e-14)


def test_energy_ledger(motion):
    """Work of the drive: integral of F v = integral of F u + c2 x2'² + J x2', plus the change of energy (contract).

    By Gauss's rule on the steps' polynomials, with F from eqs. 5.9 and 5.12 in slip and the springs' pull in stick.
    """
    p, taken = motion
    p = {name: float(np.ravel(value)[0]) for name, value in p.items()}
    nodes, weights = np.polynomial.legendre.leggauss(12)
    tau = (taken.dt / taken.h)[:, None] * (nodes + 1) / 2
    weights = taken.dt[:, None] * weights / 2
    x1, v1, x2, v2 = sum(
        c[:, :, None] * tau[:, None] ** k for k, c in enumerate(np.moveaxis(taken.polynomials, 2, 0))
    ).transpose(1, 0, 2)
    slip, touching = (m[:, None] for m in taken.mode.T)
    u, weight = v1 + p["v"], p["m1"] * p["g"]
    force = touching * (p["k0"] * (x2 - p["delta"]) + p["c0"] * v2)
    ratio = np.abs(u) / p["v_cr"]
    sliding = slip * (p["mu"] * weight * (1 - ratio + ratio**3 / 3) + p["mu"] * force)
    friction = np.where(slip == 0, p["k2"] * (x2 - x1) - p["k1"] * x1, sliding)
    given = np.sum(weights * friction * p["v"])
    spent = np.sum(weights * (friction * u + p["c2"] * v2**2 + force * v2))

    def energy(x1, v1, x2, v2):
        kinetic = p["m1"] * v1**2 + p["m2"] * v2**2
        return (kinetic + p["k1"] * x1**2 + p["k2"] * (x1 - x2) ** 2) / 2

    change = energy(*taken.after[-1]) - energy(*taken.polynomials[0, :, 0])
    assert abs(given) > 100
    assert given == pytest.approx(spent + change, rel=1e-8)


@pytest.fixture(scope="module")
def free_top():
    """Time of the striker's first turn at the top, and how high it comes, without contact."""
    _, taken = run("stuck", 2.0, delta=1.0)
    first = np.flatnonzero(taken.hits[:, 3] & taken.falling[:, 1])[0]
    x1, _, x2, _ = taken.after[first]
    return taken.start[first] + taken.dt[first], x1, x2


@pytest.mark.parametrize("above", [1e-9, 1e-12, 1e-15, 0.0, -1e-15, -1e-12, -1e-9])
def test_grazing(free_top, above):
    """The gap lies `above` where the free striker turns: no impact, or one at x2' = sqrt(2 a |above|) and no stall."""
    when, x1, top = free_top
    p, taken = run("stuck", when + 0.02, delta=top + above)
    _, free = run("stuck", when + 0.02, delta=1.0)
    impacts = taken.after[begins(p, taken)][:, 3]
    deceleration = float(p["k2"][0] * p["inverse_m2"][0]) * (top - x1)
    expected = np.sqrt(2 * deceleration * max(-above, 0))
    if abs(above) >= 1e-12:
        assert len(impacts) == (above < 0)
    np.testing.assert_allclose(impacts, expected, rtol=1e-2, atol=1e-6)
    assert len(taken.dt) < len(free.dt) + 30
    np.testing.assert_allclose(taken.after[-1], free.after[-1], rtol=0, atol=20 * expected + 1e-6)


@pytest.mark.parametrize("c0", [0.0, 1e2, 1e4, 4e4, 5e4, 7e4, 1.4e5, 2e5])
def test_chatter_comes_to_rest(c0):
    """v = 0, so the striker bounces on the bit until it rests there: restitution from 1 to next to 0."""
    for v in (0.0, 0.5):
        _, taken = run("drive", 2.0, c0=c0, v=v)
        assert taken.start[-1] + taken.dt[-1] == pytest.approx(2.0)
        assert len(taken.dt) < 1500


def test_resting_striker_stays_at_rest_without_steps():
    """Pressed on the bit by the preload: k2 x2 = k0 (delta - x2); 48 s at one step a contact rate would be 34,000."""
    p = constants(DRILL)
    k0, k2, delta = (float(Flat(p)[name][0]) for name in ("k0", "k2", "delta"))
    _, taken = run((0.0, 0.0, k0 * delta / (k0 + k2), 0.0), 48.0, v=0.0)
    assert len(taken.dt) < 10
    _, taken = run("drive", 48.0, v=0.0, delta=0.005)
    assert len(taken.dt) == 1


@pytest.mark.parametrize(
    ("start", "values"),
    [
        ("stuck", {"beta": 0.63, "gamma": 1.7, "v": 1.23, "delta": -0.0048, "k0": 1e10, "c0": 100, "c2": 2e3, "mu": 1}),
        ("drive", {"beta": 0.2742, "gamma": 1.7444, "v": 0.0393, "delta": -0.0161, "k0": 1e9, "c0": 0.0}),
    ],
)
def test_stick_ends_in_a_stiff_contact(start, values):
    """The stick limit falls with J, whose roundings are k0 times those of x2: the step must not be halved for ever."""
    assert ends(DRILL, Located(), constants(DRILL, **values), start, 0.5)[1] < 20_000


@pytest.mark.parametrize("start", [(0.003, -1.495, 0.0, 1.0), (0.03, -1.4, 0.0, 1.0)])  # the bit stays, or turns back
@pytest.mark.parametrize("shift", [0.0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-9, -1e-9])
def test_simultaneous_switches(start, shift):
    """The gap is where the striker is as the bit stops: the two switches fall together, in either order."""
    _, free = run(start, 0.5, delta=1.0)
    stop = np.flatnonzero(free.hits[:, 0])[0]
    end, gap = free.start[stop] + free.dt[stop] + 0.02, free.after[stop, 2]
    assert gap > 0
    assert free.after[stop, 3] > 0.5
    assert free.mode[stop + 1, 0] == (0 if start[0] < 0.01 else -1)
    p, taken = run(start, end, delta=gap + shift)
    beside, nearby = run(start, end, delta=gap + 1e-7)
    assert begins(p, taken).sum() == begins(beside, nearby).sum() == 1
    assert len(taken.dt) < len(nearby.dt) + 20
    np.testing.assert_allclose(taken.after[-1], nearby.after[-1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("part", [0.999, 0.9, 0.5, 0.0])
def test_turns_within_a_step(part):
    """x2' dips below zero and comes back well within a step: both turns are landed on.

    While x1 overtakes x2, x2' = e - w² a t + w² x1' t²/2, whose least value is e - w² a²/(2 x1').
    """
    p = constants(DRILL)
    behind, speed = 0.002, 1.0
    dip = float(p.drill.k2[0] * p.drill.inverse_m2[0]) * behind**2 / (2 * speed)
    _, taken = run((-behind, speed, 0.0, part * dip), 0.006, delta=1.0)
    turns = np.flatnonzero(hits(taken)["striker_turn"])
    assert len(turns) == (2 if part > 0 else 1)
    np.testing.assert_allclose(taken.after[turns, 3], 0, atol=1e-15)
    assert len(taken.dt) < 10


V, DELTA = 1.5, -0.005


@pytest.mark.parametrize(
    ("start", "slip", "touching"),
    [
        ((0.001, -V, -0.02, 0.0), 0, 0),  # at rest on the rock, within the limit
        ((0.01, -V, -0.02, 0.0), -1, 0),  # beyond it: the springs pull it back
        ((-0.01, -V, -0.02, 0.0), 1, 0),
        ((0.0, 0.0, DELTA, 1.0), 1, 1),  # at the gap, going in
        ((0.0, 0.0, DELTA, -1.0), 1, 0),  # and out
        ((0.0, 0.0, DELTA, 0.0), 1, 1),  # at rest there, and drawn in
        ((-0.01, 0.0, DELTA, 0.0), 1, 0),  # and out
        ((0.0, -V, DELTA, 1.0), 0, 1),  # on both surfaces
        ((DELTA, -V, DELTA, 0.0), 0, 0),  # and at rest on both
    ],
)
def test_start_on_a_surface(start, slip, touching):
    _, taken = run(start, 0.05)
    assert tuple(taken.mode[0]) == (slip, touching)
    assert len(taken.dt) < 300
    nudged = tuple(y + 1e-10 * sign for y, sign in zip(start, (1, 1, -1, 1), strict=True))
    _, nearby = run(nudged, 0.05)
    np.testing.assert_allclose(taken.after[-1], nearby.after[-1], rtol=0, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("touching", [False, True])
def test_slip_that_ends_as_it_begins(dtype, touching):
    """A spring force beyond the stick limit that falls below it at once: a few steps, however little it is beyond."""
    beyond = 10.0 ** np.arange(-17, -1, dtype=float)
    lanes = beyond.shape
    p = constants(DRILL, lanes, delta=0.0 if touching else 1.0)
    c = jax.tree.map(lambda value: jnp.asarray(value, dtype), p)
    p = Flat(c)
    impact = 1000.0 * touching
    limit = p["stick_limit"] + p["stick_gain"] * impact
    x2 = jnp.full(lanes, impact / 5e7, dtype)
    x1 = (limit * (1 + jnp.asarray(beyond, dtype)) + p["k2"] * x2) / (p["k1"] + p["k2"])
    zero = jnp.zeros(lanes, dtype)
    state = (x1, -p["v"], x2, zero)
    settings = Accuracy(*(jnp.asarray(value, dtype) for value in FINE._replace(tolerance=3e-6)))
    reached, steps = end_states(DRILL, Located(), c, state, settings, jnp.asarray(0.004, dtype))
    assert np.all(np.isfinite(reached))
    assert np.max(steps) < 100
