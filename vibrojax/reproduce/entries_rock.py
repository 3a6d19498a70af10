"""The source's results on rock: chapter 6 with the cores of Table 4.5 (scenes *penetration*, *drilling*, *coupled*)."""

from vibrojax.reproduce import datasets_chapter6 as data
from vibrojax.reproduce import judges_drilling as drilled
from vibrojax.reproduce import judges_penetration as forced
from vibrojax.reproduce.datasets_chapter6 import drill, pulses
from vibrojax.reproduce.entry import Entry
from vibrojax.reproduce.verdicts import LAST_DIGIT, MOSTLY, ORDER

# Rows of tables: what the source says; then what is computed, who judges it, what counts as agreement, the readings.
# fmt: off

_PULSE = ("R10",)
PENETRATION = (
    *(
        Entry(f"table-4.5.{row}", f"{rock}: stiffness of the core, 54 by 108 mm, from its Young's modulus",
            f"{source} kN/mm",
            (), forced.core_stiffness(rock, source),
            f"{100 * forced.core_tolerance(rock):.2g} %: a unit of the modulus's last digit, which is cut (see R30)",
            ("R30",))
        for row, rock, source in ((1, "granite", 224.24), (2, "limestone", 175.32), (3, "sandstone", 100.68))
    ),
    Entry("fig-6.4", "swept sine, frequency of the greatest velocity", "a resonance",
        data.SWEEPS, forced.resonance, "20 % of sqrt(k3/m1)", ("R22",)),
    Entry("fig-6.5", "swept sine, slip beyond resonance", "none",
        data.SWEEPS, forced.slips_until, "last slip below 1.25 times", ("R22",)),
    Entry("fig-6.7", "swept sine, depth of the hole over k3", "increases with k3",
        data.SWEEPS, forced.more_in_hard, ORDER, ("R22",)),
    Entry("fig-6.8", "motion of the hole under pulses", "stepwise",
        (data.STEPS[1.5],), forced.staircase, "under 0.1 %", _PULSE),
    Entry("fig-6.9", "Table 6.1, zeta 0.5", "the bit jumps (over 0 mm)",
        (pulses(data.TABLE_6_1, zeta=0.5),), forced.jumps, "over 0.01 mm", _PULSE),
    Entry("fig-6.10", "Table 6.1, zeta 1.0", "no bouncing (0 mm)",
        (pulses(data.TABLE_6_1, zeta=1.0),), forced.stays, "under 0.01 mm", _PULSE),
    Entry("fig-6.11", "Table 6.1, zeta 1.5", "no bouncing (0 mm)",
        (pulses(data.TABLE_6_1, zeta=1.5),), forced.stays, "under 0.01 mm", _PULSE),
    Entry("fig-6.12", "mean force P at 150 to 300 kN, 10 to 40 Hz", "10 to 50 kN",
        (pulses(force=150e3, frequency=10.0), pulses(force=300e3, frequency=40.0)), forced.mean_forces, MOSTLY, _PULSE),
    Entry("fig-6.13", "P/D at 250 kN over frequency and threshold", "rises with the frequency, falls with D",
        tuple(pulses(force=250e3, threshold=d, frequency=f) for d in (100e3, 250e3) for f in (10.0, 40.0)),
        forced.relief, ORDER, _PULSE),
    Entry("fig-6.14", "rate in very soft rock, k3 0.01 and 0.1 MN/m, 150 and 250 kN", "no slip, 0 mm/s",
        data.VERY_SOFT, forced.no_slip, "exactly", _PULSE),
    Entry("fig-6.15", "Table 6.2: stiffness at which slip begins", "0.01 MN/m",
        data.ONSET, forced.onset, "50 %: half a unit of its one digit", ("R10", "R23")),
    Entry("fig-6.17", "rate over k3, D 150 kN, 150 kN", "increases with k3",
        data.OVER_STIFFNESS[150e3, 150e3], forced.over_stiffness, ORDER, _PULSE),
    Entry("fig-6.18", "rate over k3, D 250 kN, 300 kN", "increases with k3",
        data.OVER_STIFFNESS[300e3, 250e3], forced.over_stiffness, ORDER, _PULSE),
    Entry("fig-6.19", "slope of the rate over k3, 200 kN", "falls in very hard rock",
        data.OVER_STIFFNESS_AT_200, forced.less_and_less, "the last step under a fifth of the greatest", _PULSE),
    Entry("sec-6.4.2.3", "rate over k3 below 50 MN/m", "linear, above 0",
        data.SOFT_ROCKS, forced.linear_in_soft, "R² over 0.98", _PULSE),
    Entry("fig-6.20a", "rate over k3 at a small P/D (10 Hz), 200 kN", "linear",
        (data.STIFFNESS_MAP,), forced.low_is_linear, "R² over 0.95", _PULSE),
    Entry("fig-6.20b", "rate over k3 at a high P/D (40 Hz), 200 kN", "not linear",
        (data.STIFFNESS_MAP,), forced.high_is_not, "R² under 0.95", _PULSE),
    Entry("fig-6.21", "share of the static load that starts the slip, 250 kN, k3 300 MN/m", "only 12 %",
        data.OVER_FREQUENCY[250e3, 300e6], forced.first_relief,
        "4 %: half a unit of its last digit; in trend below 20 %", _PULSE),
    Entry("fig-6.22", "rate over the frequency, 300 kN, k3 500 MN/m", "linear",
        data.OVER_FREQUENCY[300e3, 500e6], forced.linear_in_frequency, "R² over 0.99", _PULSE),
    Entry("fig-6.23", "rate over D from 50 to 250 kN, 300 kN, k3 500 MN/m", "decreases considerably",
        data.OVER_THRESHOLD, forced.falls_with_threshold, ORDER, _PULSE),
    Entry("fig-6.24a", "rate over P/D at 150 kN, D 150 kN, k3 100 MN/m", "a line of small slope",
        data.OVER_FREQUENCY[150e3, 100e6], forced.line, "R² over 0.99, above 0", _PULSE),
    Entry("fig-6.24b", "rate over P/D at 300 kN, D 150 kN, k3 100 MN/m", "tends to curve",
        data.OVER_FREQUENCY[300e3, 100e6], forced.curve_over_relief, "R² of a line under 0.99", _PULSE),
    Entry("fig-6.25", "rate over frequency and force, k3 500 MN/m", "increases with both",
        (data.FORCE_MAP,), forced.rises_with_both, ORDER, _PULSE),
)

