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
from vibrojax.stepping.polynomial import first_guess, highest, integral, root, rough_root, slope, value

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


@settings(deadline=None, max_examples=200)
@given(root_at=st.floats(0.05, 0.95), shape=SHAPE, off=st.floats(-0.2, 0.2), zeros=st.sampled_from([0, 1, 2]))
def test_root(root_at, shape, off, zeros):
    """Five Newton iterations suffice from a guess as good as the parabola's. Zeros at the start are not found."""
    guess = min(max(root_at + off, 0.02), 0.99)
    c = jnp.asarray(falling(root_at, shape, zeros))[:, None]
    result = find_root(c, jnp.full(1, float(zeros)), jnp.full(1, guess), jnp.ones(1))
    np.testing.assert_allclose(result, root_at, rtol=1e-12)


@settings(deadline=None, max_examples=100)
@given(root_at=st.floats(0.05, 0.95), shape=SHAPE, scale=st.floats(1e-9, 1e9), end=st.floats(0.96, 1.0))
def test_root_from_exact_guess(root_at, shape, scale, end):
    """A guess that is the root to the last digit is returned, whatever the unit of the polynomial."""
    c = jnp.asarray(scale * falling(root_at, shape))[:, None]
    result = find_root(c, jnp.zeros(1), jnp.full(1, root_at), jnp.full(1, end))
    np.testing.assert_allclose(result, root_at, rtol=1e-12)


@pytest.mark.parametrize("guess", [0.5, 0.25, 0.9, 0.5 + 1e-16])
def test_root_of_line(guess):
    """One Newton step is exact for 1 - 2 tau, and later steps must stay there."""
    c = jnp.asarray([1.0, -2.0, 0, 0, 0, 0, 0, 0])[:, None]
    np.testing.assert_allclose(find_root(c, jnp.zeros(1), jnp.full(1, guess), jnp.ones(1)), 0.5, rtol=1e-15)


def test_root_where_newton_leaves_the_bracket():
    """0.2 + 3 tau - 6 tau² rises at the guess, so Newton's step goes backwards. The root is (3 + sqrt(13.8))/12."""
    c = jnp.asarray([0.2, 3.0, -6.0, 0, 0, 0, 0, 0])[:, None]
    result = find_root(c, jnp.zeros(1), jnp.full(1, 0.1), jnp.ones(1))
    np.testing.assert_allclose(result, (3 + np.sqrt(13.8)) / 12, rtol=1e-12)


def test_roots_of_several_lanes():
    """Lanes with different roots, starts and ends do not affect each other."""
    root_at = np.array([0.2, 0.5, 0.7, 0.05])
    zeros = np.array([0, 1, 2, 1])
    c = np.stack(
        [falling(*each) for each in zip(root_at, RANDOM.uniform(-0.1, 0.1, (4, 3)), zeros, strict=True)], axis=1
    )
    result = find_root(
        jnp.asarray(c), jnp.asarray(zeros, float), jnp.asarray(root_at * 1.1), jnp.asarray([0.4, 1, 1, 0.1])
    )
    np.testing.assert_allclose(result, root_at, rtol=1e-12)


@settings(deadline=None, max_examples=100)
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


def test_root_in_single_precision():
    c = jnp.asarray(falling(0.3, [0.1, -0.1, 0.05]), jnp.float32)[:, None]
    result = find_root(c, *(jnp.full(1, value, jnp.float32) for value in (0.0, 0.35, 1.0)))
    assert result.dtype == jnp.float32
    np.testing.assert_allclose(result, 0.3, rtol=1e-6)


@pytest.mark.parametrize(
    ("start", "rate", "end"),
    [
        (1.0, -1.5, -0.5),  # a line
        (1.0, 0.0, -1.0),
        (1.0, 3.0, -2.0),  # rises before it falls
        (1.0, -3.0, -0.1),
        (1e-12, -1e-3, -2.0),
        (1e-12, 2.0, -1.0),  # starts just off the surface and returns to it
        (0.0, 2.0, -1.0),  # starts on the surface: the other root
    ],
)
def test_first_guess_is_root_of_parabola(start, rate, end):
    """The parabola is start + rate r + c r² with c = end - start - rate. Its root lies in (0, 1] after the start."""
    result = float(first_guess(*(jnp.full(1, x) for x in (start, rate, end)))[0])
    c = end - start - rate
    roots = np.roots([c, rate, start] if c else [rate, start]).real
    expected = max(x for x in roots if 0 <= x <= 1)
    np.testing.assert_allclose(result, expected, rtol=1e-6)
    assert abs(c * result**2 + rate * result + start) < 1e-15 + 1e-13 * abs(rate * result)


def test_first_guess_without_root_is_middle():
    """A start on the surface at zero speed gives 0/0."""
    np.testing.assert_array_equal(first_guess(jnp.zeros(1), jnp.zeros(1), -jnp.ones(1)), [0.5])


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("n", [7, 9, 11])
def test_rough_root(dtype, n):
    x = np.exp(np.linspace(-80, 80, 9999)).astype(dtype)
    ratio = np.asarray(rough_root(jnp.asarray(x), n)) / x.astype(float) ** (1 / n)
    assert ratio.min() > 1 - 1e-5 and ratio.max() < 1.07
    zero, infinite, unknown = rough_root(jnp.asarray([0.0, np.inf, np.nan], dtype), n)
    assert zero < 1e-3 and infinite > 1 and unknown > 1


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
