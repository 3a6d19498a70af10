"""Self-excitation without impact: chapter 5, section 4 (the scene *rotary*)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, Entry, Here, claim, number, trend
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import lane, motion
from vibrojax.reproduce.groups._table_5_3 import ROWS
from vibrojax.reproduce.pictures import self_excitation as pictures

USUAL = ("R4", "R5")
_PERIOD = "1 %: a period of some 0.2 s read to 1 ms, printed to three digits"
_READ_OFF = "2 %: read off a spectrum with bins of some 0.1 Hz"

FROM_INSIDE = motion("rotary", 40.0, sampling=2e-3)
FROM_OUTSIDE = motion("rotary", 40.0, start=(0.010, 3.5, 0.0, 0.0), sampling=2e-3)
SLOW_DRIVE = motion("rotary", 40.0, sampling=2e-3, v=0.5)
FAST_DRIVE = motion("rotary", 40.0, sampling=2e-3, v=2.5)
DECAYING = motion("rotary", 30.0, sampling=5e-3, beta=0.3, gamma=0.9)
STRONGLY_DECAYING = motion("rotary", 30.0, sampling=5e-3, beta=0.3, gamma=1.2)
TWO = {"beta": 0.4, "gamma": 1.2, "k1": 625000.0, "c2": 75.0, "v": 0.5}
TWO_FREQUENCIES = motion("rotary", 48.0, sampling=2e-3, **TWO)
_HEAVY = {"m1": 150.0, "k1": 306250.0, "c2": 250.0, "beta": 400 / 150}
HEAVY_STRIKER = motion("rotary", 40.0, sampling=2e-3, gamma=float(np.sqrt(914260 / 400 / (306250 / 150))), **_HEAVY)
SLOW = {"beta": 0.3, "v": 0.5, "c2": 75.0}
LOBED = {gamma: motion("rotary", 60.0, sampling=1e-3, gamma=float(gamma), **SLOW) for gamma in range(2, 8)}
TEN = motion("rotary", 60.0, sampling=1e-3, gamma=10.0, **SLOW)
NINE = motion("rotary", 60.0, sampling=1e-3, gamma=9.0, **SLOW)

SPEEDS = (0.5, 1.0, 1.5, 2.0, 2.5)
OVER_SPEED = tuple(lane("rotary", settle=300.0, v=v) for v in SPEEDS)
CRITICAL = (3.0, 3.5, 4.0, 5.0)
AT_2_5 = tuple(lane("rotary", settle=300.0, v=2.5, v_cr=v_cr) for v_cr in CRITICAL)
GAMMAS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
OVER_GAMMA = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in GAMMAS)
FINE_GAMMAS = tuple(round(0.80 + 0.01 * step, 2) for step in range(15))
BORDER = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in FINE_GAMMAS)


def _row(index: int) -> Entry:
    row = ROWS[index - 1]
    need = lane("rotary", k1=250.0 * row.w1**2, v=row.v, beta=row.beta, gamma=row.gamma)
    return Entry(
        f"table-5.3.{index}",
        f"synchronisation frequency, w1 {row.w1}, v {row.v}, beta {row.beta}, gamma {row.gamma}",
        f"{row.simulation} rad/s",
        (need,),
        lambda one: number(one.angular_frequency, row.simulation, "rad/s", 0.01),
        _PERIOD,
        (*USUAL, *(("R7",) if index == 10 else ())),
    )


def _first_row(moving) -> Here:
    frequency, _ = signal.peak(moving, "x1", 1.0, 20.0, since=5.0)
    decays = signal.amplitude(moving, "x1", 20.0) < 0.5 * signal.amplitude(moving, "x1", 0.0, 5.0)
    here = number(2 * np.pi * frequency, 30.7, "rad/s", 0.01)
    return here if decays else Here(here.text, DIFFERS, "it does not decay here")


def _settling_over_speed(*lanes) -> Here:
    times = [one["settling_time"] for one in lanes]
    text = f"{_listed(times[:4])} s at v {_listed(SPEEDS[:4])} m/s"
    return trend(text, bool(np.all(np.diff(times[:4]) > 0)), "at 2.5 m/s it decays here, see fig-5.21")


def _fastest_drive(*lanes) -> Here:
    swings = [one["bit_amplitude"] for one in lanes]
    lasting = [one.regime == "impact-free" for one in lanes]
    from_here = next((v_cr for v_cr, lasts in zip(CRITICAL, lasting, strict=True) if lasts), None)
    note = (
        f"tried with v_cr {_listed(CRITICAL)} m/s; it lasts {f'from {from_here} m/s on' if from_here else 'with none'}"
    )
    return claim(f"{1e3 * swings[0]:.2g} mm of amplitude are left after 300 s", lasting[0], note)


def _settling_over_gamma(*lanes) -> Here:
    times = [one["settling_time"] for one in lanes]
    steps = np.diff(times)
    holds = bool(np.all(np.diff(times[3:]) > 0) and steps[-1] > 2 * steps[-2])
    return trend(
        f"{_listed(times)} s at gamma {_listed(GAMMAS)}", holds, "the last step is more than twice the one before"
    )


def _border(*lanes) -> Here:
    sustained = [gamma for gamma, one in zip(FINE_GAMMAS, lanes, strict=True) if one.regime == "impact-free"]
    last = max(sustained, default=np.nan)
    return claim(f"{last:.2f} is the highest gamma sustained, in steps of 0.01", 0.8 <= last < 0.9)


def _listed(values) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _two_components(moving) -> Here:
    shares, places = [], []
    for since, until in ((0.0, 4.0), (20.0, 40.0)):
        low = signal.peak(moving, "x2", 1.0, 3.5, since, until)
        high = signal.peak(moving, "x2", 4.0, 6.0, since, until)
        shares.append(low[1] / high[1])
        places.append((low[0], high[0]))
    text = f"{shares[0]:.2f} of the power at {places[0][0]:.2f} Hz in the first 4 s, {shares[1]:.0e} after 20 s"
    return claim(text, shares[0] > 0.05 and shares[1] < 1e-4, f"the higher one is {places[1][1]:.2f} Hz")


def _bit_hardly_shows(moving) -> Here:
    low, high = (signal.peak(moving, "x1", *band, 0.0, 4.0)[1] for band in ((1.0, 3.5), (4.0, 6.0)))
    return trend(f"{low / high:.3f} of the power in the first 4 s", low / high < 0.05)


def _same_cycle(inside, outside) -> Here:
    here, there = (signal.amplitude(one, "x1", 30.0) for one in (inside, outside))
    greater = signal.amplitude(outside, "x1", 0.0, 1.0)
    note = f"from outside it begins with {1e3 * greater:.0f} mm"
    return claim(
        f"{1e3 * here:.2f} mm from the centre, {1e3 * there:.2f} mm from outside", abs(here / there - 1) < 1e-3, note
    )


def _reaches_the_drive(one) -> Here:
    stuck = one["stick_fraction"]
    return claim(f"{stuck:.3f} of the time at the drive's speed, sticking", stuck > 0)


def _slowest_friction(moving) -> Here:
    sliding = signal.part(moving, "v1", 30.0) + 1.5
    least = signal.part(moving, "friction_force", 30.0)[np.argmax(sliding)]
    text = f"{least:.0f} N at the highest sliding speed, {sliding.max():.2f} m/s"
    return claim(text, abs(least / (981 / 3) - 1) < 0.02, "F(v_cr) = f_st/3 = 327 N")


def _static_friction(moving) -> Here:
    return number(float(signal.part(moving, "friction_force", 30.0).max()), 981.0, "N", 0.002)


def _lag(one, at_most: float, at_least: float) -> Here:
    lag = abs(one["phase_lag"])
    return claim(f"{lag:.2f} rad behind the bit, at {one.frequency:.2f} Hz", at_least <= lag <= at_most)


def _equal(*lanes) -> Here:
    ratios = [one["striker_amplitude"] / one["bit_amplitude"] for one in lanes]
    return claim(
        f"{_listed(ratios)} times the bit's at gamma 8, 8.5, 9", max(abs(ratio - 1) for ratio in ratios) < 0.03
    )


def _lobes(*motions) -> Here:
    found = [signal.lobes(one) for one in motions]
    right = sum(count == gamma for count, gamma in zip(found, LOBED, strict=True))
    verdict = AGREES if right == len(found) else IN_TREND if right >= len(found) - 1 else DIFFERS
    return Here(f"{', '.join(map(str, found))} lobes at gamma {', '.join(map(str, LOBED))}", verdict)


def _lower(moving) -> Here:
    low, weak = signal.peak(moving, "v2", 4.0, 8.0, since=40.0)
    _, strong = signal.peak(moving, "v2", 10.0, 15.0, since=40.0)
    note = f"its power in the striker's velocity is {weak / strong:.2f} of the higher one's"
    return number(low, 6.14, "Hz", 0.02, note)


def _higher(moving) -> Here:
    high, _ = signal.peak(moving, "v2", 10.0, 15.0, since=40.0)
    return claim(f"{high:.2f} Hz", 12.3 * 0.99 <= high <= 12.8 * 1.01)


def _heavy(moving) -> Here:
    low, weak = signal.peak(moving, "x2", 1.0, 8.0, 5.0, 10.0)
    high, strong = signal.peak(moving, "x2", 10.0, 20.0, 5.0, 10.0)
    _, late = signal.peak(moving, "x2", 1.0, 8.0, 20.0)
    _, main = signal.peak(moving, "x2", 10.0, 20.0, 20.0)
    note = f"after 20 s the lower has {late / main:.0e} of the higher one's power: it dies away here"
    text = f"2 frequencies, {low:.2f} and {high:.2f} Hz, powers {weak / strong:.2g} to 1 from 5 to 10 s"
    return Here(text, AGREES if late > 0.01 * main else IN_TREND if weak > 0.01 * strong else DIFFERS, note)


def _loop(*motions) -> Here:
    widths = [np.ptp(signal.part(one, "friction_force", 30.0)) for one in motions]
    text = f"{_listed(widths)} N of friction's range at v 0.5, 1.5, 2.5 m/s"
    return trend(text, widths[0] < widths[1], "beyond 1.5 m/s the whole falling branch is used")


def _grows_gradually(moving) -> Here:
    _, swings = signal.envelope(moving, "v1", 0.5)
    steady = swings[-1]
    first = int(np.argmax(swings > 0.95 * steady))
    rising = bool(np.all(np.diff(swings[2:first]) > 0))
    change = float(np.ptp(swings[first + 4 :]) / steady)
    return trend(
        f"{steady:.2f} m/s reached after {0.5 * first + 0.25:.1f} s, steady to {change:.1%}", rising and change < 0.05
    )


GROUP = Group(
    name="self-excitation",
    title="Self-excitation without impact",
    text="The bit slides on rock whose friction falls with speed, the striker hangs on it by a spring, and there is no "
    "contact between them. The motion grows by itself until the bit sticks. Where nothing else is said m1 = 250 kg, "
    "k1 = 156250 N/m, c2 = 250 N s/m, beta 0.4, gamma 0.75, v = 1.5 m/s.",
    entries=(
        Entry(
            "table-5.3.1",
            "synchronisation frequency, w1 25, v 1.5, beta 0.3, gamma 0.9",
            "30.7 rad/s, and decays",
            (DECAYING,),
            _first_row,
            _PERIOD,
            USUAL,
        ),
        *(_row(index) for index in range(2, 12)),
        Entry(
            "table-5.2",
            "frequency at m1 300, k1 326700, beta 0.3, gamma 0.8, v 0.8",
            "6.1 Hz",
            (lane("rotary", m1=300.0, k1=326700.0, beta=0.3, gamma=0.8, v=0.8),),
            lambda one: number(one.frequency, 6.1, "Hz", 0.01),
            "1 %: half a unit of the last printed digit",
            USUAL,
        ),
        Entry(
            "fig-5.15",
            "m1 150, m2 400, k1 306250, k2 914260: frequencies of the bit and the striker",
            "two, an unstable periodic motion",
            (HEAVY_STRIKER,),
            _heavy,
            "agreement where the weaker keeps 1 % of the other's power, trend where it has that from 5 to 10 s",
            (*USUAL, "R15"),
        ),
        Entry(
            "fig-5.18",
            "friction used up over the driving velocity",
            "a wider characteristic at a higher velocity",
            (SLOW_DRIVE, FROM_INSIDE, FAST_DRIVE),
            _loop,
            "the range of the force grows from 0.5 to 1.5 m/s",
            USUAL,
        ),
        Entry(
            "fig-5.20",
            "bit velocity from zero, v 1.5",
            "grows gradually to a steady amplitude",
            (FROM_INSIDE,),
            _grows_gradually,
            "the envelope rises up to 95 % of its end, and then stays within 5 %",
            USUAL,
        ),
        Entry(
            "fig-5.21",
            "bit velocity from zero, v 2.5",
            "grows to a steady amplitude like the others",
            AT_2_5,
            _fastest_drive,
            "it repeats after one return to 0.1 %",
            USUAL,
        ),
        Entry(
            "fig-5.22",
            "settling time over the driving velocity",
            "grows with it; a few seconds at low velocity",
            OVER_SPEED,
            _settling_over_speed,
            "each longer than the one before, from 0.5 to 2 m/s",
            (*USUAL, "R16"),
        ),
        Entry(
            "fig-5.24a",
            "the striker's lower frequency component",
            "two components for 3 to 4 s, then the lower vanishes",
            (FROM_INSIDE,),
            _two_components,
            "over 5 % of the higher one's power in the first 4 s, under 0.01 % after 20 s",
            USUAL,
        ),
        Entry(
            "fig-5.24b",
            "the same in the bit",
            "hardly appears",
            (FROM_INSIDE,),
            _bit_hardly_shows,
            "under 5 % of the higher one's power",
            USUAL,
        ),
        Entry(
            "fig-5.25",
            "frequency of the bit, Table 5.1 at v 1.5",
            "29.34 rad/s",
            (lane("rotary"),),
            lambda one: number(one.angular_frequency, 29.34, "rad/s", 0.01),
            _PERIOD,
            USUAL,
        ),
        Entry(
            "fig-5.26",
            "frequency of the striker, Table 5.1 at v 1.5",
            "4.6 Hz",
            (FROM_INSIDE,),
            lambda one: number(signal.peak(one, "v2", 1.0, 20.0, since=20.0)[0], 4.6, "Hz", 0.02),
            _READ_OFF,
            USUAL,
        ),
        Entry(
            "fig-5.27",
            "period of bit and striker",
            "0.214 s",
            (lane("rotary"),),
            lambda one: number(one["period"], 0.214, "s", 0.0047),
            "1 ms: its last digit",
            USUAL,
        ),
        Entry(
            "fig-5.29",
            "how far the bit's velocity grows",
            "to the driving velocity, where it sticks",
            (lane("rotary"),),
            _reaches_the_drive,
            "it sticks at all",
            USUAL,
        ),
        Entry(
            "fig-5.30",
            "limit cycle from x1 = 10 mm, x1' = 3.5 m/s and from zero",
            "the same limit cycle",
            (FROM_INSIDE, FROM_OUTSIDE),
            _same_cycle,
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
            _slowest_friction,
            "2 % of F(v_cr)",
            USUAL,
        ),
        Entry(
            "fig-5.33b",
            "static friction that holds the bit",
            "981 N",
            (FROM_INSIDE,),
            _static_friction,
            "0.2 %: sampled every 2 ms",
            USUAL,
        ),
        Entry(
            "fig-5.38",
            "settling time over gamma at beta 0.3, v 1.5",
            "grows; steeply at gamma 0.7",
            OVER_GAMMA,
            _settling_over_gamma,
            "rising from gamma 0.4 on, and the step from 0.7 to 0.8 over twice that before",
            (*USUAL, "R16"),
        ),
        Entry(
            "fig-5.39",
            "highest gamma at which the vibration lasts, beta 0.3, v 1.5",
            "0.8; decays at 0.9",
            BORDER,
            _border,
            "between 0.8 and 0.9",
            USUAL,
        ),
        Entry(
            "fig-5.40",
            "gamma 1.2, v 1.5",
            "decays after a few oscillations",
            (STRONGLY_DECAYING,),
            lambda one: trend(
                f"{signal.amplitude(one, 'v1', 3.0, 4.0) / signal.amplitude(one, 'v1', 0.0, 1.0):.2f} "
                "of the first second's velocity is left in the fourth",
                signal.amplitude(one, "v1", 3.0, 4.0) < 0.5 * signal.amplitude(one, "v1", 0.0, 1.0),
            ),
            "less than half is left",
            USUAL,
        ),
        Entry(
            "fig-5.41",
            "frequency at gamma 1.2, v 0.5, c2 75",
            "3.2 Hz, sustained",
            (lane("rotary", gamma=1.2, **SLOW),),
            lambda one: number(one.frequency, 3.2, "Hz", 0.02),
            _READ_OFF,
            USUAL,
        ),
        *(
            Entry(
                name,
                f"bit and striker at gamma {gamma}, v 0.5, c2 75",
                said,
                (lane("rotary", gamma=gamma, **SLOW),),
                lambda one, most=most, least=least: _lag(one, most, least),
                "within 0.3 rad of 0 or of pi",
                USUAL,
            )
            for name, gamma, said, most, least in (
                ("fig-5.42", 1.0, "in counter-phase, 3.14 rad", np.pi, np.pi - 0.3),
                ("sec-5.5b", 1.1, "transition: in phase or counter-phase", np.pi, np.pi - 0.3),
                ("fig-5.43", 1.2, "in phase, 0 rad", 0.3, 0.0),
                ("sec-5.5c", 1.3, "in phase at the lower mode, 0 rad", 0.3, 0.0),
            )
        ),
        Entry(
            "fig-5.44",
            "lobes of the striker's phase portrait, gamma 2 to 7",
            "as many as the whole part of gamma",
            tuple(LOBED.values()),
            _lobes,
            "agreement where all are right, trend where all but one are",
            (*USUAL, "R18"),
        ),
        Entry(
            "fig-5.45",
            "lobes of the striker's phase portrait at gamma 3",
            "3 lobes",
            (LOBED[3],),
            lambda one: claim(f"{signal.lobes(one)} lobes", signal.lobes(one) == 3),
            "the count",
            (*USUAL, "R18"),
        ),
        Entry(
            "fig-5.47",
            "amplitude of the striker at gamma 8 to 9, v 0.5, c2 75",
            "equal to the bit's, 1 times",
            tuple(lane("rotary", gamma=gamma, **SLOW) for gamma in (8.0, 8.5, 9.0)),
            _equal,
            "3 %",
            USUAL,
        ),
        Entry(
            "fig-5.50a",
            "lower of two frequencies at beta 0.4, gamma 1.2, k1 625000, c2 75, v 0.5",
            "6.14 Hz",
            (TWO_FREQUENCIES,),
            _lower,
            _READ_OFF,
            USUAL,
        ),
        Entry(
            "fig-5.50b",
            "higher of two frequencies there",
            "12.3 to 12.8 Hz",
            (TWO_FREQUENCIES,),
            _higher,
            "the range and 1 %: a frequency meter",
            USUAL,
        ),
        Entry(
            "app-5.3",
            "beta 0.4, gamma 15, v 0.5, c2 75",
            "one limit cycle",
            (lane("rotary", beta=0.4, gamma=15.0, v=0.5, c2=75.0),),
            lambda one: claim(f"{one['cycles']:.0f} returns to close", one["cycles"] == 1),
            "it repeats after one return to 0.1 %",
            USUAL,
        ),
    ),
    pictures=(
        Picture(
            "Figs 5.19 to 5.21",
            "The bit's velocity grows by itself until it reaches the drive's; the faster the drive, the later. "
            "At 2.5 m/s it decays here.",
            (SLOW_DRIVE, FROM_INSIDE, FAST_DRIVE),
            pictures.velocities,
        ),
        Picture(
            "Figs 5.29 to 5.31",
            "One limit cycle, reached from the centre and from outside; its flat edge is the bit that sticks.",
            (FROM_INSIDE, FROM_OUTSIDE),
            pictures.limit_cycle,
        ),
        Picture(
            "Figs 5.22 and 5.38",
            "Settling time over the driving velocity and over the frequency ratio.",
            (*OVER_SPEED, *OVER_GAMMA),
            pictures.settling,
        ),
        Picture(
            "Figs 5.32 and 5.33",
            "Friction force as the vibration grows, and with the bit's speed when it is steady.",
            (FROM_INSIDE,),
            pictures.friction_in_time,
        ),
        Picture(
            "Figs 5.39 and 5.40",
            "Beyond gamma 0.86 the vibration dies away at 1.5 m/s.",
            (DECAYING, STRONGLY_DECAYING),
            pictures.decaying,
        ),
        Picture(
            "Figs 5.44, 5.45 and 5.47",
            "Lobes of the striker's phase portrait at high frequency ratios (v 0.5 m/s, beta 0.3).",
            (LOBED[3], NINE, TEN),
            pictures.lobed,
        ),
        Picture(
            "Figs 5.25, 5.26 and 5.50",
            "One frequency with Table 5.1, two at beta 0.4 and gamma 1.2.",
            (FROM_INSIDE, TWO_FREQUENCIES),
            pictures.spectra,
        ),
    ),
)
