"""Judges of the forced penetration: the cores, the swept sine, pulses, the rate over stiffness, frequency and force."""

from collections.abc import Callable

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.models.physics.rock import ROCKS
from vibrojax.reproduce import datasets_chapter6 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.needs import Features
from vibrojax.reproduce.verdicts import DIFFERS, IN_TREND, Here, claim, listed, number, shown, trend, within_range

Values = Float[np.ndarray, " values"]


def rates(lanes: tuple[Features, ...]) -> Values:
    """Rates of penetration [mm/s]."""
    return np.array([1e3 * one["rate_of_penetration"] for one in lanes])


def _straightness(x: Values, y: Values) -> float:
    """R² of a straight line."""
    return float(np.corrcoef(x, y)[0, 1] ** 2) if np.ptp(y) > 0 else 1.0


def core_tolerance(rock: str) -> float:
    """A unit of the modulus's last digit, which is cut."""
    return min(0.012, 0.1e9 / ROCKS[rock].modulus)


def core_stiffness(rock: str, source: float) -> Callable[[], Here]:
    """Stiffness of a core of 54 by 108 mm, from its Young's modulus."""

    def judge() -> Here:
        area, length = np.pi * 0.027**2, 0.108
        return number(ROCKS[rock].modulus * area / length / 1e6, source, "kN/mm", core_tolerance(rock))

    return judge


# Under a swept sine.


def natural_frequency(k3: float) -> float:
    """sqrt(k3/m1) [Hz]."""
    return float(np.sqrt(k3 / 250) / (2 * np.pi))


def _swept_frequency(time: float) -> float:
    """Of the sine, from 10 Hz on, 20 Hz faster every second."""
    return 10 + 20 * time


def resonance(*sweeps: xr.Dataset) -> Here:
    peaks = [_velocity_peak(one) for one in sweeps]
    natural = [natural_frequency(k3) for k3 in data.SWEPT_STIFFNESSES]
    holds = all(abs(a / b - 1) < 0.2 for a, b in zip(peaks, natural, strict=True))
    return trend(f"{listed(peaks)} Hz at k3 100, 300, 500 MN/m", holds, f"sqrt(k3/m1) is {listed(natural)} Hz")


def _velocity_peak(sweep: xr.Dataset) -> float:
    """Frequency [Hz] of the greatest swing of the bit's velocity, in windows of a quarter second."""
    middles, swings = motions.envelope(sweep, "v3", 0.25)
    return float(_swept_frequency(middles[np.argmax(swings)]))


def slips_until(*sweeps: xr.Dataset) -> Here:
    ends = []
    for sweep, k3 in zip(sweeps, data.SWEPT_STIFFNESSES, strict=True):
        slips = np.flatnonzero(np.diff(sweep["x4"].values) > 0)
        if not len(slips):
            return Here("nan", DIFFERS, "no slip at all")
        ends.append(_swept_frequency(float(sweep["time"][slips[-1]])) / natural_frequency(k3))
    return trend(f"{listed(ends)} times the natural frequency is where the last slip is", max(ends) < 1.25)


def more_in_hard(*sweeps: xr.Dataset) -> Here:
    depths = [1e3 * float(sweep["x4"][-1]) for sweep in sweeps]
    text = f"{listed(depths, 5)} mm at k3 100, 300, 500 MN/m"
    return trend(text, np.all(np.diff(depths) > 0), "the differences are small: the force, not k3, decides")


# Under pulses.


def staircase(motion: xr.Dataset) -> Here:
    """The growth of the hole outside of a pulse and the 4 ms after it."""
    share = motions.grown(motion, np.mod(motion["time"].values[:-1], 1 / 40) > 8e-3)
    return trend(f"{shown(share)} of the hole grows later than 4 ms after a pulse", share < 1e-3)


def jumps(one: Features) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.3f} mm off the rock after a blow", gap > 0.01)


def stays(one: Features) -> Here:
    gap = abs(1e3 * one["deepest_gap"])
    return claim(f"{gap:.3f} mm off the rock after a blow", gap < 0.01)


def mean_forces(*lanes: Features) -> Here:
    forces = [one["mean_force"] / 1e3 for one in lanes]
    note = "lowest at 150 kN and 10 Hz, highest at 300 kN and 40 Hz; with pulses of 2 ms half of it"
    return within_range(min(forces), max(forces), (10, 50), "kN", note=note)


def relief(*lanes: Features) -> Here:
    reliefs = np.array([one["relief"] for one in lanes]).reshape(2, 2)
    text = f"{listed(reliefs[0])} at 10, 40 Hz with D 100 kN; {listed(reliefs[1])} with 250 kN"
    return trend(text, np.all(np.diff(reliefs, axis=1) > 0) and np.all(np.diff(reliefs, axis=0) < 0))


