"""Least squares of rates, with censored lanes and with losses for data with outliers.

A censored lane was seen at zero rate. It has a residual only where the form predicts a rate above zero:

    S(theta) = sum over seen lanes of w (f − rate)²  +  sum over censored lanes of w max(f, 0)²

For f linear in theta S is convex and piecewise quadratic, and which censored lanes count says in which piece the
minimum lies. Newton's step solves a piece exactly, so the iteration over active sets ends after a few steps in the
exact minimum; halving the step where S would not fall keeps it from cycling (Sun 1997, "On piecewise quadratic Newton
and trust region problems"). Levenberg–Marquardt would come to the same point, but only up to its tolerance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optimistix
from jaxtyping import Bool, Float, Int

from vibrojax.models.arrays import Array

Theta = Float[Array, " coefficients"]
LaneValues = Float[Array, " lanes"]
LaneFlags = Bool[Array, " lanes"]
Number = Float[Array, ""]
Flag = Bool[Array, ""]
Count = Int[Array, ""]

MOST_PIECES = 60
MOST_STEPS = 400
TOLERANCE = 1e-6
POLISHING = 4
CONVERGED = 1e-8
_HALVINGS = 40
_ROUNDING = 1e-13

HUBER = 1.345  # 95 % as efficient as least squares where the noise is normal
NORMAL = 1.4826  # standard deviation of normal noise over its median absolute deviation
_SCALINGS = 15
_MOST_WEIGHTINGS = 300
_STILL = 1e-8
_LEAST_SCALE = 1e-12  # of the greatest rate: where most lanes are met exactly


class Minimum(NamedTuple):
    """Where a search ended, (coefficients,), and whether that is a minimum."""

    theta: Theta
    converged: Flag


def residuals(predicted: LaneValues, rate: LaneValues, censored: LaneFlags) -> LaneValues:
    """The residual of each lane; zero for a censored lane where no rate is predicted."""
    return jnp.where(censored, jnp.maximum(predicted, 0.0), predicted - rate)


class _Piece(NamedTuple):
    """An iteration over the pieces of S: theta, the lanes that count there, rounds so far, whether it has ended."""

    theta: Theta
    lanes: LaneFlags
    rounds: Count | int
    done: Flag


def linear(
    columns: Float[Array, "lanes coefficients"], rate: LaneValues, weight: LaneValues, censored: LaneFlags
) -> Minimum:
    """The exact minimum of S for f = columns @ theta; `rate` is of order one."""
    weighted_lanes = weight > 0

    def loss(theta: Theta) -> Number:
        return jnp.sum(weight * residuals(columns @ theta, rate, censored) ** 2)

    def counting(theta: Theta) -> LaneFlags:
        return weighted_lanes & (~censored | (columns @ theta > 0))

    def solution(lanes: LaneFlags) -> Theta:
        weighted = columns * jnp.where(lanes, weight, 0.0)[:, None]
        return jnp.linalg.solve(weighted.T @ columns, weighted.T @ rate)

    def step(piece: _Piece) -> _Piece:
        newton = solution(piece.lanes)
        full = newton - piece.theta
        lengths = 0.5 ** jnp.arange(_HALVINGS)
        best = lengths[jnp.argmin(jax.vmap(lambda length: loss(piece.theta + length * full))(lengths))]
        # The first of equals is the full step, and with it theta is the piece's own minimum without rounding.
        moved = jnp.where(best == 1, newton, piece.theta + best * full)
        lanes = counting(moved)
        same = (best == 1) & jnp.all(lanes == piece.lanes)
        still = jnp.max(jnp.abs(full)) <= _ROUNDING * (1 + jnp.max(jnp.abs(piece.theta)))
        return _Piece(moved, lanes, piece.rounds + 1, same | still | ~jnp.all(jnp.isfinite(newton)))

    def goes_on(piece: _Piece) -> Flag:
        return ~piece.done & (piece.rounds < MOST_PIECES)

    start = solution(weighted_lanes & ~censored)
    end = jax.lax.while_loop(goes_on, step, _Piece(start, counting(start), 0, jnp.asarray(False)))
    return Minimum(end.theta, end.done & jnp.all(jnp.isfinite(end.theta)))


def nonlinear(
    predict: Callable[[Theta], LaneValues], start: Theta, rate: LaneValues, weight: LaneValues, censored: LaneFlags
) -> Minimum:
    """A minimum of S by Levenberg–Marquardt (optimistix) from `start`.

    At the minimum S changes by rounding alone while theta still moves by its root, so steps are accepted or not by
    chance there. The final digits are therefore those of Newton's steps, whose size says whether this is the minimum.
    """

    def weighted(theta: Theta, _: object = None) -> LaneValues:
        return jnp.sqrt(weight) * residuals(predict(theta), rate, censored)

    def loss(theta: Theta) -> Number:
        return jnp.sum(weighted(theta) ** 2)

    def newton(theta: Theta) -> Theta:
        return -jnp.linalg.solve(jax.hessian(loss)(theta), jax.grad(loss)(theta))

    def polish(_: Count, theta: Theta) -> Theta:
        moved = theta + newton(theta)
        return jnp.where(loss(moved) <= loss(theta) * (1 + _ROUNDING) + _ROUNDING**2, moved, theta)

    near = levenberg_marquardt(weighted, start, TOLERANCE, MOST_STEPS)
    theta = jax.lax.fori_loop(0, POLISHING, polish, near)
    return Minimum(theta, jnp.max(jnp.abs(newton(theta)) / (1 + jnp.abs(theta))) <= CONVERGED)


def levenberg_marquardt(
    residual: Callable[[Theta, object], LaneValues], start: Theta, tolerance: float, most_steps: int
) -> Theta:
    """Where a search for the least sum of squares from `start` ends, at its minimum or not."""
    solver: optimistix.LevenbergMarquardt = optimistix.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    solution: optimistix.Solution = optimistix.least_squares(residual, solver, start, max_steps=most_steps, throw=False)
    return solution.value


@dataclass(frozen=True)
class Loss:
    """A loss rho(z) of z = residual/scale by its weight rho'(z)/(2 z), and the slope of z times that weight."""

    weight: Callable[[Array], Array]
    slope: Callable[[Array], Array]


