"""The conditions at an optimum: which limits bind, and what relaxing each would bring (Lagrange multipliers)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import nnls

from vibrojax.analyses.design.search import Candidate, linear_model
from vibrojax.analyses.design.spec import DesignSpec

BINDING_SLACK = 3e-3
"""Slack, relative to the limit, up to which a constraint binds."""

BINDING_BOUND = 1e-3
"""Distance from a bound of a varied parameter, relative to its range, up to which the bound binds."""


class Conditions(NamedTuple):
    """The first-order conditions at a candidate, along the limits of `limit_names`.

    - `slack`: distance to the limit in its own unit; `binds`: whether the limit binds.
    - `relaxation`: gain of the objective per unit by which the limit is relaxed.
    - `unexplained`: share of the objective's gradient that no limit balances: there, the border of a regime or of a
      basin binds. NaN without derivatives.
    """

    slack: Float[np.ndarray, " limits"]
    binds: Bool[np.ndarray, " limits"]
    relaxation: Float[np.ndarray, " limits"]
    unexplained: float


def limit_names(spec: DesignSpec) -> list[str]:
    """Return the names of all limits: constraints, then the bounds of the varied parameters."""
    bounds = [f"{name} {end}" for name in spec.varied for end in ("least", "most")]
    return [f"{c.variable} {c.end}" for c in spec.constraints] + bounds


def limit_values(spec: DesignSpec) -> list[float]:
    """Return the values of all limits, in the order of their names."""
    bounds = [float(end) for pair in zip(spec.low, spec.high, strict=True) for end in pair]
    return [c.limit for c in spec.constraints] + bounds


def conditions(spec: DesignSpec, candidate: Candidate) -> Conditions:
    """Return the conditions at a candidate, by non-negative least squares of the stationarity equations."""
    found, x = candidate.assessment, candidate.point
    assert found is not None
    number, count = len(candidate.constraints), len(x)
    ranges = spec.high - spec.low
    slack = [
        float(found.slack[j, np.isfinite(found.slack[j])].min(initial=np.inf)) * c.scale + c.margin
        for j, c in enumerate(candidate.constraints)
    ]
    slack += [float(d) for pair in zip(x * ranges, (1 - x) * ranges, strict=True) for d in pair]
    binds = np.zeros(len(slack), bool)
    relaxation = np.zeros(len(slack))
    candidate.cuts = []
    model = linear_model(candidate, spec.maximise) if candidate.slopes is not None else None
    if model is None:
        return Conditions(np.array(slack), binds, np.full(len(slack), np.nan), np.nan)
    gradient = model.objective_slope[0] * (abs(found.objective) or 1.0)
    columns, limits, units = [], [], []
    for row, j in enumerate(model.rows):
        if model.slack[row] <= BINDING_SLACK:
            columns.append(-model.slack_slope[row])
            limits.append(j)
            units.append(candidate.constraints[j].scale)
    for k in range(count):
        for end, distance, sign in ((0, x[k], -1.0), (1, 1 - x[k], 1.0)):
            if distance <= BINDING_BOUND:
                columns.append(sign * np.eye(count)[k])
                limits.append(number + 2 * k + end)
                units.append(float(ranges[k]))
    weights, rest = nnls(np.array(columns).T, gradient) if columns else (np.zeros(0), float(np.linalg.norm(gradient)))
    for weight, limit, unit in zip(weights, limits, units, strict=True):
        relaxation[limit] += weight / unit
        binds[limit] |= weight > 0
    size = float(np.linalg.norm(gradient))
    return Conditions(np.array(slack), binds, relaxation, rest / size if size else 0.0)
