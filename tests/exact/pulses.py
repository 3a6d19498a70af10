"""Forces on the bit in the penetration scene: smooth functions between given times."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass
class Pulses:
    """A pulse at each t = n/frequency: rectangular, or half-sine force sin(pi t/w)."""

    force: float
    frequency: float
    pulse_width: float
    pulse_shape: str = "rectangular"

    def since(self, t: float) -> tuple[Callable | None, float]:
        """Return the force from t on, smooth for all times (None: no force), and the time until which it holds."""
        n = math.floor(t * self.frequency + 1e-9)
        begin, end = n / self.frequency, n / self.frequency + self.pulse_width
        if t >= end - 1e-12:
            return None, (n + 1) / self.frequency
        if self.pulse_shape == "rectangular":
            return lambda times: self.force + 0 * times, end
        return lambda times: self.force * np.sin(np.pi * (times - begin) / self.pulse_width), end
