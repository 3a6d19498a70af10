"""Test the arithmetic of steps: polynomials against numpy.polynomial, known roots, a cosine and sine, a maximum."""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from vibrojax.measures.motion import cos_sin
from vibrojax.stepping.polynomial import extremes, highest, integral, root, slope, value

RANDOM = np.random.default_rng(11)


@pytest.mark.parametrize("order", [1, 2, 5, 10])
def test_value_slope_and_integral(order):
    """Compare with sum c_k tau^k, sum k c_k tau^(k-1) and sum c_k tau^(k+1)/(k+1) in each lane."""
    c = RANDOM.uniform(-1, 1, (order + 1, 6))
    tau = np.array([0.0, 0.1, 0.5, 0.9, 1.0, 1.3])
    lanes = [jnp.asarray(row) for row in c]
    for lane, t in enumerate(tau):
        exact = Polynomial(c[:, lane])
        for function, expected in ((value, exact), (slope, exact.deriv()), (integral, exact.integ())):
            np.testing.assert_allclose(function(lanes, jnp.asarray(tau))[lane], expected(t), rtol=1e-12, atol=1e-14)


@jax.jit
def find_root(c, zeros, guess, end):
    return root([c[k] for k in range(c.shape[0])], zeros, guess, end)


def falling(root_at, shape, zeros=0):
    """Return tau^zeros (root_at - tau) (1 + shape_1 tau + ...), padded to order 7: one simple root in (0, 1]."""
    c = (Polynomial([0, 1]) ** zeros * Polynomial([root_at, -1]) * Polynomial([1, *shape])).coef
    return np.pad(c, (0, 8 - len(c)))


SHAPE = st.lists(st.floats(-0.1, 0.1, allow_subnormal=False), min_size=3, max_size=3)


@settings(deadline=None, max_examples=50)
@given(root_at=st.floats(0.05, 0.95), shape=SHAPE, off=st.floats(-0.2, 0.2), zeros=st.sampled_from([0, 1, 2]))
def test_root(root_at, shape, off, zeros):
    """Five Newton iterations suffice from a guess as good as the parabola's. Zeros at the start are not found."""
    guess = min(max(root_at + off, 0.02), 0.99)
    c = jnp.asarray(falling(root_at, shape, zeros))[:, None]
    result = find_root(c, jnp.full(1, float(zeros)), jnp.full(1, guess), jnp.ones(1))
    np.testing.assert_allclose(result, root_at, rtol=1e-12)


def test_root_where_newton_leaves_the_bracket():
    """0.2 + 3 tau - 6 tau² rises at the guess, so Newton's step goes backwards. The root is (3 + sqrt(13.8))/12."""
    c = jnp.asarray([0.2, 3.0, -6.0, 0, 0, 0, 0, 0])[:, None]
    result = find_root(c, jnp.zeros(1), jnp.full(1, 0.1), jnp.ones(1))
    np.testing.assert_allclose(result, (3 + np.sqrt(13.8)) / 12, rtol=1e-12)


@settings(deadline=None, max_examples=30)
@given(
    c=st.lists(st.floats(-1, 1, allow_subnormal=False), min_size=6, max_size=6),
    guess=st.floats(0.02, 0.98),
    end=st.floats(0.3, 1.0),
)
def test_root_stays_within_step(c, guess, end):
    """For any polynomial from 1 at the start to -1 at the end, the result lies in (0, end]."""
    inner = Polynomial(c)
    p = Polynomial([1, -2 / end]) + Polynomial([0, end, -1]) * inner  # the second part vanishes at both ends
    padded = np.pad(p.coef, (0, 8 - len(p.coef)))
    result = find_root(jnp.asarray(padded)[:, None], jnp.zeros(1), jnp.full(1, guess * end), jnp.full(1, end))
    assert 0 < result[0] <= end


def test_cos_sin():
    angle = np.linspace(-300, 300, 20001)
    cos, sin = cos_sin(jnp.asarray(angle))
    np.testing.assert_allclose(cos, np.cos(angle), rtol=0, atol=1e-15)
    np.testing.assert_allclose(sin, np.sin(angle), rtol=0, atol=1e-15)


def test_maximum_within_step():
    """A wave of 2 rad, the longest stride, reaches 1 at its top. A rise is highest at its end, a fall at its start."""
    quarter = np.pi / 2
    wave = [jnp.full(2, np.sin(0.3 + k * quarter) * 2.0**k / factorial(k)) for k in range(18)]
    np.testing.assert_allclose(highest(wave, jnp.asarray([1.0, 0.4])), [1.0, np.sin(1.1)], rtol=1e-10)
    fall = [-c for c in wave]
    np.testing.assert_allclose(highest(fall, jnp.asarray([0.2, 0.4])), -np.sin(0.3), rtol=1e-12)


def test_extremes_of_a_wave_on_a_ramp():
    """A wave on a ramp turns twice within a step of 2 rad, at cos(phase + angle) = ramp; its ends may be outside."""
    phase, ramp = map(np.ravel, np.meshgrid(np.linspace(-np.pi, np.pi, 91), np.linspace(0, 1.4, 36)))
    wave = np.array([np.sin(phase + k * np.pi / 2) * 2.0**k / factorial(k) for k in range(25)])
    wave[1] -= 2 * ramp
    angle = np.linspace(0, 2, 2001)[:, None]
    values = np.sin(phase + angle) - ramp * angle
    low, high = extremes([jnp.asarray(c) for c in wave], jnp.ones(len(phase)))
    below, above = values.min(axis=0), values.max(axis=0)
    for found, right in ((-low, -below), (high, above)):
        assert np.max(found - right) < 2e-7  # that of the samples in `values`
        assert np.max(right - found) < 2.5e-3 and np.mean(right - found < 1e-8) > 0.98
