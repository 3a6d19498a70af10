"""Rules that judge a result: each compares a computed value with the source's value and returns a `Here`.

The column `rule` of `results.csv` calls the rules with the source's numbers and a tolerance. The source's numbers never
enter a computation. "R7" and the like name readings of the source: documented interpretations of ambiguous passages.
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
"""All outcomes of a comparison with the source, in the order of the HTML page: differences come first."""


@dataclass(frozen=True)
class Here:
    """The computed side of a result.

    `text` begins with the computed number in the source's unit; `verdict` is the outcome of the comparison with the
    source; `note` is a remark.
    """

    text: str
    verdict: Verdict
    note: str = ""


def verdict(agrees: object, trend: object = False) -> Here:
    """Return a judgement by two conditions: `agrees` for full agreement, `trend` for agreement in trend."""
    return Here("", AGREES if agrees else IN_TREND if trend else DIFFERS)


def claim(holds: object) -> Here:
    """Judge a statement that is either true or false, such as a count or a distinction."""
    return verdict(holds)


def trend(holds: object) -> Here:
    """Judge a trend that the source describes without a number."""
    return verdict(False, holds)


def not_compared() -> Here:
    """Return the judgement of a value that cannot be compared, because the source's text states no number."""
    return Here("", NOT_COMPARED)


def number(
    value: SupportsFloat,
    source: SupportsFloat,
    unit: str,
    within: float,
    trend: object = False,
    provided: object = True,
) -> Here:
    """Judge a number: it agrees if its relative difference from the source's number is at most `within`.

    `provided`: further condition of agreement. `trend`: whether the source's conclusion from the number holds, even if
    the number differs.
    """
    off = float(value) / float(source) - 1
    return _beside(value, source, unit, verdict(abs(off) <= within and provided, trend).verdict)


def printed(value: SupportsFloat, source: str, unit: str, trend: object = False) -> Here:
    """Judge a number as printed in the source, given as the string `source`.

    It agrees between half a unit of the last printed digit below and one unit above, since the source may round or
    truncate. It truncates all moduli of Table 4.5, and ten rows of eq. 5.16 in Table 5.3 (R30).
    """
    digit = 10.0 ** -len(source.partition(".")[2])
    off = (float(value) - float(source)) / digit
    return _beside(value, float(source), unit, verdict(-0.5 <= off <= 1.0, trend).verdict)


def _beside(value: SupportsFloat, source: SupportsFloat, unit: str, judgement: Verdict) -> Here:
    """Return a judgement whose text is the number, its unit, and its relative difference from the source's number."""
    ratio = float(value) / float(source)
    off = ratio - 1
    difference = "±0.0%" if abs(off) < 5e-4 else f"{off:+.1%}" if off < 10 else f"{shown(ratio)} times"
    return Here(" ".join(part for part in (shown(value), unit, f"({difference})") if part), judgement)


def within_range(
    low: SupportsFloat, high: SupportsFloat, source: Sequence[SupportsFloat], unit: str, provided: object = True
) -> Here:
    """Judge a range: it agrees if it is inside the source's range, and in trend if more than half of it is inside.

    `provided`: further condition of agreement.
    """
    low, high = float(low), float(high)
    least, most = map(float, source)
    inside = least <= low and high <= most
    mostly = min(high, most) - max(low, least) > 0.5 * (high - low)
    text = f"{shown(low)} {unit}" if low == high else f"{shown(low)} to {shown(high)} {unit}"
    return Here(text, verdict(inside and provided, inside or mostly).verdict)


def column(values: np.ndarray, source: Sequence[float]) -> Here:
    """Judge a column of Table 5.3: it agrees if all rows except the misprinted tenth (R7) differ by at most 0.1."""
    off = np.abs(values - source) > 0.1
    text = f"{values.min():.2f} to {values.max():.2f} rad/s, {np.sum(~off)} of {len(source)} rows agree within 0.1"
    rows = [row for row, is_off in enumerate(off) if is_off]
    remark = "; ".join(f"row {row + 1} is {values[row]:.2f} here, {source[row]} there" for row in rows)
    return Here(text, AGREES if set(rows) <= {9} else DIFFERS, remark)


def shown(value: SupportsFloat) -> str:
    """Format a number with four significant digits, or, if very small or large, with three digits and an exponent."""
    value = float(value)
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def formatted(value: Any, specification: str = "") -> str:
    """Format a value with a Python format specification.

    An array is formatted as numbers separated by commas, with three digits by default. A string is returned unchanged.
    """
    if isinstance(value, str):
        return value
    values = np.asarray(value)
    if values.ndim:
        return ", ".join(format(item, specification or ".3g") for item in values)
    if not specification and np.issubdtype(values.dtype, np.floating):
        return shown(value)
    return format(values.item(), specification)


FIELD = re.compile(r"\{((?:[^{}\[:]|\[[^]]*\])+)(?::([^{}]*))?\}")
"""An expression in braces with an optional format after a colon; colons inside brackets belong to the expression."""
