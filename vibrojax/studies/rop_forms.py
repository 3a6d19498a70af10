"""Forms of the rate-of-penetration law: formulas, fits by SciPy's least squares, and standard errors.

The source's law, rate = C ln(P/D) (eq. 6.4), gives a negative rate if the relief eta = P/D is below 1. It is therefore
read in three ways ("forms"): as printed, with P/D in percent, and as C ln(eta/eta0) with a fitted onset eta0, the
relief at which penetration begins. A straight line, a power law and a constant serve as comparison.

A lane (here, one pair of relief and rate) at zero rate is censored; all others are *seen*. A censored lane has a
residual only if the form predicts a positive rate. Above a founder weight, if a model has one, the rate of the law
stays at its value there or falls linearly with the weight.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

Lanes: TypeAlias = Float[np.ndarray, " lanes"]
LaneFlags: TypeAlias = Bool[np.ndarray, " lanes"]
Theta: TypeAlias = Float[np.ndarray, " coefficients"]
Jacobian: TypeAlias = Float[np.ndarray, "lanes coefficients"]
Square: TypeAlias = Float[np.ndarray, "coefficients coefficients"]
Coefficients: TypeAlias = Float[np.ndarray, " 3"]  # C (in the unit of the rate), eta0 and exponent; NaN: has none


class Reason(IntEnum):
    """Reasons why a fitted value is NaN; without a known threshold, some forms are the same curve as another one."""

    IDENTIFIED = 0
    TOO_FEW_LANES = 1
    NO_SPREAD = 2
    ALL_CENSORED = 3
    NOT_CONVERGED = 4
    NO_SLOPE = 5
    CONSTANT_RATES = 6
    UNKNOWN_THRESHOLD = 7


REASONS = tuple(reason.name.lower().replace("_", "-") for reason in Reason)
"""Names of the reasons as stored in datasets."""

LEAST_SPREAD = 1e-9
"""Standard deviation of ln(eta), or of rate/greatest rate, below which values count as equal: rounding is smaller."""

LOSSES = {"squares": ("linear", np.inf), "huber": ("huber", 1.345), "soft-l1": ("soft_l1", 2.0)}
"""Losses by name: SciPy's name, and the residual in standard deviations from which its influence is bounded.

Both robust losses are at least 90 % as efficient as least squares for normal noise."""

NORMAL_OVER_MAD = 1.4826
"""Ratio of the standard deviation to the median absolute deviation for normal noise."""

_LARGEST_EXPONENT = 60.0  # argument of exp, so that a poor trial step of the search does not overflow
_LARGEST_THETA = 30.0  # rates are scaled to order one: a search that goes farther diverges
_MOST_EVALUATIONS = 400  # ten times the largest number observed in a fit
_TOLERANCE, _LOSS_TOLERANCE = 1e-15, 1e-8  # of least squares, whose steps are quick, and of other losses
_SCALE_ROUNDS, _SAME_SCALE = 12, 0.1  # fits of a robust loss, and the change of its scale that needs no further one
_LEAST_SCALE = 1e-9  # of the residuals, relative to the greatest rate, for data that are fitted exactly
_LEAST_FREE_SHARE = 1e-6  # value of 1 - h (h: leverage) below which a lane is fitted exactly, whatever its noise


@dataclass(frozen=True)
class Form:
    """A formula of the law. `of_log`: whether the rate is a function of ln(eta); `size`: number of coefficients.

    `rate` is the formula as a function of eta and the coefficients C, eta0 and exponent.
    """

    name: str
    formula: str
    size: int
    of_log: bool
    rate: Callable[[Lanes, float, float, float], Lanes]

    def variable(self, relief: Lanes) -> Lanes:
        """Return the variable t in which the rate (of power: its logarithm) is theta_0 t, or theta_0 + theta_1 t."""
        if self.name == "constant":
            return np.ones_like(relief)
        return np.log(100 * relief if self.name == "percent" else relief) if self.of_log else relief


FORMS = (
    Form("literal", "C ln(eta)", 1, True, lambda eta, C, eta0, exponent: C * np.log(eta)),
    Form("percent", "C ln(100 eta)", 1, True, lambda eta, C, eta0, exponent: C * np.log(100.0 * eta)),
    Form("onset", "C ln(eta/eta0)", 2, True, lambda eta, C, eta0, exponent: C * np.log(eta / eta0)),
    Form("line", "C (eta - eta0)", 2, False, lambda eta, C, eta0, exponent: C * (eta - eta0)),
    Form("power", "C eta^exponent", 2, True, lambda eta, C, eta0, exponent: C * eta**exponent),
    Form("constant", "C", 1, False, lambda eta, C, eta0, exponent: C * np.ones_like(eta)),
)

LOGARITHMIC = ("literal", "percent", "onset")
"""Names of the three readings of the source's law, eq. 6.4."""

