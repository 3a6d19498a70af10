"""Parameters with the model's names, units (SI) and defaults (section 1, 2 and 3 of the model), and given forces."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

DRILL = {"m1": 250.0, "beta": 0.4, "gamma": 0.75, "k1": 156250.0, "c2": 250.0, "g": 9.81, "v": 1.5}
DRILL |= {"friction": "stribeck", "mu": 0.4, "v_cr": 3.0}  # R4
DRILL |= {"popp_c1": -0.02, "popp_c2": -0.25, "a1": 0.14, "a2": 1.14, "b1": 2.0, "b2": 100.0}
DRILL |= {"mu0": 0.4, "mu1": 0.1, "delta_f": 1.0, "lambda": 99.4, "alpha": 0.7}
CONTACT = {"k0": 50e6, "c0": 0.1, "delta": -0.005}  # R3
SANDSTONE = {"threshold": 61.9e3, "k3": 100.68e6}
PENETRATION = {"m1": 250.0, "force": 200e3, "frequency": 20.0, "threshold": 150e3, "k3": 300e6, "zeta": 1.1}
PENETRATION |= {"pulse_width": 4e-3, "pulse_shape": "rectangular"}  # R10
DEFAULTS = {
    "rotary": DRILL,
    "vibro-impact": DRILL | CONTACT,
    "penetration": PENETRATION,
    "drilling": DRILL | CONTACT | SANDSTONE | {"zeta": 1.5},
    "coupled-drilling": DRILL | CONTACT | SANDSTONE | {"zeta": 1.5},
}


def parameters(scene: str, **given) -> SimpleNamespace:
    """Return the parameters of a scene and the derived `m2`, `k2` (= beta m1 (gamma w1)^2) and `c3` (6.1)."""
    unknown = set(given) - set(DEFAULTS[scene])
    if unknown:
        raise ValueError(f"the scene {scene} has no {', '.join(sorted(unknown))}")
    p = SimpleNamespace(**(DEFAULTS[scene] | given))
    if "beta" in DEFAULTS[scene]:
        p.m2 = p.beta * p.m1
        p.k2 = p.beta * p.m1 * p.gamma**2 * p.k1 / p.m1
    if "k3" in DEFAULTS[scene]:
        p.c3 = 2 * p.zeta * math.sqrt(p.m1 * p.k3)
    return p


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
