"""The calibration of the joint law: least squares over all lanes, with what it takes to trust the coefficients."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from vibrojax.devices import precision
from vibrojax.laws._group import (
    ALL_CENSORED,
    CONFOUNDED,
    IDENTIFIED,
    LEAST_SPREAD,
    NO_SPREAD,
    NOT_CONVERGED,
    TOO_FEW_LANES,
    goodness,
)
from vibrojax.laws._least_squares import nonlinear, residuals
from vibrojax.laws._normal import covariance, inverse

_GREATEST = 60.0  # of an exponent, so that a wild step does not overflow
_ALONG = 1e-6  # a parameter of which less lies outside the directions that the lanes span is told


@dataclass(frozen=True)
class Calibration:
    """The joint law's coefficients, or the `reason` why there are none.

    - `theta`, `errors`: ln C and its exponents, ln eta0 and its exponents: (2 + 2 parameters,), NaN where not told.
    - `told`: (parameters,), whether the lanes tell the parameter's exponents.
    - `lost`: which of theta the lanes cannot tell, (2 + 2 parameters,).
    - `unit`: the rate [m/s] that C is in.
    """

    theta: np.ndarray
    errors: np.ndarray
    told: np.ndarray
    lost: np.ndarray
    unit: float
    reason: int
    degrees_of_freedom: int = 0
    r_squared: float = np.nan
    aic: float = np.nan


def calibrated(relief: np.ndarray, rate: np.ndarray, logs: np.ndarray, shared: bool) -> Calibration:
    """The joint law by least squares over all lanes, those at zero rate censored.

    What is calibrated are exponents along the directions in which the parameters of the seen lanes vary; a parameter's
    exponent is told where these hold the parameter.

    **Arguments:** `relief`, `rate` [m/s]: (lanes,); `logs`: (lanes, parameters), of the parameters over their
    reference, the mean of the seen lanes; `shared`: one eta0 for all.
    """
    number, unit = logs.shape[1], rate.max(initial=0.0)
    directions = _directions(logs[rate > 0])
    told = (directions**2).sum(axis=0) > 1 - _ALONG
    nothing, everything = np.full(2 + 2 * number, np.nan), np.ones(2 + 2 * number, bool)
    free = 2 + len(directions) * (1 if shared else 2)

    def untold(reason, lost=everything):
        return Calibration(nothing, nothing, told, lost, unit, reason)

    log = np.log(relief)
    reason = _enough(log, rate, free)
    if reason != IDENTIFIED:
        return untold(reason)
    y, censored, along = rate / unit, rate == 0, logs @ directions.T
    with precision("float64"):
        found = jax.device_get(_refined(_start(log, y, along, shared), log, y, along, censored, unit))
    if not (np.isfinite(found["jacobian"]).all() and found["lanes"].sum() > free):
        return untold(NOT_CONVERGED)
    back = _back(directions, shared)
    lanes = found["lanes"]
    square, lost = inverse(found["jacobian"][lanes])
    if square is None:
        return untold(CONFOUNDED, (back[:, lost] ** 2).sum(axis=1) > _ALONG)
    if not found["converged"]:
        return untold(NOT_CONVERGED)
    freedom = int(found["lanes"].sum() - free)
    with precision("float64"):
        square = np.asarray(covariance(square, found["jacobian"][lanes], found["residual"][lanes], lanes[lanes]))
    errors = np.sqrt(np.einsum("ci,ij,cj->c", back, square, back))
    holds = np.concatenate([[True], told, [True], told])
    values = [np.where(holds, x, np.nan) for x in (back @ found["theta"], errors)]
    fitness = (freedom, found["r_squared"].item(), found["aic"].item())
    return Calibration(*values, told, ~holds, unit, IDENTIFIED, *fitness)


def _directions(logs: np.ndarray) -> np.ndarray:
    """An orthonormal basis (directions, parameters) of how the parameters vary over the lanes."""
    if not logs.size:
        return np.zeros((0, logs.shape[1]))
    _, singular, directions = np.linalg.svd(logs - logs.mean(axis=0), full_matrices=False)
    return directions[singular > LEAST_SPREAD * np.sqrt(len(logs))]


def _back(directions: np.ndarray, shared: bool) -> np.ndarray:
    """The matrix from what is calibrated to all coefficients; the onset's exponents are 0 where it is shared."""
    count, number = directions.shape
    back = np.zeros((2 + 2 * number, 2 + count * (1 if shared else 2)))
    back[0, 0] = back[1 + number, 1 + count] = 1
    back[1 : 1 + number, 1 : 1 + count] = directions.T
    if not shared:
        back[2 + number :, 2 + count :] = directions.T
    return back


