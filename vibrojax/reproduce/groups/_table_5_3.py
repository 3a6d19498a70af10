"""Table 5.3 as printed: parameters, both formulas' columns and the simulation's, in rad/s and m/s."""

from typing import NamedTuple


class Row(NamedTuple):
    """A row; m1 = 250 kg, c2 = 250 N s/m."""

    w1: float
    v: float
    beta: float
    gamma: float
    eq_5_16: float
    eq_5_17: float
    simulation: float


ROWS = (
    Row(25, 1.5, 0.3, 0.9, 30.8, 30.0, 30.7),
    Row(25, 1.5, 0.3, 0.8, 29.1, 29.0, 29.0),
    Row(25, 1.5, 0.3, 0.7, 27.8, 28.0, 27.6),
    Row(25, 1.5, 0.3, 0.6, 26.8, 27.3, 26.7),
    Row(25, 1.5, 0.3, 0.5, 26.1, 26.6, 26.0),
    Row(25, 1.5, 0.3, 0.3, 25.3, 25.6, 25.2),
    Row(25, 1.5, 0.3, 0.1, 25.0, 25.0, 24.8),
    Row(33, 0.8, 0.3, 0.8, 38.5, 38.4, 38.3),
    Row(50, 1.5, 0.4, 0.75, 58.7, 58.4, 58.6),
    Row(66, 0.8, 0.4, 0.75, 79.6, 78.5, 79.6),
    Row(81, 1.0, 0.4, 0.75, 95.1, 94.7, 95.0),
)
