"""How the results of impact and the frequency ratio are judged."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import (
    AGREES,
    DIFFERS,
    IN_TREND,
    Here,
    claim,
    not_compared,
    number,
    trend,
    within_range,
)
from vibrojax.reproduce.groups._impact import (
    acceleration_at_impacts,
    change,
    is_single,
    listed,
    quickly,
)

LOW_GAMMAS = (0.6, 0.5, 0.4, 0.3)
TURNING = tuple(round(0.5 + 0.01 * step, 2) for step in range(11))


def frequency(one, other) -> Here:
    note = f"with a gap of +5 mm from `stuck` {other.angular_frequency:.2f} rad/s"
    return number(one.angular_frequency, 27.45, "rad/s", 0.02, note)


def lower_than_without(one, without) -> Here:
    text = f"{one.angular_frequency:.2f} rad/s with, {without.angular_frequency:.2f} without impact"
    return trend(text, one.angular_frequency < without.angular_frequency)


def change_beside(source: float, others: tuple[str, ...] = ()):
    def judge(one, *more):
        note = "; ".join(f"{name} {change(other):.2f}" for name, other in zip(others, more, strict=True))
        return number(change(one), source, "m/s", 0.1, note)

    return judge


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


def counter_phase(one) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) > np.pi / 2)


def in_phase(one) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) < np.pi / 2)


def ascending(moving) -> Here:
    found = acceleration_at_impacts(moving, 8.0)
    return claim(f"{found.mean():+.1f} m/s² of the bit just before impact", bool((found > 0).all()))


def falling(moving) -> Here:
    found = acceleration_at_impacts(moving, 8.0)
    return claim(f"{found.mean():+.1f} m/s² of the bit just before impact", bool((found < 0).all()))


def turns_in_phase(*lanes) -> Here:
    lags = np.abs([one["phase_lag"] for one in lanes])
    turned = [gamma for gamma, lag in zip(TURNING, lags, strict=True) if lag < np.pi / 2]
    if not turned:
        return Here("nan", DIFFERS, "counter-phase up to 0.6")
    return number(min(turned), 0.6, "", 0.1, "where the striker's lag first falls below pi/2, in steps of 0.01")


def forces_fall(*lanes) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in lanes]
    return trend(f"{listed(forces)} kN at gamma {listed(LOW_GAMMAS)}", bool(np.all(np.diff(forces) < 0)))


def same_frequency(*lanes) -> Here:
    with_impact, without = lanes[: len(lanes) // 2], lanes[len(lanes) // 2 :]
    off = [a.angular_frequency / b.angular_frequency - 1 for a, b in zip(with_impact, without, strict=True)]
    text = f"{listed([100 * x for x in off], 2)} % at gamma 0.5, 0.4, 0.3"
    return claim(text, max(map(abs, off)) < 0.015)


def negligible(one, without) -> Here:
    swing = one["bit_amplitude"] / without["bit_amplitude"] - 1
    return trend(f"{100 * swing:+.1f} % of the bit's amplitude", abs(swing) < 0.05)


def weak(one, strong) -> Here:
    note = f"{one['impacts']:.2f} impacts a cycle; greatest change {2 * one['impact_velocity_max']:.2f} m/s"
    return number(change(one), 0.2, "m/s", 0.25, note, trend=change(one) < 0.15 * change(strong))


def irregular(one) -> Here:
    return claim(f"{one['impacts']:.2f} impacts a cycle, {one.regime}", one.regime == "irregular")


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
    strongest = np.abs(acceleration[flight][5:-5]).max()
    still = flight & (np.abs(acceleration) < 0.1 * strongest)
    step = time[1] - time[0]
    return not_compared(
        f"{1e3 * longest(still) * step:.1f} ms under a tenth of its greatest in flight",
        "what counts as zero depends on the figure's axis, which has the blow on it and is not in the text",
    )


def longest(flags: np.ndarray) -> int:
    ends = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(max((ends[1::2] - ends[::2]), default=0))


def friction_step(moving) -> Here:
    """How much friction rises per newton of impact force, where the bit slides forward."""
    sliding = (moving["v1"].values + 1.5 > 0.05) & (moving["impact_force"].values > 1e3)
    rise = moving["friction_force"].values[sliding]
    slope = np.polyfit(moving["impact_force"].values[sliding], rise, 1)[0]
    return number(float(slope), 0.4, "of the impact force", 0.01)


def static(moving) -> Here:
    """The weight's part of the stick limit, from the friction while the bit starts to slide without impact."""
    free = moving["impact_force"].values == 0
    return number(float(moving["friction_force"].values[free].max()), 981.0, "N", 0.002)


def less_sticking(slow, fast) -> Here:
    text = f"{1e3 * slow['stick_fraction'] * slow['period']:.1f} ms at v 0.5, "
    text += f"{1e3 * fast['stick_fraction'] * fast['period']:.2f} ms at v 1.5"
    return trend(text, slow["stick_fraction"] > fast["stick_fraction"])


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
