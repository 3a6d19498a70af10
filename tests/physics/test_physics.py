"""Test laws of friction, contact, modes, fields and starts against closed forms and the model, in plain numpy."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exact.friction import LAWS
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import hyp2f1

import vibrojax as vj
from vibrojax.physics.contact import contact_time, force, restitution
from vibrojax.physics.modes import linearised

SPEEDS = np.array([1e-6, 1e-3, 0.02, 0.3, 1.5, 3.0, 4.2])

# Two sets for each law: the defaults of section 3, and distinct numbers that cannot be confused with each other.
PARAMETERS = {
    "coulomb": ({"mu": 0.4}, {"mu": 0.23}),
    "popp-exponential": ({"popp_c1": -0.02, "popp_c2": -0.25}, {"popp_c1": -0.3, "popp_c2": -0.7}),
    "popp-arctan": ({"a1": 0.14, "a2": 1.14, "b1": 2.0, "b2": 100.0}, {"a1": 0.2, "a2": 0.6, "b1": 0.9, "b2": 7.0}),
    "hyperbolic": ({"mu0": 0.4, "delta_f": 1.0}, {"mu0": 0.31, "delta_f": 2.3}),
    "stribeck": ({"mu": 0.4, "v_cr": 3.0}, {"mu": 0.27, "v_cr": 1.9}),
}
SQUARE = {"mu0": 0.4, "mu1": 0.1, "lambda": 99.4, "alpha": 0.7}
PARAMETERS |= {"hyperbolic-quadratic": (SQUARE, {"mu0": 0.5, "mu1": 0.2, "lambda": 3.0, "alpha": 0.05})}
CASES = [pytest.param(name, p, id=f"{name}-{i}") for name, both in PARAMETERS.items() for i, p in enumerate(both)]

# mu(0+) and its one-sided slope there.
AT_REST = {
    "coulomb": lambda p: (p["mu"], 0.0),
    "popp-exponential": lambda p: (0.33, 0.165 * p["popp_c2"]),  # exp(c1/|u|) and its derivatives -> 0
    "popp-arctan": lambda p: (0.0, p["a1"] * (1 + p["a2"]) * p["b2"]),
    "hyperbolic": lambda p: (p["mu0"], -p["mu0"] * p["delta_f"]),
    "hyperbolic-quadratic": lambda p: (p["mu0"], -(p["mu0"] - p["mu1"]) * p["lambda"]),
    "stribeck": lambda p: (p["mu"], -p["mu"] / p["v_cr"]),
}


def mu(name, u, p):
    """Return the coefficient of the exact reference."""
    return LAWS[name](u, SimpleNamespace(**p))


def test_laws_and_defaults_of_the_source():
    equations = {f"eq. {number}" for number in (2.13, 2.14, 2.15, 2.16, 2.17, 5.9)}
    assert {law.reference for law in vj.FRICTION_LAWS.values()} == equations
    defaults = {name: {key: q.default for key, q in law.parameters.items()} for name, law in vj.FRICTION_LAWS.items()}
    assert defaults == {name: both[0] for name, both in PARAMETERS.items()}


@pytest.mark.parametrize(("name", "p"), CASES)
def test_only_eq_5_9_has_constant_friction_under_impact(name, p):
    """Section 3: F = sgn(u) mu(u) (m1 g + J), but 5.9 uses the constant mu of eq. 5.12 for J."""
    expected = p["mu"] + 0 * SPEEDS if name == "stribeck" else mu(name, SPEEDS, p)
    values = [vj.FRICTION_LAWS[name].on_impact(jnp.asarray(u), p) for u in SPEEDS]
    np.testing.assert_allclose(values, expected, rtol=1e-14)


@pytest.mark.parametrize(("name", "p"), CASES)
@pytest.mark.parametrize("rest", [0.0, 1e-300])
def test_limit_at_rest(name, p, rest):
    """mu(0+) and d mu/d|u| at 0+ are finite for every law."""
    value, slope = jax.value_and_grad(lambda u: jnp.asarray(vj.FRICTION_LAWS[name].on_weight(u, p)))(rest)
    np.testing.assert_allclose([value, slope], AT_REST[name](p), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(("name", "p"), CASES)
def test_values_and_slopes(name, p):
    """Compare slopes with derivatives of the reference by imaginary steps, which are exact to rounding."""
    law, h = vj.FRICTION_LAWS[name], 1e-30j
    both = jax.value_and_grad(lambda u, p: jnp.asarray(law.on_weight(u, p)), argnums=(0, 1))
    for u in map(float, SPEEDS):
        value, (along_speed, along_p) = both(u, p)
        assert value == pytest.approx(float(mu(name, u, p)), rel=1e-14)
        expected = {key: mu(name, u, p | {key: x + h}).imag / h.imag for key, x in p.items()}
        np.testing.assert_allclose(along_speed, mu(name, u + h, p).imag / h.imag, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose([along_p[key] for key in p], [*expected.values()], rtol=1e-12, atol=1e-14)


# The contact of eq. 5.18, and its closed forms 5.6 to 5.8
MASS, K0 = 100.0, 50e6
XIS = [0.0, 0.1, 0.5, 0.9, 0.999, 0.9995, 1.0, 1.0005, 1.001, 2.0, 5.0]
P = (50e6, 2e4)


def ratio(xi):
    """Return acos(xi)/sqrt(1 - xi²) = 2F1(1, 1; 3/2; (1 - xi)/2), which is regular at critical damping."""
    return hyp2f1(1, 1, 1.5, (1 - np.asarray(xi)) / 2)


@pytest.mark.parametrize("xi", XIS)
def test_restitution_and_contact_time(xi):
    """R = exp(-2 xi acos(xi)/sqrt(1 - xi²)), w_d T = 2 acos(xi), with acosh and xi² - 1 for xi > 1 (5.6 to 5.8)."""
    np.testing.assert_allclose(restitution(xi), np.exp(-2 * xi * ratio(xi)), rtol=1e-12)
    w0 = np.sqrt(K0 / MASS)
    np.testing.assert_allclose(contact_time(MASS, K0, 2 * xi * w0 * MASS), 2 * ratio(xi) / w0, rtol=1e-12)


@settings(deadline=None)
@given(st.floats(-0.01, 0.01, allow_subnormal=False), st.floats(-20, 20, allow_subnormal=False))
def test_force_is_one_sided(compression, rate):
    """J = k0 d + c0 d' where d >= 0 and J is positive, else 0 (5.18)."""
    value = float(force(jnp.asarray(compression), jnp.asarray(rate), *P))
    inside = 50e6 * compression + 2e4 * rate
    expected = inside if compression >= 0 and inside > 0 else 0.0
    np.testing.assert_allclose(value, expected, rtol=1e-13, atol=1e-9)
    assert value >= 0


