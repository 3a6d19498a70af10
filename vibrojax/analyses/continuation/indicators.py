"""Test functions of families: they pass zero at folds, period doublings and tori."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.continuation.problem import Evaluation, Flags, PerLane, Unknowns
from vibrojax.io.derived import SPECIAL_KINDS
from vibrojax.periodic.newton import multipliers

KINDS = SPECIAL_KINDS
"""Kinds of special points, in the order of their flags."""

CRITICAL_DISTANCE = 1e-3
"""Largest distance of a located point's multiplier from its critical value. Where events begin or vanish, multipliers
may jump over that value; such a point is of another kind."""


def spectral_radius(product: Float[np.ndarray, "lanes states states"]) -> PerLane:
    """Return the greatest modulus of a multiplier."""
    return np.abs(multipliers(product)[:, 0])


def _fold(evaluation: Evaluation, tangent: Unknowns) -> PerLane:
    """Return the tangent's component along the parameter."""
    return tangent[:, -1]


def _period_doubling(evaluation: Evaluation, tangent: Unknowns) -> PerLane:
    """Return det(M + 1) of the repeat's derivative M."""
    return np.linalg.det(evaluation.product + np.eye(evaluation.product.shape[1]))


def _torus(evaluation: Evaluation, tangent: Unknowns) -> PerLane:
    """Return the product of mu_i mu_j - 1 over pairs (Kuznetsov, *Elements of Applied Bifurcation Theory*, 10.2)."""
    values = multipliers(evaluation.product)
    first, second = np.triu_indices(values.shape[1], 1)
    return np.prod(values[:, first] * values[:, second] - 1, axis=1).real


TEST_FUNCTIONS: dict[str, Callable[[Evaluation, Unknowns], PerLane]] = {
    "fold": _fold,
    "period-doubling": _period_doubling,
    "torus": _torus,
}
"""By kind, as functions of the evaluated equations and the tangent, (lanes,)."""


def is_critical(kind: str, product: Float[np.ndarray, "lanes states states"]) -> Flags:
    """Return which lanes have a multiplier near the critical value of `kind`."""
    values = multipliers(product)
    if kind == "fold":
        return np.abs(values - 1).min(axis=1) < CRITICAL_DISTANCE
    if kind == "period-doubling":
        return np.abs(values + 1).min(axis=1) < CRITICAL_DISTANCE
    on_circle = np.abs(np.abs(values) - 1) < CRITICAL_DISTANCE
    return ((np.abs(values.imag) > CRITICAL_DISTANCE) & on_circle).any(axis=1)
