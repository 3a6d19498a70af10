"""Test the drill on rock: one-way coupling leaves the motion of the drill unchanged, feedback softens its blows.

tests/test_exact.py compares the motion with the exact reference, and with it momentum and energy.
"""

import numpy as np
import pytest

import vibrojax as vj

SWEEP = {
    "grid": {"gamma": [0.6, 0.7, 0.8], "beta": [0.25, 0.4], "v": [1.0, 2.0]},
    "starts": ["stuck"],
    "run": {"settle": 10.0, "observe": 4.0, "error": 1e-5},
}
SANDSTONE = 61.9e3
DRILL = ("period", "impact_velocity", "impact_phase", "peak_impact_force", "stick_fraction", "bit_amplitude")
DRILL += ("striker_amplitude", "settling_time", "drive_power")


@pytest.fixture(scope="module")
def sweeps():
    scenes = ("vibro-impact", "drilling", "coupled-drilling")
    return {scene: vj.run_sweep(SWEEP | {"scene": scene}, progress=False) for scene in scenes}


def test_one_way_coupling_leaves_drill_unchanged(sweeps):
    """The equations for x1 and x2 are the same, so labels and counts are equal. Steps also end on the rock's switches,
    so the other quantities agree to the error of the steps, 1e-8.
    """
    free, drilling = sweeps["vibro-impact"], sweeps["drilling"]
    assert np.all(free.cycles > 0)
    for name in ("regime", "cycles", "impacts", "returns", "striker_turns", "status", "reason"):
        if name in free:
            np.testing.assert_array_equal(drilling[name], free[name])
    for name in DRILL:
        scale = 1.0 if name in ("stick_fraction", "reverse_fraction", "impact_phase") else free[name].values
        difference = (drilling[name].values - free[name].values) / scale
        assert np.nanmax(np.abs(difference)) < 1e-8, name
    np.testing.assert_allclose(drilling.phase_lag, free.phase_lag, atol=1e-4)
    assert set(drilling.data_vars) > set(free.data_vars)


@pytest.mark.parametrize("scene", ["drilling", "coupled-drilling"])
def test_quantities_are_consistent(sweeps, scene):
    """P = mean J, eta = P/D, and ROP = s impacts/(cycles period), the growth per second over whole cycles."""
    d = sweeps[scene]
    periodic = (d.cycles > 0).values
    assert periodic.sum() > 8
    np.testing.assert_array_equal(d.mean_force, d.mean_impact_force)
    np.testing.assert_allclose(d.relief, d.mean_impact_force / SANDSTONE, rtol=1e-13)
    rate = (d.slip_per_impact * d.impacts / (d.cycles * d.period)).values
    np.testing.assert_allclose(d.rate_of_penetration.values[periodic], rate[periodic], rtol=1e-12)
    assert np.all(d.rate_of_penetration >= 0)
    assert np.all(d.rate_of_penetration <= d.mean_force / (2 * 1.5 * np.sqrt(250 * 100.68e6)))  # mean N >= 0
