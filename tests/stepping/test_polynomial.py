"""Test the arithmetic of steps: Taylor series, roots of polynomials, cosine and sine, extremes, and the clock."""

import operator
from fractions import Fraction
from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval

from vibrojax.measures.motion import cos_sin
from vibrojax.physics import elementary
from vibrojax.stepping import Clock
from vibrojax.stepping.polynomial import extremes, root
from vibrojax.stepping.series import known


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


# The clock

STEPS = 3_000_000


@jax.jit
def tick_many_times(clock, dt):
    """Return `clock` after STEPS steps of `dt` [s], and the plain sum."""

    def tick(_, both):
        clock, total = both
        return clock.advanced(dt), total + dt

    return jax.lax.fori_loop(0, STEPS, tick, (clock, clock.high))


@pytest.mark.parametrize(("dtype", "bound"), [("float32", 2e-3), ("float64", 1e-11)])
def test_clock_is_exact_over_three_million_steps(dtype, bound):
    """Some 3e6 steps make 10^5 cycles, or 4e4 s. The clock gives n dt to half a unit in the last place, while a plain
    sum drifts by thousands of these units.
    """
    zero, dt = jnp.zeros((), dtype), jnp.asarray(0.0127, dtype)
    clock, plain = tick_many_times(Clock(zero, zero), dt)
    exact = STEPS * Fraction(float(dt))
    clock_time = Fraction(float(clock.high)) + Fraction(float(clock.low))
    assert abs(float(clock_time - exact)) < bound
    assert abs(float(Fraction(float(plain)) - exact)) > 1000 * bound
    assert float(clock.until(jnp.asarray(float(exact), dtype))) == pytest.approx(0.0, abs=2 * bound)


# Truncated Taylor series, against Cauchy's integral

ORDER = 9
POWERS = np.arange(ORDER + 1)[:, None]
RANDOM = np.random.default_rng(7)
# Two lanes, with coefficients that fall so fast that every function below is analytic inside Cauchy's circle.
A, B = RANDOM.uniform(-1, 1, (2, ORDER + 1, 2)) * 0.3**POWERS
A[0], B[0] = (0.7, -0.4), (1.9, -2.3)
LANE = np.array([1.3, -0.6])
CIRCLE = 0.5 * np.exp(2j * np.pi * np.arange(256) / 256)


def cauchy(values):
    """Return c_k = 1/(2 pi i) integral f(z) z^-(k+1) dz over the circle |z| = 0.5, from the values [256, lanes] of f.

    The trapezoidal rule converges exponentially on a circle.
    """
    return (np.fft.fft(values, axis=0)[: ORDER + 1] / 256 / 0.5**POWERS).real


def check(function, of_numbers=None):
    """Compare a function of two series with the same function, or `of_numbers`, on the circle."""
    result = function(*(known([jnp.asarray(c) for c in coefficients]) for coefficients in (A, B)))
    values = (of_numbers or function)(*(polyval(CIRCLE, coefficients).T for coefficients in (A, B)))
    actual = np.array(result.arrays(ORDER, jnp.zeros(2)))
    np.testing.assert_allclose(actual, cauchy(values), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("operate", [operator.add, operator.sub, operator.mul, operator.truediv])
def test_arithmetic(operate):
    """Of two series, and of a series and a number, or a number per lane, in either order."""
    check(operate)
    for number in (2.5, LANE):
        check(lambda a, b, number=number: operate(a, number))
        check(lambda a, b, number=number: operate(number, b))


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b: -a,
        lambda a, b: a * a * a * b,
        lambda a, b: (1 - a / 3 + a * a * a / 81) * (2 * b + 1) - 1 / (1 + a * a),
    ],
)
def test_expressions(function):
    check(function)


NAMES = ("exp", "log", "sqrt", "sin", "cos", "tanh", "arctan")
FUNCTIONS = {name: (getattr(elementary, name), getattr(np, name)) for name in NAMES} | {
    f"power {x}": (lambda a, x=x: elementary.power(a, x), lambda a, x=x: a**x) for x in (2.5, -1 / 3, 2.0)
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name):
    """Of a product, which is from 0.9 to 1.4 at the center of the circle."""
    of_series, of_numbers = FUNCTIONS[name]
    check(lambda a, b: of_series(a * b), lambda a, b: of_numbers(a * b))
