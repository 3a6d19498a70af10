"""Fields, surfaces, modes and landings of the drill's scenes against model.md, section 1, in plain numpy."""

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.scenes import SCENES
from vibrojax.scenes.rotary import Rotary
from vibrojax.scenes.vibro_impact import VibroImpact

LANES = 40
DRILL = {"m1": 230.0, "beta": 0.35, "gamma": 0.8, "k1": 2e5, "c2": 300.0, "g": 9.81, "v": 1.4}
CONTACT = {"k0": 4e7, "c0": 2e4, "delta": -0.004}
LAWS = {  # mu(|u|) of section 3, at its defaults
    "stribeck": lambda u: 0.4 * (1 - u / 3 + u**3 / 81),
    "coulomb": lambda u: 0.4 + 0 * u,
    "popp-exponential": lambda u: 0.165 * (1 + np.exp(-0.02 / u)) * (1 + np.exp(-0.25 * u)),
    "popp-arctan": lambda u: 0.14 * (1 + 1.14 * np.exp(-2 * u)) * np.arctan(100 * u),
    "hyperbolic": lambda u: 0.4 / (1 + u),
    "hyperbolic-quadratic": lambda u: 0.3 / (1 + 99.4 * u) + 0.1 + 0.7 * u**2,
}


def constants(scene, **values):
    """The scene's constants, as arrays, with defaults where nothing else is said."""
    p = {name: one.default for name, one in scene.parameters().items()}
    given = {name: value for name, value in (DRILL | CONTACT | values).items() if name in p}
    return scene.constants({name: jnp.asarray(value) for name, value in (p | given).items()})


def states(sign=0, seed=1):
    """Random states; `sign` of the sliding speed, 0 for u = 0 exactly."""
    random = np.random.default_rng(seed)
    x1, x2 = random.uniform(-0.05, 0.05, (2, LANES))
    speed = random.uniform(0.05, 3.0, LANES)
    return x1, sign * speed - DRILL["v"], x2, random.uniform(-3, 3, LANES)


def reference(law, slip, touching, state, has_contact=True):
    """x1', x1'', x2', x2'' of section 1."""
    x1, v1, x2, v2 = state
    m1, k1, c2 = DRILL["m1"], DRILL["k1"], DRILL["c2"]
    m2 = DRILL["beta"] * m1
    k2 = DRILL["beta"] * m1 * DRILL["gamma"] ** 2 * k1 / m1  # beta m1 (gamma w1)²
    impact = CONTACT["k0"] * (x2 - CONTACT["delta"]) + CONTACT["c0"] * v2  # 5.18
    impact = impact if touching and has_contact else 0.0
    u = np.abs(v1 + DRILL["v"])
    if slip == 0:
        bit = np.zeros_like(x1)  # 5.11: friction and impact balance the springs
    else:
        mu = LAWS[law](u)
        on_impact = 0.4 if law == "stribeck" else mu
        bit = (-k1 * x1 - k2 * (x1 - x2) - slip * (mu * m1 * DRILL["g"] + on_impact * impact)) / m1  # 5.9, 5.12, R2
    return v1, bit, v2, (-c2 * v2 - k2 * (x2 - x1) - impact) / m2


def arrays(*values):
    return tuple(jnp.broadcast_to(jnp.asarray(value, float), (LANES,)) for value in values)


