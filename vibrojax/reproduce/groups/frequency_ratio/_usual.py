"""Impact at the usual point: its force, its velocity, its frequency, how soon it settles (Figs 5.51 to 5.59)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import ORDER, Entry, Here, claim, listed, not_compared, number, trend
from vibrojax.reproduce._needs import lane
from vibrojax.reproduce.groups._impact import USUAL, at, change, change_beside, moving, quickly, sticks
from vibrojax.reproduce.groups.frequency_ratio._points import OTHER_GAP, SLOW, USUAL_POINT

WITHOUT = lane("rotary")
SOURCE_CONTACT = moving(k0=9e6)
GAPS = (-0.005, 0.0, 0.005, 0.010)
STIFFNESSES = (9e6, 50e6, 200e6)


def frequency(one, other) -> Here:
    note = f"with a gap of +5 mm from `stuck` {other.angular_frequency:.2f} rad/s"
    off = abs(one.angular_frequency / 27.45 - 1)
    return number(one.angular_frequency, 27.45, "rad/s", 0.005, note, trend=off <= 0.02)


def lower_than_without(one, without) -> Here:
    text = f"{one.angular_frequency:.2f} rad/s with, {without.angular_frequency:.2f} without impact"
    return trend(text, one.angular_frequency < without.angular_frequency)


def sliding(*lanes) -> Here:
    speeds = [one["bit_velocity_at_impact"] for one in lanes]
    text = f"{listed(speeds)} m/s at (beta, gamma) (0.4, 0.6), (0.4, 0.9), (0.3, 0.5)"
    return not_compared(text, "the source has it in figures only")


def coexist(drive, stuck) -> Here:
    text = f"{change(stuck):.2f} m/s from `stuck` ({stuck.regime}), {change(drive):.2f} from `drive` ({drive.regime})"
    return claim(text, drive.regime == stuck.regime, "two attractors coexist")


def faster(slow, fast) -> Here:
    ratio = fast["settling_time"] / slow["settling_time"]
    text = f"{fast['settling_time']:.1f} s with impact, {slow['settling_time']:.1f} s without ({ratio:.2f} times)"
    return trend(text, ratio < 0.5)


def force_over(values, name: str):
    def judge(*lanes):
        forces = [one["peak_impact_force"] / 1e3 for one in lanes]
        return trend(f"{listed(forces)} kN at {name} {listed(values)}", bool(np.all(np.diff(forces) > 0)))

    return judge


def typical_force(moving) -> Here:
    peak = signal.part(moving, "impact_force", 8.0).max() / 1e3
    return not_compared(f"{peak:.1f} kN at its highest", "the figure's axis is not in the text")


def few_cycles(one, without) -> Here:
    return quickly(one, without)


ENTRIES = (
    Entry(
        "fig-5.51",
        "typical impact force, k0 9e6",
        "not in the text",
        (SOURCE_CONTACT,),
        typical_force,
        "none",
        USUAL,
    ),
    Entry(
        "sec-5.6a",
        "impact force over the gap, from start stuck, -5 to 10 mm",
        "increases with the gap",
        tuple(at(start="stuck", delta=delta) for delta in GAPS),
        force_over([1e3 * gap for gap in GAPS], "gaps in mm of"),
        ORDER,
        ("R2", "R4", "R6"),
    ),
    Entry(
        "sec-5.6b",
        "impact force over the contact stiffness, 9 to 200 MN/m",
        "increases with it",
        tuple(at(k0=k0) for k0 in STIFFNESSES),
        force_over([1e-6 * k0 for k0 in STIFFNESSES], "MN/m of"),
        ORDER,
        USUAL,
    ),
    Entry(
        "fig-5.53a",
        "settling time with and without impact",
        "very short in comparison",
        (WITHOUT, USUAL_POINT),
        faster,
        "less than half",
        (*USUAL, "R16"),
    ),
    Entry(
        "fig-5.53b",
        "change of the striker's velocity at a blow",
        "about 4 m/s",
        (USUAL_POINT, OTHER_GAP),
        change_beside(4.0, 0.1, ("gap +5 mm from `stuck`",)),
        '10 %: one digit, and "about"',
        (*USUAL, "R6"),
    ),
    Entry(
        "fig-5.54a",
        "frequency with impact",
        "27.45 rad/s",
        (USUAL_POINT, OTHER_GAP),
        frequency,
        "0.5 %: 1 ms of its period; in trend to 2 %, by which what the source does not say moves it: gap and start",
        (*USUAL, "R6"),
    ),
    Entry(
        "fig-5.54b",
        "frequency with impact, compared with that without",
        "less",
        (USUAL_POINT, WITHOUT),
        lower_than_without,
        ORDER,
        USUAL,
    ),
    Entry(
        "fig-5.55",
        "how soon the limit cycle is reached",
        "after a few cycles",
        (USUAL_POINT, WITHOUT),
        few_cycles,
        "10 cycles; in trend: under a third of those without impact",
        (*USUAL, "R14", "R16"),
    ),
    Entry(
        "sec-5.6.1",
        "gap +5 mm: change of the striker's velocity, and the start",
        "always the same limit cycle",
        (at(delta=0.005), OTHER_GAP),
        coexist,
        "the same regime from both starts",
        ("R2", "R4", "R5", "R6"),
    ),
    Entry(
        "sec-5.6.2b",
        "sliding speed of the bit at impact",
        "not in the text",
        (at(gamma=0.6), at(gamma=0.9), at(beta=0.3, gamma=0.5)),
        sliding,
        "none",
        USUAL,
    ),
    Entry(
        "fig-5.56",
        "the same at beta 0.3, gamma 0.6, v 0.5",
        "after a few oscillations",
        (at(beta=0.3, gamma=0.6, v=0.5), lane("rotary", beta=0.3, gamma=0.6, v=0.5)),
        few_cycles,
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
)
