"""Families of masses at rigid stops, against closed forms: where orbits appear, double, graze and go on."""

from functools import partial

import numpy as np
import pytest
import systems
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve
from systems import BALL, IMPACT_OSCILLATOR, WALLS, cos, mass, oscillator_orbits, special_values, system

import vibrojax as vj

OSCILLATOR = {"w": 0.9, "stiffness": 1.0, "damping": 0.1, "stop": 1.0}
R = 0.7
GRAZE = systems.oscillator_grazes(**OSCILLATOR)


def test_branch_continues_past_graze_where_impact_vanishes():
    """Downwards, orbits with one impact per period double and end at the closed forms. The doubled branch loses its
    slow impact where the motion after the other impact, in closed form, touches the stop. From there, orbits with one
    impact in two periods lead down to the graze of the motion without impacts."""
    family = vj.follow(IMPACT_OSCILLATOR, along="a", at=0.61, span=(0.2, 0.65), cycles=2, progress=False)
    doubles = systems.oscillator_doubles((1.5 * GRAZE, 3 * GRAZE), R, **OSCILLATOR)
    assert special_values(family, "period-doubling") == pytest.approx([doubles], rel=1e-8)
    [graze] = special_values(family, "grazing")
    assert abs(graze - GRAZE) < 1e-8
    slow, last = special_values(family, "grazing", branch=1)
    assert abs(slow - brentq(distance_at_other_maximum, 0.54, 0.58, xtol=1e-13)) < 1e-8
    assert abs(last - GRAZE) < 1e-8
    assert len(special_values(family, "fold", branch=1)) == 1  # the branch is not retraced


def distance_at_other_maximum(a):
    """Return the distance to the stop at the other maximum of the orbit with one impact in two periods."""
    w, stop = OSCILLATOR["w"], OSCILLATOR["stop"]
    orbit = oscillator_orbits(a, R, **OSCILLATOR, n=2)[-1]
    forced = a / complex(OSCILLATOR["stiffness"] - w**2, OSCILLATOR["damping"] * w)
    decay = complex(-OSCILLATOR["damping"] / 2, np.sqrt(OSCILLATOR["stiffness"] - (OSCILLATOR["damping"] / 2) ** 2))
    u = stop - (forced * np.exp(1j * orbit.phase)).real
    q = -R * orbit.speed - (1j * w * forced * np.exp(1j * orbit.phase)).real
    free = complex(u, (decay.real * u - q) / decay.imag)  # Re(free) = u, Re(decay free) = q

    def x(t, order=0):
        driven = (1j * w) ** order * forced * np.exp(1j * (w * t + orbit.phase))
        return (decay**order * free * np.exp(decay * t) + driven).real

    t = np.linspace(0.05, 0.95, 400) * 4 * np.pi / w
    rising = x(t, 1) > 0
    tops = [brentq(x, t[k], t[k + 1], (1,), xtol=1e-13) for k in np.flatnonzero(rising[:-1] & ~rising[1:])]
    return stop - max(x(top) for top in tops)


def test_family_continues_where_impact_passes_section():
    """The impact occurs at the maximum of the force, t = 0, where the state at the section jumps."""
    fixed = {"a": 1.0, "stop": 0.5, "stiffness": 1.0, "damping": 0.1}
    family = vj.follow(IMPACT_OSCILLATOR, along="w", at=1.1, span=(0.9, 1.2), cycles=1, progress=False, a=1.0, stop=0.5)
    passed = brentq(lambda w: np.sin(oscillator_orbits(R=R, w=w, **fixed)[-1].phase), 0.9, 1.1)
    assert special_values(family, "section") == pytest.approx([passed], abs=1e-8)
    main = family.branch.values == 0
    assert {0.9, 1.2} <= set(family.w.values[main].tolist())
    for w, x in zip(family.w.values[main][::4], family.orbit_x.values[main][::4], strict=True):
        assert min(abs(x - orbit.section[0]) for orbit in oscillator_orbits(R=R, w=w, **fixed)) < 1e-8


