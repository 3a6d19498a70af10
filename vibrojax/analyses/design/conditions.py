"""The conditions at an optimum: which limits bind, and what relaxing each would bring (Lagrange multipliers)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import nnls

from vibrojax.analyses.design.evaluation import Assessment, Unit, distinct_starts
from vibrojax.analyses.design.slopes import Slopes
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


def conditions(spec: DesignSpec, point: Unit, checked: Assessment, slopes: Slopes) -> Conditions:
    """Return the conditions at a nominal point, by non-negative least squares of the stationarity equations."""
    number, count = len(spec.constraints), len(point)
    ranges = spec.high - spec.low
    least = np.where(np.isfinite(checked.slack), checked.slack, np.inf).min(axis=1, initial=np.inf)
    slack = [float(x) * c.scale + c.margin for x, c in zip(least, spec.constraints, strict=True)]
    slack += [float(d) for pair in zip(point * ranges, (1 - point) * ranges, strict=True) for d in pair]
    binds, relaxation = np.zeros(len(slack), bool), np.zeros(len(slack))
    starts = distinct_starts(checked)
    gradient = slopes[spec.maximise][starts[0]] if starts else np.full(count, np.nan)
    if not np.isfinite(gradient).all():
        return Conditions(np.array(slack), binds, np.full(len(slack), np.nan), np.nan)
    columns, limits, units = [], [], []
    for j, c in enumerate(spec.constraints):
        for start in starts:
            slope = c.sign * slopes.get(f"{c.variable} {c.end}", slopes[c.variable])[start] / c.scale
            if checked.slack[j, start] <= BINDING_SLACK and np.isfinite(slope).all():
                columns.append(-slope)
                limits.append(j)
                units.append(c.scale)
    for k in range(count):
        for end, distance, sign in ((0, point[k], -1.0), (1, 1 - point[k], 1.0)):
            if distance <= BINDING_BOUND:
                columns.append(sign * np.eye(count)[k])
                limits.append(number + 2 * k + end)
                units.append(float(ranges[k]))
    size = float(np.linalg.norm(gradient))
    weights, rest = nnls(np.array(columns).T, gradient) if columns else (np.zeros(0), size)
    for weight, limit, unit in zip(weights, limits, units, strict=True):
        relaxation[limit] += weight / unit
        binds[limit] |= weight > 0
    return Conditions(np.array(slack), binds, relaxation, rest / size if size else 0.0)
