"""Test which pulses are counted and which are refused."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import InputError


def run_points(points, **run):
    return vj.run_sweep({"scene": "penetration", "points": points, "run": run}, progress=False)


def test_first_pulse_is_counted():
    """Observed from t = 0 and rest, the first pulses drill as deep as in the trajectory."""
    dataset = run_points({"frequency": [20.0, 7.0], "force": [3e5, 2e5]}, settle=0.0, observe=0.52)
    for index, (frequency, force, pulses) in enumerate(((20.0, 3e5, 10), (7.0, 2e5, 3))):
        motion = vj.simulate(
            "penetration", frequency=frequency, force=force, duration=0.52, sampling=1e-4, progress=False
        )
        depth = np.interp(pulses / frequency, motion.time, motion.x4)
        np.testing.assert_allclose(dataset.slip_per_impact[index], depth / pulses, rtol=1e-6)


def test_rate_is_missing_without_complete_pulse():
    dataset = run_points({"frequency": [0.1, 0.2, 20.0]}, settle=1.0, observe=6.0)
    assert np.all(np.isnan(dataset.rate_of_penetration[:2]))
    assert np.isfinite(dataset.rate_of_penetration[2])
    assert np.all(dataset.status == 0)


def test_overlapping_pulses_are_refused():
    dataset = run_points(
        {"pulse_width": [0.05, 0.06, 0.0499], "frequency": [20.0, 20.0, 20.0]}, settle=0.2, observe=1.0
    )
    meanings = dataset.reason.attrs["flag_meanings"].split()
    why = "pulse-width-not-below-1-over-frequency"
    assert [meanings[flag] for flag in dataset.reason.values] == [why, why, "none"]
    np.testing.assert_array_equal(dataset.status, [2, 2, 0])
    np.testing.assert_array_equal(np.isnan(dataset.rate_of_penetration), [True, True, False])
    with pytest.raises(InputError, match="pulse width not below 1/frequency"):
        vj.simulate("penetration", pulse_width=0.05, frequency=20.0, duration=0.1, progress=False)
