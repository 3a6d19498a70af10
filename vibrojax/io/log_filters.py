"""Rows of a rig log that do not count: those that a user's conditions exclude, and those that are no drilling."""

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.io.log_columns import (
    BIT_DEPTH,
    DEPTH,
    KNOWN,
    NUMBER,
    RATE,
    ROTATION_SPEED,
    WEIGHT,
    Column,
    normalised,
    recognise,
    split_unit,
)
from vibrojax.io.log_files import to_numbers
from vibrojax.physics.units import UNITS, factor

Rows = Float[np.ndarray, " rows"]
Mask = Bool[np.ndarray, " rows"]
Where = str | Sequence[str] | Mapping[str, object] | None

RPM = 2 * np.pi / 60
SLOWEST_ROTATION = 1 * RPM
"""Rotary speed [rad/s] below which the string does not rotate."""

OFF_BOTTOM = 0.5
"""Distance [m] of the bit from the hole's end above which it does not drill; depths are rounded to 0.3 m or less."""

LIMITS = {RATE: 500 * 0.3048 / 3600, WEIGHT: 800e3, ROTATION_SPEED: 500 * RPM, "torque": 200e3, "pressure": 150e6}
"""Greatest values [SI] within reason: 500 ft/h, 180 klbf, 500 rpm. Connections, slips and faults leave larger ones."""

_MOST_LINES_LISTED = 12
_same = partial(np.isclose, rtol=1e-4, atol=0.0)  # about as many digits as a picture prints
_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "<=": np.less_equal,
    ">=": np.greater_equal,
    "!=": lambda x, y: ~_same(x, y),
    "==": _same,
    "=": _same,
    "<": np.less,
    ">": np.greater,
}
_CONDITION = re.compile(
    rf"\s*([^<>=!]+?)\s*(?:[(\[]([^()\[\]<>=!]+)[)\]]\s*)?({'|'.join(_OPERATORS)})\s*([^<>=!]+?)\s*"
)


@dataclass(frozen=True)
class Condition:
    """A comparison of a column or an axis with a value: `name`, `unit` (None if not given), `operator`, `value`."""

    name: str
    unit: str | None
    operator: str
    value: str

    @property
    def text(self) -> str:
        return f"{self.name}{f' ({self.unit})' if self.unit else ''} {self.operator} {self.value}"

    def holds(self, values: Any, value: float) -> Mask:
        return np.asarray(_OPERATORS[self.operator](values, value), bool)


def read_conditions(where: Where) -> list[Condition]:
    """Return conditions such as `"WOB (klb) < 35"` or `"Formation=shale"`; raise `InputError` for other texts."""
    if isinstance(where, Mapping):
        where = [f"{name}={value}" for name, value in where.items()]
    conditions = []
    for word in [where] if isinstance(where, str) else where or ():
        if (parts := _CONDITION.fullmatch(str(word))) is None:
            raise InputError(f'where: {shown(word)} is no condition; write one, like "WOB (klb) < 35" or delta=0.005')
        conditions.append(Condition(*parts.groups()))
    return conditions


