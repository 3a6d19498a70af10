"""Test systems written as plain functions against closed forms, and one-line errors for mistakes in them."""

import pickle
from dataclasses import replace
from inspect import signature

import numpy as np
import pytest
import systems
from matplotlib.text import Text
from refusals import refusal
from scipy.integrate import solve_ivp
from systems import BALL, BELT, IMPACT_OSCILLATOR, RELAY, VAN_DER_POL, ends, events_of, mass, names_of

import vibrojax as vj
from vibrojax.systems.probe import ARGUMENTS

cos = vj.elementary.cos


def test_accumulating_bounces_end_at_rest():
    motion = vj.simulate(BALL, start=[1.0, 0.0], duration=20.0, progress=False)
    # The slowest bounces are omitted; their height is rounding error.
    rest = np.sqrt(2 / 9.81) * (1 + 0.5) / (1 - 0.5)
    assert len(events_of(motion, "impact")) > 10 and events_of(motion, "impact")[-1] == pytest.approx(rest, abs=1e-6)
    assert events_of(motion, "stick") == pytest.approx([rest], abs=1e-6)
    assert abs(float(motion.x[-1])) < 1e-12 and float(motion.v[-1]) == 0 and names_of(motion) == ["equilibrium"]


def test_period_of_stick_slip_on_belt_from_two_starts():
    sweep = {"scene": BELT, "grid": {"belt_speed": [0.05, 0.2]}, "starts": [[0.0, 0.0], [1.5, 0.0]]}
    ds = vj.run_sweep(sweep | {"run": {"error": 1e-6}}, progress=False)
    periods = [systems.belt_period(speed, 0.2) for speed in ds.belt_speed.values]
    assert ds.period.values == pytest.approx(np.transpose([periods] * 2), rel=1e-8)
    assert names_of(ds) == ["periodic"] * 4


def test_relay_slides_by_filippov_convention():
    motion = vj.simulate(RELAY, start=[1.0, 0.0], duration=8.0, error=1e-8, progress=False)
    late = motion.sel(time=slice(5.0, None))
    assert len(events_of(motion, "slide")) == 1 and not len(events_of(motion, "impact"))
    decay = np.exp(-(late.time.values - late.time.values[0]))
    assert late.x.values / float(late.x[0]) == pytest.approx(decay, rel=1e-8)
    assert np.abs(late.x + late.y).max() < 1e-14
    assert ends(RELAY, [0.3, -0.3], 2.0)[0] == pytest.approx(0.3 * np.exp(-2.0), abs=1e-7)  # begins on the surface


def test_section_can_lie_at_value_and_regimes_can_be_renamed():
    rate = lambda t, y, p: p["mu"] * (1 - y["x"] ** 2) * y["v"] - y["x"]
    ticking = mass(rate, parameters={"mu": 0.5}, section=("x", 0.5), regimes={"periodic": "ticking"})
    motion = vj.simulate(ticking, start=[0.1, 0.0], progress=False)
    assert names_of(motion) == ["ticking"]
    assert float(motion.period) == pytest.approx(6.3807, abs=2e-3)  # van der Pol, mu = 0.5
    assert float(motion.x[0]) == pytest.approx(0.1) and float(motion.x.max()) == pytest.approx(2.0, abs=0.02)
    figure = vj.picture(motion)
    shown = [text.get_text() for text in figure.legends[0].get_texts()]
    assert shown == ["whole motion", "the last ten periods"] and "mu = 0.5" in figure.get_supxlabel()
    assert motion.x.interp(time=events_of(motion, "section")[-3:]).values == pytest.approx([0.5] * 3, abs=1e-4)


def test_other_processes_import_system_from_its_module():
    assert pickle.loads(pickle.dumps(systems.BALL)) is systems.BALL
    alone = systems.one_state(lambda t, y, p: -y["x"], parameters={"k": 1.0}, section="x")
    assert "top level of a file" in refusal(pickle.dumps, alone)


GOOD = {
    "states": {"x": "m", "v": "m s-1"},
    "parameters": {"k": 1.0},
    "field": lambda t, y, p: {"x": y["v"], "v": -p["k"] * y["x"]},
    "section": "x",
}
FORCED = lambda t, y, p: {"x": y["v"], "v": cos(t)}
gap = lambda t, y, p: 1.0 - y["x"]


def rub(relative=lambda t, y, p: y["v"], law=0.2, **more):
    return vj.Friction("belt", relative, lambda t, y, p: 1.0, law, "v", **more)


