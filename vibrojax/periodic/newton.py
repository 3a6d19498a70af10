"""Newton's method of periodic orbits: multiple shooting, multipliers, and steps that stay on their branch."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact

from vibrojax.lazy import jax

PerLane = Float[np.ndarray, " lanes"]
States = Float[np.ndarray, "lanes cycles states"]
Scales = Float[np.ndarray, "lanes states"]

SAME_BRANCH = 5e-3
"""Largest scaled difference between a step along a branch and the trapezoidal rule, with the slopes at both ends. It is
of third order in the step. A larger one shows that the step has led to another branch, or that it is too long."""


def multipliers(product: Float[np.ndarray, "lanes states states"]) -> Complex[np.ndarray, "lanes states"]:
    """Return the eigenvalues in order of decreasing modulus; NaN where the derivative is not finite."""
    sound = np.isfinite(product).all(axis=(1, 2))
    values = np.linalg.eigvals(np.where(sound[:, None, None], product, 0.0)).astype(complex)
    values[~sound] = np.nan
    return np.take_along_axis(values, np.argsort(-np.abs(values), axis=1, kind="stable"), axis=1)


def held_states(jacobian: Float[np.ndarray, "... states states"]) -> Bool[np.ndarray, "... states"]:
    """Return a mask of the states that a map holds, such as the position of a body that sticks for good."""
    return np.all(jacobian == np.eye(jacobian.shape[-1]), axis=-1)


def spectral_radius(product: Float[np.ndarray, "lanes states states"]) -> PerLane:
    """Return the greatest modulus of each lane's multipliers; NaN where the derivative is not finite."""
    return np.abs(multipliers(product)[:, 0])


def solve(
    matrix: Inexact[np.ndarray, "lanes n n"], right: Inexact[np.ndarray, "lanes n columns"]
) -> Inexact[np.ndarray, "lanes n columns"]:
    """Solve matrix x = `right` in each lane; x is NaN where the matrix is singular, for example at a fold."""
    sound = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=(1, 2))
    matrix = np.where(sound[:, None, None], matrix, np.eye(matrix.shape[1]))
    # For a single singular matrix, NumPy would raise for the whole batch.
    sound &= np.linalg.slogdet(matrix)[0] != 0
    matrix = np.where(sound[:, None, None], matrix, np.eye(matrix.shape[1]))
    return np.where(sound[:, None, None], np.linalg.solve(matrix, right), np.nan)


def images_by_lane(mapped: tuple[Any, ...], lanes: int, cycles: int) -> Any:
    """Return a copy of `mapped` with arrays of shape (lanes, cycles, ...) instead of (..., segments)."""
    return jax.tree.map(lambda x: np.moveaxis(np.array(x), -1, 0).reshape(lanes, cycles, *np.shape(x)[:-1]), mapped)


def shooting_matrix(
    jacobian: Float[np.ndarray, "lanes cycles states states"],
) -> Float[np.ndarray, "lanes equations equations"]:
    """Return the block-cyclic matrix of multiple shooting."""
    lanes, cycles, rows, _ = jacobian.shape
    blocks = np.zeros((lanes, cycles, rows, cycles, rows))
    for k in range(cycles):
        blocks[:, k, :, k] += jacobian[:, k]
        blocks[:, k, :, (k + 1) % cycles] -= np.eye(rows)
    return blocks.reshape(lanes, cycles * rows, cycles * rows)


def residual_of(states: States, images: Any, scales: Scales) -> PerLane:
    """Return the greatest scaled difference between an image and the next state; infinite if a lane did not return."""
    off = np.abs(images.state - np.roll(states, -1, axis=1)) / scales[:, None]
    residual = np.where(images.seen.returned.all(axis=1), off.max(axis=(1, 2)), np.inf)
    return np.where(np.isnan(residual), np.inf, residual)


def distance_of(states: States, begin: States, scales: Scales) -> PerLane:
    """Return the greatest scaled difference between the states and those at the beginning."""
    return np.max(np.abs(states - begin) / scales[:, None], axis=(1, 2))


def newton_step(states: States, images: Any, scales: Scales) -> States:
    """Return the Newton steps, computed in scaled unknowns; NaN where the matrix is singular.

    A state that the map holds keeps its value: every value belongs to an orbit, so the matrix would be singular.
    """
    lanes, cycles, rows = states.shape
    jacobian = images.jacobian * scales[:, None, None, :] / scales[:, None, :, None]
    off = (np.roll(states, -1, axis=1) - images.state) / scales[:, None]
    matrix, off = shooting_matrix(jacobian), off.reshape(lanes, cycles * rows, 1)
    lane, held = np.nonzero(held_states(images.jacobian).all(axis=1))
    last = (cycles - 1) * rows + held
    matrix[lane, last], off[lane, last] = 0.0, 0.0
    matrix[lane, last, held] = 1.0
    step = solve(matrix, off)
    return step.reshape(states.shape) * scales[:, None]