_LAW = ("R8", "R9", "R10")
LAW = (
    Entry("eq-6.4a", "C for 200, 250, 300 kN and k3 300, 500 MN/m, in the listing's rate", "0.046 to 0.189",
        (data.CONSTANT_MAP, data.CONSTANT_OVER_DAMPING), drilled.constant_range,
        "the range at every damping of the source, zeta 0.5 to 1.5; in trend where that at zeta 0.6 is within it",
        _LAW),
    Entry("eq-6.4b", "C over the force", "strongly affected",
        (data.CONSTANT_MAP,), drilled.constant_over_force, "over 2 times from 200 to 300 kN", _LAW),
    Entry("eq-6.4c", "C over the stiffness", "little effect",
        (data.CONSTANT_MAP,), drilled.constant_over_stiffness, "under 25 %, where the force makes over 100 %", _LAW),
    Entry("eq-6.4d", "sign of C in the law as printed", "positive",
        (data.CONSTANT_MAP,), drilled.literal_constant, "the sign", ("R9",)),
    Entry("eq-6.4e", "shape of the rate over P/D, varied by the frequency", "logarithmic",
        (data.CONSTANT_MAP,), drilled.shape_over_frequency, "AIC over the same lanes", _LAW),
    Entry("eq-6.4f", "shape of the rate over P/D, varied by the force", "logarithmic",
        (data.RATE_ALONG_FORCE,), drilled.shape_over_force, "AIC over the same lanes", _LAW),
    Entry("fig-6.27", "200 kN, k3 50 MN/m: the rate beside eq. 6.4 at high P/D", "the law underestimates",
        (data.SOFT_MAP,), drilled.underestimates, "the sign", (*_LAW, "R24")),
    Entry("sec-7b", "applied load compared with the threshold", "10 to 20 %",
        (data.CONSTANT_MAP,), drilled.thrust, MOSTLY, ("R10",)),
)

