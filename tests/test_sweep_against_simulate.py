"""Test sweeps against single trajectories: lanes in blocks, and the features that `simulate` reports."""

import json

import numpy as np
import pytest
import xarray as xr
from systems import mass

import vibrojax as vj
from vibrojax.studies.sweep import frequency_part
from vibrojax.studies.trajectory import feature_lines

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