@pytest.mark.long
def test_rotations_of_a_pendulum_whose_angle_jumps_back():
    """The angle returns to -pi at pi. Rotations at the torque 1.5 lose their period at a homoclinic orbit. Distances
    shrink by exp(-c t) (Liouville), all of them across the flow."""
    turn = vj.Impact("turn", lambda t, y, p: np.pi - y["phi"], reset=lambda t, y, p: {"phi": y["phi"] - 2 * np.pi})
    field = lambda t, y, p: {"phi": y["w"], "w": p["torque"] - p["c"] * y["w"] - vj.elementary.sin(y["phi"])}
    states, parameters = {"phi": "rad", "w": "rad s-1"}, {"torque": 1.5, "c": 0.5}
    pendulum = system(states, field, turn, parameters=parameters, section="phi")
    family = vj.follow(pendulum, along="torque", at=1.5, span=(0.2, 3.0), start=[0.0, 3.0], cycles=1, progress=False)
    assert family.torque.values.min() == pytest.approx(0.597383, abs=1e-5)
    assert family.torque.values.max() == pytest.approx(3.0, rel=1e-12)
    assert family.period.values[family.torque.values.argmin()] > 30
    # Next to the homoclinic orbit, where the motion rests near the saddle, an error of the state of 1e-12 decides.
    far = family.isel(point=family.period.values < 20)
    np.testing.assert_allclose(far.multiplier_abs[:, 0], np.exp(-0.5 * far.period), rtol=1e-6, atol=1e-9)
    assert far.sizes["point"] > 70


def test_family_goes_on_where_an_angle_jumps_back_at_the_section():
    """At the forcing 1.2241 the angle is -pi as the period begins. The reference is Newton's method on the motion
    without jumps, at relative tolerance 1e-11."""
    events = [
        vj.Impact("up", lambda t, y, p: np.pi - y["x"], reset=lambda t, y, p: {"x": y["x"] - 2 * np.pi}),
        vj.Impact("down", lambda t, y, p: np.pi + y["x"], reset=lambda t, y, p: {"x": y["x"] + 2 * np.pi}),
    ]
    rate = lambda t, y, p: p["g"] * cos(2 / 3 * t) - 0.5 * y["v"] - vj.elementary.sin(y["x"])
    pendulum = mass(rate, *events, name="forced-pendulum", parameters={"g": 1.2}, period=3 * np.pi)
    orbit = {"states": [-3.1015250230, 0.7606582105], "period": 3 * np.pi}
    family = vj.follow(
        pendulum, along="g", at=1.2116256715788802, span=(1.2, 1.4), orbit=orbit, cycles=1, progress=False
    )
    assert special_values(family, "end").tolist() == [1.2, 1.4] and len(special_values(family, "section")) == 1
    last = family.isel(point=-1)
    assert [float(last.orbit_x), float(last.orbit_v)] == pytest.approx([2 * np.pi - 3.55828588, 0.53843125], abs=1e-8)


def masses(t, y, p):
    """Return the rates of a shaken mass and of a second one on it."""
    pull = 2 * (y["x2"] - y["x1"]) + 0.1 * (y["v2"] - y["v1"])
    first = 0.4 * cos(p["w"] * t) - y["x1"] - 0.1 * y["v1"] + pull
    return {"x1": y["v1"], "v1": first, "x2": y["v2"], "v2": -2 * pull}


MOVING_STOP = system(
    ("x1", "v1", "x2", "v2"),
    masses,
    vj.Impact("stop", lambda t, y, p: 0.6 + p["e"] * cos(p["w"] * t + 0.5) - y["x2"], velocity="v2", restitution=0.7),
    name="moving-stop",
    parameters={"w": 1.0, "e": 0.1},
    period=lambda p: 2 * np.pi / p["w"],
)


def misses_moving_stop(w, e):
    """Return the amplitude of the gap without impact, which is linear, less its mean."""
    stiffness, mass_matrix = np.array([[3.0, -2.0], [-2.0, 2.0]]), np.diag([1.0, 0.5])
    dynamic = stiffness + 1j * w * np.array([[0.2, -0.1], [-0.1, 0.1]]) - w**2 * mass_matrix
    return abs(np.linalg.solve(dynamic, [0.4, 0.0])[1] - e * np.exp(0.5j)) - 0.6


