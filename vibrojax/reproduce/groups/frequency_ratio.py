"""Impact, and the influence of the frequency ratio: chapter 5, sections 6 to 6.2 (the scene *vibro-impact*)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import (
    AGREES,
    DIFFERS,
    IN_TREND,
    Entry,
    Here,
    claim,
    not_compared,
    number,
    trend,
    within_range,
)
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import lane
from vibrojax.reproduce.groups._impact import (
    CHANGE,
    FREQUENCY,
    STIFF,
    USUAL,
    acceleration_at_impacts,
    at,
    change,
    is_single,
    listed,
    moving,
    quickly,
    single,
    sticks,
    sticks_at_some_speed,
)
from vibrojax.reproduce.pictures import impact as pictures

USUAL_POINT, OTHER_GAP = at(), at(start="stuck", delta=0.005)
WITHOUT = lane("rotary")
SLOW = at(v=0.5)
TYPICAL, TYPICAL_SLOW = moving(), moving(v=0.5)
COUNTER = moving(beta=0.3, gamma=0.5)
IN_PHASE = moving(gamma=0.6)
STIFF_POINT = moving(gamma=0.8, **STIFF)
EXTRA_SWING = moving(gamma=0.9)
SOURCE_CONTACT = moving(k0=9e6)
LOW_GAMMAS = (0.6, 0.5, 0.4, 0.3)
LOW = tuple(at(beta=0.3, gamma=gamma) for gamma in LOW_GAMMAS)
LOW_WITHOUT = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in LOW_GAMMAS)
TURNING = tuple(round(0.5 + 0.01 * step, 2) for step in range(11))
HIGH = (at(gamma=1.1, **STIFF), at(gamma=1.2, **STIFF), at(gamma=1.5, **STIFF), at(beta=0.3, gamma=1.2))
TRIPLE = tuple(moving(20.0, gamma=gamma, **STIFF) for gamma in (1.0, 1.1, 1.2))
GAPS = (-0.005, 0.0, 0.005, 0.010)
STIFFNESSES = (9e6, 50e6, 200e6)
UNSAID = tuple(
    at(start=start, delta=delta, v_cr=v_cr)
    for delta in pictures.GAPS
    for start in pictures.STARTS
    for v_cr in pictures.CRITICAL
)


def _frequency(one, other) -> Here:
    note = f"with a gap of +5 mm from `stuck` {other.angular_frequency:.2f} rad/s"
    return number(one.angular_frequency, 27.45, "rad/s", 0.02, note)


def _lower_than_without(one, without) -> Here:
    text = f"{one.angular_frequency:.2f} rad/s with, {without.angular_frequency:.2f} without impact"
    return trend(text, one.angular_frequency < without.angular_frequency)


def _change(source: float, others: tuple[str, ...] = ()):
    def judge(one, *more):
        note = "; ".join(f"{name} {change(other):.2f}" for name, other in zip(others, more, strict=True))
        return number(change(one), source, "m/s", 0.1, note)

    return judge


def _sliding(*lanes) -> Here:
    speeds = [one["bit_velocity_at_impact"] for one in lanes]
    text = f"{listed(speeds)} m/s at (beta, gamma) (0.4, 0.6), (0.4, 0.9), (0.3, 0.5)"
    return not_compared(text, "the source has it in figures only")


def _coexist(drive, stuck) -> Here:
    text = f"{change(stuck):.2f} m/s from `stuck` ({stuck.regime}), {change(drive):.2f} from `drive` ({drive.regime})"
    return claim(text, drive.regime == stuck.regime, "two attractors coexist")


def _faster(slow, fast) -> Here:
    ratio = fast["settling_time"] / slow["settling_time"]
    text = f"{fast['settling_time']:.1f} s with impact, {slow['settling_time']:.1f} s without ({ratio:.2f} times)"
    return trend(text, ratio < 0.5)


def _counter_phase(one) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) > np.pi / 2)


def _in_phase(one) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) < np.pi / 2)


def _ascending(moving) -> Here:
    found = acceleration_at_impacts(moving, 8.0)
    return claim(f"{found.mean():+.1f} m/s² of the bit just before impact", bool((found > 0).all()))


def _falling(moving) -> Here:
    found = acceleration_at_impacts(moving, 8.0)
    return claim(f"{found.mean():+.1f} m/s² of the bit just before impact", bool((found < 0).all()))


def _turns_in_phase(*lanes) -> Here:
    lags = np.abs([one["phase_lag"] for one in lanes])
    turned = [gamma for gamma, lag in zip(TURNING, lags, strict=True) if lag < np.pi / 2]
    if not turned:
        return Here("nan", DIFFERS, "counter-phase up to 0.6")
    return number(min(turned), 0.6, "", 0.1, "where the striker's lag first falls below pi/2, in steps of 0.01")


def _forces_fall(*lanes) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    return trend(f"{listed(forces)} kN at gamma {listed(LOW_GAMMAS)}", bool(np.all(np.diff(forces) < 0)))


def _same_frequency(*lanes) -> Here:
    with_impact, without = lanes[: len(lanes) // 2], lanes[len(lanes) // 2 :]
    off = [a.angular_frequency / b.angular_frequency - 1 for a, b in zip(with_impact, without, strict=True)]
    text = f"{listed([100 * x for x in off], 2)} % at gamma 0.5, 0.4, 0.3"
    return claim(text, max(map(abs, off)) < 0.015)


def _negligible(one, without) -> Here:
    swing = one["bit_amplitude"] / without["bit_amplitude"] - 1
    return trend(f"{100 * swing:+.1f} % of the bit's amplitude", abs(swing) < 0.05)


def _weak(one, strong) -> Here:
    note = f"{one['impacts']:.2f} impacts a cycle; greatest change {2 * one['impact_velocity_max']:.2f} m/s"
    return number(change(one), 0.2, "m/s", 0.25, note, trend=change(one) < 0.15 * change(strong))


def _irregular(one) -> Here:
    return claim(f"{one['impacts']:.2f} impacts a cycle, {one.regime}", one.regime == "irregular")


def _phases(slow, fast, *others) -> Here:
    moved = fast["impact_phase"] - slow["impact_phase"]
    text = f"{moved:+.2f} rad from v 0.5 to 1.5 m/s"
    shift = others[1]["impact_phase"] - others[0]["impact_phase"]
    return trend(
        text, abs(moved) > 0.1, f"at beta 0.3, as Table 5.5 has it, {shift:+.2f} rad: the motion only scales with v"
    )


def _grows_with_v(slow, fast) -> Here:
    text = f"{change(slow):.2f} m/s at v 0.5, {change(fast):.2f} m/s at v 1.5"
    return trend(text, change(fast) > change(slow))


def _rest(moving) -> Here:
    """How long the striker hardly accelerates about its farthest point from the bit."""
    begin, end = signal.last_cycle(moving)
    time = moving["time"].values
    inside = (time >= begin) & (time <= end)
    acceleration = np.gradient(moving["v2"].values[inside], time[inside])
    flight = moving["impact_force"].values[inside] == 0
    strongest = np.abs(acceleration[flight][5:-5]).max()
    still = flight & (np.abs(acceleration) < 0.1 * strongest)
    step = time[1] - time[0]
    return not_compared(
        f"{1e3 * _longest(still) * step:.1f} ms under a tenth of its greatest in flight",
        "what counts as zero depends on the figure's axis, which has the blow on it and is not in the text",
    )


def _longest(flags: np.ndarray) -> int:
    ends = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(max((ends[1::2] - ends[::2]), default=0))


def _friction_step(moving) -> Here:
    """How much friction rises per newton of impact force, where the bit slides forward."""
    sliding = (moving["v1"].values + 1.5 > 0.05) & (moving["impact_force"].values > 1e3)
    rise = moving["friction_force"].values[sliding]
    slope = np.polyfit(moving["impact_force"].values[sliding], rise, 1)[0]
    return number(float(slope), 0.4, "of the impact force", 0.01)


def _static(moving) -> Here:
    """The weight's part of the stick limit, from the friction while the bit starts to slide without impact."""
    free = moving["impact_force"].values == 0
    return number(float(moving["friction_force"].values[free].max()), 981.0, "N", 0.002)


