"""Polynomials in the time of one step: values, slopes, integrals, maxima and the root that ends the step."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import custom_jvp, lax

from vibrojax.models.arrays import Array, Real, keep

Coefficients = Sequence[Array]
"""Coefficients of a polynomial in tau, from tau^0 on; each (lanes,)."""

ROOT_ITERATIONS = 5
"""Newton iterations for the root that ends a step; its first guess is that of a parabola."""


def value(coefficients: Sequence[Any], tau: Real) -> Any:
    """Return sum_k c_k tau^k by Horner's rule; coefficients and tau have one shape."""
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = total * tau + c
    return total


def slope(coefficients: Coefficients, tau: Real) -> Any:
    """Return the derivative of the polynomial with respect to tau."""
    return value([k * c for k, c in enumerate(coefficients)][1:], tau)


def integral(coefficients: Coefficients, tau: Real) -> Any:
    """Return the integral of the polynomial from 0 to tau."""
    return tau * value([c / (k + 1) for k, c in enumerate(coefficients)], tau)


def highest(coefficients: Coefficients, tau: Array) -> jax.Array:
    """Return the greatest value from 0 to tau: at an end, or where the slope falls through zero between them.

    Two Newton iterations start at the zero of a linear slope: of a wave of 2 rad they find 1e-10 of its height.
    """
    rate = [k * c for k, c in enumerate(coefficients)][1:]
    start, end = rate[0], value(rate, tau)
    turns = (start > 0) & (end < 0)
    top = jnp.where(turns, tau * start / jnp.where(turns, start - end, 1), 0)
    for _ in range(2):
        better = keep(top - value(rate, top) / slope(rate, top))
        top = jnp.where(turns & (better > 0) & (better < tau), better, top)
    return jnp.maximum(jnp.maximum(coefficients[0], value(coefficients, tau)), value(coefficients, top))


def first_guess(start: Array, rate: Array, end: Array) -> jax.Array:
    """Return the fraction r in (0, 1] at which the parabola start + rate r + c r², equal to `end` at 1, is zero.

    For start >= 0 > end there is one such root apart from a start on the guard; both forms avoid cancellation.
    """
    c = end - start - rate
    root = jnp.sqrt(jnp.maximum(rate * rate - 4 * c * start, 0))
    falls = rate <= 0
    guess = jnp.where(falls, 2 * start, rate + root) / jnp.where(falls, root - rate, -2 * c)
    guess = jnp.clip(guess, 0, 1)
    return jnp.where(jnp.isnan(guess), 0.5, guess)


@custom_jvp
def root(coefficients: Coefficients, zeros: Array, guess: Array, end: Array) -> jax.Array:
    """Return the root in (0, end) of a polynomial that falls from positive values to a negative one at `end`.

    Newton's iteration stays inside a shrinking bracket. It acts on the polynomial divided by tau^zeros, so that it does
    not return to a start on the guard (zeros = 1) or tangent to it (zeros = 2).

    **Arguments:** `coefficients` list of (lanes,); `zeros`, `guess`, `end` (lanes,).

    **Returns:** tau (lanes,). Its derivative is that of the root, d tau = -sum_k dc_k tau^k / G'(tau), not of the
    iteration, so that event times have the correct derivatives by parameters.
    """

    def refine(_: Any, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        tau, low, high = carry
        y = value(coefficients, tau)
        inside = y > 0
        low, high = jnp.where(inside, tau, low), jnp.where(inside, high, tau)
        newton = tau - y / (slope(coefficients, tau) - zeros * y / tau)
        middle = (low + high) / 2
        # A converged root is an end of the bracket and stays. A NaN (0/0) fails both tests: the bisection takes over.
        tau = jnp.where((newton >= low) & (newton <= high), newton, middle)
        return tau, low, high

    tau, _, _ = lax.fori_loop(0, ROOT_ITERATIONS, refine, (guess, jnp.zeros_like(end), end))
    return tau


@root.defjvp
def _root_jvp(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    coefficients, zeros, guess, end = primals
    tau = root(coefficients, zeros, guess, end)
    rate = slope(coefficients, tau)
    moved = value(tangents[0], tau)
    return tau, jnp.where(rate == 0, 0.0, -moved / jnp.where(rate == 0, 1.0, rate))


def rough_root(x: Array, n: int) -> jax.Array:
    """Return x^(1/n) for x > 0 to within a factor 1 to 1.07; a tiny number for 0, one above 1 for infinity and NaN.

    It serves step lengths, at a twentieth of a power's cost: a float's bits, read as an integer, are its logarithm,
    linear between powers of two.
    """
    x = lax.stop_gradient(x)
    bits = jnp.finfo(x.dtype)
    integer = jnp.dtype(f"int{bits.bits}")
    bits_of_one = jnp.asarray(1 - bits.minexp, integer) << bits.nmant
    # Floats divide faster: the division of integers is not vectorised.
    logarithm = (lax.bitcast_convert_type(x, integer) - bits_of_one).astype(x.dtype) * (1 / n)
    return lax.bitcast_convert_type(logarithm.astype(integer) + bits_of_one, x.dtype)