@pytest.mark.long
def test_graze_of_two_masses_is_exact_over_two_parameters():
    """The motion without impact is linear. At e = 0.123 a step ends 1e-11 before the stop."""
    begin = {"along": "w", "start": [0.0] * 4, "cycles": 1, "progress": False}
    family = vj.follow(MOVING_STOP, at=1.5, span=(1.12, 1.6), **begin, e=0.12)
    [graze] = special_values(family, "grazing")
    assert graze == pytest.approx(brentq(misses_moving_stop, 1.1, 1.2, args=(0.12,)), abs=1e-9)
    special = int(np.flatnonzero(family.special_value.values == graze)[0])
    curve = vj.curves(family, by="e", span=(0.115, 0.15), special=special, progress=False)
    assert (curve.e.values.min(), curve.e.values.max()) == (0.115, 0.15)
    assert max(abs(misses_moving_stop(*x)) for x in zip(curve.w.values, curve.e.values, strict=True)) < 1e-9


LONGER = [pytest.param(phase, 0.008, marks=pytest.mark.long) for phase in (0.0, 1.0)]


@pytest.mark.parametrize(("phase", "last"), [(0.0, 0.005), *LONGER])
def test_fold_and_period_doubling_of_ball_on_shaken_table(phase, last):
    """At the fold the impact has the phase 0, that of the section if `phase` is 0. Upwards, impacts appear one by one.
    After each graze the orbits double and turn back once, so near the branch before that a step could lead there. The
    branch leads to rest, which ends where the table throws the ball."""
    w, g, R, a = 60.0, 9.81, 0.4, 0.0045
    fold, doubles = systems.ball_appears(R) * g / w**2, systems.ball_doubles(R) * g / w**2
    table = vj.Impact("table", lambda t, y, p: y["x"] - p["a"] * cos(w * t + phase - np.pi / 2), "v", R)
    ball = mass(lambda t, y, p: -g, table, parameters={"a": a}, period=2 * np.pi / w)
    above, T = np.arccos(fold / a), 2 * np.pi / w
    remaining, speed = T - (above - phase) % (2 * np.pi) / w, g * T / 2
    start = [a * np.sin(above) + speed * remaining - g / 2 * remaining**2, speed - g * remaining]
    family = vj.follow(ball, along="a", at=a, span=(0.002, last), start=start, cycles=1, progress=False)
    assert special_values(family, "fold")[-1] == pytest.approx(fold, rel=1e-8)
    assert special_values(family, "period-doubling")[-1] == pytest.approx(doubles, rel=1e-8)
    assert (np.diff(family.impacts[family.a > 0.00479]) <= 0).all() and len(special_values(family, "section")) <= 6
    if last > 0.0069:  # the first graze
        assert special_values(family, "grazing").min() == pytest.approx(g / w**2, abs=1e-8)  # of the ball at rest
        points, doublings = family.a[family.stable == 1].values, special_values(family, "period-doubling")
        for low in (x for x in special_values(family, "fold") if x > 0.00479):  # stable windows, however narrow
            assert ((points > low) & (points < doublings[doublings > low].min())).any()


@pytest.mark.parametrize("at", [pytest.param(0.27, marks=pytest.mark.long), 0.3])
def test_end_of_chatter_is_no_graze(at):
    """A ball leaves the table where its acceleration exceeds gravity. The end of its bounces passes the section at the
    amplitude 0.3218; further bounces before rest appear as the amplitude grows."""
    family = vj.follow(BALL, along="a", at=at, span=(0.2, 0.35), start=[0.0, 0.0], cycles=1, progress=False)
    assert special_values(family, "grazing") == pytest.approx([9.81 / (2 * np.pi) ** 2], abs=1e-8)
    begin = {"states": [-at * (1 + 1e-13), 0.0], "period": 1.0}  # at rest on the table, as the family gives it
    again = vj.follow(BALL, along="a", at=at, span=(0.26, 0.31), orbit=begin, cycles=1, progress=False)
    assert special_values(again, "end").tolist() == [0.26, 0.31]


