"""Frequency ratios above 0.8, and appendices 5-4 to 5-6: extra swings, several impacts (Figs 5.75 to 5.77)."""

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import (
    AGREES,
    DIFFERS,
    IN_TREND,
    MOSTLY,
    Entry,
    Here,
    claim,
    listed,
    number,
    within_range,
)
from vibrojax.reproduce.groups._impact import STIFF, USUAL, at, counter_phase, is_single, moving, single

EXTRA_SWING = moving(gamma=0.9)
HIGH = (at(gamma=1.1, **STIFF), at(gamma=1.2, **STIFF), at(gamma=1.5, **STIFF), at(beta=0.3, gamma=1.2))


def extra_swing(one) -> Here:
    text = f"{one['striker_turns']:.2f} swings of the striker per cycle, {one.regime}"
    return claim(text, is_single(one) and one["striker_turns"] > 1.5)


def second_harmonic(moving) -> Here:
    first, second = (signal.peak(moving, "v2", *band, since=6.0) for band in ((3.5, 6.0), (8.0, 11.0)))
    text = f"{second[0]:.2f} Hz with {second[1] / first[1]:.2f} of the power at {first[0]:.2f} Hz"
    return Here(text, AGREES if second[1] > first[1] else IN_TREND if second[1] > 0.3 * first[1] else DIFFERS)


def in_turn(one, other) -> Here:
    share = one["impacts"] / one["cycles"] if one["cycles"] else one["impacts"]
    text = f"{share:.2f} impacts a cycle, {one['impacts']:.3g} in {one['cycles']:.0f} returns"
    note = f"from `stuck`: {other.regime}"
    return claim(text, one["cycles"] > 0 and abs(share - 1.5) < 1e-9, note)


def mixes(one, other) -> Here:
    text = f"{one['impacts']:.2f} impacts a cycle, {one.regime}"
    holds = one.regime == "irregular" and 1 < one["impacts"] < 3
    return claim(text, holds, f"from `stuck`: {other.regime}")


def high_forces(*lanes) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    note = f"greatest forces {listed(forces)} kN at (k1 625000) gamma 1.1, 1.2, 1.5 and (k1 156250, beta 0.3) 1.2"
    return within_range(min(forces), max(forces), (10, 70), "kN", note=note)


def not_converging(one) -> Here:
    return claim(f"{one['impacts']:.2f} impacts a cycle, {one.regime}", not is_single(one))


ENTRIES = (
    Entry(
        "fig-5.75",
        "beta 0.3, gamma 0.9",
        "one limit cycle with an undesired swing (2 swings)",
        (at(beta=0.3, gamma=0.9),),
        extra_swing,
        "over 1.5 swings of the striker a cycle, one impact",
        USUAL,
    ),
    Entry(
        "fig-5.76b",
        "beta 0.4, gamma 0.9: frequency with impact",
        "4.6 Hz",
        (at(gamma=0.9),),
        lambda one: number(one.frequency, 4.6, "Hz", 0.011),
        "1.1 %: half a unit of its last digit",
        USUAL,
    ),
    Entry(
        "fig-5.76c",
        "beta 0.4, gamma 0.9: frequencies of the striker",
        "9.3 Hz stronger than 4.6 Hz",
        (EXTRA_SWING,),
        second_harmonic,
        "more power in the velocity at the double frequency; in trend: over 0.3 of it",
        USUAL,
    ),
    Entry(
        "fig-5.77a",
        "k1 625000, gamma 1.0",
        "1 impact in 1 cycle",
        (at(gamma=1.0, **STIFF),),
        single,
        "the count",
        USUAL,
    ),
    Entry(
        "fig-5.77b",
        "k1 625000, gamma 1.1",
        "single and double in turn, 1.5 impacts a cycle",
        (HIGH[0], at(start="stuck", gamma=1.1, **STIFF)),
        in_turn,
        "the count",
        (*USUAL, "R6"),
    ),
    Entry(
        "fig-5.77c",
        "k1 625000, gamma 1.2",
        "single, double and triple, irregular (1 to 3 a cycle)",
        (HIGH[1], at(start="stuck", gamma=1.2, **STIFF)),
        mixes,
        "irregular, between 1 and 3",
        (*USUAL, "R6"),
    ),
    Entry(
        "sec-5.6.2.4",
        "greatest impact force for gamma over 1",
        "10 to 70 kN",
        HIGH,
        high_forces,
        MOSTLY,
        USUAL,
    ),
    Entry(
        "app-5.4",
        "beta 0.4, gamma 0.5: striker against bit",
        "counter-phase, 3.14 rad",
        (at(gamma=0.5),),
        counter_phase,
        "lag over pi/2",
        USUAL,
    ),
    Entry(
        "app-5.5a",
        "beta 0.3, gamma 0.6",
        "1 impact in 1 cycle",
        (at(beta=0.3, gamma=0.6),),
        single,
        "the count",
        USUAL,
    ),
    Entry("app-5.5b", "beta 0.4, gamma 0.61", "1 impact in 1 cycle", (at(gamma=0.61),), single, "the count", USUAL),
    Entry(
        "table-a5.1",
        "beta 0.3, gamma 1.2",
        "does not converge, over 1 impact a cycle",
        (HIGH[3],),
        not_converging,
        "no single impact",
        (*USUAL, "R12"),
    ),
    Entry(
        "table-a5.2",
        "k1 625000, gamma 1.5: greatest impact force",
        "10 to 70 kN",
        (HIGH[2],),
        lambda one: within_range(one["peak_impact_force"] / 1e3, one["peak_impact_force"] / 1e3, (10, 70), "kN"),
        "the range given for gamma over 1",
        (*USUAL, "R12"),
    ),
)
