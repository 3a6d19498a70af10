"""Test the contact of eq. 5.18, and its closed forms 5.6 to 5.8 against a numerically integrated blow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.special import hyp2f1

from vibrojax.physics.contact import contact_time, damping_ratio, force, raw_force, restitution

MASS, K0 = 100.0, 50e6
XIS = [0.0, 0.1, 0.5, 0.9, 0.999, 0.9995, 1.0, 1.0005, 1.001, 2.0, 5.0]
P = (50e6, 2e4)


def integrate_blow(xi):
    """Return restitution and duration of m d'' = -k0 d - c0 d', d(0) = 0, d'(0) = 1, until the force is zero."""
    c0 = 2 * xi * np.sqrt(K0 * MASS)

    def released(t, y):
        return K0 * y[0] + c0 * y[1]

    released.terminal, released.direction = True, -1
    run = solve_ivp(
        lambda t, y: (y[1], -(K0 * y[0] + c0 * y[1]) / MASS),
        (0.0, 20 / np.sqrt(K0 / MASS)),
        (0.0, 1.0),
        method="DOP853",
        events=released,
        rtol=1e-12,
        atol=1e-16,
    )
    return -run.y_events[0][0, 1], run.t_events[0][0]


def ratio(xi):
    """Return acos(xi)/sqrt(1 - xi²) = 2F1(1, 1; 3/2; (1 - xi)/2), which is regular at critical damping."""
    return hyp2f1(1, 1, 1.5, (1 - np.asarray(xi)) / 2)


def ratio_slope(xi):
    """Return its derivative, -1/3 2F1(2, 2; 5/2; (1 - xi)/2)."""
    return -hyp2f1(2, 2, 2.5, (1 - np.asarray(xi)) / 2) / 3


@pytest.mark.parametrize("xi", XIS)
def test_restitution_and_contact_time_of_integrated_blow(xi):
    """R = exp(-2 xi acos(xi)/sqrt(1 - xi²)), w_d T = 2 acos(xi), with acosh and xi² - 1 for xi > 1 (5.6 to 5.8)."""
    expected_restitution, expected_time = integrate_blow(xi)
    np.testing.assert_allclose(restitution(xi), expected_restitution, rtol=1e-9)
    c0 = 2 * xi * np.sqrt(K0 * MASS)
    np.testing.assert_allclose(contact_time(MASS, K0, c0), expected_time, rtol=1e-9)


def test_elastic_limit():
    """At xi = 0, R = 1, T is half a period pi/W, and dR/dxi = -2 acos(0) = -pi."""
    value, slope = jax.value_and_grad(restitution)(0.0)
    np.testing.assert_allclose([value, slope], [1.0, -np.pi], rtol=1e-14)
    np.testing.assert_allclose(contact_time(MASS, K0, 0.0), np.pi / np.sqrt(K0 / MASS), rtol=1e-14)


def test_critical_damping():
    """At xi = 1, acos(xi)/sqrt(1 - xi²) = 1 with slope -1/3, so R = exp(-2), dR/dxi = -2 (1 - 1/3) R, T = 2/W."""
    value, slope = jax.value_and_grad(restitution)(1.0)
    np.testing.assert_allclose([value, slope], [np.exp(-2), -4 / 3 * np.exp(-2)], rtol=1e-13)
    np.testing.assert_allclose(contact_time(MASS, K0, 2 * np.sqrt(K0 * MASS)), 2 / np.sqrt(K0 / MASS), rtol=1e-13)


@pytest.mark.parametrize("around", [1.0, 1 - 1e-3, 1 + 1e-3])
def test_smooth_through_critical_damping(around):
    """Values, slopes and curvatures agree with the closed form at xi = 1 and at both ends of the series about it."""
    xi = around + np.linspace(-2e-4, 2e-4, 41)
    expected = np.exp(-2 * xi * ratio(xi))
    np.testing.assert_allclose(jax.vmap(restitution)(xi), expected, rtol=1e-12)
    slope = -2 * (ratio(xi) + xi * ratio_slope(xi)) * expected
    np.testing.assert_allclose(jax.vmap(jax.grad(restitution))(xi), slope, rtol=1e-8)
    curvature = np.gradient(slope, xi)
    np.testing.assert_allclose(jax.vmap(jax.grad(jax.grad(restitution)))(xi)[1:-1], curvature[1:-1], rtol=1e-5)


@pytest.mark.parametrize("xi", [0.05, 0.3, 0.7, 0.99, 0.9991, 1.0009, 1.01, 1.7, 4.0])
def test_gradient_against_closed_form_and_finite_differences(xi):
    slope = jax.grad(restitution)(xi)
    closed = -2 * (ratio(xi) + xi * ratio_slope(xi)) * np.exp(-2 * xi * ratio(xi))
    np.testing.assert_allclose(slope, closed, rtol=1e-8)
    h = 1e-4
    central = (integrate_blow(xi + h)[0] - integrate_blow(xi - h)[0]) / (2 * h)
    np.testing.assert_allclose(slope, central, rtol=1e-5)


def test_gradient_of_contact_time_in_all_arguments():
    c0 = 2 * 0.6 * np.sqrt(K0 * MASS)
    slopes = jax.grad(contact_time, argnums=(0, 1, 2))(MASS, K0, c0)

    def time(mass, k0, c0):  # T = 2 acos(xi)/w_d, w_d = W sqrt(1 - xi²)
        w, xi = np.sqrt(k0 / mass), c0 / (2 * np.sqrt(k0 * mass))
        return 2 * np.arccos(xi) / (w * np.sqrt(1 - xi**2))

    arguments = np.array([MASS, K0, c0])
    for i, slope in enumerate(slopes):
        h = np.zeros(3)
        h[i] = 1e-5 * arguments[i]
        np.testing.assert_allclose(slope, (time(*(arguments + h)) - time(*(arguments - h))) / (2 * h[i]), rtol=1e-7)


def test_damping_ratio():
    """xi = c0/(2 m2 W), W = sqrt(k0/m2)."""
    np.testing.assert_allclose(damping_ratio(90.0, 4e6, 700.0), 700 / (2 * 90 * np.sqrt(4e6 / 90)), rtol=1e-14)


def test_restitution_falls_with_damping_within_0_to_1():
    xi = jnp.linspace(0, 3, 3001)
    value = np.asarray(jax.jit(restitution)(xi))
    assert value.shape == (3001,)
    assert value[0] == 1
    assert value[-1] > 0
    assert np.all(np.diff(value) < 0)


@settings(deadline=None)
@given(st.floats(-0.01, 0.01, allow_subnormal=False), st.floats(-20, 20, allow_subnormal=False))
def test_force_is_one_sided(compression, rate):
    """J = k0 d + c0 d' where d >= 0 and J is positive, else 0 (5.18)."""
    value = float(force(jnp.asarray(compression), jnp.asarray(rate), *P))
    inside = 50e6 * compression + 2e4 * rate
    expected = inside if compression >= 0 and inside > 0 else 0.0
    np.testing.assert_allclose(value, expected, rtol=1e-13, atol=1e-9)
    assert value >= 0


