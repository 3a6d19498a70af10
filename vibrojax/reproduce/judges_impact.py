"""Judges of the drill with impact: one blow at the usual point, and what the frequency ratio makes of it."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Bool

from vibrojax.reproduce import datasets_chapter5 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.needs import Features
from vibrojax.reproduce.verdicts import (
    AGREES,
    DIFFERS,
    IN_TREND,
    Here,
    Verdict,
    claim,
    listed,
    not_compared,
    number,
    trend,
    within_range,
)


def change(one: Features) -> float:
    """The striker's change of velocity in a blow [m/s]: twice the impact velocity, as the contact loses nothing."""
    return 2 * one["impact_velocity"]


def is_single(one: Features) -> bool:
    """Whether it repeats after one return with one impact."""
    return one.regime == "single-impact"


def forces(lanes: Sequence[Features]) -> list[float]:
    """The greatest impact forces [kN]."""
    return [one["peak_impact_force"] / 1e3 for one in lanes]


def single(one: Features) -> Here:
    return claim(f"{one['impacts']:.3g} impact in {one['cycles']:.0f} cycle, {one.regime}", is_single(one))


def counter_phase(one: Features) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) > np.pi / 2)


def in_phase(one: Features) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) < np.pi / 2)


def change_beside(source: float, within: float, others: tuple[str, ...] = ()) -> Callable[..., Here]:
    """The change of velocity beside the source's; `others` name further lanes, for the remark."""

    def judge(one: Features, *more: Features) -> Here:
        note = "; ".join(f"{name} {change(other):.2f}" for name, other in zip(others, more, strict=True))
        return number(change(one), source, "m/s", within, note)

    return judge


# At the usual point.


def typical_force(motion: xr.Dataset) -> Here:
    peak = motions.part(motion, "impact_force", 8.0).max() / 1e3
    return not_compared(f"{peak:.1f} kN at its highest", "the figure's axis is not in the text")


def force_over(values: Sequence[float], name: str) -> Callable[..., Here]:
    """Whether the greatest impact force grows with `values`."""

    def judge(*lanes: Features) -> Here:
        text = f"{listed(forces(lanes))} kN at {name} {listed(values)}"
        return trend(text, np.all(np.diff(forces(lanes)) > 0))

    return judge


def faster(slow: Features, fast: Features) -> Here:
    ratio = fast["settling_time"] / slow["settling_time"]
    text = f"{fast['settling_time']:.1f} s with impact, {slow['settling_time']:.1f} s without ({ratio:.2f} times)"
    return trend(text, ratio < 0.5)


def frequency(one: Features, other: Features) -> Here:
    note = f"with a gap of +5 mm from `stuck` {other.angular_frequency:.2f} rad/s"
    off = abs(one.angular_frequency / 27.45 - 1)
    return number(one.angular_frequency, 27.45, "rad/s", 0.005, note, trend=off <= 0.02)


def lower_than_without(one: Features, without: Features) -> Here:
    text = f"{one.angular_frequency:.2f} rad/s with, {without.angular_frequency:.2f} without impact"
    return trend(text, one.angular_frequency < without.angular_frequency)


def settles_in_few_cycles(one: Features, without: Features) -> Here:
    """Settled after a few cycles; `without`: the lane without impact."""
    cycles = one["settling_time"] / one["period"]
    slower = without["settling_time"] / without["period"]
    verdict: Verdict = AGREES if cycles <= 10 else IN_TREND if cycles < slower / 3 else DIFFERS
    return Here(f"{cycles:.0f} cycles ({one['settling_time']:.1f} s), {slower:.0f} without impact", verdict)


def coexist(drive: Features, stuck: Features) -> Here:
    text = f"{change(stuck):.2f} m/s from `stuck` ({stuck.regime}), {change(drive):.2f} from `drive` ({drive.regime})"
    return claim(text, drive.regime == stuck.regime, "two attractors coexist")


def sliding(*lanes: Features) -> Here:
    speeds = [one["bit_velocity_at_impact"] for one in lanes]
    text = f"{listed(speeds)} m/s at (beta, gamma) (0.4, 0.6), (0.4, 0.9), (0.3, 0.5)"
    return not_compared(text, "the source has it in figures only")