def test_scenes_are_found_by_name():
    assert SCENES["rotary"] is Rotary and SCENES["vibro-impact"] is VibroImpact


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("slip", [1, -1, 0])
def test_rotary_field(law, slip):
    scene = Rotary(friction=FRICTION_LAWS[law])
    state = states(slip)
    found = scene.field(constants(scene), arrays(slip), arrays(*state))
    for one, expected in zip(found, reference(law, slip, 0, state, has_contact=False), strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("slip", [1, -1, 0])
@pytest.mark.parametrize("touching", [1, 0])
def test_vibro_impact_field(law, slip, touching):
    scene = VibroImpact(friction=FRICTION_LAWS[law])
    state = states(slip, seed=2)
    found = scene.field(constants(scene), arrays(slip, touching), arrays(*state))
    for one, expected in zip(found, reference(law, slip, touching, state), strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("slip", [1, -1])
@pytest.mark.parametrize("touching", [1, 0])
def test_smoothed_field_tends_to_the_sliding_one(slip, touching):
    """sgn u is spread as u/sqrt(u² + w²): at |u| >= 0.05 and w = 1e-6 it differs by w²/(2 u²) < 1e-9."""
    scene = VibroImpact()
    state, mode = states(slip, seed=3), arrays(slip, touching)
    found = scene.smoothed_field(constants(scene), mode, arrays(*state), 1e-6)
    for one, expected in zip(found, reference("stribeck", slip, touching, state), strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_friction_is_against_sliding_and_grows_under_impact(law):
    """R2: F = (force on the bit from the springs) - m1 x1'' has the sign of u, and J > 0 only adds to it."""
    scene = VibroImpact(friction=FRICTION_LAWS[law])
    p = constants(scene)
    k2 = DRILL["beta"] * DRILL["gamma"] ** 2 * DRILL["k1"]
    for sign in (1, -1):
        x1, v1, _, v2 = states(sign, seed=4)
        x2 = CONTACT["delta"] + 1e-3 + 0 * x1  # J = 4e4 + c0 v2 > 0
        v2 = np.abs(v2)
        forces = []
        for touching in (0, 1):
            bit = scene.field(p, arrays(sign, touching), arrays(x1, v1, x2, v2))[1]
            forces.append(-DRILL["k1"] * x1 - k2 * (x1 - x2) - DRILL["m1"] * np.asarray(bit))
        assert np.all(forces[0] * (v1 + DRILL["v"]) > 0)
        assert np.all(sign * (forces[1] - forces[0]) > 0)


@pytest.mark.parametrize("scene", [Rotary(), VibroImpact()], ids=lambda scene: scene.name)
def test_stick_holds_the_bit_on_the_rock(scene):
    """R1: friction is against the pull, so that u stays at 0 whatever pulls, and the bit goes back with the drive."""
    state = states(0)
    mode = arrays(0, 0)[: len(scene.modes)]
    found = scene.field(constants(scene), mode, arrays(*state))
    np.testing.assert_array_equal(found[0], -DRILL["v"])
    np.testing.assert_array_equal(found[1], 0.0)


def limit(impact=0.0):
    """f_st + mu J (5.11, R2)."""
    return 0.4 * (DRILL["m1"] * DRILL["g"] + impact)


def springs(x1, x2):
    k2 = DRILL["beta"] * DRILL["gamma"] ** 2 * DRILL["k1"]
    return -DRILL["k1"] * x1 - k2 * (x1 - x2)


def pulled(force, x2):
    """x1 at which the springs pull with `force` [N]."""
    k2 = DRILL["beta"] * DRILL["gamma"] ** 2 * DRILL["k1"]
    return (k2 * x2 - force) / (DRILL["k1"] + k2)


@pytest.mark.parametrize("slip", [1, -1, 0])
@pytest.mark.parametrize("touching", [1, 0])
def test_surfaces(slip, touching):
    """|u|, or the force in hand over sqrt(k1 m1); J/k0, or min of gap and -J/k0, whichever ends the flight later."""
    scene = VibroImpact()
    state = states(slip, seed=5)
    x1, v1, x2, v2 = state
    over_k0 = x2 - CONTACT["delta"] + CONTACT["c0"] / CONTACT["k0"] * v2
    impact = touching * CONTACT["k0"] * over_k0
    in_hand = (limit(impact) - np.abs(springs(x1, x2))) / np.sqrt(DRILL["k1"] * DRILL["m1"])
    friction, contact = scene.surfaces(constants(scene), arrays(slip, touching), arrays(*state))
    np.testing.assert_allclose(friction, np.abs(v1 + DRILL["v"]) if slip else in_hand, rtol=1e-11, atol=1e-10)
    apart = np.maximum(CONTACT["delta"] - x2, -over_k0)
    np.testing.assert_allclose(contact, over_k0 if touching else apart, rtol=1e-11, atol=1e-15)
    if not touching:
        rotary = Rotary()
        alone = rotary.surfaces(constants(rotary), arrays(slip), arrays(*state))
        np.testing.assert_allclose(alone, friction[None], rtol=1e-11, atol=1e-10)


def test_surfaces_are_exactly_zero_on_the_surface():
    scene = VibroImpact()
    p = constants(scene)
    _, delta = (0, p["delta"])
    at_rest = jnp.asarray(0.01), -p["v"], delta, jnp.asarray(0.7)
    for slip in (1.0, -1.0):  # u = 0
        assert scene.surfaces(p, (jnp.asarray(slip), jnp.asarray(0.0)), at_rest)[0] == 0
    # Apart and rising through delta: x2 = delta, J = c0 x2' > 0.
    assert scene.surfaces(p, (jnp.asarray(1.0), jnp.asarray(0.0)), at_rest)[1] == 0
    # Let go at J = 0: x2 - delta = -c0/k0 x2'.
    leaving = jnp.asarray(0.01), -p["v"], delta + 0.7 * p["c0"] / p["k0"], jnp.asarray(-0.7)
    for touching in (1.0, 0.0):
        surface = scene.surfaces(p, (jnp.asarray(1.0), jnp.asarray(touching)), leaving)[1]
        assert abs(surface) < 2 * np.spacing(abs(CONTACT["delta"]))
    # Let go above delta and falling: apart until J > 0 again.
    let_go = (*leaving[:3], jnp.asarray(-0.9))
    assert scene.surfaces(p, (jnp.asarray(1.0), jnp.asarray(0.0)), let_go)[1] > 0


def test_markers_are_the_turns():
    x1, v1, x2, v2 = states(1)
    for scene in (Rotary(), VibroImpact()):
        np.testing.assert_array_equal(scene.markers(constants(scene), arrays(x1, v1, x2, v2)), [v1, v2])
