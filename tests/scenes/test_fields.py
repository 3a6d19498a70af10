"""Test fields, surfaces, modes and landings of the drill's scenes against model.md, section 1, in plain numpy."""

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.scenes import SCENES

Rotary, VibroImpact = SCENES["rotary"], SCENES["vibro-impact"]
LANES = 40
DRILL = {"m1": 230.0, "beta": 0.35, "gamma": 0.8, "k1": 2e5, "c2": 300.0, "g": 9.81, "v": 1.4}
CONTACT = {"k0": 4e7, "c0": 2e4, "delta": -0.004}
K2 = DRILL["beta"] * DRILL["k1"] * DRILL["gamma"] ** 2  # beta m1 (gamma w1)², w1² = k1/m1
LAWS = {  # mu(|u|) of section 3, at its defaults
    "stribeck": lambda u: 0.4 * (1 - u / 3 + u**3 / 81),
    "coulomb": lambda u: 0.4 + 0 * u,
    "popp-exponential": lambda u: 0.165 * (1 + np.exp(-0.02 / u)) * (1 + np.exp(-0.25 * u)),
    "popp-arctan": lambda u: 0.14 * (1 + 1.14 * np.exp(-2 * u)) * np.arctan(100 * u),
    "hyperbolic": lambda u: 0.4 / (1 + u),
    "hyperbolic-quadratic": lambda u: 0.3 / (1 + 99.4 * u) + 0.1 + 0.7 * u**2,
}


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
        mu = LAWS[law](u)
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


def stick_limit(impact=0.0):
    """Return f_st + mu J (5.11, R2)."""
    return 0.4 * (DRILL["m1"] * DRILL["g"] + impact)


def spring_force(x1, x2):
    return -DRILL["k1"] * x1 - K2 * (x1 - x2)


def x1_for_pull(force, x2):
    """Return x1 at which the springs pull with `force` [N]."""
    return (K2 * x2 - force) / (DRILL["k1"] + K2)


@pytest.mark.parametrize("slip", [1, -1, 0])
@pytest.mark.parametrize("touching", [1, 0])
def test_surfaces(slip, touching):
    """The friction surface is |u|, or the force left to the stick limit over sqrt(k1 m1). The contact surface is J/k0
    in contact, and the greater of the gap and -J/k0 in flight.
    """
    scene = VibroImpact()
    state = states(slip, seed=5)
    x1, v1, x2, v2 = state
    over_k0 = x2 - CONTACT["delta"] + CONTACT["c0"] / CONTACT["k0"] * v2
    impact = touching * CONTACT["k0"] * over_k0
    reserve = (stick_limit(impact) - np.abs(spring_force(x1, x2))) / np.sqrt(DRILL["k1"] * DRILL["m1"])
    friction, contact = scene.guard_values(constants(scene), arrays(slip, touching), arrays(*state))
    np.testing.assert_allclose(friction, np.abs(v1 + DRILL["v"]) if slip else reserve, rtol=1e-11, atol=1e-10)
    apart = np.maximum(CONTACT["delta"] - x2, -over_k0)
    np.testing.assert_allclose(contact, over_k0 if touching else apart, rtol=1e-11, atol=1e-15)
    np.testing.assert_array_equal(scene.marker_values(arrays(*state)), [v1, v2])  # the turns
    if not touching:
        rotary = Rotary()
        alone = rotary.guard_values(constants(rotary), arrays(slip), arrays(*state))
        np.testing.assert_allclose(alone, friction[None], rtol=1e-11, atol=1e-10)


def mode_at(scene, *state, **values):
    p = constants(scene, **values)
    return tuple(float(flag) for flag in scene.mode_at(p, tuple(jnp.asarray(float(value)) for value in state)))


@pytest.mark.parametrize(("force", "slip"), [(0, 0), (0.99, 0), (-0.99, 0), (1.01, 1), (-1.01, -1), (5, 1), (-5, -1)])
def test_rotary_mode_at_rest(force, slip):
    """5.11: at u = 0 the bit sticks up to f_st = mu m1 g. Beyond it, the bit moves in the direction of the pull."""
    assert mode_at(Rotary(), x1_for_pull(force * stick_limit(), 0.02), -DRILL["v"], 0.02, 0.3) == (slip,)


@pytest.mark.parametrize("sign", [1, -1])
def test_impact_raises_stick_limit(sign):
    """R2: only while J acts, a pull between f_st and f_st + mu J is held."""
    x2 = CONTACT["delta"] + 1e-4  # J = 4000 N at x2' = 0
    for share, slip in ((0.9, 0), (1.1, sign)):
        state = x1_for_pull(sign * share * stick_limit(4e3), x2), -DRILL["v"], x2, 0.0
        assert mode_at(VibroImpact(), *state) == (slip, 1)
    x2 = CONTACT["delta"] - 1e-4
    assert mode_at(VibroImpact(), x1_for_pull(sign * 0.9 * stick_limit(4e3), x2), -DRILL["v"], x2, 0.0) == (sign, 0)


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


def land(scene, mode, state, *hits):
    p = constants(scene)
    state = tuple(jnp.asarray(float(value)) for value in state)
    by_name = dict(zip(scene.event_names, map(jnp.asarray, hits), strict=True))
    mode, state = scene.after_event(p, tuple(map(jnp.asarray, mode)), state, by_name)
    return tuple(map(float, mode)), tuple(map(float, state))


@pytest.mark.parametrize(("slip", "share", "after"), [(1, 0.5, 0), (1, -2, -1), (-1, -0.5, 0), (-1, 2, 1), (1, 2, 1)])
def test_landing_at_zero_sliding_speed(slip, share, after):
    """u is exactly 0. Then 5.11 decides between stick and slip in the direction of the pull."""
    x1 = x1_for_pull(share * stick_limit(), 0.02)
    for scene, rest in ((Rotary(), ()), (VibroImpact(), (0.0,))):
        hits = (True, *(False for _ in rest), False, False)
        mode, state = land(scene, (float(slip), *rest), (x1, -DRILL["v"] + 1e-12, 0.02, 0.3), *hits)
        assert mode == (after, *rest)
        assert state == (x1, -DRILL["v"], 0.02, 0.3)


def test_landings_on_contact():
    """x2 = delta exactly where an impact begins, J = 0 where it ends. Renewed contact leaves x2 unchanged."""
    delta, relaxation = CONTACT["delta"], CONTACT["c0"] / CONTACT["k0"]
    contact = (False, True, False, False)
    begins = land(VibroImpact(), (1.0, 0.0), (0.01, 0.2, delta + 1e-16, 0.7), *contact)
    assert begins == ((1, 1), (0.01, 0.2, delta, 0.7))
    mode, state = land(VibroImpact(), (1.0, 1.0), (0.01, 0.2, delta + 0.7 * relaxation + 1e-12, -0.7), *contact)
    assert mode == (1, 0)
    np.testing.assert_allclose(state, (0.01, 0.2, delta + 0.7 * relaxation, -0.7), rtol=1e-15)
    caught = 0.01, 0.2, delta + 0.5 * relaxation, -0.5
    assert land(VibroImpact(), (1.0, 0.0), caught, *contact) == ((1, 1), caught)
