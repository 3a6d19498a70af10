"""Rows of a rig log that are no drilling: nothing weighs, turns or moves, or the numbers cannot be true."""

from bisect import bisect_right
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.errors import Place
from vibrojax.io.log_columns import BIT_DEPTH, DEPTH, RATE, ROTATION_SPEED, WEIGHT, Column

SLOWEST_ROTATION = 2 * np.pi / 60
"""Rotary speed [rad/s] below which the string does not rotate: 1 rpm."""

OFF_BOTTOM = 0.5
"""Distance [m] of the bit from the hole's end above which it does not drill; depths are rounded to 0.3 m or less."""

_MOST_LINES_LISTED = 12


def no_drilling(values: Mapping[str, Float[np.ndarray, " rows"]], limit: float) -> dict[str, Bool[np.ndarray, " rows"]]:
    """Return a mask of the rows that are dropped by reason; a row counts for the first reason that applies to it."""
    nothing = np.zeros(len(next(iter(values.values()), np.zeros(0))), bool)
    tests: dict[str, Bool[np.ndarray, " rows"]] = {}
    if RATE in values:
        tests["missing rate"] = np.isnan(values[RATE])
    if WEIGHT in values:
        tests["missing weight"] = ~(values[WEIGHT] > 0)
    if ROTATION_SPEED in values:
        tests["no rotation"] = ~(values[ROTATION_SPEED] >= SLOWEST_ROTATION)
    if RATE in values:
        tests["rate beyond reason"] = (values[RATE] < 0) | (values[RATE] > limit)
    if DEPTH in values:
        tests["missing depth"] = np.isnan(values[DEPTH])
        if BIT_DEPTH in values:
            tests["off bottom"] = values[BIT_DEPTH] < values[DEPTH] - OFF_BOTTOM
    masks, before = {}, nothing
    for reason, mask in tests.items():
        masks[reason] = mask & ~before
        before = before | mask
    return masks


def not_monotonic(
    place: Place,
    column: Column,
    depth: Float[np.ndarray, " rows"],
    kept: Bool[np.ndarray, " rows"],
    lines: Int[np.ndarray, " rows"],
) -> Bool[np.ndarray, " rows"]:
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