def test_graze_is_the_same_from_both_sides():
    """The orbit with one impact at each wall grazes both, where a branch with two impacts at each leads to it. On the
    side of two impacts, multipliers grow as the square of the inverse velocity of these impacts."""
    [smooth], [steep] = (
        special_values(vj.follow(WALLS, along="d", at=0.4, span=span, start=start, cycles=1, progress=False), "grazing")
        for start, span in (([0.2, -0.6], (0.29, 0.41)), ([0.1, 0.3], (0.29, 0.46)))
    )
    assert steep == pytest.approx(smooth, rel=1e-10)


@pytest.mark.parametrize(
    ("d", "at", "start", "value"),
    [
        (0.341, 0.85, [0.1, 0.3], 0.865514886644253),
        (0.34, 0.69, [0.0, 0.0], 0.685333635132339),  # steps become short
        (0.34, 0.74, [0.0, 0.0], 0.685333635132339),  # rounding errors lead past the point
    ],
)
def test_branch_point_is_the_same_from_both_branches(d, at, start, value):
    """At this restitution twins leave a symmetric orbit, at d = 0.341 within 1e-3 of their swing. The family begins on
    the symmetric orbit or on a twin. Its branches end at the bounds, the twins on one side."""
    bounds = {"span": (0.6, 0.99), "settle": 2000.0}
    family = vj.follow(WALLS, along="r", at=at, start=start, d=d, cycles=1, progress=False, **bounds)
    [crossing] = np.concatenate([special_values(family, "branch-point", branch) for branch in (0, 1)])
    ends = [sorted(special_values(family, "end", branch)) for branch in (0, 1)]
    assert crossing == pytest.approx(value, abs=1e-12) and sorted(ends) == [[0.6, 0.99], [0.99, 0.99]]


def grazes_against_friction(w, damping, stop, grip):
    """Return the amplitude of the force at which a mass on a spring reaches the stop at rest."""
    half = expm(np.array([[0.0, 1.0], [-1.0, -damping]]) * np.pi / w)
    off = np.linalg.solve(np.eye(2) + half, (half - np.eye(2)) @ [grip, 0.0])
    return np.hypot(stop - off[0], off[1] / w) * abs(complex(1 - w**2, damping * w))


RUBBED = mass(
    lambda t, y, p: p["a"] * cos(p["w"] * t) - 2 * p["zeta"] * y["v"] - y["x"],
    vj.Impact("wall", lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=lambda p: p["r"]),
    vj.Friction("base", lambda t, y, p: y["v"], lambda t, y, p: p["mu"], 1.0, "v"),
    parameters={"a": 1.0, "zeta": 0.05, "d": 0.6, "r": 0.7, "mu": 0.2, "w": 0.9},
    period=lambda p: 2 * np.pi / p["w"],
)
"""A shaken mass on a spring that rubs and hits a wall."""


def test_branches_pass_and_join_at_a_graze_against_friction():
    """Friction turns the mass where it grazes, so that two events coincide. The amplitude there is known. From the
    greatest to the least position, the distance from the forced oscillation and from the equilibrium under friction
    obeys the flow of the free oscillation (Den Hartog, Transactions of the ASME 53 (1931), 107). The branch of one
    impact in two periods joins the motion without impact there. Along the frequency, the branch turns back at the graze
    and leads on without impacts; there are two impacting orbits up to a fold."""
    graze = partial(grazes_against_friction, damping=0.1, stop=0.6, grip=0.2)
    family = vj.follow(RUBBED, along="a", at=1.0, span=(0.25, 2.0), cycles=2, progress=False)
    assert special_values(family, "grazing") == pytest.approx([graze(0.9)], abs=1e-8)
    assert special_values(family, "grazing", branch=1)[-1] == pytest.approx(graze(0.9), abs=1e-10)
    assert special_values(family, "end").tolist() == [0.25, 2.0] and not len(special_values(family, "end", branch=1))
    family = vj.follow(RUBBED, along="w", at=1.5, span=(1.3, 2.1), progress=False)
    turn = brentq(lambda w: graze(w) - 1.0, 1.3, 2.0, xtol=1e-14)
    assert special_values(family, "grazing") == pytest.approx([turn], abs=1e-8)
    assert special_values(family, "end").tolist() == [1.3, 2.1] and len(special_values(family, "fold")) == 1


