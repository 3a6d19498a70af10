"""Systems whose events meet: jumps across the surfaces of other events, kinks, discrete states, and their refusals.

Right values are closed forms, or follow from an independent integration by SciPy (stated at the test)."""

import functools

import numpy as np
import pytest
from refusals import refusal
from scipy.linalg import expm
from scipy.optimize import brentq
from systems import ends, events_of, mass, one_state, system

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
    field = lambda t, y, p, s: {"x": 1.0, "y": s["half"], "q": -y["q"] + s["half"]}
    wrap = vj.Impact("wrap", gap=lambda t, y, p: 1.0 - y["x"], reset=lambda t, y, p: {"x": y["x"] - 1.0})
    half = vj.Switch("half", lambda t, y, p: y["x"] - p["at"])
    saw = system("xyq", field, wrap, half, parameters={"at": 0.5}, period=1.0)
    assert ends(saw, [0.25, 0.0, 0.0], 2.5)[:2] == pytest.approx([0.75, 0.0], abs=1e-9)
    assert ends(saw, [0.2, 0.0, 0.0], 6.0, at=0.7)[2] == pytest.approx(-0.3278, abs=5e-5)


def test_kinks_are_located():
    """x'' = |cos t|, from rest: the velocity is 8 after two periods."""
    system = mass(lambda t, y, p: abs(cos(t)), period=2 * np.pi)
    for error in (1e-4, 1e-9):
        assert ends(system, [0.0, 0.0], 4 * np.pi, error=error)[1] == pytest.approx(8.0, abs=10 * error)
    # x' = -|max(-x, 0) - 1| - 1 from 0: x = 2 e^-t - 2 down to -1, and then x' = x.
    inside = one_state(lambda t, y, p: -abs(E.maximum(-y["x"], 0.0) - 1) - 1, parameters={"p": 0.0})
    assert ends(inside, [0.5], 0.25 + np.log(2) + 1.0) == pytest.approx([-np.e], abs=1e-7)


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
    rises = lambda t: 0.2 * E.maximum(E.sin(t) - 0.5, 0.0) ** 3
    table = vj.Impact("table", lambda t, y, p: y["x"] - rises(t), velocity="v", restitution=0.5)
    ball = mass(lambda t, y, p: -1.0, table, period=2 * np.pi)
    assert ends(ball, [0.0, 0.0], 1.5)[0] == pytest.approx(float(rises(1.5)), rel=1e-7)


def test_stiff_and_steep_forces_and_a_zero_state_without_derivative():
    """A mass comes back from a contact after half a period of its own. With steep friction, it slows down for 1 s from
    1.5 to the speed 0.5 of a belt. A fall with quadratic drag, written with a root, ends on 1 m/s as tanh t."""
    bounces = mass(lambda t, y, p: -1e8 * E.maximum(y["x"] - 1.0, 0.0), period=10.0)
    assert ends(bounces, [0.0, 1.0], 1.5, error=1e-8) == pytest.approx([0.5 + np.pi * 1e-4, -1.0], abs=1e-7)
    rubs = mass(lambda t, y, p: -E.tanh(1e6 * (y["v"] - 0.5)), period=10.0)
    assert ends(rubs, [0.0, 1.5], 1.1, error=1e-8) == pytest.approx([1.05, 0.5], abs=1e-7)
    fall = mass(lambda t, y, p: -1.0 - E.sqrt(y["v"] ** 2) * y["v"])
    assert ends(fall, [0.0, -0.5], 1.0)[1] == pytest.approx(-np.tanh(1.0 + np.arctanh(0.5)), abs=1e-8)


def test_square_wave_is_a_forcing():
    """x' = -x + square wave: the amplitude is tanh(T/4)."""
    rate = lambda t, y, p: -y["x"] + E.square(t / p["T"])
    system = one_state(rate, parameters={"T": 2.0}, period=lambda p: p["T"])
    ds = vj.run_sweep({"scene": system, "starts": [[0.0]], "grid": {"T": [2.0, 3.0]}}, progress=False)
    assert ds.cycles.values.ravel().tolist() == [1, 1]
    assert ds.x_amplitude.values.ravel() == pytest.approx(np.tanh([0.5, 0.75]), abs=1e-8)


def rubbed(normal, **options):
    rub = vj.Friction("rub", relative=lambda t, y, p: y["v"], normal=normal, law=0.5, acts_on="v", **options)
    return mass(lambda t, y, p: 0.2, rub, parameters={"n": 0.5}, period=2 * np.pi)


