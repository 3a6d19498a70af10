"""Tests of periodic orbits: against reference cases, the exact integrator and closed forms, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from exact import orbits as exact
from exact.orbits import in_upper_half

import vibrojax as vj

CASES = json.loads((Path(__file__).parent / "data" / "orbit_cases.json").read_text())["orbits"]
ORBITS = {"orbits": True}
FOUND, NOT_REPEATING, REFUSED = 0, 1, 5
MEASURED = {"impact_velocity": 1e-8, "stick_fraction": 1e-7, "reverse_fraction": 1e-8}
SMALL = {"scene": "vibro-impact", "grid": {"beta": [0.3, 0.4, 0.5], "gamma": [0.7, 0.75]}}
SOON = {"settle": 2.0, "observe": 0.5}


def multipliers(point):
    return point.multiplier_abs.values * np.exp(1j * point.multiplier_arg.values)


@pytest.fixture(scope="module")
def cases():
    # With several attractors, a lane at the default error may end on another one than the exact motion.
    points = {name: [case["point"][name] for case in CASES] for name in CASES[0]["point"]}
    return vj.run_sweep({"scene": "vibro-impact", "points": points, "run": ORBITS | {"error": 1e-6}}, progress=False)


@pytest.mark.parametrize("index", range(len(CASES)))
def test_reference_cases(cases, index):
    point, expected = cases.isel(point=index), CASES[index]["expected"]
    assert point.orbit_reason == FOUND and point.stable == 1
    assert point.orbit_residual < 1e-10
    assert point.cycles == point.orbit_cycles == CASES[index]["cycles"]
    assert abs(point.period.item() - expected["period"]) < 1e-9
    values = in_upper_half([complex(*x) for x in expected["multipliers"]])
    np.testing.assert_allclose(multipliers(point), values, atol=1e-6)
    assert point.impacts == expected["impacts"]
    for name, tolerance in MEASURED.items():
        assert abs(point[name].item() - expected[name]) < tolerance, name
    section = [point[f"orbit_{name}"].item() for name in ("x1", "x2", "v2")]
    # The section is a fixed point of the exact map. One of its returns is the reference's, which is good to some 4e-9.
    parameters = {name: x for name, x in CASES[index]["point"].items() if name != "start"}
    _, states = exact.returns("vibro-impact", parameters, section, (point.cycles.item() + 0.1) * expected["period"])
    np.testing.assert_allclose(states[-1], section, rtol=0, atol=1e-11)
    assert np.abs(states - expected["section"]).max(axis=1).min() < 1e-8


def test_sticking_makes_a_multiplier_zero(cases):
    sticks = cases.stick_fraction.values > 0
    assert sticks.any() and not sticks.all()
    assert (cases.multiplier_abs.values[sticks, -1] < 1e-12).all()
    assert (cases.multiplier_abs.values[~sticks, -1] > 1e-3).all()


# Other scenes
def test_multipliers_of_rock():
    points, soft = {"beta": [0.3, 0.4], "gamma": [0.7, 0.75]}, {"threshold": [2e4, 2e4]}
    drill, one_way, coupled = (
        vj.run_sweep({"scene": scene, "points": points | rock, "starts": ["stuck"], "run": ORBITS}, progress=False)
        for scene, rock in (("vibro-impact", {}), ("drilling", soft), ("coupled-drilling", soft))
    )
    for ds in (one_way, coupled):
        assert (ds.orbit_reason == FOUND).all() and (ds.stable == 1).all()
        assert (ds.rate_of_penetration > 0).all()
    # One-way rock does not act back: the orbits are those of the drill without it.
    np.testing.assert_allclose(one_way.multiplier_abs, drill.multiplier_abs, atol=1e-9)
    np.testing.assert_allclose(one_way.period, drill.period, rtol=1e-12)
    # Coupled rock acts back, yields, and comes to rest before the next impact.
    assert coupled.sizes["multiplier"] == 5
    assert (coupled.multiplier_abs.values[..., 3:] < 1e-9).all()
    assert (np.abs(coupled.multiplier_abs.values[..., :3] - drill.multiplier_abs.values) > 1e-3).any()


@pytest.mark.long
def test_coupled_rock_matches_exact_motion():
    """Compare the multipliers of five states with central differences. The rock is damped so lightly that it still
    moves at the next impact. It yields in the second lane, which makes a multiplier zero."""
    points = {"beta": [0.4626, 0.58], "gamma": [0.67, 0.6341], "v": [1.349, 1.351]}
    points |= {"zeta": [0.02357, 0.03134], "threshold": [13.81e3, 26.87e3], "k3": [9.912e6, 26.69e6]}
    sweep = {"scene": "coupled-drilling", "points": points, "starts": ["stuck"], "unusual": True}
    ds = vj.run_sweep(sweep | {"run": ORBITS | {"settle": 100.0}}, progress=False).squeeze("start")
    assert (ds.orbit_reason == FOUND).all() and (ds.cycles == 1).all()
    for index in range(2):
        lane, parameters = ds.isel(point=index), {name: column[index] for name, column in points.items()}
        section = np.array([lane[f"orbit_{name}"].item() for name in ("x1", "x2", "v2", "compression", "v3")])
        span = lane.period.item()
        _, states = exact.returns(lane.scene, parameters, section, 1.01 * span)
        np.testing.assert_allclose(states[0], section, atol=1e-10)
        values = in_upper_half(exact.multipliers(lane.scene, parameters, section, span))
        np.testing.assert_allclose(multipliers(lane), values, atol=1e-6)
        assert (lane.rate_of_penetration > 0) == (index > 0)
        assert (lane.multiplier_abs[-1] < 1e-12) == (index > 0)


# Replaced features, and refused orbits
def test_irregular_and_failed_lanes_have_no_orbit():
    tables = {"scene": "vibro-impact", "grid": {"beta": [0.95], "gamma": [0.35, 0.7]}, "run": ORBITS | SOON}
    irregular = vj.run_sweep(tables, progress=False)
    assert (irregular.orbit_reason == NOT_REPEATING).all() and (irregular.stable == -1).all()
    stiff = SMALL | {"parameters": {"k0": 1e30}, "run": ORBITS | SOON, "unusual": True}
    refused = vj.run_sweep(stiff, progress=False)
    assert (refused.status != 0).all() and (refused.orbit_reason == REFUSED).all() and (refused.stable == -1).all()


# Commands and files
def test_other_features_do_not_change():
    """Orbits change only the features that they replace, and add their own variables."""
    columns = {name: [case["point"][name] for case in (CASES[0], CASES[4], CASES[8])] for name in CASES[0]["point"]}
    without, with_orbits = (
        vj.run_sweep({"scene": "vibro-impact", "points": columns, "run": {"orbits": orbits}}, progress=False)
        for orbits in (False, True)
    )
    same = ("regime", "cycles", "impacts", "returns", "settling_time", "error_estimate", "drift_estimate", "status")
    for name in same:
        np.testing.assert_array_equal(without[name], with_orbits[name], name)
    for name in ("period", "impact_velocity", "bit_amplitude", "drive_power"):
        np.testing.assert_allclose(without[name], with_orbits[name], rtol=1e-4)
    assert not {"stable", "orbit_reason"} & set(without.data_vars)
