"""The normal equations of a fit: the coefficients that it does not tell, and the covariance of those that it does."""

import jax.numpy as jnp
import numpy as np
from jax import Array

LEAST_SINGULAR = 1e-7
"""Of a Jacobian with columns of length one: below it coefficients cannot be told apart."""

LEAST_FREE = 1e-6
"""Of 1 − h, the share of a lane's noise that is left over as its residual."""


def inverse(jacobian: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """(J^T J)^-1, and which coefficients no lane tells, or none tells from others.

    **Arguments:** `jacobian`: (lanes, coefficients), finite.

    **Returns:** an array (coefficients, coefficients), None where a coefficient is not told; booleans (coefficients,).
    """
    lengths = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(lengths > 0, lengths, 1.0)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=len(jacobian) < len(lengths))
    singular = np.pad(singular, (0, len(lengths) - len(singular)))
    lost = singular < LEAST_SINGULAR * max(singular[0], np.finfo(float).tiny)
    untold = (directions[lost] ** 2).sum(axis=0) > LEAST_SINGULAR
    if lost.any():
        return None, untold
    half = directions.T / singular / lengths[:, None]
    return half @ half.T, untold


def covariance(inverse: Array, jacobian: Array, residual: Array, lanes: Array) -> Array:
    """Covariance of the coefficients, whatever the size of each lane's noise:

        (J^T J)^-1 J^T diag(r²/(1 − h)²) J (J^T J)^-1,  h the diagonal of J (J^T J)^-1 J^T

    The usual s² (J^T J)^-1 takes all lanes for equally noisy. With noise in proportion to the rate, as a rig's often
    is, its intervals for an onset beside the lanes are far too wide, and those for C can be too narrow; the two agree
    where lanes are equally noisy (HC3: MacKinnon and White 1985, "Some heteroskedasticity-consistent covariance matrix
    estimators with improved finite sample properties").

    **Arguments:** `inverse`: (J^T J)^-1; `jacobian`: (lanes, coefficients), `residual`: (lanes,), both zero where not
    in `lanes`.
    """
    half = jacobian @ inverse
    free = 1 - jnp.sum(half * jacobian, axis=1)
    spread = jnp.sqrt(jnp.sum(residual**2) / jnp.maximum(jnp.sum(lanes) - len(inverse), 1))
    # A lane that a coefficient hangs on alone is met exactly: the others say how noisy it may be.
    alone = free < LEAST_FREE
    noise = jnp.where(alone, spread, residual / jnp.where(alone, 1.0, free))
    weighted = half * noise[:, None]
    return weighted.T @ weighted
