"""Test functions along families, which change sign at folds, period doublings and torus bifurcations."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from vibrojax.analyses.continuation.problem import Evaluation, Flags, PerLane, Unknowns
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.newton import multipliers

KINDS = SPECIAL_KINDS
"""Kinds of special points, in the order of their flag values."""

CRITICAL_DISTANCE = 1e-3
"""Largest distance of a located point's multiplier from its critical value. Where events begin or vanish, multipliers
may jump over the critical value; such a point has another kind."""


def spectral_radius(product: Float[np.ndarray, "lanes states states"]) -> PerLane:
    """Return the greatest modulus of each lane's multipliers."""
    return np.abs(multipliers(product)[:, 0])


def _torus(evaluation: Evaluation, _: Unknowns) -> PerLane:
    """Return the product of mu_i mu_j - 1 over all pairs of multipliers.

    See Kuznetsov, *Elements of Applied Bifurcation Theory*, section 10.2.
    """
    values = multipliers(evaluation.product)
    first, second = np.triu_indices(values.shape[1], 1)
    return np.prod(values[:, first] * values[:, second] - 1, axis=1).real


TEST_FUNCTIONS: dict[str, Callable[[Evaluation, Unknowns], PerLane]] = {
    "fold": lambda _, tangent: tangent[:, -1],
    "period-doubling": lambda now, _: np.linalg.det(now.product + np.eye(now.product.shape[1])),
    "torus": _torus,
}
"""Test functions by kind: the tangent's component along the parameter; det(M + 1), where M is the derivative of the
map over one period of the motion; and `_torus`."""


def is_critical(kind: Int[np.ndarray, " lanes"], product: Float[np.ndarray, "lanes states states"]) -> Flags:
    """Return a mask of lanes with a multiplier near the critical value of their `kind` (a flag)."""
    values = multipliers(product)
    fold, doubling = (np.abs(values - critical).min(axis=1) < CRITICAL_DISTANCE for critical in (1, -1))
    on_circle = np.abs(np.abs(values) - 1) < CRITICAL_DISTANCE
    torus = ((np.abs(values.imag) > CRITICAL_DISTANCE) & on_circle).any(axis=1)
    names = ("fold", "period-doubling", "torus")
    return np.select([kind == KINDS.index(name) for name in names], [fold, doubling, torus], False)