_DRILL = ("R2", "R3", "R4", "R5", "R25")
DRILL = (
    Entry("table-6.6.1", "frequency of the drill", "5.8 Hz",
        (drill(),), drilled.frequency("5.8"), LAST_DIGIT, _DRILL),
    Entry("table-6.6.2", "frequency, k1 4 times", "11.6 Hz",
        (drill(k1=data.K1 * 4),), drilled.frequency("11.6"), LAST_DIGIT, (*_DRILL, "R26")),
    Entry("table-6.6.3", "frequency, k1 5.74 times", "13.9 Hz",
        (drill(k1=data.K1 * (13.9 / 5.8) ** 2),), drilled.frequency("13.9"), LAST_DIGIT, (*_DRILL, "R26")),
    Entry("fig-6.29", "motion of the hole", "only at impact, stepwise",
        (data.DRILLING,), drilled.only_at_impact, "under 1e-6 of it away from impacts", _DRILL),
    Entry("fig-6.30", "impact force for gaps of 10 to 20 mm", "increases with the gap",
        (*data.OVER_GAP, *data.OVER_WIDE_GAP), drilled.over_gap, "the order, over -5 to 20 mm", (*_DRILL, "R6")),
    Entry("fig-6.32", "rate of penetration over the gap", "increases with it",
        data.OVER_GAP, drilled.rate_over_gap, "the order, over -5 to 5 mm, where there is a single impact",
        (*_DRILL, "R6")),
    Entry("fig-6.33", "rate of penetration over k3", "grows; little from 300 to 500 MN/m",
        data.DRILLED, drilled.rate_over_stiffness, "the second step above 0, and under 0.3 of the first", _DRILL),
    *(
        Entry(f"table-6.7.{index + 1}", f"slip under a blow of 470 kN, D 250 kN, k3 {k3 / 1e6:g} MN/m", f"{source} mm",
            data.TABLE_6_7, drilled.slip(index, source),
            f"{LAST_DIGIT}; in trend where the second step along k3 is above 0, and under 0.3 of the first",
            ("R11", "R27"))
        for index, (k3, source) in enumerate(zip(data.DRILLED_STIFFNESSES, ("0.58", "0.73", "0.77"), strict=True))
    ),
    Entry("sec-6.6b", "highest impact force of Table 6.6", "470 kN",
        (data.SPEED_MAP,), drilled.highest_force, "1 %: its second digit is the last that is sure", (*_DRILL, "R11")),
    Entry("fig-6.34", "C of the whole drill", "0.44 m/s",
        (data.SPEED_MAP,), drilled.drilled_constant, LAST_DIGIT, (*_DRILL, "R8", "R9")),
    Entry("fig-6.35", "limit cycle with penetration beside that without", "no change, 0 %",
        (drill(), data.STRIKING_ONLY, data.ROCK_MOVES_BIT), drilled.same_cycle,
        "1 % of the period, also with the bit's normal motion fed back", _DRILL),
    Entry("sec-6.6a", "contact of bit and rock", "no separation, 0 mm",
        (drill(),), drilled.in_contact, "0.01 mm", _DRILL),
    Entry("fig-6.37", "frequency with penetration beside that without", "no change, 0 Hz",
        (drill(), data.STRIKING_ONLY), drilled.same_response, "0.01 Hz", _DRILL),
    Entry("fig-6.31", "depth of the hole after 8 s", "not in the text",
        (data.DRILLING,), drilled.depth, "none", _DRILL),
)
