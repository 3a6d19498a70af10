"""Tests of the measures that the time loop accumulates: against the exact reference, and at corners of their rules."""

import exact
import jax.numpy as jnp
import numpy as np
import pytest
from exact.measures import sections

import vibrojax as vj
from vibrojax.measures.motion import _trend

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

# Reference case 10, which repeats after two returns, of 15 and 179 ms.
UNEQUAL = {"beta": 0.856, "gamma": 0.719, "v": 1.497, "delta": -0.0009}


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


def test_phases_of_unequal_returns():
    """The phase is that of the mean period, wherever in a repeat the observation begins and ends.

    Each impact counts by its own return, whose duration differs from the mean.
    """
    sweep = {"scene": "vibro-impact", "points": {key: [value] for key, value in UNEQUAL.items()}, "starts": ["drive"]}
    lane = vj.run_sweep(sweep | {"run": {"observe": 7.0, "error": ERROR}}, progress=False).squeeze()
    assert lane.cycles == 2
    motion = exact.run("vibro-impact", **UNEQUAL, start="drive", settle=40.0, observe=7.0)
    expected = exact.measure(motion)
    assert np.ptp(np.diff(sections(motion))) > 0.02
    assert_close(lane.phase_lag, expected["phase_lag"], 0, 1e-3)
    assert_close(lane.impact_phase, expected["impact_phase"], 1e-6)


def test_settling_time(features, name="gap"):
    """The last return counts whose state s differs from the next by over 0.01, scaled by the swings between the two."""
    lane = features[name]
    scene, values, start = LANES[name]
    motion = vj.simulate(
        scene, **values, start=start, duration=SETTLE + OBSERVE, sampling=1e-4, error=ERROR, progress=False
    )
    kinds = motion.event_kind.attrs["flag_meanings"].split()
    crossings = motion.event_time.values[motion.event_kind.values == kinds.index("section")]
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


def test_means_cover_whole_repeats():
    """The means of a lane that repeats after four returns (k1 = 625000, gamma 1.1) cover a multiple of four."""
    points = {"gamma": [1.1, 1.1], "beta": [0.4, 0.4], "k1": [625000.0, 625000.0], "start": ["stuck", "drive"]}
    lane = vj.run_sweep({"scene": "vibro-impact", "points": points}, progress=False).isel(point=1)
    assert lane.cycles == 4
    assert lane.impacts == 6
    motion = vj.simulate("vibro-impact", beta=0.4, gamma=1.1, k1=625000.0, duration=48.0, sampling=0.1, progress=False)
    kinds = motion.event_kind.attrs["flag_meanings"].split()
    times = {kind: motion.event_time.values[motion.event_kind.values == kinds.index(kind)] for kind in kinds}
    sections = times["section"][times["section"] > 40.0]
    whole = (len(sections) - 1) // 4 * 4
    assert whole < len(sections) - 1  # otherwise all returns are covered anyway
    assert_close(lane.period, (sections[whole] - sections[0]) / whole, 1e-8)


@pytest.mark.parametrize(
    ("greatest", "trend"),
    [
        ([1, 2, 3, 4, 5, 6, 7, 8], 1),
        ([8, 7, 6, 5, 4, 3, 2, 1], -1),
        ([1, 2, 3, 4, 4, 6, 7, 8], 0),  # not strictly monotonic
        ([1, 2, 3, 4, 3, 6, 7, 8], 0),
        ([100, 100.1, 100.2, 100.3, 100.4, 100.5, 100.6, 100.7], 0),  # by less than 1 %
        ([100, 100.1, 100.2, 100.3, 100.4, 100.5, 100.6, 101.1], 1),
        ([1, 2, 3, np.nan, 5, 6, 7, 8], 0),  # one eighth has no return
    ],
)
def test_trend_of_eighths(greatest, trend):
    assert _trend(jnp.array(greatest, float)[:, None])[0] == trend
