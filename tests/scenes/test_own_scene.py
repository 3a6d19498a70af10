"""Test a scene written outside the package, with a third degree of freedom: the drill string between drive and bit."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import pytest

import vibrojax as vj
from vibrojax.physics.parameters import positive, table
from vibrojax.scenes import Marker, Section, State, Swing
from vibrojax.scenes.vibro_impact import VibroImpact

STRING = table(
    positive("m0", 500.0, "kg", "mass of the string", "m₀"),
    positive("k4", 4e6, "N m-1", "stiffness of the string above", "k₄"),
    positive("c4", 2e4, "N s m-1", "damping of the string", "c₄"),
)


class Constants(NamedTuple):
    drill: Any
    contact: Any
    m0: Any
    k4: Any
    c4: Any


@dataclass(frozen=True)
class DrillWithString(VibroImpact):
    """A drill whose bit hangs on k1 from a mass m0, on k4 below the drive. x0, x1, x2 are relative to the drive."""

    name = "with-string"
    states = (
        *VibroImpact.states,
        State("x0", "m", "string"),
        State("v0", "m s-1", "velocity of the string", is_velocity=True),
    )
    markers = (*VibroImpact.markers, Marker("string_turn", "v0"))
    section = Section(
        (*VibroImpact.section.swings, Swing("x0", "v0", "string_amplitude")), rearm=lambda c: -0.05 * c.drill.slip.v
    )
    starts = ("stuck",)

    def parameters(self):
        return super().parameters() | STRING

    def constants(self, p):
        return Constants(*super().constants(p), *(p[name] for name in STRING))

    def pull(self, c, state):
        return super().pull(c, state) + c.drill.k1 * state[4]

    def pull_rate(self, c, state):
        return super().pull_rate(c, state) + c.drill.k1 * state[5]

    def other_rates(self, c, mode, state, impact):
        x0, v0 = state[4:]
        return (v0, (c.drill.k1 * (state[0] - x0) - c.k4 * x0 - c.c4 * v0) / c.m0)

    def flight_rate(self, c):
        return super().flight_rate(c) + jnp.sqrt((c.drill.k1 + c.k4) / c.m0) + c.c4 / c.m0


@pytest.mark.long
def test_stiff_string_has_no_effect():
    """The string is so stiff that its mass moves with the drive; the motion is that of the vibro-impact scene.

    k1 and k4 in series are softer than k1 by 1.6e-3.
    """
    stiff = {"k4": [1e8], "m0": [100.0], "delta": [0.005]}
    run = {"settle": 20.0, "observe": 4.0}
    own, plain = (
        vj.run_sweep({"scene": scene, "points": points, "starts": ["stuck"], "run": run}, progress=False).squeeze()
        for scene, points in ((DrillWithString(), stiff), (VibroImpact(), {"delta": [0.005]}))
    )
    assert (own.cycles, own.impacts) == (plain.cycles, plain.impacts)
    for name in ("period", "bit_amplitude", "striker_amplitude"):
        assert float(own[name]) == pytest.approx(float(plain[name]), rel=1e-2), name
    assert 0 < own.string_amplitude < 4e-3 * own.bit_amplitude
