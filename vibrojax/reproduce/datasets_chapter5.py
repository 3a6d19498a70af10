"""What is computed for chapters 3 and 5: friction laws, struck masses, self-excitation, impact and its region."""

from typing import NamedTuple

import numpy as np

from vibrojax.reproduce.needs import ALL_STARTS, SETTLE, Lane, Motion, Shared, grid, lane, motion, struck


class Row(NamedTuple):
    """A row of Table 5.3 as printed, in rad/s and m/s; m1 = 250 kg, c2 = 250 N s/m."""

    w1: int
    v: float
    beta: float
    gamma: float
    eq_5_16: float
    eq_5_17: float
    simulation: float

    @property
    def modes(self) -> dict[str, float]:
        """The parameters of the linear modes."""
        return {"m1": 250.0, "k1": 250.0 * self.w1**2, "beta": self.beta, "gamma": self.gamma}


TABLE_5_1 = {"m1": 250.0, "k1": 156250.0, "beta": 0.4, "gamma": 0.75}
TABLE_5_3 = (
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

# Friction laws.
LAWS = ("coulomb", "popp-exponential", "popp-arctan", "hyperbolic", "hyperbolic-quadratic", "stribeck")
_REGIME_AXES = {
    "beta": np.round(np.arange(0.2, 0.801, 0.1), 2),
    "gamma": np.round(np.arange(0.5, 1.001, 0.1), 2),
}
REGIMES = tuple(
    grid(f"regimes under {law}", "vibro-impact", _REGIME_AXES, starts=ALL_STARTS, friction=law) for law in LAWS
)
"""From all starts, so that the source's own law needs no program of its own."""
FALLING = {"coulomb": 1.5, "popp-exponential": 1.5, "popp-arctan": 0.5, "hyperbolic": 1.5, "hyperbolic-quadratic": 0.05}
"""A drive speed [m/s] on the falling branch of each law, where it has one."""
UNDER_LAW = {law: motion("rotary", 40.0, sampling=5e-3, friction=law, v=v) for law, v in FALLING.items()}

# Struck masses, and one blow of the striker at the drive at rest.
NATURAL = 10.0
FREE = {gap: struck((-0.01, 0.0), 5.0, natural=NATURAL, gap=gap) for gap in (0.005, 0.0, -0.005)}
HAMMER = {"natural": NATURAL, "frequency": 15.0, "drive": 5.0, "restitution": 0.5, "gap": 0.01}
HAMMERED = struck((0.0, 0.0), 60.0, **HAMMER)
HAMMER_AT_TWICE = HAMMER | {"frequency": 20.0, "gap": 0.0}
HAMMERED_AT_TWICE = struck((-0.02, 0.0), 60.0, **HAMMER_AT_TWICE)
BALL = {"natural": 0.0, "frequency": 20.0, "drive": 12.0, "pull": 9.81, "restitution": 0.6}
THROWN = struck((-0.15, 0.0), 60.0, **BALL)
M2, K0 = 100.0, 50e6
LOSS_FACTORS = (0.1, 0.3, 0.5, 0.7, 0.91)


def _blow(xi: float, speed: float = 2.0) -> Motion:
    """The striker flying at the contact, the drive at rest."""
    c0 = float(2 * xi * np.sqrt(K0 * M2))
    start = (0.0, 0.0, -0.01, speed)
    return motion("vibro-impact", 0.03, start=start, sampling=2e-6, v=0.0, delta=0.0, c0=c0, c2=0.0, gamma=1e-3)


ONE_BLOW = {xi: _blow(xi) for xi in LOSS_FACTORS}
SLOW_BLOW = _blow(0.3, 0.5)

# Self-excitation without impact.
WITHOUT = lane("rotary")
FROM_INSIDE = motion("rotary", 40.0, sampling=2e-3)
FROM_OUTSIDE = motion("rotary", 40.0, start=(0.010, 3.5, 0.0, 0.0), sampling=2e-3)
SLOW_DRIVE = motion("rotary", 40.0, sampling=2e-3, v=0.5)
FAST_DRIVE = motion("rotary", 40.0, sampling=2e-3, v=2.5)
_HEAVY = {"m1": 150.0, "k1": 306250.0, "c2": 250.0, "beta": 400 / 150}
HEAVY_STRIKER = motion("rotary", 40.0, _HEAVY, sampling=2e-3, gamma=float(np.sqrt(914260 / 400 / (306250 / 150))))
SPEEDS = (0.5, 1.0, 1.5, 2.0, 2.5)
OVER_SPEED = tuple(lane("rotary", settle=300.0, v=v) for v in SPEEDS)
STRIBECK_SPEEDS = (3.0, 3.5, 4.0, 5.0)
AT_2_5 = tuple(lane("rotary", settle=300.0, v=2.5, v_cr=v_cr) for v_cr in STRIBECK_SPEEDS)
DECAYING = motion("rotary", 30.0, sampling=5e-3, beta=0.3, gamma=0.9)
STRONGLY_DECAYING = motion("rotary", 30.0, sampling=5e-3, beta=0.3, gamma=1.2)
_TWO = {"beta": 0.4, "gamma": 1.2, "k1": 625000.0, "c2": 75.0, "v": 0.5}
TWO_FREQUENCIES = motion("rotary", 48.0, _TWO, sampling=2e-3)
SLOW = {"beta": 0.3, "v": 0.5, "c2": 75.0}
LOBED = {gamma: motion("rotary", 60.0, SLOW, sampling=1e-3, gamma=float(gamma)) for gamma in range(2, 8)}
NINE = motion("rotary", 60.0, SLOW, sampling=1e-3, gamma=9.0)
TEN = motion("rotary", 60.0, SLOW, sampling=1e-3, gamma=10.0)
GAMMAS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
OVER_GAMMA = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in GAMMAS)
FINE_GAMMAS = tuple(round(0.80 + 0.01 * step, 2) for step in range(15))
BORDER = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in FINE_GAMMAS)


