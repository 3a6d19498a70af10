"""Verdicts: what is computed here beside what the source says, as a text, a verdict and a remark."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from vibrojax.reproduce.needs import Features

Real = float | int
"""A number; where types are checked at run time, whole numbers are no floats."""
Truth = bool | np.bool_

Verdict = Literal["agrees", "agrees in trend", "differs", "cannot be compared"]
AGREES: Final = "agrees"
IN_TREND: Final = "agrees in trend"
DIFFERS: Final = "differs"
NOT_COMPARED: Final = "cannot be compared"
VERDICTS: tuple[Verdict, ...] = (DIFFERS, NOT_COMPARED, IN_TREND, AGREES)
"""In the order in which they are shown: what is wrong comes first."""

MOSTLY = "within the range; in trend where more than half of ours is"
"""The tolerance of `within_range`."""
LAST_DIGIT = "its last digit, rounded or cut"
"""The tolerance of `printed`."""
ORDER = "the order"
"""A tolerance: what is said to grow grows here, however much."""


@dataclass(frozen=True)
class Here:
    """What is computed here: a text that begins with the number in the source's unit, the verdict, and a remark."""

    text: str
    verdict: Verdict
    note: str = ""


def number(value: Real, source: Real, unit: str, within: float, note: str = "", trend: Truth = False) -> Here:
    """A number beside the source's: agreement where they differ by no more than `within`, relative to the source's.

    `trend`: whether what the source concludes from it holds all the same.
    """
    return _beside(value, source, unit, abs(value / source - 1) <= within, note, trend)


def printed(value: Real, source: str, unit: str, note: str = "", trend: Truth = False) -> Here:
    """A number beside one that the source prints: agreement within its last digit, from half a unit below it to a whole
    one above.

    The source cuts: all moduli of Table 4.5 and ten rows of eq. 5.16 in Table 5.3 are cut (R30), and 29.34 rad/s, which
    are 4.67 Hz, are "4.6Hz on the graphs". That it always does is not known.
    """
    digit = 10.0 ** -len(source.partition(".")[2])
    off = (value - float(source)) / digit
    return _beside(value, float(source), unit, -0.5 <= off <= 1.0, note, trend)


def _beside(value: Real, source: Real, unit: str, agrees: Truth, note: str, trend: Truth) -> Here:
    off = value / source - 1
    verdict: Verdict = AGREES if agrees else IN_TREND if trend else DIFFERS
    beside = "±0.0%" if abs(off) < 5e-4 else f"{off:+.1%}" if off < 10 else f"{shown(value / source)} times"
    return Here(" ".join(part for part in (shown(value), unit, f"({beside})") if part), verdict, note)


def within_range(low: Real, high: Real, source: tuple[Real, Real], unit: str, note: str = "") -> Here:
    """A range beside the source's: agreement where it lies within, in trend where more than half of it does."""
    least, most = source
    inside = least <= low and high <= most
    mostly = min(high, most) - max(low, least) > 0.5 * (high - low)
    verdict: Verdict = AGREES if inside else IN_TREND if mostly else DIFFERS
    text = f"{shown(low)} {unit}" if low == high else f"{shown(low)} to {shown(high)} {unit}"
    return Here(text, verdict, note)


def claim(text: str, holds: Truth, note: str = "") -> Here:
    """What can be counted or distinguished: it holds here or not. `text` begins with a number."""
    return Here(text, AGREES if holds else DIFFERS, note)


def trend(text: str, holds: Truth, note: str = "") -> Here:
    """What the source shows as a tendency: it is there or not. `text` begins with a number."""
    return Here(text, IN_TREND if holds else DIFFERS, note)


def not_compared(text: str, why: str) -> Here:
    """What the source's text does not give a number for. `text` begins with ours."""
    return Here(text, NOT_COMPARED, why)


def frequency_beside(source: float, within: float) -> Callable[[Features], Here]:
    """A judge of one lane: its frequency [Hz] beside the source's, by `number`."""

    def judge(one: Features) -> Here:
        return number(one.frequency, source, "Hz", within)

    return judge


def shown(value: Real) -> str:
    """A number to four digits, without an exponent in the usual range."""
    value = float(value)
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def listed(values: Iterable[Real], digits: int = 3) -> str:
    """Numbers to so many digits, with commas between."""
    return ", ".join(f"{value:.{digits}g}" for value in values)
