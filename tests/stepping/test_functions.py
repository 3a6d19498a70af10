"""Taylor series of the elementary functions against Cauchy's integral of the function itself."""

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.models.physics import elementary
from vibrojax.stepping.series import expand, known

ORDER = 5
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


def coefficients(function):
    """c_k of f(tau) = sum_k c_k tau^k, by its mean over a circle of f(tau) tau^-k."""
    return [np.mean(function(CIRCLE) * CIRCLE**-k).real for k in range(ORDER + 1)]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_series(name):
    of_series, of_numbers = FUNCTIONS[name]
    lanes = [np.array(INSIDE), np.array([1.7, 0.4, 0.0, -0.3, 0.2, 0.1])]
    series = of_series(known([jnp.asarray([lane[k] for lane in lanes]) for k in range(ORDER + 1)]))
    expected = [coefficients(lambda tau, a=lane: of_numbers(np.polyval(a[::-1], tau))) for lane in lanes]
    found = np.array([np.asarray(series[k]) for k in range(ORDER + 1)]).T
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numbers(name):
    of_series, of_numbers = FUNCTIONS[name]
    at = jnp.linspace(0.1, 3.0, 7)
    np.testing.assert_allclose(of_series(at), of_numbers(np.asarray(at)), rtol=1e-14)


def test_functions_of_a_state_in_an_equation():
    """y' = tanh(y) has sinh(y) = sinh(y0) e^t, and y' = sqrt(1 + y²) has y = sinh(t + arsinh y0)."""
    solutions = [
        (elementary.tanh, lambda t: np.arcsinh(np.sinh(0.3) * np.exp(t))),
        (lambda y: elementary.sqrt(1.0 + y * y), lambda t: np.sinh(t + np.arcsinh(0.3))),
    ]
    for rate, solution in solutions:
        [series] = expand(lambda state, rate=rate: (rate(state[0]),), (jnp.asarray([0.3]),), 1.0, ORDER)
        np.testing.assert_allclose([float(series[k][0]) for k in range(ORDER + 1)], coefficients(solution), atol=1e-12)
