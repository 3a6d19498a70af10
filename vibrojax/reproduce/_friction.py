"""The friction laws of chapters 3 and 5 as curves."""

import numpy as np

from vibrojax.physics.friction import FRICTION_LAWS

LAWS = ("coulomb", "popp-exponential", "popp-arctan", "hyperbolic", "hyperbolic-quadratic", "stribeck")


def curve(law: str, speeds: np.ndarray) -> np.ndarray:
    """mu at sliding speeds [m/s], with the law's default coefficients."""
    found = FRICTION_LAWS[law]
    p = {name: np.asarray(parameter.default) for name, parameter in found.parameters.items()}
    return np.asarray(found.on_weight(speeds, p)) + 0.0 * speeds
