"""Least squares with censored lanes: exact for linear forms, Levenberg–Marquardt for the others.

A censored lane was seen at zero rate. It has a residual only where the form predicts a rate above zero:

    S(theta) = sum over seen lanes of w (f − rate)²  +  sum over censored lanes of w max(f, 0)²

For f linear in theta S is convex and piecewise quadratic, and which censored lanes count says in which piece the
minimum lies. Newton's step solves a piece exactly, so the iteration over active sets ends after a few steps in the
exact minimum; halving the step where S would not fall keeps it from cycling (Sun 1997, "On piecewise quadratic Newton
and trust region problems"). Levenberg–Marquardt would come to the same point, but only up to its tolerance.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import optimistix
from jax import Array

MOST_PIECES = 60
MOST_STEPS = 400
TOLERANCE = 1e-6
POLISHING = 4
CONVERGED = 1e-8
_HALVINGS = 40
_ROUNDING = 1e-13


def residuals(predicted: Array, rate: Array, censored: Array) -> Array:
    """The residual of each lane; zero for a censored lane where no rate is predicted."""
    return jnp.where(censored, jnp.maximum(predicted, 0.0), predicted - rate)


def linear(columns: Array, rate: Array, weight: Array, censored: Array) -> tuple[Array, Array]:
    """The exact minimum of S for f = columns @ theta.

    **Arguments:** `columns`: (lanes, coefficients); `rate` (of order one), `weight` and `censored`: (lanes,).

    **Returns:** theta, and whether it is the minimum.
    """
    counts = weight > 0

    def loss(theta):
        return jnp.sum(weight * residuals(columns @ theta, rate, censored) ** 2)

    def active(theta):
        return counts & (~censored | (columns @ theta > 0))

    def solved(lanes):
        weighted = columns * jnp.where(lanes, weight, 0.0)[:, None]
        return jnp.linalg.solve(weighted.T @ columns, weighted.T @ rate)

    def step(state):
        theta, piece, count, _ = state
        newton = solved(piece)
        full = newton - theta
        lengths = 0.5 ** jnp.arange(_HALVINGS)
        best = lengths[jnp.argmin(jax.vmap(lambda length: loss(theta + length * full))(lengths))]
        # The first of equals is the full step, and with it theta is the piece's own minimum without rounding.
        moved = jnp.where(best == 1, newton, theta + best * full)
        found = active(moved)
        same = (best == 1) & jnp.all(found == piece)
        still = jnp.max(jnp.abs(full)) <= _ROUNDING * (1 + jnp.max(jnp.abs(theta)))
        return moved, found, count + 1, same | still | ~jnp.all(jnp.isfinite(newton))

    def unsolved(state):
        return ~state[3] & (state[2] < MOST_PIECES)

    start = solved(counts & ~censored)
    theta, _, _, done = jax.lax.while_loop(unsolved, step, (start, active(start), 0, jnp.asarray(False)))
    return theta, done & jnp.all(jnp.isfinite(theta))


def nonlinear(
    predict: Callable[[Array], Array], start: Array, rate: Array, weight: Array, censored: Array
) -> tuple[Array, Array]:
    """A minimum of S by Levenberg–Marquardt (optimistix) from `start`.

    At the minimum S changes by rounding alone while theta still moves by its root, so steps are accepted or not by
    chance there. The last digits are therefore those of Newton's steps, whose size says whether this is the minimum.

    **Returns:** theta, and whether it converged.
    """

    def weighted(theta, _=None):
        return jnp.sqrt(weight) * residuals(predict(theta), rate, censored)

    def loss(theta):
        return jnp.sum(weighted(theta) ** 2)

    def newton(theta):
        return -jnp.linalg.solve(jax.hessian(loss)(theta), jax.grad(loss)(theta))

    def polish(_, theta):
        moved = theta + newton(theta)
        return jnp.where(loss(moved) <= loss(theta) * (1 + _ROUNDING) + _ROUNDING**2, moved, theta)

    solver = optimistix.LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE)
    near = optimistix.least_squares(weighted, solver, start, max_steps=MOST_STEPS, throw=False).value
    theta = jax.lax.fori_loop(0, POLISHING, polish, near)
    return theta, jnp.max(jnp.abs(newton(theta)) / (1 + jnp.abs(theta))) <= CONVERGED
