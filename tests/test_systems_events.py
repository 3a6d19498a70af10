"""Systems whose events meet: jumps across the surfaces of other events, kinks, discrete states, and their refusals.

Right values are closed forms, or follow from an independent integration by SciPy (stated at the test).
"""

import functools

import numpy as np
import pytest
from refusals import refusal
from scipy.linalg import expm
from scipy.optimize import brentq
from systems import ends, events_of, mass, one_state

import vibrojax as vj

E = vj.elementary
cos = E.cos


# After a jump, everything is decided anew.

WALL = vj.Impact("wall", gap=lambda t, y, p: 1.0 - y["x"], velocity="v", restitution=0.5)
RUB = vj.Friction("rub", relative=lambda t, y, p: y["v"], normal=lambda t, y, p: 1.0, law=0.2, acts_on="v")


def test_block_rebounds_against_friction():
    """It arrives with vi² = v0² - 2 mu L after (v0 - vi)/mu, and stops at L - (r vi)²/(2 mu) = 0.625."""
    block = mass(lambda t, y, p: 0.0, WALL, RUB)
    motion, arrives = vj.simulate(block, start=[0.0, 1.0], duration=4.0, progress=False), 5 * (1 - np.sqrt(0.6))
    assert events_of(motion, "impact") == pytest.approx([arrives], abs=1e-8)
    assert events_of(motion, "stick") == pytest.approx([arrives + 2.5 * np.sqrt(0.6)], abs=1e-8)
    assert [float(motion.x[-1]), float(motion.v[-1])] == pytest.approx([0.625, 0.0], abs=1e-8)


def test_resets_cross_surface_of_switch():
    """A sawtooth x over a switch at 1/2, and a reset to 0 over a switch at 0.7, with q' = -q + s."""
    saw = vj.System(
        "saw",
        states={"x": "m", "y": "m", "q": "m"},
        parameters={"at": 0.5},
        field=lambda t, y, p, s: {"x": 1.0, "y": s["half"], "q": -y["q"] + s["half"]},
        period=1.0,
        events=[
            vj.Impact("wrap", gap=lambda t, y, p: 1.0 - y["x"], reset=lambda t, y, p: {"x": y["x"] - 1.0}),
            vj.Switch("half", lambda t, y, p: y["x"] - p["at"]),
        ],
    )
    assert ends(saw, [0.25, 0.0, 0.0], 2.5)[:2] == pytest.approx([0.75, 0.0], abs=1e-9)
    assert ends(saw, [0.2, 0.0, 0.0], 6.0, at=0.7)[2] == pytest.approx(-0.3278, abs=5e-5)


def test_kinks_are_located():
    """x'' = |cos t|, from rest: the velocity is 8 after two periods."""
    system = mass(lambda t, y, p: abs(cos(t)), period=2 * np.pi)
    for error in (1e-4, 1e-9):
        assert ends(system, [0.0, 0.0], 4 * np.pi, error=error)[1] == pytest.approx(8.0, abs=10 * error)


def test_stop_that_vibrates_faster_than_the_mass_moves():
    """It is hit at the first of the times at which x = t/2 exceeds 0.5 + cos(500 t)/100."""
    stop = vj.Impact("stop", lambda t, y, p: 0.5 - y["x"] + 0.01 * cos(500 * t), velocity="v", restitution=0.5)
    excess, times = lambda t: 0.5 * t - 0.5 - 0.01 * np.cos(500 * t), np.linspace(0, 2, 100001)
    hit = brentq(excess, *times[np.argmax(excess(times) > 0) + [-1, 0]], xtol=1e-15)
    speed = ends(mass(lambda t, y, p: 0.0, stop, period=2 * np.pi), [0.0, 0.5], hit + 1e-4, error=1e-8)[1]
    assert speed == pytest.approx(-7.5 * np.sin(500 * hit) - 0.25, rel=1e-6)


