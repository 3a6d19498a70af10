"""Reading of rig logs into datasets in SI units, with the rows that are no drilling dropped and counted."""

import io
import json
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.io.attributes import attribute_of, table_of, text_of
from vibrojax.io.riglog.columns import (
    BIT_DEPTH,
    DEPTH,
    KNOWN,
    LINE,
    RATE,
    ROTATION_SPEED,
    TIME,
    WEIGHT,
    Column,
    choose_columns,
    columns_lines,
)
from vibrojax.io.riglog.dialects import DATE, detect_dialect, dialect_named, recognise
from vibrojax.io.tables import Rows, column_numbers, is_number, read_table, read_text, rows_without_units
from vibrojax.models.physics.units import factor

NULLS = (-999.25, -999.0, -9999.0, -9999.25)
"""Numbers that stand for a missing value in every dialect."""

FASTEST = "500 ft/h"
"""Rate of penetration above which a row is no drilling; connections and slips leave rates of thousands of ft/h."""

SLOWEST_ROTATION = 2 * np.pi / 60
"""Rotary speed [rad/s] below which the string does not rotate: 1 rpm."""

OFF_BOTTOM = 0.5
"""Distance [m] of the bit from the hole's end above which it does not drill; depths are rounded to 0.3 m or less."""

_SAME = 0.05
"""Relative difference of the medians of two columns of one quantity above which one of their units is wrong."""

_MOST_LINES_LISTED = 12
_LONGEST_CLOCK = len("23:59:59.999")
_MEASUREMENTS = ("measurement", "no rows; add a line for each measurement", f"relief,{RATE}")


@dataclass(frozen=True)
class Log:
    """A rig log: `data` as `read_log` returns it, the names of all columns, and those that are taken for quantities."""

    place: Place
    line: int
    header: list[str]
    chosen: Mapping[str, Column]
    data: xr.Dataset


def read_log(
    path: str | PathLike[str],
    *,
    dialect: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    fastest: str = FASTEST,
    table: pd.DataFrame | None = None,
) -> xr.Dataset:
    """Read a rig log (CSV or LAS 2.0) as it is into a dataset in SI units along `row`.

    Rows that are no drilling are dropped, unless the dialect is "plain": no rate or weight, no rotation, a bit off the
    bottom, a rate beyond reason, or a depth that falls (the longest sequence of rows whose depth does not fall stays).

    **Arguments:**

    - `path`: the file.
    - `dialect`: a name of [vibrojax.io.riglog.dialects][]; by default it is detected by the names of the columns.
    - `columns`: by quantity, the column and its unit, or a value for all rows, such as {"bit_diameter": "8.5 in"}.
    - `units`: by quantity, the unit of a column that is recognised, in place of that of its name or its dialect.
    - `fastest`: the rate with its unit above which a row is dropped.
    - `table`: the table that `path` names, if it is not in a file.

    **Returns:** a dataset with `depth` [m], `time` [s] since the first row, `weight_on_bit` [N],
    `rate_of_penetration` [m/s], `rotary_speed` [rad/s], `torque` [N m], `flow` [m3/s], `pressure` [Pa],
    `bit_diameter` [m] and `stick_slip_index` (as given), where the file has them. Other columns are coordinates, as is
    `line`, the number of a row's line in the file. Attributes: `dialect`, `detected` (how), `columns` (JSON: source and
    unit of each quantity), `rows_read`, `dropped` (JSON: by reason, number of rows and their lines), `nulls` (JSON:
    missing values by quantity) and `notes`.

    **Raises:** `InputError` that names column and line.
    """
    return open_log(path, dialect=dialect, columns=columns, units=units, fastest=fastest, table=table).data


