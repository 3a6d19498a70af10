"""Forced penetration: the bit on the rock under given pulses and a swept sine (chapter 6, section 4)."""

import numpy as np

from vibrojax.physics.rock import ROCKS
from vibrojax.reproduce._entry import Entry, number
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import grid, lane, motion
from vibrojax.reproduce.groups import _penetration as judge
from vibrojax.reproduce.groups._penetration import FREQUENCIES, ONSETS, SOFT_ROCKS
from vibrojax.reproduce.pictures import penetration as pictures

FORCES = (100e3, 150e3, 200e3, 250e3, 300e3)
STIFFNESSES = (100e6, 200e6, 300e6, 400e6, 500e6)
TABLE_6_1 = {"frequency": 40.0, "force": 300e3, "threshold": 150e3, "k3": 100e6}
SWEEPS = tuple(
    motion(
        "penetration",
        20.0,
        pulse_shape="sweep",
        k3=k3,
        force=70e3,
        bias=60e3,
        sweep_start=10.0,
        sweep_rate=20.0,
        zeta=0.3,
    )
    for k3 in (100e6, 300e6, 500e6)
)
STEPS = {zeta: motion("penetration", 0.3, zeta=zeta, **TABLE_6_1) for zeta in (0.5, 1.0, 1.5)}
SOFT = {k3: motion("penetration", 0.5, k3=k3, zeta=0.5, frequency=10.0, force=150e3) for k3 in (1e5, 1e8)}
_RUN = {"settle": 1.0, "observe": 1.0}
SURFACE = grid(
    "penetration over frequency and force",
    "penetration",
    {"k3": (100e6, 500e6), "force": np.linspace(100e3, 300e3, 21), "frequency": np.linspace(10, 40, 13)},
    zeta=1.1,
    **_RUN,
)
OVER_STIFFNESS = grid(
    "penetration over stiffness",
    "penetration",
    {"frequency": FREQUENCIES, "k3": np.linspace(50e6, 500e6, 46)},
    force=200e3,
    zeta=1.1,
    **_RUN,
)
OVER_THRESHOLD = grid(
    "penetration over threshold",
    "penetration",
    {"threshold": np.linspace(50e3, 250e3, 9), "frequency": np.linspace(10, 40, 7)},
    force=300e3,
    k3=500e6,
    zeta=1.1,
    **_RUN,
)


def _pulses(**parameters):
    return lane("penetration", settle=1.0, observe=1.0, **parameters)


def _damped(zeta: float):
    return _pulses(zeta=zeta, **TABLE_6_1)


def _core_stiffness(name: str, source: float) -> Entry:
    area, length = np.pi * 0.027**2, 0.108
    return Entry(
        f"table-4.5.{name}",
        f"{name}: stiffness of the core, 54 by 108 mm, from its Young's modulus",
        f"{source} kN/mm",
        (),
        lambda: number(ROCKS[name].modulus * area / length / 1e6, source, "kN/mm", 0.012),
        "1.2 %: the modulus has two digits",
    )


