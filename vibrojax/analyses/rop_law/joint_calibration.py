"""The calibration of the joint law: least squares over all lanes, with what it takes to trust the coefficients."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.rop_law.least_squares import Flag, LaneFlags, LaneValues, Number, Theta, nonlinear, residuals
from vibrojax.analyses.rop_law.uncertainty import (
    ALL_CENSORED,
    CONFOUNDED,
    IDENTIFIED,
    LEAST_SPREAD,
    NO_SPREAD,
    NOT_CONVERGED,
    TOO_FEW_LANES,
    covariance,
    goodness,
    normal_inverse,
)
from vibrojax.compile.devices import precision
from vibrojax.models.arrays import Array

_GREATEST = 60.0  # of an exponent, so that a wild step does not overflow
_OUTSIDE = 1e-6  # share of a parameter outside the directions that the lanes span, from which on it is not identified

OnLanes = Float[np.ndarray, " lanes"]
Logs = Float[np.ndarray, "lanes parameters"]
"""Of the parameters over their reference, the mean of the seen lanes."""
Positions = Float[np.ndarray, "lanes directions"]
"""Of the lanes along the directions in which these logarithms vary."""
OfParameters = Float[np.ndarray, " parameters"]
Coefficients = Float[np.ndarray, " coefficients"]
"""Of the joint law: ln C and its exponents, ln eta0 and its exponents, 2 + 2 parameters."""


@dataclass(frozen=True)
class JointLaw:
    """The joint law at the reference, NaN with a `reason` where it is not identified.

    - `C` [m/s], `eta0` [1], their exponents, and the standard errors of all.
    - `reference`: of the parameters, each in its own unit.
    - `reason`, `exponent_reason`: indices into `REASONS`.
    - `confounded`: which `Coefficients` the lanes do not identify.
    """

    C: float
    C_stderr: float
    C_exponent: OfParameters
    C_exponent_stderr: OfParameters
    eta0: float
    eta0_stderr: float
    eta0_exponent: OfParameters
    eta0_exponent_stderr: OfParameters
    reference: OfParameters
    r_squared: float
    aic: float
    degrees_of_freedom: int
    reason: int
    exponent_reason: Int[np.ndarray, " parameters"]
    confounded: Bool[np.ndarray, " coefficients"]


@dataclass(frozen=True)
class _Fit:
    """Coefficients and standard errors, the rate in units of the greatest; or the `reason` why there are none."""

    reason: int
    coefficients: Coefficients
    errors: Coefficients
    confounded: Bool[np.ndarray, " coefficients"]
    degrees_of_freedom: int = 0
    r_squared: float = np.nan
    aic: float = np.nan


def calibrate(
    relief: OnLanes, rate: OnLanes, parameters: Float[np.ndarray, "lanes parameters"], shared: bool
) -> JointLaw:
    """The joint law by least squares over all lanes, those at zero rate censored.

    What is calibrated are exponents along the directions in which the parameters of the seen lanes vary; a parameter's
    exponent is identified where these hold the parameter.

    **Arguments:** `relief`, `rate` [m/s]; `parameters`: above 0, or NaN throughout where the data do not have one;
    `shared`: one eta0 for all.
    """
    number, seen = parameters.shape[1], rate > 0
    logs = np.log(parameters)
    centre = logs[seen].mean(axis=0) if seen.any() else np.full(number, np.nan)
    logs = np.nan_to_num(logs - centre)
    directions = _directions(logs[seen])
    within = (directions**2).sum(axis=0) > 1 - _OUTSIDE
    fit = _fit(relief, rate, logs, directions, within, shared)
    unit = rate.max(initial=0.0)
    C, eta0 = unit * np.exp(fit.coefficients[0]), np.exp(fit.coefficients[1 + number])
    varies = np.abs(logs).max(axis=0, initial=0.0) > LEAST_SPREAD
    return JointLaw(
        C=C,
        C_stderr=C * fit.errors[0],
        C_exponent=fit.coefficients[1 : 1 + number],
        C_exponent_stderr=fit.errors[1 : 1 + number],
        eta0=eta0,
        eta0_stderr=eta0 * fit.errors[1 + number],
        eta0_exponent=fit.coefficients[2 + number :],
        eta0_exponent_stderr=fit.errors[2 + number :],
        reference=np.exp(centre),
        r_squared=fit.r_squared,
        aic=fit.aic,
        degrees_of_freedom=fit.degrees_of_freedom,
        reason=fit.reason,
        exponent_reason=np.where(within, fit.reason, np.where(varies, CONFOUNDED, NO_SPREAD)),
        confounded=fit.confounded,
    )


def _directions(logs: Logs) -> Float[np.ndarray, "directions parameters"]:
    """An orthonormal basis of how the parameters vary over the lanes."""
    if not logs.size:
        return np.zeros((0, logs.shape[1]))
    _, singular, directions = np.linalg.svd(logs - logs.mean(axis=0), full_matrices=False)
    return directions[singular > LEAST_SPREAD * np.sqrt(len(logs))]


def _fit(
    relief: OnLanes,
    rate: OnLanes,
    logs: Logs,
    directions: Float[np.ndarray, "directions parameters"],
    within: Bool[np.ndarray, " parameters"],
    shared: bool,
) -> _Fit:
    """The coefficients by least squares along the directions; `within` says which parameters these hold."""
    expansion = _expansion(directions, shared)
    size, free = expansion.shape

    def without(reason: int, confounded: np.ndarray | None = None) -> _Fit:
        nothing = np.full(size, np.nan)
        return _Fit(reason, nothing, nothing, np.ones(size, bool) if confounded is None else confounded)

    log = np.log(relief)
    reason = _enough(log, rate, free)
    if reason != IDENTIFIED:
        return without(reason)
    unit = rate.max()
    y, censored, positions = rate / unit, rate == 0, logs @ directions.T
    with precision("float64"):
        refined = jax.device_get(_refined(_start(log, y, positions, shared), log, y, positions, censored, unit))
    lanes, jacobian = refined.lanes, refined.jacobian
    if not (np.isfinite(jacobian).all() and lanes.sum() > free):
        return without(NOT_CONVERGED)
    square, confounded = normal_inverse(jacobian[lanes])
    if square is None:
        return without(CONFOUNDED, (expansion[:, confounded] ** 2).sum(axis=1) > _OUTSIDE)
    if not refined.converged:
        return without(NOT_CONVERGED)
    with precision("float64"):
        square = np.asarray(covariance(square, jacobian[lanes], refined.residual[lanes], lanes[lanes]))
    errors = np.sqrt(np.einsum("ci,ij,cj->c", expansion, square, expansion))
    known = np.concatenate([[True], within, [True], within])
    coefficients, errors = (np.where(known, x, np.nan) for x in (expansion @ refined.theta, errors))
    freedom = int(lanes.sum() - free)
    return _Fit(IDENTIFIED, coefficients, errors, ~known, freedom, refined.r_squared.item(), refined.aic.item())


def _expansion(
    directions: Float[np.ndarray, "directions parameters"], shared: bool
) -> Float[np.ndarray, "coefficients free"]:
    """The matrix from what is calibrated to all coefficients; the onset's exponents are 0 where it is shared."""
    count, number = directions.shape
    matrix = np.zeros((2 + 2 * number, 2 + count * (1 if shared else 2)))
    matrix[0, 0] = matrix[1 + number, 1 + count] = 1
    matrix[1 : 1 + number, 1 : 1 + count] = directions.T
    if not shared:
        matrix[2 + number :, 2 + count :] = directions.T
    return matrix