@pytest.mark.parametrize(
    ("compression", "rate", "expected"),
    [
        (1e-3, 0.0, 5e4),
        (1e-3, 2.0, 9e4),
        (1e-3, -2.0, 1e4),
        (1e-3, -3.0, 0.0),  # 5e4 - 6e4: the stop does not pull
        (0.0, 2.0, 4e4),  # touching: the damper acts at once
        (0.0, -2.0, 0.0),
        (-1e-9, 2.0, 0.0),  # apart: the damper does not act
        (-1e-3, 3.0, 0.0),
    ],
)
def test_force_in_each_case(compression, rate, expected):
    value = force(jnp.asarray(compression), jnp.asarray(rate), *P)
    np.testing.assert_allclose(value, expected, rtol=1e-13)
    slopes = jax.grad(force, argnums=(0, 1))(compression, rate, *P)
    if expected > 0:
        assert slopes == (50e6, 2e4)
        np.testing.assert_allclose(raw_force(compression, rate, *P), expected, rtol=1e-13)
    else:
        assert slopes == (0, 0)


def test_single_precision():
    """The range includes critical damping, near which 1 - xi² loses digits that acos(xi) keeps."""
    xi = jnp.asarray([0.0, 0.1, 0.5, 0.9, 0.998, 1.0, 1.002, 2.0], jnp.float32)
    value = restitution(xi)
    assert value.dtype == jnp.float32
    np.testing.assert_allclose(value, np.exp(-2 * xi.astype(float) * ratio(xi.astype(float))), rtol=5e-5)
