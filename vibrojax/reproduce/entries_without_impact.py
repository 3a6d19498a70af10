"""The source's results without impact: chapters 3 and 5, up to section 5, with the classical checks of its review."""

import numpy as np

from vibrojax.reproduce import datasets_chapter5 as data
from vibrojax.reproduce import judges_closed_forms as closed
from vibrojax.reproduce import judges_self_excitation as excited
from vibrojax.reproduce.entry import Entry
from vibrojax.reproduce.needs import lane
from vibrojax.reproduce.verdicts import LAST_DIGIT, frequency_beside

# Rows of tables: what the source says; then what is computed, who judges it, what counts as agreement, the readings.
# fmt: off

LINEAR = (
    Entry("eq-5.15", "roots of the determinant and of the eigenvalue problem, Table 5.1", "identical",
        (), closed.roots, "rounding"),
    Entry("eq-5.16a", "higher natural frequency, Table 5.1", "29.34 rad/s",
        (), closed.mode_of_table_5_1(1, "29.34"), LAST_DIGIT),
    Entry("eq-5.16b", "lower natural frequency, Table 5.1", "15.97 rad/s",
        (), closed.mode_of_table_5_1(0, "15.97"), LAST_DIGIT),
    Entry("table-5.1", "stiffness of the second spring for beta 0.4, gamma 0.75", "35156 N/m",
        (), closed.second_spring, LAST_DIGIT),
    Entry("eq-5.16c", "column of eq. 5.16 in Table 5.3", "25.0 to 95.1 rad/s",
        (), closed.column_5_16, "all rows but the misprinted one within a unit of the last digit", ("R7",)),
    Entry("eq-5.17", "column of eq. 5.17 in Table 5.3", "25.0 to 94.7 rad/s",
        (), closed.column_5_17, "all rows but the misprinted one within a unit of the last digit", ("R7",)),
    Entry("app-5.2a", "higher natural frequency at beta 0.3, gamma 1.2", "5.93 Hz",
        (), closed.higher_at_gamma_1_2, LAST_DIGIT),
    Entry("app-5.2b", "lower natural frequency at beta 0.3, gamma 1.2", "3.2 Hz",
        (), closed.lower_at_gamma_1_2, "0.3 %, as the higher one is met: a tenth of its last digit"),
    Entry("fig-5.76a", "calculated frequency without impact at beta 0.4, gamma 0.9", "4.9 Hz",
        (), closed.without_impact, "0.01 of 4.9 Hz: half a unit of the last printed digit"),
    Entry("sec-5.5a", "the lower natural frequency over gamma at beta 0.3",
        "rises up to gamma 1.2, no more thereafter",
        (), closed.lower_rises,
        "at gamma 1.2 within 0.1 Hz, the last digit of the source, of its limit w1/sqrt(1 + beta)"),
)

