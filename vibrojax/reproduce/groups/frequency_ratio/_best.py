"""Frequency ratios from 0.6 to 0.8: in phase, one strong blow a cycle (Figs 5.67 to 5.74)."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import ORDER, Entry, Here, claim, not_compared, number, trend
from vibrojax.reproduce.groups._impact import (
    STIFF,
    USUAL,
    acceleration_at_impacts,
    at,
    change,
    change_beside,
    in_phase,
    moving,
    single,
    sticks_at_some_speed,
)
from vibrojax.reproduce.groups.frequency_ratio._points import SLOW, USUAL_POINT

TYPICAL, TYPICAL_SLOW = moving(), moving(v=0.5)
IN_PHASE = moving(gamma=0.6)
STIFF_POINT = moving(gamma=0.8, **STIFF)


def falling(moving) -> Here:
    found = acceleration_at_impacts(moving, 8.0)
    return claim(f"{found.mean():+.1f} m/s² of the bit just before impact", bool((found < 0).all()))


def phases(slow, fast, *others) -> Here:
    moved = fast["impact_phase"] - slow["impact_phase"]
    text = f"{moved:+.2f} rad from v 0.5 to 1.5 m/s"
    shift = others[1]["impact_phase"] - others[0]["impact_phase"]
    return trend(
        text, abs(moved) > 0.1, f"at beta 0.3, as Table 5.5 has it, {shift:+.2f} rad: the motion only scales with v"
    )


def grows_with_v(slow, fast) -> Here:
    text = f"{change(slow):.2f} m/s at v 0.5, {change(fast):.2f} m/s at v 1.5"
    return trend(text, change(fast) > change(slow))


def rest(moving) -> Here:
    """How long the striker hardly accelerates about its farthest point from the bit."""
    begin, end = signal.last_cycle(moving)
    time = moving["time"].values
    inside = (time >= begin) & (time <= end)
    acceleration = np.gradient(moving["v2"].values[inside], time[inside])
    flight = moving["impact_force"].values[inside] == 0
    strongest, blow = np.abs(acceleration[flight][5:-5]).max(), np.abs(acceleration).max()
    stills = [flight & (np.abs(acceleration) < zero) for zero in (0.1 * strongest, 0.02 * blow)]
    short, long = (1e3 * (time[1] - time[0]) * longest(still) for still in stills)
    return not_compared(
        f"{short:.1f} ms under a tenth of its greatest in flight",
        f"what looks like zero depends on the axis, not in the text: {long:.0f} ms under 2 % of that in the blow",
    )


def longest(flags: np.ndarray) -> int:
    ends = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(max((ends[1::2] - ends[::2]), default=0))


def friction_step(moving) -> Here:
    """How much friction rises per newton of impact force, where the bit slides forward."""
    forward = (moving["v1"].values + 1.5 > 0.05) & (moving["impact_force"].values > 1e3)
    rise = moving["friction_force"].values[forward]
    slope = np.polyfit(moving["impact_force"].values[forward], rise, 1)[0]
    return number(float(slope), 0.4, "of the impact force", 0.01)


def static(moving) -> Here:
    """The weight's part of the stick limit, from the friction while the bit starts to slide without impact."""
    free = moving["impact_force"].values == 0
    return number(float(moving["friction_force"].values[free].max()), 981.0, "N", 0.002)


def less_sticking(slow, fast) -> Here:
    text = f"{1e3 * slow['stick_fraction'] * slow['period']:.1f} ms at v 0.5, "
    text += f"{1e3 * fast['stick_fraction'] * fast['period']:.2f} ms at v 1.5"
    return trend(text, slow["stick_fraction"] > fast["stick_fraction"])


ENTRIES = (
    Entry(
        "fig-5.67a",
        "beta 0.4, gamma 0.6: place of the impact in the cycle as v goes from 0.5 to 1.5",
        "moves with the driving velocity",
        (at(gamma=0.6, v=0.5), at(gamma=0.6), at(beta=0.3, gamma=0.6, v=0.5), at(beta=0.3, gamma=0.6)),
        phases,
        "over 0.1 rad",
        (*USUAL, "R19"),
    ),
    Entry(
        "fig-5.67b",
        "beta 0.4, gamma 0.6: change of the striker's velocity",
        "6 m/s",
        (at(gamma=0.6), at(beta=0.3, gamma=0.6)),
        change_beside(6.0, 0.08, ("at beta 0.3",)),
        "8 %: half a unit of its one digit",
        (*USUAL, "R19"),
    ),
    Entry(
        "fig-5.67c",
        "beta 0.4, gamma 0.6: change of velocity over v",
        "increases",
        (at(gamma=0.6, v=0.5), at(gamma=0.6)),
        grows_with_v,
        ORDER,
        (*USUAL, "R19"),
    ),
    Entry(
        "fig-5.67d",
        "beta 0.4, gamma 0.6: striker against bit",
        "in phase, 0 rad",
        (at(gamma=0.6),),
        in_phase,
        "lag under pi/2",
        (*USUAL, "R19"),
    ),
    Entry(
        "fig-5.67e",
        "beta 0.4, gamma 0.6: the bit's velocity when it is hit",
        "falling (an acceleration below 0)",
        (IN_PHASE,),
        falling,
        "the sign, in the 2 ms before each impact",
        USUAL,
    ),
    Entry(
        "fig-5.68",
        "beta 0.3, gamma 0.6: stick, slip and impact in a cycle",
        "all three, and never backwards (0 of the time)",
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
        change_beside(3.8, 0.026),
        "2.6 %: between two readings of a plot, each to half a unit of the last digit",
        USUAL,
    ),
    Entry(
        "fig-5.70b",
        "k1 625000, gamma 0.8: rest of the striker at its farthest",
        "35 ms of zero acceleration",
        (STIFF_POINT,),
        rest,
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
        less_sticking,
        ORDER,
        USUAL,
    ),
    Entry("fig-5.74a", "static friction", "981 N", (TYPICAL_SLOW,), static, "0.2 %: sampled", USUAL),
    Entry(
        "fig-5.74b",
        "rise of friction at impact",
        "stepwise, 0.4 of the impact force",
        (TYPICAL,),
        friction_step,
        "1 %",
        USUAL,
    ),
)
