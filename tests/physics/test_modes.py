"""Test linear modes, eqs. 5.15 to 5.17, against eigenvalues, the source's Table 5.3 and the rotary scene's field."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.physics.modes import empirical_frequency, linearised, natural_frequencies
from vibrojax.scenes.rotary import Rotary


def drill(w1, beta, gamma, m1=250.0, c2=250.0):
    """Return parameters with k1 = m1 w1²."""
    return {"m1": m1, "k1": m1 * w1**2, "beta": beta, "gamma": gamma, "c2": c2}


def reference_frequencies(p):
    """Return sqrt of the eigenvalues of M^-1 K, K = [[k1 + k2, -k2], [-k2, k2]], M = diag(m1, beta m1)."""
    m2 = p["beta"] * p["m1"]
    k2 = m2 * (p["gamma"] * np.sqrt(p["k1"] / p["m1"])) ** 2
    stiffness = np.array([[p["k1"] + k2, -k2], [-k2, k2]])
    return np.sqrt(np.sort(np.linalg.eigvals(np.diag([1 / p["m1"], 1 / m2]) @ stiffness)))


@pytest.mark.parametrize("beta", [0.01, 0.4, 1.2])
@pytest.mark.parametrize("gamma", [0.1, 0.75, 1.0, 1.3, 9.0])
def test_natural_frequencies_are_eigenvalues(beta, gamma):
    """Test eq. 5.16."""
    p = drill(33.0, beta, gamma, m1=300.0)
    np.testing.assert_allclose(natural_frequencies(p), reference_frequencies(p), rtol=1e-11)


@pytest.mark.parametrize(
    ("w1", "beta", "gamma", "eq_5_16", "eq_5_17"),
    [
        (25, 0.3, 0.9, 30.8, 30.0),
        (25, 0.3, 0.7, 27.8, 28.2),  # the source prints 28.0 for eq. 5.17, which gives 28.17
        (66, 0.4, 0.75, 77.5, 77.1),  # R7: the source prints 79.6 and 78.5
    ],
)
def test_table_5_3(w1, beta, gamma, eq_5_16, eq_5_17):
    """Eqs. 5.16 and 5.17, w² = (k1 + k2)/m1 + k2/(4 m2), agree with the source's values, cut or rounded to 0.1."""
    p = drill(float(w1), beta, gamma)
    assert natural_frequencies(p)[1] == pytest.approx(eq_5_16, abs=0.1)
    assert empirical_frequency(p) == pytest.approx(eq_5_17, abs=0.1)
    # k2/m1 = beta gamma² w1², k2/m2 = gamma² w1²
    assert empirical_frequency(p) == pytest.approx(w1 * np.sqrt(1 + beta * gamma**2 + gamma**2 / 4), rel=1e-13)


def rotary_at_steady_sliding(w1, v, beta, gamma):
    """Return the rotary scene, its parameters and its equilibrium u = v, x1 = x2 = -F(v)/k1."""
    scene = Rotary()
    p = {name: jnp.asarray(parameter.default) for name, parameter in scene.parameters().items()}
    p |= {"k1": p["m1"] * w1**2, "v": jnp.asarray(v), "beta": jnp.asarray(beta), "gamma": jnp.asarray(gamma)}
    friction = 0.4 * 250 * 9.81 * (1 - v / 3 + v**3 / 81)  # 5.9 with v_cr = 3
    rest = -friction / p["k1"]
    return scene, p, (rest, jnp.asarray(0.0), rest, jnp.asarray(0.0))


def slope_5_9(v):
    """Return dF/du = mu m1 g (-1/v_cr + u²/v_cr³) at u = v."""
    return 0.4 * 250 * 9.81 * (-1 / 3 + v**2 / 27)


@pytest.mark.parametrize(("w1", "v", "beta", "gamma"), [(25.0, 1.5, 0.3, 0.9), (50.0, 0.8, 0.4, 0.75)])
def test_linearised_is_jacobian_of_field(w1, v, beta, gamma):
    scene, p, rest = rotary_at_steady_sliding(w1, v, beta, gamma)
    field = lambda state: jnp.stack(scene.field(scene.constants(p), (jnp.asarray(1.0),), tuple(state)))  # noqa: E731
    np.testing.assert_allclose(field(jnp.stack(rest)), 0, atol=1e-12)
    np.testing.assert_allclose(linearised(p, slope_5_9(v)), jax.jacfwd(field)(jnp.stack(rest)), rtol=1e-12, atol=1e-12)