# Over the stiffness.


def no_slip(*lanes: Features) -> Here:
    greatest = rates(lanes).max()
    return claim(f"{greatest:.3g} mm/s at the most", greatest == 0)


def onset(*lanes: Features) -> Here:
    slips = [k3 for k3, rate in zip(data.ONSET_STIFFNESSES, rates(lanes), strict=True) if rate > 0]
    if not slips:
        return Here("nan", DIFFERS, "no slip up to 100 MN/m")
    return number(min(slips) / 1e6, 0.01, "MN/m", 0.5, "lowest k3 with slip, of 41 from 0.01 to 100 MN/m")


def over_stiffness(*lanes: Features) -> Here:
    ours = rates(lanes)
    return trend(f"{listed(ours)} mm/s at k3 100 to 500 MN/m", np.all(np.diff(ours) >= 0) and ours[-1] > ours[0])


def less_and_less(*lanes: Features) -> Here:
    steps = np.diff(rates(lanes))
    holds = np.all(steps >= 0) and np.all(np.diff(steps[1:]) <= 0) and steps[-1] < 0.2 * steps.max()
    return trend(f"{listed(rates(lanes))} mm/s at k3 100 to 500 MN/m", holds)


def linear_in_soft(*lanes: Features) -> Here:
    ours = rates(lanes)
    if not (ours > 0).any():
        return Here("0 mm/s up to 50 MN/m", DIFFERS, "at 300 kN, zeta 1.1 and D 150 kN nothing slips in softer rock")
    straight = _straightness(np.array(data.SOFT_STIFFNESSES), ours)
    return trend(f"{listed(ours)} mm/s at k3 10 to 50 MN/m", straight > 0.98)


def low_is_linear(ds: xr.Dataset) -> Here:
    part = ds.sel(frequency=10.0)
    slips = part.rate_of_penetration.values > 0
    straight = _straightness(part.k3.values[slips], part.rate_of_penetration.values[slips])
    first = float(part.k3.values[slips][0] / 1e6)
    return trend(f"{straight:.3f} is R² of a line over k3, from {first:g} MN/m on", straight > 0.95)


def high_is_not(ds: xr.Dataset) -> Here:
    low, high = (ds.rate_of_penetration.sel(frequency=frequency).values for frequency in (10.0, 40.0))
    off = float(np.abs(high / 4 - low).max() / low.max())
    straight = _straightness(ds.k3.values, high)
    note = f"but the curve at 40 Hz is four times that at 10 Hz to {off:.1e}: the shape does not depend on P/D"
    return trend(f"{straight:.3f} is R² of a line over k3 at 40 Hz", straight < 0.95, note)


# Over the frequency, the threshold and the force.


def first_relief(*lanes: Features) -> Here:
    reliefs = [one["relief"] for one in lanes if one["rate_of_penetration"] > 0]
    if not reliefs:
        return Here("nan", DIFFERS, "no slip")
    note = "lowest P/D with slip, of 10 to 40 Hz; it is proportional to the lowest frequency tried"
    return number(100 * min(reliefs), 12.0, "%", 0.04, note, trend=min(reliefs) < 0.2)


def linear_in_frequency(*lanes: Features) -> Here:
    straight = _straightness(np.array(data.FREQUENCIES), rates(lanes))
    return claim(f"{straight:.6f} is R² of a line over the frequency", straight > 0.99)


def falls_with_threshold(*lanes: Features) -> Here:
    return trend(f"{listed(rates(lanes))} mm/s at D 50 to 250 kN", np.all(np.diff(rates(lanes)) < 0))


def line(*lanes: Features) -> Here:
    ours = rates(lanes)
    if not (ours > 0).any():
        why = "a pulse as high as the threshold does not bring damped rock to yield"
        return Here("0 mm/s at 10 to 40 Hz", DIFFERS, why)
    return trend(f"{listed(ours)} mm/s at 10 to 40 Hz", _straightness(np.array(data.FREQUENCIES), ours) > 0.99)


def curve_over_relief(*lanes: Features) -> Here:
    straight = _straightness(np.array([one["relief"] for one in lanes]), rates(lanes))
    note = "each blow slips as far, however often it falls, so the rate is proportional to P/D at a fixed force"
    return Here(f"{straight:.5f} is R² of a line over P/D", IN_TREND if straight < 0.99 else DIFFERS, note)


def rises_with_both(ds: xr.Dataset) -> Here:
    rate = ds.rate_of_penetration.sel(k3=500e6).values
    rising = np.all(np.diff(rate, axis=0) >= 0) and np.all(np.diff(rate, axis=1) >= 0)
    return trend(f"{1e3 * rate.max():.1f} mm/s at 300 kN and 40 Hz, rising along both axes", rising)