def test_clearances_hide_no_structure():
    """Beyond a clearance, sharp or smooth, a time moves a state; a ball rides on a table that moves later."""
    grows = one_state(lambda t, y, p: cos(t) * E.maximum(y["x"] - p["b"], 0.0), parameters={"b": 5.0})
    assert ends(grows, [6.0], 2.0)[0] == pytest.approx(5 + np.exp(np.sin(2.0)), rel=1e-7)
    smooth = one_state(lambda t, y, p: (1 + E.tanh(50 * (y["x"] - p["b"]))) * cos(t), parameters={"b": 5.0})
    assert ends(smooth, [6.0], 1.0)[0] == pytest.approx(6 + 2 * np.sin(1.0), rel=1e-7)
    rises = lambda t: 0.2 * E.maximum(E.sin(t) - 0.5, 0.0) ** 3  # noqa: E731
    table = vj.Impact("table", lambda t, y, p: y["x"] - rises(t), velocity="v", restitution=0.5)
    ball = mass(lambda t, y, p: -1.0, table, period=2 * np.pi)
    assert ends(ball, [0.0, 0.0], 1.5)[0] == pytest.approx(float(rises(1.5)), rel=1e-7)


def test_stiff_contact_beyond_a_clearance():
    """A mass comes back from the contact after half a period of its own."""
    bounces = mass(lambda t, y, p: -1e8 * E.maximum(y["x"] - 1.0, 0.0), period=10.0)
    assert ends(bounces, [0.0, 1.0], 1.5, error=1e-8) == pytest.approx([0.5 + np.pi * 1e-4, -1.0], abs=1e-7)


def test_steep_regularised_friction_from_speeds_at_which_it_is_flat():
    """A mass slows down for 1 s from 1.5 to the speed 0.5 of a belt, and then moves with it."""
    rubs = mass(lambda t, y, p: -E.tanh(1e7 * (y["v"] - 0.5)), period=10.0)
    assert ends(rubs, [0.0, 1.5], 3.0, error=1e-8) == pytest.approx([2.0, 0.5], abs=1e-7)


def test_rate_where_the_zero_state_has_no_derivative():
    """A fall with quadratic drag, written with a root, ends on the speed 1 m/s as tanh t."""
    fall = mass(lambda t, y, p: -1.0 - E.sqrt(y["v"] ** 2) * y["v"])
    assert ends(fall, [0.0, -0.5], 1.0)[1] == pytest.approx(-np.tanh(1.0 + np.arctanh(0.5)), abs=1e-8)


def test_square_wave_is_a_forcing():
    """x' = -x + square wave: the amplitude is tanh(T/4)."""
    rate = lambda t, y, p: -y["x"] + E.square(t / p["T"])  # noqa: E731
    system = one_state(rate, parameters={"T": 2.0}, period=lambda p: p["T"])
    ds = vj.run_sweep({"scene": system, "starts": [[0.0]], "grid": {"T": [2.0, 3.0]}}, progress=False)
    assert ds.cycles.values.ravel().tolist() == [1, 1]
    assert ds.x_amplitude.values.ravel() == pytest.approx(np.tanh([0.5, 0.75]), abs=1e-8)


def rubbed(normal, **options):
    rub = vj.Friction("rub", relative=lambda t, y, p: y["v"], normal=normal, law=0.5, acts_on="v", **options)
    return mass(lambda t, y, p: 0.2, rub, parameters={"n": 0.5}, period=2 * np.pi)


def test_negative_normal_force_ends_the_motion_or_lifts_off():
    system = rubbed(lambda t, y, p: cos(t))
    with pytest.raises(vj.InputError, match="negative normal force"):
        vj.simulate(system, start=[0.0, 0.0], duration=4.0, progress=False)
    lifted = rubbed(lambda t, y, p: cos(t), lift_off=True)
    assert ends(lifted, [0.0, 0.0], 4 * np.pi)[1] == pytest.approx(0.7396757961189339, abs=1e-7)
    with pytest.raises(vj.InputError, match="normal force of rub is -1"):
        vj.simulate(rubbed(lambda t, y, p: -1.0), start=[0.0, 0.0], progress=False)


def contact(normal, **options):
    """A body on a floor of friction 0.3, with a normal force [N/kg] that depends on the side of x = 1."""
    side = vj.Switch("side", lambda t, y, p: y["x"] - 1.0)
    floor = {"relative": lambda t, y, p: y["v"], "normal": normal, "law": 0.3, "acts_on": "v"}
    return mass(lambda t, y, p, s: 0.0, side, vj.Friction("floor", **floor, **options))