def _enough(log: OnLanes, rate: OnLanes, free: int) -> int:
    """Whether there are lanes for `free` coefficients at all; the reason why not."""
    seen = rate > 0
    if not rate.size:
        return TOO_FEW_LANES
    if not seen.any():
        return ALL_CENSORED
    if seen.sum() <= free:
        return TOO_FEW_LANES
    return IDENTIFIED if np.ptp(log[seen]) > LEAST_SPREAD else NO_SPREAD


def _start(log: OnLanes, y: OnLanes, positions: Positions, shared: bool) -> Float[np.ndarray, " free"]:
    """Power laws through C and eta0 of straight lines in ln eta, one for every combination of parameters."""
    seen = y > 0
    every = np.zeros(seen.sum(), dtype=int)
    group = np.unique(positions[seen].round(9), axis=0, return_inverse=True)[1].ravel() if positions.shape[1] else every
    lines = _lines(log[seen], y[seen], positions[seen], group)
    if not np.isfinite(lines.slope).any():
        lines = _lines(log[seen], y[seen], positions[seen], every)
    slope, onset, at = lines
    rising = np.isfinite(slope)
    if not rising.any():  # the rate falls with the relief: begin with a C of one, and an onset below all lanes
        slope, onset, rising = np.ones_like(slope), np.full_like(onset, log.min() - 1), ~rising
    design = np.column_stack([np.ones(rising.sum()), at[rising]])
    coefficient = np.linalg.lstsq(design, np.log(slope[rising]), rcond=None)[0]
    if shared:
        return np.append(coefficient, np.median(onset[rising]))
    return np.append(coefficient, np.linalg.lstsq(design, onset[rising], rcond=None)[0])


