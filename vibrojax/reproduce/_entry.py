"""One statement of the source, and how it is put beside what is computed here."""

from collections.abc import Callable
from dataclasses import dataclass

AGREES, IN_TREND, DIFFERS, NOT_COMPARED = "agrees", "agrees in trend", "differs", "cannot be compared"
VERDICTS = (DIFFERS, NOT_COMPARED, IN_TREND, AGREES)
"""In the order in which they are shown: what is wrong comes first."""


MOSTLY = "within the range; in trend where more than half of ours is"
"""The tolerance of `within_range`."""
LAST_DIGIT = "its last digit, rounded or cut"
"""The tolerance of `printed`."""
ORDER = "the order"
"""A tolerance: what is said to grow grows here, however much."""


@dataclass(frozen=True)
class Here:
    """What is found here: a text that begins with the number in the source's unit, the verdict, and a remark."""

    text: str
    verdict: str
    note: str = ""


@dataclass(frozen=True)
class Entry:
    """One result of the source.

    **Arguments:**

    - `id`: like `table-5.3.1`, `fig-5.67b`, `eq-5.17`.
    - `what`: what it is about, with its parameters.
    - `source`: what the source says: a number, a range, a count or a trend.
    - `needs`: what must be computed for it (see [vibrojax.reproduce._needs][]).
    - `judge`: takes the answers to `needs`, in their order, and gives `Here`. It never uses the source's number to
      compute ours.
    - `tolerance`: what counts as agreement, and why.
    - `readings`: names of the readings it rests on, R1 and so on.
    """

    id: str
    what: str
    source: str
    needs: tuple
    judge: Callable[..., Here]
    tolerance: str
    readings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Unanswered:
    """What takes the place of an answer that could not be computed, and why."""

    why: str


UNREADABLE = (ValueError, IndexError, ZeroDivisionError)
"""What reading a motion raises that has none of what is looked for: no return, no impact, nothing but NaN."""


def judged(entry: Entry, answers: list) -> Here:
    """What the entry's judge says; where there is nothing to read in the answers, that is a difference too."""
    missing = [answer.why for answer in answers if isinstance(answer, Unanswered)]
    if missing:
        return Here("nan", DIFFERS, f"could not be computed: {missing[0]}")
    try:
        return entry.judge(*answers)
    except UNREADABLE as problem:
        return Here("nan", DIFFERS, f"nothing to read in what was computed: {problem}")


def number(value: float, source: float, unit: str, within: float, note: str = "", trend: bool = False) -> Here:
    """A number beside the source's: agreement where they differ by no more than `within`, relative to the source's.

    `trend`: whether what the source concludes from it holds all the same.
    """
    return _beside(value, source, unit, abs(value / source - 1) <= within, note, trend)


def printed(value: float, source: str, unit: str, note: str = "", trend: bool = False) -> Here:
    """A number beside one that the source prints: agreement within its last digit, from half a unit below it to a whole
    one above.

    The source cuts: all moduli of Table 4.5 and ten rows of eq. 5.16 in Table 5.3 are cut (R30), and 29.34 rad/s, which
    are 4.67 Hz, are "4.6Hz on the graphs". That it always does is not known.
    """
    digit = 10.0 ** -len(source.partition(".")[2])
    off = (value - float(source)) / digit
    return _beside(value, float(source), unit, -0.5 <= off <= 1.0, note, trend)


def _beside(value: float, source: float, unit: str, agrees: bool, note: str, trend: bool) -> Here:
    off = value / source - 1
    verdict = AGREES if agrees else IN_TREND if trend else DIFFERS
    beside = "±0.0%" if abs(off) < 5e-4 else f"{off:+.1%}" if off < 10 else f"{shown(value / source)} times"
    return Here(" ".join(part for part in (shown(value), unit, f"({beside})") if part), verdict, note)


def within_range(low: float, high: float, source: tuple[float, float], unit: str, note: str = "") -> Here:
    """A range beside the source's: agreement where it lies within, in trend where more than half of it does."""
    least, most = source
    inside = least <= low and high <= most
    mostly = min(high, most) - max(low, least) > 0.5 * (high - low)
    verdict = AGREES if inside else IN_TREND if mostly else DIFFERS
    text = f"{shown(low)} {unit}" if low == high else f"{shown(low)} to {shown(high)} {unit}"
    return Here(text, verdict, note)


def claim(text: str, holds: bool, note: str = "") -> Here:
    """What can be counted or told apart: it holds here or not. `text` begins with a number."""
    return Here(text, AGREES if holds else DIFFERS, note)


def trend(text: str, holds: bool, note: str = "") -> Here:
    """What the source shows as a tendency: it is there or not. `text` begins with a number."""
    return Here(text, IN_TREND if holds else DIFFERS, note)


def not_compared(text: str, why: str) -> Here:
    """What the source's text does not give a number for. `text` begins with ours."""
    return Here(text, NOT_COMPARED, why)


def shown(value: float) -> str:
    """A number to four digits, without an exponent in the usual range."""
    value = float(value)
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def listed(values, digits: int = 3) -> str:
    """Numbers to so many digits, with commas between."""
    return ", ".join(f"{value:.{digits}g}" for value in values)
