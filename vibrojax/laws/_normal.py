"""The normal equations of a fit: the inverse that gives its covariance, and the coefficients that it does not tell."""

import numpy as np

LEAST_SINGULAR = 1e-7
"""Of a Jacobian with columns of length one: below it coefficients cannot be told apart."""


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
