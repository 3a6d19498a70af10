"""Test fields, contact and starts of the drill's scenes against model.md, section 1, in plain numpy."""

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.scenes import SCENES

Rotary, VibroImpact = SCENES["rotary"], SCENES["vibro-impact"]
DRILL = {"m1": 230.0, "beta": 0.35, "gamma": 0.8, "k1": 2e5, "c2": 300.0, "g": 9.81, "v": 1.4}
CONTACT = {"k0": 4e7, "c0": 2e4, "delta": -0.004}


def constants(scene, **values):
    """Return the scene's constants as arrays, with defaults for missing values."""
    p = {name: parameter.default for name, parameter in scene.parameters().items()}
    given = {name: value for name, value in (DRILL | CONTACT | values).items() if name in p}
    return scene.constants({name: jnp.asarray(value) for name, value in (p | given).items()})


def mode_at(scene, *state, **values):
    p = constants(scene, **values)
    return tuple(float(flag) for flag in scene.mode_at(p, tuple(jnp.asarray(float(value)) for value in state)))


@pytest.mark.parametrize(
    ("over", "v2", "x1", "touching"),
    [
        (-1e-3, 2.0, 0.0, 0),  # apart
        (1e-3, 0.0, 0.0, 1),
        (1e-3, -1.9, 0.0, 1),  # J = 40000 - 38000 N
        (1e-3, -2.1, 0.0, 0),  # J < 0: released above delta
        (0.0, 0.5, 0.0, 1),  # the gap closes
        (0.0, -0.5, 0.0, 0),  # the gap opens
        (0.0, 0.0, 0.01, 1),  # at rest on the bit, pressed on by k2 (x1 - x2) > 0
        (0.0, 0.0, -0.01, 0),  # at rest, pulled off
    ],
)
def test_contact_mode(over, v2, x1, touching):
    """5.18: J acts where x2 >= delta and J is positive."""
    assert mode_at(VibroImpact(), x1, 0.0, CONTACT["delta"] + over, v2) == (1, touching)


def test_starts():
    """R5: `drive` is zero, `stuck` has u = 0. R13: if delta < 0, both are in contact, and `touching` at its edge."""
    scene = VibroImpact()
    for delta, touching in ((-0.005, 1), (0.005, 0)):
        p = constants(scene, delta=delta)
        for name, state, mode in (
            ("drive", (0, 0, 0, 0), (1, touching)),
            ("stuck", (0, -DRILL["v"], 0, 0), (0, touching)),
            ("touching", (0, 0, min(0, delta), 0), (1, touching)),
        ):
            start = scene.start(p, name, ())
            np.testing.assert_array_equal(start, state)
            np.testing.assert_array_equal(scene.mode_at(p, start), mode)
    vector = (0.01, 3.5, 0.0, -1.0)
    np.testing.assert_array_equal(scene.start(p, vector, (2,)), np.transpose([vector, vector]))
    p = constants(scene, delta=-0.005)
    np.testing.assert_allclose(
        scene.contact_force(p, (1.0, 1.0), scene.start(p, "drive", ())), 4e7 * 0.005
    )  # k0 |delta|