def open_log(
    path: str | PathLike[str],
    *,
    dialect: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    fastest: str = FASTEST,
    table: pd.DataFrame | None = None,
) -> Log:
    """Read a rig log as `read_log` does; return it with the names of all columns."""
    path = Path(path)
    place, given = Place(str(path)), None if dialect is None else dialect_named(dialect)
    limit = _limit(fastest)
    nulls = list(NULLS)
    if table is not None:
        text = (table.reset_index() if any(table.index.names) else table).to_csv(index=False)
    else:
        text = read_text(path)
    if text.lstrip().startswith("~") or path.suffix.lower() == ".las":
        line, header, rows, null = _read_las(place, text)
        nulls += [null] if null is not None else []
        spoken, why = dialect_named("las"), "it begins with a section of LAS"
    else:
        line, header, others = read_table(path, *_MEASUREMENTS, text=text)
        rows = rows_without_units(place, header, list(others))
        first = next(part for part in text.splitlines() if part.strip())
        spoken, why = detect_dialect(header, ";" if ";" in first and "," not in first else ",")
    spoken, why = (given, "as the user says") if given else (spoken, why)
    guess = partial(recognise, dialect=spoken)
    chosen, beside, notes = choose_columns(place.at(f"line {line}"), header, columns or {}, guess, units or {})
    lines = np.array([number for number, _ in rows])
    values: dict[str, Float[np.ndarray, " rows"]] = {}
    missing: dict[str, int] = {}
    for name, column in chosen.items():
        if column.index is None:
            values[name] = np.full(len(rows), np.nan if column.value is None else column.value)
        elif name == TIME:
            if (times := _times(place, header, column, rows)) is not None:
                values[name] = times
            else:
                notes.append(f"time: column {shown(column.header)} holds no times that are known, and is left out")
        else:
            values[name], missing[name] = _quantity(place, column, rows, nulls)
    for name, column in beside:
        _check_same(place, chosen[name], column, values[name], _quantity(place, column, rows, nulls)[0], name)
    cleaned = spoken.name != "plain"
    dropped = _dropped(values, limit) if cleaned else {}
    kept = ~np.any([np.zeros(len(rows), bool), *dropped.values()], axis=0)
    if cleaned and DEPTH in values:
        dropped["depth not monotonic"] = _not_monotonic(place, chosen[DEPTH], values[DEPTH], kept, lines)
        kept &= ~dropped["depth not monotonic"]
    counts = {reason: int(mask.sum()) for reason, mask in dropped.items() if mask.any()}
    if not kept.any():
        texts = ", ".join(f"{reason} {count}" for reason, count in counts.items())
        at = place.at(f"line {lines[0]} to {lines[-1]}, column {chosen[RATE].header if RATE in chosen else header[0]}")
        raise at.error(f"no row is left of {len(rows)}: {texts}")
    keep = np.flatnonzero(kept)
    variables: dict[str, Any] = {LINE: ("row", lines[keep], {"units": "1", "long_name": "line in the file"})}
    for name, numbers in values.items():
        variables[name] = ("row", numbers[keep], {"units": KNOWN[name].unit, "long_name": KNOWN[name].long_name})
    others_kept = [rows[index] for index in keep]
    taken = {column.index for column in chosen.values()}
    for index, name in enumerate(header):
        if index not in taken and name not in ("", "row", *variables):
            try:
                numbers, _ = column_numbers(place, name, index, others_kept, nulls)
                variables[name] = ("row", numbers)
            except InputError:
                variables[name] = ("row", np.array([row[index].strip() for _, row in others_kept]))
    attributes = {
        "title": path.name,
        "dialect": spoken.name,
        "detected": why,
        "columns": json.dumps({name: column.described() for name, column in chosen.items() if name in values}),
        "rows_read": len(rows),
        "dropped": json.dumps(
            {reason: {"rows": count, "lines": _ranges(lines[dropped[reason]])} for reason, count in counts.items()}
        ),
        "nulls": json.dumps({name: count for name, count in missing.items() if count}),
        "notes": "; ".join(notes),
    }
    data = xr.Dataset(variables, attrs=attributes)
    return Log(place, line, header, chosen, data.set_coords([name for name in variables if name not in KNOWN]))


def log_lines(data: xr.Dataset) -> list[str]:
    """Return lines of text: the dialect, the source and unit of each quantity, and what was dropped and why."""
    if text_of(data, "dialect", "plain") == "plain":
        return columns_lines(data)
    lines = [f"dialect {text_of(data, 'dialect')}: {text_of(data, 'detected')}", *columns_lines(data)]
    if dropped := table_of(data, "dropped"):
        total, read = sum(about["rows"] for about in dropped.values()), attribute_of(data, "rows_read")
        lines.append(f"dropped {total} of {counted(read, 'row')}:")
        lines += [f"  {reason}: {about['rows']} (line {about['lines']})" for reason, about in dropped.items()]
    return lines + [part for part in text_of(data, "notes").split("; ") if part]


def _limit(fastest: str) -> float:
    number, _, unit = str(fastest).strip().partition(" ")
    scale = factor(unit, "m s-1") if unit else None
    if not is_number(number) or scale is None or not 0 < float(number) * scale < np.inf:
        raise InputError(f"fastest: {shown(fastest)} is not a rate above 0 with its unit; write one, like {FASTEST}")
    return float(number) * scale


def _read_las(place: Place, text: str) -> tuple[int, list[str], Rows, float | None]:
    """Return the line of the section ~Curve, its names with units, the rows, and the number of a missing value."""
    try:
        import lasio
    except ImportError:
        raise place.error('LAS files need lasio, which is not installed; pip install "vibrojax[las]"') from None
    plain = text.splitlines()
    sections = {line[1:2].upper(): number for number, line in enumerate(plain, 1) if line.startswith("~")}
    for letter, name in (("V", "~Version"), ("C", "~Curve"), ("A", "~ASCII")):
        if letter not in sections:
            raise place.error(f"not LAS 2.0: it has no section {name}")
    try:
        las = lasio.read(io.StringIO("\n".join(plain)), ignore_data=True)
        version, wrap = float(las.version.VERS.value), str(las.version.WRAP.value).strip().upper()
    except Exception as error:  # lasio has no error of its own for a malformed header
        raise place.at(f"line {sections['V']}").error(f"not LAS 2.0: {error}") from None
    if version > 2 or wrap == "YES":
        fault = "its lines are wrapped (WRAP YES)" if wrap == "YES" else f"it is LAS {version:g}"
        raise place.at(f"line {sections['V']}").error(f"{fault}; write LAS 2.0 with one row on a line")
    header = [f"{c.original_mnemonic} ({c.unit})" if c.unit else str(c.original_mnemonic) for c in las.curves]
    rows = []
    for number in range(sections["A"] + 1, len(plain) + 1):
        cells = plain[number - 1].split()
        if not cells or cells[0].startswith("#"):
            continue
        if len(cells) != len(header):
            fault = f"has {len(cells)} cells; {len(header)} are needed, one a curve"
            raise place.at(f"line {number}, from {cells[0]}").error(fault)
        rows.append((number, cells))
    if not rows:
        raise place.at(f"line {sections['A']}").error("no rows below ~ASCII; add a line for each measurement")
    null = las.well["NULL"].value if "NULL" in las.well else None
    return sections["C"], header, rows, float(str(null)) if is_number(str(null)) else None


