"""Results in closed form: linear modes, friction laws, masses that hit a stop, and one blow on the contact.

"Table" and "eq." refer to the source.
"""

import numpy as np
from jaxtyping import Float

from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.physics.modes import empirical_frequency, natural_frequencies, striker
from vibrojax.physics.rock import ROCKS

Values = Float[np.ndarray, " values"]
Parameter = float | int | Values
"""One or several values of a parameter; expressions in `results.csv` may also contain integers."""

TABLE_5_1 = {"m1": 250.0, "k1": 156250.0}
TABLE_5_3 = {
    "k1": 250 * np.array([25.0, 25, 25, 25, 25, 25, 25, 33, 50, 66, 81]) ** 2,
    "beta": np.array([0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.4, 0.4, 0.4]),
    "gamma": np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.3, 0.1, 0.8, 0.75, 0.75, 0.75]),
}
SPEEDS = np.linspace(0.0, 5.0, 20001)
"""Sliding speeds [m/s] at which the friction laws are evaluated."""
LOSS_FACTORS = np.array([0.1, 0.3, 0.5, 0.7, 0.91])


def modes(**parameters: Parameter) -> Float[np.ndarray, "2 ..."]:
    """Return the lower and the upper natural frequency [rad/s], eq. 5.16; m1 and k1 default to Table 5.1."""
    return np.moveaxis(np.asarray(natural_frequencies(TABLE_5_1 | parameters)), -1, 0)


def mode_estimate(**parameters: Parameter) -> np.ndarray:
    """Return the empirical frequency [rad/s], eq. 5.17; m1 and k1 default to Table 5.1."""
    return np.asarray(empirical_frequency(TABLE_5_1 | parameters))


def second_spring(**parameters: float) -> float:
    """Return the stiffness k2 [N/m] of the striker's spring; m1 and k1 default to Table 5.1."""
    return float(striker(TABLE_5_1 | parameters)[1])


def mode_discrepancy() -> float:
    """Return the relative difference between eq. 5.16 and the eigenvalues of the linear system, for Table 5.1."""
    m1, k1 = TABLE_5_1.values()
    m2, k2 = map(float, striker(TABLE_5_1 | {"beta": 0.4, "gamma": 0.75}))
    matrix = np.array([[(k1 + k2) / m1, -k2 / m1], [-k2 / m2, k2 / m2]])
    frequencies = np.sqrt(np.sort(np.linalg.eigvals(matrix).real))
    return float(np.abs(frequencies / modes(beta=0.4, gamma=0.75) - 1).max())


def friction(law: str, speeds: Values = SPEEDS) -> Values:
    """Return the friction coefficient mu of a law at sliding speeds [m/s], with its default coefficients."""
    friction_law = FRICTION_LAWS[law]
    p = {name: np.asarray(parameter.default) for name, parameter in friction_law.parameters.items()}
    return np.asarray(friction_law.on_weight(speeds, p)) + 0.0 * speeds


def hammer_velocity(frequency: float | int, gap: float | int) -> float:
    """Return the impact velocity [m/s] of Tsaplin's hammer with one impact per period (eqs. 5.1, 5.2).

    There are two solutions; the faster one is returned. Between impacts at t = 0 and T

        x = A sin(w t + theta) − (1 + R) V/(2 w_n sin(w_n T/2)) cos(w_n (t − T/2))

    with A w cos(theta) = V (1 − R)/2 and A sin(theta) = gap + (1 + R) V cot(w_n T/2)/(2 w_n).
    """
    w, natural, drive, restitution = float(frequency), 10.0, 5.0, 0.5
    swing = drive / (natural**2 - w**2)
    slope, lean = (1 - restitution) / (2 * w), (1 + restitution) / (2 * natural * np.tan(natural * np.pi / w))
    a, b, c = slope**2 + lean**2, 2 * gap * lean, gap**2 - swing**2
    return float((-b + np.sqrt(b**2 - 4 * a * c)) / (2 * a))


def restitution_as_printed(xi: Values) -> Values:
    """Return the restitution by eq. 5.8 exactly as printed (misprint R29), for loss factors with real roots."""
    angle = np.arctan(-2 * xi * np.sqrt(1 - xi**2) / (1 - 2 * xi**2))
    return np.exp(-xi / np.sqrt(1 - 2 * xi**2) * angle) * np.sin(angle)


def core_stiffness(rock: str) -> float:
    """Return the stiffness [kN/mm] of a rock core (54 mm in diameter, 108 mm long), from its modulus in Table 4.5."""
    area, length = np.pi * 0.027**2, 0.108
    return ROCKS[rock].modulus * area / length / 1e6