def test_negative_normal_force_ends_the_motion_or_lifts_off():
    system = rubbed(lambda t, y, p: cos(t))
    assert "negative normal force" in refusal(vj.simulate, system, start=[0.0, 0.0], duration=4.0, progress=False)
    lifted = rubbed(lambda t, y, p: cos(t), lift_off=True)
    assert ends(lifted, [0.0, 0.0], 4 * np.pi)[1] == pytest.approx(0.7396757961189339, abs=1e-7)
    with pytest.raises(vj.InputError, match="normal force of rub is -1"):
        vj.simulate(rubbed(lambda t, y, p: -1.0), start=[0.0, 0.0], progress=False)


def contact(**options):
    """Return a body on a floor of friction 0.3, with a normal force [N/kg] that depends on the side of x = 1."""
    side = vj.Switch("side", lambda t, y, p: y["x"] - 1.0)
    beyond = lambda t, y, p, s: p["n"] + p["k"] * y["x"] + (p["s"] + p["q"] * (y["x"] - 1.0)) * (1 + s["side"]) / 2
    floor = vj.Friction("floor", lambda t, y, p: y["v"], beyond, 0.3, "v", **options)
    return mass(lambda t, y, p, s: 0.0, side, floor, parameters={"n": 10.0, "k": 0.0, "s": 0.0, "q": 0.0})


def test_normal_force_depends_on_the_side_of_a_switch():
    """A force that would be negative on the other side ends no motion; one that is negative behind the switch does."""
    firm, lifting = contact(), contact(lift_off=True)
    assert ends(firm, [0.0, 2.0], 0.4, q=1e5) == pytest.approx([0.56, 0.8], abs=1e-8)
    # x'' = 0.3 (10 + 2 x) before: x + 5 is a sum of hyperbolic functions of 0.6^(1/2) t.
    rate, negative = np.sqrt(0.6), {"n": -20.0, "k": 2.0, "s": 30.0}
    at = lambda t: 7.0 * np.cosh(rate * t) - 5.0 / rate * np.sinh(rate * t) - 5.0
    time = brentq(lambda t: at(t) - 1.0, 0.0, 0.5)
    speed = 7.0 * rate * np.sinh(rate * time) - 5.0 * np.cosh(rate * time)
    over, climbing = {"n": 5.0, "s": -10.0}, [0.0, 3.0]
    for end, start, given in ((time, [2.0, -5.0], negative), ((3 - 6**0.5) / 1.5, climbing, over)):
        with pytest.raises(vj.InputError, match=f"ends at t = {end:.6g} s: negative normal force"):
            vj.simulate(firm, start=start, duration=1.0, progress=False, **given)
    assert ends(lifting, [2.0, -5.0], 1.0, **negative)[1] == pytest.approx(speed, abs=1e-8)


def test_frictions_and_kinks_of_both_sides_count_while_the_motion_slides():
    """w' = 1/2 - s slides with 3/4 of the side 1. There x'' = -|x + 2 s| is -2 - x/2, and the friction is 0.45."""
    side = vj.Switch("s", lambda t, y, p: y["w"])
    normal = lambda t, y, p, s: s["s"] ** 2 * (2 - s["s"])
    rub = vj.Friction("rub", relative=lambda t, y, p: y["u"], normal=normal, law=0.3, acts_on="u")
    field = lambda t, y, p, s: {"x": y["v"], "v": -abs(y["x"] + 2 * s["s"]), "u": 0.5, "w": 0.5 - s["s"]}
    slide = system("xvuw", field, side, rub, section="x")
    assert ends(slide, [1.0, 0.0, 0.0, 0.0], 1.0)[::2] == pytest.approx([5 * np.cos(0.5**0.5) - 4, 0.05], abs=1e-8)


def test_time_matters_on_any_side_and_in_any_discrete_state():
    far, level = vj.Switch("far", lambda t, y, p: y["x"] - 5.0), {"gap": lambda t, y, p: 1.0 - y["x"]}
    begin = vj.Impact("gate", reset=lambda t, y, p, s: {"x": 0.0 * y["x"], "on": 1.0}, **level)
    later = vj.Impact("gate", reset=lambda t, y, p: {"x": y["x"] - 3.0 * t}, **level)
    begins = lambda t, y, p, s: 1 + s["on"] * (cos(t) - 1)
    for rate, events, options, end in (
        (lambda t, y, p, s: (1 - s["far"]) / 2 * cos(t), [far], {}, np.sin(2.0)),
        (begins, [begin], {"modes": {"on": 0}}, np.sin(2.0) - np.sin(1.0)),
        (lambda t, y, p: 1.0, [later], {}, -1.0),
    ):
        make = functools.partial(one_state, rate, *events, parameters={"p": 0.0}, **options)
        assert ends(make(), [0.0], 2.0) == pytest.approx([end], abs=1e-8)
        assert "it depends on t; give period=" in refusal(make, section="x")


