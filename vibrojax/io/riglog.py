"""Reading of rig logs into datasets in SI units, with the rows that are no drilling dropped and counted."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.io.attributes import attribute_of, table_of, text_of
from vibrojax.io.log_columns import (
    DEPTH,
    KNOWN,
    LINE,
    RATE,
    TIME,
    Column,
    choose_columns,
    columns_lines,
    split_unit,
)
from vibrojax.io.log_dialects import DATE, detect_dialect, dialect_named, is_alias, recognise
from vibrojax.io.log_drilling import line_ranges, no_drilling, not_monotonic
from vibrojax.io.tables import (
    Rows,
    column_numbers,
    is_number,
    read_las,
    read_table,
    read_text,
    row_of_units,
    separator,
)
from vibrojax.physics.units import factor, is_unit

NULLS = (-999.25, -999.0, -9999.0, -9999.25)
"""Numbers that stand for a missing value in every dialect."""

FASTEST = "500 ft/h"
"""Rate of penetration above which a row is no drilling; connections and slips leave rates of thousands of ft/h."""

_SAME = 0.05
"""Relative difference of the medians of two columns of one quantity above which one of their units is wrong."""

LIMITS_OF_LOGS = (
    "Rotary rig data are not percussive data: they can inform the friction at the bit and C of the law, "
    "not the striker, the gap or the contact"
)
"""What summaries and pictures of a log say about it."""

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
    fastest: str | None = None,
    table: pd.DataFrame | None = None,
) -> xr.Dataset:
    """Read a rig log (CSV or LAS 2.0) as it is into a dataset in SI units along `row`.

    Rows that are no drilling are dropped, unless the dialect is "plain": no rate or weight, no rotation, a bit off the
    bottom, a rate beyond reason, or a depth that falls (the longest sequence of rows whose depth does not fall stays).

    **Arguments:**

    - `path`: the file.
    - `dialect`: a name of [vibrojax.io.log_dialects][]; by default it is detected by the names of the columns.
    - `columns`: by quantity, the column and its unit, or a value for all rows, such as {"bit_diameter": "8.5 in"}.
    - `units`: by quantity, the unit of a column that is recognised, in place of that of its name or its dialect.
    - `fastest`: the rate with its unit above which a row is dropped, by default 500 ft/h.
    - `table`: the table that `path` names, if it is not in a file.

    **Returns:** a dataset with `depth` [m], `time` [s] since the first row, `weight_on_bit` [N],
    `rate_of_penetration` [m/s], `rotary_speed` [rad/s], `torque` [N m], `flow` [m3/s], `pressure` [Pa],
    `bit_diameter` [m] and `stick_slip_index` (as given), where the file has them. Other columns are coordinates, as is
    `line`, the number of a row's line in the file. Attributes: `dialect`, `detected` (how), `columns` (JSON: source and
    unit of each quantity), `rows_read`, `dropped` (JSON: by reason, number of rows and their lines), `nulls` (JSON:
    missing values by quantity) and `notes`.

    **Raises:** `InputError` that names column and line.

    **Example:**

    >>> import pandas as pd
    >>> table = pd.DataFrame({"Depth (ft)": [5000, 5001, 5002], "WOB (klbs)": [20, -999.25, 25], "ROP (ft/h)": 60})
    >>> log = vj.read_log("export", table=table)
    >>> log.rate_of_penetration.values.round(5).tolist(), log.dropped
    ([0.00508, 0.00508], '{"missing weight": {"rows": 1, "lines": "3"}}')
    """
    return open_log(path, dialect=dialect, columns=columns, units=units, fastest=fastest, table=table).data


def open_log(
    path: str | PathLike[str],
    *,
    dialect: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    fastest: str | None = None,
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
        text = read_text(path, windows=True)
    notes = []
    if text.lstrip().startswith("~") or path.suffix.lower() == ".las":
        line, header, rows, null = read_las(place, text)
        nulls += [null] if null is not None else []
        spoken, why = dialect_named("las"), "it begins with a section of LAS"
    else:
        line, header, others = read_table(path, *_MEASUREMENTS, text=text)
        rows = list(others)
        if units_below := row_of_units(rows):
            header = [
                f"{name} ({unit})" if is_unit(unit) and (is_alias(name) or split_unit(name)[1] is None) else name
                for name, unit in zip(header, units_below, strict=True)
            ]
            notes.append(f"line {rows.pop(0)[0]} holds the units of the columns")
        if not rows:
            raise place.error(f"{_MEASUREMENTS[1]} below the units")
        spoken, why = detect_dialect(header, separator(text))
    spoken, why = (given, "as the user says") if given else (spoken, why)
    guess = partial(recognise, dialect=spoken)
    chosen, beside, left_out = choose_columns(place.at(f"line {line}"), header, columns or {}, guess, units or {})
    notes += left_out
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
        _check_same(
            place.at(f"line {line}"), chosen[name], column, values[name], _quantity(place, column, rows, nulls)[0], name
        )
    cleaned = spoken.name != "plain"
    dropped = no_drilling(values, limit) if cleaned else {}
    kept = ~np.any([np.zeros(len(rows), bool), *dropped.values()], axis=0)
    if cleaned and DEPTH in values:
        dropped["depth not monotonic"] = not_monotonic(place, chosen[DEPTH], values[DEPTH], kept, lines)
        kept &= ~dropped["depth not monotonic"]
    counts = {reason: int(mask.sum()) for reason, mask in dropped.items() if mask.any()}
    if not kept.any():
        texts = ", ".join(f"{reason} {count}" for reason, count in counts.items())
        here = place.at(
            f"line {lines[0]} to {lines[-1]}, column {chosen[RATE].header if RATE in chosen else header[0]}"
        )
        raise here.error(f"no row is left of {len(rows)}: {texts}")
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
            {reason: {"rows": count, "lines": line_ranges(lines[dropped[reason]])} for reason, count in counts.items()}
        ),
        "nulls": json.dumps({name: count for name, count in missing.items() if count}),
        "notes": "; ".join(notes),
    }
    data = xr.Dataset(variables, attrs=attributes)
    return Log(place, line, header, chosen, data.set_coords([name for name in variables if name not in KNOWN]))


def is_log(data: xr.Dataset) -> bool:
    """Return whether a dataset holds, or was made from, an exported log of a rig."""
    return text_of(data, "dialect", "plain") != "plain"


def log_lines(data: xr.Dataset) -> list[str]:
    """Return lines of text: the dialect, the source and unit of each quantity, and what was dropped and why."""
    if not is_log(data):
        return columns_lines(data)
    lines = [f"dialect {text_of(data, 'dialect')}: {text_of(data, 'detected')}", *columns_lines(data)]
    if dropped := table_of(data, "dropped"):
        total, read = sum(about["rows"] for about in dropped.values()), attribute_of(data, "rows_read")
        lines.append(f"dropped {total} of {counted(read, 'row')}:")
        lines += [f"  {reason}: {about['rows']} (line {about['lines']})" for reason, about in dropped.items()]
    return lines + [part for part in text_of(data, "notes").split("; ") if part]


def _limit(fastest: str | None) -> float:
    fastest = FASTEST if fastest is None else fastest
    number, _, unit = str(fastest).strip().partition(" ")
    scale = factor(unit, "m s-1") if unit else None
    if not is_number(number) or scale is None or not 0 < float(number) * scale < np.inf:
        raise InputError(f"fastest: {shown(fastest)} is not a rate above 0 with its unit; write one, like {FASTEST}")
    return float(number) * scale


def _quantity(place: Place, column: Column, rows: Rows, nulls: list[float]) -> tuple[Float[np.ndarray, " rows"], int]:
    """Return a column in SI units, and its number of null cells; raise `InputError` for an infinite number."""
    values, count = column_numbers(place, column.header, column.index or 0, rows, nulls)
    if (infinite := np.isinf(values)).any():
        line, row = rows[int(np.argmax(infinite))]
        here = place.at(f"line {line}, column {column.header}")
        raise here.error(f"{shown(row[column.index or 0].strip())} is not finite; leave the cell empty")
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
        here = place.at(f"line {rows[position][0]}, column {column.header}")
        raise here.error(f"{shown(cells[position])} is not a time; write one, like 2020-11-04 12:30:00")
    return (stamps - stamps.iloc[0]).dt.total_seconds().to_numpy(float)


def recognise_date(cell: str) -> bool:
    """Return whether a column holds the day of each row."""
    column = recognise(cell, dialect_named("pason"))
    return column is not None and column[0] == DATE


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
    raise Place(place.file, f"{place.key}, column {second.header}").error(
        f"{fault}; choose one: --columns {name}=COLUMN"
    )
