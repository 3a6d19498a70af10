"""What the groups of the vibro-impact scene share: its lanes, and how statements about impacts are judged."""

from dataclasses import replace

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import AGREES, DIFFERS, IN_TREND, Here, claim, number
from vibrojax.reproduce._needs import Lane, Motion, lane, motion

USUAL = ("R2", "R3", "R4", "R5")
STIFF = {"k1": 625000.0}


def at(settle: float = 40.0, start: str = "drive", **parameters) -> Lane:
    """A point of the scene, the source's where nothing is said."""
    return lane("vibro-impact", start, settle, **parameters)


def moving(duration: float = 12.0, start="drive", **parameters) -> Motion:
    """Its motion."""
    return motion("vibro-impact", duration, start, **parameters)


def change(one) -> float:
    """The striker's change of velocity in a blow [m/s]: twice the impact velocity, as the contact loses nothing."""
    return 2 * one["impact_velocity"]


def single(one, more: str = "") -> Here:
    """One impact per cycle."""
    return claim(f"{one['impacts']:.3g} impact in {one['cycles']:.0f} cycle, {one.regime}{more}", is_single(one))


def is_single(one) -> bool:
    """Whether it repeats after one return with one impact."""
    return one.regime == "single-impact"


def quickly(one, without) -> Here:
    """Settled after a few cycles; `without`: the lane without impact."""
    cycles = one["settling_time"] / one["period"]
    slower = without["settling_time"] / without["period"]
    verdict = AGREES if cycles <= 10 else IN_TREND if cycles < slower / 3 else DIFFERS
    return Here(f"{cycles:.0f} cycles ({one['settling_time']:.1f} s), {slower:.0f} without impact", verdict)


def sticks(one, slower) -> Here:
    """Whether the bit sticks and never slides back; `slower`: the lane at 0.5 m/s."""
    stick, back = one["stick_fraction"], one["reverse_fraction"]
    verdict = AGREES if _stick_slip(one) else DIFFERS
    held, backwards = slower["stick_fraction"], slower["reverse_fraction"]
    note = f"at v 0.5 m/s it sticks {held:.3f} of the time and slides backwards {backwards:.3f}"
    return Here(f"{back:.3f} of the time sliding backwards, {stick:.4f} sticking", verdict, note)


def sticks_at_some_speed(one, slower) -> Here:
    """The same, where the source's figure does not say the speed."""
    here = sticks(one, slower)
    return here if here.verdict == AGREES or not _stick_slip(slower) else replace(here, verdict=IN_TREND)


def _stick_slip(one) -> bool:
    return one["stick_fraction"] > 1e-3 and one["reverse_fraction"] == 0


def acceleration_at_impacts(motion, since: float) -> np.ndarray:
    """The bit's acceleration [m/s²] in the two milliseconds before each impact."""
    times = signal.events(motion, "impact", since)
    before, later = (signal.at(motion, "v1", times - early) for early in (2.1e-3, 1e-4))
    return (later - before) / 2e-3


def change_beside(source: float, within: float, others: tuple[str, ...] = ()):
    def judge(one, *more):
        note = "; ".join(f"{name} {change(other):.2f}" for name, other in zip(others, more, strict=True))
        return number(change(one), source, "m/s", within, note)

    return judge


def counter_phase(one) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) > np.pi / 2)


def in_phase(one) -> Here:
    return claim(f"{one['phase_lag']:.2f} rad behind the bit", abs(one["phase_lag"]) < np.pi / 2)