# Linear modes, eqs. 5.15 to 5.17
@pytest.mark.parametrize(("w1", "v", "beta", "gamma"), [(25.0, 1.5, 0.3, 0.9), (50.0, 0.8, 0.4, 0.75)])
def test_linearised_is_jacobian_of_field(w1, v, beta, gamma):
    """At steady sliding u = v, x1 = x2 = -F(v)/k1, and dF/du = mu m1 g (-1/v_cr + v²/v_cr³) with v_cr = 3 (5.9)."""
    scene = vj.SCENES["rotary"]()
    p = {name: jnp.asarray(parameter.default) for name, parameter in scene.parameters().items()}
    p |= {"k1": p["m1"] * w1**2, "v": jnp.asarray(v), "beta": jnp.asarray(beta), "gamma": jnp.asarray(gamma)}
    x = -0.4 * 250 * 9.81 * (1 - v / 3 + v**3 / 81) / p["k1"]
    rest, slope = jnp.stack([x, 0 * x, x, 0 * x]), 0.4 * 250 * 9.81 * (-1 / 3 + v**2 / 27)
    field = lambda state: jnp.stack(scene.field(scene.constants(p), (jnp.asarray(1.0),), tuple(state)))
    np.testing.assert_allclose(field(rest), 0, atol=1e-12)
    np.testing.assert_allclose(linearised(p, slope), jax.jacfwd(field)(rest), rtol=1e-12, atol=1e-12)


VibroImpact = vj.SCENES["vibro-impact"]
DRILL = {"m1": 230.0, "beta": 0.35, "gamma": 0.8, "k1": 2e5, "c2": 300.0, "g": 9.81, "v": 1.4}
CONTACT = {"k0": 4e7, "c0": 2e4, "delta": -0.004}


def constants(scene, **values):
    """Return the scene's constants as arrays, with defaults for missing values."""
    p = {name: parameter.default for name, parameter in scene.parameters().items()}
    given = {name: value for name, value in (DRILL | CONTACT | values).items() if name in p}
    return scene.constants({name: jnp.asarray(value) for name, value in (p | given).items()})


def test_contact_mode():
    """5.18: J acts where x2 >= delta and J is positive."""
    scene = VibroImpact()
    for over, v2, x1, touching in (
        (-1e-3, 2.0, 0.0, 0),  # apart
        (1e-3, 0.0, 0.0, 1),
        (1e-3, -1.9, 0.0, 1),  # J = 40000 - 38000 N
        (1e-3, -2.1, 0.0, 0),  # J < 0: released above delta
        (0.0, 0.5, 0.0, 1),  # the gap closes
        (0.0, -0.5, 0.0, 0),  # the gap opens
        (0.0, 0.0, 0.01, 1),  # at rest on the bit, pressed on by k2 (x1 - x2) > 0
        (0.0, 0.0, -0.01, 0),  # at rest, pulled off
    ):
        state = tuple(map(jnp.asarray, (x1, 0.0, CONTACT["delta"] + over, v2)))
        assert tuple(map(float, scene.mode_at(constants(scene), state))) == (1, touching), (over, v2, x1)


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
    force = scene.contact_force(p, (1.0, 1.0), scene.start(p, "drive", ()))
    np.testing.assert_allclose(force, 4e7 * 0.005)  # k0 |delta|
