"""Test penetration against the reference cases (tests/data)."""

import json
from pathlib import Path

import numpy as np
import pytest

import vibrojax as vj

CASES = json.loads((Path(__file__).parents[1] / "data" / "penetration_cases.json").read_text())
NAMES = {"A": "force", "f": "frequency", "w": "pulse_width", "D": "threshold", "k3": "k3", "zeta": "zeta"}
SHAPES = ("rectangular", "half-sine")
SHORT = {"settle": 2.0, "observe": 1.0}
"""Run settings. The slowest cases strike 10 times a second, so 20 pulses settle; the reference takes 60."""


def cases_of(shape):
    return [case for case in CASES if case["point"]["shape"] == shape]


def run_cases(shape):
    points = {name: [case["point"][key] for case in cases_of(shape)] for key, name in NAMES.items()}
    sweep = {"scene": "penetration", "parameters": {"pulse_shape": shape}, "points": points, "run": SHORT}
    return vj.run_sweep(sweep, progress=False)


@pytest.fixture(scope="module")
def datasets():
    return {shape: run_cases(shape) for shape in SHAPES}


def expected(shape, name):
    return np.array([case["expected"][name] for case in cases_of(shape)])


def test_all_cases_run(datasets):
    """There are 24 cases. In both shapes some slip and some do not."""
    assert sum(dataset.sizes["point"] for dataset in datasets.values()) == len(CASES) == 24
    for shape, dataset in datasets.items():
        assert not dataset.status.any(), shape
        assert {slip > 0 for slip in expected(shape, "slip_per_pulse")} == {True, False}


@pytest.mark.parametrize("shape", SHAPES)
def test_measures(datasets, shape):
    """P = A w f for rectangular pulses, times 2/pi for half-sines, eta = P/D, and ROP = s f (R8, in true units)."""
    ds = datasets[shape]
    bounds = {"mean_force": (1e-10, 0.0), "relief": (1e-10, 0.0), "rate_of_penetration": (1e-8, 1e-11)}
    for name, (relative, absolute) in bounds.items():
        np.testing.assert_allclose(ds[name], expected(shape, name), rtol=relative, atol=absolute, err_msg=name)
    slip, exact = ds.slip_per_impact.values, expected(shape, "slip_per_pulse")
    np.testing.assert_allclose(slip, exact, rtol=1e-8, atol=1e-12)
    assert np.all(slip[exact == 0] == 0)
    np.testing.assert_allclose(ds.rate_of_penetration, slip * ds.frequency, rtol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_error_estimate_is_upper_bound(datasets, shape):
    """The estimate bounds the error and stays below the accepted 1e-4."""
    exact = expected(shape, "rate_of_penetration")
    rate, estimate = datasets[shape].rate_of_penetration.values, datasets[shape].error_estimate.values
    assert np.all(estimate < 1e-4)
    assert np.all(np.abs(rate - exact) <= estimate * exact + 1e-8 * exact + 1e-11)  # the reference is accurate to 1e-9
