"""Forced penetration: the bit on the rock under given pulses and a swept sine (chapter 6, section 4)."""

import numpy as np

from vibrojax.physics.rock import ROCKS
from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import DIFFERS, IN_TREND, Entry, Here, claim, number, trend, within_range
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import grid, lane, motion
from vibrojax.reproduce.groups._impact import listed
from vibrojax.reproduce.pictures import penetration as pictures

FREQUENCIES = (10.0, 20.0, 30.0, 40.0)
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


def _speed(one) -> float:
    """Rate of penetration [mm/s]."""
    return 1e3 * one["rate_of_penetration"]


def _resonance(*sweeps) -> Here:
    found = [_velocity_peak(one) for one in sweeps]
    natural = [np.sqrt(k3 / 250) / (2 * np.pi) for k3 in (100e6, 300e6, 500e6)]
    holds = all(abs(a / b - 1) < 0.2 for a, b in zip(found, natural, strict=True))
    return trend(f"{listed(found)} Hz at k3 100, 300, 500 MN/m", holds, f"sqrt(k3/m1) is {listed(natural)} Hz")


def _velocity_peak(sweep) -> float:
    """Frequency [Hz] of the greatest swing of the bit's velocity, in windows of a quarter second."""
    middles, swings = signal.envelope(sweep, "v3", 0.25)
    return float(10 + 20 * middles[np.argmax(swings)])


def _slips_until(*sweeps) -> Here:
    ends = []
    for sweep, k3 in zip(sweeps, (100e6, 300e6, 500e6), strict=True):
        slips = np.flatnonzero(np.diff(sweep["x4"].values) > 0)
        if not len(slips):
            return Here("nan", DIFFERS, "no slip at all")
        ends.append((10 + 20 * float(sweep["time"][slips[-1]])) / (np.sqrt(k3 / 250) / (2 * np.pi)))
    return trend(f"{listed(ends)} times the natural frequency is where the last slip is", max(ends) < 1.25)


def _more_in_hard(*sweeps) -> Here:
    depths = [1e3 * float(sweep["x4"][-1]) for sweep in sweeps]
    text = f"{listed(depths, 5)} mm at k3 100, 300, 500 MN/m"
    return trend(text, bool(np.all(np.diff(depths) > 0)), "the differences are small: the force, not k3, decides")


def _staircase(moving) -> Here:
    """The growth of the hole outside of a pulse and the 4 ms after it."""
    growth = np.diff(moving["x4"].values)
    late = np.mod(moving["time"].values[:-1], 1 / 40) > 8e-3
    share = float(growth[late].sum() / growth.sum())
    return trend(f"{share:.1e} of the hole grows later than 4 ms after a pulse", share < 1e-3)


def _jumps(one) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.3f} mm off the rock after a blow", gap > 0.01)


def _stays(one) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.3f} mm off the rock after a blow", gap < 0.01)


def _mean_forces(*lanes) -> Here:
    forces = [one["mean_force"] / 1e3 for one in lanes]
    note = "lowest at 150 kN and 10 Hz, highest at 300 kN and 40 Hz; with pulses of 2 ms half of it"
    return within_range(min(forces), max(forces), (10, 50), "kN", note=note)


def _relief(*lanes) -> Here:
    found = np.array([one["relief"] for one in lanes]).reshape(2, 2)
    text = f"{listed(found[0])} at 10, 40 Hz with D 100 kN; {listed(found[1])} with 250 kN"
    return trend(text, bool(np.all(np.diff(found, axis=1) > 0) and np.all(np.diff(found, axis=0) < 0)))


def _no_slip(*lanes) -> Here:
    rates = [_speed(one) for one in lanes]
    return claim(f"{max(rates):.3g} mm/s at the most", max(rates) == 0)


ONSETS = tuple(float(k3) for k3 in np.round(np.geomspace(1e4, 1e8, 41), -2))


def _onset(*lanes) -> Here:
    slips = [k3 for k3, one in zip(ONSETS, lanes, strict=True) if one["rate_of_penetration"] > 0]
    if not slips:
        return Here("nan", DIFFERS, "no slip up to 100 MN/m")
    return number(min(slips) / 1e6, 0.01, "MN/m", 0.5, "lowest k3 with slip, of 41 from 0.01 to 100 MN/m")


def _over_stiffness(*lanes) -> Here:
    rates = [_speed(one) for one in lanes]
    holds = bool(np.all(np.diff(rates) >= 0) and rates[-1] > rates[0])
    return trend(f"{listed(rates)} mm/s at k3 100 to 500 MN/m", holds)


def _less_and_less(*lanes) -> Here:
    rates = [_speed(one) for one in lanes]
    steps = np.diff(rates)
    holds = bool(np.all(steps >= 0) and np.all(np.diff(steps[1:]) <= 0) and steps[-1] < 0.2 * steps.max())
    return trend(f"{listed(rates)} mm/s at k3 100 to 500 MN/m", holds)


