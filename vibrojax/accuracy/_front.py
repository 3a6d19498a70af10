"""The Pareto front: the settings that no other one beats in both time and error."""

import numpy as np


def pareto(time, error) -> np.ndarray:
    """Whether each point is on the front; points that are not finite never are.

    On it is a point than which no other is faster and at least as exact, or more exact and at least as fast.
    """
    time, error = np.asarray(time, float), np.asarray(error, float)
    finite = np.isfinite(time) & np.isfinite(error)
    quicker = (time[:, None] <= time) & (error[:, None] < error)
    finer = (time[:, None] < time) & (error[:, None] <= error)
    beaten = np.any((quicker | finer) & finite[:, None], axis=0)
    return finite & ~beaten
