"""How the results of impact and the mass ratio are judged."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, Here, claim, listed, trend
from vibrojax.reproduce.groups._impact import change, is_single

BETAS = (0.25, 0.5, 0.6)
SHARES = (0.1, 0.25, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


def extra_swings(one) -> Here:
    return claim(f"{one['striker_turns']:.2f} swings of the striker per cycle", one["striker_turns"] > 1.5)


def weaker(light, usual) -> Here:
    text = f"{change(light):.2f} m/s at beta 0.1, {change(usual):.2f} m/s at beta 0.4"
    return trend(text, change(light) < change(usual))


def unstable(*lanes) -> Here:
    unstable = sum(not is_single(one) for one in lanes)
    text = f"{unstable} of {len(lanes)} points (beta 0.1, 0.15, 0.2) are not a single impact"
    return claim(text, unstable > 0, "the single impact is stable there too, with a second swing of the striker at 0.1")


def amplitudes(*lanes) -> Here:
    swings = [1e3 * one["striker_amplitude"] for one in lanes]
    return trend(f"{listed(swings)} mm at beta {listed(BETAS)}", bool(np.all(np.diff(swings) > 0)))


def smaller_swing(soft, stiff) -> Here:
    swings = [1e3 * one["striker_amplitude"] for one in (soft, stiff)]
    return trend(f"{swings[0]:.1f} mm at k1 156250, {swings[1]:.1f} mm at 625000", swings[1] < swings[0])


def greater_force(soft, stiff) -> Here:
    forces = [one["peak_impact_force"] / 1e3 for one in (soft, stiff)]
    return trend(f"{forces[0]:.1f} kN at k1 156250, {forces[1]:.1f} kN at 625000", forces[1] > forces[0])


def all_single(*lanes) -> Here:
    counts = [one["impacts"] for one in lanes]
    return claim(f"{listed(counts)} impacts per cycle at beta {listed(BETAS)}", all(map(is_single, lanes)))


def same_frequency(*lanes) -> Here:
    found = np.array([one.angular_frequency for one in lanes])
    return claim(
        f"{100 * (found.max() / found.min() - 1):.1f} % between beta 0.25 and 0.6", np.ptp(found) < 0.022 * found.min()
    )


def settles_late(early, late) -> Here:
    note = (
        f"at 40 s it is {early.regime}, and creeps; returns differ by under 1 % from {late['settling_time']:.0f} s on"
    )
    return claim(f"{late['cycles']:.0f} return to repeat, by 300 s", late["cycles"] == 1, note)


def no_sticking(one) -> Here:
    text = f"{one['stick_fraction']:.4f} of the time sticking, {one['reverse_fraction']:.4f} sliding backwards"
    return claim(text, one["stick_fraction"] == 0 and one["reverse_fraction"] == 0)


def tolerable_damping(*lanes) -> Here:
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


def equal_masses(early, late, damped_less) -> Here:
    text = f"{late['impacts']:.3g} impact in {late['cycles']:.0f} returns by 300 s; at 40 s {early.regime}"
    note = f"with a quarter of the damping: {damped_less.regime}, {damped_less.angular_frequency:.2f} rad/s"
    verdict = AGREES if is_single(late) else IN_TREND if late["impacts"] == 1 else DIFFERS
    return Here(text, verdict, note)


def creeps(moving) -> Here:
    _, swings = signal.envelope(moving, "x1", 2.0)
    early, middle, late = (1e3 * float(swings[part].max()) for part in (slice(2, 5), slice(7, 10), slice(15, 20)))
    text = f"{early:.1f} mm at 4 to 10 s, {middle:.1f} mm at 14 to 20 s, {late:.1f} mm after 30 s"
    return trend(text, early < middle < late)


def neither(*lanes) -> Here:
    regimes = ", ".join(
        f"{one.regime} from `{start}`" for one, start in zip(lanes, ("drive", "stuck", "touching"), strict=True)
    )
    irregular = sum(one["cycles"] == 0 for one in lanes)
    return claim(f"{irregular} of 3 starts not periodic by 40 s", lanes[0]["cycles"] == 0, regimes)


def still_single(one, damped_less) -> Here:
    note = f"with a quarter of the damping: {damped_less.regime}, change of velocity {change(damped_less):.2f} m/s"
    verdict = AGREES if is_single(one) else DIFFERS
    return Here(f"{one['impacts']:.2f} impacts per cycle, {one.regime}", verdict, note)