def sticks(one: Features, slower: Features) -> Here:
    """Whether the bit sticks and never slides back; `slower`: the lane at 0.5 m/s."""
    stick, back = one["stick_fraction"], one["reverse_fraction"]
    held, backwards = slower["stick_fraction"], slower["reverse_fraction"]
    note = f"at v 0.5 m/s it sticks {held:.3f} of the time and slides backwards {backwards:.3f}"
    text = f"{back:.3f} of the time sliding backwards, {stick:.4f} sticking"
    return Here(text, AGREES if _stick_slip(one) else DIFFERS, note)


def sticks_at_some_speed(one: Features, slower: Features) -> Here:
    """The same, where the source's figure does not say the speed."""
    here = sticks(one, slower)
    return here if here.verdict == AGREES or not _stick_slip(slower) else replace(here, verdict=IN_TREND)


def _stick_slip(one: Features) -> bool:
    return one["stick_fraction"] > 1e-3 and one["reverse_fraction"] == 0


# Frequency ratios below 0.6: counter-phase, weak and irregular impacts.


def turns_in_phase(*lanes: Features) -> Here:
    lags = np.abs([one["phase_lag"] for one in lanes])
    turned = [gamma for gamma, lag in zip(data.TURNING, lags, strict=True) if lag < np.pi / 2]
    if not turned:
        return Here("nan", DIFFERS, "counter-phase up to 0.6")
    return number(min(turned), 0.6, "", 0.083, "where the striker's lag first falls below pi/2, in steps of 0.01")


def bit_acceleration(sign: int) -> Callable[[xr.Dataset], Here]:
    """Whether the bit's acceleration has a sign in the two milliseconds before each impact."""

    def judge(motion: xr.Dataset) -> Here:
        times = motions.events(motion, "impact", 8.0)
        before, later = (motions.at(motion, "v1", times - early) for early in (2.1e-3, 1e-4))
        acceleration = (later - before) / 2e-3
        text = f"{acceleration.mean():+.1f} m/s² of the bit just before impact"
        return claim(text, (sign * acceleration > 0).all())

    return judge


def negligible(one: Features, without: Features) -> Here:
    swing = one["bit_amplitude"] / without["bit_amplitude"] - 1
    return trend(f"{100 * swing:+.1f} % of the bit's amplitude", abs(swing) < 0.05)


def forces_fall(*lanes: Features) -> Here:
    text = f"{listed(forces(lanes))} kN at gamma {listed(data.LOW_GAMMAS)}"
    return trend(text, np.all(np.diff(forces(lanes)) < 0))