def _less_sticking(slow, fast) -> Here:
    text = f"{1e3 * slow['stick_fraction'] * slow['period']:.1f} ms at v 0.5, "
    text += f"{1e3 * fast['stick_fraction'] * fast['period']:.2f} ms at v 1.5"
    return trend(text, slow["stick_fraction"] > fast["stick_fraction"])


def _extra_swing(one) -> Here:
    text = f"{one['striker_turns']:.2f} swings of the striker per cycle, {one.regime}"
    return claim(text, is_single(one) and one["striker_turns"] > 1.5)


def _second_harmonic(moving) -> Here:
    first, second = (signal.peak(moving, "v2", *band, since=6.0) for band in ((3.5, 6.0), (8.0, 11.0)))
    text = f"{second[0]:.2f} Hz with {second[1] / first[1]:.2f} of the power at {first[0]:.2f} Hz"
    return Here(text, AGREES if second[1] > first[1] else IN_TREND if second[1] > 0.3 * first[1] else DIFFERS)


def _in_turn(one, other) -> Here:
    share = one["impacts"] / one["cycles"] if one["cycles"] else one["impacts"]
    text = f"{share:.2f} impacts a cycle, {one['impacts']:.3g} in {one['cycles']:.0f} returns"
    note = f"from `stuck`: {other.regime}"
    return claim(text, one["cycles"] > 0 and abs(share - 1.5) < 1e-9, note)


