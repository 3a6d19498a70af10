"""A mass on a spring that hits a stop: one system for the classical examples reviewed in chapter 5 of the source.

    x'' + w_n² x = (F/m) sin(w t) + g,   x <= gap;   at x = gap: x'(+) = −R x'(−)

With F = 0, this is the free vibro-impact oscillator (Fig. 5.7); with w_n = 0, the ball thrown by a force (eq. 5.3);
otherwise, Tsaplin's driven hammer (eqs. 5.1, 5.2).
"""

from functools import cache

import numpy as np

from vibrojax.physics.elementary import sin
from vibrojax.systems.events import Impact
from vibrojax.systems.system import System

STRUCK = "struck"
"""Name of the system in the computations of `source.toml`."""

EXACT = 1e-9
"""Accepted relative error of its motions, which are compared with closed forms."""


@cache
def struck_mass() -> System:
    """Return the system of a mass and a stop."""
    return System(
        STRUCK,
        states={"x": "m", "v": "m s-1"},
        parameters={
            "natural": (10.0, "rad s-1"),
            "drive": (0.0, "m s-2"),
            "frequency": (10.0, "rad s-1"),
            "pull": (0.0, "m s-2"),
            "restitution": 1.0,
            "gap": (0.0, "m"),
        },
        field=lambda t, y, p: {
            "x": y["v"],
            "v": p["drive"] * sin(p["frequency"] * t) + p["pull"] - p["natural"] * p["natural"] * y["x"],
        },
        period=lambda p: 2 * np.pi / p["frequency"],
        events=[Impact("stop", lambda t, y, p: p["gap"] - y["x"], "v", lambda p: p["restitution"])],
    )