FIRST, SECOND = (0.5375127342607715, [0.48732077, -0.28777351], 0.5), (0.85, [0.64, 0.12], 0.9)


@pytest.mark.parametrize(("at", "states", "near"), [FIRST, pytest.param(*SECOND, marks=pytest.mark.long)])
def test_no_step_leads_over_a_graze_and_a_fold(at, states, near):
    """Between them three orbits coexist, in the second case within 1e-5. A step could lead over both."""
    w, span = 0.4940463346155941, (0.4155952563264156, 1.038988140816039)
    fixed = {"a": 0.9670313078557167, "zeta": 0.037390504262386035, "r": 0.5457002440122073, "mu": 0.0377447662751558}
    begin = {"at": at, "orbit": {"states": states, "period": 2 * np.pi / w}}
    family = vj.follow(RUBBED, along="d", span=span, cycles=1, progress=False, w=w, **begin, **fixed)
    [fold] = [x for x in special_values(family, "fold") if abs(x - near) < 0.02]
    assert special_values(family, "grazing").min() < fold
    assert family.multiplier_abs[np.abs(family.d.values - fold).argmin(), 0] == pytest.approx(1.0, abs=1e-4)


OTHER_SIDE = pytest.param(2.1016626655, [-0.6736863982, 0.3782824034], marks=pytest.mark.long)


@pytest.mark.parametrize(("at", "states"), [(2.3216075, [-0.5568880757, 0.2205922152]), OTHER_SIDE])
def test_end_at_a_graze_against_friction_is_the_same_from_both_sides(at, states):
    """Orbits of one impact in two periods end where the mass without impacts grazes; rounding errors make it stick."""
    a, zeta, stop, grip = 1.3478945560663065, 0.11624693203868956, 0.36831794778351135, 0.23061673176405711
    fixed = {"a": a, "zeta": zeta, "d": stop, "r": 0.4673012773751276, "mu": grip}
    begin = {"at": at, "orbit": {"states": states, "period": 4 * np.pi / at}}
    family = vj.follow(RUBBED, along="w", span=(2.0, 2.4), cycles=1, progress=False, **begin, **fixed)
    graze = brentq(lambda w: grazes_against_friction(w, 2 * zeta, stop, grip) - a, 2.0, 2.2)
    assert special_values(family, "grazing").min() == pytest.approx(graze, abs=1e-9)
    assert not len(special_values(family, "stick"))


def test_branch_of_twice_the_period_ends_where_the_orbit_doubles():
    """A family that begins with one impact in two periods leads to a doubling in closed form, and does not go back."""
    family = vj.follow(IMPACT_OSCILLATOR, along="r", at=0.7, span=(0.0, 1.5), a=0.5, progress=False, cycles=2)
    product = lambda r: np.prod(1 + oscillator_orbits(0.5, r, **OSCILLATOR)[-1].multipliers).real
    doubles = brentq(product, 0.6, 0.62, xtol=1e-15)
    assert special_values(family, "period-doubling") == pytest.approx([doubles], abs=1e-10)
    assert len(special_values(family, "fold")) == len(special_values(family, "grazing")) == 1
    assert special_values(family, "end").tolist() == [1.0]
    assert "motions beyond are refused: restitution not 0 to 1" in family.special_note.values


def test_family_goes_on_where_an_impact_passes_the_section():
    """At r = 0.928 the mass leaves the right wall as the period begins. The symmetric orbit is known in closed form."""
    family = vj.follow(WALLS, along="r", at=0.8, span=(0.8, 0.95), start=[0.0, 0.0], d=0.5, cycles=1, progress=False)
    last = family.isel(point=int(family.r.values.argmax()))
    [passed] = special_values(family, "section")
    X, decay, half = 1 / (0.19 + 0.054j), -0.03 + 1j * 0.9991**0.5, np.pi / 0.9

    def misses(unknown):
        """From the right wall, half a period leads to the left one, with the speed of the impact before."""
        force, speed = X * np.exp(1j * unknown[0]), unknown[1]
        begin = [0.5 - force.real, -r * speed + 0.9 * force.imag]
        free = np.linalg.solve([[1.0, 0.0], [decay.real, -decay.imag]], begin)
        free = (free[0] + 1j * free[1]) * np.exp(decay * half)
        return free.real - force.real + 0.5, (decay * free).real + 0.9 * force.imag + speed

    for r, found in ((0.8, family.isel(point=int(family.r.values.argmin()))), (0.95, last)):
        [_, speed], _, end, _ = fsolve(misses, [0.0, float(found.impact_velocity)], xtol=1e-13, full_output=True)
        assert end == 1 and float(found.r) == r and float(found.impact_velocity) == pytest.approx(speed, rel=1e-9)
    assert 0.92 < passed < 0.93 and float(last.orbit_v) > 0


