"""Judges of the self-excitation without impact: synchronisation, growth from zero, the frequency ratio."""

from collections.abc import Callable

import numpy as np
import xarray as xr

from vibrojax.models.physics.modes import natural_frequencies
from vibrojax.reproduce import datasets_chapter5 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.needs import Features
from vibrojax.reproduce.verdicts import AGREES, DIFFERS, IN_TREND, Here, claim, listed, number, printed, trend

PERIOD_WITHIN = 0.008
PERIOD = "0.8 %: 1 ms of a period of some 0.25 s, as in Fig. 5.27, and a unit of the third digit, which is cut (R30)"
"""The tolerance of frequencies within `PERIOD_WITHIN`."""


def synchronised(row: data.Row) -> Callable[[Features], Here]:
    """The synchronisation frequency beside that of a row of Table 5.3."""

    def judge(one: Features) -> Here:
        upper = float(natural_frequencies(row.modes)[1])
        note = f"eq. 5.16 gives {upper:.2f} rad/s, and the source prints {row.eq_5_16} for it"
        return number(one.angular_frequency, row.simulation, "rad/s", PERIOD_WITHIN, note)

    return judge


def first_row(motion: xr.Dataset) -> Here:
    frequency, _ = motions.peak(motion, "x1", 1.0, 20.0, since=5.0)
    decays = motions.amplitude(motion, "x1", 20.0) < 0.5 * motions.amplitude(motion, "x1", 0.0, 5.0)
    here = number(2 * np.pi * frequency, 30.7, "rad/s", PERIOD_WITHIN)
    return here if decays else Here(here.text, DIFFERS, "it does not decay here")


def heavy_striker(motion: xr.Dataset) -> Here:
    low, weak = motions.peak(motion, "x2", 1.0, 8.0, 5.0, 10.0)
    high, strong = motions.peak(motion, "x2", 10.0, 20.0, 5.0, 10.0)
    _, late = motions.peak(motion, "x2", 1.0, 8.0, 20.0)
    _, main = motions.peak(motion, "x2", 10.0, 20.0, 20.0)
    note = f"after 20 s the lower has {late / main:.0e} of the higher one's power: it dies away here"
    text = f"2 frequencies, {low:.2f} and {high:.2f} Hz, powers {weak / strong:.2g} to 1 from 5 to 10 s"
    return Here(text, AGREES if late > 0.01 * main else IN_TREND if weak > 0.01 * strong else DIFFERS, note)


def friction_used(*over_speed: xr.Dataset) -> Here:
    widths = [np.ptp(motions.part(one, "friction_force", 30.0)) for one in over_speed]
    text = f"{listed(widths, 4)} N of friction's range at v 0.5, 1.5, 2.5 m/s"
    note = "at 2.5 m/s the vibration has died away here, see fig-5.21; at 1.5 m/s it is from f_st to -f_st already"
    return trend(text, widths[0] < widths[1], note)


def grows_gradually(motion: xr.Dataset) -> Here:
    _, swings = motions.envelope(motion, "v1", 0.5)
    steady = swings[-1]
    first = int(np.argmax(swings > 0.95 * steady))
    rising = np.all(np.diff(swings[2:first]) > 0)
    change = float(np.ptp(swings[first + 4 :]) / steady)
    text = f"{steady:.2f} m/s reached after {0.5 * first + 0.25:.1f} s, steady to {change:.1%}"
    return trend(text, rising and change < 0.05)


def fastest_drive(*over_v_cr: Features) -> Here:
    sustained = [v_cr for v_cr, one in zip(data.STRIBECK_SPEEDS, over_v_cr, strict=True) if _sustained(one)]
    lasts = f"from {sustained[0]} m/s on" if sustained else "with none"
    note = f"tried with v_cr {listed(data.STRIBECK_SPEEDS)} m/s; it lasts {lasts}"
    first = over_v_cr[0]
    return claim(f"{1e3 * first['bit_amplitude']:.2g} mm of amplitude are left after 300 s", _sustained(first), note)


def _sustained(one: Features) -> bool:
    return one.regime == "impact-free"


def settling_over_speed(*lanes: Features) -> Here:
    times = [one["settling_time"] for one in lanes]
    text = f"{listed(times[:4])} s at v {listed(data.SPEEDS[:4])} m/s"
    return trend(text, np.all(np.diff(times[:4]) > 0), "at 2.5 m/s it decays here, see fig-5.21")


def two_components(motion: xr.Dataset) -> Here:
    early, late = (
        (motions.peak(motion, "x2", 1.0, 3.5, *span), motions.peak(motion, "x2", 4.0, 6.0, *span))
        for span in ((0.0, 4.0), (20.0, 40.0))
    )
    shares = [low.power / high.power for low, high in (early, late)]
    text = f"{shares[0]:.2f} of the power at {early[0].frequency:.2f} Hz in the first 4 s, {shares[1]:.0e} after 20 s"
    return claim(text, shares[0] > 0.05 and shares[1] < 1e-4, f"the higher one is {late[1].frequency:.2f} Hz")