_FORM = "the form of the curve between 0 and 5 m/s"
_LASTS = "over a tenth of the drive's velocity is left in the bit's after 35 s, or not"
FRICTION = (
    Entry("eq-2.13", "Coulomb friction (Fig. 3.8a)", "constant, 0 range",
        (), closed.constant, _FORM),
    Entry("eq-2.14", "Popp's exponential law (Fig. 3.10)", "rises, passes a maximum, falls slightly",
        (), closed.rises_then_falls("popp-exponential"), _FORM, ("R28",)),
    Entry("eq-2.15", "Popp's arctangent law (Fig. 3.11a)", "rises and falls",
        (), closed.rises_then_falls("popp-arctan"), _FORM, ("R28",)),
    Entry("eq-2.16", "hyperbolic law (Fig. 3.11b)", "falls towards 0",
        (), closed.falls, _FORM, ("R28",)),
    Entry("eq-2.17", "hyperbolic and quadratic law (Fig. 3.13a)", "falls steeply to a minimum, then rises",
        (), closed.falls_then_rises("hyperbolic-quadratic"), _FORM, ("R28",)),
    Entry("eq-5.9", "the law used (Fig. 5.12): its critical speed",
        "v_cr, with a third of the static friction (3 m/s)",
        (), closed.critical_speed, "the grid of 0.25 mm/s", ("R4",)),
    Entry("fig-3.8", "self-excitation under Coulomb friction", "none: no instability, 0",
        (data.UNDER_LAW["coulomb"],), closed.sustains("coulomb", False), _LASTS),
    Entry("fig-3.11a", "self-excitation under Popp's arctangent law", "yes: a falling branch",
        (data.UNDER_LAW["popp-arctan"],), closed.sustains("popp-arctan", True), _LASTS, ("R28",)),
    Entry("fig-3.11b", "self-excitation under the hyperbolic law", "yes: a falling branch",
        (data.UNDER_LAW["hyperbolic"],), closed.sustains("hyperbolic", True), _LASTS, ("R28",)),
    Entry("fig-3.13", "self-excitation under the hyperbolic and quadratic law", "yes: a falling branch",
        (data.UNDER_LAW["hyperbolic-quadratic"],), closed.sustains("hyperbolic-quadratic", True), _LASTS, ("R28",)),
    Entry("sec-5.3.2", "regimes of the drill under the other laws", "the law must be chosen carefully",
        data.REGIMES, closed.law_matters, "each other law changes the regime of over a tenth of the map", ("R28",)),
)

_KNOWN = "1e-6 of the known solution"
CLASSICAL = (
    Entry("fig-5.7", "period of the free oscillator on an elastic stop", "never over that without the stop, 1",
        tuple(data.FREE.values()), closed.period_on_stop, "1e-9 of the closed form"),
    Entry("eq-5.1", "Tsaplin's hammer, w = 1.5 w_n, R 0.5: impact velocity",
        "periodic, with the velocity of the known solution",
        (data.HAMMERED,), closed.hammer, _KNOWN),
    Entry("eq-5.2", "Tsaplin's hammer, w = 2 w_n, R 0.5, no gap", "periodic where w/w_n is an integer",
        (data.HAMMERED_AT_TWICE,), closed.hammer_at_twice, "the time between the last ten impacts is constant to 1e-6"),
    Entry("eq-5.3a", "ball thrown by a force: impact velocity", "periodic, g T/(1 + R) = 1.926 m/s",
        (data.THROWN,), closed.thrown, _KNOWN),
    Entry("eq-5.3b", "ball thrown by a force: phase of the impact", "fixed by the force, 0.642",
        (data.THROWN,), closed.thrown_phase, _KNOWN),
    Entry("eq-5.6", "duration of a blow on the contact, xi 0.3", "depends on frequency and loss factor only",
        (data.ONE_BLOW[0.3], data.SLOW_BLOW), closed.duration, "1e-4 of the closed form", ("R29",)),
    Entry("eq-5.8", "restitution over the loss factor", "falls with it from 1",
        tuple(data.ONE_BLOW.values()), closed.restitutions, "1e-3 of the closed form with its root read as 1 − xi²",
        ("R29",)),
    Entry("listing-a3-1", "restitution for loss factors 0.5 to 0.91", "0.1 to 0.3",
        tuple(data.ONE_BLOW.values()), closed.listing, "within the range", ("R29",)),
)

_SLIDING = ("R4", "R5")


def _table_5_3(index: int) -> Entry:
    """A row of Table 5.3, counted from 1."""
    row = data.TABLE_5_3[index - 1]
    return Entry(
        f"table-5.3.{index}",
        f"synchronisation frequency, w1 {row.w1}, v {row.v}, beta {row.beta}, gamma {row.gamma}",
        f"{row.simulation} rad/s",
        (lane("rotary", k1=250.0 * row.w1**2, v=row.v, beta=row.beta, gamma=row.gamma),),
        excited.synchronised(row),
        excited.PERIOD,
        (*_SLIDING, *(("R7",) if index == 10 else ()), "R30"),
    )