STICKS_AT_STOP = mass(
    lambda t, y, p: cos(0.8 * t) - y["x"] - 0.05 * y["v"],
    vj.Friction("rub", lambda t, y, p: y["v"], lambda t, y, p: 1.0, law=0.2, static=0.25, acts_on="v"),
    vj.Impact("stop", lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=lambda p: p["r"]),
    parameters={"d": 0.8, "r": 0.7},
    period=2.5 * np.pi,
)


@pytest.mark.parametrize("at", [pytest.param(0.7, marks=pytest.mark.long), 0.3])
def test_bounce_that_vanishes_with_the_restitution_is_no_graze(at):
    """At small r the mass sticks next to the stop or rests on it; one impact in a period remains, as r = 0 has it."""
    span = (0.0, 0.5 + at / 2)
    family = vj.follow(STICKS_AT_STOP, along="r", at=at, span=span, start=[0, 0], cycles=1, progress=False)
    assert set(family.impacts.values) == {1} and not len(special_values(family, "grazing"))
    assert not (special_values(family, "stick") < 0.5).any()


BESIDE = pytest.param(0.95, True, 1.1005, marks=pytest.mark.long)


@pytest.mark.parametrize(("at", "sticks", "near"), [(0.8, True, 1.1005), BESIDE, (1.3, False, 1.1007)])
def test_branch_ends_where_greater_static_friction_makes_the_motion_jump(at, sticks, near):
    """A mass that slides slower and slower until it touches rest sticks at once, until the drive exceeds 0.25."""
    family = vj.follow(STICKS_AT_STOP, along="d", at=at, span=(0.7, 1.5), start=[0, 0], cycles=1, progress=False)

    def slide(begin, x, v, push):
        """Return position and velocity after `begin` [s]; `push`: friction."""
        decay, forced = complex(-0.025, np.sqrt(1 - 0.025**2)), 1 / complex(1 - 0.8**2, 0.05 * 0.8)
        u, q = x - push - (forced * np.exp(0.8j * begin)).real, v - (0.8j * forced * np.exp(0.8j * begin)).real
        free = complex(u, (decay.real * u - q) / decay.imag)

        def state(t):
            own, driven = free * np.exp(decay * (t - begin)), forced * np.exp(0.8j * t)
            return np.array([(own + driven).real + push, (decay * own + 0.8j * driven).real])

        return state

    def equations(unknowns):
        """Return the velocity at the touch, and state minus stop and speed after one period; impact at `t0`."""
        t0, speed, d = unknowns
        state = slide(t0, d, -0.7 * speed, 0.2)
        touch = brentq(lambda t: np.cos(0.8 * t) - state(t) @ [1.0, 0.05] + 0.2, 1.8, 2.5, xtol=1e-15)
        x, v = state(touch)
        if sticks:
            slips = brentq(lambda t: np.cos(0.8 * t) - x + 0.25, touch, touch + 0.5, xtol=1e-15)
            state = slide(slips, x, 0.0, 0.2)
        turns = brentq(lambda t: state(t)[1], touch + 0.5, 5.5, xtol=1e-15)
        return [v, *slide(turns, state(turns)[0], 0.0, -0.2)(t0 + 2.5 * np.pi) - [d, speed]]

    last = fsolve(equations, [-0.0286, 1.5574, near], xtol=1e-12)[2]
    end = family.sortby("special_value").isel(special=-1 if sticks else 0)
    assert (str(end.special_note.values), end.special_value) == ("the family ends here", pytest.approx(last, abs=1e-9))
    assert special_values(family, "stick")[-1 if sticks else 0] == end.special_value


