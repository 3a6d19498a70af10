"""Frequency ratios below 0.6: counter-phase, weak and irregular impacts (Figs 5.60 to 5.66)."""

import numpy as np

from vibrojax.reproduce._entry import DIFFERS, ORDER, Entry, Here, claim, listed, number, trend
from vibrojax.reproduce._needs import lane
from vibrojax.reproduce.groups._impact import USUAL, acceleration_at_impacts, at, change, counter_phase, moving
from vibrojax.reproduce.groups.frequency_ratio._points import USUAL_POINT

COUNTER = moving(beta=0.3, gamma=0.5)
LOW_GAMMAS = (0.6, 0.5, 0.4, 0.3)
LOW = tuple(at(beta=0.3, gamma=gamma) for gamma in LOW_GAMMAS)
LOW_WITHOUT = tuple(lane("rotary", beta=0.3, gamma=gamma) for gamma in LOW_GAMMAS)
TURNING = tuple(round(0.5 + 0.01 * step, 2) for step in range(11))


def ascending(moving) -> Here:
    found = acceleration_at_impacts(moving, 8.0)
    return claim(f"{found.mean():+.1f} m/s² of the bit just before impact", bool((found > 0).all()))


def turns_in_phase(*lanes) -> Here:
    lags = np.abs([one["phase_lag"] for one in lanes])
    turned = [gamma for gamma, lag in zip(TURNING, lags, strict=True) if lag < np.pi / 2]
    if not turned:
        return Here("nan", DIFFERS, "counter-phase up to 0.6")
    return number(min(turned), 0.6, "", 0.083, "where the striker's lag first falls below pi/2, in steps of 0.01")


def forces_fall(*lanes) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    return trend(f"{listed(forces)} kN at gamma {listed(LOW_GAMMAS)}", bool(np.all(np.diff(forces) < 0)))


def same_frequency(*lanes) -> Here:
    with_impact, without = lanes[: len(lanes) // 2], lanes[len(lanes) // 2 :]
    off = [a.angular_frequency / b.angular_frequency - 1 for a, b in zip(with_impact, without, strict=True)]
    text = f"{listed([100 * x for x in off], 2)} % at gamma 0.5, 0.4, 0.3"
    return claim(text, max(map(abs, off)) < 0.012)


def negligible(one, without) -> Here:
    swing = one["bit_amplitude"] / without["bit_amplitude"] - 1
    return trend(f"{100 * swing:+.1f} % of the bit's amplitude", abs(swing) < 0.05)


def weak(one, strong) -> Here:
    note = f"{one['impacts']:.2f} impacts a cycle; greatest change {2 * one['impact_velocity_max']:.2f} m/s"
    return number(change(one), 0.2, "m/s", 0.25, note, trend=change(one) < 0.15 * change(strong))


def irregular(one) -> Here:
    return claim(f"{one['impacts']:.2f} impacts a cycle, {one.regime}", one.regime == "irregular")


ENTRIES = (
    Entry(
        "sec-5.6.2",
        "lowest gamma at which bit and striker move in phase, beta 0.4",
        "0.6",
        tuple(at(gamma=gamma) for gamma in TURNING),
        turns_in_phase,
        "8.3 %: half of the source's step of 0.1",
        USUAL,
    ),
    Entry(
        "fig-5.60a",
        "beta 0.3, gamma 0.5: striker against bit",
        "counter-phase, 3.14 rad",
        (at(beta=0.3, gamma=0.5),),
        counter_phase,
        "lag over pi/2",
        USUAL,
    ),
    Entry(
        "fig-5.60b",
        "beta 0.3, gamma 0.5: the bit's velocity when it is hit",
        "ascending (an acceleration above 0)",
        (COUNTER,),
        ascending,
        "the sign, in the 2 ms before each impact",
        USUAL,
    ),
    Entry(
        "fig-5.61",
        "beta 0.3, gamma 0.4: effect of the impact on the bit",
        "negligible",
        (LOW[2], LOW_WITHOUT[2]),
        negligible,
        "under 5 % of the amplitude",
        USUAL,
    ),
    Entry(
        "fig-5.64",
        "greatest impact force as gamma falls from 0.6 to 0.3, beta 0.3",
        "reduces considerably",
        LOW,
        forces_fall,
        ORDER,
        USUAL,
    ),
    Entry(
        "sec-5.6.2.1",
        "frequency below gamma 0.6, beta 0.3, compared with that without impact",
        "identical, 0 %",
        (*LOW[1:], *LOW_WITHOUT[1:]),
        same_frequency,
        "1.2 %: 0.05 Hz of 4.2; the source has frequencies with impact to 0.1 Hz",
        USUAL,
    ),
    Entry(
        "fig-5.65",
        "beta 0.3, gamma 0.3: impacts",
        "irregular, multiple",
        (LOW[3],),
        irregular,
        "the regime",
        USUAL,
    ),
    Entry(
        "fig-5.66",
        "beta 0.3, gamma 0.3: change of the striker's velocity",
        "about 0.2 m/s",
        (LOW[3], USUAL_POINT),
        weak,
        "25 %: one digit; in trend: under 15 % of that at gamma 0.75",
        USUAL,
    ),
)
