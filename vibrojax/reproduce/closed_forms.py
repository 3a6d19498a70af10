"""Results known in closed form: linear modes, friction laws, struck masses, and one blow on the contact."""

import numpy as np
from jaxtyping import Float

from vibrojax.models.physics.friction import FRICTION_LAWS
from vibrojax.models.physics.modes import empirical_frequency, natural_frequencies, striker
from vibrojax.models.physics.rock import ROCKS
from vibrojax.reproduce.struck_mass import Blows

Values = Float[np.ndarray, " values"]
Parameter = float | int | Values
"""Values of a parameter; the expressions of `results.csv` have whole numbers too."""

TABLE_5_1 = {"m1": 250.0, "k1": 156250.0}
TABLE_5_3 = {
    "k1": 250 * np.array([25.0, 25, 25, 25, 25, 25, 25, 33, 50, 66, 81]) ** 2,
    "beta": np.array([0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.4, 0.4, 0.4]),
    "gamma": np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.3, 0.1, 0.8, 0.75, 0.75, 0.75]),
}
SPEEDS = np.linspace(0.0, 5.0, 20001)
"""Sliding speeds [m/s] at which the friction laws are compared."""
LOSS_FACTORS = np.array([0.1, 0.3, 0.5, 0.7, 0.91])


def modes(**parameters: Parameter) -> Float[np.ndarray, "2 ..."]:
    """Return the natural frequencies [rad/s] of eq. 5.16, lower first, with m1 and k1 of Table 5.1 by default."""
    return np.moveaxis(np.asarray(natural_frequencies(TABLE_5_1 | parameters)), -1, 0)


def mode_estimate(**parameters: Parameter) -> np.ndarray:
    """Return the frequency [rad/s] of eq. 5.17, with m1 and k1 of Table 5.1 by default."""
    return np.asarray(empirical_frequency(TABLE_5_1 | parameters))


def second_spring(**parameters: float) -> float:
    """Return k2 [N/m], with m1 and k1 of Table 5.1 by default."""
    return float(striker(TABLE_5_1 | parameters)[1])


def mode_discrepancy() -> float:
    """Return the relative difference of eq. 5.16 from the eigenvalue problem, for Table 5.1."""
    m1, k1 = TABLE_5_1.values()
    m2, k2 = map(float, striker(TABLE_5_1 | {"beta": 0.4, "gamma": 0.75}))
    matrix = np.array([[(k1 + k2) / m1, -k2 / m1], [-k2 / m2, k2 / m2]])
    frequencies = np.sqrt(np.sort(np.linalg.eigvals(matrix).real))
    return float(np.abs(frequencies / modes(beta=0.4, gamma=0.75) - 1).max())


def friction(law: str, speeds: Values = SPEEDS) -> Values:
    """Return mu at sliding speeds [m/s], with the law's default coefficients."""
    friction_law = FRICTION_LAWS[law]
    p = {name: np.asarray(parameter.default) for name, parameter in friction_law.parameters.items()}
    return np.asarray(friction_law.on_weight(speeds, p)) + 0.0 * speeds


def mean_period(mass: Blows) -> float:
    """Return the mean time [s] between impacts."""
    return float(np.diff(mass.times).mean())


def free_period_ratio(gap: Values) -> Values:
    """Return the period of the free oscillator over that without the stop, for gaps in amplitudes (Fig. 5.7)."""
    return 0.5 + np.arcsin(gap) / np.pi


def hammer_velocity(frequency: float | int, gap: float | int) -> float:
    """Return the impact velocity [m/s] of Tsaplin's hammer, one impact a period, the faster solution (eqs. 5.1, 5.2).

    Between impacts at t = 0 and T

        x = A sin(w t + theta) − (1 + R) V/(2 w_n sin(w_n T/2)) cos(w_n (t − T/2))

    with A w cos(theta) = V (1 − R)/2 and A sin(theta) = gap + (1 + R) V cot(w_n T/2)/(2 w_n).
    """
    w, natural, drive, restitution = float(frequency), 10.0, 5.0, 0.5
    swing = drive / (natural**2 - w**2)
    slope, lean = (1 - restitution) / (2 * w), (1 + restitution) / (2 * natural * np.tan(natural * np.pi / w))
    a, b, c = slope**2 + lean**2, 2 * gap * lean, gap**2 - swing**2
    return float((-b + np.sqrt(b**2 - 4 * a * c)) / (2 * a))


def restitution_as_printed(xi: Values) -> Values:
    """Return eq. 5.8 as it is printed (R29), for loss factors at which its roots are real."""
    angle = np.arctan(-2 * xi * np.sqrt(1 - xi**2) / (1 - 2 * xi**2))
    return np.exp(-xi / np.sqrt(1 - 2 * xi**2) * angle) * np.sin(angle)


def core_stiffness(rock: str) -> float:
    """Return the stiffness [kN/mm] of a core of 54 by 108 mm, from its Young's modulus (Table 4.5)."""
    area, length = np.pi * 0.027**2, 0.108
    return ROCKS[rock].modulus * area / length / 1e6


def rock_mode(k3: Values) -> Values:
    """Return sqrt(k3/m1) [Hz]."""
    return np.sqrt(k3 / 250) / (2 * np.pi)
