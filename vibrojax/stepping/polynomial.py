"""Polynomials in the scaled time tau of one step: values, slopes, integrals, maxima, and the root that ends a step."""

from collections.abc import Sequence
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


INTERVALS, EXTREMUM_ITERATIONS = 6, 2
"""Intervals of a step between samples, and Newton iterations for the zero of the slope, from the best sample."""


def highest(coefficients: Coefficients, tau: Array) -> "jax.Array":
    """Return the greatest value between 0 and tau, at an end or at a maximum in between; see `extremes`."""
    return _highest(coefficients, tau, _samples(coefficients, tau))


def extremes(coefficients: Coefficients, tau: Array) -> "tuple[jax.Array, jax.Array]":
    """Return the least and the greatest value between 0 and tau.

    For 2 rad of a sine wave, the longest stride, on a ramp of any slope, errors are at most 2.5e-3 of the wave's
    amplitude. They are that large only where two turning points are close to each other: 99 % are below 1e-8.
    """
    samples = _samples(coefficients, tau)
    return -_highest([-c for c in coefficients], tau, [-x for x in samples]), _highest(coefficients, tau, samples)


def _samples(coefficients: Coefficients, tau: Array) -> list[Array]:
    return [coefficients[0], *(value(coefficients, tau * (k / INTERVALS)) for k in range(1, INTERVALS + 1))]


def _highest(coefficients: Coefficients, tau: Array, samples: list[Array]) -> "jax.Array":
    best, top = samples[0], jnp.zeros_like(tau)
    for k, sample in enumerate(samples[1:], start=1):
        above = sample > best
        best, top = jnp.where(above, sample, best), jnp.where(above, tau * (k / INTERVALS), top)
    rate = [k * c for k, c in enumerate(coefficients)][1:]
    for _ in range(EXTREMUM_ITERATIONS):
        better = keep(top - value(rate, top) / slope(rate, top))
        top = jnp.where((better > 0) & (better < tau), better, top)
    return jnp.maximum(best, value(coefficients, top))


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

    **Arguments:** `coefficients`: list of (lanes,); `zeros`, `guess` (initial value of tau; 0 for the root at 0),
    `end`: (lanes,).

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
    return jnp.where(guess > 0, tau, 0.0)


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
