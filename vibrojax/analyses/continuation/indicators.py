"""What passes zero along a family where its stability changes: at folds, period doublings and tori."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex, Float

from vibrojax.analyses.continuation.problem import At, Flags, PerLane, Unknowns
from vibrojax.io.derived import SPECIAL_KINDS

KINDS = SPECIAL_KINDS
"""Kinds of special points, in the order of their flags."""

CLOSE = 1e-3
"""Distance from where it belongs within which the multiplier of a located point must be. Where events begin or vanish
multipliers may jump over it, which is a point of another kind."""

Multipliers = Complex[np.ndarray, "lanes states"]


def multipliers(product: Float[np.ndarray, "lanes states states"]) -> Multipliers:
    """The eigenvalues, by falling modulus."""
    sound = np.isfinite(product).all(axis=(1, 2))
    values = np.linalg.eigvals(np.where(sound[:, None, None], product, 0.0)).astype(complex)
    values[~sound] = np.nan
    return np.take_along_axis(values, np.argsort(-np.abs(values), axis=1, kind="stable"), axis=1)


def spectral_radius(product: Float[np.ndarray, "lanes states states"]) -> PerLane:
    """The greatest modulus of a multiplier."""
    return np.abs(multipliers(product)[:, 0])


def _fold(at: At, tangent: Unknowns) -> PerLane:
    """The tangent's part along the parameter."""
    return tangent[:, -1]


def _doubling(at: At, tangent: Unknowns) -> PerLane:
    """det(M + 1)."""
    return np.linalg.det(at.product + np.eye(at.product.shape[1]))


def _torus(at: At, tangent: Unknowns) -> PerLane:
    """The product of mu_i mu_j - 1 over all pairs (Kuznetsov, *Elements of Applied Bifurcation Theory*, 10.2)."""
    values = multipliers(at.product)
    first, second = np.triu_indices(values.shape[1], 1)
    return np.prod(values[:, first] * values[:, second] - 1, axis=1).real


INDICATORS: dict[str, Callable[[At, Unknowns], PerLane]] = {
    "fold": _fold,
    "period-doubling": _doubling,
    "torus": _torus,
}
"""By kind: what vanishes there; (lanes,) of the equations at a point and the tangent."""


def holds(kind: str, product: Float[np.ndarray, "lanes states states"]) -> Flags:
    """Whether there is a multiplier where those of a located point of that kind have one (lanes,)."""
    values = multipliers(product)
    if kind == "fold":
        return np.abs(values - 1).min(axis=1) < CLOSE
    if kind == "period-doubling":
        return np.abs(values + 1).min(axis=1) < CLOSE
    pair = (np.abs(values.imag) > CLOSE) & (np.abs(np.abs(values) - 1) < CLOSE)
    return pair.any(axis=1)