def test_normal_force_depends_on_the_side_of_a_switch():
    """A force that would be negative on the other side ends no motion; one that is negative behind the switch does."""
    beside = contact(lambda t, y, p, s: 10.0 + 1e5 * (y["x"] - 1.0) * (1 + s["side"]) / 2)
    assert ends(beside, [0.0, 2.0], 0.4) == pytest.approx([0.56, 0.8], abs=1e-8)
    # x'' = 0.3 (10 + 2 x) before: x + 5 is a sum of hyperbolic functions of 0.6^(1/2) t.
    normal = lambda t, y, p, s: 10.0 + 2 * y["x"] - (1 - s["side"]) * 15.0  # noqa: E731
    rate = np.sqrt(0.6)
    at = lambda t: 7.0 * np.cosh(rate * t) - 5.0 / rate * np.sinh(rate * t) - 5.0  # noqa: E731
    time = brentq(lambda t: at(t) - 1.0, 0.0, 0.5)
    speed = 7.0 * rate * np.sinh(rate * time) - 5.0 * np.cosh(rate * time)
    with pytest.raises(vj.InputError, match=f"ends at t = {time:.6g} s: negative normal force"):
        vj.simulate(contact(normal), start=[2.0, -5.0], duration=1.0, progress=False)
    assert ends(contact(normal, lift_off=True), [2.0, -5.0], 1.0)[1] == pytest.approx(speed, abs=1e-8)
    with pytest.raises(vj.InputError, match=f"ends at t = {(3 - 6**0.5) / 1.5:.6g} s: negative normal force"):
        vj.simulate(contact(lambda t, y, p, s: -5.0 * s["side"]), start=[0.0, 3.0], duration=1.0, progress=False)


def test_frictions_and_kinks_of_both_sides_count_while_the_motion_slides():
    """w' = 1/2 - s slides with 3/4 of the side 1. There x'' = -|x + 2 s| is -2 - x/2, and the friction is 0.45."""
    side = vj.Switch("s", lambda t, y, p: y["w"])
    normal = lambda t, y, p, s: s["s"] ** 2 * (2 - s["s"])  # noqa: E731
    rub = vj.Friction("rub", relative=lambda t, y, p: y["u"], normal=normal, law=0.3, acts_on="u")
    field = lambda t, y, p, s: {"x": y["v"], "v": -abs(y["x"] + 2 * s["s"]), "u": 0.5, "w": 0.5 - s["s"]}  # noqa: E731
    states = {"x": "m", "v": "m s-1", "u": "m s-1", "w": "1"}
    system = vj.System("slide", states=states, parameters={"p": 0.0}, field=field, section="x", events=[side, rub])
    assert ends(system, [1.0, 0.0, 0.0, 0.0], 1.0)[::2] == pytest.approx([5 * np.cos(0.5**0.5) - 4, 0.05], abs=1e-8)


def test_time_matters_on_any_side_and_in_any_discrete_state():
    far, level = vj.Switch("far", lambda t, y, p: y["x"] - 5.0), {"gap": lambda t, y, p: 1.0 - y["x"]}
    begin = vj.Impact("gate", reset=lambda t, y, p, s: {"x": 0.0 * y["x"], "on": 1.0}, **level)
    later = vj.Impact("gate", reset=lambda t, y, p: {"x": y["x"] - 3.0 * t}, **level)
    begins = lambda t, y, p, s: 1 + s["on"] * (cos(t) - 1)  # noqa: E731
    for rate, events, options, end in (
        (lambda t, y, p, s: (1 - s["far"]) / 2 * cos(t), [far], {}, np.sin(2.0)),
        (begins, [begin], {"modes": {"on": 0}}, np.sin(2.0) - np.sin(1.0)),
        (lambda t, y, p: 1.0, [later], {}, -1.0),
    ):
        make = functools.partial(one_state, rate, *events, parameters={"p": 0.0}, **options)
        assert ends(make(), [0.0], 2.0) == pytest.approx([end], abs=1e-8)
        assert "it depends on t; give period=" in refusal(make, section="x")


def test_kink_inside_another_kink_is_located():
    """x' = -|max(-x, 0) - 1| - 1 from 0: x = 2 e^-t - 2 down to -1, and then x' = x."""
    inside = one_state(lambda t, y, p: -abs(E.maximum(-y["x"], 0.0) - 1) - 1, parameters={"p": 0.0})
    assert ends(inside, [0.5], 0.25 + np.log(2) + 1.0) == pytest.approx([-np.e], abs=1e-7)