MISTAKES = {
    "is not a state": {"section": "z"},
    "field gave no rate of v": {"field": lambda t, y, p: {"x": y["v"]}},
    "field asks for 'c'": {"field": lambda t, y, p: {"x": y["v"], "v": -p["c"]}},
    "not jnp, np or math": {"field": lambda t, y, p: {"x": y["v"], "v": -np.sin(y["x"])}},
    "field uses a function of np": {"field": lambda t, y, p: {"x": y["v"], "v": -np.sin(p["k"]) * y["x"]}},
    "stop: restitution uses a function": {"events": [vj.Impact("stop", gap, "v", lambda p: np.exp(-p["k"]))]},
    "it depends on t; give period=": {"field": FORCED},
    "does not repeat after the period": {"field": FORCED, "section": None, "period": 6.0},
    "does not repeat after": {  # the forcing is 1e-11 of the other terms at states of order one
        "field": lambda t, y, p: {"x": y["v"], "v": 10 * cos(t) - 1e12 * y["x"]},
        **{"section": None, "period": 6.0},
    },
    "it must be above zero": {"section": None, "period": lambda p: -p["k"]},
    "cannot see the switch": {"events": [vj.Switch("side", lambda t, y, p: y["x"])]},
    "decides by a value": {"field": lambda t, y, p: {"x": y["v"], "v": -max(y["x"], 0.0)}},
    'did you mean "coulomb"?': {"events": [rub(law="coulumb")]},
    "belt: mass is 0; it must be above": {"events": [rub(mass=0.0)]},
    "cannot see the discrete state heating": {"modes": {"heating": 1}},
    "put a vj.Switch on it": {"field": lambda t, y, p: {"x": y["v"], "v": -(y["v"] > 0) * 1.0}},
    "the velocity on which it acts": {"events": [rub(lambda t, y, p: y["x"])]},
    "would drive it; change the sign": {"events": [rub(lambda t, y, p: 0.5 - y["v"])]},
    "floor of a value that depends on": {"field": lambda t, y, p: {"x": y["v"], "v": vj.elementary.floor(y["x"])}},
    "a and b have the same surface": {
        "field": lambda t, y, p, s: {"x": y["v"], "v": s["a"] - 2 * s["b"]},
        "events": [vj.Switch("a", lambda t, y, p: y["x"]), vj.Switch("b", lambda t, y, p: -2 * y["x"])],
    },
    "for a force and its reaction, use a state": {
        "events": [
            replace(rub(lambda t, y, p: y["x"] - y["v"]), name="a", acts_on="x"),
            replace(rub(lambda t, y, p: y["v"] - y["x"]), name="b"),
        ]
    },
    "must depend on states, and not on t": {"section": lambda t, y, p: y["x"] - t},
    "a pair of a state and a number, or a function": {"section": 3.0},
    "the name of an argument": {"parameters": {"k": 1.0, "step": 1.0}},
    "states are x, v": {"section": ["x", 0.3]},
    "stop: reset uses a function of np": {
        "events": [vj.Impact("stop", lambda t, y, p: 1.0 - y["x"], reset=lambda t, y, p: {"v": -np.abs(y["v"])})]
    },
    "rub: normal uses a function that steps cannot expand": {
        "events": [vj.Friction("rub", lambda t, y, p: y["v"], lambda t, y, p: np.exp(y["x"]), 0.3, "v")]
    },
    "rate uses a function of np": {"rate": lambda p: np.sqrt(p["k"])},
    "stop: gap is nan at x = ": {"events": [vj.Impact("stop", lambda t, y, p: vj.elementary.sqrt(-y["x"]), "v")]},
    "law is nan": {"events": [rub(law=np.nan)]},
    "that is a kind of special points": {"events": [vj.Switch("fold", lambda t, y, p: y["x"])]},
    "either velocity=": {"events": [vj.Impact("stop", gap=lambda t, y, p: y["x"])]},
    "law takes other arguments; write law(p), or a vj.FrictionLaw": {"events": [rub(law=lambda u, p: 0.2)]},
    "gap takes other arguments; write gap(t, y, p)": {"events": [vj.Impact("stop", lambda y: y["x"], "v")]},
    "static is 0.1, below 0.2": {"events": [rub(static=0.1)]},
    "asks for sign; vj.elementary has absolute": {"field": lambda t, y, p: {"x": vj.elementary.sign(y["v"])}},
    "is the name of two events": {"events": [vj.Impact("stop", gap, "v")] * 2},
    'period is "2*pi"; write a number': {"section": None, "period": "2*pi"},
    "reset, x, gave NoneType": {"events": [vj.Impact("gate", gap, reset=lambda t, y, p: {"x": None})]},
}


