"""Tests of the package against the exact reference (tests/exact): trajectories, and measures of the time loop."""

import exact
import jax.numpy as jnp
import numpy as np
import pytest
from exact import measure, run
from exact.friction import LAWS
from exact.measures import sections
from systems import events_of

import vibrojax as vj
from vibrojax.measures.motion import _trend

SCENES = {
    "rotary": {"beta": 0.3, "gamma": 0.6, "v": 1.0},
    "vibro-impact": {"beta": 0.4, "gamma": 0.6, "start": "stuck", "v": 0.8},
    "drilling": {"beta": 0.4, "gamma": 0.6, "zeta": 0.5},
    "coupled-drilling": {"beta": 0.4, "gamma": 0.6, "zeta": 0.5},
    "penetration": {"zeta": 0.5, "force": 250e3, "pulse_shape": "half-sine"},
}
"""A point of each scene; both drilling scenes yield, lift off and land at theirs."""


def differences(motion, dataset):
    times = dataset.time.values
    return {
        name: np.abs(motion.column(name, times) - dataset[name].values).max()
        for name in ("x1", "v1", "x2", "v2", "x3", "v3", "x4")
        if name in dataset
    }


def run_both(scene, **point):
    dataset = vj.simulate(scene, duration=1.0, error=1e-6, progress=False, **point)
    return run(scene, observe=1.0, **point), dataset


@pytest.mark.parametrize("scene", SCENES)
def test_simulate(scene):
    """Positions agree to 1e-10 m, velocities to 1e-8 m/s, and times of impacts, sticks and slips to 1e-9 s."""
    motion, dataset = run_both(scene, **SCENES[scene])
    for name, difference in differences(motion, dataset).items():
        assert difference < (1e-10 if name[0] == "x" else 1e-8), name
    kinds = dataset.event_kind.attrs["flag_meanings"].split()
    is_start = {
        "impact": lambda event: event.name == "strikes",
        "stick": lambda event: event.name == "stops" and event.after.bit == 0,
        "slip": lambda event: event.before.bit != event.after.bit and event.after.bit != 0,
    }
    for kind, matches in is_start.items():
        event_times = dataset.event_time.values[dataset.event_kind.values == kinds.index(kind)]
        exact_times = [event.time for event in motion.events if matches(event)]
        np.testing.assert_allclose(event_times, exact_times, rtol=0, atol=1e-9, err_msg=kind)


@pytest.mark.parametrize("law", ["hyperbolic-quadratic", *(pytest.param(law, marks=pytest.mark.long) for law in LAWS)])
def test_simulate_friction_laws(law):
    motion, dataset = run_both("vibro-impact", beta=0.4, gamma=0.6, v=0.8, start="stuck", friction=law)
    errors = differences(motion, dataset)
    assert max(errors["x1"], errors["x2"]) < 1e-9


def test_contact_closes_again_when_rock_yields():
    """A released but still compressed contact closes again when x4' sets in: no impact occurs, and x2 does not jump."""
    point = {"beta": 0.08, "gamma": 1.9, "v": 2.0, "c0": 1e5, "c2": 50.0, "mu": 1.0, "start": "stuck"}
    rock = {"zeta": 0.1, "threshold": 5e3, "k3": 100e6}
    motion = run("coupled-drilling", observe=0.3, **point, **rock)
    [closes, *_] = [event for event in motion.events if event.name == "yields" and event.before.striker == "leaving"]
    assert closes.after.striker == "touching"
    dataset = vj.simulate("coupled-drilling", duration=0.3, error=1e-6, progress=False, **point, **rock)
    assert differences(motion, dataset)["x2"] < 1e-9


def test_sweep_of_coupled_drilling():
    """A settled drilling lane has the counts of the reference, and its measures to 1e-7."""
    run_for = {"settle": 10.0, "observe": 6.0}
    sweep = {"scene": "coupled-drilling", "starts": ["drive"], "grid": {"zeta": [0.5]}, "parameters": {"gamma": 0.6}}
    lane = vj.run_sweep(sweep | {"run": run_for}, progress=False).squeeze()
    motion = run("coupled-drilling", gamma=0.6, zeta=0.5, **run_for)
    expected = measure(motion)
    assert (expected["cycles"], expected["impacts"]) == (lane.cycles, lane.impacts)
    for name in ("period", "impact_velocity", "rate_of_penetration", "mean_force", "stick_fraction", "drive_power"):
        np.testing.assert_allclose(lane[name], expected[name], rtol=1e-7, atol=1e-9, err_msg=name)


SETTLE, OBSERVE = 10.0, 4.0
ERROR = 1e-5  # so small that the periods of sweep and simulation agree to 1e-9
USUAL = {"m1": 250.0, "beta": 0.4, "gamma": 0.75, "k1": 156250.0, "c2": 250.0, "v": 1.5, "g": 9.81, "mu": 0.4}
CONTACT = {"delta": -0.005, "k0": 50e6, "c0": 1e3}
# The stuck lane with a gap is first: starts then occur in the order of other tests, whose program these lanes share.
LANES = {
    "gap": ("vibro-impact", USUAL | CONTACT | {"delta": 0.005}, "stuck"),
    "preload": ("vibro-impact", USUAL | CONTACT, "drive"),
    "light": ("vibro-impact", USUAL | CONTACT | {"beta": 0.3, "gamma": 0.5}, "drive"),
    "free": ("rotary", USUAL | {"gamma": 0.5}, "stuck"),
    "in phase": ("rotary", USUAL | {"beta": 0.3, "gamma": 8.0, "v": 0.5, "c2": 75.0}, "drive"),
}


