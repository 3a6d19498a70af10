"""Self-excitation without impact: chapter 5, section 4 (the scene *rotary*)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import Entry, claim, number, trend
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import lane, motion
from vibrojax.reproduce.groups import _self_excitation as judge
from vibrojax.reproduce.groups._self_excitation import CRITICAL, FINE_GAMMAS, GAMMAS, LOBED, SLOW, SPEEDS
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
TEN = motion("rotary", 60.0, sampling=1e-3, gamma=10.0, **SLOW)
NINE = motion("rotary", 60.0, sampling=1e-3, gamma=9.0, **SLOW)

OVER_SPEED = tuple(lane("rotary", settle=300.0, v=v) for v in SPEEDS)
AT_2_5 = tuple(lane("rotary", settle=300.0, v=2.5, v_cr=v_cr) for v_cr in CRITICAL)
OVER_GAMMA = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in GAMMAS)
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
            judge.first_row,
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
            judge.heavy,
            "agreement where the weaker keeps 1 % of the other's power, trend where it has that from 5 to 10 s",
            (*USUAL, "R15"),
        ),
        Entry(
            "fig-5.18",
            "friction used up over the driving velocity",
            "a wider characteristic at a higher velocity",
            (SLOW_DRIVE, FROM_INSIDE, FAST_DRIVE),
            judge.loop,
            "the range of the force grows from 0.5 to 1.5 m/s",
            USUAL,
        ),
        Entry(
            "fig-5.20",
            "bit velocity from zero, v 1.5",
            "grows gradually to a steady amplitude",
            (FROM_INSIDE,),
            judge.grows_gradually,
            "the envelope rises up to 95 % of its end, and then stays within 5 %",
            USUAL,
        ),
        Entry(
            "fig-5.21",
            "bit velocity from zero, v 2.5",
            "grows to a steady amplitude like the others",
            AT_2_5,
            judge.fastest_drive,
            "it repeats after one return to 0.1 %",
            USUAL,
        ),
        Entry(
            "fig-5.22",
            "settling time over the driving velocity",
            "grows with it; a few seconds at low velocity",
            OVER_SPEED,
            judge.settling_over_speed,
            "each longer than the one before, from 0.5 to 2 m/s",
            (*USUAL, "R16"),
        ),
        Entry(
            "fig-5.24a",
            "the striker's lower frequency component",
            "two components for 3 to 4 s, then the lower vanishes",
            (FROM_INSIDE,),
            judge.two_components,
            "over 5 % of the higher one's power in the first 4 s, under 0.01 % after 20 s",
            USUAL,
        ),
        Entry(
            "fig-5.24b",
            "the same in the bit",
            "hardly appears",
            (FROM_INSIDE,),
            judge.bit_hardly_shows,
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
            judge.reaches_the_drive,
            "it sticks at all",
            USUAL,
        ),
        Entry(
            "fig-5.30",
            "limit cycle from x1 = 10 mm, x1' = 3.5 m/s and from zero",
            "the same limit cycle",
            (FROM_INSIDE, FROM_OUTSIDE),
            judge.same_cycle,
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
            judge.slowest_friction,
            "2 % of F(v_cr)",
            USUAL,
        ),
        Entry(
            "fig-5.33b",
            "static friction that holds the bit",
            "981 N",
            (FROM_INSIDE,),
            judge.static_friction,
            "0.2 %: sampled every 2 ms",
            USUAL,
        ),
        Entry(
            "fig-5.38",
            "settling time over gamma at beta 0.3, v 1.5",
            "grows; steeply at gamma 0.7",
            OVER_GAMMA,
            judge.settling_over_gamma,
            "rising from gamma 0.4 on, and the step from 0.7 to 0.8 over twice that before",
            (*USUAL, "R16"),
        ),
        Entry(
            "fig-5.39",
            "highest gamma at which the vibration lasts, beta 0.3, v 1.5",
            "0.8; decays at 0.9",
            BORDER,
            judge.border,
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
                lambda one, most=most, least=least: judge.lag(one, most, least),
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
            judge.lobes,
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
            judge.equal,
            "3 %",
            USUAL,
        ),
        Entry(
            "fig-5.50a",
            "lower of two frequencies at beta 0.4, gamma 1.2, k1 625000, c2 75, v 0.5",
            "6.14 Hz",
            (TWO_FREQUENCIES,),
            judge.lower,
            _READ_OFF,
            USUAL,
        ),
        Entry(
            "fig-5.50b",
            "higher of two frequencies there",
            "12.3 to 12.8 Hz",
            (TWO_FREQUENCIES,),
            judge.higher,
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