SAME_AS_ONSET = ("literal", "percent")
"""Forms that have the same curve as the onset form if the threshold is unknown."""

CONTAINED = {"literal": ("onset",), "percent": ("onset",), "constant": ("onset", "line", "power")}
"""Forms that contain another one as a special case: they are no rivals of it, since they cannot be worse."""


@dataclass(frozen=True)
class Model:
    """Rates of a form over a group of lanes, as a function of its coefficients theta in scaled variables.

    With `weight`, theta ends with the founder weight and the fall of the rate per weight above it.
    """

    form: Form
    relief: Lanes
    centre: float
    spread: float
    weight: Lanes | None = None

    def rates(self, theta: Theta) -> tuple[Lanes, Jacobian]:
        """Return the rate of each lane and its derivatives with respect to theta."""
        size, weight, relief = self.form.size, self.weight, self.relief
        if weight is not None:
            relief = relief * np.minimum(1.0, theta[-2] / weight)
        z = (self.form.variable(relief) - self.centre) / self.spread
        columns = z[:, None] if size == 1 else np.stack([np.ones_like(z), z], axis=1)
        rates = columns @ theta[:size]
        if self.form.name == "power":
            rates = np.exp(np.minimum(rates, _LARGEST_EXPONENT))
            columns = rates[:, None] * columns
        if weight is None:
            return rates, columns
        above, excess = weight > theta[-2], np.maximum(weight - theta[-2], 0.0)
        moved = (1 / theta[-2] if self.form.of_log else relief / theta[-2]) / self.spread
        by_bend = np.where(above, columns[:, 0] * moved * theta[size - 1] + theta[-1], 0.0)
        return rates - theta[-1] * excess, np.column_stack([columns, by_bend, -excess])

    def coefficients(self, theta: Theta) -> tuple[Coefficients, Float[np.ndarray, "3 coefficients"]]:
        """Return the coefficients of the law, and their derivatives with respect to theta."""
        none, centre, spread = [np.nan] * self.form.size, self.centre, self.spread
        if self.form.size == 1:
            return np.array([theta[0] / spread, np.nan, np.nan]), np.array([[1 / spread], none, none])
        if self.form.name == "power":
            exponent = theta[1] / spread
            c = np.exp(theta[0] - exponent * centre)
            return np.array([c, np.nan, exponent]), np.array([[c, -c * centre / spread], none, [0.0, 1 / spread]])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            onset = centre - spread * theta[0] / theta[1]
            eta0 = np.exp(onset) if self.form.of_log else onset
            slope = (eta0 if self.form.of_log else 1.0) * spread / theta[1]
            slopes = [[0.0, 1 / spread], [-slope, slope * theta[0] / theta[1]], none]
        return np.array([theta[1] / spread, eta0, np.nan]), np.array(slopes)


def model_of(form: Form, relief: Lanes, seen: LaneFlags) -> Model:
    """Return the model of a form, with its variable scaled by the lanes that penetrate."""
    t = form.variable(relief[seen])
    centre = 0.0 if form.size == 1 else float(t.mean())
    return Model(form, relief, centre, float(np.sqrt(np.mean((t - centre) ** 2))))


@dataclass(frozen=True)
class Minimum:
    """Result of a search: theta, and whether it converged to a minimum of the loss.

    `residual` and `jacobian` are evaluated at theta. `active` is a mask of the lanes that contribute. `scale` is the
    residual from which the loss bounds the influence of a lane.
    """

    model: Model
    theta: Theta
    converged: bool
    residual: Lanes
    jacobian: Jacobian
    active: LaneFlags
    loss: str = "linear"
    scale: float = 1.0

    def influence(self) -> Lanes:
        """Return the residuals as they enter the coefficients: bounded by the loss, over its mean curvature."""
        z, r = np.abs(self.residual / self.scale), self.residual
        if self.loss == "linear":
            return r
        if self.loss == "huber":
            return r * np.minimum(1.0, 1 / np.maximum(z, 1.0)) / np.mean(z[self.active] <= 1.0)
        return r * (1 + z**2) ** -0.5 / np.mean((1 + z[self.active] ** 2) ** -1.5)


def evaluate(model: Model, theta: Theta, rate: Lanes, seen: LaneFlags) -> Minimum:
    """Return residuals and Jacobian at theta; they are zero for a censored lane whose rate is not predicted above 0."""
    predicted, jacobian = model.rates(theta)
    active = seen | (predicted > 0)
    residual = np.where(seen, predicted - rate, np.maximum(predicted, 0.0))
    return Minimum(model, theta, bool(np.isfinite(theta).all()), residual, jacobian * active[:, None], active)


