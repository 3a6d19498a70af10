"""The uncertainty of the unknowns near the estimate: Fisher information, combinations, and a posterior."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.studies.calibration_model import Fit, Model, Theta
from vibrojax.studies.calibration_spec import CalibrationSpec

CHECKED_DRAWS = 32
"""Draws of the posterior at which the motion is computed again, to check the linear approximation."""


class Uncertainty(NamedTuple):
    """The uncertainty of the unknowns near the estimate, in units of `scale`.

    - `covariance`: very large, but finite, where the data do not determine a parameter.
    - `directions`: orthonormal combinations as rows, with their standard errors `errors`, the best known first.
    """

    scale: Theta
    covariance: Float[np.ndarray, "unknown unknown"]
    directions: Float[np.ndarray, "unknown unknown"]
    errors: Theta


def uncertainty_of(spec: CalibrationSpec, theta: Theta, jacobian: np.ndarray, variance: float) -> Uncertainty:
    """Return covariance and combinations from the Fisher information J'J; logarithms of positive parameters."""
    scale = np.where(spec.low > 0, np.abs(theta), spec.high - spec.low)
    scaled = jacobian * scale
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values, vectors = values[::-1], vectors[:, ::-1]
    floor = np.finfo(float).eps * max(values[0], 0.0) * len(theta)
    with np.errstate(divide="ignore"):
        errors = np.sqrt(variance / np.where(values > floor, values, 0.0))
    finite = np.where(np.isfinite(errors), errors, 1e9)  # products with infinities would be NaN
    covariance = (vectors * finite**2) @ vectors.T
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(theta))])
    return Uncertainty(scale, covariance, (vectors * signs).T, errors)


def posterior_draws(
    spec: CalibrationSpec, theta: Theta, known: Uncertainty, freedom: int
) -> Float[np.ndarray, "draws unknown"]:
    """Return draws inside the bounds, normal in logarithms of positive parameters.

    If the residuals give the error of the observations, its own uncertainty makes the draws those of Student's t.
    """
    rng = np.random.default_rng(spec.seed)
    finite = np.where(np.isfinite(known.errors), known.errors, 1e3)
    steps = (rng.standard_normal((spec.draws, len(theta))) * finite) @ known.directions
    if spec.errors is None and freedom > 0:
        steps /= np.sqrt(rng.chisquare(freedom, (spec.draws, 1)) / freedom)
    return moved(spec, theta, known.scale, steps)


def moved(spec: CalibrationSpec, theta: Theta, scale: Theta, steps: np.ndarray) -> np.ndarray:
    """Return theta changed by `steps` in units of `scale`, in logarithms of positive parameters, inside the bounds."""
    with np.errstate(over="ignore"):
        return np.clip(np.where(spec.low > 0, theta * np.exp(steps), theta + scale * steps), spec.low, spec.high)


def nonlinearity(model: Model, fit: Fit, jacobian: np.ndarray, draws: np.ndarray) -> float:
    """Return the error of the linear prediction at draws of the posterior, relative to the spread of the prediction."""
    rows, width = slice(0, fit.target.values.size), fit.target.values.shape[1]
    centre = fit.target.residuals(fit.prediction, fit.theta)
    off, spread = [], []
    checked = draws[:CHECKED_DRAWS]
    for draw, prediction in zip(checked, model.predict_all(checked), strict=True):
        valid = np.repeat(prediction.valid, width)
        linear = jacobian @ (draw - fit.theta)
        off.append((fit.target.residuals(prediction, draw) - centre - linear)[rows][valid])
        spread.append(linear[rows][valid])
    total = np.sum(np.concatenate(spread) ** 2)
    return float(np.sqrt(np.sum(np.concatenate(off) ** 2) / total)) if total > 0 else np.nan