SOFT_ROCKS = (10e6, 20e6, 30e6, 40e6, 50e6)


def _linear_in_soft(*lanes) -> Here:
    rates = np.array([_speed(one) for one in lanes])
    if not (rates > 0).any():
        return Here("0 mm/s up to 50 MN/m", DIFFERS, "at 300 kN, zeta 1.1 and D 150 kN nothing slips in softer rock")
    return trend(f"{listed(rates)} mm/s at k3 10 to 50 MN/m", _straightness(np.array(SOFT_ROCKS), rates) > 0.98)


def _straightness(x: np.ndarray, y: np.ndarray) -> float:
    """R² of a straight line."""
    return float(np.corrcoef(x, y)[0, 1] ** 2) if np.ptp(y) > 0 else 1.0


def _low_is_linear(ds) -> Here:
    part = ds.sel(frequency=10.0)
    slips = part.rate_of_penetration.values > 0
    r2 = _straightness(part.k3.values[slips], part.rate_of_penetration.values[slips])
    first = float(part.k3.values[slips][0] / 1e6)
    return trend(f"{r2:.3f} is R² of a line over k3, from {first:g} MN/m on", r2 > 0.95)


def _high_is_not(ds) -> Here:
    curves = [ds.rate_of_penetration.sel(frequency=frequency).values for frequency in (10.0, 40.0)]
    off = float(np.abs(curves[1] / 4 - curves[0]).max() / curves[0].max())
    r2 = _straightness(ds.k3.values, curves[1])
    note = f"but the curve at 40 Hz is four times that at 10 Hz to {off:.1e}: the shape does not depend on P/D"
    return trend(f"{r2:.3f} is R² of a line over k3 at 40 Hz", r2 < 0.95, note)


def _first_relief(*lanes) -> Here:
    found = [one["relief"] for one in lanes if one["rate_of_penetration"] > 0]
    if not found:
        return Here("nan", DIFFERS, "no slip")
    note = "lowest P/D with slip, of 10 to 40 Hz; it is proportional to the lowest frequency tried"
    return number(100 * min(found), 12.0, "%", 0.1, note, trend=min(found) < 0.2)


def _linear_in_frequency(*lanes) -> Here:
    r2 = _straightness(np.array(FREQUENCIES), np.array([_speed(one) for one in lanes]))
    return claim(f"{r2:.6f} is R² of a line over the frequency", r2 > 0.99)


def _falls_with_threshold(*lanes) -> Here:
    rates = [_speed(one) for one in lanes]
    return trend(f"{listed(rates)} mm/s at D 50 to 250 kN", bool(np.all(np.diff(rates) < 0)))


def _line(*lanes) -> Here:
    rates = np.array([_speed(one) for one in lanes])
    if not (rates > 0).any():
        return Here(
            "0 mm/s at 10 to 40 Hz", DIFFERS, "a pulse as high as the threshold does not bring damped rock to yield"
        )
    return trend(f"{listed(rates)} mm/s at 10 to 40 Hz", _straightness(np.array(FREQUENCIES), rates) > 0.99)


def _curve(*lanes) -> Here:
    rates = np.array([_speed(one) for one in lanes])
    r2 = _straightness(np.array([one["relief"] for one in lanes]), rates)
    note = "each blow slips as far, however often it falls, so the rate is proportional to P/D at a fixed force"
    return Here(f"{r2:.5f} is R² of a line over P/D", IN_TREND if r2 < 0.99 else DIFFERS, note)