def meets(
    place: Place,
    condition: Condition,
    columns: Mapping[str, pd.Series],
    chosen: Mapping[str, Column],
    values: Mapping[str, Rows],
) -> tuple[str | None, Mask]:
    """Return the quantity that a condition is on, None for another one of the `columns`, and where it holds.

    **Raises:** `InputError` if there is no such column, or the value does not suit it.
    """
    here, name = place.at(f"where {condition.text}"), normalised(condition.name)
    number, unit = NUMBER.fullmatch(condition.value), condition.unit
    headers = {key: chosen[key].header for key in values}
    names = {normalised(t): key for key, cell in headers.items() for t in (cell, split_unit(cell)[0], key)}
    key = names.get(name, recognise(condition.name)[0])
    if key in values and key is not None:
        unit = unit or (number[2] if number else None)
        scale = factor(unit, KNOWN[key].unit) if unit else chosen[key].factor
        if number is None or scale is None:
            units = ", ".join(UNITS[KNOWN[key].unit])
            raise here.error(f"{shown(condition.value)} does not suit {key}; write a number with a unit of {units}")
        return key, condition.holds(values[key], float(number[1]) * scale)
    column = next((cells for header, cells in columns.items() if normalised(header) == name), None)
    if column is None:
        hint = suggestion(condition.name, [*values, *filter(None, columns)])
        raise here.error(f"the file has no column {shown(condition.name)}; {hint}")
    found, wrong = to_numbers(column, ".", frozenset())
    if number is not None and not number[2] and not wrong.any():
        return None, condition.holds(found, float(number[1]))
    if condition.operator not in ("=", "==", "!="):
        raise here.error("texts are only compared by = or !=")
    equal = (column.fillna("").str.strip() == condition.value).to_numpy(bool)
    return None, ~equal if condition.operator == "!=" else equal


def no_drilling(values: Mapping[str, Rows], free: Collection[str | None] = ()) -> list[tuple[str, Mask]]:
    """Return masks of the rows that are no drilling, by reason; `free`: quantities without a limit of reason."""
    tests = []
    if RATE in values:
        tests.append(("missing rate", np.isnan(values[RATE])))
    if WEIGHT in values:
        tests.append(("missing weight", ~(values[WEIGHT] > 0)))
    if ROTATION_SPEED in values:
        tests.append(("no rotation", ~(values[ROTATION_SPEED] >= SLOWEST_ROTATION)))
    for name, word in ((RATE, "rate"), (WEIGHT, "weight"), (ROTATION_SPEED, "rotation")):
        if name in values:
            limit = np.inf if name in free else LIMITS[name]
            tests.append((f"{word} beyond reason", (values[name] < 0) | (values[name] > limit)))
    if DEPTH in values:
        tests.append(("missing depth", np.isnan(values[DEPTH])))
        if BIT_DEPTH in values:
            tests.append(("off bottom", values[BIT_DEPTH] < values[DEPTH] - OFF_BOTTOM))
    return tests


def not_monotonic(place: Place, column: Column, depth: Rows, kept: Mask, lines: Int[np.ndarray, " rows"]) -> Mask:
    """Return a mask of the `kept` rows outside the longest sequence whose depth does not fall.

    **Raises:** `InputError` if that sequence holds less than half of the rows.
    """
    rows = np.flatnonzero(kept)
    ends: list[float] = []  # least end of a sequence of each length (patience sorting)
    last: list[int] = []
    previous = np.full(rows.size, -1)
    for position, value in enumerate(depth[rows].tolist()):
        length = bisect_right(ends, value)
        previous[position] = last[length - 1] if length else -1
        ends[length : length + 1] = [value]
        last[length : length + 1] = [position]
    if 2 * len(ends) < rows.size:
        here = place.at(f"line {lines[rows[int(np.argmax(np.diff(depth[rows]) < 0)) + 1]]}, column {column.header}")
        raise here.error(f"the depth falls in most rows (only {len(ends)} of {rows.size} in order); sort them by depth")
    dropped, position = kept.copy(), last[-1] if last else -1
    while position >= 0:
        dropped[rows[position]] = False
        position = int(previous[position])
    return dropped


def line_ranges(lines: Int[np.ndarray, " lines"]) -> str:
    """Return line numbers as text such as "3, 7-9", at most a dozen ranges."""
    parts = np.split(lines, np.flatnonzero(np.diff(lines) > 1) + 1)
    texts = [f"{part[0]}" if part.size == 1 else f"{part[0]}-{part[-1]}" for part in parts]
    more = f" and {len(texts) - _MOST_LINES_LISTED} ranges more" if len(texts) > _MOST_LINES_LISTED else ""
    return ", ".join(texts[:_MOST_LINES_LISTED]) + more