def test_rub_of_a_rotor_begins_all_along_its_circle():
    """A rotor z whirls on a circle; outside the radius d, a stator pushes it back and rubs. Where the circle without
    contact has the radius d, the side of the stator changes along the whole orbit at once. The response leans over, so
    that the branch turns back at the second of these speeds."""
    damping, stator, rub, d, e = 0.3, 3.0, 0.1, 0.6, 0.3

    def rates(t, y, p, s):
        push = (1 + s["rub"]) / 2 * stator * (1 - d / vj.elementary.sqrt(y["x"] ** 2 + y["y"] ** 2))
        x = e * p["w"] ** 2 * cos(p["w"] * t) - damping * y["u"] - y["x"] - push * (y["x"] - rub * y["y"])
        z = e * p["w"] ** 2 * vj.elementary.sin(p["w"] * t) - damping * y["v"] - y["y"] - push * (y["y"] + rub * y["x"])
        return {"x": y["u"], "u": x, "y": y["v"], "v": z}

    radius = lambda t, y, p: vj.elementary.sqrt(y["x"] ** 2 + y["y"] ** 2) - d
    options = {"parameters": {"w": 1.0}, "period": lambda p: 2 * np.pi / p["w"], "events": [vj.Switch("rub", radius)]}
    rotor = vj.System("rotor", states=dict.fromkeys("xuyv", "1"), field=rates, **options)
    family = vj.follow(rotor, along="w", at=1.2, span=(0.8, 1.7), start=[0.7, 0.0, 0.0, 0.7], progress=False)
    whirl = lambda w: e * w**2 / abs(1 - w**2 + 1j * damping * w) - d
    begins = [brentq(whirl, low, high, xtol=1e-14) for low, high in ((0.8, 0.9), (1.3, 1.4))]
    np.testing.assert_allclose(np.sort(special_values(family, "rub")), begins, rtol=1e-9)
    np.testing.assert_allclose(np.sort(special_values(family, "end")), [0.8, 1.7])
    inside = family.w.values[np.hypot(family.orbit_x, family.orbit_y) < d - 1e-6]
    assert inside.min() < begins[0] and inside.max() > begins[1]


