"""Growth from zero, the limit cycle and its friction (Figs 5.14 to 5.33)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import (
    AGREES,
    DIFFERS,
    IN_TREND,
    LAST_DIGIT,
    Entry,
    Here,
    claim,
    listed,
    number,
    printed,
    trend,
)
from vibrojax.reproduce._needs import lane, motion
from vibrojax.reproduce.groups.self_excitation._precision import PERIOD, PERIOD_WITHIN, USUAL

FROM_INSIDE = motion("rotary", 40.0, sampling=2e-3)
FROM_OUTSIDE = motion("rotary", 40.0, start=(0.010, 3.5, 0.0, 0.0), sampling=2e-3)
SLOW_DRIVE = motion("rotary", 40.0, sampling=2e-3, v=0.5)
FAST_DRIVE = motion("rotary", 40.0, sampling=2e-3, v=2.5)
_HEAVY = {"m1": 150.0, "k1": 306250.0, "c2": 250.0, "beta": 400 / 150}
HEAVY_STRIKER = motion("rotary", 40.0, sampling=2e-3, gamma=float(np.sqrt(914260 / 400 / (306250 / 150))), **_HEAVY)
SPEEDS = (0.5, 1.0, 1.5, 2.0, 2.5)
OVER_SPEED = tuple(lane("rotary", settle=300.0, v=v) for v in SPEEDS)
CRITICAL = (3.0, 3.5, 4.0, 5.0)
AT_2_5 = tuple(lane("rotary", settle=300.0, v=2.5, v_cr=v_cr) for v_cr in CRITICAL)


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
    text = f"{listed(widths, 4)} N of friction's range at v 0.5, 1.5, 2.5 m/s"
    return trend(
        text,
        widths[0] < widths[1],
        "at 2.5 m/s the vibration has died away here, see fig-5.21; at 1.5 m/s it is from f_st to -f_st already",
    )


def grows_gradually(moving) -> Here:
    _, swings = signal.envelope(moving, "v1", 0.5)
    steady = swings[-1]
    first = int(np.argmax(swings > 0.95 * steady))
    rising = bool(np.all(np.diff(swings[2:first]) > 0))
    change = float(np.ptp(swings[first + 4 :]) / steady)
    return trend(
        f"{steady:.2f} m/s reached after {0.5 * first + 0.25:.1f} s, steady to {change:.1%}", rising and change < 0.05
    )


ENTRIES = (
    Entry(
        "fig-5.15",
        "m1 150, m2 400, k1 306250, k2 914260: frequencies of the bit and the striker",
        "two, an unstable periodic motion",
        (HEAVY_STRIKER,),
        heavy,
        "agreement where the weaker keeps 1 % of the other's power, trend where it has that from 5 to 10 s",
        (*USUAL, "R15"),
    ),
    Entry(
        "fig-5.18",
        "friction used up over the driving velocity",
        "a wider characteristic at a higher velocity",
        (SLOW_DRIVE, FROM_INSIDE, FAST_DRIVE),
        loop,
        "the range of the force grows from 0.5 to 1.5 m/s",
        USUAL,
    ),
    Entry(
        "fig-5.20",
        "bit velocity from zero, v 1.5",
        "grows gradually to a steady amplitude",
        (FROM_INSIDE,),
        grows_gradually,
        "the envelope rises up to 95 % of its end, and then stays within 5 %",
        USUAL,
    ),
    Entry(
        "fig-5.21",
        "bit velocity from zero, v 2.5",
        "grows to a steady amplitude like the others",
        AT_2_5,
        fastest_drive,
        "it repeats after one return to 0.1 %",
        USUAL,
    ),
    Entry(
        "fig-5.22",
        "settling time over the driving velocity",
        "grows with it; a few seconds at low velocity",
        OVER_SPEED,
        settling_over_speed,
        "each longer than the one before, from 0.5 to 2 m/s",
        (*USUAL, "R16"),
    ),
    Entry(
        "fig-5.24a",
        "the striker's lower frequency component",
        "two components for 3 to 4 s, then the lower vanishes",
        (FROM_INSIDE,),
        two_components,
        "over 5 % of the higher one's power in the first 4 s, under 0.01 % after 20 s",
        USUAL,
    ),
    Entry(
        "fig-5.24b",
        "the same in the bit",
        "hardly appears",
        (FROM_INSIDE,),
        bit_hardly_shows,
        "under 5 % of the higher one's power",
        USUAL,
    ),
    Entry(
        "fig-5.25",
        "frequency of the bit, Table 5.1 at v 1.5",
        "29.34 rad/s",
        (lane("rotary"),),
        lambda one: number(one.angular_frequency, 29.34, "rad/s", PERIOD_WITHIN),
        PERIOD,
        USUAL,
    ),
    Entry(
        "fig-5.26",
        "frequency of the striker, Table 5.1 at v 1.5",
        "4.6 Hz",
        (FROM_INSIDE,),
        lambda one: number(signal.peak(one, "v2", 1.0, 20.0, since=20.0)[0], 4.6, "Hz", 0.02),
        "2 %: 0.1 Hz, cut: the source has 29.34 rad/s, 4.67 Hz, as 4.6 Hz on its graphs",
        USUAL,
    ),
    Entry(
        "fig-5.27",
        "period of bit and striker",
        "0.214 s",
        (lane("rotary"),),
        lambda one: printed(one["period"], "0.214", "s"),
        LAST_DIGIT,
        USUAL,
    ),
    Entry(
        "fig-5.29",
        "how far the bit's velocity grows",
        "to the driving velocity, where it sticks",
        (lane("rotary"),),
        reaches_the_drive,
        "it sticks at all",
        ("R1", *USUAL),
    ),
    Entry(
        "fig-5.30",
        "limit cycle from x1 = 10 mm, x1' = 3.5 m/s and from zero",
        "the same limit cycle",
        (FROM_INSIDE, FROM_OUTSIDE),
        same_cycle,
        "swings equal to 0.1 %",
        USUAL,
    ),
    Entry(
        "fig-5.32",
        "sliding backwards on the rock",
        "never, 0 of the time",
        (lane("rotary"),),
        lambda one: claim(f"{one['reverse_fraction']:.4f} of the time", one["reverse_fraction"] == 0),
        "exactly",
        USUAL,
    ),
    Entry(
        "fig-5.33a",
        "friction at the bit's highest sliding speed",
        "its critical value F_cr, at v_cr",
        (FROM_INSIDE,),
        slowest_friction,
        "2 % of F(v_cr)",
        USUAL,
    ),
    Entry(
        "fig-5.33b",
        "static friction that holds the bit",
        "981 N",
        (FROM_INSIDE,),
        static_friction,
        "0.2 %: sampled every 2 ms",
        ("R1", *USUAL),
    ),
)
