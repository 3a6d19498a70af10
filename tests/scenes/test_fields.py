"""Test fields, contact and starts of the drill's scenes against model.md, section 1, in plain numpy."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from exact.friction import LAWS

from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.scenes import SCENES

Rotary, VibroImpact = SCENES["rotary"], SCENES["vibro-impact"]
LANES = 40
DRILL = {"m1": 230.0, "beta": 0.35, "gamma": 0.8, "k1": 2e5, "c2": 300.0, "g": 9.81, "v": 1.4}
CONTACT = {"k0": 4e7, "c0": 2e4, "delta": -0.004}
K2 = DRILL["beta"] * DRILL["k1"] * DRILL["gamma"] ** 2  # beta m1 (gamma w1)², w1² = k1/m1


def constants(scene, **values):
    """Return the scene's constants as arrays, with defaults for missing values."""
    p = {name: parameter.default for name, parameter in scene.parameters().items()}
    given = {name: value for name, value in (DRILL | CONTACT | values).items() if name in p}
    return scene.constants({name: jnp.asarray(value) for name, value in (p | given).items()})


def states(sign=0, seed=1):
    """Return random states with the given `sign` of the sliding speed, 0 for u = 0 exactly."""
    random = np.random.default_rng(seed)
    x1, x2 = random.uniform(-0.05, 0.05, (2, LANES))
    speed = random.uniform(0.05, 3.0, LANES)
    return x1, sign * speed - DRILL["v"], x2, random.uniform(-3, 3, LANES)


def reference(law, slip, touching, state):
    """Return x1', x1'', x2', x2'' of section 1."""
    x1, v1, x2, v2 = state
    m1, k1, c2 = DRILL["m1"], DRILL["k1"], DRILL["c2"]
    m2 = DRILL["beta"] * m1
    impact = CONTACT["k0"] * (x2 - CONTACT["delta"]) + CONTACT["c0"] * v2  # 5.18
    impact = impact if touching else 0.0
    u = np.abs(v1 + DRILL["v"])
    if slip == 0:
        bit = np.zeros_like(x1)  # 5.11: friction and impact balance the springs
    else:
        mu = LAWS[law](u, SimpleNamespace(**{n: q.default for n, q in FRICTION_LAWS[law].parameters.items()}))
        on_impact = 0.4 if law == "stribeck" else mu
        bit = (-k1 * x1 - K2 * (x1 - x2) - slip * (mu * m1 * DRILL["g"] + on_impact * impact)) / m1  # 5.9, 5.12, R2
    return v1, bit, v2, (-c2 * v2 - K2 * (x2 - x1) - impact) / m2


def arrays(*values):
    return tuple(jnp.broadcast_to(jnp.asarray(value, float), (LANES,)) for value in values)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("slip", [1, -1, 0])
@pytest.mark.parametrize(("kind", "touching"), [(Rotary, ()), (VibroImpact, (1,)), (VibroImpact, (0,))])
def test_field(law, slip, kind, touching):
    scene = kind(friction=FRICTION_LAWS[law])
    state = states(slip, seed=2)
    field = scene.field(constants(scene), arrays(slip, *touching), arrays(*state))
    for component, expected in zip(field, reference(law, slip, any(touching), state), strict=True):
        np.testing.assert_allclose(component, expected, rtol=1e-12, atol=1e-10 if touching else 1e-12)


@pytest.mark.parametrize("slip", [1, -1])
@pytest.mark.parametrize("touching", [1, 0])
def test_smoothed_field_converges_to_sliding_field(slip, touching):
    """u/sqrt(u² + w²) replaces sgn u. At |u| >= 0.05 and w = 1e-6 they differ by w²/(2 u²) < 1e-9."""
    scene = VibroImpact()
    state, mode = states(slip, seed=3), arrays(slip, touching)
    field = scene.smoothed_field(constants(scene), mode, arrays(*state), 1e-6)
    for component, expected in zip(field, reference("stribeck", slip, touching, state), strict=True):
        np.testing.assert_allclose(component, expected, rtol=1e-7, atol=1e-6)


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
