"""Test steps: those of the located and the smoothed stepper, and their arithmetic of series and polynomials."""

import json
import operator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval

import vibrojax as vj
from vibrojax.stepping.polynomial import root
from vibrojax.stepping.series import known
from vibrojax.studies.trajectory import feature_lines


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("touching", [False, True])
def test_slip_that_ends_immediately(precision, touching):
    """A spring force exceeds the stick limit and falls below it at once. This takes few steps for any excess."""
    excess, impact = 10.0 ** np.arange(-17, -1, dtype=float), 1000.0 * touching
    k1, k2, x2 = 156250.0, 0.4 * 156250.0 * 0.75**2, impact / 50e6
    x1 = (0.4 * (250.0 * 9.81 + impact) * (1 + excess) + k2 * x2) / (k1 + k2)
    columns = {"start_x1": x1, "start_v1": 0 * x1 - 1.5, "start_x2": 0 * x1 + x2, "start_v2": 0 * x1}
    sweep = {"scene": "vibro-impact", "parameters": {"delta": 0.0 if touching else 1.0}, "unusual": True}
    run = {"settle": 0.0, "observe": 0.004, "precision": precision}
    ds = vj.run_sweep(sweep | {"points": columns, "run": run}, progress=False)
    assert (ds.status == 0).all() and json.loads(ds.attrs["solver"])["steps"] < 40 * len(x1)


# The steppers against each other, over a transient too short for chaos
STUCK = {"start": "stuck"}  # sticks, slips both ways, impacts; settles on a periodic orbit
IRREGULAR = {"k1": 625000.0, "gamma": 1.2, "start": "drive"}  # settles on a chaotic attractor (Fig. 5.77c)
WIDTHS = (1e-2, 1e-3, 1e-4)


def position_motion(point, **how):
    return vj.simulate("vibro-impact", **point, **how, duration=0.8, sampling=1e-3, progress=False)


@pytest.fixture(scope="module")
def located():
    return {"stuck": position_motion(STUCK), "irregular": position_motion(IRREGULAR)}


def position_error(trajectory, reference):
    """Return the largest difference of the positions, relative to the largest position."""
    return max(float(abs(trajectory[x] - reference[x]).max() / abs(reference[x]).max()) for x in ("x1", "x2"))


def bound_of_width(width):
    """Return the order of the smoothing error: w^(4/5) in units of 1 m/s ."""
    return width**0.8


@pytest.mark.parametrize("width", WIDTHS)
def test_smoothed_matches_located(located, width):
    """The error stays below the bound of the width, which shrinks with the width."""
    for name, point in (("stuck", STUCK), ("irregular", IRREGULAR)):
        smoothed = position_motion(point, method="smoothed", smoothing=width, step=0.1 * width)
        assert position_error(smoothed, located[name]) < bound_of_width(width)


def test_smoothed_matches_diffrax():
    """Both solve the same equations, so at equal widths only their step errors differ. These are far smaller."""
    smoothed = position_motion(STUCK, method="smoothed", smoothing=1e-2, step=1e-4)
    adaptive = position_motion(STUCK, solver="Tsit5", smoothing=1e-2, error=1e-6)
    assert position_error(smoothed, adaptive) < 1e-2 * bound_of_width(1e-2)
    assert "regime" not in adaptive and feature_lines(adaptive) == []


@jax.jit
def find_root(c, zeros, guess, end):
    return root([c[k] for k in range(c.shape[0])], zeros, guess, end)


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
    The trapezoidal rule converges exponentially on a circle."""
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


def test_expressions():
    for function in (
        lambda a, b: -a,
        lambda a, b: a * a * a * b,
        lambda a, b: (1 - a / 3 + a * a * a / 81) * (2 * b + 1) - 1 / (1 + a * a),
    ):
        check(function)


NAMES = ("exp", "log", "sqrt", "sin", "cos", "tanh", "arctan")
FUNCTIONS = {name: (getattr(vj.elementary, name), getattr(np, name)) for name in NAMES} | {
    f"power {x}": (lambda a, x=x: vj.elementary.power(a, x), lambda a, x=x: a**x) for x in (2.5, -1 / 3, 2.0)
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name):
    """Of a product, which is from 0.9 to 1.4 at the center of the circle."""
    of_series, of_numbers = FUNCTIONS[name]
    check(lambda a, b: of_series(a * b), lambda a, b: of_numbers(a * b))
