"""The cores' stiffness, and the swept sine (Table 4.5, Figs 6.4 to 6.7)."""

import numpy as np

from vibrojax.physics.rock import ROCKS
from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import DIFFERS, ORDER, Entry, Here, listed, number, trend
from vibrojax.reproduce._needs import motion

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
_SINE = ("R22",)


def _core_stiffness(row: int, name: str, source: float) -> Entry:
    area, length = np.pi * 0.027**2, 0.108
    within = min(0.012, 0.1e9 / ROCKS[name].modulus)
    return Entry(
        f"table-4.5.{row}",
        f"{name}: stiffness of the core, 54 by 108 mm, from its Young's modulus",
        f"{source} kN/mm",
        (),
        lambda: number(ROCKS[name].modulus * area / length / 1e6, source, "kN/mm", within),
        f"{100 * within:.2g} %: a unit of the modulus's last digit, which is cut (see R30)",
        ("R30",),
    )


def resonance(*sweeps) -> Here:
    found = [velocity_peak(one) for one in sweeps]
    natural = [np.sqrt(k3 / 250) / (2 * np.pi) for k3 in (100e6, 300e6, 500e6)]
    holds = all(abs(a / b - 1) < 0.2 for a, b in zip(found, natural, strict=True))
    return trend(f"{listed(found)} Hz at k3 100, 300, 500 MN/m", holds, f"sqrt(k3/m1) is {listed(natural)} Hz")


def velocity_peak(sweep) -> float:
    """Frequency [Hz] of the greatest swing of the bit's velocity, in windows of a quarter second."""
    middles, swings = signal.envelope(sweep, "v3", 0.25)
    return float(10 + 20 * middles[np.argmax(swings)])


def slips_until(*sweeps) -> Here:
    ends = []
    for sweep, k3 in zip(sweeps, (100e6, 300e6, 500e6), strict=True):
        slips = np.flatnonzero(np.diff(sweep["x4"].values) > 0)
        if not len(slips):
            return Here("nan", DIFFERS, "no slip at all")
        ends.append((10 + 20 * float(sweep["time"][slips[-1]])) / (np.sqrt(k3 / 250) / (2 * np.pi)))
    return trend(f"{listed(ends)} times the natural frequency is where the last slip is", max(ends) < 1.25)


def more_in_hard(*sweeps) -> Here:
    depths = [1e3 * float(sweep["x4"][-1]) for sweep in sweeps]
    text = f"{listed(depths, 5)} mm at k3 100, 300, 500 MN/m"
    return trend(text, bool(np.all(np.diff(depths) > 0)), "the differences are small: the force, not k3, decides")


ENTRIES = (
    *(_core_stiffness(*row) for row in ((1, "granite", 224.24), (2, "limestone", 175.32), (3, "sandstone", 100.68))),
    Entry(
        "fig-6.4",
        "swept sine, frequency of the greatest velocity",
        "a resonance",
        SWEEPS,
        resonance,
        "20 % of sqrt(k3/m1)",
        _SINE,
    ),
    Entry(
        "fig-6.5",
        "swept sine, slip beyond resonance",
        "none",
        SWEEPS,
        slips_until,
        "last slip below 1.25 times",
        _SINE,
    ),
    Entry(
        "fig-6.7",
        "swept sine, depth of the hole over k3",
        "increases with k3",
        SWEEPS,
        more_in_hard,
        ORDER,
        _SINE,
    ),
)
