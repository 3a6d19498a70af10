"""Derivatives at periodic orbits, against central differences of orbits that Newton's method has converged."""

import numpy as np
import pytest

from vibrojax.models.scenes import SCENES
from vibrojax.periodic.orbit_derivatives import orbit_features, orbit_variables
from vibrojax.periodic.return_map import Segments

DRILL = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
ORBITS = {
    "impact": ("vibro-impact", ("beta", "gamma", "v", "delta"), DRILL),
    "hole": ("drilling", ("beta", "threshold"), {"beta": 0.4, "gamma": 0.6, "zeta": 0.5, "threshold": 1e5}),
}


def settled(scene, values, returns=200):
    """The parameters of one lane, and the state to which the return map converges."""
    p = {name: np.array([about.default]) for name, about in scene.parameters().items()}
    p |= {name: np.array([x]) for name, x in values.items()}
    driving = scene.driving_part()
    own = {name: p[name] for name in driving.parameters()}
    go, state = Segments(driving), np.array([[-0.05], [-0.05], [0.0]])
    for _ in range(returns):
        state = np.asarray(go(own, state).state)
    return p, state.T[None]


@pytest.mark.parametrize("case", ORBITS)
def test_derivatives_are_the_slopes_of_converged_orbits(case):
    name, by, values = ORBITS[case]
    scene = SCENES[name]()
    p, guess = settled(scene, values)
    of = orbit_variables(scene)
    orbit = orbit_features(scene, of, by, p, guess)
    assert orbit.residual[0] < 1e-12 and set(orbit.reason.ravel()) == {0}
    for place, varied in enumerate(by):
        step = 1e-6 * abs(values.get(varied, 1.5))
        up, down = (orbit_features(scene, of, (), p | {varied: p[varied] + h}, orbit.states) for h in (step, -step))
        slope = (up.values - down.values)[0] / (2 * step)
        scale = np.abs(orbit.derivatives[0, :, place]) + 0.1 * np.abs(orbit.values[0]) / p[varied][0]
        off = np.abs(slope - orbit.derivatives[0, :, place]) / np.where(scale > 0, scale, 1.0)
        assert dict(zip(of, off, strict=True)) == pytest.approx(dict.fromkeys(of, 0.0), abs=1e-6)
