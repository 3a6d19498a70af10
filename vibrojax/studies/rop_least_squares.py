"""Least-squares fits of rates, with censored lanes, robust losses for data with outliers, and standard errors.

A lane (here, one pair of relief and rate) observed at zero rate is censored; all others are *seen*. A censored lane has
a residual only if the model predicts a positive rate f. The sum of squares, with weights w, is

    S(theta) = sum over seen lanes of w (f - rate)²  +  sum over censored lanes of w max(f, 0)²
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares

Lanes = Float[np.ndarray, " lanes"]
LaneFlags = Bool[np.ndarray, " lanes"]
Theta = Float[np.ndarray, " coefficients"]
Jacobian = Float[np.ndarray, "lanes coefficients"]
Square = Float[np.ndarray, "coefficients coefficients"]


class Reason(IntEnum):
    """Reasons why a fitted value is NaN.

    CONFOUNDED occurs only in fits of the joint law, CONSTANT_RATES only for R². UNKNOWN_THRESHOLD
    occurs in fits of logs without a threshold, for the forms that then are the same curve as another one.
    """

    IDENTIFIED = 0
    TOO_FEW_LANES = 1
    NO_SPREAD = 2
    ALL_CENSORED = 3
    NOT_CONVERGED = 4
    NO_SLOPE = 5
    CONFOUNDED = 6
    CONSTANT_RATES = 7
    UNKNOWN_THRESHOLD = 8


REASONS = tuple(reason.name.lower().replace("_", "-") for reason in Reason)
"""Names of the reasons as stored in datasets."""

LEAST_SPREAD = 1e-9
"""Standard deviation below which values count as equal: of ln(eta), a parameter's logarithm, or rate/greatest rate.

