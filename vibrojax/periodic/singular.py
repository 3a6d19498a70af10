"""Signed singular values, and second compound matrices, of many lanes, with their derivatives."""

from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.newton import PerLane, chain


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
