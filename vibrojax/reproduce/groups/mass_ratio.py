"""Impact and the mass ratio: chapter 5, section 6.3, and the region of best performance (section 7)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, Entry, Here, claim, trend
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce.groups._impact import STIFF, USUAL, at, change, is_single, listed, moving, single
from vibrojax.reproduce.pictures import mass_ratio as pictures

LATE = 300.0
USUAL_POINT = at()
BETAS = (0.25, 0.5, 0.6)
BEST = tuple(at(beta=beta) for beta in BETAS)
STIFFENED = at(beta=0.5, **STIFF)
LIGHT = tuple(at(beta=beta) for beta in (0.1, 0.15, 0.2))
HEAVY, HEAVY_LATE = at(beta=0.7), at(LATE, beta=0.7)
HEAVY_DAMPED_LESS = at(beta=0.7, c2=62.5)
SHARES = (0.1, 0.25, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
OVER_DAMPING = tuple(at(beta=0.7, c2=250.0 * share) for share in SHARES)
EQUAL, EQUAL_LATE = at(beta=1.0), at(LATE, beta=1.0)
EQUAL_DAMPED_LESS = at(beta=1.0, c2=62.5)
CREEPING = moving(40.0, beta=1.0)
HEAVIER = tuple(at(start=start, beta=1.2) for start in ("drive", "stuck", "touching"))
HEAVIER_STIFF = at(beta=1.2, gamma=1.0)
HEAVIER_STIFF_DAMPED_LESS = at(beta=1.2, gamma=1.0, c2=62.5)
PORTRAITS = tuple(moving(beta=beta) for beta in BETAS)
LIGHT_MOTION, HEAVY_MOTION = moving(beta=0.1), moving(60.0, beta=0.7)


def _extra_swings(one) -> Here:
    return claim(f"{one['striker_turns']:.2f} swings of the striker per cycle", one["striker_turns"] > 1.5)


def _weaker(light, usual) -> Here:
    text = f"{change(light):.2f} m/s at beta 0.1, {change(usual):.2f} m/s at beta 0.4"
    return trend(text, change(light) < change(usual))


def _unstable(*lanes) -> Here:
    unstable = sum(not is_single(one) for one in lanes)
    text = f"{unstable} of {len(lanes)} points (beta 0.1, 0.15, 0.2) are not a single impact"
    return claim(text, unstable > 0, "the single impact is stable there too, with a second swing of the striker at 0.1")


def _amplitudes(*lanes) -> Here:
    swings = [1e3 * one["striker_amplitude"] for one in lanes]
    return trend(f"{listed(swings)} mm at beta {listed(BETAS)}", bool(np.all(np.diff(swings) > 0)))


def _smaller_swing(soft, stiff) -> Here:
    swings = [1e3 * one["striker_amplitude"] for one in (soft, stiff)]
    return trend(f"{swings[0]:.1f} mm at k1 156250, {swings[1]:.1f} mm at 625000", swings[1] < swings[0])


def _greater_force(soft, stiff) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in (soft, stiff)]
    return trend(f"{forces[0]:.1f} kN at k1 156250, {forces[1]:.1f} kN at 625000", forces[1] > forces[0])


def _all_single(*lanes) -> Here:
    counts = [one["impacts"] for one in lanes]
    return claim(f"{listed(counts)} impacts per cycle at beta {listed(BETAS)}", all(map(is_single, lanes)))


def _same_frequency(*lanes) -> Here:
    found = np.array([one.angular_frequency for one in lanes])
    return claim(
        f"{100 * (found.max() / found.min() - 1):.1f} % between beta 0.25 and 0.6", np.ptp(found) < 0.05 * found.min()
    )


def _settles_late(early, late) -> Here:
    note = f"at 40 s it is still {early.regime}; settled after {late['settling_time']:.0f} s"
    return claim(f"{late['cycles']:.0f} return to repeat, by 300 s", late["cycles"] == 1, note)


def _no_sticking(one) -> Here:
    text = f"{one['stick_fraction']:.4f} of the time sticking, {one['reverse_fraction']:.4f} sliding backwards"
    return claim(text, one["stick_fraction"] == 0 and one["reverse_fraction"] == 0)


def _tolerable_damping(*lanes) -> Here:
    good = [share for share, one in zip(SHARES, lanes, strict=True) if is_single(one)]
    if not good:
        return Here("nan", DIFFERS)
    first_bad = next((share for share in SHARES if share not in good), np.inf)
    below = [share for share in good if share < first_bad]
    text = (
        f"{100 * max(below, default=np.nan):.0f} % of 250 N s/m gives a single impact by 40 s, of {listed(SHARES, 2)}"
    )
    verdict = IN_TREND if 0.25 in good and 1.0 not in good else DIFFERS
    return Here(text, AGREES if max(below, default=0) == 0.25 else verdict)


def _equal_masses(early, late, damped_less) -> Here:
    text = f"{late['impacts']:.3g} impact in {late['cycles']:.0f} returns by 300 s; at 40 s {early.regime}"
    note = f"with a quarter of the damping: {damped_less.regime}, {damped_less.angular_frequency:.2f} rad/s"
    verdict = AGREES if is_single(late) else IN_TREND if late["impacts"] == 1 else DIFFERS
    return Here(text, verdict, note)


def _creeps(moving) -> Here:
    _, swings = signal.envelope(moving, "x1", 2.0)
    early, middle, late = (1e3 * float(swings[part].max()) for part in (slice(2, 5), slice(7, 10), slice(15, 20)))
    text = f"{early:.1f} mm at 4 to 10 s, {middle:.1f} mm at 14 to 20 s, {late:.1f} mm after 30 s"
    return trend(text, early < middle < late)


def _neither(*lanes) -> Here:
    regimes = ", ".join(
        f"{one.regime} from `{start}`" for one, start in zip(lanes, ("drive", "stuck", "touching"), strict=True)
    )
    irregular = sum(one["cycles"] == 0 for one in lanes)
    verdict = AGREES if irregular == len(lanes) else IN_TREND if irregular else DIFFERS
    return Here(f"{irregular} of 3 starts not periodic by 40 s", verdict, regimes)


def _still_single(one, damped_less) -> Here:
    note = f"with a quarter of the damping: {damped_less.regime}, change of velocity {change(damped_less):.2f} m/s"
    verdict = AGREES if is_single(one) else DIFFERS
    return Here(f"{one['impacts']:.2f} impacts per cycle, {one.regime}", verdict, note)


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
            _extra_swings,
            "over 1.5 swings a cycle",
            USUAL,
        ),
        Entry(
            "fig-5.79",
            "beta 0.1: change of the striker's velocity",
            "small",
            (LIGHT[0], USUAL_POINT),
            _weaker,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.1",
            "beta under 0.25: stability",
            "not stable, may bifurcate (over 0 points)",
            LIGHT,
            _unstable,
            "some of three points are not a stable single impact",
            USUAL,
        ),
        Entry(
            "fig-5.80a", "impacts at beta 0.25, 0.5, 0.6", "1 per cycle, stable", BEST, _all_single, "the count", USUAL
        ),
        Entry(
            "fig-5.80b",
            "swing of the striker at beta 0.25, 0.5, 0.6",
            "increases with beta",
            BEST,
            _amplitudes,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.2a",
            "swing of the striker as k1 grows, beta 0.5",
            "decreases",
            (BEST[1], STIFFENED),
            _smaller_swing,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.2b",
            "impact force as k1 grows, beta 0.5",
            "increases",
            (BEST[1], STIFFENED),
            _greater_force,
            "the order",
            USUAL,
        ),
        Entry(
            "sec-5.6.3.2c",
            "frequency over beta from 0.25 to 0.6",
            "not affected, 0 %",
            BEST,
            _same_frequency,
            "5 %",
            USUAL,
        ),
        Entry(
            "fig-5.81",
            "beta 0.7, c2 250",
            "periodic, but sensitive (1 return)",
            (HEAVY, HEAVY_LATE),
            _settles_late,
            "it repeats after one return by 300 s",
            (*USUAL, "R14"),
        ),
        Entry(
            "fig-5.82b",
            "beta 0.7, c2 250: sticking",
            "none; the bit's sliding velocity does not reach 0",
            (HEAVY_LATE,),
            _no_sticking,
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
            _tolerable_damping,
            "agreement where 25 % does and the next does not; in trend where 25 % does and 100 % does not",
            USUAL,
        ),
        Entry(
            "fig-5.83a",
            "beta 1.0: impacts",
            "1 in 1 cycle",
            (EQUAL, EQUAL_LATE, EQUAL_DAMPED_LESS),
            _equal_masses,
            "the count; in trend where one impact is in the two returns of a repeat",
            (*USUAL, "R14"),
        ),
        Entry(
            "fig-5.83b",
            "beta 1.0: amplitude of the bit over 40 s",
            "creeps up, no stabilisation",
            (CREEPING,),
            _creeps,
            "the order of three stretches",
            (*USUAL, "R14"),
        ),
        Entry(
            "fig-5.84",
            "beta 1.2",
            "neither periodic nor synchronised",
            HEAVIER,
            _neither,
            "agreement where no start repeats by 40 s, in trend where one does not",
            (*USUAL, "R6"),
        ),
        Entry(
            "app-5.7",
            "beta 1.2, gamma 1.0",
            "1 impact in 1 cycle",
            (HEAVIER_STIFF, HEAVIER_STIFF_DAMPED_LESS),
            _still_single,
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
            pictures.strikers,
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
