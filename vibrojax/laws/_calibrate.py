"""The calibration of the joint law: least squares over all lanes, with what it takes to trust the coefficients."""

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

_GREATEST = 60.0  # of an exponent, so that a wild step does not overflow
_LEAST_SINGULAR = 1e-7  # of the Jacobian with columns of length one: below it coefficients cannot be told apart


def calibrated(relief: np.ndarray, rate: np.ndarray, logs: np.ndarray, shared: bool) -> dict:
    """The law's coefficients with standard errors, or why there are none.

    **Arguments:** `logs`: (lanes, parameters), of the parameters over their reference; `shared`: one eta0 for all.
    """
    number = logs.shape[1]
    nothing = np.full(2 + number + (0 if shared else number), np.nan)
    log, unit = np.log(relief), rate.max(initial=0.0)
    reason = _told_apart(log, rate, logs, nothing.size)
    if reason != IDENTIFIED:
        return _coefficients(nothing, nothing, number, unit, reason)
    y, censored = rate / unit, rate == 0
    with precision("float64"):
        found = jax.device_get(_refined(_start(log, y, logs, shared), log, y, logs, censored, unit))
    inverse, reason = _inverse(found["jacobian"][found["lanes"]])
    if reason == IDENTIFIED and not found["converged"]:
        reason = NOT_CONVERGED
    if reason != IDENTIFIED:
        return _coefficients(nothing, nothing, number, unit, reason)
    freedom = found["lanes"].sum() - nothing.size
    errors = np.sqrt((found["residual"] ** 2).sum() / freedom * np.diag(inverse))
    more = {name: found[name].item() for name in ("r_squared", "aic")} | {"degrees_of_freedom": np.int32(freedom)}
    return _coefficients(found["theta"], errors, number, unit, IDENTIFIED) | more


def _inverse(jacobian: np.ndarray) -> tuple[np.ndarray | None, int]:
    """(J^T J)^-1, or the reason why there is none."""
    lanes, size = jacobian.shape
    if lanes <= size or not np.isfinite(jacobian).all():
        return None, TOO_FEW_LANES if lanes <= size else NOT_CONVERGED
    lengths = np.linalg.norm(jacobian, axis=0)
    if not lengths.all():
        return None, CONFOUNDED
    _, singular, directions = np.linalg.svd(jacobian / lengths, full_matrices=False)
    if singular[-1] < _LEAST_SINGULAR * singular[0]:
        return None, CONFOUNDED
    half = directions.T / singular / lengths[:, None]
    return half @ half.T, IDENTIFIED


def _told_apart(log: np.ndarray, rate: np.ndarray, logs: np.ndarray, size: int) -> int:
    """Whether the lanes can tell the coefficients at all; the reason why not."""
    seen = rate > 0
    if not rate.size or (seen.any() and seen.sum() <= size):
        return TOO_FEW_LANES
    if not seen.any():
        return ALL_CENSORED
    if np.ptp(log[seen]) <= LEAST_SPREAD:
        return NO_SPREAD
    design = np.column_stack([np.ones(seen.sum()), logs[seen]])
    return IDENTIFIED if np.linalg.matrix_rank(design, tol=None) == design.shape[1] else CONFOUNDED


def _start(log: np.ndarray, y: np.ndarray, logs: np.ndarray, shared: bool) -> np.ndarray:
    """Power laws through C and eta0 of straight lines in ln eta, one for every combination of parameters."""
    seen = y > 0
    every = np.zeros(seen.sum(), dtype=int)
    group = np.unique(logs[seen], axis=0, return_inverse=True)[1].ravel() if logs.shape[1] else every
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


def _coefficients(theta: np.ndarray, errors: np.ndarray, number: int, unit: float, reason: int) -> dict:
    """The dataset's variables; of a theta of NaN, NaN."""
    c, eta0 = unit * np.exp(theta[0]), np.exp(theta[1 + number])
    free = theta.size > 2 + number or not number
    none = np.full(number, np.nan if reason != IDENTIFIED else 0.0)
    return {
        "C": c,
        "C_stderr": c * errors[0],
        "C_exponent": theta[1 : 1 + number],
        "C_exponent_stderr": errors[1 : 1 + number],
        "eta0": eta0,
        "eta0_stderr": eta0 * errors[1 + number],
        "eta0_exponent": theta[2 + number :] if free else none,
        "eta0_exponent_stderr": errors[2 + number :] if free else none,
        "r_squared": np.nan,
        "aic": np.nan,
        "degrees_of_freedom": np.int32(0),
        "reason": np.int8(reason),
    }