def _mixes(one, other) -> Here:
    text = f"{one['impacts']:.2f} impacts a cycle, {one.regime}"
    holds = one.regime == "irregular" and 1 < one["impacts"] < 3
    return claim(text, holds, f"from `stuck`: {other.regime}")


def _high_forces(*lanes) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    note = f"greatest forces {listed(forces)} kN at (k1 625000) gamma 1.1, 1.2, 1.5 and (k1 156250, beta 0.3) 1.2"
    return within_range(min(forces), max(forces), (10, 70), "kN", note=note)


def _not_converging(one) -> Here:
    return claim(f"{one['impacts']:.2f} impacts a cycle, {one.regime}", not is_single(one))


def _force_over(values, name: str):
    def judge(*lanes):
        forces = [one["peak_impact_force"] / 1e3 for one in lanes]
        return trend(f"{listed(forces)} kN at {name} {listed(values)}", bool(np.all(np.diff(forces) > 0)))

    return judge


def _typical_force(moving) -> Here:
    peak = signal.part(moving, "impact_force", 8.0).max() / 1e3
    return not_compared(f"{peak:.1f} kN at its highest", "the figure's axis is not in the text")


def _few(one, without) -> Here:
    return quickly(one, without)


_TREND = "the order"
GROUP = Group(
    name="frequency-ratio",
    title="Impact, and the frequency ratio",
    text="The striker hits the bit through a one-sided contact; the blow adds to the friction and brakes the bit. "
    "Where nothing else is said beta 0.4, gamma 0.75, v 1.5 m/s, k0 50 MN/m, a preload of 5 mm, start `drive`.",
    entries=(
        Entry(
            "fig-5.51",
            "typical impact force, k0 9e6",
            "a single hump",
            (SOURCE_CONTACT,),
            _typical_force,
            "none",
            USUAL,
        ),
        Entry(
            "sec-5.6a",
            "impact force over the gap, from start stuck, -5 to 10 mm",
            "increases with the gap",
            tuple(at(start="stuck", delta=delta) for delta in GAPS),
            _force_over([1e3 * gap for gap in GAPS], "gaps in mm of"),
            _TREND,
            ("R2", "R4", "R6"),
        ),
        Entry(
            "sec-5.6b",
            "impact force over the contact stiffness, 9 to 200 MN/m",
            "increases with it",
            tuple(at(k0=k0) for k0 in STIFFNESSES),
            _force_over([1e-6 * k0 for k0 in STIFFNESSES], "MN/m of"),
            _TREND,
            USUAL,
        ),
        Entry(
            "fig-5.53a",
            "settling time with and without impact",
            "very short in comparison",
            (WITHOUT, USUAL_POINT),
            _faster,
            "less than half",
            (*USUAL, "R16"),
        ),
        Entry(
            "fig-5.53b",
            "change of the striker's velocity at a blow",
            "about 4 m/s",
            (USUAL_POINT, OTHER_GAP),
            _change(4.0, ("gap +5 mm from `stuck`",)),
            CHANGE,
            (*USUAL, "R6"),
        ),
        Entry(
            "fig-5.54a",
            "frequency with impact",
            "27.45 rad/s",
            (USUAL_POINT, OTHER_GAP),
            _frequency,
            FREQUENCY,
            (*USUAL, "R6"),
        ),
        Entry(
            "fig-5.54b",
            "frequency with impact, compared with that without",
            "less",
            (USUAL_POINT, WITHOUT),
            _lower_than_without,
            _TREND,
            USUAL,
        ),
        Entry(
            "fig-5.55",
            "how soon the limit cycle is reached",
            "after a few cycles",
            (USUAL_POINT, WITHOUT),
            _few,
            "10 cycles; in trend: under a third of those without impact",
            (*USUAL, "R14", "R16"),
        ),
        Entry(
            "sec-5.6.1",
            "gap +5 mm: change of the striker's velocity, and the start",
            "always the same limit cycle",
            (at(delta=0.005), OTHER_GAP),
            _coexist,
            "the same regime from both starts",
            ("R2", "R4", "R5", "R6"),
        ),
        Entry(
            "sec-5.6.2b",
            "sliding speed of the bit at impact",
            "not in the text",
            (at(gamma=0.6), at(gamma=0.9), at(beta=0.3, gamma=0.5)),
            _sliding,
            "none",
            USUAL,
        ),
        Entry(
            "fig-5.56",
            "the same at beta 0.3, gamma 0.6, v 0.5",
            "after a few oscillations",
            (at(beta=0.3, gamma=0.6, v=0.5), lane("rotary", beta=0.3, gamma=0.6, v=0.5)),
            _few,
            "10 cycles; in trend: under a third of those without impact",
            (*USUAL, "R14", "R16"),
        ),
        Entry(
            "fig-5.59",
            "absolute motion of the bit",
            "stick-slip, never backwards (0 of the time)",
            (USUAL_POINT, SLOW),
            sticks,
            "sticks over 0.1 % of the time and never slides backwards",
            USUAL,
        ),
        Entry(
            "sec-5.6.2",
            "lowest gamma at which bit and striker move in phase, beta 0.4",
            "0.6",
            tuple(at(gamma=gamma) for gamma in TURNING),
            _turns_in_phase,
            "10 %: the source tried steps of about 0.1",
            USUAL,
        ),
        Entry(
            "fig-5.60a",
            "beta 0.3, gamma 0.5: striker against bit",
            "counter-phase, 3.14 rad",
            (at(beta=0.3, gamma=0.5),),
            _counter_phase,
            "lag over pi/2",
            USUAL,
        ),
        Entry(
            "fig-5.60b",
            "beta 0.3, gamma 0.5: the bit's velocity when it is hit",
            "ascending (an acceleration above 0)",
            (COUNTER,),
            _ascending,
            "the sign, in the 2 ms before each impact",
            USUAL,
        ),
        Entry(
            "fig-5.61",
            "beta 0.3, gamma 0.4: effect of the impact on the bit",
            "negligible",
            (LOW[2], LOW_WITHOUT[2]),
            _negligible,
            "under 5 % of the amplitude",
            USUAL,
        ),
        Entry(
            "fig-5.64",
            "greatest impact force as gamma falls from 0.6 to 0.3, beta 0.3",
            "reduces considerably",
            LOW,
            _forces_fall,
            _TREND,
            USUAL,
        ),
        Entry(
            "sec-5.6.2.1",
            "frequency below gamma 0.6, beta 0.3, compared with that without impact",
            "identical, 0 %",
            (*LOW[1:], *LOW_WITHOUT[1:]),
            _same_frequency,
            "1.5 %",
            USUAL,
        ),
        Entry(
            "fig-5.65",
            "beta 0.3, gamma 0.3: impacts",
            "irregular, multiple",
            (LOW[3],),
            _irregular,
            "the regime",
            USUAL,
        ),
        Entry(
            "fig-5.66",
            "beta 0.3, gamma 0.3: change of the striker's velocity",
            "about 0.2 m/s",
            (LOW[3], USUAL_POINT),
            _weak,
            "25 %: one digit; in trend: under 15 % of that at gamma 0.75",
            USUAL,
        ),
        Entry(
            "fig-5.67a",
            "beta 0.4, gamma 0.6: place of the impact in the cycle as v goes from 0.5 to 1.5",
            "moves with the driving velocity",
            (at(gamma=0.6, v=0.5), at(gamma=0.6), at(beta=0.3, gamma=0.6, v=0.5), at(beta=0.3, gamma=0.6)),
            _phases,
            "over 0.1 rad",
            (*USUAL, "R19"),
        ),
        Entry(
            "fig-5.67b",
            "beta 0.4, gamma 0.6: change of the striker's velocity",
            "6 m/s",
            (at(gamma=0.6), at(beta=0.3, gamma=0.6)),
            _change(6.0, ("at beta 0.3",)),
            CHANGE,
            (*USUAL, "R19"),
        ),
        Entry(
            "fig-5.67c",
            "beta 0.4, gamma 0.6: change of velocity over v",
            "increases",
            (at(gamma=0.6, v=0.5), at(gamma=0.6)),
            _grows_with_v,
            _TREND,
            (*USUAL, "R19"),
        ),
        Entry(
            "fig-5.67d",
            "beta 0.4, gamma 0.6: striker against bit",
            "in phase, 0 rad",
            (at(gamma=0.6),),
            _in_phase,
            "lag under pi/2",
            (*USUAL, "R19"),
        ),
        Entry(
            "fig-5.67e",
            "beta 0.4, gamma 0.6: the bit's velocity when it is hit",
            "falling (an acceleration below 0)",
            (IN_PHASE,),
            _falling,
            "the sign, in the 2 ms before each impact",
            USUAL,
        ),
        Entry(
            "fig-5.68",
            "beta 0.3, gamma 0.6: stick, slip and impact in a cycle",
            "all three (sticking over 0 of the time)",
            (at(beta=0.3, gamma=0.6), at(beta=0.3, gamma=0.6, v=0.5)),
            sticks_at_some_speed,
            "sticks over 0.1 % of the time and never slides backwards; in trend where it does so at v 0.5",
            USUAL,
        ),
        Entry(
            "fig-5.70a",
            "k1 625000, gamma 0.8: change of the striker's velocity",
            "3.8 m/s",
            (at(gamma=0.8, **STIFF),),
            _change(3.8),
            CHANGE,
            USUAL,
        ),
        Entry(
            "fig-5.70b",
            "k1 625000, gamma 0.8: rest of the striker at its farthest",
            "35 ms of zero acceleration",
            (STIFF_POINT,),
            _rest,
            "none",
            (*USUAL, "R20"),
        ),
        Entry(
            "fig-5.71",
            "beta 0.4, gamma 0.8, k1 625000",
            "1 impact in 1 cycle",
            (at(gamma=0.8, **STIFF),),
            single,
            "the count",
            USUAL,
        ),
        Entry("fig-5.72", "typical motion, impacts", "1 impact in 1 cycle", (USUAL_POINT,), single, "the count", USUAL),
        Entry(
            "fig-5.73",
            "time of sticking as v goes from 0.5 to 1.5",
            "decreases",
            (SLOW, USUAL_POINT),
            _less_sticking,
            _TREND,
            USUAL,
        ),
        Entry("fig-5.74a", "static friction", "981 N", (TYPICAL_SLOW,), _static, "0.2 %: sampled", USUAL),
        Entry(
            "fig-5.74b",
            "rise of friction at impact",
            "stepwise, 0.4 of the impact force",
            (TYPICAL,),
            _friction_step,
            "1 %",
            USUAL,
        ),
        Entry(
            "fig-5.75",
            "beta 0.3, gamma 0.9",
            "one limit cycle with an undesired swing (2 swings)",
            (at(beta=0.3, gamma=0.9),),
            _extra_swing,
            "over 1.5 swings of the striker a cycle, one impact",
            USUAL,
        ),
        Entry(
            "fig-5.76b",
            "beta 0.4, gamma 0.9: frequency with impact",
            "4.6 Hz",
            (at(gamma=0.9),),
            lambda one: number(one.frequency, 4.6, "Hz", 0.02),
            FREQUENCY,
            USUAL,
        ),
        Entry(
            "fig-5.76c",
            "beta 0.4, gamma 0.9: frequencies of the striker",
            "9.3 Hz stronger than 4.6 Hz",
            (EXTRA_SWING,),
            _second_harmonic,
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
            _in_turn,
            "the count",
            (*USUAL, "R6"),
        ),
        Entry(
            "fig-5.77c",
            "k1 625000, gamma 1.2",
            "single, double and triple, irregular (1 to 3 a cycle)",
            (HIGH[1], at(start="stuck", gamma=1.2, **STIFF)),
            _mixes,
            "irregular, between 1 and 3",
            (*USUAL, "R6"),
        ),
        Entry(
            "sec-5.6.2.4",
            "greatest impact force for gamma over 1",
            "10 to 70 kN",
            HIGH,
            _high_forces,
            "the range",
            USUAL,
        ),
        Entry(
            "app-5.4",
            "beta 0.4, gamma 0.5: striker against bit",
            "counter-phase, 3.14 rad",
            (at(gamma=0.5),),
            _counter_phase,
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
            _not_converging,
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
    ),
    pictures=(
        Picture(
            "Figs 5.53 and 5.54, what the source does not say",
            "Frequency and change of velocity over the Stribeck speed v_cr, for both signs of the gap and three "
            "starts; dashed: the source. Hollow: no single impact.",
            UNSAID,
            pictures.unsaid,
        ),
        Picture(
            "Fig. 5.52 and 5.72",
            "The working cycle at v 0.5 m/s: stick (thick), slip, and the blow, which falls while the bit slows.",
            (TYPICAL_SLOW,),
            pictures.working_cycle,
        ),
        Picture(
            "Fig. 5.53",
            "Velocities of bit and striker with impact, from zero: settled after some cycles.",
            (TYPICAL,),
            pictures.velocities,
        ),
        Picture(
            "Figs 5.57 and 5.68",
            "Phase portraits of bit and striker; the striker's vertical edge is the blow.",
            (TYPICAL,),
            pictures.portraits,
        ),
        Picture(
            "Figs 5.51 and 5.74",
            "Impact force of one blow, and the friction force beside it (k0 50 MN/m).",
            (TYPICAL,),
            pictures.forces,
        ),
        Picture(
            "Figs 5.60 and 5.67",
            "Counter-phase at gamma 0.5 (beta 0.3), in phase at 0.6 (beta 0.4).",
            (COUNTER, IN_PHASE),
            pictures.phases,
        ),
        Picture(
            "Fig. 5.77",
            "k1 625000: single blows at gamma 1.0, single and double in turn at 1.1, irregular at 1.2.",
            TRIPLE,
            pictures.in_turn,
        ),
    ),
)