_SINE = ("R22",)
_PULSE = ("R10",)
_ORDER = "the order"
_GRID_17 = tuple(_pulses(force=150e3, threshold=150e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES)
_GRID_18 = tuple(_pulses(force=300e3, threshold=250e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES)
_GRID_21 = tuple(_pulses(force=250e3, k3=300e6, zeta=1.1, frequency=frequency) for frequency in FREQUENCIES)
_GRID_22 = tuple(_pulses(force=300e3, k3=500e6, zeta=1.1, frequency=frequency) for frequency in FREQUENCIES)
_GRID_24 = {
    force: tuple(_pulses(force=force, k3=100e6, zeta=1.1, frequency=frequency) for frequency in FREQUENCIES)
    for force in (150e3, 300e3)
}
GROUP = Group(
    name="penetration",
    title="Forced penetration",
    text="The bit stands on rock, a spring with a damper in series with an element that slips at the threshold D, "
    "and is driven by given pulses or a swept sine. Pulses are rectangular, 4 ms wide, D 150 kN where nothing is said.",
    entries=(
        *(_core_stiffness(*row) for row in (("sandstone", 100.68), ("limestone", 175.32), ("granite", 224.24))),
        Entry(
            "fig-6.4",
            "swept sine, frequency of the greatest velocity",
            "a resonance",
            SWEEPS,
            judge.resonance,
            "20 % of sqrt(k3/m1)",
            _SINE,
        ),
        Entry(
            "fig-6.5",
            "swept sine, slip beyond resonance",
            "none",
            SWEEPS,
            judge.slips_until,
            "last slip below 1.25 times",
            _SINE,
        ),
        Entry(
            "fig-6.7",
            "swept sine, depth of the hole over k3",
            "increases with k3",
            SWEEPS,
            judge.more_in_hard,
            _ORDER,
            _SINE,
        ),
        Entry(
            "fig-6.8",
            "motion of the hole under pulses",
            "stepwise",
            (STEPS[1.5],),
            judge.staircase,
            "under 0.1 %",
            _PULSE,
        ),
        Entry(
            "fig-6.9",
            "Table 6.1, zeta 0.5",
            "the bit jumps (over 0 mm)",
            (_damped(0.5),),
            judge.jumps,
            "over 0.01 mm",
            _PULSE,
        ),
        Entry(
            "fig-6.10",
            "Table 6.1, zeta 1.0",
            "no bouncing (0 mm)",
            (_damped(1.0),),
            judge.stays,
            "under 0.01 mm",
            _PULSE,
        ),
        Entry(
            "fig-6.11",
            "Table 6.1, zeta 1.5",
            "no bouncing (0 mm)",
            (_damped(1.5),),
            judge.stays,
            "under 0.01 mm",
            _PULSE,
        ),
        Entry(
            "fig-6.12",
            "mean force P at 150 to 300 kN, 10 to 40 Hz",
            "10 to 50 kN",
            (_pulses(force=150e3, frequency=10.0), _pulses(force=300e3, frequency=40.0)),
            judge.mean_forces,
            "within the range; in trend where they overlap",
            _PULSE,
        ),
        Entry(
            "fig-6.13",
            "P/D at 250 kN over frequency and threshold",
            "rises with the frequency, falls with D",
            tuple(_pulses(force=250e3, threshold=d, frequency=f) for d in (100e3, 250e3) for f in (10.0, 40.0)),
            judge.relief,
            _ORDER,
            _PULSE,
        ),
        Entry(
            "fig-6.14",
            "rate in very soft rock, k3 0.01 and 0.1 MN/m, 150 and 250 kN",
            "no slip, 0 mm/s",
            tuple(_pulses(k3=k3, force=f, zeta=0.5, frequency=10.0) for k3 in (1e4, 1e5) for f in (150e3, 250e3)),
            judge.no_slip,
            "exactly",
            _PULSE,
        ),
        Entry(
            "fig-6.15",
            "Table 6.2: stiffness at which slip begins",
            "0.01 MN/m",
            tuple(_pulses(k3=k3, force=150e3, zeta=0.5, frequency=10.0) for k3 in ONSETS),
            judge.onset,
            "50 %",
            ("R10", "R23"),
        ),
        Entry(
            "fig-6.17",
            "rate over k3, D 150 kN, 150 kN",
            "increases with k3",
            _GRID_17,
            judge.over_stiffness,
            _ORDER,
            _PULSE,
        ),
        Entry(
            "fig-6.18",
            "rate over k3, D 250 kN, 300 kN",
            "increases with k3",
            _GRID_18,
            judge.over_stiffness,
            _ORDER,
            _PULSE,
        ),
        Entry(
            "fig-6.19",
            "slope of the rate over k3, 200 kN",
            "falls in very hard rock",
            tuple(_pulses(force=200e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES),
            judge.less_and_less,
            "the last step under a fifth of the greatest",
            _PULSE,
        ),
        Entry(
            "sec-6.4.2.3",
            "rate over k3 below 50 MN/m",
            "linear, above 0",
            tuple(_pulses(force=300e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in SOFT_ROCKS),
            judge.linear_in_soft,
            "R² over 0.98",
            _PULSE,
        ),
        Entry(
            "fig-6.20a",
            "rate over k3 at a small P/D (10 Hz), 200 kN",
            "linear",
            (OVER_STIFFNESS,),
            judge.low_is_linear,
            "R² over 0.95",
            _PULSE,
        ),
        Entry(
            "fig-6.20b",
            "rate over k3 at a high P/D (40 Hz), 200 kN",
            "not linear",
            (OVER_STIFFNESS,),
            judge.high_is_not,
            "R² under 0.95",
            _PULSE,
        ),
        Entry(
            "fig-6.21",
            "share of the static load that starts the slip, 250 kN, k3 300 MN/m",
            "only 12 %",
            _GRID_21,
            judge.first_relief,
            "10 %; in trend below 20 %",
            _PULSE,
        ),
        Entry(
            "fig-6.22",
            "rate over the frequency, 300 kN, k3 500 MN/m",
            "linear",
            _GRID_22,
            judge.linear_in_frequency,
            "R² over 0.99",
            _PULSE,
        ),
        Entry(
            "fig-6.23",
            "rate over D from 50 to 250 kN, 300 kN, k3 500 MN/m",
            "decreases considerably",
            tuple(_pulses(force=300e3, k3=500e6, zeta=1.1, frequency=20.0, threshold=50e3 * n) for n in range(1, 6)),
            judge.falls_with_threshold,
            _ORDER,
            _PULSE,
        ),
        Entry(
            "fig-6.24a",
            "rate over P/D at 150 kN, D 150 kN, k3 100 MN/m",
            "a line of small slope",
            _GRID_24[150e3],
            judge.line,
            "R² over 0.99, above 0",
            _PULSE,
        ),
        Entry(
            "fig-6.24b",
            "rate over P/D at 300 kN, D 150 kN, k3 100 MN/m",
            "tends to curve",
            _GRID_24[300e3],
            judge.curve,
            "R² of a line under 0.99",
            _PULSE,
        ),
        Entry(
            "fig-6.25",
            "rate over frequency and force, k3 500 MN/m",
            "increases with both",
            (SURFACE,),
            judge.surface,
            _ORDER,
            _PULSE,
        ),
    ),
    pictures=(
        Picture(
            "Figs 6.4 to 6.7",
            "Swept sine: swing of the bit's velocity, and the hole, over the frequency, for three rocks.",
            SWEEPS,
            pictures.swept,
        ),
        Picture(
            "Figs 6.8 to 6.11",
            "Bit (thin) and hole (thick) under pulses of 300 kN: the lightly damped bit jumps off the rock.",
            tuple(STEPS.values()),
            pictures.staircases,
        ),
        Picture(
            "Figs 6.14 and 6.16",
            "Soft rock swings and does not break; hard rock does.",
            tuple(SOFT.values()),
            pictures.soft,
        ),
        Picture(
            "Figs 6.19 and 6.20",
            "Rate of penetration over the stiffness at 200 kN, one line a frequency.",
            (OVER_STIFFNESS,),
            pictures.over_stiffness,
        ),
        Picture(
            "Figs 6.25 and 6.26",
            "Surface of the rate over frequency and force, k3 100 and 500 MN/m.",
            (SURFACE,),
            pictures.surfaces,
        ),
        Picture(
            "Fig. 6.23",
            "Surface of the rate over frequency and threshold, 300 kN, k3 500 MN/m.",
            (OVER_THRESHOLD,),
            pictures.over_threshold,
        ),
    ),
)