def minimise(
    model: Model,
    rate: Lanes,
    seen: LaneFlags,
    loss: str = "squares",
    start: Theta | None = None,
    bounds: tuple[Theta, Theta] = (np.array(-np.inf), np.array(np.inf)),
) -> Minimum:
    """Return a minimum of a loss of `LOSSES`, scaled by the median absolute deviation of its residuals.

    Rates are of order one. A linear form without censored lanes above its onset needs no search. `start` is an initial
    guess, by default the linear fit to the seen lanes; `bounds` are those of a model with a founder.
    """
    by_log = model.form.name == "power"
    if start is None:
        _, columns = replace(model, form=FORMS[2] if by_log else model.form).rates(np.ones(model.form.size))
        # To first order, a residual of the logarithm times the rate is the residual of the rate.
        weight, target = np.where(seen, rate if by_log else 1.0, 0.0), np.log(np.where(seen, rate, 1.0))
        start = np.linalg.lstsq(weight[:, None] * columns, weight * (target if by_log else rate))[0]
    minimum, (name, bound), scale = evaluate(model, start, rate, seen), LOSSES[loss], 1.0
    is_solved = not by_log and model.weight is None and not (minimum.active & ~seen).any()

    def search(name: str, start: Theta) -> Minimum:
        method = "lm" if name == "linear" and model.weight is None else "trf"
        found = least_squares(
            lambda theta: evaluate(model, theta, rate, seen).residual,
            start,
            lambda theta: evaluate(model, theta, rate, seen).jacobian,
            bounds=bounds,
            method=method,
            loss=name,
            f_scale=scale,
            max_nfev=_MOST_EVALUATIONS,
            **dict.fromkeys(("ftol", "xtol", "gtol"), _TOLERANCE if method == "lm" else _LOSS_TOLERANCE),
        )
        done = found.status > 0 and bool(np.abs(found.x[: model.form.size]).max() < _LARGEST_THETA)
        return replace(evaluate(model, found.x, rate, seen), converged=done, loss=name, scale=scale)

    minimum, before = minimum if is_solved else search("linear", start), np.inf
    for _ in range(_SCALE_ROUNDS if name != "linear" else 0):
        scale = bound * max(spread_of(minimum.residual[minimum.active]), _LEAST_SCALE)
        if abs(scale - before) <= _SAME_SCALE * scale:
            break
        minimum, before = search(name, minimum.theta), scale
    return minimum


def search(form: Form, relief: Lanes, rate: Lanes, loss: str) -> Minimum | Reason:
    """Return the fit of a form to one group, with rates in units of the greatest one, or the reason why it has none."""
    seen = rate > 0
    if not seen.any():
        return Reason.ALL_CENSORED if seen.size else Reason.TOO_FEW_LANES
    if seen.sum() <= form.size:
        return Reason.TOO_FEW_LANES
    if not np.std(np.log(relief[seen])) > LEAST_SPREAD:
        return Reason.NO_SPREAD
    minimum = minimise(model_of(form, relief, seen), rate / rate.max(), seen, loss)
    return minimum if minimum.converged else Reason.NOT_CONVERGED


def spread_of(residual: Lanes) -> float:
    """Return the standard deviation of residuals, estimated from their median absolute deviation."""
    return NORMAL_OVER_MAD * float(np.median(np.abs(residual)))


def covariance(jacobian: Jacobian, residual: Lanes) -> Square:
    """Return the covariance of the coefficients for noise whose variance may differ between lanes (HC3).

        (J^T J)^-1 J^T diag(r²/(1 - h)²) J (J^T J)^-1,  h the diagonal of J (J^T J)^-1 J^T

    The usual estimate s² (J^T J)^-1 assumes the same variance at all lanes. If the noise is proportional to the rate,
    as is common on a rig, its intervals are far too wide for an onset outside the range of the lanes, and sometimes too
    narrow for C (MacKinnon and White 1985, J. Econometrics 29, 305).
    """
    inverse = np.linalg.pinv(jacobian)
    free = 1 - np.sum(inverse.T * jacobian, axis=1)
    spread = np.sqrt(np.sum(residual**2) / max(residual.size - jacobian.shape[1], 1))
    # A lane that alone determines a coefficient is fitted exactly: its noise is estimated from the other lanes.
    alone = free < _LEAST_FREE_SHARE
    weighted = inverse * np.where(alone, spread, residual / np.where(alone, 1.0, free))
    return weighted @ weighted.T
