"""Motion under pulses, its damping and the mean force (Figs 6.8 to 6.13)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import MOSTLY, ORDER, Entry, Here, claim, listed, shown, trend, within_range
from vibrojax.reproduce._needs import motion
from vibrojax.reproduce.groups.penetration._pulsed import PULSE, pulses

TABLE_6_1 = {"frequency": 40.0, "force": 300e3, "threshold": 150e3, "k3": 100e6}
STEPS = {zeta: motion("penetration", 0.3, zeta=zeta, **TABLE_6_1) for zeta in (0.5, 1.0, 1.5)}


def _damped(zeta: float):
    return pulses(zeta=zeta, **TABLE_6_1)


def staircase(moving) -> Here:
    """The growth of the hole outside of a pulse and the 4 ms after it."""
    share = signal.grown(moving, np.mod(moving["time"].values[:-1], 1 / 40) > 8e-3)
    return trend(f"{shown(share)} of the hole grows later than 4 ms after a pulse", share < 1e-3)


def jumps(one) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.3f} mm off the rock after a blow", gap > 0.01)


def stays(one) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.3f} mm off the rock after a blow", gap < 0.01)


def mean_forces(*lanes) -> Here:
    forces = [one["mean_force"] / 1e3 for one in lanes]
    note = "lowest at 150 kN and 10 Hz, highest at 300 kN and 40 Hz; with pulses of 2 ms half of it"
    return within_range(min(forces), max(forces), (10, 50), "kN", note=note)


def relief(*lanes) -> Here:
    found = np.array([one["relief"] for one in lanes]).reshape(2, 2)
    text = f"{listed(found[0])} at 10, 40 Hz with D 100 kN; {listed(found[1])} with 250 kN"
    return trend(text, bool(np.all(np.diff(found, axis=1) > 0) and np.all(np.diff(found, axis=0) < 0)))


ENTRIES = (
    Entry(
        "fig-6.8",
        "motion of the hole under pulses",
        "stepwise",
        (STEPS[1.5],),
        staircase,
        "under 0.1 %",
        PULSE,
    ),
    Entry(
        "fig-6.9",
        "Table 6.1, zeta 0.5",
        "the bit jumps (over 0 mm)",
        (_damped(0.5),),
        jumps,
        "over 0.01 mm",
        PULSE,
    ),
    Entry(
        "fig-6.10",
        "Table 6.1, zeta 1.0",
        "no bouncing (0 mm)",
        (_damped(1.0),),
        stays,
        "under 0.01 mm",
        PULSE,
    ),
    Entry(
        "fig-6.11",
        "Table 6.1, zeta 1.5",
        "no bouncing (0 mm)",
        (_damped(1.5),),
        stays,
        "under 0.01 mm",
        PULSE,
    ),
    Entry(
        "fig-6.12",
        "mean force P at 150 to 300 kN, 10 to 40 Hz",
        "10 to 50 kN",
        (pulses(force=150e3, frequency=10.0), pulses(force=300e3, frequency=40.0)),
        mean_forces,
        MOSTLY,
        PULSE,
    ),
    Entry(
        "fig-6.13",
        "P/D at 250 kN over frequency and threshold",
        "rises with the frequency, falls with D",
        tuple(pulses(force=250e3, threshold=d, frequency=f) for d in (100e3, 250e3) for f in (10.0, 40.0)),
        relief,
        ORDER,
        PULSE,
    ),
)
