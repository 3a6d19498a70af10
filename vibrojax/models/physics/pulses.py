"""Parameters of the prescribed force on the bit (pulses or a swept sine), and the mean force of pulses."""

from collections.abc import Mapping
from math import pi
from typing import Any

from vibrojax.models.physics.parameters import Parameter, not_negative, positive, table

PULSES = table(
    not_negative("force", 200e3, "N", "greatest force of a pulse", "A", (50e3, 500e3)),
    positive("frequency", 20.0, "s-1", "pulses per second", "f", (10.0, 40.0)),
    positive("pulse_width", 4e-3, "s", "duration of a pulse", "w", (1e-3, 10e-3)),
)

SWEEP = table(
    not_negative("force", 200e3, "N", "amplitude of the swept sine", "A", (50e3, 500e3)),
    not_negative("sweep_start", 0.0, "s-1", "frequency of the swept sine at t = 0", "f₀", (0.0, 100.0)),
    Parameter("sweep_rate", 10.0, "s-2", "rate of the swept sine's frequency", "r"),
    Parameter("bias", 0.0, "N", "constant part of the force", "B", usual=(20e3, 100e3)),
)


def mean_force(p: Mapping[str, Any], shape: str) -> Any:
    """Return the mean force P [N] of pulses over one period: A w f for rectangles, (2/pi) A w f for half-sines.

    `p` has the force amplitude A, the pulse width w and the pulse frequency f.
    """
    mean = p["force"] * p["pulse_width"] * p["frequency"]
    return mean * (2 / pi) if shape == "half-sine" else mean
