"""Tests of the exact reference (tests/exact) by itself, and of the package against it."""

import numpy as np
import pytest
from exact import measure, run
from exact.polynomials import COEFFICIENTS, X, falls

import vibrojax as vj

SCENES = {
    "rotary": {"beta": 0.3, "gamma": 0.6, "v": 1.0},
    "vibro-impact": {"beta": 0.4, "gamma": 0.6, "start": "stuck", "v": 0.8},
    "drilling": {"beta": 0.4, "gamma": 0.6, "zeta": 0.5},
    "coupled-drilling": {"beta": 0.4, "gamma": 0.6, "zeta": 0.5},
    "penetration": {"zeta": 0.5, "force": 250e3, "pulse_shape": "half-sine"},
}
"""A point of each scene; both drilling scenes yield, lift off and land at theirs."""


# The reference by itself


def test_falls_finds_every_downward_crossing():
    """cos 7x falls at -3 pi/14 and pi/14. A rise 1e-6 after a fall hides neither. A touch from above is not a fall."""

    def find_falls(function):
        return falls(COEFFICIENTS @ function(X), 1.0, 1.0)

    np.testing.assert_allclose(find_falls(lambda x: np.cos(7 * x)), [-3 * np.pi / 14, np.pi / 14], rtol=1e-12)
    np.testing.assert_allclose(find_falls(lambda x: -(x - 0.3) * (x - 0.3 - 1e-6) * (x - 0.7)), [0.3, 0.7], rtol=1e-8)
    assert find_falls(lambda x: (x - 0.2) ** 2) == []
    assert find_falls(lambda x: -1 - x / 10) == [-1.0]
    assert find_falls(np.cos) == []


# The package against the reference


def differences(motion, dataset):
    times = dataset.time.values
    return {
        name: np.abs(motion.column(name, times) - dataset[name].values).max()
        for name in ("x1", "v1", "x2", "v2", "x3", "v3", "x4")
        if name in dataset
    }


def run_both(scene, **point):
    dataset = vj.simulate(scene, duration=1.0, error=1e-6, progress=False, **point)
    return run(scene, observe=1.0, **point), dataset


@pytest.mark.parametrize("scene", SCENES)
def test_simulate(scene):
    """Positions agree to 1e-10 m, velocities to 1e-8 m/s, and times of impacts, sticks and slips to 1e-9 s."""
    motion, dataset = run_both(scene, **SCENES[scene])
    for name, difference in differences(motion, dataset).items():
        assert difference < (1e-10 if name[0] == "x" else 1e-8), name
    kinds = dataset.event_kind.attrs["flag_meanings"].split()
    is_start = {
        "impact": lambda event: event.name == "strikes",
        "stick": lambda event: event.name == "stops" and event.after.bit == 0,
        "slip": lambda event: event.before.bit != event.after.bit and event.after.bit != 0,
    }
    for kind, matches in is_start.items():
        event_times = dataset.event_time.values[dataset.event_kind.values == kinds.index(kind)]
        exact_times = [event.time for event in motion.events if matches(event)]
        np.testing.assert_allclose(event_times, exact_times, rtol=0, atol=1e-9, err_msg=kind)


@pytest.mark.parametrize(
    "law",
    ["hyperbolic-quadratic"]
    + [pytest.param(law, marks=pytest.mark.long) for law in ("popp-exponential", "popp-arctan", "coulomb")],
)
def test_simulate_friction_laws(law):
    motion, dataset = run_both("vibro-impact", beta=0.4, gamma=0.6, v=0.8, start="stuck", friction=law)
    errors = differences(motion, dataset)
    assert max(errors["x1"], errors["x2"]) < 1e-9


def test_contact_closes_again_when_rock_yields():
    """A released but still compressed contact closes again when x4' sets in: no impact occurs, and x2 does not jump."""
    point = {"beta": 0.08, "gamma": 1.9, "v": 2.0, "c0": 1e5, "c2": 50.0, "mu": 1.0, "start": "stuck"}
    rock = {"zeta": 0.1, "threshold": 5e3, "k3": 100e6}
    motion = run("coupled-drilling", observe=0.3, **point, **rock)
    closings = [event for event in motion.events if event.name == "yields" and event.before.striker == "leaving"]
    assert closings
    assert closings[0].after.striker == "touching"
    dataset = vj.simulate("coupled-drilling", duration=0.3, error=1e-6, progress=False, **point, **rock)
    assert differences(motion, dataset)["x2"] < 1e-9


def test_sweep_of_coupled_drilling():
    """A settled drilling lane has the counts of the reference, and its measures to 1e-7."""
    run_for = {"settle": 10.0, "observe": 6.0}
    sweep = {
        "scene": "coupled-drilling",
        "starts": ["drive"],
        "grid": {"zeta": [0.5]},
        "parameters": {"gamma": 0.6},
    }
    lane = vj.run_sweep(sweep | {"run": run_for}, progress=False).squeeze()
    motion = run("coupled-drilling", gamma=0.6, zeta=0.5, **run_for)
    expected = measure(motion)
    assert (expected["cycles"], expected["impacts"]) == (lane.cycles, lane.impacts)
    for name in ("period", "impact_velocity", "rate_of_penetration", "mean_force", "stick_fraction", "drive_power"):
        np.testing.assert_allclose(lane[name], expected[name], rtol=1e-7, atol=1e-9, err_msg=name)