def same_frequency(*lanes: Features) -> Here:
    with_impact, without = lanes[: len(lanes) // 2], lanes[len(lanes) // 2 :]
    off = [a.angular_frequency / b.angular_frequency - 1 for a, b in zip(with_impact, without, strict=True)]
    text = f"{listed([100 * x for x in off], 2)} % at gamma 0.5, 0.4, 0.3"
    return claim(text, max(map(abs, off)) < 0.012)


def irregular(one: Features) -> Here:
    return claim(f"{one['impacts']:.2f} impacts a cycle, {one.regime}", one.regime == "irregular")


def weak(one: Features, strong: Features) -> Here:
    note = f"{one['impacts']:.2f} impacts a cycle; greatest change {2 * one['impact_velocity_max']:.2f} m/s"
    return number(change(one), 0.2, "m/s", 0.25, note, trend=change(one) < 0.15 * change(strong))


# From 0.6 to 0.8: in phase, one strong blow a cycle.


def impact_phase(slow: Features, fast: Features, *others: Features) -> Here:
    moved = fast["impact_phase"] - slow["impact_phase"]
    shift = others[1]["impact_phase"] - others[0]["impact_phase"]
    note = f"at beta 0.3, as Table 5.5 has it, {shift:+.2f} rad: the motion only scales with v"
    return trend(f"{moved:+.2f} rad from v 0.5 to 1.5 m/s", abs(moved) > 0.1, note)


def grows_with_v(slow: Features, fast: Features) -> Here:
    text = f"{change(slow):.2f} m/s at v 0.5, {change(fast):.2f} m/s at v 1.5"
    return trend(text, change(fast) > change(slow))


def rest(motion: xr.Dataset) -> Here:
    """How long the striker hardly accelerates about its farthest point from the bit."""
    begin, end = motions.last_cycle(motion)
    time = motion["time"].values
    inside = (time >= begin) & (time <= end)
    acceleration = np.gradient(motion["v2"].values[inside], time[inside])
    flight = motion["impact_force"].values[inside] == 0
    strongest, blow = np.abs(acceleration[flight][5:-5]).max(), np.abs(acceleration).max()
    stills = [flight & (np.abs(acceleration) < zero) for zero in (0.1 * strongest, 0.02 * blow)]
    short, long = (1e3 * (time[1] - time[0]) * _longest(still) for still in stills)
    return not_compared(
        f"{short:.1f} ms under a tenth of its greatest in flight",
        f"what looks like zero depends on the axis, not in the text: {long:.0f} ms under 2 % of that in the blow",
    )


def _longest(flags: Bool[np.ndarray, " samples"]) -> int:
    """Samples of the longest run of true flags."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(max((ends[1::2] - ends[::2]), default=0))


def less_sticking(slow: Features, fast: Features) -> Here:
    text = f"{1e3 * slow['stick_fraction'] * slow['period']:.1f} ms at v 0.5, "
    text += f"{1e3 * fast['stick_fraction'] * fast['period']:.2f} ms at v 1.5"
    return trend(text, slow["stick_fraction"] > fast["stick_fraction"])


def static_friction(motion: xr.Dataset) -> Here:
    """The weight's part of the stick limit, from the friction while the bit starts to slide without impact."""
    free = motion["impact_force"].values == 0
    return number(float(motion["friction_force"].values[free].max()), 981.0, "N", 0.002)


def friction_step(motion: xr.Dataset) -> Here:
    """How much friction rises per newton of impact force, where the bit slides forward."""
    forward = (motion["v1"].values + 1.5 > 0.05) & (motion["impact_force"].values > 1e3)
    rise = motion["friction_force"].values[forward]
    slope = np.polyfit(motion["impact_force"].values[forward], rise, 1)[0]
    return number(float(slope), 0.4, "of the impact force", 0.01)


# Above 0.8: extra swings, several impacts.


def extra_swing(one: Features) -> Here:
    text = f"{one['striker_turns']:.2f} swings of the striker per cycle, {one.regime}"
    return claim(text, is_single(one) and one["striker_turns"] > 1.5)


def second_harmonic(motion: xr.Dataset) -> Here:
    first, second = (motions.peak(motion, "v2", *band, since=6.0) for band in ((3.5, 6.0), (8.0, 11.0)))
    share = second.power / first.power
    text = f"{second.frequency:.2f} Hz with {share:.2f} of the power at {first.frequency:.2f} Hz"
    stronger, strong = second.power > first.power, second.power > 0.3 * first.power
    return Here(text, AGREES if stronger else IN_TREND if strong else DIFFERS)


def in_turn(one: Features, other: Features) -> Here:
    share = one["impacts"] / one["cycles"] if one["cycles"] else one["impacts"]
    text = f"{share:.2f} impacts a cycle, {one['impacts']:.3g} in {one['cycles']:.0f} returns"
    return claim(text, one["cycles"] > 0 and abs(share - 1.5) < 1e-9, f"from `stuck`: {other.regime}")


def mixes(one: Features, other: Features) -> Here:
    text = f"{one['impacts']:.2f} impacts a cycle, {one.regime}"
    holds = one.regime == "irregular" and 1 < one["impacts"] < 3
    return claim(text, holds, f"from `stuck`: {other.regime}")


def high_forces(*lanes: Features) -> Here:
    note = (
        f"greatest forces {listed(forces(lanes))} kN at (k1 625000) gamma 1.1, 1.2, 1.5 and (k1 156250, beta 0.3) 1.2"
    )
    return within_range(min(forces(lanes)), max(forces(lanes)), (10, 70), "kN", note)


def high_force(one: Features) -> Here:
    (force,) = forces([one])
    return within_range(force, force, (10, 70), "kN")


def not_converging(one: Features) -> Here:
    return claim(f"{one['impacts']:.2f} impacts a cycle, {one.regime}", not is_single(one))
