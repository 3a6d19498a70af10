"""Test friction laws against those of the exact reference, which are plain numpy (eqs. 2.13 to 2.17 and 5.9)."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exact.friction import LAWS

from vibrojax.physics.friction import FRICTION_LAWS

SPEEDS = np.array([1e-6, 1e-3, 0.02, 0.3, 1.5, 3.0, 4.2])

# Two sets for each law: the defaults of section 3, and distinct numbers that cannot be confused with each other.
PARAMETERS = {
    "coulomb": ({"mu": 0.4}, {"mu": 0.23}),
    "popp-exponential": ({"popp_c1": -0.02, "popp_c2": -0.25}, {"popp_c1": -0.3, "popp_c2": -0.7}),
    "popp-arctan": ({"a1": 0.14, "a2": 1.14, "b1": 2.0, "b2": 100.0}, {"a1": 0.2, "a2": 0.6, "b1": 0.9, "b2": 7.0}),
    "hyperbolic": ({"mu0": 0.4, "delta_f": 1.0}, {"mu0": 0.31, "delta_f": 2.3}),
    "hyperbolic-quadratic": (
        {"mu0": 0.4, "mu1": 0.1, "lambda": 99.4, "alpha": 0.7},
        {"mu0": 0.5, "mu1": 0.2, "lambda": 3.0, "alpha": 0.05},
    ),
    "stribeck": ({"mu": 0.4, "v_cr": 3.0}, {"mu": 0.27, "v_cr": 1.9}),
}
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
    assert {law.reference for law in FRICTION_LAWS.values()} == equations
    defaults = {name: {key: q.default for key, q in law.parameters.items()} for name, law in FRICTION_LAWS.items()}
    assert defaults == {name: both[0] for name, both in PARAMETERS.items()}


@pytest.mark.parametrize(("name", "p"), CASES)
def test_only_eq_5_9_has_constant_friction_under_impact(name, p):
    """Section 3: F = sgn(u) mu(u) (m1 g + J), but 5.9 uses the constant mu of eq. 5.12 for J."""
    expected = p["mu"] + 0 * SPEEDS if name == "stribeck" else mu(name, SPEEDS, p)
    values = [FRICTION_LAWS[name].on_impact(jnp.asarray(u), p) for u in SPEEDS]
    np.testing.assert_allclose(values, expected, rtol=1e-14)


@pytest.mark.parametrize(("name", "p"), CASES)
@pytest.mark.parametrize("rest", [0.0, 1e-300])
def test_limit_at_rest(name, p, rest):
    """mu(0+) and d mu/d|u| at 0+ are finite for every law."""
    value, slope = jax.value_and_grad(lambda u: jnp.asarray(FRICTION_LAWS[name].on_weight(u, p)))(rest)
    np.testing.assert_allclose([value, slope], AT_REST[name](p), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(("name", "p"), CASES)
def test_values_and_slopes(name, p):
    """Compare slopes with derivatives of the reference by imaginary steps, which are exact to rounding."""
    law, h = FRICTION_LAWS[name], 1e-30j
    both = jax.value_and_grad(lambda u, p: jnp.asarray(law.on_weight(u, p)), argnums=(0, 1))
    for u in map(float, SPEEDS):
        value, (along_speed, along_p) = both(u, p)
        assert value == pytest.approx(float(mu(name, u, p)), rel=1e-14)
        expected = {key: mu(name, u, p | {key: x + h}).imag / h.imag for key, x in p.items()}
        np.testing.assert_allclose(along_speed, mu(name, u + h, p).imag / h.imag, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose([along_p[key] for key in p], [*expected.values()], rtol=1e-12, atol=1e-14)
