"""The uncertainty of the best estimate of a calibration, and the variables of its dataset."""

from typing import Any

import numpy as np
import scipy.stats
from jaxtyping import Float

from vibrojax.errors import Place, counted
from vibrojax.io.variables import Variable
from vibrojax.studies.calibration_model import ORBIT_ERROR, TOLERANCE, Fit, Model, Problem, best_along_step

CHECKED_DRAWS = 32  # draws of the posterior at which the motion is computed again, to check the linear approximation
REASONS = ("identified", "confounded", "at-bound")  # whether the data determine a parameter

USES = ("no", "yes")
"""Whether an observation is used: it is not where the followed orbit does not exist, or is not stable."""

INTERVAL = 0.95  # probability with which an interval covers the true value
VAGUE = 0.5  # relative standard error from which on a parameter is not identified

AT_BOUND = 1e-2
"""Distance from a bound, relative to the interval, within which an estimate whose next step leads beyond the bound is
at the bound: a search approaches it slowly."""

LARGEST_OFFSET = 0.05
"""Length of the residuals along the tangent plane, in standard errors, up to which a search has reached a minimum
(Bates and Watts 1981)."""

LARGEST_FALL = 0.1
"""Variances by which the sum of squares of a history may fall along a step, where its minimum is at a kink: the
estimate is then within a third of a standard error of it."""

_OF, _PARAMETER, _COMBINATION = ("observation", "of"), ("parameter",), ("combination",)

CALIBRATION_VARIABLES = {
    "estimate": Variable("", "estimate, in the parameter's own unit", dims=_PARAMETER),
    "estimate_stderr": Variable("", "standard error of the estimate, NaN for one at a bound", dims=_PARAMETER),
    "estimate_low": Variable("", "lower end of the 95 % interval, not below the bound", dims=_PARAMETER),
    "estimate_high": Variable("", "upper end of the 95 % interval, not above the bound", dims=_PARAMETER),
    "low": Variable("", "lower bound, in the parameter's own unit", dims=_PARAMETER),
    "high": Variable("", "upper bound, in the parameter's own unit", dims=_PARAMETER),
    "reason": Variable("1", "whether the data determine the parameter", np.int8, REASONS, dims=_PARAMETER),
    "correlation": Variable("1", "correlation of two estimates", dims=("parameter", "other")),
    "direction": Variable("1", "exponent of the parameter in a combination", dims=_COMBINATION + _PARAMETER),
    "direction_error": Variable("1", "relative standard error of a combination, best known first", dims=_COMBINATION),
    "posterior": Variable("", "draws of the posterior, in the parameter's own unit", dims=("draw", "parameter")),
    "observed": Variable("", "observation, in the variable's own unit", dims=_OF),
    "predicted": Variable("", "value of the orbit at the estimate, in the variable's own unit", dims=_OF),
    "residual": Variable("1", "predicted minus observed, in standard errors of the observation", dims=_OF),
    "used": Variable("1", "whether the observation is used", np.int8, USES, dims=("observation",)),
    "chi_squared": Variable("1", "sum of the squared residuals"),
    "freedom": Variable("1", "number of used values minus number of unknowns", np.int32),
    "noise": Variable("1", "relative error of the observations that the residuals give; NaN if it was given"),
    "nonlinearity": Variable(
        "1", "error of the linear prediction over draws of the posterior, relative to their spread"
    ),
}


