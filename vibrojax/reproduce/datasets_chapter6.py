"""What is computed for chapter 6: the bit on rock under given pulses and a swept sine, the law, the whole drill."""

from collections.abc import Iterable, Mapping

import numpy as np

from vibrojax.models.physics.contact import contact_time
from vibrojax.reproduce.needs import ALL_STARTS, Lane, Map, Shared, grid, lane, motion

FREQUENCIES = (10.0, 20.0, 30.0, 40.0)
SETTLE, OBSERVE = 1.0, 1.0


def pulses(*shared: Shared, **parameters: float) -> Lane:
    """A point under pulses, which soon repeats."""
    return lane("penetration", *shared, parameters, settle=SETTLE, observe=OBSERVE)


def _penetration(name: str, axes: Mapping[str, Iterable[float]], **parameters: float) -> Map:
    return grid(name, "penetration", axes, parameters, settle=SETTLE, observe=OBSERVE)


# Forced penetration.
SWEPT_STIFFNESSES = (100e6, 300e6, 500e6)
_SWEPT: Shared = {
    "pulse_shape": "sweep",
    "force": 70e3,
    "bias": 60e3,
    "sweep_start": 10.0,
    "sweep_rate": 20.0,
    "zeta": 0.3,
}
SWEEPS = tuple(motion("penetration", 20.0, _SWEPT, k3=k3) for k3 in SWEPT_STIFFNESSES)
TABLE_6_1 = {"frequency": 40.0, "force": 300e3, "threshold": 150e3, "k3": 100e6}
STEPS = {zeta: motion("penetration", 0.3, TABLE_6_1, zeta=zeta) for zeta in (0.5, 1.0, 1.5)}
VERY_SOFT = tuple(pulses(k3=k3, force=force, zeta=0.5, frequency=10.0) for k3 in (1e4, 1e5) for force in (150e3, 250e3))
SOFT_AND_HARD = {k3: motion("penetration", 0.5, k3=k3, zeta=0.5, frequency=10.0, force=150e3) for k3 in (1e5, 1e8)}
ONSET_STIFFNESSES = tuple(float(k3) for k3 in np.round(np.geomspace(1e4, 1e8, 41), -2))
ONSET = tuple(pulses(k3=k3, force=150e3, zeta=0.5, frequency=10.0) for k3 in ONSET_STIFFNESSES)
SOFT_STIFFNESSES = (10e6, 20e6, 30e6, 40e6, 50e6)
SOFT_ROCKS = tuple(pulses(force=300e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in SOFT_STIFFNESSES)
STIFFNESSES = (100e6, 200e6, 300e6, 400e6, 500e6)
OVER_STIFFNESS = {
    (force, threshold): tuple(
        pulses(force=force, threshold=threshold, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES
    )
    for force, threshold in ((150e3, 150e3), (300e3, 250e3))
}
OVER_STIFFNESS_AT_200 = tuple(pulses(force=200e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES)
STIFFNESS_MAP = _penetration(
    "penetration over stiffness",
    {"frequency": FREQUENCIES, "k3": np.linspace(50e6, 500e6, 46)},
    force=200e3,
    zeta=1.1,
)
OVER_FREQUENCY = {
    (force, k3): tuple(pulses(force=force, k3=k3, zeta=1.1, frequency=frequency) for frequency in FREQUENCIES)
    for force, k3 in ((250e3, 300e6), (300e3, 500e6), (150e3, 100e6), (300e3, 100e6))
}
OVER_THRESHOLD = tuple(pulses(force=300e3, k3=500e6, zeta=1.1, frequency=20.0, threshold=50e3 * n) for n in range(1, 6))
FORCE_MAP = _penetration(
    "penetration over frequency and force",
    {"k3": (100e6, 500e6), "force": np.linspace(100e3, 300e3, 21), "frequency": np.linspace(10, 40, 13)},
    zeta=1.1,
)
THRESHOLD_MAP = _penetration(
    "penetration over threshold",
    {"threshold": np.linspace(50e3, 250e3, 9), "frequency": np.linspace(10, 40, 7)},
    force=300e3,
    k3=500e6,
    zeta=1.1,
)

# The law of the rate of penetration.
_FORCES = (200e3, 250e3, 300e3)
CONSTANT_MAP = _penetration(
    "rate constant",
    {"pulse_width": (0.002, 0.004), "k3": (300e6, 500e6), "force": _FORCES, "frequency": FREQUENCIES},
    zeta=0.6,
)
DAMPINGS = (0.5, 0.6, 0.9, 1.1, 1.5)
CONSTANT_OVER_DAMPING = _penetration(
    "rate constant over damping",
    {"zeta": DAMPINGS, "k3": (300e6, 500e6), "force": _FORCES, "frequency": FREQUENCIES},
)
RATE_ALONG_FORCE = _penetration(
    "rate along force",
    {"k3": (300e6, 500e6), "frequency": (20.0,), "force": np.linspace(100e3, 300e3, 21)},
    zeta=0.6,
)
SOFT_MAP = _penetration(
    "soft rock of Fig 6.27",
    {"zeta": (0.5, 0.6, 0.9, 1.1), "frequency": np.linspace(10, 40, 7)},
    force=200e3,
    k3=50e6,
)

# The whole drill.
K1, K2, M2 = 246490.0, 55460.0, 100.0
TABLE_6_6 = {
    "k0": 20e6,
    "c0": 10.0,
    "k1": K1,
    "gamma": float(np.sqrt((K2 / M2) / (K1 / 250.0))),
    "beta": 0.4,
    "zeta": 1.5,
    "k3": 300e6,
    "threshold": 50e3,
}
WITHOUT_ROCK = {name: value for name, value in TABLE_6_6.items() if name not in ("zeta", "k3", "threshold")}
BLOW = float(contact_time(M2, 20e6, 10.0))
"""Duration [s] of a blow on the contact of Table 6.6."""


def drill(*, start: str = "drive", **parameters: float) -> Lane:
    """A point of the whole drill, that of Table 6.6 where nothing is said."""
    return lane("drilling", TABLE_6_6, parameters, start=start)


DRILLING = motion("drilling", 8.0, TABLE_6_6)
SINGLE_IMPACT_GAPS = (-0.005, 0.0, 0.005)
WIDE_GAPS = (0.010, 0.015, 0.020)
OVER_GAP = tuple(drill(start="stuck", delta=gap) for gap in SINGLE_IMPACT_GAPS)
OVER_WIDE_GAP = tuple(drill(start="stuck", delta=gap) for gap in WIDE_GAPS)
DRILLED_STIFFNESSES = (100e6, 300e6, 500e6)
DRILLED = tuple(drill(k3=k3) for k3 in DRILLED_STIFFNESSES)
SPEED_MAP = grid(
    "drill over speed",
    "drilling",
    {"k3": DRILLED_STIFFNESSES, "v": np.linspace(0.5, 2.5, 17)},
    {name: value for name, value in TABLE_6_6.items() if name != "k3"},
    starts=ALL_STARTS,
)
_HALF_SINE: Shared = {"pulse_shape": "half-sine", "force": 470e3, "pulse_width": BLOW, "frequency": 5.8}
TABLE_6_7 = tuple(pulses(_HALF_SINE, threshold=250e3, zeta=1.5, k3=k3) for k3 in DRILLED_STIFFNESSES)
ROCK_MOVES_BIT = lane("coupled-drilling", TABLE_6_6)
"""With the bit's normal motion fed back to the drill."""
STRIKING_ONLY = lane("vibro-impact", WITHOUT_ROCK)
"""Without penetration."""
