"""Test truncated Taylor series: arithmetic against Cauchy's integral, expansions against closed-form solutions."""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.physics import elementary
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.scenes.vibro_impact import VibroImpact
from vibrojax.stepping.series import expand, known

ORDER = 9
RANDOM = np.random.default_rng(7)
# Two lanes, with coefficients that fall so fast that every function below is analytic inside Cauchy's circle.
A = RANDOM.uniform(-1, 1, (ORDER + 1, 2)) * 0.3 ** np.arange(ORDER + 1)[:, None]
B = RANDOM.uniform(-1, 1, (ORDER + 1, 2)) * 0.3 ** np.arange(ORDER + 1)[:, None]
A[0], B[0] = (0.7, -0.4), (1.9, -2.3)
LANE = np.array([1.3, -0.6])


def series(coefficients):
    return known([jnp.asarray(c) for c in coefficients])


def cauchy(function):
    """Return c_k = 1/(2 pi i) integral f(a(z), b(z)) z^-(k+1) dz over |z| = 0.5.

    The trapezoidal rule converges exponentially on a circle.
    """
    z = 0.5 * np.exp(2j * np.pi * np.arange(256) / 256)
    a, b = (sum(c[k] * z[:, None] ** k for k in range(ORDER + 1)) for c in (A, B))
    spectrum = np.fft.fft(function(a, b) + 0 * a, axis=0) / 256
    return (spectrum[: ORDER + 1] / 0.5 ** np.arange(ORDER + 1)[:, None]).real


def coefficients(series, order=ORDER):
    return np.array(series.arrays(order, jnp.zeros(2)))


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b: a + b,
        lambda a, b: a - b,
        lambda a, b: a * b,
        lambda a, b: a * a,
        lambda a, b: a * a * a * b,
        lambda a, b: a / b,
        lambda a, b: -a,
        lambda a, b: a + 2.5,
        lambda a, b: 2.5 + a,
        lambda a, b: a - 2.5,
        lambda a, b: 2.5 - a,
        lambda a, b: a * 2.5,
        lambda a, b: 2.5 * a,
        lambda a, b: a / 2.5,
        lambda a, b: 2.5 / b,
        lambda a, b: a + LANE,
        lambda a, b: LANE + a,
        lambda a, b: a - LANE,
        lambda a, b: LANE - a,
        lambda a, b: LANE * a,
        lambda a, b: a / LANE,
        lambda a, b: LANE / b,
        lambda a, b: 1 / (1 + a * a),
        lambda a, b: (1 - a / 3 + a * a * a / 81) * (2 * b + 1) - a / b,
    ],
)
def test_arithmetic(function):
    expected = cauchy(function)
    np.testing.assert_allclose(coefficients(function(series(A), series(B))), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("function", "reference"),
    [
        (lambda a, b: elementary.exp(-2.0 * a * b), lambda a, b: np.exp(-2 * a * b)),
        (lambda a, b: elementary.exp(-0.02 / b), lambda a, b: np.exp(-0.02 / b)),
        (lambda a, b: elementary.arctan(0.3 * b) * elementary.exp(a), lambda a, b: np.arctan(0.3 * b) * np.exp(a)),
    ],
)
def test_composed_functions(function, reference):
    result = coefficients(function(series(A), series(B)))
    np.testing.assert_allclose(result, cauchy(reference), rtol=1e-9, atol=1e-12)


FUNCTION_ORDER = 5
INSIDE = [0.8, -0.3, 0.5, 0.2, -0.4, 0.1]
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


CIRCLE = 0.3 * np.exp(2j * np.pi * np.arange(128) / 128)


def cauchy_mean(function):
    """Return c_k of f(tau) = sum_k c_k tau^k as the mean of f(tau) tau^-k over a circle."""
    return [np.mean(function(CIRCLE) * CIRCLE**-k).real for k in range(FUNCTION_ORDER + 1)]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name):
    of_series, of_numbers = FUNCTIONS[name]
    lanes = [np.array(INSIDE), np.array([1.7, 0.4, 0.0, -0.3, 0.2, 0.1])]
    series = of_series(known([jnp.asarray([lane[k] for lane in lanes]) for k in range(FUNCTION_ORDER + 1)]))
    expected = [cauchy_mean(lambda tau, a=lane: of_numbers(np.polyval(a[::-1], tau))) for lane in lanes]
    actual = np.array([np.asarray(series[k]) for k in range(FUNCTION_ORDER + 1)]).T
    np.testing.assert_allclose(actual, expected, rtol=1e-11, atol=1e-12)


def test_functions_of_state_in_equation():
    """y' = tanh(y) has the solution sinh(y) = sinh(y0) e^t, and y' = sqrt(1 + y²) has y = sinh(t + arsinh y0)."""
    solutions = [
        (elementary.tanh, lambda t: np.arcsinh(np.sinh(0.3) * np.exp(t))),
        (lambda y: elementary.sqrt(1.0 + y * y), lambda t: np.sinh(t + np.arcsinh(0.3))),
    ]
    for rate, solution in solutions:
        [series] = expand(lambda state, rate=rate: (rate(state[0]),), (jnp.asarray([0.3]),), 1.0, FUNCTION_ORDER)
        np.testing.assert_allclose(
            [float(series[k][0]) for k in range(FUNCTION_ORDER + 1)], cauchy_mean(solution), atol=1e-12
        )


H = jnp.asarray([0.1, 0.7])


def test_expansion_of_oscillator():
    """x'' = -w² x has x = x0 cos wt + v0/w sin wt, so c_k(x) = h^k/k! times the k-th derivative at 0."""
    w, x0, v0 = np.array([3.0, 0.9]), np.array([0.2, -1.0]), np.array([-1.0, 0.4])
    field = lambda y: (y[1], jnp.asarray(-(w**2)) * y[0])  # noqa: E731
    expansions = expand(field, (jnp.asarray(x0), jnp.asarray(v0)), H, ORDER)
    derivatives = [x0, v0]
    for _ in range(ORDER):
        derivatives.append(-(w**2) * derivatives[-2])
    for i, expansion in enumerate(expansions):
        expected = [derivatives[k + i] * np.asarray(H) ** k / factorial(k) for k in range(ORDER + 1)]
        np.testing.assert_allclose(coefficients(expansion), expected, rtol=1e-12)


def test_expansion_of_logarithm():
    """y' = exp(-y) has y = ln(exp(y0) + t), c_k = -(-s)^k/k with s = h exp(-y0)."""
    y0 = np.array([0.8, -0.7])
    (expansion,) = expand(lambda y: (elementary.exp(-y[0]),), (jnp.asarray(y0),), H, ORDER)
    s = np.asarray(H) * np.exp(-y0)
    expected = [y0] + [-((-s) ** k) / k for k in range(1, ORDER + 1)]
    np.testing.assert_allclose(coefficients(expansion), expected, rtol=1e-12)


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
    derivative_values = jax.jit(lambda y: [derivative(y) for derivative in derivatives])(
        state
    )  # compiled together, because they have much in common
    for k, values in enumerate(derivative_values, 1):
        expected = np.array(values) * h**k / factorial(k)
        np.testing.assert_allclose([c[k] for c in expansions], expected, rtol=1e-9, atol=1e-13, err_msg=str(k))
