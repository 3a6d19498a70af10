"""Test sweeps against single trajectories: lanes in blocks, and the features that `simulate` reports."""

import json

import numpy as np
import pytest
import xarray as xr
from systems import mass

import vibrojax as vj
from vibrojax.lanes.record import window
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.studies.sweep import frequency_part
from vibrojax.studies.trajectory import feature_lines

LANES = 96
COMPARED = (0, 63, 64, 95)
"""The first and the last lane, and the lanes on either side of the border between a full and a short block."""

SETTLE, OBSERVE, ERROR = 0.3, 0.9, 1e-4
DRILLS = ("rotary", "vibro-impact", "drilling", "coupled-drilling")
SHORT = ("vibro-impact", "stribeck"), ("vibro-impact", "hyperbolic"), ("coupled-drilling", "coulomb")


def columns(scene: str) -> dict:
    """Return lanes over the usual range of the parameters, all different."""
    rng = np.random.default_rng(96)
    if scene == "penetration":
        return {"zeta": rng.uniform(0.6, 1.5, LANES), "k3": rng.uniform(100e6, 400e6, LANES)}
    drill = {
        "beta": rng.uniform(0.25, 0.6, LANES),
        "gamma": rng.uniform(0.5, 0.9, LANES),
        "v": rng.uniform(0.5, 1.5, LANES),
    }
    if scene != "rotary":
        drill["delta"] = rng.uniform(-0.005, 0.005, LANES)
    return drill | {"start": np.array(["stuck", "drive"] * (LANES // 2))}


def run_points(scene: str, points: dict, run: dict, **parameters):
    run = {"settle": SETTLE, "observe": OBSERVE, "error": ERROR} | run
    points = {name: column.tolist() for name, column in points.items()}
    sweep = {"scene": scene, "points": points, "parameters": parameters, "run": run}
    dataset = vj.run_sweep(sweep, progress=False)
    assert json.loads(dataset.attrs["solver"])["compiler"] == "llvm"  # kernels support every scene, law and pulse shape
    return dataset


def section_times(motion) -> np.ndarray:
    kinds = motion.event_kind.attrs["flag_meanings"].split()
    times = motion.event_time.values[motion.event_kind.values == kinds.index("section")]
    return times[times > SETTLE]


def drill_cases():
    """Yield every drill with every law. A case is long if others, or `test_exact.py`, cover its drill and its law."""
    for scene in DRILLS:
        for law in FRICTION_LAWS:
            covered = (scene, law) not in SHORT
            yield pytest.param(scene, law, marks=[pytest.mark.long] * covered)


@pytest.mark.parametrize(("scene", "law"), list(drill_cases()))
def test_drill_agrees_with_trajectory(scene, law):
    """Every return to the section comes at the same time, and the hole grows by the same depth in between."""
    dataset = run_points(scene, columns(scene), {"keep_returns": 25}, friction=law)
    returns = 0
    for lane in COMPARED:
        point = {name: column[lane].item() for name, column in columns(scene).items()}
        setting = {"duration": SETTLE + OBSERVE, "error": ERROR, "sampling": 1e-3, "progress": False}
        motion = vj.simulate(scene, friction=law, **point, **setting)
        times = section_times(motion)
        lane_data = dataset.isel(point=lane)
        assert lane_data.status == 0
        kept = lane_data.return_time.values
        np.testing.assert_allclose(kept[np.isfinite(kept)], times, rtol=ERROR, err_msg=str(point))
        returns += len(times)
        if "x4" in motion and len(times) > 1:
            first, last = np.interp(times[[0, -1]], motion.time, motion.x4)
            rate = (last - first) / (times[-1] - times[0])
            np.testing.assert_allclose(lane_data.rate_of_penetration, rate, rtol=10 * ERROR, atol=1e-9)
    assert returns >= 6


@pytest.mark.parametrize("shape", ["rectangular", pytest.param("half-sine", marks=pytest.mark.long)])
def test_pulses_agree_with_trajectory(shape):
    """The hole grows by the same depth in 18 pulses."""
    points = columns("penetration")
    dataset = run_points("penetration", points, {}, force=500e3, pulse_shape=shape)
    for lane in COMPARED:
        point = {name: column[lane].item() for name, column in points.items()}
        motion = vj.simulate(
            "penetration", pulse_shape=shape, force=500e3, **point, duration=1.2, sampling=1e-3, progress=False
        )
        before, after = np.interp([0.29, 1.19], motion.time, motion.x4)  # outside the pulses
        assert after > before
        np.testing.assert_allclose(dataset.rate_of_penetration[lane], (after - before) / 0.9, rtol=ERROR)


# The features that `simulate` reports, and their text

STRONG = {"threshold": 30e3, "delta": 0.002}
POINTS = {
    "vibro-impact": ({"delta": 0.002, "gamma": 0.5, "beta": 0.9}, 12.0),
    "coupled-drilling": (STRONG, 5.0),
    "penetration": ({"force": 300e3}, 1.0),
}
ROUNDING = {"drift_estimate", "deepest_gap", "stick_fraction"}
"""Features that are zero here up to rounding, or that measure rounding."""


def swept_lane(scene, parameters, run, **more):
    """Return the only lane of a sweep that settles and is observed as `run` says."""
    starts = {} if scene == "penetration" else {"starts": ["stuck"]}
    sweep = {"scene": scene, "parameters": parameters, "grid": {"m1": [250.0]}, "run": run | more} | starts
    return vj.run_sweep(sweep, progress=False).squeeze()


@pytest.mark.parametrize("scene", POINTS)
def test_motion_is_measured_and_labelled_like_lane_of_sweep(scene):
    parameters, duration = POINTS[scene]
    start = {} if scene == "penetration" else {"start": "stuck"}
    motion = vj.simulate(scene, duration=duration, progress=False, **parameters, **start)
    lane = swept_lane(scene, parameters, json.loads(motion.attrs["run"]), end_early=False)
    sweep_only = {"check_regime", "error_estimate", "sensitive", "status", "reason"}
    assert set(lane.data_vars) - sweep_only == {name for name in motion.data_vars if motion[name].ndim == 0}
    for name in set(lane.data_vars) - sweep_only:
        assert motion[name].attrs["units"] == lane[name].attrs["units"]
        assert motion[name].dtype == lane[name].dtype
        atol = 1e-7 if name in ROUNDING else 0.0
        np.testing.assert_allclose(motion[name], lane[name], rtol=1e-7, atol=atol, err_msg=name)


def test_default_observation_is_that_of_sweeps():
    drill = vj.SCENES["vibro-impact"]()
    assert window(drill, 48.0) == (40.0, 8.0)
    assert window(drill, 20.0) == (12.0, 8.0)
    assert window(drill, 1.0) == (0.5, 0.5)
    assert window(drill, 120.0) == (100.0, 20.0)


def test_undecided_motion_names_a_sufficient_duration():
    motion = vj.simulate("vibro-impact", duration=1.0, progress=False)
    line = feature_lines(motion)[0]
    assert line.startswith("undecided: 2 returns to the section are too few to judge by, 9 are needed; give duration=")
    enough = float(line.rpartition("=")[2])
    longer = vj.simulate("vibro-impact", duration=enough, progress=False)
    assert longer["returns"] >= 9
    still = vj.simulate("vibro-impact", v=0.0, duration=1.0, progress=False)
    assert "the drive is at rest: give v above 0" in feature_lines(still)[0]


def test_short_motion_that_repeats_has_its_period():
    """12 cycles of a damped, driven oscillator: too few returns for a regime, enough for the period."""
    rate = lambda t, y, p: vj.elementary.cos(2 * t) - 2 * p["zeta"] * y["v"] - y["x"]  # noqa: E731
    oscillator = mass(rate, parameters={"zeta": 0.5}, period=lambda p: np.pi)
    motion = vj.simulate(oscillator, duration=12 * np.pi, progress=False)
    assert int(motion.cycles) == 1 and float(motion.period) == pytest.approx(np.pi, rel=1e-12)
    assert "so far it repeats in each period of 3.1416 s; give duration=" in feature_lines(motion)[0]


def test_frequencies_are_outputs():
    """Compare with w1/2pi, w2/2pi, the roots of the frequency equation (sum and product), and impacts per minute."""
    motion = vj.simulate("vibro-impact", delta=0.005, start="stuck", striker_frequency=3.0, progress=False)
    outputs = vj.frequencies(motion)
    assert float(outputs["bit_frequency"]) == pytest.approx(25 / (2 * np.pi))
    assert float(outputs["striker_frequency"]) == pytest.approx(3.0) and outputs["striker_frequency"].units == "Hz"
    squares = [(2 * np.pi * float(outputs[name])) ** 2 for name in ("lower_frequency", "upper_frequency")]
    gamma = 6 * np.pi / 25
    assert sum(squares) == pytest.approx(625 * (1 + gamma**2 * 1.4))
    assert np.prod(squares) == pytest.approx(625**2 * gamma**2)
    single = float(motion.impacts) == float(motion.cycles) == 1
    assert single and float(outputs["blow_frequency"]) == pytest.approx(60 / float(motion.period))
    ds = xr.Dataset(
        {"impacts": ("rpm", [3.0, 0.5, 0.0]), "cycles": ("rpm", [2, 0, 1]), "period": ("rpm", [0.2, 0.25, 0.2])},
        {"rpm": ("rpm", [100.0, 110.0, 120.0])},
        {"sweep": 'scene = "vibro-impact"\n[parameters]\nbit_radius = 0.1\n'},
    )
    np.testing.assert_allclose(vj.frequencies(ds)["blow_frequency"], [450.0, 120.0, 0.0])
    part = frequency_part(ds)
    assert part.lines == ["blows 0 to 450 1/min, rotation 100 to 120 1/min"]
    assert part.facts["frequencies"]["rpm"] == {"least": 100.0, "greatest": 120.0, "units": "min-1"}