def test_family_goes_on_where_two_events_exchange_their_order():
    """The impact passes the instant at which the force jumps: the map is continuous, but not its derivative."""
    square = vj.Switch("square", lambda t, y, p: cos(0.9 * t + p["ph"]))
    wall = vj.Impact("wall", lambda t, y, p: 0.3 - y["x"], velocity="v", restitution=0.9)
    rate = lambda t, x, v, side: cos(0.9 * t - 1.5) + 0.8 * side - 0.05 * v - x
    field = lambda t, y, p, s: rate(t, y["x"], y["v"], s["square"])
    own = mass(field, square, wall, name="exchange", parameters={"ph": 2.0}, period=2 * np.pi / 0.9)
    family = vj.follow(own, along="ph", at=2.0, span=(1.8, 4.0), settle=900.0, cycles=1, progress=False)
    values, ph, stable = special_values(family, "grazing"), family.ph.values, family.stable.values
    value, turn, graze = sorted(values)
    assert sorted(family.special_value.values) == pytest.approx([1.8, value, turn, graze, 4.0], abs=1e-12)
    assert sum("exchange" in str(note) for note in family.special_note.values) == 2
    one, away = family.impacts.values == 1, abs(ph - value) > 1e-6
    np.testing.assert_array_equal(stable[one & away & (ph < graze)], ph[one & away & (ph < graze)] > value)
    assert abs(ph[one].max() - graze) < 1e-9 and abs(ph[~one].min() - turn) < 1e-9 and ph[~one].max() > 3.999
    state, begin = [float(family[f"orbit_{name}"][abs(ph - value).argmin()]) for name in "xv"], 0.0
    for jump in sorted((np.array([0.5, 1.5]) * np.pi - value) % (2 * np.pi) / 0.9):
        side = np.sign(np.cos(0.45 * (begin + jump) + value))
        rates = lambda t, y, side=side: [y[1], rate(t, *y, side)]
        state = solve_ivp(rates, (begin, jump), state, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        begin = jump
        if state[0] > 0.3 - 1e-7:
            break
    assert abs(state[0] - 0.3) < 1e-7


def test_family_ends_without_a_graze_where_two_impacts_coincide():
    """The state z fires at 1.5 and kicks the mass: before or after its impact at 0.8, which makes the map jump."""

    def rates(t, x, v, z, ph):
        return v, cos(0.9 * t) + 0.3 * z - 0.1 * v - x, 1.0 + 0.8 * cos(0.9 * t + ph) - 0.3 * z

    field = lambda t, y, p: dict(zip("xvz", rates(t, *(y[name] for name in "xvz"), p["ph"]), strict=True))
    wall = vj.Impact("wall", lambda t, y, p: 0.8 - y["x"], velocity="v", restitution=0.8)
    fires = vj.Impact("fires", lambda t, y, p: 1.5 - y["z"], reset=lambda t, y, p: {"z": 0 * y["z"], "v": y["v"] - 0.2})
    own = system("xvz", field, wall, fires, name="kicked", parameters={"ph": 0.0}, period=2 * np.pi / 0.9)
    family = vj.follow(own, along="ph", at=0.05, span=(0.0, 0.4), settle=900.0, cycles=1, progress=False)
    last = family.ph.values.argmax()
    assert not len(special_values(family, "grazing")) and 0.1468 < family.ph[last] < 0.1469
    assert "none grazes" in str(family.special_note.values[family.special_value.values.argmax()])
    y, t = [float(family[f"orbit_{name}"][last]) for name in "xvz"], 0.0
    gaps = lambda t, y, ph: 0.8 - y[0], lambda t, y, ph: 1.5 - y[2]
    for gap in gaps:
        gap.terminal, gap.direction = True, -1
    options = {"method": "DOP853", "events": gaps, "args": (float(family.ph[last]),), "rtol": 1e-12, "atol": 1e-13}
    x = z = 0.0
    while max(0.8 - x, 1.5 - z) > 1e-6:
        assert t < 7
        motion = solve_ivp(lambda t, y, ph: [*rates(t, *y, ph)], (t, 7.0), y, **options)
        x, v, z = motion.y[:, -1]
        y, t = ([x, -0.8 * v, z] if motion.t_events[0].size else [x, v - 0.2, 0.0]), motion.t[-1]


@pytest.mark.long
def test_loop_of_three_returns_closes_at_another_return():
    """After one turn the family is back at its first orbit, listed from another of its three returns."""
    table, positive = vj.parameters.table, vj.parameters.positive
    parameters = table(positive("mus", 0.4, "1", "static", "mus"), positive("vs", 0.3, "m s-1", "Stribeck", "vs"))
    falling = lambda u, p: 0.2 + (p["mus"] - 0.2) * vj.elementary.exp(-u / p["vs"])
    belt = mass(
        lambda t, y, p: 0.15 * cos(p["w"] * t) - 0.02 * y["v"] - y["x"],
        vj.Friction(
            "slip",
            relative=lambda t, y, p: y["v"] - 0.3,
            normal=lambda t, y, p: 1.0,
            law=vj.FrictionLaw(name="falling", reference="own", parameters=parameters, mu=falling),
            acts_on="v",
        ),
        vj.Impact("stop", lambda t, y, p: 0.5 - y["x"], velocity="v", restitution=0.6),
        name="belt",
        parameters={"w": 1.7},
        period=lambda p: 2 * np.pi / p["w"],
    )
    family = vj.follow(belt, along="w", at=1.7, span=(1.0, 3.0), start=[0.0, 0.0], cycles=1, progress=False)
    assert sorted(special_values(family, "grazing")) == pytest.approx([1.56692158, 1.61701058], abs=1e-7)
    assert sorted(special_values(family, "stick")) == pytest.approx([1.67144594, 1.89238109], abs=1e-7)
    assert (
        "back where it began" in family.special_note.values
        and not (family.special_note == "the family ends here").any()
    )
