"""Polynomials in the scaled time tau of one step: values, slopes, integrals, maxima, and the root that ends a step."""

from collections.abc import Sequence
from functools import reduce
from typing import Any

from vibrojax.lazy import jax, jnp, lax
from vibrojax.physics.arrays import Array, Real, keep

Coefficients = Sequence[Array]
"""Coefficients of a polynomial in tau, each (lanes,), in ascending order from tau^0."""

ROOT_ITERATIONS = 5
"""Number of Newton iterations for the root that ends a step; the initial value is the root of a parabola."""


def value(coefficients: Sequence[Any], tau: Real) -> Any:
    """Return sum_k c_k tau^k by Horner's rule; the coefficients and tau have the same shape."""
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


def highest(coefficients: Coefficients, tau: Array) -> "jax.Array":
    """Return the greatest value between 0 and tau: at an end, or at a maximum in between.

    The maximum is found with two Newton iterations from the zero of a linear slope. For 2 rad of a sine wave, the
    maximum is exact to 1e-10 of its height.
    """
    rate = [k * c for k, c in enumerate(coefficients)][1:]
    start, end = rate[0], value(rate, tau)
    turns = (start > 0) & (end < 0)
    top = jnp.where(turns, tau * start / jnp.where(turns, start - end, 1), 0)
    for _ in range(2):
        better = keep(top - value(rate, top) / slope(rate, top))
        top = jnp.where(turns & (better > 0) & (better < tau), better, top)
    return jnp.maximum(jnp.maximum(coefficients[0], value(coefficients, tau)), value(coefficients, top))


def extremes(coefficients: Coefficients, tau: Array) -> "tuple[jax.Array, jax.Array]":
    """Return the least and the greatest value between 0 and tau, for a polynomial with at most one turning point there.

    The turning point is found as in `highest`.
    """
    rate = [k * c for k, c in enumerate(coefficients)][1:]
    start, end = rate[0], value(rate, tau)
    turns = start * end < 0
    top = jnp.where(turns, tau * start / jnp.where(turns, start - end, 1), 0)
    for _ in range(2):
        better = keep(top - value(rate, top) / slope(rate, top))
        top = jnp.where(turns & (better > 0) & (better < tau), better, top)
    values = keep((coefficients[0], value(coefficients, tau), value(coefficients, top)))
    return reduce(jnp.minimum, values), reduce(jnp.maximum, values)


def first_guess(start: Array, rate: Array, end: Array) -> "jax.Array":
    """Return the root r in (0, 1] of the parabola start + rate r + c r² whose value at r = 1 is `end`.

    For start >= 0 > end there is one such root in addition to a possible root at r = 0. Each of the two formulas is
    used where it avoids cancellation.
    """
    c = end - start - rate
    root = jnp.sqrt(jnp.maximum(rate * rate - 4 * c * start, 0))
    falls = rate <= 0
    guess = jnp.where(falls, 2 * start, rate + root) / jnp.where(falls, root - rate, -2 * c)
    guess = jnp.clip(guess, 0, 1)
    return jnp.where(jnp.isnan(guess), 0.5, guess)


def root(coefficients: Coefficients, zeros: Array, guess: Array, end: Array) -> "jax.Array":
    """Return the root in (0, end) of a polynomial that is positive before the root and negative at `end`.

    Newton's iteration stays inside a shrinking bracket. It is applied to the polynomial divided by tau^zeros, so that
    it does not converge to tau = 0 if the step starts on the guard (zeros = 1) or at a tangency to it (zeros = 2).

    **Arguments:** `coefficients`: list of (lanes,); `zeros`, `guess` (initial value of tau), `end`: (lanes,).

    **Returns:** tau (lanes,). Its derivative is that of the root of the polynomial G, d tau = -sum_k dc_k tau^k /
    G'(tau), not that of the iteration. Event times thus have the correct derivatives with respect to parameters.
    """
    differentiable: Any = jax.custom_jvp(_iterated_root)
    differentiable.defjvp(_root_jvp)
    zero: jax.Array = differentiable(coefficients, zeros, guess, end)
    return zero


def _iterated_root(coefficients: Coefficients, zeros: Array, guess: Array, end: Array) -> "jax.Array":
    def refine(_: Any, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        tau, low, high = carry
        y = value(coefficients, tau)
        inside = y > 0
        low, high = jnp.where(inside, tau, low), jnp.where(inside, high, tau)
        newton = tau - y / (slope(coefficients, tau) - zeros * y / tau)
        middle = (low + high) / 2
        # A converged root is an end of the bracket and is kept. A NaN (0/0) fails both comparisons, so that a bisection
        # step is taken.
        tau = jnp.where((newton >= low) & (newton <= high), newton, middle)
        return tau, low, high

    tau, _, _ = lax.fori_loop(0, ROOT_ITERATIONS, refine, (guess, jnp.zeros_like(end), end))
    return tau


def _root_jvp(primals: tuple, tangents: tuple) -> "tuple[jax.Array, jax.Array]":
    coefficients, zeros, guess, end = primals
    tau = root(coefficients, zeros, guess, end)
    rate = slope(coefficients, tau)
    moved = value(tangents[0], tau)
    return tau, jnp.where(rate == 0, 0.0, -moved / jnp.where(rate == 0, 1.0, rate))


def rough_root(x: Array, n: int) -> "jax.Array":
    """Return x^(1/n) for x > 0 times an error factor between 1 and 1.07.

    The result is a tiny number for 0, and a number above 1 for infinity and NaN. This accuracy suffices for step
    lengths, at a twentieth of the cost of a power. The bits of a float, interpreted as an integer, are a piecewise
    linear approximation of its logarithm.
    """
    x = lax.stop_gradient(x)
    bits = jnp.finfo(x.dtype)
    integer = jnp.dtype(f"int{bits.bits}")
    bits_of_one = jnp.asarray(1 - bits.minexp, integer) << bits.nmant
    # Floats are used because the division of integers is not vectorised.
    logarithm = (lax.bitcast_convert_type(x, integer) - bits_of_one).astype(x.dtype) * (1 / n)
    return lax.bitcast_convert_type(logarithm.astype(integer) + bits_of_one, x.dtype)