It is far above rounding errors and far below the spread of any measurement.
"""

LARGEST_EXPONENT = 60.0
"""Upper bound of the argument of exp, so that a poor trial step of the search does not overflow."""

_EPSILON = float(np.finfo(float).eps)
_LM_MAX_EVALUATIONS = 400  # ten times the largest number of evaluations observed in a fit
_NEWTON_STEPS = 4  # two suffice: they converge quadratically from MINPACK's seven digits to full precision
_NEWTON_TOLERANCE = 1e-8  # relative size of the next Newton step below which the search counts as converged
_ROUNDING = 1e-13  # relative increase of S that rounding errors can cause

_HUBER = 1.345  # 95 % as efficient as least squares for normal noise
_NORMAL_OVER_MAD = 1.4826  # ratio of standard deviation to median absolute deviation for normal noise
_SCALE_ROUNDS = 15  # iterations of reweighting in which the scale is updated from the residuals
_REWEIGHTING_MAX_ROUNDS = 300
_REWEIGHTING_TOLERANCE = 1e-8  # relative change of theta below which the reweighting stops
_LEAST_SCALE = 1e-12  # smallest scale, relative to the greatest rate, for data that are fitted exactly

# Relative singular value of a Jacobian with unit columns below which coefficients are confounded.
_LEAST_SINGULAR_VALUE = 1e-7
_LEAST_FREE_SHARE = 1e-6  # value of 1 - h (h: leverage) below which a lane is fitted exactly, whatever its noise


@runtime_checkable
class RateModel(Protocol):
    """A model that predicts the rates of a group of lanes from the coefficients theta."""

    def rates(self, theta: Theta) -> Lanes:
        """Return the rate of each lane."""

    def jacobian(self, theta: Theta) -> Jacobian:
        """Return the derivatives of the rates with respect to theta."""

    def curvature(self, theta: Theta, weight: Lanes) -> Square:
        """Return the weighted sum, over the lanes, of the Hessians of the rates."""

    def start(self, rate: Lanes, weight: Lanes) -> Theta:
        """Return the initial guess of theta. For a linear model, it is the minimum of S without censored lanes."""


@dataclass(frozen=True)
class LinearRates:
    """Model whose rates are linear in the coefficients: columns @ theta."""

    columns: Jacobian

    def rates(self, theta: Theta) -> Lanes:
        return self.columns @ theta

    def jacobian(self, theta: Theta) -> Jacobian:
        return self.columns

    def curvature(self, theta: Theta, weight: Lanes) -> Square:
        return np.zeros((theta.size, theta.size))

    def start(self, rate: Lanes, weight: Lanes) -> Theta:
        root = np.sqrt(weight)
        return np.linalg.lstsq(root[:, None] * self.columns, root * rate)[0]


@dataclass(frozen=True)
class ExponentialRates:
    """Model of positive rates whose logarithm is linear in the coefficients: exp(columns @ theta)."""

    columns: Jacobian

    def rates(self, theta: Theta) -> Lanes:
        return np.exp(np.minimum(self.columns @ theta, LARGEST_EXPONENT))

    def jacobian(self, theta: Theta) -> Jacobian:
        return self.rates(theta)[:, None] * self.columns

    def curvature(self, theta: Theta, weight: Lanes) -> Square:
        return self.columns.T @ ((weight * self.rates(theta))[:, None] * self.columns)

    def start(self, rate: Lanes, weight: Lanes) -> Theta:
        # To first order, a residual of the logarithm times the rate is the residual of the rate.
        logs = np.log(np.where(weight > 0, rate, 1.0))
        return LinearRates(self.columns).start(logs, weight * rate**2)


@dataclass(frozen=True)
class Minimum:
    """The result of a search: theta, and whether it converged to a minimum.

    `residual` and `jacobian` are evaluated at theta; `active` is a mask of the lanes that contribute to S there.
    """

    theta: Theta
    converged: bool
    residual: Lanes
    active: LaneFlags
    jacobian: Jacobian


def residuals(predicted: Lanes, rate: Lanes, censored: LaneFlags) -> Lanes:
    """Return the residual of each lane; it is zero for a censored lane whose predicted rate is not positive."""
    return np.where(censored, np.maximum(predicted, 0.0), predicted - rate)


def minimise(
    model: RateModel, rate: Lanes, censored: LaneFlags, start: Theta | None = None, weight: Lanes | None = None
) -> Minimum:
    """Return a minimum of S.

    Close to the minimum, S is constant up to rounding errors while theta still changes by the square root of their
    size. Newton steps with the exact Hessian therefore determine the final digits. The size of the next Newton step
    decides on convergence. `rate` is scaled to order one. `start` is an initial guess of theta, by default that of the
    model for the seen lanes. `weight` is the weight w of each lane, by default 1.
    """
    weight = np.ones(rate.size) if weight is None else weight
    linear = isinstance(model, LinearRates)
    theta = model.start(rate, np.where(censored, 0.0, weight)) if start is None or linear else start
    if linear and not (model.rates(theta)[censored] > 0).any():
        converged = bool(np.isfinite(theta).all())  # S is convex
    else:
        theta, converged = _search(model, rate, censored, theta, np.sqrt(weight))
    predicted = model.rates(theta)
    active = ~censored | (predicted > 0)
    return Minimum(theta, converged, residuals(predicted, rate, censored), active, model.jacobian(theta))


def _search(model: RateModel, rate: Lanes, censored: LaneFlags, theta: Theta, root: Lanes) -> tuple[Theta, bool]:
    """Search for a minimum of S from `theta`; return it and whether it converged. `root` is sqrt(w) of each lane."""

    def weighted(theta: Theta) -> Lanes:
        return root * residuals(model.rates(theta), rate, censored)

    def slopes(theta: Theta) -> Jacobian:
        return (root * (~censored | (model.rates(theta) > 0)))[:, None] * model.jacobian(theta)

    def newton_step(theta: Theta) -> Theta:
        jacobian, values = slopes(theta), weighted(theta)
        try:
            return -np.linalg.solve(jacobian.T @ jacobian + model.curvature(theta, root * values), jacobian.T @ values)
        except np.linalg.LinAlgError:
            return np.full(theta.size, np.inf)

    theta = least_squares(weighted, theta, slopes, method="lm", max_nfev=_LM_MAX_EVALUATIONS).x
    step = newton_step(theta)
    for _ in range(_NEWTON_STEPS):
        before, after = (float(np.sum(weighted(x) ** 2)) for x in (theta, theta + step))
        if not after <= before * (1 + _ROUNDING) + _ROUNDING**2:  # or NaN, since the Hessian is singular
            break
        theta = theta + step
        step = newton_step(theta)
    return theta, bool(np.max(np.abs(step) / (1 + np.abs(theta))) <= _NEWTON_TOLERANCE)


Loss = tuple[Callable[[Lanes], Lanes], Callable[[Lanes], Lanes]]
"""A loss rho(z) of z = residual/scale: its weight rho'(z)/(2 z), and the derivative of z weight(z)."""

LOSSES: dict[str, Loss] = {
    "huber": (
        lambda z: np.minimum(1.0, _HUBER / np.maximum(np.abs(z), _HUBER)),
        lambda z: np.where(np.abs(z) <= _HUBER, 1.0, 0.0),
    ),
    "soft-l1": (lambda z: (1 + z**2) ** -0.5, lambda z: (1 + z**2) ** -1.5),
}
"""Losses in which the influence of outliers is bounded."""


