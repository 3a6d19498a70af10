"""Standard errors, R² and AIC of a fit, and the reasons for which they are not numbers."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.rop_law.least_squares import LaneFlags, LaneValues, Number
from vibrojax.models.arrays import Array

REASONS = (
    "identified",
    "too-few-lanes",
    "no-spread",
    "all-censored",
    "not-converged",
    "no-slope",
    "confounded",
    "constant-rates",
)
"""Reasons for a NaN. Only the joint law and friction use `confounded`; only R² uses `constant-rates`."""

IDENTIFIED, TOO_FEW_LANES, NO_SPREAD, ALL_CENSORED, NOT_CONVERGED, NO_SLOPE, CONFOUNDED, CONSTANT_RATES = range(
    len(REASONS)
)

LEAST_SPREAD = 1e-9
"""Standard deviation of ln(eta), of a parameter's logarithm, or of the rates over the greatest. Values that vary less
count as equal."""

LEAST_SINGULAR = 1e-7
"""Of a Jacobian with columns of length one: below it coefficients are confounded."""

LEAST_FREE = 1e-6
"""Of 1 − h, the share of a lane's noise that is left over as its residual."""

OFFSET = 0.05
"""Relative offset up to which a search is said to have ended in a minimum."""


def normal_inverse(
    jacobian: Float[np.ndarray, "lanes coefficients"],
) -> tuple[Float[np.ndarray, "coefficients coefficients"] | None, Bool[np.ndarray, " coefficients"]]:
    """(J^T J)^-1, None where coefficients are confounded; and which are confounded, or in no lane."""
    lengths = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(lengths > 0, lengths, 1.0)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=len(jacobian) < len(lengths))
    singular = np.pad(singular, (0, len(lengths) - len(singular)))
    lost = singular < LEAST_SINGULAR * max(singular[0], np.finfo(float).tiny)
    confounded = (directions[lost] ** 2).sum(axis=0) > LEAST_SINGULAR
    if lost.any():
        return None, confounded
    half = directions.T / singular / lengths[:, None]
    return half @ half.T, confounded


def covariance(
    inverse: Float[Array, "coefficients coefficients"],
    jacobian: Float[Array, "lanes coefficients"],
    residual: LaneValues,
    lanes: LaneFlags,
) -> Float[Array, "coefficients coefficients"]:
    """Covariance of the coefficients, whatever the size of each lane's noise:

        (J^T J)^-1 J^T diag(r²/(1 − h)²) J (J^T J)^-1,  h the diagonal of J (J^T J)^-1 J^T

    The usual s² (J^T J)^-1 takes all lanes for equally noisy. With noise in proportion to the rate, as a rig's often
    is, its intervals for an onset beside the lanes are far too wide, and those for C can be too narrow; the two agree
    where lanes are equally noisy (HC3: MacKinnon and White 1985, "Some heteroskedasticity-consistent covariance matrix
    estimators with improved finite sample properties").

    **Arguments:** `inverse`: (J^T J)^-1; `jacobian` and `residual`: both zero where not in `lanes`.
    """
    half = jacobian @ inverse
    free = 1 - jnp.sum(half * jacobian, axis=1)
    spread = jnp.sqrt(jnp.sum(residual**2) / jnp.maximum(jnp.sum(lanes) - len(inverse), 1))
    # A lane that a coefficient hangs on alone is met exactly: the others say how noisy it may be.
    alone = free < LEAST_FREE
    noise = jnp.where(alone, spread, residual / jnp.where(alone, 1.0, free))
    weighted = half * noise[:, None]
    return weighted.T @ weighted


def goodness(
    residual: LaneValues, rate: LaneValues, unit: Number | float, valid: LaneFlags, size: int
) -> tuple[Number, Number]:
    """Return R² and AIC = n ln(RSS/n) + 2 size over all valid lanes.

    R² is NaN if the rates do not vary. An RSS/n below one rounding of the greatest rate counts as that, so that the AIC
    of exact data is finite.

    **Arguments:** `residual` and `rate`: in units of `unit` [m/s], the greatest rate; zero where not valid.
    """
    n = jnp.sum(valid)
    squares = jnp.sum(residual**2)
    about_mean = jnp.sum(jnp.where(valid, (rate - jnp.sum(rate) / n) ** 2, 0.0))
    mean_square = jnp.maximum(squares / n, jnp.finfo(rate.dtype).eps ** 2)
    varies = about_mean > n * LEAST_SPREAD**2
    r_squared = jnp.where(varies, 1 - squares / jnp.where(varies, about_mean, 1.0), jnp.nan)
    return r_squared, n * (jnp.log(mean_square) + 2 * jnp.log(unit)) + 2 * size


def r_squared_reason(r_squared: Float[np.ndarray, "*fits"], reason: Int[np.ndarray, "*fits"]) -> np.ndarray:
    """Return why R² is NaN, as indices into `REASONS`; `reason` says the same of the coefficients."""
    fitted = np.isin(reason, (IDENTIFIED, NO_SLOPE))
    return np.where(np.isfinite(r_squared), IDENTIFIED, np.where(fitted, CONSTANT_RATES, reason))


def at_minimum(
    jacobian: Float[np.ndarray, "lanes coefficients"], residual: Float[np.ndarray, " lanes"], freedom: int
) -> bool:
    """Whether the residual has no part along the Jacobian to speak of (the relative offset of Bates and Watts 1981).

    The motion's own kinks keep a search from the final digits; what matters is that another step would be small beside
    the standard errors.
    """
    basis = np.linalg.qr(jacobian)[0]
    along = basis @ (basis.T @ residual)
    across = np.linalg.norm(residual - along) / np.sqrt(freedom)
    return bool(np.linalg.norm(along) / np.sqrt(jacobian.shape[1]) <= OFFSET * across + np.finfo(float).eps)
