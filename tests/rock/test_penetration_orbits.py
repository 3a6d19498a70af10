"""Test orbits under pulses, stroboscopic at the pulse, against the exact reference and a closed form."""

import exact
import numpy as np
import pytest

import vibrojax as vj

M1 = 250.0
FOUND = 0
COLUMNS = ("force", "frequency", "pulse_width", "zeta", "threshold", "k3")
POINTS = {
    "pressed without a pause": (5e3, 200.0, 2e-3, 1.1, 1e7, 300e6),
    "jumps off": (5e3, 100.0, 2e-3, 0.3, 1e7, 300e6),
    "yields, and comes to rest": (200e3, 20.0, 4e-3, 1.1, 150e3, 300e6),
    "yields and jumps off": (300e3, 150.0, 3e-3, 0.2, 150e3, 300e6),
    "never stops to yield": (207e3, 212.0, 3.7e-3, 0.3925, 85e3, 14.2e6),
    "two pulses": (24774.87, 169.046, 2.46e-3, 0.03131, 112879.0, 140.4925e6),
    "two pulses, one of which yields": (98373.2, 54.5255, 8.11e-3, 0.112, 240579.0, 267.12e6),
}


def run_points(**more):
    columns = dict(zip(COLUMNS, map(list, zip(*POINTS.values(), strict=True)), strict=True))
    run = {"orbits": True, "settle": 4.0, "observe": 1.0}
    return vj.run_sweep(
        {"scene": "penetration", "points": columns, "parameters": more, "run": run, "unusual": True}, progress=False
    )


@pytest.fixture(scope="module")
def orbits():
    return run_points()


@pytest.mark.parametrize("name", POINTS)
def test_orbits_agree_with_exact_motion(orbits, name):
    lane, point = orbits.isel(point=list(POINTS).index(name)), dict(zip(COLUMNS, POINTS[name], strict=True))
    assert lane.orbit_reason == FOUND and lane.orbit_residual < 1e-10 and lane.stable == 1
    assert lane.orbit_cycles == (2 if "two" in name else 1)
    begin, time = (
        np.array([lane.orbit_compression.item(), lane.orbit_v3.item()]),
        lane.orbit_cycles.item() / point["frequency"],
    )

    def end(state):
        return exact.run("penetration", start=state, observe=time, **point).at([time])[0]

    sizes = [max(np.abs(begin).max(), 1e-4) * x for x in (1e-3, 1.0)]  # a bit at rest has none
    np.testing.assert_allclose(end(begin)[:2], begin, rtol=0, atol=1e-9 * sizes[1])
    steps = [1e-5 * size * unit for size, unit in zip(sizes, np.eye(2), strict=True)]
    slopes = [(end(begin + step) - end(begin - step))[:2] / (2 * step.sum()) for step in steps]
    exact_moduli = np.sort(np.abs(np.linalg.eigvals(np.transpose(slopes))))[::-1]
    np.testing.assert_allclose(lane.multiplier_abs, exact_moduli, rtol=0, atol=1e-6)
    np.testing.assert_allclose(lane.rate_of_penetration, end(begin)[2] / time, rtol=1e-8, atol=1e-12)
    if "yield" in name:
        assert lane.rate_of_penetration > 0 and lane.multiplier_abs[1] < 1e-14


def test_multipliers_under_constant_contact_do_not_depend_on_pulses(orbits):
    """The flow is linear throughout, so the multipliers are exp(r/frequency), m1 r² + c3 r + k3 = 0, for any pulse."""
    _, frequency, _, zeta, _, k3 = POINTS["pressed without a pause"]
    expected = np.sort(np.exp(np.roots([M1, 2 * zeta * np.sqrt(M1 * k3), k3]) / frequency))[::-1]
    for dataset in (orbits, run_points(pulse_shape="half-sine")):
        np.testing.assert_allclose(dataset.multiplier_abs[0], expected, rtol=1e-9)


def test_variables_of_orbits(orbits):
    assert "period" not in orbits and "cycles" not in orbits
    assert {"orbit_compression", "orbit_v3", "grazing_margin"} <= set(orbits.data_vars)
    assert {"multiplier_abs", "orbit_v3"} <= set(vj.list_variables("penetration").index)


def test_margin_is_the_least_compression_whatever_the_rounding_errors():
    """The next pulse turns the bit before it leaves the rock: its compression is least at the end of a step there."""
    grid = {"threshold": (204.5e3 * (1 + 1e-4 * np.arange(9))).tolist()}
    machine = {"k3": 45e6, "force": 500e3, "frequency": 20.0}
    run = {"orbits": True, "settle": 4.0, "observe": 1.0}
    ds = vj.run_sweep({"scene": "penetration", "parameters": machine, "grid": grid, "run": run}, progress=False)
    np.testing.assert_allclose(ds.grazing_margin, ds.orbit_compression * machine["k3"] / ds.threshold, rtol=2e-5)