def minimise_loss(
    loss: Loss, model: RateModel, rate: Lanes, censored: LaneFlags, minimum: Minimum
) -> tuple[Minimum, float]:
    """Minimise a loss by iteratively reweighted least squares; return the minimum and the scale of the residuals.

    The scale is the standard deviation of the residuals, estimated from their median absolute deviation. It is updated
    in the first iterations and constant afterwards, so that the search has a fixed objective. It begins at `minimum`.
    """
    (weight, _), scale, change = loss, 1.0, np.inf
    for count in range(_REWEIGHTING_MAX_ROUNDS):
        if count < _SCALE_ROUNDS:
            deviation = np.median(np.abs(minimum.residual[minimum.active]))
            scale = float(max(_NORMAL_OVER_MAD * deviation, _LEAST_SCALE))
        before = minimum.theta
        minimum = minimise(model, rate, censored, before, weight(minimum.residual / scale))
        change = float(np.max(np.abs(minimum.theta - before)) / (1 + np.max(np.abs(before))))
        if not np.isfinite(change) or (change <= _REWEIGHTING_TOLERANCE and count >= _SCALE_ROUNDS):
            break
    return replace(minimum, converged=minimum.converged and change <= _REWEIGHTING_TOLERANCE), scale


def reason_of_no_fit(seen: LaneFlags, coefficients: int, log_relief: Lanes) -> Reason | None:
    """Return the reason why lanes do not determine the coefficients of a law, or None; `seen`: lanes that penetrate."""
    if not seen.any():
        return Reason.ALL_CENSORED if seen.size else Reason.TOO_FEW_LANES
    if seen.sum() <= coefficients:
        return Reason.TOO_FEW_LANES
    return None if np.std(log_relief[seen]) > LEAST_SPREAD else Reason.NO_SPREAD


def covariance(jacobian: Jacobian, residual: Lanes) -> Square:
    """Return the covariance of the coefficients for noise whose variance may differ between lanes.

        (J^T J)^-1 J^T diag(r²/(1 - h)²) J (J^T J)^-1,  h the diagonal of J (J^T J)^-1 J^T

    The usual estimate s² (J^T J)^-1 assumes the same noise variance at all lanes. If the noise is proportional to the
    rate, as is common on a rig, that estimate makes confidence intervals far too wide for an onset outside the range of
    the lanes, and sometimes too narrow for C. Both estimates agree if all lanes are equally noisy (HC3: MacKinnon and
    White 1985, "Some heteroskedasticity-consistent covariance matrix estimators with improved finite sample
    properties").
    """
    inverse = np.linalg.pinv(jacobian)
    free = 1 - np.sum(inverse.T * jacobian, axis=1)
    spread = np.sqrt(np.sum(residual**2) / max(residual.size - jacobian.shape[1], 1))
    # A lane that alone determines a coefficient is fitted exactly: its noise is estimated from the other lanes.
    alone = free < _LEAST_FREE_SHARE
    weighted = inverse * np.where(alone, spread, residual / np.where(alone, 1.0, free))
    return weighted @ weighted.T


def confounded_coefficients(jacobian: Jacobian) -> Bool[np.ndarray, " coefficients"]:
    """Return a mask of the coefficients that the lanes cannot distinguish, or that do not affect any lane."""
    lengths = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(lengths > 0, lengths, 1.0)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=len(jacobian) < len(lengths))
    singular = np.pad(singular, (0, len(lengths) - len(singular)))
    lost = singular < _LEAST_SINGULAR_VALUE * max(singular[0], np.finfo(float).tiny)
    return np.asarray((directions[lost] ** 2).sum(axis=0) > _LEAST_SINGULAR_VALUE)


def goodness(minimum: Minimum, rate: Lanes, unit: float) -> dict[str, float]:
    """Return `r_squared`, `aic` = n ln(RSS/n) + 2 coefficients (RSS in m²/s²), and `degrees_of_freedom`.

    R² is NaN if the rates do not vary. RSS/n has a lower bound, the squared rounding error of the greatest rate, so
    that the AIC of exact data is finite.

    **Arguments:** `rate`: rates in units of `unit` [m/s], the greatest rate, like the residuals of `minimum`.
    """
    squares, about_mean = np.sum(minimum.residual**2), np.sum((rate - rate.mean()) ** 2)
    r_squared = 1 - squares / about_mean if about_mean > rate.size * LEAST_SPREAD**2 else np.nan
    mean_square, size = max(squares / rate.size, _EPSILON**2), minimum.theta.size
    aic = rate.size * (np.log(mean_square) + 2 * np.log(unit)) + 2 * size
    return {"r_squared": float(r_squared), "aic": float(aic), "degrees_of_freedom": int(minimum.active.sum()) - size}


def r_squared_reason(r_squared: Float[np.ndarray, "*fits"], reason: Int[np.ndarray, "*fits"]) -> np.ndarray:
    """Return the reasons why R² is NaN, as indices into `REASONS`; `reason` holds the reasons of the coefficients."""
    fitted = np.isin(reason, (Reason.IDENTIFIED, Reason.NO_SLOPE))
    return np.where(np.isfinite(r_squared), Reason.IDENTIFIED, np.where(fitted, Reason.CONSTANT_RATES, reason))