def test_kinks_follow_sides_that_a_switch_or_a_jump_changes():
    """x'' = -|x + 2 s|, with s the side of x = 0, or of a state that changes its sign at the gate x = 1."""
    side, phase = (vj.Switch("s", lambda t, y, p, name=name: y[name]) for name in ("x", "w"))
    flip = lambda t, y, p: y | {"w": -y["w"], "x": y["x"] - 0.5}
    gate = vj.Impact("gate", gap=lambda t, y, p: 1.0 - y["x"], reset=flip)

    def swing(*events):
        field = lambda t, y, p, s: {"x": y["v"], "v": -abs(y["x"] + 2 * s["s"]), "w": 0.0}
        return system("xvw", field, *events, section="x")

    def state(x, v, shift, t):
        """x + shift below zero grows, and above zero oscillates, each by x'' = -|x + shift|."""
        y = x + shift
        turn = [np.cosh(t), np.sinh(t)] if y < 0 else [np.cos(t), np.sin(t)]
        slope = np.sinh(t) if y < 0 else -np.sin(t)
        return y * turn[0] + v * turn[1] - shift, y * slope + v * turn[0]

    for own, start, level, back, end in (
        (swing(side), [-1.0, 2.5, 1.0], 0.0, 0.0, 0.9),
        (swing(phase, gate), [0.0, 3.0, -1.0], 1.0, 0.5, 0.6),
    ):
        time = brentq(lambda t, a=start, h=level: state(*a[:2], -2.0, t)[0] - h, 0.0, 1.0)
        x, v = state(*start[:2], -2.0, time)
        expected = state(x - back, v, 2.0, end - time)
        found = vj.simulate(own, start=start, duration=end, progress=False)
        assert [found.x[-1].item(), found.v[-1].item()] == pytest.approx(expected, abs=1e-8)


SIDES = [vj.Switch(name, lambda t, y, p, x=x: y[x]) for name, x in ("ax", "by")]


def test_two_surfaces_that_change_each_others_sliding():
    """x' = -2 a - b + 0.3, y' = -a - 2 b + 0.1 with a = sgn x, b = sgn y: both slide at 0, and do not before."""
    f = lambda t, y, p, s: {"x": 0.3 - 2 * s["a"] - s["b"], "y": 0.1 - s["a"] - 2 * s["b"], "z": s["a"] + 3 * s["b"]}
    # From (1, 1): x falls at 2.7, y at 2.9. At t = 1/2.9, y slides with b = (0.1 - 1)/2, until x = 0 at its speed
    # 0.3 - 2 - b. Then both slide, with a and b from the two equations.
    first = 1 / 2.9
    b = (0.1 - 1) / 2
    second = (1 - 2.7 * first) / (1.7 + b)
    both = np.linalg.solve([[2.0, 1.0], [1.0, 2.0]], [0.3, 0.1])
    z = 4 * first + (1 + 3 * b) * second + (both @ [1.0, 3.0]) * (2 - first - second)
    ended = ends(system("xyz", f, *SIDES, period=1.0), [1.0, 1.0, 0.0], 2.0)
    assert ended == pytest.approx([0.0, 0.0, z], abs=1e-8)


@pytest.mark.long
def test_sliding_on_two_switches_with_a_product_ends_with_a_reason():
    field = lambda t, y, p, s: {"x": -2.0 * s["a"] - p["q"] * s["a"] * s["b"], "y": -s["b"]}
    product = system("xy", field, *SIDES, parameters={"q": 0.5}, period=1.0)
    with pytest.raises(vj.InputError, match=r"ends at t = 1 s: slides on two switches"):
        vj.simulate(product, start=[1.0, 1.0], duration=6.0, progress=False)


