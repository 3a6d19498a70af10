"""Rules that judge a result: each puts a computed value beside the source's and returns a `Here`.

The column `rule` of `results.csv` calls them with the source's numbers and a tolerance. Numbers of the source never
enter a computation.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, SupportsFloat

import numpy as np

Verdict = Literal["agrees", "agrees in trend", "differs", "cannot be compared"]
AGREES: Final = "agrees"
IN_TREND: Final = "agrees in trend"
DIFFERS: Final = "differs"
NOT_COMPARED: Final = "cannot be compared"
VERDICTS: tuple[Verdict, ...] = (DIFFERS, NOT_COMPARED, IN_TREND, AGREES)
"""In the order of the page: differences come first."""


@dataclass(frozen=True)
class Here:
    """The computed side of a result: a text that begins with the number in the source's unit, a verdict, a remark."""

    text: str
    verdict: Verdict
    note: str = ""


def verdict(agrees: object, trend: object = False) -> Here:
    """Judge by two conditions: full agreement, and agreement in trend."""
    return Here("", AGREES if agrees else IN_TREND if trend else DIFFERS)


def claim(holds: object) -> Here:
    """Judge a statement that can be counted or distinguished."""
    return verdict(holds)


def trend(holds: object) -> Here:
    """Judge a tendency for which the source gives no number."""
    return verdict(False, holds)


def not_compared() -> Here:
    """Show a value for which the source's text gives no number."""
    return Here("", NOT_COMPARED)


def number(
    value: SupportsFloat,
    source: SupportsFloat,
    unit: str,
    within: float,
    trend: object = False,
    provided: object = True,
) -> Here:
    """Judge a number: it agrees if the two differ by at most `within`, relative to the source's.

    `trend`: whether the source's conclusion from the number holds in any case. `provided`: a condition of agreement.
    """
    off = float(value) / float(source) - 1
    return _beside(value, source, unit, verdict(abs(off) <= within and provided, trend).verdict)


def printed(value: SupportsFloat, source: str, unit: str, trend: object = False) -> Here:
    """Judge a number that the source prints: agreement from half a unit of its last digit below to a unit above.

    The source cuts all moduli of Table 4.5 and ten rows of eq. 5.16 in Table 5.3 (R30), but it may also round.
    """
    digit = 10.0 ** -len(source.partition(".")[2])
    off = (float(value) - float(source)) / digit
    return _beside(value, float(source), unit, verdict(-0.5 <= off <= 1.0, trend).verdict)


def _beside(value: SupportsFloat, source: SupportsFloat, unit: str, judgement: Verdict) -> Here:
    """Return a number with its relative difference from the source's."""
    ratio = float(value) / float(source)
    off = ratio - 1
    difference = "±0.0%" if abs(off) < 5e-4 else f"{off:+.1%}" if off < 10 else f"{shown(ratio)} times"
    return Here(" ".join(part for part in (shown(value), unit, f"({difference})") if part), judgement)


def within_range(
    low: SupportsFloat, high: SupportsFloat, source: Sequence[SupportsFloat], unit: str, provided: object = True
) -> Here:
    """Judge a range: it agrees inside the source's, in trend if more than half of it is inside."""
    low, high = float(low), float(high)
    least, most = map(float, source)
    inside = least <= low and high <= most
    mostly = min(high, most) - max(low, least) > 0.5 * (high - low)
    text = f"{shown(low)} {unit}" if low == high else f"{shown(low)} to {shown(high)} {unit}"
    return Here(text, verdict(inside and provided, inside or mostly).verdict)


def column(values: np.ndarray, source: Sequence[float]) -> Here:
    """Judge a column of Table 5.3: all rows but the misprinted tenth agree within a unit of the last digit (R7)."""
    off = np.abs(values - source) > 0.1
    text = f"{values.min():.2f} to {values.max():.2f} rad/s, {np.sum(~off)} of {len(source)} rows within 0.1"
    rows = [row for row, is_off in enumerate(off) if is_off]
    remark = "; ".join(f"row {row + 1} is {values[row]:.2f} here, {source[row]} there" for row in rows)
    return Here(text, AGREES if set(rows) <= {9} else DIFFERS, remark)


def shown(value: SupportsFloat) -> str:
    """Format a number to four digits, without an exponent in the usual range."""
    value = float(value)
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def formatted(value: Any, specification: str = "") -> str:
    """Format a value as Python does; several numbers get commas between them and three digits by default."""
    if isinstance(value, str):
        return value
    values = np.asarray(value)
    if values.ndim:
        return ", ".join(format(item, specification or ".3g") for item in values)
    if not specification and np.issubdtype(values.dtype, np.floating):
        return shown(value)
    return format(values.item(), specification)


FIELD = re.compile(r"\{((?:[^{}\[:]|\[[^]]*\])+)(?::([^{}]*))?\}")
"""An expression in braces, with an optional format after a colon; a slice in brackets has colons of its own."""
