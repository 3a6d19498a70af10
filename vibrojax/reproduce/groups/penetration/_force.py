"""Rate of penetration over the frequency, the threshold and the force (Figs 6.21 to 6.26)."""

import numpy as np

from vibrojax.reproduce._entry import DIFFERS, IN_TREND, ORDER, Entry, Here, claim, listed, number, trend
from vibrojax.reproduce._needs import grid
from vibrojax.reproduce.groups.penetration._pulsed import FREQUENCIES, PULSE, RUN, pulses, speed, straightness

SURFACE = grid(
    "penetration over frequency and force",
    "penetration",
    {"k3": (100e6, 500e6), "force": np.linspace(100e3, 300e3, 21), "frequency": np.linspace(10, 40, 13)},
    zeta=1.1,
    **RUN,
)
_GRID_21 = tuple(pulses(force=250e3, k3=300e6, zeta=1.1, frequency=frequency) for frequency in FREQUENCIES)
_GRID_22 = tuple(pulses(force=300e3, k3=500e6, zeta=1.1, frequency=frequency) for frequency in FREQUENCIES)
_GRID_24 = {
    force: tuple(pulses(force=force, k3=100e6, zeta=1.1, frequency=frequency) for frequency in FREQUENCIES)
    for force in (150e3, 300e3)
}


def first_relief(*lanes) -> Here:
    found = [one["relief"] for one in lanes if one["rate_of_penetration"] > 0]
    if not found:
        return Here("nan", DIFFERS, "no slip")
    note = "lowest P/D with slip, of 10 to 40 Hz; it is proportional to the lowest frequency tried"
    return number(100 * min(found), 12.0, "%", 0.04, note, trend=min(found) < 0.2)


def linear_in_frequency(*lanes) -> Here:
    r2 = straightness(np.array(FREQUENCIES), np.array([speed(one) for one in lanes]))
    return claim(f"{r2:.6f} is R² of a line over the frequency", r2 > 0.99)


def falls_with_threshold(*lanes) -> Here:
    rates = [speed(one) for one in lanes]
    return trend(f"{listed(rates)} mm/s at D 50 to 250 kN", bool(np.all(np.diff(rates) < 0)))


def line(*lanes) -> Here:
    rates = np.array([speed(one) for one in lanes])
    if not (rates > 0).any():
        return Here(
            "0 mm/s at 10 to 40 Hz", DIFFERS, "a pulse as high as the threshold does not bring damped rock to yield"
        )
    return trend(f"{listed(rates)} mm/s at 10 to 40 Hz", straightness(np.array(FREQUENCIES), rates) > 0.99)


def curve(*lanes) -> Here:
    rates = np.array([speed(one) for one in lanes])
    r2 = straightness(np.array([one["relief"] for one in lanes]), rates)
    note = "each blow slips as far, however often it falls, so the rate is proportional to P/D at a fixed force"
    return Here(f"{r2:.5f} is R² of a line over P/D", IN_TREND if r2 < 0.99 else DIFFERS, note)


def surface(ds) -> Here:
    rate = ds.rate_of_penetration.sel(k3=500e6).values
    rising = bool(np.all(np.diff(rate, axis=0) >= 0) and np.all(np.diff(rate, axis=1) >= 0))
    return trend(f"{1e3 * rate.max():.1f} mm/s at 300 kN and 40 Hz, rising along both axes", rising)


ENTRIES = (
    Entry(
        "fig-6.21",
        "share of the static load that starts the slip, 250 kN, k3 300 MN/m",
        "only 12 %",
        _GRID_21,
        first_relief,
        "4 %: half a unit of its last digit; in trend below 20 %",
        PULSE,
    ),
    Entry(
        "fig-6.22",
        "rate over the frequency, 300 kN, k3 500 MN/m",
        "linear",
        _GRID_22,
        linear_in_frequency,
        "R² over 0.99",
        PULSE,
    ),
    Entry(
        "fig-6.23",
        "rate over D from 50 to 250 kN, 300 kN, k3 500 MN/m",
        "decreases considerably",
        tuple(pulses(force=300e3, k3=500e6, zeta=1.1, frequency=20.0, threshold=50e3 * n) for n in range(1, 6)),
        falls_with_threshold,
        ORDER,
        PULSE,
    ),
    Entry(
        "fig-6.24a",
        "rate over P/D at 150 kN, D 150 kN, k3 100 MN/m",
        "a line of small slope",
        _GRID_24[150e3],
        line,
        "R² over 0.99, above 0",
        PULSE,
    ),
    Entry(
        "fig-6.24b",
        "rate over P/D at 300 kN, D 150 kN, k3 100 MN/m",
        "tends to curve",
        _GRID_24[300e3],
        curve,
        "R² of a line under 0.99",
        PULSE,
    ),
    Entry(
        "fig-6.25",
        "rate over frequency and force, k3 500 MN/m",
        "increases with both",
        (SURFACE,),
        surface,
        ORDER,
        PULSE,
    ),
)