def bit_hardly_shows(motion: xr.Dataset) -> Here:
    low, high = (motions.peak(motion, "x1", *band, 0.0, 4.0).power for band in ((1.0, 3.5), (4.0, 6.0)))
    return trend(f"{low / high:.3f} of the power in the first 4 s", low / high < 0.05)


def bit_frequency(one: Features) -> Here:
    return number(one.angular_frequency, 29.34, "rad/s", PERIOD_WITHIN)


def striker_frequency(motion: xr.Dataset) -> Here:
    return number(motions.peak(motion, "v2", 1.0, 20.0, since=20.0).frequency, 4.6, "Hz", 0.02)


def period(one: Features) -> Here:
    return printed(one["period"], "0.214", "s")


def reaches_the_drive(one: Features) -> Here:
    stuck = one["stick_fraction"]
    return claim(f"{stuck:.3f} of the time at the drive's speed, sticking", stuck > 0)


def same_cycle(inside: xr.Dataset, outside: xr.Dataset) -> Here:
    here, there = (motions.amplitude(one, "x1", 30.0) for one in (inside, outside))
    greater = motions.amplitude(outside, "x1", 0.0, 1.0)
    text = f"{1e3 * here:.2f} mm from the centre, {1e3 * there:.2f} mm from outside"
    return claim(text, abs(here / there - 1) < 1e-3, f"from outside it begins with {1e3 * greater:.0f} mm")


def never_backwards(one: Features) -> Here:
    return claim(f"{one['reverse_fraction']:.4f} of the time", one["reverse_fraction"] == 0)


def least_friction(motion: xr.Dataset) -> Here:
    sliding = motions.part(motion, "v1", 30.0) + 1.5
    least = motions.part(motion, "friction_force", 30.0)[np.argmax(sliding)]
    text = f"{least:.0f} N at the highest sliding speed, {np.max(sliding):.2f} m/s"
    return claim(text, abs(least / (981 / 3) - 1) < 0.02, "F(v_cr) = f_st/3 = 327 N")


def static_friction(motion: xr.Dataset) -> Here:
    return number(float(motions.part(motion, "friction_force", 30.0).max()), 981.0, "N", 0.002)


def settling_over_gamma(*lanes: Features) -> Here:
    times = [one["settling_time"] for one in lanes]
    steps = np.diff(times)
    holds = np.all(np.diff(times[3:]) > 0) and steps[-1] > 2 * steps[-2]
    text = f"{listed(times)} s at gamma {listed(data.GAMMAS)}"
    return trend(text, holds, "the last step is more than twice the one before")


def border(*lanes: Features) -> Here:
    sustained = [gamma for gamma, one in zip(data.FINE_GAMMAS, lanes, strict=True) if _sustained(one)]
    highest = max(sustained, default=np.nan)
    return claim(f"{highest:.2f} is the highest gamma sustained, in steps of 0.01", 0.8 <= highest < 0.9)


def decays_soon(motion: xr.Dataset) -> Here:
    fourth, first = motions.amplitude(motion, "v1", 3.0, 4.0), motions.amplitude(motion, "v1", 0.0, 1.0)
    return trend(f"{fourth / first:.2f} of the first second's velocity is left in the fourth", fourth < 0.5 * first)


def lag_within(least: float, most: float) -> Callable[[Features], Here]:
    """Whether the striker is between two phases [rad] behind the bit."""

    def judge(one: Features) -> Here:
        lag = abs(one["phase_lag"])
        return claim(f"{lag:.2f} rad behind the bit, at {one.frequency:.2f} Hz", least <= lag <= most)

    return judge


def equal_amplitudes(*lanes: Features) -> Here:
    ratios = [one["striker_amplitude"] / one["bit_amplitude"] for one in lanes]
    return claim(f"{listed(ratios)} times the bit's at gamma 8, 8.5, 9", max(abs(ratio - 1) for ratio in ratios) < 0.03)


def lobes(*over_gamma: xr.Dataset) -> Here:
    counts = [motions.lobes(one) for one in over_gamma]
    others = [
        f"{listed([motions.lobes(one, abscissa) for one in over_gamma])} with {abscissa}" for abscissa in (0.3, 0.5)
    ]
    note = f"where slow is under 0.4 of the greatest velocity (R18); {', '.join(others)}"
    return claim(f"{listed(counts)} lobes at gamma {listed(data.LOBED)}", counts == list(data.LOBED), note)


def three_lobes(motion: xr.Dataset) -> Here:
    count = motions.lobes(motion)
    return claim(f"{count} lobes", count == 3)


def lower_frequency(motion: xr.Dataset) -> Here:
    low, weak = motions.peak(motion, "v2", 4.0, 8.0, since=40.0)
    _, strong = motions.peak(motion, "v2", 10.0, 15.0, since=40.0)
    note = f"its power in the striker's velocity is {weak / strong:.2f} of the higher one's"
    return number(low, 6.14, "Hz", 0.01, note)


def higher_frequency(motion: xr.Dataset) -> Here:
    high = motions.peak(motion, "v2", 10.0, 15.0, since=40.0).frequency
    return claim(f"{high:.2f} Hz", 12.3 <= high <= 12.8)


def one_cycle(one: Features) -> Here:
    return claim(f"{one['cycles']:.0f} return to close", one["cycles"] == 1)
