"""How the results of the self-excitation without impact are judged."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, Here, claim, number, trend
from vibrojax.reproduce._needs import motion

SLOW = {"beta": 0.3, "v": 0.5, "c2": 75.0}
LOBED = {gamma: motion("rotary", 60.0, sampling=1e-3, gamma=float(gamma), **SLOW) for gamma in range(2, 8)}
SPEEDS = (0.5, 1.0, 1.5, 2.0, 2.5)
CRITICAL = (3.0, 3.5, 4.0, 5.0)
GAMMAS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
FINE_GAMMAS = tuple(round(0.80 + 0.01 * step, 2) for step in range(15))


def first_row(moving) -> Here:
    frequency, _ = signal.peak(moving, "x1", 1.0, 20.0, since=5.0)
    decays = signal.amplitude(moving, "x1", 20.0) < 0.5 * signal.amplitude(moving, "x1", 0.0, 5.0)
    here = number(2 * np.pi * frequency, 30.7, "rad/s", 0.01)
    return here if decays else Here(here.text, DIFFERS, "it does not decay here")


def settling_over_speed(*lanes) -> Here:
    times = [one["settling_time"] for one in lanes]
    text = f"{listed(times[:4])} s at v {listed(SPEEDS[:4])} m/s"
    return trend(text, bool(np.all(np.diff(times[:4]) > 0)), "at 2.5 m/s it decays here, see fig-5.21")


def fastest_drive(*lanes) -> Here:
    swings = [one["bit_amplitude"] for one in lanes]
    lasting = [one.regime == "impact-free" for one in lanes]
    from_here = next((v_cr for v_cr, lasts in zip(CRITICAL, lasting, strict=True) if lasts), None)
    note = (
        f"tried with v_cr {listed(CRITICAL)} m/s; it lasts {f'from {from_here} m/s on' if from_here else 'with none'}"
    )
    return claim(f"{1e3 * swings[0]:.2g} mm of amplitude are left after 300 s", lasting[0], note)


def settling_over_gamma(*lanes) -> Here:
    times = [one["settling_time"] for one in lanes]
    steps = np.diff(times)
    holds = bool(np.all(np.diff(times[3:]) > 0) and steps[-1] > 2 * steps[-2])
    return trend(
        f"{listed(times)} s at gamma {listed(GAMMAS)}", holds, "the last step is more than twice the one before"
    )


def border(*lanes) -> Here:
    sustained = [gamma for gamma, one in zip(FINE_GAMMAS, lanes, strict=True) if one.regime == "impact-free"]
    last = max(sustained, default=np.nan)
    return claim(f"{last:.2f} is the highest gamma sustained, in steps of 0.01", 0.8 <= last < 0.9)


def listed(values) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def two_components(moving) -> Here:
    shares, places = [], []
    for since, until in ((0.0, 4.0), (20.0, 40.0)):
        low = signal.peak(moving, "x2", 1.0, 3.5, since, until)
        high = signal.peak(moving, "x2", 4.0, 6.0, since, until)
        shares.append(low[1] / high[1])
        places.append((low[0], high[0]))
    text = f"{shares[0]:.2f} of the power at {places[0][0]:.2f} Hz in the first 4 s, {shares[1]:.0e} after 20 s"
    return claim(text, shares[0] > 0.05 and shares[1] < 1e-4, f"the higher one is {places[1][1]:.2f} Hz")


def bit_hardly_shows(moving) -> Here:
    low, high = (signal.peak(moving, "x1", *band, 0.0, 4.0)[1] for band in ((1.0, 3.5), (4.0, 6.0)))
    return trend(f"{low / high:.3f} of the power in the first 4 s", low / high < 0.05)


def same_cycle(inside, outside) -> Here:
    here, there = (signal.amplitude(one, "x1", 30.0) for one in (inside, outside))
    greater = signal.amplitude(outside, "x1", 0.0, 1.0)
    note = f"from outside it begins with {1e3 * greater:.0f} mm"
    return claim(
        f"{1e3 * here:.2f} mm from the centre, {1e3 * there:.2f} mm from outside", abs(here / there - 1) < 1e-3, note
    )


def reaches_the_drive(one) -> Here:
    stuck = one["stick_fraction"]
    return claim(f"{stuck:.3f} of the time at the drive's speed, sticking", stuck > 0)


def slowest_friction(moving) -> Here:
    sliding = signal.part(moving, "v1", 30.0) + 1.5
    least = signal.part(moving, "friction_force", 30.0)[np.argmax(sliding)]
    text = f"{least:.0f} N at the highest sliding speed, {sliding.max():.2f} m/s"
    return claim(text, abs(least / (981 / 3) - 1) < 0.02, "F(v_cr) = f_st/3 = 327 N")


def static_friction(moving) -> Here:
    return number(float(signal.part(moving, "friction_force", 30.0).max()), 981.0, "N", 0.002)


def lag(one, at_most: float, at_least: float) -> Here:
    lag = abs(one["phase_lag"])
    return claim(f"{lag:.2f} rad behind the bit, at {one.frequency:.2f} Hz", at_least <= lag <= at_most)


def equal(*lanes) -> Here:
    ratios = [one["striker_amplitude"] / one["bit_amplitude"] for one in lanes]
    return claim(f"{listed(ratios)} times the bit's at gamma 8, 8.5, 9", max(abs(ratio - 1) for ratio in ratios) < 0.03)


def lobes(*motions) -> Here:
    found = [signal.lobes(one) for one in motions]
    right = sum(count == gamma for count, gamma in zip(found, LOBED, strict=True))
    verdict = AGREES if right == len(found) else IN_TREND if right >= len(found) - 1 else DIFFERS
    return Here(f"{', '.join(map(str, found))} lobes at gamma {', '.join(map(str, LOBED))}", verdict)


def lower(moving) -> Here:
    low, weak = signal.peak(moving, "v2", 4.0, 8.0, since=40.0)
    _, strong = signal.peak(moving, "v2", 10.0, 15.0, since=40.0)
    note = f"its power in the striker's velocity is {weak / strong:.2f} of the higher one's"
    return number(low, 6.14, "Hz", 0.02, note)


def higher(moving) -> Here:
    high, _ = signal.peak(moving, "v2", 10.0, 15.0, since=40.0)
    return claim(f"{high:.2f} Hz", 12.3 * 0.99 <= high <= 12.8 * 1.01)


def heavy(moving) -> Here:
    low, weak = signal.peak(moving, "x2", 1.0, 8.0, 5.0, 10.0)
    high, strong = signal.peak(moving, "x2", 10.0, 20.0, 5.0, 10.0)
    _, late = signal.peak(moving, "x2", 1.0, 8.0, 20.0)
    _, main = signal.peak(moving, "x2", 10.0, 20.0, 20.0)
    note = f"after 20 s the lower has {late / main:.0e} of the higher one's power: it dies away here"
    text = f"2 frequencies, {low:.2f} and {high:.2f} Hz, powers {weak / strong:.2g} to 1 from 5 to 10 s"
    return Here(text, AGREES if late > 0.01 * main else IN_TREND if weak > 0.01 * strong else DIFFERS, note)


def loop(*motions) -> Here:
    widths = [np.ptp(signal.part(one, "friction_force", 30.0)) for one in motions]
    text = f"{listed(widths)} N of friction's range at v 0.5, 1.5, 2.5 m/s"
    return trend(text, widths[0] < widths[1], "beyond 1.5 m/s the whole falling branch is used")


def grows_gradually(moving) -> Here:
    _, swings = signal.envelope(moving, "v1", 0.5)
    steady = swings[-1]
    first = int(np.argmax(swings > 0.95 * steady))
    rising = bool(np.all(np.diff(swings[2:first]) > 0))
    change = float(np.ptp(swings[first + 4 :]) / steady)
    return trend(
        f"{steady:.2f} m/s reached after {0.5 * first + 0.25:.1f} s, steady to {change:.1%}", rising and change < 0.05
    )