def test_kinks_follow_sides_that_a_switch_or_a_jump_changes():
    """x'' = -|x + 2 s|, with s the side of x = 0, or of a state that changes its sign at the gate x = 1."""
    side, phase = (vj.Switch("s", lambda t, y, p, name=name: y[name]) for name in ("x", "w"))
    flip = lambda t, y, p: y | {"w": -y["w"], "x": y["x"] - 0.5}  # noqa: E731
    gate = vj.Impact("gate", gap=lambda t, y, p: 1.0 - y["x"], reset=flip)

    def swing(*events):
        field = lambda t, y, p, s: {"x": y["v"], "v": -abs(y["x"] + 2 * s["s"]), "w": 0.0}  # noqa: E731
        states = {"x": "m", "v": "m s-1", "w": "1"}
        return vj.System("swing", states=states, parameters={"p": 0.0}, field=field, section="x", events=list(events))

    def state(x, v, shift, t):
        """x + shift below zero grows, and above zero oscillates, each by x'' = -|x + shift|."""
        y = x + shift
        turn = [np.cosh(t), np.sinh(t)] if y < 0 else [np.cos(t), np.sin(t)]
        slope = np.sinh(t) if y < 0 else -np.sin(t)
        return y * turn[0] + v * turn[1] - shift, y * slope + v * turn[0]

    for system, start, level, back, end in (
        (swing(side), [-1.0, 2.5, 1.0], 0.0, 0.0, 0.9),
        (swing(phase, gate), [0.0, 3.0, -1.0], 1.0, 0.5, 0.6),
    ):
        time = brentq(lambda t, a=start, h=level: state(*a[:2], -2.0, t)[0] - h, 0.0, 1.0)
        x, v = state(*start[:2], -2.0, time)
        expected = state(x - back, v, 2.0, end - time)
        found = vj.simulate(system, start=start, duration=end, progress=False)
        assert [found.x[-1].item(), found.v[-1].item()] == pytest.approx(expected, abs=1e-8)


def test_two_surfaces_that_change_each_others_sliding():
    """x' = -2 a - b + 0.3, y' = -a - 2 b + 0.1 with a = sgn x, b = sgn y: both slide at 0, and do not before."""
    system = vj.System(
        "pair",
        states={"x": "m", "y": "m", "z": "m"},
        parameters={"q": 1.0},
        period=1.0,
        field=lambda t, y, p, s: {
            "x": -2.0 * s["a"] - s["b"] + 0.3,
            "y": -s["a"] - 2.0 * s["b"] + 0.1,
            "z": s["a"] + 3.0 * s["b"],
        },
        events=[vj.Switch("a", lambda t, y, p: y["x"]), vj.Switch("b", lambda t, y, p: y["y"])],
    )
    # From (1, 1): x falls at 2.7, y at 2.9. At t = 1/2.9, y slides with b = (0.1 - 1)/2, until x = 0 at its speed
    # 0.3 - 2 - b. Then both slide, with a and b from the two equations.
    first = 1 / 2.9
    b = (0.1 - 1) / 2
    second = (1 - 2.7 * first) / (1.7 + b)
    both = np.linalg.solve([[2.0, 1.0], [1.0, 2.0]], [0.3, 0.1])
    z = 4 * first + (1 + 3 * b) * second + (both @ [1.0, 3.0]) * (2 - first - second)
    assert ends(system, [1.0, 1.0, 0.0], 2.0) == pytest.approx([0.0, 0.0, z], abs=1e-8)


@pytest.mark.long
def test_sliding_on_two_switches_with_a_product_ends_with_a_reason():
    system = vj.System(
        "product",
        states={"x": "m", "y": "m"},
        parameters={"q": 0.5},
        period=1.0,
        field=lambda t, y, p, s: {"x": -2.0 * s["a"] - p["q"] * s["a"] * s["b"], "y": -s["b"]},
        events=[vj.Switch("a", lambda t, y, p: y["x"]), vj.Switch("b", lambda t, y, p: y["y"])],
    )
    with pytest.raises(vj.InputError, match=r"ends at t = 1 s: slides on two switches"):
        vj.simulate(system, start=[1.0, 1.0], duration=6.0, progress=False)


