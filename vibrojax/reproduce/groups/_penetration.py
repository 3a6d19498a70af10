"""How the results of the forced penetration are judged."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import DIFFERS, IN_TREND, Here, claim, number, trend, within_range
from vibrojax.reproduce.groups._impact import listed

FREQUENCIES = (10.0, 20.0, 30.0, 40.0)


def speed(one) -> float:
    """Rate of penetration [mm/s]."""
    return 1e3 * one["rate_of_penetration"]


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


def staircase(moving) -> Here:
    """The growth of the hole outside of a pulse and the 4 ms after it."""
    growth = np.diff(moving["x4"].values)
    late = np.mod(moving["time"].values[:-1], 1 / 40) > 8e-3
    share = float(growth[late].sum() / growth.sum())
    return trend(f"{share:.1e} of the hole grows later than 4 ms after a pulse", share < 1e-3)


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


def no_slip(*lanes) -> Here:
    rates = [speed(one) for one in lanes]
    return claim(f"{max(rates):.3g} mm/s at the most", max(rates) == 0)


ONSETS = tuple(float(k3) for k3 in np.round(np.geomspace(1e4, 1e8, 41), -2))


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


SOFT_ROCKS = (10e6, 20e6, 30e6, 40e6, 50e6)


def linear_in_soft(*lanes) -> Here:
    rates = np.array([speed(one) for one in lanes])
    if not (rates > 0).any():
        return Here("0 mm/s up to 50 MN/m", DIFFERS, "at 300 kN, zeta 1.1 and D 150 kN nothing slips in softer rock")
    return trend(f"{listed(rates)} mm/s at k3 10 to 50 MN/m", straightness(np.array(SOFT_ROCKS), rates) > 0.98)


def straightness(x: np.ndarray, y: np.ndarray) -> float:
    """R² of a straight line."""
    return float(np.corrcoef(x, y)[0, 1] ** 2) if np.ptp(y) > 0 else 1.0


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


def first_relief(*lanes) -> Here:
    found = [one["relief"] for one in lanes if one["rate_of_penetration"] > 0]
    if not found:
        return Here("nan", DIFFERS, "no slip")
    note = "lowest P/D with slip, of 10 to 40 Hz; it is proportional to the lowest frequency tried"
    return number(100 * min(found), 12.0, "%", 0.1, note, trend=min(found) < 0.2)


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