def _surface(ds) -> Here:
    rate = ds.rate_of_penetration.sel(k3=500e6).values
    rising = bool(np.all(np.diff(rate, axis=0) >= 0) and np.all(np.diff(rate, axis=1) >= 0))
    return trend(f"{1e3 * rate.max():.1f} mm/s at 300 kN and 40 Hz, rising along both axes", rising)


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
            _resonance,
            "20 % of sqrt(k3/m1)",
            _SINE,
        ),
        Entry(
            "fig-6.5",
            "swept sine, slip beyond resonance",
            "none",
            SWEEPS,
            _slips_until,
            "last slip below 1.25 times",
            _SINE,
        ),
        Entry(
            "fig-6.7",
            "swept sine, depth of the hole over k3",
            "increases with k3",
            SWEEPS,
            _more_in_hard,
            _ORDER,
            _SINE,
        ),
        Entry(
            "fig-6.8", "motion of the hole under pulses", "stepwise", (STEPS[1.5],), _staircase, "under 0.1 %", _PULSE
        ),
        Entry(
            "fig-6.9",
            "Table 6.1, zeta 0.5",
            "the bit jumps (over 0 mm)",
            (_damped(0.5),),
            _jumps,
            "over 0.01 mm",
            _PULSE,
        ),
        Entry(
            "fig-6.10", "Table 6.1, zeta 1.0", "no bouncing (0 mm)", (_damped(1.0),), _stays, "under 0.01 mm", _PULSE
        ),
        Entry(
            "fig-6.11", "Table 6.1, zeta 1.5", "no bouncing (0 mm)", (_damped(1.5),), _stays, "under 0.01 mm", _PULSE
        ),
        Entry(
            "fig-6.12",
            "mean force P at 150 to 300 kN, 10 to 40 Hz",
            "10 to 50 kN",
            (_pulses(force=150e3, frequency=10.0), _pulses(force=300e3, frequency=40.0)),
            _mean_forces,
            "within the range; in trend where they overlap",
            _PULSE,
        ),
        Entry(
            "fig-6.13",
            "P/D at 250 kN over frequency and threshold",
            "rises with the frequency, falls with D",
            tuple(_pulses(force=250e3, threshold=d, frequency=f) for d in (100e3, 250e3) for f in (10.0, 40.0)),
            _relief,
            _ORDER,
            _PULSE,
        ),
        Entry(
            "fig-6.14",
            "rate in very soft rock, k3 0.01 and 0.1 MN/m, 150 and 250 kN",
            "no slip, 0 mm/s",
            tuple(_pulses(k3=k3, force=f, zeta=0.5, frequency=10.0) for k3 in (1e4, 1e5) for f in (150e3, 250e3)),
            _no_slip,
            "exactly",
            _PULSE,
        ),
        Entry(
            "fig-6.15",
            "Table 6.2: stiffness at which slip begins",
            "0.01 MN/m",
            tuple(_pulses(k3=k3, force=150e3, zeta=0.5, frequency=10.0) for k3 in ONSETS),
            _onset,
            "50 %",
            ("R10", "R23"),
        ),
        Entry(
            "fig-6.17", "rate over k3, D 150 kN, 150 kN", "increases with k3", _GRID_17, _over_stiffness, _ORDER, _PULSE
        ),
        Entry(
            "fig-6.18", "rate over k3, D 250 kN, 300 kN", "increases with k3", _GRID_18, _over_stiffness, _ORDER, _PULSE
        ),
        Entry(
            "fig-6.19",
            "slope of the rate over k3, 200 kN",
            "falls in very hard rock",
            tuple(_pulses(force=200e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in STIFFNESSES),
            _less_and_less,
            "the last step under a fifth of the greatest",
            _PULSE,
        ),
        Entry(
            "sec-6.4.2.3",
            "rate over k3 below 50 MN/m",
            "linear, above 0",
            tuple(_pulses(force=300e3, k3=k3, zeta=1.1, frequency=20.0) for k3 in SOFT_ROCKS),
            _linear_in_soft,
            "R² over 0.98",
            _PULSE,
        ),
        Entry(
            "fig-6.20a",
            "rate over k3 at a small P/D (10 Hz), 200 kN",
            "linear",
            (OVER_STIFFNESS,),
            _low_is_linear,
            "R² over 0.95",
            _PULSE,
        ),
        Entry(
            "fig-6.20b",
            "rate over k3 at a high P/D (40 Hz), 200 kN",
            "not linear",
            (OVER_STIFFNESS,),
            _high_is_not,
            "R² under 0.95",
            _PULSE,
        ),
        Entry(
            "fig-6.21",
            "share of the static load that starts the slip, 250 kN, k3 300 MN/m",
            "only 12 %",
            _GRID_21,
            _first_relief,
            "10 %; in trend below 20 %",
            _PULSE,
        ),
        Entry(
            "fig-6.22",
            "rate over the frequency, 300 kN, k3 500 MN/m",
            "linear",
            _GRID_22,
            _linear_in_frequency,
            "R² over 0.99",
            _PULSE,
        ),
        Entry(
            "fig-6.23",
            "rate over D from 50 to 250 kN, 300 kN, k3 500 MN/m",
            "decreases considerably",
            tuple(_pulses(force=300e3, k3=500e6, zeta=1.1, frequency=20.0, threshold=50e3 * n) for n in range(1, 6)),
            _falls_with_threshold,
            _ORDER,
            _PULSE,
        ),
        Entry(
            "fig-6.24a",
            "rate over P/D at 150 kN, D 150 kN, k3 100 MN/m",
            "a line of small slope",
            _GRID_24[150e3],
            _line,
            "R² over 0.99, above 0",
            _PULSE,
        ),
        Entry(
            "fig-6.24b",
            "rate over P/D at 300 kN, D 150 kN, k3 100 MN/m",
            "tends to curve",
            _GRID_24[300e3],
            _curve,
            "R² of a line under 0.99",
            _PULSE,
        ),
        Entry(
            "fig-6.25",
            "rate over frequency and force, k3 500 MN/m",
            "increases with both",
            (SURFACE,),
            _surface,
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