SELF_EXCITATION = (
    Entry("table-5.3.1", "synchronisation frequency, w1 25, v 1.5, beta 0.3, gamma 0.9", "30.7 rad/s, and decays",
        (data.DECAYING,), excited.first_row, excited.PERIOD, _SLIDING),
    *(_table_5_3(index) for index in range(2, 12)),
    Entry("table-5.2", "frequency at m1 300, k1 326700, beta 0.3, gamma 0.8, v 0.8", "6.1 Hz",
        (lane("rotary", m1=300.0, k1=326700.0, beta=0.3, gamma=0.8, v=0.8),), frequency_beside(6.1, 0.0082),
        "0.8 %: half a unit of its last digit", _SLIDING),
    Entry("fig-5.15", "m1 150, m2 400, k1 306250, k2 914260: frequencies of the bit and the striker",
        "two, an unstable periodic motion",
        (data.HEAVY_STRIKER,), excited.heavy_striker,
        "agreement where the weaker keeps 1 % of the other's power, trend where it has that from 5 to 10 s",
        (*_SLIDING, "R15")),
    Entry("fig-5.18", "friction used up over the driving velocity", "a wider characteristic at a higher velocity",
        (data.SLOW_DRIVE, data.FROM_INSIDE, data.FAST_DRIVE), excited.friction_used,
        "the range of the force grows from 0.5 to 1.5 m/s", _SLIDING),
    Entry("fig-5.20", "bit velocity from zero, v 1.5", "grows gradually to a steady amplitude",
        (data.FROM_INSIDE,), excited.grows_gradually,
        "the envelope rises up to 95 % of its end, and then stays within 5 %", _SLIDING),
    Entry("fig-5.21", "bit velocity from zero, v 2.5", "grows to a steady amplitude like the others",
        data.AT_2_5, excited.fastest_drive, "it repeats after one return to 0.1 %", _SLIDING),
    Entry("fig-5.22", "settling time over the driving velocity", "grows with it; a few seconds at low velocity",
        data.OVER_SPEED, excited.settling_over_speed, "each longer than the one before, from 0.5 to 2 m/s",
        (*_SLIDING, "R16")),
    Entry("fig-5.24a", "the striker's lower frequency component",
        "two components for 3 to 4 s, then the lower vanishes",
        (data.FROM_INSIDE,), excited.two_components,
        "over 5 % of the higher one's power in the first 4 s, under 0.01 % after 20 s", _SLIDING),
    Entry("fig-5.24b", "the same in the bit", "hardly appears",
        (data.FROM_INSIDE,), excited.bit_hardly_shows, "under 5 % of the higher one's power", _SLIDING),
    Entry("fig-5.25", "frequency of the bit, Table 5.1 at v 1.5", "29.34 rad/s",
        (data.WITHOUT,), excited.bit_frequency, excited.PERIOD, _SLIDING),
    Entry("fig-5.26", "frequency of the striker, Table 5.1 at v 1.5", "4.6 Hz",
        (data.FROM_INSIDE,), excited.striker_frequency,
        "2 %: 0.1 Hz, cut: the source has 29.34 rad/s, 4.67 Hz, as 4.6 Hz on its graphs", _SLIDING),
    Entry("fig-5.27", "period of bit and striker", "0.214 s",
        (data.WITHOUT,), excited.period, LAST_DIGIT, _SLIDING),
    Entry("fig-5.29", "how far the bit's velocity grows", "to the driving velocity, where it sticks",
        (data.WITHOUT,), excited.reaches_the_drive, "it sticks at all", ("R1", *_SLIDING)),
    Entry("fig-5.30", "limit cycle from x1 = 10 mm, x1' = 3.5 m/s and from zero", "the same limit cycle",
        (data.FROM_INSIDE, data.FROM_OUTSIDE), excited.same_cycle, "swings equal to 0.1 %", _SLIDING),
    Entry("fig-5.32", "sliding backwards on the rock", "never, 0 of the time",
        (data.WITHOUT,), excited.never_backwards, "exactly", _SLIDING),
    Entry("fig-5.33a", "friction at the bit's highest sliding speed", "its critical value F_cr, at v_cr",
        (data.FROM_INSIDE,), excited.least_friction, "2 % of F(v_cr)", _SLIDING),
    Entry("fig-5.33b", "static friction that holds the bit", "981 N",
        (data.FROM_INSIDE,), excited.static_friction, "0.2 %: sampled every 2 ms", ("R1", *_SLIDING)),
    Entry("fig-5.38", "settling time over gamma at beta 0.3, v 1.5", "grows; steeply at gamma 0.7",
        data.OVER_GAMMA, excited.settling_over_gamma,
        "rising from gamma 0.4 on, and the step from 0.7 to 0.8 over twice that before", (*_SLIDING, "R16")),
    Entry("fig-5.39", "highest gamma at which the vibration lasts, beta 0.3, v 1.5", "0.8; decays at 0.9",
        data.BORDER, excited.border, "between 0.8 and 0.9", _SLIDING),
    Entry("fig-5.40", "gamma 1.2, v 1.5", "decays after a few oscillations",
        (data.STRONGLY_DECAYING,), excited.decays_soon, "less than half is left", _SLIDING),
    Entry("fig-5.41", "frequency at gamma 1.2, v 0.5, c2 75", "3.2 Hz, sustained",
        (lane("rotary", data.SLOW, gamma=1.2),), frequency_beside(3.2, 0.016),
        "1.6 %: half a unit of its last digit", _SLIDING),
    *(
        Entry(name, f"bit and striker at gamma {gamma}, v 0.5, c2 75", source,
            (lane("rotary", data.SLOW, gamma=gamma),), excited.lag_within(least, most),
            "within 0.3 rad of 0 or of pi: a twentieth of a cycle, as one sees it in a time history",
            (*_SLIDING, "R17"))
        for name, gamma, source, least, most in (
            ("fig-5.42", 1.0, "in counter-phase, 3.14 rad", np.pi - 0.3, np.pi),
            ("sec-5.5b", 1.1, "transition: in phase or counter-phase", np.pi - 0.3, np.pi),
            ("fig-5.43", 1.2, "in phase, 0 rad", 0.0, 0.3),
            ("sec-5.5c", 1.3, "in phase at the lower mode, 0 rad", 0.0, 0.3),
        )
    ),
    Entry("fig-5.44", "lobes of the striker's phase portrait, gamma 2 to 7", "as many as the whole part of gamma",
        tuple(data.LOBED.values()), excited.lobes, "all the counts", (*_SLIDING, "R17", "R18")),
    Entry("fig-5.45", "lobes of the striker's phase portrait at gamma 3", "3 lobes",
        (data.LOBED[3],), excited.three_lobes, "the count", (*_SLIDING, "R17", "R18")),
    Entry("fig-5.47", "amplitude of the striker at gamma 8 to 9, v 0.5, c2 75", "equal to the bit's, 1 times",
        tuple(lane("rotary", data.SLOW, gamma=gamma) for gamma in (8.0, 8.5, 9.0)), excited.equal_amplitudes,
        "3 %: what one tells apart in a phase portrait", (*_SLIDING, "R17")),
    Entry("fig-5.50a", "lower of two frequencies at beta 0.4, gamma 1.2, k1 625000, c2 75, v 0.5", "6.14 Hz",
        (data.TWO_FREQUENCIES,), excited.lower_frequency, "1 %: the source itself has 6.14 and 6.2 Hz for it",
        (*_SLIDING, "R17")),
    Entry("fig-5.50b", "higher of two frequencies there", "12.3 to 12.8 Hz",
        (data.TWO_FREQUENCIES,), excited.higher_frequency, "the range", (*_SLIDING, "R17")),
    Entry("app-5.3", "beta 0.4, gamma 15, v 0.5, c2 75", "one limit cycle",
        (lane("rotary", beta=0.4, gamma=15.0, v=0.5, c2=75.0),), excited.one_cycle,
        "it repeats after one return to 0.1 %", (*_SLIDING, "R17")),
)