LOSSES = {
    "huber": Loss(
        lambda z: jnp.minimum(1.0, HUBER / jnp.maximum(jnp.abs(z), HUBER)),
        lambda z: jnp.where(jnp.abs(z) <= HUBER, 1.0, 0.0),
    ),
    "soft-l1": Loss(lambda z: (1 + z**2) ** -0.5, lambda z: (1 + z**2) ** -1.5),
}
"""Losses that outliers cannot dominate."""


class _Weighting(NamedTuple):
    """A round of reweighting: theta, the scale of its weights, rounds so far, what ended the solve and the rounds."""

    theta: Theta
    scale: Number
    rounds: Count | int
    converged: Flag
    still: Flag


def reweighted(
    loss: Loss,
    solve: Callable[[LaneValues, Theta], Minimum],
    residual: Callable[[Theta], tuple[LaneValues, LaneFlags]],
    first: Theta,
    valid: LaneFlags,
) -> tuple[Minimum, Number]:
    """The minimum of the loss, by weights that follow the residuals (iteratively reweighted least squares).

    The scale follows the residuals for some rounds and is constant then, so that what is minimised stays the same.

    **Arguments:**

    - `solve`: from weights and a start to the minimum.
    - `residual`: from theta to residuals, and which lanes have one.
    - `first`: theta by least squares.
    - `valid`: the lanes that are used.

    **Returns:** the minimum and the scale, the residuals' standard deviation by their median absolute deviation.
    """

    def step(before: _Weighting) -> _Weighting:
        values, lanes = residual(before.theta)
        measured = jnp.maximum(NORMAL * jnp.nanmedian(jnp.where(lanes, jnp.abs(values), jnp.nan)), _LEAST_SCALE)
        scale = jnp.where(before.rounds < _SCALINGS, measured, before.scale)
        moved, converged = solve(jnp.where(valid, loss.weight(values / scale), 0.0), before.theta)
        change = jnp.max(jnp.abs(moved - before.theta)) / (1 + jnp.max(jnp.abs(before.theta)))
        still = (change <= _STILL) & (before.rounds >= _SCALINGS)
        return _Weighting(moved, scale, before.rounds + 1, converged, still)

    def goes_on(before: _Weighting) -> Flag:
        return ~before.still & (before.rounds < _MOST_WEIGHTINGS) & jnp.all(jnp.isfinite(before.theta))

    no = jnp.asarray(False)
    end = jax.lax.while_loop(goes_on, step, _Weighting(first, jnp.ones(()), 0, no, no))
    return Minimum(end.theta, end.converged & end.still), end.scale