def test_arguments_of_simulate_are_no_parameters():
    assert {*signature(vj.simulate).parameters} - {"start", "parameters"} == {*ARGUMENTS}


@pytest.mark.parametrize("message", MISTAKES)
def test_mistake_in_system_gives_one_line(message):
    text = refusal(vj.System, "wrong", **(GOOD | MISTAKES[message]))
    assert text.startswith("system wrong: ") and message in text and len(text) < 220


@pytest.mark.parametrize("unit", [1e-10, 1e9])
def test_structure_does_not_depend_on_units(unit):
    """Two coupled relays slide on both surfaces, to their intersection. A weak forcing without a period moves x."""
    field = lambda t, y, p, s: {"x": -p["a"] * (s["p"] + 0.5 * s["q"]), "y": p["a"] * (0.4 * s["p"] - s["q"])}
    first = vj.Switch("p", lambda t, y, p: y["x"] + 0.3 * y["y"])
    second = vj.Switch("q", lambda t, y, p: y["y"] - 0.2 * y["x"] + 0.1 * p["a"])
    relays = systems.system("xy", field, first, second, parameters={"a": unit}, section="x")
    assert np.array(ends(relays, [0.5 * unit, 0.8 * unit], 5.0)) / unit == pytest.approx([0.03 / 1.06, -0.1 / 1.06])
    forced = mass(lambda t, y, p: p["a"] * cos(3 * t) - y["x"], parameters={"a": unit}, section=None)
    assert ends(forced, [0.0, 0.0], 2.0)[0] / unit == pytest.approx((np.cos(2.0) - np.cos(6.0)) / 8, rel=1e-7)


def test_lanes_that_cannot_be_run_fail_with_reason():
    ds = vj.run_sweep({"scene": IMPACT_OSCILLATOR, "grid": {"a": [0.1, 0.15]}, "starts": [[1.5, 0.0]]}, progress=False)
    assert names_of(ds) == ["failed"] * 2 and names_of(ds, "reason") == ["beyond-a-stop"] * 2
    assert "Lanes failed: beyond-a-stop" in vj.picture(ds).get_supxlabel().replace("\n", " ")
    bounces = vj.run_sweep({"scene": BALL, "grid": {"r": [0.5, 1.01]}, "starts": [[1.0, 0.0]]}, progress=False)
    assert names_of(bounces, "reason") == ["none", "restitution-not-0-to-1"] and names_of(bounces)[1] == "failed"
    base = vj.Friction("base", lambda t, y, p: y["v"], lambda t, y, p: 1.0, 0.3, "v", mass=lambda p: p["m"])
    block = mass(lambda t, y, p: (cos(t) - y["x"]) / p["m"], base, parameters={"m": 1.0}, period=2 * np.pi)
    ds = vj.run_sweep({"scene": block, "grid": {"m": [1.0, -1.0]}, "run": {"settle": 1.0}}, progress=False)
    assert names_of(ds, "reason") == ["none", "mass-not-above-zero"] and names_of(ds)[1] == "failed"
    assert "the mass of base is -1; it must be above 0" in refusal(vj.simulate, block, m=-1.0, progress=False)
    ds = vj.run_sweep({"scene": IMPACT_OSCILLATOR, "grid": {"w": [2.0, 0.0, -2.0]}}, progress=False)
    assert names_of(ds, "reason") == ["none", *["period-not-above-zero"] * 2]
    with pytest.raises(vj.InputError, match=r"the period of the forcing is -3.14159 s; it must be above 0"):
        vj.simulate(IMPACT_OSCILLATOR, w=-2.0, progress=False)


