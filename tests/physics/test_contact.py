"""Test the contact of eq. 5.18, and its closed forms 5.6 to 5.8."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import hyp2f1

from vibrojax.physics.contact import contact_time, force, restitution

MASS, K0 = 100.0, 50e6
XIS = [0.0, 0.1, 0.5, 0.9, 0.999, 0.9995, 1.0, 1.0005, 1.001, 2.0, 5.0]
P = (50e6, 2e4)


def ratio(xi):
    """Return acos(xi)/sqrt(1 - xi²) = 2F1(1, 1; 3/2; (1 - xi)/2), which is regular at critical damping."""
    return hyp2f1(1, 1, 1.5, (1 - np.asarray(xi)) / 2)


def ratio_slope(xi):
    """Return its derivative, -1/3 2F1(2, 2; 5/2; (1 - xi)/2)."""
    return -hyp2f1(2, 2, 2.5, (1 - np.asarray(xi)) / 2) / 3


@pytest.mark.parametrize("xi", XIS)
def test_restitution_and_contact_time(xi):
    """R = exp(-2 xi acos(xi)/sqrt(1 - xi²)), w_d T = 2 acos(xi), with acosh and xi² - 1 for xi > 1 (5.6 to 5.8)."""
    np.testing.assert_allclose(restitution(xi), np.exp(-2 * xi * ratio(xi)), rtol=1e-12)
    w0 = np.sqrt(K0 / MASS)
    np.testing.assert_allclose(contact_time(MASS, K0, 2 * xi * w0 * MASS), 2 * ratio(xi) / w0, rtol=1e-12)


SLOPE = jax.grad(restitution)
JITTED = [jax.jit(jax.vmap(function)) for function in (restitution, SLOPE, jax.grad(SLOPE))]


@pytest.mark.parametrize("around", [1.0, 1 - 1e-3, 1 + 1e-3])
def test_smooth_through_critical_damping(around):
    """Values, slopes and curvatures agree with the closed form at xi = 1 and at both ends of the series about it."""
    xi = around + np.linspace(-2e-4, 2e-4, 41)
    expected = np.exp(-2 * xi * ratio(xi))
    values, slopes, curvatures = (function(xi) for function in JITTED)
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    slope = -2 * (ratio(xi) + xi * ratio_slope(xi)) * expected
    np.testing.assert_allclose(slopes, slope, rtol=1e-8)
    np.testing.assert_allclose(curvatures[1:-1], np.gradient(slope, xi)[1:-1], rtol=1e-5)


@settings(deadline=None)
@given(st.floats(-0.01, 0.01, allow_subnormal=False), st.floats(-20, 20, allow_subnormal=False))
def test_force_is_one_sided(compression, rate):
    """J = k0 d + c0 d' where d >= 0 and J is positive, else 0 (5.18)."""
    value = float(force(jnp.asarray(compression), jnp.asarray(rate), *P))
    inside = 50e6 * compression + 2e4 * rate
    expected = inside if compression >= 0 and inside > 0 else 0.0
    np.testing.assert_allclose(value, expected, rtol=1e-13, atol=1e-9)
    assert value >= 0
