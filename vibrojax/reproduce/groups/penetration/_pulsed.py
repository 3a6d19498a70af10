"""Points and measures of penetration under pulses."""

import numpy as np

from vibrojax.reproduce._needs import lane

RUN = {"settle": 1.0, "observe": 1.0}
PULSE = ("R10",)
FREQUENCIES = (10.0, 20.0, 30.0, 40.0)


def pulses(**parameters):
    return lane("penetration", settle=1.0, observe=1.0, **parameters)


def speed(one) -> float:
    """Rate of penetration [mm/s]."""
    return 1e3 * one["rate_of_penetration"]


def straightness(x: np.ndarray, y: np.ndarray) -> float:
    """R² of a straight line."""
    return float(np.corrcoef(x, y)[0, 1] ** 2) if np.ptp(y) > 0 else 1.0