def _quantity(place: Place, column: Column, rows: Rows, nulls: list[float]) -> tuple[Float[np.ndarray, " rows"], int]:
    """Return a column in SI units, and its number of null cells; raise `InputError` for an infinite number."""
    values, count = column_numbers(place, column.header, column.index or 0, rows, nulls)
    if (infinite := np.isinf(values)).any():
        line, row = rows[int(np.argmax(infinite))]
        at = place.at(f"line {line}, column {column.header}")
        raise at.error(f"{shown(row[column.index or 0].strip())} is not finite; leave the cell empty")
    return column.factor * values, count


def _times(place: Place, header: list[str], column: Column, rows: Rows) -> Float[np.ndarray, " rows"] | None:
    """Return the times [s] since the first row: numbers, dates with times, or days and times in two columns.

    None if no cell is a time that is known. A few wrong cells raise `InputError`.
    """
    index = column.index or 0
    cells = [row[index].strip() for _, row in rows]
    date = next((k for k, cell in enumerate(header) if recognise_date(cell)), None)
    if date is None and all(is_number(cell) or not cell for cell in cells):
        values = column.factor * np.array([float(cell) if cell else np.nan for cell in cells])
        return values - values[np.isfinite(values)][:1].sum()
    if date is not None and date != index:
        cells = [f"{row[date].strip()} {cell}".replace("/", "-") for (_, row), cell in zip(rows, cells, strict=True)]
    clock = date is None and all(cell.count(":") == 2 and len(cell) <= _LONGEST_CLOCK for cell in cells)
    parse = pd.to_timedelta if clock else partial(pd.to_datetime, format="ISO8601", utc=True)
    stamps = parse(pd.Series(cells), errors="coerce")
    wrong = stamps.isna().to_numpy() & np.array([bool(cell.strip()) for cell in cells])
    if wrong.all():
        return None
    if wrong.any():
        position = int(np.argmax(wrong))
        at = place.at(f"line {rows[position][0]}, column {column.header}")
        raise at.error(f"{shown(cells[position])} is not a time; write one, like 2020-11-04 12:30:00")
    return (stamps - stamps.iloc[0]).dt.total_seconds().to_numpy(float)


def recognise_date(cell: str) -> bool:
    """Return whether a column holds the day of each row."""
    found = recognise(cell, dialect_named("pason"))
    return found is not None and found[0] == DATE


def _check_same(
    place: Place,
    first: Column,
    second: Column,
    values: Float[np.ndarray, " rows"],
    others: Float[np.ndarray, " rows"],
    name: str,
) -> None:
    """Check that two columns of one quantity agree, so that neither of their units is wrong."""
    both = np.isfinite(values) & np.isfinite(others) & (values > 0)
    if not both.any() or abs(float(np.median(others[both] / values[both])) - 1) <= _SAME:
        return
    ratio = float(np.median(others[both] / values[both]))
    fault = f"is {ratio:.4g} times column {shown(first.header)}, which should be the same {name}"
    raise place.at(f"line 1, column {second.header}").error(f"{fault}; choose one: --columns {name}=COLUMN")


def _dropped(values: Mapping[str, Float[np.ndarray, " rows"]], limit: float) -> dict[str, Bool[np.ndarray, " rows"]]:
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


def _not_monotonic(
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
        at = place.at(f"line {lines[rows[int(np.argmax(np.diff(depth[rows]) < 0)) + 1]]}, column {column.header}")
        raise at.error(f"the depth falls in most rows (only {len(ends)} of {rows.size} in order); sort them by depth")
    dropped, position = kept.copy(), last[-1] if last else -1
    while position >= 0:
        dropped[rows[position]] = False
        position = int(previous[position])
    return dropped


def _ranges(lines: Int[np.ndarray, " lines"]) -> str:
    """Return line numbers as text such as "3, 7-9", at most a dozen ranges."""
    parts = np.split(lines, np.flatnonzero(np.diff(lines) > 1) + 1)
    texts = [f"{part[0]}" if part.size == 1 else f"{part[0]}-{part[-1]}" for part in parts]
    more = f" and {len(texts) - _MOST_LINES_LISTED} ranges more" if len(texts) > _MOST_LINES_LISTED else ""
    return ", ".join(texts[:_MOST_LINES_LISTED]) + more
