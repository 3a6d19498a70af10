"""Test that `error_estimate` of penetration covers settling and the mean over a finite observation."""

import numpy as np
import pytest

import vibrojax as vj

BEATING = {
    "force": 364187.2,
    "frequency": 32.95242,
    "pulse_width": 0.002,
    "threshold": 202693.9,
    "k3": 36945190.0,
    "zeta": 0.0,
    "pulse_shape": "half-sine",
}
"""Without damping, the bit beats for seconds before a pulse first breaks the rock."""


def dataset(times, **parameters):
    run = {"settle": times, "observe": times}
    grid = {"frequency": [parameters.pop("frequency", 20.0)]}
    return vj.run_sweep(
        {"scene": "penetration", "parameters": parameters, "grid": grid, "run": run, "unusual": True}, progress=False
    )


def test_undamped_lane_is_not_certified():
    """In the first second, no pulse breaks the rock. Later, the rate is 0.05 m/s."""
    ds = dataset(1.0, **BEATING)
    assert not float(ds.error_estimate.item()) <= 1.0
    assert ds.attrs["certified"].count('"within": 0') == 1


@pytest.mark.parametrize("force, yields", [(20e3, False), (200e3, True)])
def test_damped_lane_is_certified(force, yields):
    """A rate of zero is certified as well if the load stays below the yield force."""
    ds = dataset(1.0, force=force)
    assert (float(ds.rate_of_penetration.item()) > 0) == yields
    assert float(ds.error_estimate.item()) < 1e-6


def test_swept_sine_does_not_repeat():
    """The rate is the mean over the observation; there is no settled motion."""
    ds = vj.run_sweep(
        {
            "scene": "penetration",
            "parameters": {"pulse_shape": "sweep"},
            "grid": {"bias": [60e3]},
            "run": {"settle": 0.5, "observe": 0.5},
        },
        progress=False,
    )
    assert np.isfinite(ds.rate_of_penetration.item()) and np.isnan(ds.error_estimate.item())


def test_undamped_rock_under_a_drill():
    """The drill has settled after 5 s, but the bit still moves on the rock: the rate of penetration is 20 % too low."""
    point = {
        "beta": 0.1342515580221152,
        "gamma": 0.48801906227391845,
        "v": 1.2542774914090655,
        "c2": 141.5584516830171,
        "delta": -0.00381931693952789,
    }
    rock = {"zeta": 0.0, "threshold": 54599.84978859603, "k3": 21316867.615476258}
    estimates = {}
    for scene, parameters in (("vibro-impact", point), ("drilling", point | rock)):
        sweep = {"scene": scene, "parameters": parameters, "grid": {"mu": [0.4]}, "starts": ["stuck"]}
        ds = vj.run_sweep(sweep | {"run": {"settle": 5.0, "observe": 3.0}}, progress=False)
        assert ds.cycles.item() == 1
        estimates[scene] = float(ds.error_estimate.item())
    assert estimates["vibro-impact"] < 1e-4 < 0.2 < estimates["drilling"]