def chain(jacobian: Float[np.ndarray, "lanes cycles states states"]) -> Float[np.ndarray, "lanes states states"]:
    """Return the derivative of the map over one period of the motion, the product of the segments' derivatives."""
    product = jacobian[:, 0]
    for k in range(1, jacobian.shape[1]):
        product = jacobian[:, k] @ product
    return product


def branch_determinant(product: Float[np.ndarray, "lanes states states"]) -> PerLane:
    """Return det(I - A), where A is the derivative of the map over one period; zero where branches meet."""
    return np.asarray(np.linalg.det(np.eye(product.shape[1]) - product))


def same_branch(
    off: States, d: tuple[PerLane, PerLane], trends: tuple[PerLane, PerLane], jumps: Bool[np.ndarray, " lanes"]
) -> Bool[np.ndarray, " lanes"]:
    """Return which steps from one orbit to another stay on their branch; NaN slopes are refused.

    States must follow the trapezoidal rule, within `SAME_BRANCH`. Next to a point at which branches meet, the branches
    differ by less than that. There d = det(I - A) distinguishes them. It varies linearly on the branches that cross at
    d = 0, with another slope on each, so the tangents at both ends must predict the other end's d to within its size.
    For a step from one branch to another, the error of this prediction is at least 3/2 of the greater |d| at a
    pitchfork, and twice that at a transcritical point. At a fold, |d| is a square root, whose slope is infinite. Where
    an event begins or vanishes d may jump, and the branch goes on if its sign is the same (Feigin's condition; di
    Bernardo et al., *Piecewise-smooth Dynamical Systems*, section 3.1).

    **Arguments:** `off`: scaled distances of the states from the trapezoidal rule; `d`, `trends`: d at both ends, and
    its slopes there times the step; `jumps`: mask of steps in which an impact passes the section, so that states jump.
    """
    change, size = d[1] - d[0], np.maximum(np.abs(d[0]), np.abs(d[1]))
    smooth = (np.abs(change - trends[0]) <= size) & (np.abs(change - trends[1]) <= size)
    return np.asarray(smooth & ((off.max(axis=(1, 2)) <= SAME_BRANCH) | jumps & np.isfinite(off).all(axis=(1, 2))))


def signed_singular(matrix: Float[np.ndarray, "lanes n n"]) -> tuple[PerLane, np.ndarray, np.ndarray]:
    """Return the smallest singular value of each matrix with the sign of the determinant, and its vectors w and v.

    The vectors satisfy w A v = value. All are NaN for a matrix that is not finite.
    """
    sound = np.isfinite(matrix).all(axis=(1, 2))
    matrix = np.where(sound[:, None, None], matrix, 0.0)
    w, values, v = np.linalg.svd(matrix)
    sign = np.where(np.linalg.slogdet(matrix)[0] < 0, -1.0, 1.0)
    sign[~sound] = np.nan
    return sign * values[:, -1], sign[:, None] * w[:, :, -1], v[:, -1]


def compound(product: Float[np.ndarray, "lanes n n"]) -> Float[np.ndarray, "lanes pairs pairs"]:
    """Return the second compound matrix of each matrix: its minors of order two."""
    i, j = np.triu_indices(product.shape[1], 1)
    first, second = product[:, i][:, :, i] * product[:, j][:, :, j], product[:, i][:, :, j] * product[:, j][:, :, i]
    return np.asarray(first - second)


def compound_along(product: np.ndarray, slopes: np.ndarray) -> Float[np.ndarray, "lanes directions pairs pairs"]:
    """Return the derivatives of the matrix's second compound. `slopes`: its own (lanes, directions, n, n)."""
    i, j = np.triu_indices(product.shape[1], 1)

    def part(a: np.ndarray, rows: Any, columns: Any) -> np.ndarray:
        return np.asarray(a[..., rows, :][..., columns])

    m = product[:, None]
    total = part(slopes, i, i) * part(m, j, j) + part(m, i, i) * part(slopes, j, j)
    return np.asarray(total - part(slopes, i, j) * part(m, j, i) - part(m, i, j) * part(slopes, j, i))


def segment_product(jacobian: np.ndarray, first: int, end: int) -> np.ndarray:
    """Return the product of the derivatives of segments `first` (inclusive) to `end` (exclusive)."""
    if end <= first:
        return np.broadcast_to(np.eye(jacobian.shape[-1]), jacobian[:, 0].shape)
    return chain(jacobian[:, first:end])