def _enough(log: np.ndarray, rate: np.ndarray, free: int) -> int:
    """Whether there are lanes for `free` coefficients at all; the reason why not."""
    seen = rate > 0
    if not rate.size:
        return TOO_FEW_LANES
    if not seen.any():
        return ALL_CENSORED
    if seen.sum() <= free:
        return TOO_FEW_LANES
    return IDENTIFIED if np.ptp(log[seen]) > LEAST_SPREAD else NO_SPREAD


def _start(log: np.ndarray, y: np.ndarray, logs: np.ndarray, shared: bool) -> np.ndarray:
    """Power laws through C and eta0 of straight lines in ln eta, one for every combination of parameters."""
    seen = y > 0
    every = np.zeros(seen.sum(), dtype=int)
    group = np.unique(logs[seen].round(9), axis=0, return_inverse=True)[1].ravel() if logs.shape[1] else every
    slope, onset, at = _lines(log[seen], y[seen], logs[seen], group)
    if not np.isfinite(slope).any():
        slope, onset, at = _lines(log[seen], y[seen], logs[seen], every)
    rising = np.isfinite(slope)
    if not rising.any():  # the rate falls with the relief: begin with a C of one, and an onset below all lanes
        slope, onset, rising = np.ones_like(slope), np.full_like(onset, log.min() - 1), ~rising
    design = np.column_stack([np.ones(rising.sum()), at[rising]])
    coefficient = np.linalg.lstsq(design, np.log(slope[rising]), rcond=None)[0]
    if shared:
        return np.append(coefficient, np.median(onset[rising]))
    return np.append(coefficient, np.linalg.lstsq(design, onset[rising], rcond=None)[0])


def _lines(log: np.ndarray, y: np.ndarray, logs: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, ...]:
    """Slope and ln eta0 of each group's straight line, NaN where it does not rise, and the group's parameters."""
    count = np.bincount(group)

    def mean(x):
        return np.bincount(group, x) / count

    log_mean, y_mean = mean(log), mean(y)
    spread = mean((log - log_mean[group]) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = mean((log - log_mean[group]) * (y - y_mean[group])) / spread
        slope = np.where((spread > LEAST_SPREAD**2) & (slope > 0), slope, np.nan)
    return slope, log_mean - y_mean / slope, np.stack([mean(x) for x in (np.ones_like(log), *logs.T)], axis=1)[:, 1:]


def predict(theta: Array, log: Array, logs: Array) -> Array:
    """The rate; theta is ln C and its exponents, then ln eta0 and its (none where it is shared)."""
    number = logs.shape[1]
    coefficient = jnp.exp(jnp.minimum(theta[0] + logs @ theta[1 : 1 + number], _GREATEST))
    onset = theta[1 + number] + (logs @ theta[2 + number :] if theta.size > 2 + number else 0.0)
    return coefficient * (log - onset)


@jax.jit
def _refined(start: Array, log: Array, y: Array, logs: Array, censored: Array, unit: Array) -> dict[str, Array]:
    """The minimum: theta, whether it converged, and there the residuals, the lanes that have one, and the Jacobian."""

    def rates(theta):
        return predict(theta, log, logs)

    theta, converged = nonlinear(rates, start, y, jnp.ones_like(y), censored)
    residual = residuals(rates(theta), y, censored)
    r_squared, aic = goodness(residual, y, unit, jnp.ones_like(censored), start.size)
    return {
        "theta": theta,
        "converged": converged,
        "residual": residual,
        "lanes": ~censored | (rates(theta) > 0),
        "jacobian": jax.jacfwd(rates)(theta),
        "r_squared": r_squared,
        "aic": aic,
    }
