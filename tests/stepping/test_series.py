"""Test truncated Taylor series: arithmetic against Cauchy's integral, expansions against closed-form solutions."""

import operator
from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

from vibrojax.physics import elementary
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.scenes.vibro_impact import VibroImpact
from vibrojax.stepping.series import expand, known

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


FUNCTIONS = {
    "exp": (elementary.exp, np.exp),
    "log": (elementary.log, np.log),
    "sqrt": (elementary.sqrt, np.sqrt),
    "sin": (elementary.sin, np.sin),
    "cos": (elementary.cos, np.cos),
    "tanh": (elementary.tanh, np.tanh),
    "arctan": (elementary.arctan, np.arctan),
    "power 2.5": (lambda x: elementary.power(x, 2.5), lambda x: x**2.5),
    "power -1/3": (lambda x: elementary.power(x, -1 / 3), lambda x: x ** (-1 / 3)),
    "power 2": (lambda x: elementary.power(x, 2.0), lambda x: x**2),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name):
    """Of a product, which is from 0.9 to 1.4 at the center of the circle."""
    of_series, of_numbers = FUNCTIONS[name]
    check(lambda a, b: of_series(a * b), lambda a, b: of_numbers(a * b))


@pytest.mark.parametrize(
    ("rates", "start", "solution"),
    [
        pytest.param(
            lambda y: (y[1], -9.0 * y[0]),
            (0.2, -1.0),
            lambda t: 0.2 * np.cos(3 * t) - np.sin(3 * t) / 3,
            id="oscillator",
        ),
        pytest.param(lambda y: (elementary.exp(-y[0]),), (0.8,), lambda t: np.log(np.exp(0.8) + t), id="exp"),
        pytest.param(
            lambda y: (elementary.tanh(y[0]),), (0.3,), lambda t: np.arcsinh(np.sinh(0.3) * np.exp(t)), id="tanh"
        ),
        pytest.param(
            lambda y: (elementary.sqrt(1.0 + y[0] * y[0]),), (0.3,), lambda t: np.sinh(t + np.arcsinh(0.3)), id="sqrt"
        ),
    ],
)
def test_expansion_of_solution(rates, start, solution):
    """The coefficients of y(h tau) are h^k times those of the solution y(t)."""
    h = np.array([0.1, 0.7])
    [expansion, *_] = expand(rates, tuple(jnp.full(2, x) for x in start), jnp.asarray(h), ORDER)
    expected = cauchy(solution(CIRCLE)[:, None]) * h**POWERS
    np.testing.assert_allclose(expansion.arrays(ORDER, jnp.zeros(2)), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("law", FRICTION_LAWS)
def test_expansion_of_drill_against_repeated_differentiation(law):
    """y^(k+1) = (d y^(k)/dy) f(y) by nested forward derivatives of the field on arrays, which do not use series.

    The four lanes are in different modes.
    """
    scene = VibroImpact(friction=FRICTION_LAWS[law])
    p = {name: jnp.asarray(parameter.default) for name, parameter in scene.parameters().items()}
    p = scene.constants(p | {"k0": jnp.asarray(4e5), "c0": jnp.asarray(50.0)})
    slip, touching = jnp.asarray([1.0, 1.0, -1.0, 0.0]), jnp.asarray([1.0, 0.0, 1.0, 1.0])
    state = (jnp.full(4, 0.01), 0.4 * slip - 1.5, jnp.full(4, 0.004), jnp.full(4, 0.9))
    field = lambda y: scene.field(p, (slip, touching), y)  # noqa: E731

    def differentiate_along_field(derivative):
        return lambda y: jax.jvp(derivative, (y,), (field(y),))[1]

    order, h = 5, 0.003
    expansions = jax.jit(lambda y: [c.arrays(order, slip) for c in expand(field, y, h, order)])(state)
    derivatives = [field]
    for _ in range(1, order):
        derivatives.append(differentiate_along_field(derivatives[-1]))
    # compiled together, because they have much in common
    derivative_values = jax.jit(lambda y: [derivative(y) for derivative in derivatives])(state)
    for k, values in enumerate(derivative_values, 1):
        expected = np.array(values) * h**k / factorial(k)
        np.testing.assert_allclose([c[k] for c in expansions], expected, rtol=1e-9, atol=1e-13, err_msg=str(k))