def test_accumulating_events_are_named():
    """Each flight lasts half as long as the last one, from 2 s to the first bounce on: 2 + 2 + 1 + ... = 6 s."""
    floor = vj.Impact("floor", lambda t, y, p: y["x"], reset=lambda t, y, p: {"v": -0.5 * y["v"]})
    ball = mass(lambda t, y, p: -p["g"], floor, parameters={"g": 0.5}, section="v")
    with pytest.raises(vj.InputError, match=r"at 6 s, .* without end: floor; .* only stops with velocity="):
        vj.simulate(ball, start=[1.0, 0.0], duration=20.0, progress=False)


def test_friction_holds_a_body_at_a_stop():
    """The pull grows as 0.5 t - 1: the stop carries -1 + 0.2 and less; friction holds until the pull exceeds 0.2."""
    system = vj.System(
        "held",
        states={"x": "m", "v": "m s-1", "pull": "m s-2"},
        parameters={"d": 0.0},
        field=lambda t, y, p: {"x": y["v"], "v": y["pull"], "pull": 0.5},
        events=[vj.Impact("stop", gap=lambda t, y, p: y["x"] - p["d"], velocity="v", restitution=0.3), RUB],
    )
    free = 4.0 - 2.4  # s since the pull exceeded the friction
    x, v, _ = ends(system, [0.0, 0.0, -1.0], 4.0)
    assert (x, v) == pytest.approx((0.5 * free**3 / 6, 0.5 * free**2 / 2), abs=1e-8)


def steep_system(scale):
    law = vj.FrictionLaw(
        name="falling",
        reference="",
        parameters=vj.parameters.table(vj.parameters.positive("v_s", scale, "m s-1", "scale", "v_s")),
        mu=lambda u, p: 0.2 + 0.2 * E.exp(-u / p["v_s"]),
    )
    belt = vj.Friction("belt", lambda t, y, p: y["v"] - p["b"], lambda t, y, p: 1.0, law=law, acts_on="v")
    return mass(lambda t, y, p: -y["x"], belt, parameters={"b": 0.1}, section="v")


def test_steep_friction_law_from_two_starts():
    """By SciPy. From 1e-3 on, with steps of 2 v_s where the sliding speed is below 45 v_s, and a sine beyond."""
    ds = vj.run_sweep(
        {"scene": steep_system(1e-2), "starts": [[0.0, 0.0], [0.3, 0.1]], "grid": {"v_s": [1e-2, 1e-3, 1e-4, 1e-6]}},
        progress=False,
    )
    periods = ds.period.transpose("v_s", "start").values
    right = np.array([8.3544943, 8.116578627, 8.075518689, 8.068991064])
    estimates = ds.error_estimate.transpose("v_s", "start").values
    assert np.all(np.abs(periods / right[:, None] - 1) < estimates + 1e-8) and np.all(estimates < 1e-5)


def test_field_that_does_not_repeat():
    ramp = vj.System(
        "ramp",
        states={"x": "m", "v": "m s-1"},
        parameters={"k": 1.0},
        field=lambda t, y, p: {"x": y["v"], "v": 0.1 * t - p["k"] * y["x"]},
    )
    assert ends(ramp, [0.0, 0.0], 10.0)[0] == pytest.approx(0.1 * (10 - np.sin(10)), abs=1e-7)
    with pytest.raises(vj.InputError, match="period= or section="):
        vj.run_sweep({"scene": ramp, "grid": {"k": [1.0, 2.0]}}, progress=False)


