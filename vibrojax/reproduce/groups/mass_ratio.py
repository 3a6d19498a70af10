"""Impact and the mass ratio: chapter 5, section 6.3, and the region of best performance (section 7)."""

from vibrojax.reproduce._entry import Entry, trend
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce.groups import _mass_ratio as judge
from vibrojax.reproduce.groups._impact import STIFF, USUAL, at, change, moving, single
from vibrojax.reproduce.groups._mass_ratio import BETAS, SHARES
from vibrojax.reproduce.pictures import mass_ratio as pictures

LATE = 300.0
USUAL_POINT = at()
BEST = tuple(at(beta=beta) for beta in BETAS)
STIFFENED = at(beta=0.5, **STIFF)
LIGHT = tuple(at(beta=beta) for beta in (0.1, 0.15, 0.2))
HEAVY, HEAVY_LATE = at(beta=0.7), at(LATE, beta=0.7)
HEAVY_DAMPED_LESS = at(beta=0.7, c2=62.5)
OVER_DAMPING = tuple(at(beta=0.7, c2=250.0 * share) for share in SHARES)
EQUAL, EQUAL_LATE = at(beta=1.0), at(LATE, beta=1.0)
EQUAL_DAMPED_LESS = at(beta=1.0, c2=62.5)
CREEPING = moving(40.0, beta=1.0)
HEAVIER = tuple(at(start=start, beta=1.2) for start in ("drive", "stuck", "touching"))
HEAVIER_STIFF = at(beta=1.2, gamma=1.0)
HEAVIER_STIFF_DAMPED_LESS = at(beta=1.2, gamma=1.0, c2=62.5)
PORTRAITS = tuple(moving(beta=beta) for beta in BETAS)
LIGHT_MOTION, HEAVY_MOTION = moving(beta=0.1), moving(60.0, beta=0.7)


GROUP = Group(
    name="mass-ratio",
    title="Impact, and the mass ratio",
    text="Gamma 0.75 and v 1.5 m/s, where nothing else is said; beta is varied.",
    entries=(
        Entry(
            "fig-5.78a",
            "beta 0.1: motion of the striker between impacts",
            "an additional oscillation (2 swings)",
            (LIGHT[0],),
            judge.extra_swings,
            "over 1.5 swings a cycle",
            USUAL,
        ),
        Entry(
            "fig-5.79",
            "beta 0.1: change of the striker's velocity",
            "small",
            (LIGHT[0], USUAL_POINT),
            judge.weaker,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.1",
            "beta under 0.25: stability",
            "not stable, may bifurcate (over 0 points)",
            LIGHT,
            judge.unstable,
            "some of three points are not a stable single impact",
            USUAL,
        ),
        Entry(
            "fig-5.80a",
            "impacts at beta 0.25, 0.5, 0.6",
            "1 per cycle, stable",
            BEST,
            judge.all_single,
            "the count",
            USUAL,
        ),
        Entry(
            "fig-5.80b",
            "swing of the striker at beta 0.25, 0.5, 0.6",
            "increases with beta",
            BEST,
            judge.amplitudes,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.2a",
            "swing of the striker as k1 grows, beta 0.5",
            "decreases",
            (BEST[1], STIFFENED),
            judge.smaller_swing,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.2b",
            "impact force as k1 grows, beta 0.5",
            "increases",
            (BEST[1], STIFFENED),
            judge.greater_force,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.2c",
            "frequency over beta from 0.25 to 0.6",
            "not affected, 0 %",
            BEST,
            judge.same_frequency,
            "2.2 %: 0.1 Hz of 4.5, the last digit of the source's frequencies with impact",
            USUAL,
        ),
        Entry(
            "fig-5.81",
            "beta 0.7, c2 250",
            "periodic, but sensitive (1 return)",
            (HEAVY, HEAVY_LATE),
            judge.settles_late,
            "it repeats after one return by 300 s",
            (*USUAL, "R14"),
        ),
        Entry(
            "fig-5.82b",
            "beta 0.7, c2 250: sticking",
            "none; the bit's sliding velocity does not reach 0",
            (HEAVY_LATE,),
            judge.no_sticking,
            "no sample sticks or slides backwards",
            (*USUAL, "R14"),
        ),
        Entry(
            "sec-5.6.3.3a",
            "beta 0.7 with a quarter of the damping",
            "1 impact in 1 cycle",
            (HEAVY_DAMPED_LESS,),
            single,
            "the count",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.3b",
            "beta 0.7: damping that still gives a single impact",
            "25 % or less",
            OVER_DAMPING,
            judge.tolerable_damping,
            "agreement where 25 % does and the next does not; in trend where 25 % does and 100 % does not",
            USUAL,
        ),
        Entry(
            "fig-5.83a",
            "beta 1.0: impacts",
            "1 in 1 cycle",
            (EQUAL, EQUAL_LATE, EQUAL_DAMPED_LESS),
            judge.equal_masses,
            "the count; in trend where one impact is in each repeat, if that takes two returns",
            (*USUAL, "R14"),
        ),
        Entry(
            "fig-5.83b",
            "beta 1.0: amplitude of the bit over 40 s",
            "creeps up, no stabilisation",
            (CREEPING,),
            judge.creeps,
            "the order of three stretches",
            (*USUAL, "R14"),
        ),
        Entry(
            "fig-5.84",
            "beta 1.2",
            "neither periodic nor synchronised",
            HEAVIER,
            judge.neither,
            "the source's own start, `drive`, does not repeat by 40 s",
            (*USUAL, "R6"),
        ),
        Entry(
            "app-5.7",
            "beta 1.2, gamma 1.0",
            "1 impact in 1 cycle",
            (HEAVIER_STIFF, HEAVIER_STIFF_DAMPED_LESS),
            judge.still_single,
            "the count",
            USUAL,
        ),
        Entry(
            "table-a5.3",
            "beta 0.7, c2 62.5: change of the striker's velocity beside that at beta 0.4, c2 250",
            "a striker that is too heavy imparts very strong blows",
            (HEAVY_DAMPED_LESS, USUAL_POINT),
            lambda heavy, usual: trend(
                f"{change(heavy):.2f} m/s, {change(usual):.2f} m/s at beta 0.4", change(heavy) > change(usual)
            ),
            "the order",
            (*USUAL, "R12"),
        ),
    ),
    pictures=(
        Picture(
            "Fig. 5.80",
            "Phase portraits of the striker: its swing grows with the mass ratio.",
            PORTRAITS,
            pictures.by_mass,
        ),
        Picture(
            "Figs 5.78 and 5.81",
            "The striker too light (beta 0.1: a second swing) and too heavy (beta 0.7: the bit never sticks).",
            (LIGHT_MOTION, HEAVY_MOTION),
            pictures.extremes,
        ),
        Picture("Fig. 5.83", "Beta 1.0: the amplitude creeps up over half a minute.", (CREEPING,), pictures.creeping),
    ),
)