def test_accumulating_events_are_named():
    """Each flight lasts half as long as the last one, from 2 s to the first bounce on: 2 + 2 + 1 + ... = 6 s."""
    floor = vj.Impact("floor", lambda t, y, p: y["x"], reset=lambda t, y, p: {"v": -0.5 * y["v"]})
    ball = mass(lambda t, y, p: -p["g"], floor, parameters={"g": 0.5}, section="v")
    with pytest.raises(vj.InputError, match=r"at 6 s, .* without end: floor; .* only stops with velocity="):
        vj.simulate(ball, start=[1.0, 0.0], duration=20.0, progress=False)
    clock = vj.Impact("clock", gap=lambda t, y, p: 1 - y["x"], reset=lambda t, y, p: {"y": 1.0})
    stuck = system("xy", lambda t, y, p: {"x": 1.0, "y": -y["y"]}, clock, period=1.0)
    with pytest.raises(vj.InputError, match="at 1 s, events follow one another without end"):
        vj.simulate(stuck, start=[0.0, 0.0], duration=3.0, progress=False)


def test_friction_holds_a_body_at_a_stop():
    """The pull grows as 0.5 t - 1: the stop carries -1 + 0.2 and less; friction holds until the pull exceeds 0.2."""
    stop = vj.Impact("stop", gap=lambda t, y, p: y["x"], velocity="v", restitution=0.3)
    held = system("xvp", lambda t, y, p: {"x": y["v"], "v": y["p"], "p": 0.5}, stop, RUB)
    free = 4.0 - 2.4  # s since the pull exceeded the friction
    x, v, _ = ends(held, [0.0, 0.0, -1.0], 4.0)
    assert (x, v) == pytest.approx((0.5 * free**3 / 6, 0.5 * free**2 / 2), abs=1e-8)


def test_steep_friction_law_from_two_starts():
    """By SciPy. From 1e-3 on, with steps of 2 v_s where the sliding speed is below 45 v_s, and a sine beyond."""
    scale = vj.parameters.table(vj.parameters.positive("v_s", 1e-2, "m s-1", "scale", "v_s"))
    law = vj.FrictionLaw("falling", "", scale, lambda u, p: 0.2 + 0.2 * E.exp(-u / p["v_s"]))
    belt = vj.Friction("belt", lambda t, y, p: y["v"] - p["b"], lambda t, y, p: 1.0, law=law, acts_on="v")
    steep = mass(lambda t, y, p: -y["x"], belt, parameters={"b": 0.1}, section="v")
    starts, scales = [[0.0, 0.0], [0.3, 0.1]], [1e-2, 1e-3, 1e-4, 1e-6]
    ds = vj.run_sweep({"scene": steep, "starts": starts, "grid": {"v_s": scales}}, progress=False)
    periods = ds.period.transpose("v_s", "start").values
    right = np.array([8.3544943, 8.116578627, 8.075518689, 8.068991064])
    estimates = ds.error_estimate.transpose("v_s", "start").values
    assert np.all(np.abs(periods / right[:, None] - 1) < estimates + 1e-8) and np.all(estimates < 1e-5)


def test_fields_that_do_not_repeat_or_have_arguments_with_defaults():
    ramp = mass(lambda t, y, p: 0.1 * t - p["k"] * y["x"], parameters={"k": 1.0}, section=None)
    assert ends(ramp, [0.0, 0.0], 10.0)[0] == pytest.approx(0.1 * (10 - np.sin(10)), abs=1e-7)
    assert "period= or section=" in refusal(vj.run_sweep, {"scene": ramp, "grid": {"k": [1.0, 2.0]}}, progress=False)
    field = lambda t, y, p, rate=2.0: {"x": -rate * y["x"]}
    vj.System("loop", states={"x": "m"}, parameters={"k": 1.0}, period=1.0, field=field)


def test_hysteresis_of_a_second_order_plant_by_directions():
    """The state passes both thresholds after the relay has switched. In between, the flow is linear."""
    off = vj.Impact("off", gap=lambda t, y, p: y["x"] - 0.5, direction=1, reset=lambda t, y, p, s: {"h": 0})
    on = vj.Impact("on", gap=lambda t, y, p: y["x"] + 0.5, direction=-1, reset=lambda t, y, p, s: {"h": 1})
    rate = lambda t, y, p, s: p["F"] * (2 * s["h"] - 1) - y["x"] - 0.2 * y["v"]
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