def at(*shared: Shared, start: str = "drive", settle: float = SETTLE, **parameters: float) -> Lane:
    """A point with impact, the source's where nothing is said."""
    return lane("vibro-impact", *shared, parameters, start=start, settle=settle)


def moving(*shared: Shared, duration: float = 12.0, **parameters: float) -> Motion:
    """Its motion."""
    return motion("vibro-impact", duration, *shared, parameters)


# Impact, over the frequency ratio.
STIFF = {"k1": 625000.0}
USUAL_POINT, OTHER_GAP = at(), at(start="stuck", delta=0.005)
SLOW_POINT = at(v=0.5)
TYPICAL, TYPICAL_SLOW = moving(), moving(v=0.5)
SOURCE_CONTACT = moving(k0=9e6)
GAPS = (-0.005, 0.0, 0.005, 0.010)
CONTACT_STIFFNESSES = (9e6, 50e6, 200e6)
COUNTER_PHASE = moving(beta=0.3, gamma=0.5)
IN_PHASE = moving(gamma=0.6)
STIFF_POINT = moving(STIFF, gamma=0.8)
EXTRA_SWING = moving(gamma=0.9)
LOW_GAMMAS = (0.6, 0.5, 0.4, 0.3)
LOW = tuple(at(beta=0.3, gamma=gamma) for gamma in LOW_GAMMAS)
LOW_WITHOUT = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in LOW_GAMMAS)
TURNING = tuple(round(0.5 + 0.01 * step, 2) for step in range(11))
HIGH = (at(STIFF, gamma=1.1), at(STIFF, gamma=1.2), at(STIFF, gamma=1.5), at(beta=0.3, gamma=1.2))
TRIPLE = tuple(moving(STIFF, duration=20.0, gamma=gamma) for gamma in (1.0, 1.1, 1.2))
BOTH_GAPS = (-0.005, 0.005)
CRITICAL_SPEEDS = (2.0, 2.5, 3.0, 4.0, 5.0)
UNSAID = tuple(
    at(start=start, delta=delta, v_cr=v_cr) for delta in BOTH_GAPS for start in ALL_STARTS for v_cr in CRITICAL_SPEEDS
)
"""What the source does not say: the gap's sign, the start, the Stribeck speed."""

# Impact, over the mass ratio.
LATE = 300.0
BETAS = (0.25, 0.5, 0.6)
BEST = tuple(at(beta=beta) for beta in BETAS)
BEST_MOTIONS = tuple(moving(beta=beta) for beta in BETAS)
STIFFENED = at(STIFF, beta=0.5)
LIGHT = tuple(at(beta=beta) for beta in (0.1, 0.15, 0.2))
HEAVY, HEAVY_LATE = at(beta=0.7), at(settle=LATE, beta=0.7)
HEAVY_DAMPED_LESS = at(beta=0.7, c2=62.5)
DAMPING_SHARES = (0.1, 0.25, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
OVER_DAMPING = tuple(at(beta=0.7, c2=250.0 * share) for share in DAMPING_SHARES)
EQUAL, EQUAL_LATE = at(beta=1.0), at(settle=LATE, beta=1.0)
EQUAL_DAMPED_LESS = at(beta=1.0, c2=62.5)
CREEPING = moving(duration=40.0, beta=1.0)
HEAVIER = tuple(at(start=start, beta=1.2) for start in ALL_STARTS)
HEAVIER_STIFF = at(beta=1.2, gamma=1.0)
HEAVIER_STIFF_DAMPED_LESS = at(beta=1.2, gamma=1.0, c2=62.5)
LIGHT_MOTION, HEAVY_MOTION = moving(beta=0.1), moving(duration=60.0, beta=0.7)

# The source's region of best performance.
WIDE = grid(
    "region over beta and gamma",
    "vibro-impact",
    {
        "delta": (-0.005, 0.005),
        "v": (0.5, 1.5),
        "beta": np.round(np.arange(0.10, 1.2001, 0.05), 3),
        "gamma": np.round(np.arange(0.30, 1.2001, 0.05), 3),
    },
    starts=ALL_STARTS,
)
INSIDE = grid(
    "region over gap and speed",
    "vibro-impact",
    {
        "delta": np.round(np.arange(-0.010, 0.0101, 0.0025), 4),
        "v": (0.5, 1.0, 1.5, 2.0),
        "beta": np.round(np.arange(0.25, 0.6001, 0.05), 3),
        "gamma": np.round(np.arange(0.60, 0.8001, 0.025), 4),
    },
    starts=ALL_STARTS,
)
