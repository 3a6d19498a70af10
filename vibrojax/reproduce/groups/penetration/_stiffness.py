"""Rate of penetration over the stiffness of the rock (Figs 6.14 to 6.20)."""

import numpy as np

from vibrojax.reproduce._entry import DIFFERS, ORDER, Entry, Here, claim, listed, number, trend
from vibrojax.reproduce._needs import grid
from vibrojax.reproduce.groups.penetration._pulsed import FREQUENCIES, PULSE, RUN, pulses, speed, straightness

STIFFNESSES = (100e6, 200e6, 300e6, 400e6, 500e6)
OVER_STIFFNESS = grid(
    "penetration over stiffness",
    "penetration",
    {"frequency": FREQUENCIES, "k3": np.linspace(50e6, 500e6, 46)},
    force=200e3,
    zeta=1.1,
    **RUN,
)
_GRID_17 = tuple(pulses(force=150e3, threshold=150e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES)
_GRID_18 = tuple(pulses(force=300e3, threshold=250e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES)
ONSETS = tuple(float(k3) for k3 in np.round(np.geomspace(1e4, 1e8, 41), -2))
SOFT_ROCKS = (10e6, 20e6, 30e6, 40e6, 50e6)


def no_slip(*lanes) -> Here:
    rates = [speed(one) for one in lanes]
    return claim(f"{max(rates):.3g} mm/s at the most", max(rates) == 0)


def onset(*lanes) -> Here:
    slips = [k3 for k3, one in zip(ONSETS, lanes, strict=True) if one["rate_of_penetration"] > 0]
    if not slips:
        return Here("nan", DIFFERS, "no slip up to 100 MN/m")
    return number(min(slips) / 1e6, 0.01, "MN/m", 0.5, "lowest k3 with slip, of 41 from 0.01 to 100 MN/m")


def over_stiffness(*lanes) -> Here:
    rates = [speed(one) for one in lanes]
    holds = bool(np.all(np.diff(rates) >= 0) and rates[-1] > rates[0])
    return trend(f"{listed(rates)} mm/s at k3 100 to 500 MN/m", holds)


def less_and_less(*lanes) -> Here:
    rates = [speed(one) for one in lanes]
    steps = np.diff(rates)
    holds = bool(np.all(steps >= 0) and np.all(np.diff(steps[1:]) <= 0) and steps[-1] < 0.2 * steps.max())
    return trend(f"{listed(rates)} mm/s at k3 100 to 500 MN/m", holds)


def linear_in_soft(*lanes) -> Here:
    rates = np.array([speed(one) for one in lanes])
    if not (rates > 0).any():
        return Here("0 mm/s up to 50 MN/m", DIFFERS, "at 300 kN, zeta 1.1 and D 150 kN nothing slips in softer rock")
    return trend(f"{listed(rates)} mm/s at k3 10 to 50 MN/m", straightness(np.array(SOFT_ROCKS), rates) > 0.98)


def low_is_linear(ds) -> Here:
    part = ds.sel(frequency=10.0)
    slips = part.rate_of_penetration.values > 0
    r2 = straightness(part.k3.values[slips], part.rate_of_penetration.values[slips])
    first = float(part.k3.values[slips][0] / 1e6)
    return trend(f"{r2:.3f} is R² of a line over k3, from {first:g} MN/m on", r2 > 0.95)


def high_is_not(ds) -> Here:
    curves = [ds.rate_of_penetration.sel(frequency=frequency).values for frequency in (10.0, 40.0)]
    off = float(np.abs(curves[1] / 4 - curves[0]).max() / curves[0].max())
    r2 = straightness(ds.k3.values, curves[1])
    note = f"but the curve at 40 Hz is four times that at 10 Hz to {off:.1e}: the shape does not depend on P/D"
    return trend(f"{r2:.3f} is R² of a line over k3 at 40 Hz", r2 < 0.95, note)


ENTRIES = (
    Entry(
        "fig-6.14",
        "rate in very soft rock, k3 0.01 and 0.1 MN/m, 150 and 250 kN",
        "no slip, 0 mm/s",
        tuple(pulses(k3=k3, force=f, zeta=0.5, frequency=10.0) for k3 in (1e4, 1e5) for f in (150e3, 250e3)),
        no_slip,
        "exactly",
        PULSE,
    ),
    Entry(
        "fig-6.15",
        "Table 6.2: stiffness at which slip begins",
        "0.01 MN/m",
        tuple(pulses(k3=k3, force=150e3, zeta=0.5, frequency=10.0) for k3 in ONSETS),
        onset,
        "50 %: half a unit of its one digit",
        ("R10", "R23"),
    ),
    Entry(
        "fig-6.17",
        "rate over k3, D 150 kN, 150 kN",
        "increases with k3",
        _GRID_17,
        over_stiffness,
        ORDER,
        PULSE,
    ),
    Entry(
        "fig-6.18",
        "rate over k3, D 250 kN, 300 kN",
        "increases with k3",
        _GRID_18,
        over_stiffness,
        ORDER,
        PULSE,
    ),
    Entry(
        "fig-6.19",
        "slope of the rate over k3, 200 kN",
        "falls in very hard rock",
        tuple(pulses(force=200e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES),
        less_and_less,
        "the last step under a fifth of the greatest",
        PULSE,
    ),
    Entry(
        "sec-6.4.2.3",
        "rate over k3 below 50 MN/m",
        "linear, above 0",
        tuple(pulses(force=300e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in SOFT_ROCKS),
        linear_in_soft,
        "R² over 0.98",
        PULSE,
    ),
    Entry(
        "fig-6.20a",
        "rate over k3 at a small P/D (10 Hz), 200 kN",
        "linear",
        (OVER_STIFFNESS,),
        low_is_linear,
        "R² over 0.95",
        PULSE,
    ),
    Entry(
        "fig-6.20b",
        "rate over k3 at a high P/D (40 Hz), 200 kN",
        "not linear",
        (OVER_STIFFNESS,),
        high_is_not,
        "R² under 0.95",
        PULSE,
    ),
)
