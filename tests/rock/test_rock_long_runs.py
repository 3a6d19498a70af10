"""Test that late blows are as exact as the first, also in float32: no state holds the depth."""

import numpy as np
import pytest

import vibrojax as vj

FAST = {"threshold": 150e3, "k3": 20e9, "pulse_width": 3e-4, "zeta": 0.9}
"""A thousand blows per second on a very stiff rock, each a few tens of steps long."""


def sweep(name, settle, observe):
    run = {"settle": settle, "observe": observe, "precision": name}
    grid = {"force": [200e3, 300e3], "frequency": [1000.0]}
    return vj.run_sweep({"scene": "penetration", "parameters": FAST, "grid": grid, "run": run}, progress=False)


@pytest.mark.parametrize(("name", "blows", "rtol"), [("float64", 4_000, 1e-12), ("float32", 20_000, 1e-6)])
def test_thousands_of_blows(name, blows, rtol):
    """The slip of forty blows after many blows agrees with that of blows 201 to 240."""
    early, late = sweep(name, 0.2, 0.0405), sweep(name, blows / 1000, 0.0405)
    assert np.all(early.slip_per_impact > 1e-7)
    np.testing.assert_allclose(late.slip_per_impact, early.slip_per_impact, rtol=rtol)
