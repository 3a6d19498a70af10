"""Forced penetration: the bit on the rock under given pulses and a swept sine (chapter 6, section 4)."""

import numpy as np

from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import grid, motion
from vibrojax.reproduce.groups.penetration import _force, _sine, _stiffness, _under_pulses
from vibrojax.reproduce.groups.penetration._force import SURFACE
from vibrojax.reproduce.groups.penetration._pulsed import RUN
from vibrojax.reproduce.groups.penetration._sine import SWEEPS
from vibrojax.reproduce.groups.penetration._stiffness import OVER_STIFFNESS
from vibrojax.reproduce.groups.penetration._under_pulses import STEPS
from vibrojax.reproduce.pictures import penetration as pictures

SOFT = {k3: motion("penetration", 0.5, k3=k3, zeta=0.5, frequency=10.0, force=150e3) for k3 in (1e5, 1e8)}
OVER_THRESHOLD = grid(
    "penetration over threshold",
    "penetration",
    {"threshold": np.linspace(50e3, 250e3, 9), "frequency": np.linspace(10, 40, 7)},
    force=300e3,
    k3=500e6,
    zeta=1.1,
    **RUN,
)
GROUP = Group(
    name="penetration",
    title="Forced penetration",
    text="The bit stands on rock, a spring with a damper in series with an element that slips at the threshold D, "
    "and is driven by given pulses or a swept sine. Pulses are rectangular, 4 ms wide, D 150 kN where nothing is said.",
    entries=(
        *_sine.ENTRIES,
        *_under_pulses.ENTRIES,
        *_stiffness.ENTRIES,
        *_force.ENTRIES,
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