def test_section_is_a_function():
    """On a circle, y - k x rises through zero once a turn. One of the multipliers is zero. r' = r (1 - r²), phi' = 1.4:
    the other is exp(-2 T) with the period T = 2 pi/1.4."""

    def circle(t, y, p):
        growth = 1 - (y["x"] * y["x"] + y["y"] * y["y"])
        return {"x": growth * y["x"] - 1.4 * y["y"], "y": 1.4 * y["x"] + growth * y["y"]}

    section = lambda t, y, p: y["y"] - p["k"] * y["x"]
    ring = system("xy", circle, parameters={"k": 0.3}, section=section)
    ds = vj.run_sweep({"scene": ring, "starts": [[0.5, 0.0]], "run": {"orbits": True}}, progress=False).squeeze()
    assert ds.cycles == 1 and ds.error_estimate < 1e-6
    assert float(ds.period) == pytest.approx(2 * np.pi / 1.4, rel=1e-8)
    assert ds.multiplier_abs.values == pytest.approx([np.exp(-4 * np.pi / 1.4), 0.0], abs=1e-9)
    assert [float(ds.orbit_x), float(ds.orbit_y)] == pytest.approx(np.array([1.0, 0.3]) / np.hypot(1.0, 0.3), abs=1e-9)


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
    later, and sticks until f = -3 at 12."""
    above = vj.Switch("above", lambda t, y, p: y["v"] - 1.0)
    rub = vj.Friction("rub", lambda t, y, p: y["v"], lambda t, y, p: 1.0, law=1.0, acts_on="v")
    limited = system("xvf", lambda t, y, p, s: {"x": y["v"], "v": y["f"] - 2 * s["above"], "f": -0.25}, above, rub)
    motion = vj.simulate(limited, start=[0.0, 0.0, 0.0], duration=14.0, progress=False)
    first, fall = 4 - np.sqrt(8), np.sqrt(8)
    x = first**2 / 2 - first**3 / 24 + (4 - first) + fall - fall**3 / 24 - 2**3 / 24
    assert [float(motion[name][-1]) for name in ("x", "v")] == pytest.approx([x, -0.5], abs=1e-8)
    assert events_of(motion, "slide") == pytest.approx([first], abs=1e-8)
    assert events_of(motion, "stick") == pytest.approx([4 + fall], abs=1e-8)


@pytest.mark.parametrize("order", [1, -1])
def test_a_body_that_one_friction_releases_sticks_to_the_other_at_once(order):
    """The ground holds a body under a plate with v = 0.1 sin t until the plate reverses at pi, and its friction turns.
    The ground alone cannot hold the body against both forces. So the body follows the plate, with -0.25 of at most 0.4,
    and has the plate's speed at 3 pi/2. At t = 0, both frictions could hold it."""
    ground = vj.Friction("ground", lambda t, y, p: y["v"], lambda t, y, p: 1.0, law=0.3, acts_on="v")
    below = lambda t, y, p: y["v"] - 0.1 * E.sin(t)
    plate = vj.Friction("plate", below, lambda t, y, p: 1.0, law=0.2, static=0.4, acts_on="v")
    body = mass(lambda t, y, p: -0.15, *[ground, plate][::order], period=2 * np.pi)
    assert ends(body, [0.0, 0.0], 1.5 * np.pi) == pytest.approx([-0.1, -0.1], abs=1e-8)


@pytest.mark.long
def test_relay_feedback_with_section_on_the_switch():
    """The relay -sgn(x) with the plant 1/(s + 1)³. The multipliers of its cycle are published."""
    field = lambda t, y, p, s: {"x": y["y"], "y": y["z"], "z": -3 * y["z"] - 3 * y["y"] - y["x"] - s["relay"]}
    relay = system("xyz", field, vj.Switch("relay", lambda t, y, p: y["x"]), section="x")
    ds = vj.run_sweep({"scene": relay, "starts": [[0.3, 0.0, 0.0]], "run": {"orbits": True}}, progress=False)
    assert ds.cycles.item() == 1
    assert ds.multiplier_abs.values.ravel() == pytest.approx([0.147449, 1.089e-4], abs=5e-7)


def test_thermostat_with_discrete_state():
    """T' = 15 h - (T - 10), h off at 22 and on at 18: the period is ln(7/3) + ln(12/8)."""
    off = vj.Impact("off", gap=lambda t, y, p: 22 - y["x"], reset=lambda t, y, p, s: {"heating": 0})
    on = vj.Impact("on", gap=lambda t, y, p: y["x"] - 18, reset=lambda t, y, p, s: {"heating": 1})
    rate = lambda t, y, p, s: 15 * s["heating"] - (y["x"] - 10)
    thermostat = one_state(rate, off, on, modes={"heating": 1}, section=("x", 20.0))
    motion = vj.simulate(thermostat, start=[20.0], duration=6.0, error=1e-8, progress=False)
    assert np.diff(events_of(motion, "impact"))[:4] == pytest.approx(np.log([1.5, 7 / 3] * 2), abs=1e-8)
