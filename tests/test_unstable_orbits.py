"""Test that a lane near an unstable orbit is assigned to that orbit only if the lane is shown to stay on it."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.io.variables import ORBIT_REASONS

DOUBLED = {"gamma": 1.032361, "v": 1.124847, "c2": 62.5, "delta": 0.001271, "k0": 6815244.917454, "c0": 0.0}


def rotor(t, y, p):
    back = 3.0 * (1.0 - y["c"] * y["c"] - y["s"] * y["s"])
    return {"c": back * y["c"] - 6.0 * y["s"], "s": back * y["s"] + 6.0 * y["c"], "y": p["growth"] * y["y"]}


ROTOR = vj.System("rotor", states=dict.fromkeys("csy", "1"), parameters={"growth": 1.0}, field=rotor, section="s")
"""A rotor (c, s) that returns to its circle, with y' = growth y. Only y = 0 never leaves its plane."""


def orbit_reason(lane):
    return ORBIT_REASONS[int(lane.orbit_reason)]


@pytest.fixture(scope="module")
def doubled_lane():
    """Return a lane near an unstable 4-cycle, at least 15 s before it approaches its stable 8-cycle.

    It runs without and with orbits, and with orbits after 120 s.
    """
    sweep = {"scene": "vibro-impact", "parameters": DOUBLED, "grid": {"beta": [0.189708]}, "starts": ["stuck"]}
    runs = ({"settle": 60.0}, {"settle": 60.0, "orbits": True}, {"settle": 120.0, "orbits": True})
    return [vj.run_sweep(sweep | {"run": run, "unusual": True}, progress=False).squeeze() for run in runs]


def test_unstable_orbit_near_lane_is_another_orbit(doubled_lane):
    own, early, late = doubled_lane
    assert orbit_reason(early) == "another-orbit" and early.stable == -1
    assert np.isnan(early.multiplier_abs).all() and np.isnan(early.orbit_x1) and early.orbit_cycles == 0
    for name in ("period", "impact_velocity", "impact_phase", "stick_fraction"):
        assert early[name] == own[name]
    assert orbit_reason(late) == "found" and late.stable == 1 and late.orbit_cycles == 8


def test_lane_near_unstable_orbit_has_no_error_bound(doubled_lane):
    """The lane is 7e-5 from where it settles."""
    own, early, late = doubled_lane
    assert abs(own.impact_velocity / late.impact_velocity - 1) > 5e-5
    assert np.isinf(early.error_estimate) and np.isinf(early.drift_estimate)


@pytest.mark.parametrize(("y", "growth", "reason"), [(0.0, 1.0, "found"), (0.0, 0.1, "another-orbit")])
def test_orbit_is_found_only_if_lane_would_have_left(y, growth, reason):
    sweep = {"scene": ROTOR, "starts": [[1.0, 0.0, y]], "grid": {"growth": [growth]}, "unusual": True}
    lane = vj.run_sweep(sweep | {"run": {"orbits": True}}, progress=False).squeeze()
    assert lane.cycles == 1 and orbit_reason(lane) == reason
    if reason == "found":
        assert lane.stable == 0 and lane.error_estimate < 1e-4
        np.testing.assert_allclose(lane.multiplier_abs[0], np.exp(growth * lane.period), rtol=1e-9)
    elif y == 0:
        assert np.isinf(lane.error_estimate)