def test_friction_that_drives_for_some_parameters_fails_with_reason():
    """The probe of a system sees the default only: the friction opposes the motion for a positive sign."""
    law = {"normal": lambda t, y, p: 1.0, "law": lambda p: p["mu"], "acts_on": "v"}
    friction = vj.Friction("base", lambda t, y, p: p["sign"] * y["v"], **law)
    parameters = {"sign": 1.0, "mu": 0.3}
    block = mass(lambda t, y, p: vj.elementary.cos(2 * np.pi * t) - y["x"], friction, parameters=parameters)
    points = {"sign": [2.0, -1.0, 1.0], "mu": [0.3, 0.3, -0.3]}
    ds = vj.run_sweep({"scene": block, "points": points, "run": {"settle": 1.0}}, progress=False)
    assert names_of(ds, "reason") == ["none", *["friction-drives"] * 2] and names_of(ds)[1:] == ["failed"] * 2
    with pytest.raises(vj.InputError, match=r"relative of base falls where v rises, so that friction would drive it"):
        vj.simulate(block, sign=-1.0, progress=False)
    weak = mass(lambda t, y, p: -y["x"], replace(friction, static=0.4), name="weak", parameters=parameters)
    ds = vj.run_sweep({"scene": weak, "grid": {"mu": [0.4, 0.5]}, "run": {"settle": 1.0}}, progress=False)
    assert names_of(ds, "reason") == ["none", "static-below-sliding"]
    with pytest.raises(vj.InputError, match=r"static of base is 0.4, below the 0.5 of its law at rest"):
        vj.simulate(weak, mu=0.5, progress=False)


def test_trajectory_that_grows_without_bound_warns():
    """The solution of x'' = 6 x² from x = 1, x' = 2 is 1/(1 - t)²."""
    field = lambda t, y, p: {"x": y["v"], "v": 6 * y["x"] * y["x"]}
    grows = systems.system("xv", field, name="grows", section="v")
    with pytest.warns(UserWarning, match=r"grows is not finite after t = (0\.99|1 s)"):
        vj.simulate(grows, start=[1.0, 2.0], duration=2.0, progress=False)


def test_powers_of_states():
    """x' = -x³ from -1 is -1/√(1 + 2t), also with 3.0 for 3; x' = -x^1.5 from 1 is (1 + t/2)⁻²."""
    field = lambda t, y, p: {"x": -(y["x"] ** 3.0), "y": -(y["y"] ** p["n"])}
    powers = vj.System("powers", states={"x": "m", "y": "m"}, parameters={"n": 1.5}, field=field)
    assert ends(powers, [-1.0, 1.0], 2.0) == pytest.approx([-(5**-0.5), 0.25], abs=1e-7)


def test_start_is_on_a_stop_or_refused():
    """The gap is -5.6e-17. The mass rebounds at once; its free motion is known. A slightly greater gap is refused."""
    free = {"a": 0.0, "damping": 0.0, "stop": 0.3}
    x, v = ends(IMPACT_OSCILLATOR, [0.1 + 0.2, 0.5], 2.0, **free)
    assert [x, v] == pytest.approx([0.3 * np.cos(2) - 0.35 * np.sin(2), -0.3 * np.sin(2) - 0.35 * np.cos(2)], abs=1e-8)
    with pytest.raises(vj.InputError, match="must not be negative"):
        vj.simulate(IMPACT_OSCILLATOR, start=[0.3 + 1e-13, 0.5], progress=False, **free)
    with pytest.raises(vj.InputError, match=r"start: \[1.5, 0.0\]: the gap of stop_hit is -0.5; it must not be neg"):
        vj.simulate(IMPACT_OSCILLATOR, start=[1.5, 0.0], progress=False)
    with pytest.raises(vj.InputError, match=r"omega: scene .* has no such parameter; choose from"):
        vj.simulate(IMPACT_OSCILLATOR, start=[0.0, 0.0], omega=2.0, progress=False)
    with pytest.raises(vj.InputError, match=r"cannot be run \(beyond a stop\)"):
        vj.follow(IMPACT_OSCILLATOR, along="a", at=0.1, span=(0.05, 0.2), start=[1.5, 0.0], progress=False)
    power = vj.System("power", **(GOOD | {"field": lambda t, y, p: {"x": y["v"], "v": -(y["x"] ** 1.5)}}))
    with pytest.raises(vj.InputError, match="the field, v, is nan at the start; it must be finite"):
        vj.simulate(power, start=[-0.2, 0.0], progress=False)