def estimated(file: str, problem: Problem, model: Model, fit: Fit, draws: int) -> dict[str, Any]:
    """Return the values of `CALIBRATION_VARIABLES` at the best fit; `file`: the calibration in messages.

    **Raises:** `InputError` if the fit has not reached a minimum.
    """
    theta, prediction, weight, cost, freedom, _ = fit
    residuals, jacobian = problem.residuals(weight, prediction, theta), problem.jacobian(weight, prediction)
    given, count, history = problem.errors is not None, problem.parameters, problem.history
    low, high, estimate = problem.low[:count], problem.high[:count], theta[:count]
    variance = 1.0 if given else max(cost / freedom, ORBIT_ERROR**2)
    noise = np.nan if given else float(np.sqrt(variance))
    margin, free = AT_BOUND * (problem.high - problem.low), jacobian
    beyond = np.zeros(len(theta), bool)
    for _ in theta:  # with one unknown held at its bound, another one may step beyond its own
        step = -np.linalg.lstsq(free, residuals)[0]
        beyond |= (theta < problem.low + margin) & (theta + step < problem.low)
        beyond |= (theta > problem.high - margin) & (theta + step > problem.high)
        free = jacobian * ~beyond
    offset = np.linalg.norm(free @ np.linalg.lstsq(free, residuals)[0])
    far = offset > LARGEST_OFFSET * np.sqrt(variance * len(theta)) + TOLERANCE
    if far and (history is None or best_along_step(problem, model, weight, theta)[1] > LARGEST_FALL * variance):
        where = ", ".join(f"{name} = {x:.4g}" for name, x in zip(problem.names, theta, strict=True))
        others = "give other bounds, another start, more searches, or leave out observations of other motions"
        if names := ", ".join(name for name, at_bound in zip(problem.names, beyond, strict=True) if at_bound):
            others = f"{names}: at-bound, the data suggest values beyond; widen the bounds, or examine the model"
        where += f", where {fit.used.sum()} of {counted(len(problem.labels), 'observation')} have an orbit"
        fault = f"no search has reached a minimum of the residuals; the best one ended at {where}; {others}"
        raise Place(file).error(fault)
    # Unknown states follow the parameters: what they cannot compensate determines the parameters.
    along = jacobian[:, count:]
    follow = -np.linalg.pinv(along) @ jacobian[:, :count]
    scale = np.where(low > 0, np.abs(estimate), high - low)
    covariance, directions, direction_error = _uncertainty((jacobian[:, :count] + along @ follow) * scale, variance)
    width = np.sqrt(np.diag(covariance))

    def moved(steps: np.ndarray) -> np.ndarray:
        """Return estimates changed by `steps` in units of `scale`, in logarithms if positive, in the bounds."""
        with np.errstate(over="ignore"):
            return np.clip(np.where(low > 0, estimate * np.exp(steps), estimate + scale * steps), low, high)

    rng = np.random.default_rng(problem.seed)
    finite = np.where(np.isfinite(direction_error), direction_error, 1e3)
    steps = (rng.standard_normal((draws, count)) * finite) @ directions
    if not given and freedom > 0:  # the error of the observations is uncertain itself: Student's t
        steps /= np.sqrt(rng.chisquare(freedom, (len(steps), 1)) / freedom)
    posterior = moved(steps)
    reason = np.where(width < VAGUE, REASONS.index("identified"), REASONS.index("confounded"))
    reason = np.where(beyond[:count], REASONS.index("at-bound"), reason)
    checked = posterior[:CHECKED_DRAWS]
    thetas = np.hstack([checked, theta[count:] + (checked - estimate) @ follow.T])
    nonlinearity = np.nan if reason.any() else _nonlinearity(problem, model, fit, jacobian, thetas)
    inside = np.where(beyond[:count], np.nan, 1.0)  # at a bound, the normal approximation gives no interval
    covered = 0.5 + INTERVAL / 2
    quantile = scipy.stats.norm.ppf(covered) if given else scipy.stats.t.ppf(covered, freedom)
    error = problem.errors_at(prediction.values) * (1.0 if given else noise)
    predicted = prediction.values.copy()
    if history is not None:  # rows have no samples, and samples no variables of orbits
        predicted[: problem.rows, -1] = predicted[problem.rows :, :-1] = np.nan
    return {
        "estimate": estimate,
        "estimate_stderr": inside * scale * width,
        "estimate_low": inside * moved(-quantile * width),
        "estimate_high": inside * moved(quantile * width),
        "low": low,
        "high": high,
        "reason": reason,
        "correlation": covariance / width / width[:, None],
        "direction": directions,
        "direction_error": direction_error,
        "posterior": posterior,
        "observed": problem.values,
        "predicted": predicted,
        "residual": np.where(weight > 0, (prediction.values - problem.values) / error, np.nan),
        "used": fit.used,
        "chi_squared": cost / variance,
        "freedom": freedom,
        "noise": noise,
        "nonlinearity": nonlinearity,
    }


def _uncertainty(
    scaled: Float[np.ndarray, "residuals unknown"], variance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the covariance from the Fisher information J'J, and combinations of the unknowns with their errors.

    The covariance is very large, but finite, where the data do not determine a parameter. The combinations are
    orthonormal rows, the best known first.
    """
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values, vectors = values[::-1], vectors[:, ::-1]
    floor = np.finfo(float).eps * max(values[0], 0.0) * len(values)
    with np.errstate(divide="ignore"):
        errors = np.sqrt(variance / np.where(values > floor, values, 0.0))
    finite = np.where(np.isfinite(errors), errors, 1e9)  # products with infinities would be NaN
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(values))])
    return (vectors * finite**2) @ vectors.T, (vectors * signs).T, errors


def _nonlinearity(problem: Problem, model: Model, fit: Fit, jacobian: np.ndarray, draws: np.ndarray) -> float:
    """Return the error of the linear prediction at draws of the posterior, relative to the spread of the prediction."""
    rows, width = slice(0, fit.weight.size), fit.weight.shape[1]
    centre = problem.residuals(fit.weight, fit.prediction, fit.theta)
    off, spread = [], []
    for draw, prediction in zip(draws, model.predict_all(draws), strict=True):
        valid = np.repeat(prediction.valid, width)
        linear = jacobian @ (draw - fit.theta)
        off.append((problem.residuals(fit.weight, prediction, draw) - centre - linear)[rows][valid])
        spread.append(linear[rows][valid])
    total = np.sum(np.concatenate(spread) ** 2)
    return float(np.sqrt(np.sum(np.concatenate(off) ** 2) / total)) if total > 0 else np.nan
