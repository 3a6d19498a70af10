"""Tests of multipliers against the exact integrator by two methods; tests/benchmarks/multipliers.py does 64 orbits."""

import numpy as np
import pytest
from exact import orbits as exact
from random_orbits import drawn, in_upper_half, off_by_differences, off_by_volumes

import vibrojax as vj


@pytest.mark.parametrize(("law", "seed"), [("stribeck", 2), pytest.param("hyperbolic", 3, marks=pytest.mark.long)])
def test_multipliers_at_random_points(law, seed):
    """Compare with central differences, which have errors of about 1e-8 themselves, and with volumes.

    Most saltations that change volumes are of a bit that turns without sticking, where friction changes its sign.
    A missing saltation would show as a factor like 0.01.
    """
    orbits = drawn(law, 64, seed)
    for orbit in orbits[:3]:
        assert off_by_differences(orbit) < 1e-6
    sliding = [off_by_volumes(orbit) for orbit in [candidate for candidate in orbits if candidate.stick == 0][:6]]
    assert len(sliding) >= 5
    assert all(off < 1e-7 for off, _ in sliding)
    assert sum(jumps < 0.9 for _, jumps in sliding) >= 2


def test_multipliers_without_impacts():
    points = {"beta": [0.3, 0.45], "gamma": [0.65, 0.75], "v": [1.0, 1.3]}
    ds = vj.run_sweep(
        {"scene": "rotary", "points": points, "starts": ["stuck"], "run": {"orbits": True}}, progress=False
    )
    for index in range(2):
        lane = ds.isel(point=index, start=0)
        assert lane.orbit_reason == 0 and lane.cycles == 1
        parameters = {name: column[index] for name, column in points.items()}
        section = np.array([lane[f"orbit_{name}"].item() for name in ("x1", "x2", "v2")])
        _, states = exact.returns("rotary", parameters, section, 1.01 * lane.period.item())
        np.testing.assert_allclose(states[0], section, atol=1e-10)
        values = exact.multipliers("rotary", parameters, section, lane.period.item())
        computed = lane.multiplier_abs.values * np.exp(1j * lane.multiplier_arg.values)
        np.testing.assert_allclose(computed, in_upper_half(values), atol=1e-6)
