"""Tests of invariants at every instant on hard lanes: energy, braking friction, pushing contact, rock that yields."""

import numpy as np
import pytest
from cases import ROCK, USUAL, lanes

import vibrojax as vj


@pytest.mark.parametrize(
    "changes", [{}, {"k0": 1e9, "c0": 1e3}, {"delta": -0.02, "start": "drive"}, {"mu": 10.0}, {"c0": 1e5}]
)
def test_invariants_at_every_instant(changes):
    """Friction brakes. In contact J is no less than k0 (x2 - delta) + c0 x2', and it never pulls.

    The ledger of energy holds: F v = F u + c2 x2'^2 + J x2' + change of energy.
    """
    point = USUAL | changes
    motion = vj.simulate("vibro-impact", **point, duration=0.5, sampling=5e-6, progress=False)
    m1, k1 = 250.0, 156250.0
    m2, k2 = point["beta"] * m1, point["beta"] * k1 * point["gamma"] ** 2
    x1, v1, x2, v2, F, J = (motion[n].values for n in ("x1", "v1", "x2", "v2", "friction_force", "impact_force"))
    u = v1 + point["v"]
    assert np.all(F * u >= -1e-9 * np.abs(F).max() * point["v"])
    inside = x2 >= point["delta"]
    raw = point["k0"] * (x2 - point["delta"]) + point["c0"] * v2
    assert inside.any() and np.all(J >= 0) and np.all(raw[inside] <= J[inside] + 1e-6 * J.max())
    energy = (m1 * v1**2 + m2 * v2**2 + k1 * x1**2 + k2 * (x1 - x2) ** 2) / 2
    power = F * point["v"] - F * u - point["c2"] * v2**2 - J * v2
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(motion.time.values))])
    np.testing.assert_allclose(work, energy - energy[0], atol=1e-3 * np.abs(energy).max())


@pytest.mark.parametrize("scene", ["penetration", "coupled-drilling"])
def test_hole_never_fills(scene):
    """x4 is the running maximum of x3 - D/k3 and of 0 (6.3): it never falls and never lags."""
    usual = {"duration": 0.25, "sampling": 2.5e-4} | (
        {} if scene == "penetration" else {"gamma": 0.6, "start": "stuck"}
    )
    deepened = 0
    for name, changes in lanes(ROCK):
        point = {"zeta": 1.1, "threshold": 61.9e3, "k3": 100.68e6} | changes
        motion = vj.simulate(scene, **usual, **point, progress=False)
        x3, x4 = motion.x3.values, motion.x4.values
        grows = np.diff(x4, prepend=0.0)
        noise = 1e-12 * (np.abs(x3).max() + x4[-1])
        assert np.all(grows >= -noise), (name, changes, grows.min())
        assert np.all(x4 - (x3 - point["threshold"] / point["k3"]) >= -noise), (name, changes)
        deepened += x4[-1] > 0
    assert deepened >= 4