def test_hysteresis_of_a_second_order_plant_by_directions():
    """The state passes both thresholds after the relay has switched. In between, the flow is linear."""
    off = vj.Impact("off", gap=lambda t, y, p: y["x"] - 0.5, direction=1, reset=lambda t, y, p, s: {"h": 0})
    on = vj.Impact("on", gap=lambda t, y, p: y["x"] + 0.5, direction=-1, reset=lambda t, y, p, s: {"h": 1})
    rate = lambda t, y, p, s: p["F"] * (2 * s["h"] - 1) - y["x"] - 0.2 * y["v"]  # noqa: E731
    plant = mass(rate, off, on, parameters={"F": 1.0}, modes={"h": 1}, section="x")
    motion = vj.simulate(plant, start=[0.0, 0.0], duration=20.0, progress=False)
    begin, side, y = 0.0, 1.0, np.zeros(2)
    switched = events_of(motion, "impact")
    for t in [*switched, 20.0]:
        rest = [side, 0.0]
        y = rest + expm(np.array([[0.0, 1.0], [-1.0, -0.2]]) * (t - begin)) @ (y - rest)
        if t < 20.0:
            assert y[0] == pytest.approx(0.5 * side, abs=1e-6) and side * y[1] > 0
        begin, side = t, -side
    assert len(switched) > 5 and set(np.unique(motion.h)) == {0.0, 1.0}
    assert float(motion.x[-1]) == pytest.approx(y[0], abs=1e-6)


def test_argument_with_default_is_not_a_side():
    field = lambda t, y, p, rate=2.0: {"x": -rate * y["x"]}  # noqa: E731
    vj.System("loop", states={"x": "m"}, parameters={"k": 1.0}, period=1.0, field=field)


def test_section_is_a_function():
    """On a circle, y - k x rises through zero once a turn. One of the multipliers is zero.

    r' = r (1 - r²), phi' = 1.4: the other is exp(-2 T) with the period T = 2 pi/1.4.
    """

    def circle(t, y, p):
        growth = 1 - (y["x"] * y["x"] + y["y"] * y["y"])
        return {"x": growth * y["x"] - 1.4 * y["y"], "y": 1.4 * y["x"] + growth * y["y"]}

    section = lambda t, y, p: y["y"] - p["k"] * y["x"]  # noqa: E731
    system = vj.System("circle", states={"x": "1", "y": "1"}, parameters={"k": 0.3}, field=circle, section=section)
    ds = vj.run_sweep({"scene": system, "starts": [[0.5, 0.0]], "run": {"orbits": True}}, progress=False).squeeze()
    assert ds.cycles == 1 and ds.error_estimate < 1e-6
    assert float(ds.period) == pytest.approx(2 * np.pi / 1.4, rel=1e-8)
    assert ds.multiplier_abs.values == pytest.approx([np.exp(-4 * np.pi / 1.4), 0.0], abs=1e-9)
    assert [float(ds.orbit_x), float(ds.orbit_y)] == pytest.approx(np.array([1.0, 0.3]) / np.hypot(1.0, 0.3), abs=1e-9)


def test_events_without_end_are_refused():
    system = vj.System(
        "stuck-clock",
        states={"x": "m", "y": "m"},
        parameters={"k": 1.0},
        period=1.0,
        field=lambda t, y, p: {"x": 1.0, "y": -p["k"] * y["y"]},
        events=[vj.Impact("clock", gap=lambda t, y, p: 1 - y["x"], reset=lambda t, y, p: {"y": 1.0})],
    )
    with pytest.raises(vj.InputError, match="at 1 s, events follow one another without end"):
        vj.simulate(system, start=[0.0, 0.0], duration=3.0, progress=False)


@pytest.mark.long
def test_slide_that_pauses_within_a_step():
    """x' = a sin(t + 3) - s slides on x = 0 except while |a sin| > 1, first for x' = a sin(t + 3) + 1 around 3 pi/2."""
    rate, side = lambda t, y, p, s: p["a"] * E.sin(t + 3.0) - s["side"], vj.Switch("side", lambda t, y, p: y["x"])
    slide = one_state(rate, side, parameters={"a": 1.002}, period=2 * np.pi)
    leaves, low = np.pi + np.arcsin(1 / 1.002), 1.5 * np.pi
    motion = vj.simulate(slide, start=[0.0], duration=2.5 * (low - 3.0), sampling=(low - 3.0) / 100, progress=False)
    assert float(motion.x[100]) == pytest.approx(1.002 * (np.cos(leaves) - np.cos(low)) + low - leaves, abs=1e-9)