def test_amplitudes_do_not_depend_on_steps():
    """x' = cos(w t) - x swings by 1/sqrt(1 + w²). No state is the rate of x, so no step ends at its turns."""
    period = lambda p: 2 * np.pi / p["w"]
    lag = systems.one_state(lambda t, y, p: cos(p["w"] * t) - y["x"], parameters={"w": 3.0}, period=period)
    ds = vj.run_sweep({"scene": lag, "grid": {"w": [1.0, 3.0]}, "run": {"keep_returns": 4}}, progress=False)
    exact = 1 / np.sqrt(1 + ds.w.values**2)
    assert ds.x_amplitude.values.ravel() == pytest.approx(exact, rel=1e-6)
    assert ds.return_x.dims == ("w", "start", "return_index") and np.isfinite(ds.return_x).all()
    assert ds.return_x.values[:, 0, -1] == pytest.approx(exact**2, rel=1e-6)  # at t = 0, exact² cos 0


def test_parameters_have_units_of_pint(tmp_path):
    units = {"states": {"x": "deg", "v": "deg/s"}, "parameters": {"k": (1.0, "N m rad-1")}}
    torsion = vj.System("torsion", **(GOOD | units))
    ds = vj.run_sweep({"scene": torsion, "grid": {"k": [1.0, 2.0]}, "starts": [[1.0, 0.0]]}, progress=False)
    assert ds.k.units == "N m rad-1" and ds.x_amplitude.units == "deg"
    assert "k [N m/rad]" in [axes.get_xlabel() for axes in vj.picture(ds, variable="x_amplitude").axes]
    figure = vj.picture(vj.simulate(torsion, duration=10.0, progress=False))
    assert any("k = 1 N m/rad" in text.get_text() for text in figure.findobj(Text))


def test_default_times_follow_slowest_oscillation():
    field = lambda t, y, p: {"x": y["v"], "v": -(p["slow"] ** 2) * y["x"], "z": y["w"], "w": -(p["fast"] ** 2) * y["z"]}
    pair = systems.system("xvzw", field, parameters={"slow": 1.0, "fast": 10.0}, section="x")
    assert pair.usual_times == pytest.approx((200 * np.pi, 80 * np.pi), rel=0.02)


def test_sticking_body_has_exactly_speed_of_surface():
    """A departure moves the surface away by 1e-12 of a typical speed, at which the body must not stick."""
    motion = vj.simulate(BELT, start=[0.0, 0.0], duration=60.0, progress=False)
    sticks, slips = events_of(motion, "stick"), events_of(motion, "slip")
    time = motion.time.values
    stuck = np.any([(time > a) & (time < b) for a, b in zip(sticks, slips, strict=False)], axis=0)
    assert len(sticks) >= 4 and stuck.sum() > 100
    assert np.abs(motion.v.values[stuck] - 0.2).max() < 1e-15


def test_soft_contacts_are_impacts_with_approach_speed():
    """A ball on elastic ground, soft or stiff, follows a parabola and an arc of the oscillation about g/k."""
    ball = mass(
        lambda t, y, p, s: -p["g"] - p["k"] * y["x"] * (1 + s["contact"]) / 2,
        vj.Switch("contact", lambda t, y, p: -y["x"], impact=True),
        parameters={"g": 9.81, "k": 1e4},
        section="v",
    )
    sweep = {"scene": ball, "starts": [[0.2, 0.0]], "grid": {"k": [1e4, 1e9]}}
    ds = vj.run_sweep(sweep | {"run": {"settle": 2.0, "observe": 10.0}}, progress=False)
    speed, w = np.sqrt(2 * 9.81 * 0.2), np.sqrt(ds.k.values)
    assert names_of(ds) == ["single-impact"] * 2
    assert ds.impact_velocity.values.ravel() == pytest.approx([speed] * 2, rel=1e-6)
    contact = 2 * (np.pi - np.arctan(speed * w / 9.81)) / w
    assert ds.period.values.ravel() == pytest.approx(2 * speed / 9.81 + contact, rel=1e-6)


AT_ONE = 6.6632868593231301896996820305  # s: the period at mu = 1


