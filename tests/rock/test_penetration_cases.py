"""Test penetration against the reference cases (tests/data), and C in the listing's rate against model.md."""

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

C_SEEN = {300e6: (0.061, 0.121, 0.187), 500e6: (0.051, 0.101, 0.154)}  # m/s, model.md section 5
FORCES, FREQUENCIES = (200e3, 250e3, 300e3), (10.0, 20.0, 30.0, 40.0)


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


@pytest.fixture(scope="module")
def listing():
    """Return the grid of model.md section 5: zeta 0.6, D = 150 kN, rectangular pulses of 4 ms."""
    grid = {"k3": list(C_SEEN), "force": list(FORCES), "frequency": list(FREQUENCIES)}
    fixed = {"zeta": 0.6, "threshold": 150e3, "pulse_width": 4e-3}
    return vj.run_sweep({"scene": "penetration", "parameters": fixed, "grid": grid, "run": SHORT}, progress=False)


def fit_c(rate, relief):
    """Return C of 2 pi ROP = C ln eta + b by least squares (R8, onset form of R9)."""
    return np.polyfit(np.log(relief), 2 * np.pi * rate, 1)[0]


def test_c_of_listing_rate(listing):
    """C agrees with model.md to 2 %: 0.061, 0.121, 0.187 at k3 = 300 MN/m and 0.051, 0.101, 0.154 at 500 MN/m."""
    for k3, seen in C_SEEN.items():
        for force, c in zip(FORCES, seen, strict=True):
            line = listing.sel(k3=k3, force=force)
            c_fitted = fit_c(line.rate_of_penetration.values, line.relief.values)
            assert abs(c_fitted / c - 1) < 0.02, (k3, force, c_fitted)
