"""Losses that outliers cannot dominate, by weights that follow the residuals (iteratively reweighted least squares)."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

HUBER = 1.345  # 95 % as efficient as least squares where the noise is normal
NORMAL = 1.4826  # standard deviation of normal noise over its median absolute deviation
_SCALINGS = 15
_MOST = 300
_STILL = 1e-8
_LEAST_SCALE = 1e-12  # of the greatest rate: where most lanes are met exactly


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


def scale_of(residual: Array, lanes: Array) -> Array:
    """Standard deviation of the residuals of `lanes`, by their median absolute deviation."""
    return jnp.maximum(NORMAL * jnp.nanmedian(jnp.where(lanes, jnp.abs(residual), jnp.nan)), _LEAST_SCALE)


def reweighted(
    loss: Loss,
    solve: Callable[[Array, Array], tuple[Array, Array]],
    residual: Callable[[Array], tuple[Array, Array]],
    first: Array,
    valid: Array,
) -> tuple[Array, Array, Array]:
    """The minimum of the loss.

    The scale follows the residuals for some rounds and is then held, so that what is minimised stays the same.

    **Arguments:**

    - `solve`: from weights and a start to theta, and whether that converged.
    - `residual`: from theta to residuals, and which lanes have one.
    - `first`: theta by least squares.
    - `valid`: the lanes that are used.

    **Returns:** theta, scale, and whether it converged.
    """

    def step(state):
        theta, scale, count, _, _ = state
        found, lanes = residual(theta)
        scale = jnp.where(count < _SCALINGS, scale_of(found, lanes), scale)
        moved, converged = solve(jnp.where(valid, loss.weight(found / scale), 0.0), theta)
        change = jnp.max(jnp.abs(moved - theta)) / (1 + jnp.max(jnp.abs(theta)))
        still = (change <= _STILL) & (count >= _SCALINGS)
        return moved, scale, count + 1, converged, still

    def moving(state):
        return ~state[4] & (state[2] < _MOST) & jnp.all(jnp.isfinite(state[0]))

    no = jnp.asarray(False)
    theta, scale, _, converged, still = jax.lax.while_loop(moving, step, (first, jnp.ones(()), 0, no, no))
    return theta, scale, converged & still