def test_start_on_the_surface_of_a_reset():
    """x'' = -x begins at x = 1, where v becomes -0.8 v. With v > 0 it does so at once, though the spring alone would
    bring the mass back soon; with v < 0, where the mass returns after 2 pi - 2 arctan(-v)."""
    wall = vj.Impact("wall", gap=lambda t, y, p: 1.0 - y["x"], reset=lambda t, y, p: {"v": -p["r"] * y["v"]})
    system = mass(lambda t, y, p: -y["x"], wall, parameters={"r": 0.8})
    assert ends(system, [1.0, 0.1], 1.0)[0] == pytest.approx(np.cos(1.0) - 0.08 * np.sin(1.0), abs=1e-8)
    after = 8.0 - (2 * np.pi - 2 * np.arctan(0.5))
    right = [np.cos(after) - 0.4 * np.sin(after), -np.sin(after) - 0.4 * np.cos(after)]
    assert ends(system, [1.0, -0.5], 8.0) == pytest.approx(right, abs=1e-8)


@pytest.mark.long
def test_friction_and_a_switch_on_one_velocity_hold_one_at_a_time():
    """v' = f + 2 below v = 1 and f - 2 above, with friction 1 and f = -t/4: v slides at 1, falls, sticks and reverses.

    The mass slips at once and reaches v = t - t²/8 = 1 at 4 - sqrt(8). It slides until f = -1 at 4, stops sqrt(8)
    later, and sticks until f = -3 at 12.
    """
    system = vj.System(
        "limited",
        states={"x": "m", "v": "m s-1", "f": "m s-2"},
        parameters={"limit": 1.0},
        field=lambda t, y, p, s: {"x": y["v"], "v": y["f"] - 2.0 * s["above"], "f": -0.25},
        events=[
            vj.Switch("above", lambda t, y, p: y["v"] - p["limit"]),
            vj.Friction("rub", lambda t, y, p: y["v"], lambda t, y, p: 1.0, law=1.0, acts_on="v"),
        ],
    )
    motion = vj.simulate(system, start=[0.0, 0.0, 0.0], duration=14.0, progress=False)
    first, fall = 4 - np.sqrt(8), np.sqrt(8)
    x = first**2 / 2 - first**3 / 24 + (4 - first) + fall - fall**3 / 24 - 2**3 / 24
    assert [float(motion[name][-1]) for name in ("x", "v")] == pytest.approx([x, -0.5], abs=1e-8)
    assert events_of(motion, "slide") == pytest.approx([first], abs=1e-8)
    assert events_of(motion, "stick") == pytest.approx([4 + fall], abs=1e-8)


@pytest.mark.long
def test_relay_feedback_with_section_on_the_switch():
    """The relay -sgn(x) with the plant 1/(s + 1)³. The multipliers of its cycle are published."""
    relay = vj.System(
        "relay",
        states={"x": "1", "y": "1", "z": "1"},
        parameters={"k": 1.0},
        section="x",
        field=lambda t, y, p, s: {
            "x": y["y"],
            "y": y["z"],
            "z": -3 * y["z"] - 3 * y["y"] - y["x"] - p["k"] * s["relay"],
        },
        events=[vj.Switch("relay", lambda t, y, p: y["x"])],
    )
    ds = vj.run_sweep(
        {"scene": relay, "starts": [[0.3, 0.0, 0.0]], "grid": {"k": [1.0]}, "run": {"orbits": True}}, progress=False
    )
    assert int(ds.cycles[0, 0]) == 1
    assert ds.multiplier_abs.values.ravel() == pytest.approx([0.147449, 1.089e-4], abs=5e-7)


def test_thermostat_with_discrete_state():
    """T' = 15 h - (T - 10), h off at 22 and on at 18: the period is ln(7/3) + ln(12/8)."""
    thermostat = vj.System(
        "thermostat",
        states={"T": "1"},
        parameters={"k": 1.0},
        modes={"heating": 1},
        section=("T", 20.0),
        field=lambda t, y, p, s: {"T": 15 * s["heating"] - p["k"] * (y["T"] - 10)},
        events=[
            vj.Impact("off", gap=lambda t, y, p: 22 - y["T"], reset=lambda t, y, p, s: {"heating": 0}),
            vj.Impact("on", gap=lambda t, y, p: y["T"] - 18, reset=lambda t, y, p, s: {"heating": 1}),
        ],
    )
    motion = vj.simulate(thermostat, start=[20.0], duration=6.0, error=1e-8, progress=False)
    assert np.diff(events_of(motion, "impact"))[:4] == pytest.approx(np.log([1.5, 7 / 3] * 2), abs=1e-8)
