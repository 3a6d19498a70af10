"""Test that a lane near an unstable orbit is assigned to that orbit only if the lane is shown to stay on it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.io.variables import ORBIT_REASONS
from vibrojax.physics.parameters import positive, table

DOUBLED = {"gamma": 1.032361, "v": 1.124847, "c2": 62.5, "delta": 0.001271, "k0": 6815244.917454, "c0": 0.0}


class Constants(NamedTuple):
    frequency: Any
    growth: Any


@dataclass(frozen=True)
class Rotor(vj.Scene[Constants]):
    """A rotor (c, s) = (cos, sin) that returns to its circle, with y' = growth y. Only y = 0 never leaves its plane."""

    name = "rotor"
    states = (
        vj.State("c", "1", "cosine of the phase"),
        vj.State("s", "1", "sine of the phase", is_velocity=True),
        vj.State("y", "1", "distance from the plane"),
    )
    modes = (vj.Mode("on", "always 1", 1.0),)
    markers = (vj.Marker("phase", "s"),)
    section = vj.Section((vj.Swing("c", "s", "bit_amplitude"),), rearm=lambda c: -0.5 + 0 * c.growth)
    start_states = ("c", "s", "y")
    measures = ("swings",)

    def parameters(self):
        return table(
            positive("frequency", 6.0, "rad s-1", "frequency", "w"), positive("growth", 1.0, "s-1", "growth rate", "a")
        )

    def constants(self, p):
        return Constants(p["frequency"], p["growth"])

    def start(self, c, name, shape):
        return tuple(jnp.full(shape, x, c.growth.dtype) for x in ((1.0, 0.0, 0.0) if name is None else name))

    def mode_at(self, c, state):
        return (jnp.ones_like(state[0]),)

    def field(self, c, mode, state):
        rotor, s, y = state
        back = 3.0 * (1.0 - rotor * rotor - s * s)
        return (back * rotor - c.frequency * s, back * s + c.frequency * rotor, c.growth * y)

    def guards(self):
        return ()

    def reset(self, c, mode, state, hits):
        return mode, state

    def rate(self, c, mode):
        return c.frequency + 7.0

    def speed_scale(self, c):
        return 1.0 + 0 * c.growth


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


@pytest.mark.parametrize(
    ("y", "growth", "reason"),
    [
        (0.0, 1.0, "found"),  # a rounding error would have grown by exp(40)
        (0.0, 0.1, "another-orbit"),  # by exp(4) only, so the lane may still be leaving
        (1e-25, 1.0, "another-orbit"),  # the lane has left
    ],
)
def test_orbit_is_found_only_if_lane_would_have_left(y, growth, reason):
    sweep = {"scene": Rotor(), "starts": [[1.0, 0.0, y]], "grid": {"growth": [growth]}, "unusual": True}
    lane = vj.run_sweep(sweep | {"run": {"orbits": True}}, progress=False).squeeze()
    assert lane.cycles == 1 and orbit_reason(lane) == reason
    if reason == "found":
        assert lane.stable == 0 and lane.error_estimate < 1e-4
        np.testing.assert_allclose(lane.multiplier_abs[0], np.exp(growth * lane.period), rtol=1e-9)
    elif y == 0:
        assert np.isinf(lane.error_estimate)
