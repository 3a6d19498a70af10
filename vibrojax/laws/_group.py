"""One form fitted to the lanes of one group: coefficients, their standard errors, goodness, and whether it can be told.

Everything is of fixed shape, so that a jitted program fits all groups at once (vmap); lanes that are not valid have no
weight.
"""

import jax
import jax.numpy as jnp
from jax import Array

from vibrojax.laws._forms import Form
from vibrojax.laws._least_squares import linear, nonlinear, residuals
from vibrojax.laws._normal import covariance
from vibrojax.laws._robust import LOSSES, Loss, reweighted

REASONS = ("identified", "too-few-lanes", "no-spread", "all-censored", "not-converged", "no-slope", "confounded")
"""Why a coefficient is NaN; `confounded` is of the joint law alone."""

IDENTIFIED, TOO_FEW_LANES, NO_SPREAD, ALL_CENSORED, NOT_CONVERGED, NO_SLOPE, CONFOUNDED = range(len(REASONS))

LEAST_SPREAD = 1e-9
"""Of ln(eta): below it all reliefs are equal."""

LEAST_SLOPE = 1e-10
"""Change of the rate over the lanes as a share of the greatest rate: below it there is no onset to be found."""

LEAST_SLOPE_IN_ERRORS = 2.0
"""The same in standard errors of that change: an interval of the onset (Fieller's) then has no ends."""


def fit_group(form: Form, relief: Array, rate: Array, valid: Array, robust: str | None) -> dict[str, Array]:
    """Fit `form` to the valid lanes; a lane at zero rate is censored.

    **Arguments:** `relief` [1], `rate` [m/s], `valid`: (lanes,), finite and relief above zero where valid;
    `robust`: a name in `LOSSES`.

    **Returns:** C [m/s], eta0, exponent, each with `_stderr`; r_squared, aic, degrees_of_freedom, used, reason.
    """
    relief, rate = jnp.where(valid, relief, 1.0), jnp.where(valid, rate, 0.0)
    censored, seen = valid & (rate == 0), valid & (rate > 0)
    unit = jnp.max(rate)
    y = rate / unit
    t = form.variable(relief)
    frame = form.frame(t, seen)
    z = (t - frame.centre) / frame.spread

    def residual(theta):
        predicted = form.predict(theta, z)
        return jnp.where(valid, residuals(predicted, y, censored), 0.0), seen | (censored & (predicted > 0))

    def solve(weight, start):
        if form.linear:
            return linear(form.columns(z), y, weight, censored)
        return nonlinear(lambda theta: form.predict(theta, z), start, y, weight, censored)

    start = None if form.linear else form.start(z, y, seen)
    theta, converged = solve(valid * 1.0, start)
    loss = LOSSES[robust] if robust else None
    if loss:
        theta, scale, settled = reweighted(loss, solve, residual, theta, valid)
        converged &= settled
    found, lanes = residual(theta)
    square, freedom = _covariance(form, theta, z, found, lanes, (loss, scale) if loss else None)
    values, errors = _coefficients(form, theta, frame, unit, square)

    used = jnp.sum(valid)
    spread = jnp.std(jnp.log(relief), where=seen)
    reason = jnp.select(
        [used == 0, ~jnp.any(seen), jnp.sum(seen) <= form.size, ~(spread > LEAST_SPREAD), ~converged | (freedom <= 0)],
        [TOO_FEW_LANES, ALL_CENSORED, TOO_FEW_LANES, NO_SPREAD, NOT_CONVERGED],
        IDENTIFIED,
    )
    known = reason == IDENTIFIED
    values, errors = jnp.where(known, values, jnp.nan), jnp.where(known, errors, jnp.nan)
    if form.linear and form.size == 2:  # a level line has a C of about zero, but no onset
        least = jnp.maximum(LEAST_SLOPE, LEAST_SLOPE_IN_ERRORS * jnp.sqrt(square[1, 1]))
        level = (jnp.abs(theta[1]) <= least) | ~jnp.isfinite(values[1])
        onset = jnp.array([False, True, False]) & level
        values, errors = jnp.where(onset, jnp.nan, values), jnp.where(onset, jnp.nan, errors)
        reason = jnp.where(known & level, NO_SLOPE, reason)
    r_squared, aic = goodness(found, y, unit, valid, form.size)
    names = ("C", "eta0", "exponent")
    return {
        **dict(zip(names, values, strict=True)),
        **{f"{name}_stderr": error for name, error in zip(names, errors, strict=True)},
        "r_squared": jnp.where(known, r_squared, jnp.nan),
        "aic": jnp.where(known, aic, jnp.nan),
        "degrees_of_freedom": jnp.where(known, freedom, 0),
        "used": used,
        "reason": reason,
    }


def goodness(residual: Array, y: Array, unit: Array, valid: Array, size: int) -> tuple[Array, Array]:
    """R² and AIC = n ln(RSS/n) + 2 size over all valid lanes.

    **Arguments:** `residual` and `y`: in units of `unit` [m/s], zero where not valid.
    """
    n = jnp.sum(valid)
    squares = jnp.sum(residual**2)
    about_mean = jnp.sum(jnp.where(valid, (y - jnp.sum(y) / n) ** 2, 0.0))
    # Exact data leave rounding alone; its logarithm must not become infinite.
    mean_square = jnp.maximum(squares / n, jnp.finfo(y.dtype).eps ** 2)
    r_squared = jnp.where(about_mean > 0, 1 - squares / about_mean, jnp.nan)
    return r_squared, n * (jnp.log(mean_square) + 2 * jnp.log(unit)) + 2 * size


def _covariance(
    form: Form, theta: Array, z: Array, residual: Array, lanes: Array, robust: tuple[Loss, Array] | None
) -> tuple[Array, Array]:
    """Covariance of theta over the lanes that have a residual, and how many more than coefficients these are.

    A censored lane below the onset pins nothing, so it is in neither. For a robust loss Huber's psi over the mean of
    its slope stands for the residual.
    """
    jacobian = jax.jacfwd(lambda theta: form.predict(theta, z))(theta) * lanes[:, None]
    count = jnp.sum(lanes)
    if robust:
        loss, scale = robust
        scaled = residual / scale
        slope = jnp.sum(jnp.where(lanes, loss.slope(scaled), 0.0)) / count
        residual = residual * loss.weight(scaled) / slope
    residual = jnp.where(lanes, residual, 0.0)
    return covariance(jnp.linalg.inv(jacobian.T @ jacobian), jacobian, residual, lanes), count - form.size


def _coefficients(form: Form, theta: Array, frame, unit: Array, square: Array) -> tuple[Array, Array]:
    """C, eta0 and exponent, and their standard errors by the delta method; NaN where the form has none."""

    def coefficients(theta):
        return form.coefficients(theta, frame) * jnp.array([unit, 1.0, 1.0])

    values, slopes = coefficients(theta), jax.jacfwd(coefficients)(theta)
    errors = jnp.sqrt(jnp.einsum("ci,ij,cj->c", slopes, square, slopes))
    return values, jnp.where(jnp.isnan(values), jnp.nan, errors)