@pytest.fixture(scope="module")
def features():
    """Return datasets of one lane each, by name."""
    datasets = {}
    for scene in ("vibro-impact", "rotary"):
        lanes = {name: lane for name, lane in LANES.items() if lane[0] == scene}
        first = next(iter(lanes.values()))[1]
        points = {key: [values[key] for _, values, _ in lanes.values()] for key in first}
        points["start"] = [start for *_, start in lanes.values()]
        run = {"settle": SETTLE, "observe": OBSERVE, "error": ERROR}
        dataset = vj.run_sweep({"scene": scene, "points": points, "run": run}, progress=False)
        datasets |= {name: dataset.isel(point=index) for index, name in enumerate(lanes)}
    return datasets


def assert_close(value, expected, rtol=2e-4, atol=0.0):
    np.testing.assert_allclose(float(value), expected, rtol=rtol, atol=atol)


ABSOLUTE = {"stick_fraction": 1e-8, "reverse_fraction": 1e-8, "phase_lag": 1e-6}
"""Absolute tolerances; the others are relative, 1e-8."""


@pytest.mark.parametrize("name", LANES)
def test_every_measure(features, name):
    """Every measure equals that of the exact reference, which shares no code with the package."""
    lane, (scene, values, start) = features[name], LANES[name]
    motion = exact.run(scene, **values, start=start, settle=SETTLE, observe=OBSERVE)
    expected = exact.measure(motion)
    assert lane.cycles == 1
    assert lane.returns == len(sections(motion))
    assert ("impacts" in expected) == (scene == "vibro-impact")
    for quantity, value in expected.items():
        assert_close(lane[quantity], value, 1e-8, ABSOLUTE.get(quantity, 0.0))
    assert -np.pi < lane.phase_lag <= np.pi


def test_unequal_returns():
    """Means cover whole repeats, and the phase is that of the mean period, wherever in a repeat the observation ends.
    Each impact counts by its own return: here two returns, of 15 and 179 ms, make a repeat."""
    point = {"beta": 0.856, "gamma": 0.719, "v": 1.497, "delta": -0.0009}
    sweep = {"scene": "vibro-impact", "points": {key: [value] for key, value in point.items()}, "starts": ["drive"]}
    lane = vj.run_sweep(sweep | {"run": {"observe": 7.0, "error": ERROR}}, progress=False).squeeze()
    motion = exact.run("vibro-impact", **point, start="drive", settle=40.0, observe=7.0)
    expected, returns = exact.measure(motion), sections(motion)
    assert lane.cycles == 2 and np.ptp(np.diff(returns)) > 0.02 and len(returns) % 2 == 0  # the last return is left out
    assert_close(lane.period, expected["period"], 1e-7)
    assert_close(lane.phase_lag, expected["phase_lag"], 0, 1e-3)
    assert_close(lane.impact_phase, expected["impact_phase"], 1e-6)


def test_settling_time(features, name="gap"):
    """The last return counts whose state s differs from the next by over 0.01, scaled by the swings between the two."""
    lane = features[name]
    scene, values, start = LANES[name]
    settings = {"duration": SETTLE + OBSERVE, "sampling": 1e-4, "error": ERROR, "progress": False}
    motion = vj.simulate(scene, **values, start=start, **settings)
    crossings = events_of(motion, "section")
    t = motion.time.values
    x1, x2, v2 = (np.interp(crossings, t, motion[y].values) for y in ("x1", "x2", "v2"))
    last = 0.0
    for k in range(len(crossings) - 1):
        between = (t >= crossings[k]) & (t <= crossings[k + 1])
        bit, striker = (np.ptp(motion[y].values[between]) / 2 for y in ("x1", "x2"))
        speed = striker * 2 * np.pi / (crossings[k + 1] - crossings[k])
        change = [(x1[k + 1] - x1[k]) / bit, (x2[k + 1] - x2[k]) / striker, (v2[k + 1] - v2[k]) / speed]
        if np.max(np.abs(change)) > 0.01:
            last = crossings[k]
    assert 0 < last < SETTLE
    assert_close(lane.settling_time, last, 1e-9)


def test_trend_of_eighths():
    """It is 0 if the swings do not rise strictly, or by less than 1 %, or if one eighth has no return."""
    not_strict, little, none = [1, 2, 3, 4, 4, 6, 7, 8], 100 + 0.1 * np.arange(8), [1, 2, 3, np.nan, 5, 6, 7, 8]
    lanes = jnp.array([np.arange(1, 9), np.arange(8, 0, -1), not_strict, little, none], float).T
    assert _trend(lanes).tolist() == [1, -1, 0, 0, 0]