def test_periods_and_multiplier_of_van_der_pol():
    """Periods are published for 1 and 5. At 0.1, the series of the frequency has an error of 1e-11."""
    series = 2 * np.pi / (1 - 0.1**2 / 16 + 17 * 0.1**4 / 3072 + 35 * 0.1**6 / 884736)
    sweep = {"scene": VAN_DER_POL, "grid": {"mu": [0.1, 1.0, 5.0]}, "starts": [[1.0, 0.0]], "run": {"orbits": True}}
    ds = vj.run_sweep(sweep, progress=False)
    right = np.array([series, AT_ONE, 11.612230667])
    difference = np.abs(ds.period.values.ravel() - right)
    assert (difference <= 3 * ds.error_estimate.values.ravel() * right).all()
    np.testing.assert_allclose(ds.period.values.ravel(), right, rtol=1e-9)
    # The multiplier of a planar orbit is the exponential of the integral of the field's divergence.
    rates = lambda t, y: [y[1], (1 - y[0] ** 2) * y[1] - y[0], 1 - y[0] ** 2]
    settled = solve_ivp(rates, (0.0, 10 * AT_ONE), [2.0, 0.0, 0.0], rtol=1e-12, atol=1e-14, method="DOP853").y[:2, -1]
    exponent = solve_ivp(rates, (0.0, AT_ONE), [*settled, 0.0], rtol=1e-12, atol=1e-14, method="DOP853").y[2, -1]
    assert exponent == pytest.approx(-7.0589, abs=1e-3)
    assert float(ds.multiplier_abs[1, 0, 0]) == pytest.approx(np.exp(exponent), rel=1e-6)


def test_resting_ball_leaves_table_that_falls_faster():
    """The table's downward acceleration reaches a w² = 1.5 g. The ball leaves where a w² cos(w t) = -g."""
    a, w = 1.5 * 9.81 / (2 * np.pi) ** 2, 2 * np.pi
    motion = vj.simulate(BALL, start=[-a, 0.0], a=a, r=0.0, duration=1.0, sampling=1e-3, error=1e-8, progress=False)
    gap = motion.x.values + a * np.cos(w * motion.time.values)
    leaves = np.arccos(-1 / 1.5) / w
    flying = motion.time.values[gap > 1e-7]
    assert flying[0] == pytest.approx(leaves, abs=2e-2) and flying[0] > leaves
    assert np.abs(gap[motion.time.values < leaves]).max() < 1e-10  # accumulated errors of the steps


DAMPING, RATE, DECAY, PERIOD = 0.2, 0.7, 0.05, np.pi


def test_states_that_stand_still_or_decay_do_not_decide():
    """Beside an oscillation, z decays, and w approaches an equilibrium; some starts have w there at once."""
    own = lambda t, y, p: {"x": y["v"], "v": cos(2.0 * t) - DAMPING * y["v"] - y["x"]}
    field = lambda t, y, p: {"z": -DECAY * y["z"], "w": p["q"] - RATE * y["w"]} | own(t, y, p)
    beside = systems.system("zwxv", field, parameters={"q": 0.3}, period=PERIOD)
    starts = [[1.0, 3 / 7, 0.0, 0.0], [1.0, 0.0, 0.3, 1.0], [0.0] * 4]
    sweep = {"scene": beside, "grid": {"q": [0.3]}, "starts": starts, "run": {"orbits": True}}
    ds = vj.run_sweep(sweep, progress=False)
    assert ds.cycles.values.ravel().tolist() == [1, 1, 1] and set(names_of(ds)) == {"periodic"}
    assert (ds.error_estimate < 2e-6).all() and (ds.orbit_reason == 0).all() and (ds.stable == 1).all()
    own = np.exp(-PERIOD * np.array([DECAY, DAMPING / 2, DAMPING / 2, RATE]))
    np.testing.assert_allclose(ds.multiplier_abs.values[0], np.tile(own, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(ds.orbit_w, 3 / 7, rtol=1e-9)


def test_impact_velocity_has_unit_of_rate_of_gap():
    """The length L has no part in it: a gap of L times an angle counts as an angle."""
    turn = lambda t, y, p: 0.5 * cos(1.5 * t) - 0.1 * y["speed"] - vj.elementary.sin(y["angle"])
    field = lambda t, y, p, s: {"angle": y["speed"], "speed": turn(t, y, p)}
    about = {"parameters": {"L": (2.0, "m")}, "period": 2 * np.pi / 1.5}
    for unit, event in (
        ("rad s-1", vj.Impact("stop", gap=lambda t, y, p: 0.3 - y["angle"], velocity="speed", restitution=0.6)),
        ("rad s-1", vj.Switch("stop", lambda t, y, p: p["L"] * y["angle"] - 0.3, impact=True)),
        ("rad s-2", vj.Switch("stop", lambda t, y, p: y["speed"] - 0.3, impact=True)),
    ):
        pendulum = systems.system({"angle": "rad", "speed": "rad s-1"}, field, event, **about)
        assert pendulum.impact_unit == unit
