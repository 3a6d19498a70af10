"""Test that `error_estimate` of penetration covers settling and the mean over a finite observation."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.lanes.certificate import drift_under_pulses, error_under_pulses

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

STATES = ("compression", "v3")
STEPS, LEAST, TOLERANCE = 0.0, 1e-10, 1e-7


def dataset(times, **parameters):
    run = {"settle": times, "observe": times}
    grid = {"frequency": [parameters.pop("frequency", 20.0)]}
    return vj.run_sweep(
        {"scene": "penetration", "parameters": parameters, "grid": grid, "run": run, "unusual": True}, progress=False
    )


def lane(growth, distance, load=1.0, pulses=25, total=None):
    """Return features of a lane, and of a check run with the same rate.

    `growth`, `distance`: functions of the numbers of pulses, the growth of the hole [m] in the period before and the
    distance of the states from those of an orbit, over their scales. `total`: pulses in the observation.
    """
    number = np.arange(-(total or pulses) + 1, 1)
    mean = np.mean(growth(number[1:]))
    states = {"compression": 0.3 + 0.8 * distance(number), "v3": -0.2 - 0.5 * distance(number)}
    features = {f"return_{name}": 2.0 * x[None, -pulses:] for name, x in states.items()}
    features |= {f"{name}_scale": np.array([2.0]) for name in STATES}
    features |= {"return_growth": np.concatenate([[np.nan], growth(number[1:])])[None, -pulses:]}
    return features | {
        "slip_per_impact": np.array([mean]),
        "rate_of_penetration": np.array([20.0 * mean]),
        "load": np.array([load]),
    }


def estimate(features):
    away = drift_under_pulses(features, STATES, "float64", TOLERANCE)
    return float(error_under_pulses(features, features, away, STEPS, LEAST)[0])


def settled(k):
    return 0.0 * k


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_undamped_lane_is_not_certified(times):
    """In the first second, no pulse breaks the rock. Later, the rate is 0.05 m/s."""
    ds = dataset(times, **BEATING)
    assert not float(ds.error_estimate.item()) <= 1.0
    assert ds.attrs["certified"].count('"within": 0') == 1


def test_unbounded_growth_is_not_certified():
    """Without damping, a mean force above the yield force accelerates the bit for ever."""
    ds = dataset(1.0, force=500e3, pulse_width=0.02, threshold=100e3, zeta=0.0)
    assert float(ds.relief.item()) > 1 and not float(ds.error_estimate.item()) <= 1.0


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


@pytest.mark.parametrize("pulses", [10, 11, 25, 160, 161])
def test_mean_over_incomplete_periods(pulses):
    """Growth alternates between 1 and 3 mm: a mean over an odd number of pulses is off by 1/(2 n) and less."""
    alternating = lane(lambda k: 1e-3 * (2 + (-1.0) ** k), lambda k: 0.05 * (-1.0) ** k, total=pulses)
    error = abs(2e-3 / alternating["slip_per_impact"][0] - 1)
    assert error < 1e-14 or 1 / (3 * pulses) < error < 1 / pulses
    assert error <= estimate(alternating) <= 1.3 * error + 1e-9


@pytest.mark.parametrize("multiplier", [0.98, 0.9, -0.95])
def test_growth_that_settles(multiplier):
    def away(k):
        return 1e-4 * multiplier ** k.astype(float)

    settling = lane(lambda k: 1e-3 * (1 + 0.4 * away(k)), away)
    error = abs(1e-3 / settling["slip_per_impact"][0] - 1)
    assert error <= estimate(settling) <= 10 * max(error, 1e-4)


def test_zero_rate_near_yield_force():
    """A load that still rises may yet break the rock."""

    def rises(k):
        return -1e-4 * 0.97 ** k.astype(float)

    assert np.isinf(estimate(lane(settled, rises, load=0.9999)))
    assert estimate(lane(settled, rises, load=0.9)) < 1e-2
    assert estimate(lane(settled, settled, load=0.9999)) < 1e-9


def test_pulses_that_do_not_repeat_have_no_estimate():
    rng = np.random.default_rng(0)
    assert np.isnan(estimate(lane(settled, lambda k: 0.1 * rng.standard_normal(len(k)))))
    assert np.isnan(estimate(lane(settled, settled, pulses=3)))


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