class _Lines(NamedTuple):
    """Slope and ln eta0 of each group's straight line, NaN where it does not rise, and where the group lies."""

    slope: Float[np.ndarray, " groups"]
    onset: Float[np.ndarray, " groups"]
    at: Float[np.ndarray, "groups directions"]


def _lines(log: OnLanes, y: OnLanes, positions: Positions, group: Int[np.ndarray, " lanes"]) -> _Lines:
    count = np.bincount(group)

    def mean(x: OnLanes) -> Float[np.ndarray, " groups"]:
        return np.bincount(group, x) / count

    log_mean, y_mean = mean(log), mean(y)
    spread = mean((log - log_mean[group]) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = mean((log - log_mean[group]) * (y - y_mean[group])) / spread
        slope = np.where((spread > LEAST_SPREAD**2) & (slope > 0), slope, np.nan)
    at = np.stack([mean(x) for x in (np.ones_like(log), *positions.T)], axis=1)[:, 1:]
    return _Lines(slope, log_mean - y_mean / slope, at)


def predict(theta: Theta, log: LaneValues, positions: Float[Array, "lanes directions"]) -> LaneValues:
    """The rate; theta is ln C and its exponents, then ln eta0 and its (none where it is shared)."""
    number = positions.shape[1]
    coefficient = jnp.exp(jnp.minimum(theta[0] + positions @ theta[1 : 1 + number], _GREATEST))
    onset = theta[1 + number] + (positions @ theta[2 + number :] if theta.size > 2 + number else 0.0)
    return coefficient * (log - onset)


class _Refined(NamedTuple):
    """The minimum, and there the residuals, the lanes that have one, the Jacobian and the goodness."""

    theta: Theta
    converged: Flag
    residual: LaneValues
    lanes: LaneFlags
    jacobian: Float[Array, "lanes free"]
    r_squared: Number
    aic: Number


@jax.jit
def _refined(
    start: Theta,
    log: LaneValues,
    y: LaneValues,
    positions: Float[Array, "lanes directions"],
    censored: LaneFlags,
    unit: Number,
) -> _Refined:
    def rates(theta: Theta) -> LaneValues:
        return predict(theta, log, positions)

    theta, converged = nonlinear(rates, start, y, jnp.ones_like(y), censored)
    residual = residuals(rates(theta), y, censored)
    r_squared, aic = goodness(residual, y, unit, jnp.ones_like(censored), start.size)
    lanes = ~censored | (rates(theta) > 0)
    return _Refined(theta, converged, residual, lanes, jax.jacfwd(rates)(theta), r_squared, aic)
