"""Reading of rig logs into tables in SI units, with the rows that are no drilling dropped and counted."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.io.attributes import attribute_of, table_of, text_of
from vibrojax.io.log_columns import (
    DATE,
    DEPTH,
    KNOWN,
    LAW,
    LINE,
    RELIEF,
    RIG,
    ROTATION_SPEED,
    TIME,
    WEIGHT,
    Column,
    checked_columns,
    choose_columns,
    in_unit_of_rigs,
    likely_words,
    recognise,
)
from vibrojax.io.log_files import NULLS, Cells, read_cells, to_numbers
from vibrojax.io.log_filters import LIMITS, Where, line_ranges, meets, no_drilling, not_monotonic, read_conditions
from vibrojax.io.tables import ambiguous_commas, decimal_mark, is_number
from vibrojax.physics.parameters import Parameter
from vibrojax.physics.units import UNITS

LIMITS_OF_LOGS = (
    "Rotary rig data are not percussive data: they can inform the friction at the bit and C of the law, "
    "not the striker, the gap or the contact"
)
"""What summaries and pictures of a log say about it."""

FOR_LAW = frozenset((*LAW, WEIGHT, ROTATION_SPEED))
"""Quantities that a fit of the law needs; faults in others do not stop it."""

LOG_ENDINGS = (".csv", ".txt", ".tsv", ".las", ".xml", ".xlsx", ".xlsm", ".xls")
"""Endings of the files that a fit takes for logs."""

_DAY = 86400.0
_MOST_LISTED = 10
_CLOCK = r"\d{1,2}:\d\d(:\d\d(\.\d*)?)?"
Source: TypeAlias = str | PathLike[str] | pd.DataFrame
Nulls = Sequence[str | float] | None
Values = dict[str, Float[np.ndarray, " rows"]]


@dataclass(frozen=True)
class Log:
    """A rig log: `data` as `read_log` returns it, the names of all columns, and those that are taken for quantities.

    `unusual`: place, quantity, median and advice of each column whose values are far from those of rigs in its unit.
    """

    place: Place
    line: int
    header: list[str]
    chosen: Mapping[str, Column]
    data: pd.DataFrame
    unusual: list[tuple[Place, Parameter, float, str]]


def read_log(
    path: Source, columns: Mapping[str, str] | None = None, where: Where = None, nulls: Nulls = None
) -> pd.DataFrame:
    """Read a rig log as it was exported (CSV, LAS, WITSML, xlsx) into a table in SI units.

    Rows that are no drilling are dropped and counted: no rate or weight, no rotation, a bit off the bottom, a value
    beyond reason, or a depth that falls (the longest sequence of rows whose depth does not fall stays). A table without
    a column of a rig, such as one with relief and rate_of_penetration, keeps all its rows.

    **Arguments:**

    - `path`: the file, or a DataFrame with the columns of such a file.
    - `columns`: by quantity, the column and its unit, or a value for all rows, such as {"bit_diameter": "8.5 in"}.
    - `where`: one or several conditions that rows must meet: "WOB (klb) < 35", "depth (m) >= 1200", "time (h) > 2",
      "Formation=shale". A condition on a quantity replaces its limit of reason.
    - `nulls`: further texts or numbers that stand for a missing value, beside -999.25, NULL, N/A, - and the like.

    **Returns:** a table with `depth` [m], `time` [s] since the first row, `weight_on_bit` [N], `rate_of_penetration`
    [m/s], `rotary_speed` [rad/s], `torque` [N m], `flow` [m3/s], `pressure` [Pa], `bit_diameter` [m] and
    `stick_slip_index` (as given), where the file has them; then `line`, the number of a row's line in the file, and the
    other columns. `attrs`: `units` and `sources` by quantity, `dropped` (number of rows by reason), `lines` (of them),
    `rows_read`, `notes`, `title`, and `rig` (whether it is the log of a rig).

    **Raises:** `InputError` that names column and line; all bad cells are listed at once.

    **Example:**

    >>> import pandas as pd
    >>> table = pd.DataFrame({"Depth (ft)": [5000, 5001, 5002], "WOB (klbs)": [20, -999.25, 25], "ROP (ft/h)": 60})
    >>> log = vj.read_log(table)
    >>> log.rate_of_penetration.round(5).tolist(), log.attrs["dropped"]
    ([0.00508, 0.00508], {'missing weight': 1})
    """
    return open_log(path, columns, where, nulls).data


def open_log(
    path: Source,
    columns: Mapping[str, str] | None = None,
    where: Where = None,
    nulls: Nulls = None,
    needed: Collection[str] | None = None,
    name: str = "read_log",
) -> Log:
    """Read a rig log as `read_log` does; return it with the names of all columns.

    `needed`: quantities in which a bad cell or an unlikely unit is an error, by default all; faults of others are only
    noted. `name`: what stands for the file in messages about a DataFrame.
    """
    columns, conditions = checked_columns(columns), read_conditions(where)
    if nulls is not None and (isinstance(nulls, str) or not isinstance(nulls, Sequence)):
        raise InputError(f'nulls: {shown(nulls)} is not a list; give one, like ["absent", -1]')
    if not isinstance(path, (str, PathLike, pd.DataFrame)):
        raise InputError(f"{name}: {shown(path)} is no log; give a path or a DataFrame")
    place = Place(name if isinstance(path, pd.DataFrame) else str(path))
    cells = _cells_of(place, path) if isinstance(path, pd.DataFrame) else read_cells(place, Path(path))
    header, rows, lines = cells.header, cells.rows, cells.rows.index.to_numpy()
    here = place.at(f"line {cells.line}")
    chosen, notes = choose_columns(here, header, columns)
    missing = NULLS | cells.nulls | {str(null).strip().casefold() for null in nulls or ()}
    text = {key: rows.iloc[:, column.index] for key, column in chosen.items() if column.index is not None}
    is_needed = {key: needed is None or key in needed or key in columns for key in chosen}
    mark = decimal_mark(text[key] for key in text if is_needed[key]) or decimal_mark(text.values())
    notes += ["commas are decimal marks"] * (mark == ",")
    values: Values = {}
    bad: dict[str, np.ndarray] = {}
    for key, column in chosen.items():
        if key == TIME and column.index is not None:
            values[key], bad[key] = _times(header, column, rows)
        elif column.index is not None:
            values[key], bad[key] = to_numbers(text[key], mark, missing)
        else:
            values[key] = np.full(len(rows), (column.value or 0.0) / column.factor)
    empty = np.all([np.isnan(values[key]) for key in text], axis=0) if text else np.zeros(len(rows), bool)
    empty &= empty.mean() < 0.5  # repeated names and remarks
    for key in [key for key in bad if not is_needed[key] or key == TIME]:
        if (wrong := bad.pop(key) & ~empty).any():
            fault = (
                f"{counted(wrong.sum(), 'cell')} taken as missing, such as {shown(text[key].iloc[np.argmax(wrong)])}"
            )
            notes.append(f"{key}: {fault} in line {lines[np.argmax(wrong)]}")
    _check_cells(place, {key: mask & ~empty for key, mask in bad.items()}, chosen, text, mark)
    unusual = _to_si(here, chosen, values, is_needed, notes)
    names = [(recognise(cell)[0] or "", cell) for cell in header]
    is_rig = RELIEF not in chosen and any(name in RIG or (name and not cell.startswith(name)) for name, cell in names)
    masks: list[tuple[str, np.ndarray]] = [("no numbers", empty)]
    free = set()
    everything = {cell: rows.iloc[:, index] for index, cell in enumerate(header)}
    for condition in conditions:
        quantity, mask = meets(place, condition, everything, chosen, values)
        masks.append((f"not {condition.text}", ~mask))
        free.add(quantity)
    if is_rig:
        masks += no_drilling(values, free)
    for key in sorted({"torque", "pressure"} & set(values) - free):
        if (large := values[key] > LIMITS[key]).any():
            values[key] = np.where(large, np.nan, values[key])
            limit = f"{LIMITS[key]:g} {UNITS[KNOWN[key].unit][0]}"
            notes.append(f"{key}: {counted(large.sum(), 'value')} above {limit} taken as missing")
    kept, dropped = np.ones(len(rows), bool), {}
    for reason, mask in masks:
        dropped[reason] = mask & kept
        kept &= ~mask
    if is_rig and DEPTH in values:
        dropped["depth not monotonic"] = not_monotonic(place, chosen[DEPTH], values[DEPTH], kept, lines)
        kept &= ~dropped["depth not monotonic"]
    dropped = {reason: mask for reason, mask in dropped.items() if mask.any()}
    if not kept.any():
        texts = ", ".join(f"{reason} {mask.sum()}" for reason, mask in dropped.items())
        hint = f"; is a unit wrong? {unusual[0][3]}" if unusual else ""
        raise place.at(f"line {lines[0]} to {lines[-1]}").error(f"no row is left of {len(rows)}: {texts}{hint}")
    table: dict[str, np.ndarray] = {key: numbers[kept] for key, numbers in values.items()} | {LINE: lines[kept]}
    taken = {column.index for column in chosen.values()}
    for index, cell in enumerate(header):
        if index not in taken and cell not in ("", "row", *table):
            found, wrong = to_numbers(rows.iloc[:, index], mark, missing)
            table[cell] = (
                rows.iloc[:, index].fillna("").str.strip().to_numpy(object)[kept] if wrong.any() else found[kept]
            )
    data = pd.DataFrame(table)
    data.attrs = {
        "title": Path(place.file).name,
        "rig": is_rig,
        "rows_read": len(rows),
        "units": {key: KNOWN[key].unit for key in values},
        "sources": {key: chosen[key].described() for key in values},
        "dropped": {reason: int(mask.sum()) for reason, mask in dropped.items()},
        "lines": {reason: line_ranges(lines[mask]) for reason, mask in dropped.items()},
        "notes": [*cells.notes, *notes],
    }
    return Log(place, cells.line, header, {key: chosen[key] for key in values}, data, unusual)


def to_dataset(log: pd.DataFrame, dim: str = "row") -> xr.Dataset:
    """Return a log as a dataset along `dim`: quantities as variables, other columns as coordinates.

    Its attributes are those of the table, as texts: `columns`, `dropped` (JSON), `rows_read`, `notes`, `title`, and
    `dialect` ("log" or "plain").
    """
    about = {name: {"units": KNOWN[name].unit, "long_name": KNOWN[name].long_name} for name in log.attrs["units"]}
    about[LINE] = {"units": "1", "long_name": "line in the file"}
    variables = {
        name: (
            dim,
            column.to_numpy() if column.dtype.kind in "fiu" else np.array(list(column), str),
            about.get(name, {}),
        )
        for name, column in log.items()
    }
    lines = log.attrs["lines"]
    attributes = {
        "title": log.attrs["title"],
        "dialect": "log" if log.attrs["rig"] else "plain",
        "columns": json.dumps(log.attrs["sources"]),
        "rows_read": log.attrs["rows_read"],
        "dropped": json.dumps({key: {"rows": n, "lines": lines[key]} for key, n in log.attrs["dropped"].items()}),
        "notes": "; ".join(log.attrs["notes"]),
    }
    return xr.Dataset(variables, attrs=attributes).set_coords([name for name in variables if name not in KNOWN])


def is_log(data: xr.Dataset) -> bool:
    """Return whether a dataset holds, or was made from, an exported log of a rig."""
    return text_of(data, "dialect", "plain") != "plain"


def log_lines(data: xr.Dataset) -> list[str]:
    """Return lines of text: the source and unit of each quantity, and what was dropped and why."""
    lines = []
    for name, source in table_of(data, "columns").items():
        written_in = source.get("unit", source.get("given_in"))
        unit = f", taken as {written_in}, since it names no unit" if source["assumed"] else f", in {written_in}"
        si = UNITS[KNOWN[name].unit][0] if name in KNOWN else ""
        value = f"{source['value']:g} {si} for all rows" if "value" in source else f"column {shown(source['column'])}"
        lines.append(f"{name}: {value}{unit if source['assumed'] or 'value' not in source else ''}")
    if dropped := table_of(data, "dropped"):
        total, read = sum(about["rows"] for about in dropped.values()), attribute_of(data, "rows_read")
        lines.append(f"dropped {total} of {counted(read, 'row')}:")
        lines += [f"  {reason}: {about['rows']} (line {about['lines']})" for reason, about in dropped.items()]
    return lines + [part for part in text_of(data, "notes").split("; ") if part]


def _cells_of(place: Place, table: pd.DataFrame) -> Cells:
    """Return the cells of a DataFrame; in one that `read_log` returned, the quantities are in SI units."""
    units = table.attrs["units"] if "sources" in table.attrs else {}
    table = table.reset_index() if any(table.index.names) else table
    lines = table[LINE] if units and LINE in table else range(2, len(table) + 2)
    table = table.drop(columns=LINE, errors="ignore") if units else table
    if table.empty:
        raise place.error("has no rows; give a row for each measurement")
    names = [f"{name} ({units[name]})" if name in units else str(name) for name in table.columns]
    rows = table.astype(object).where(table.notna(), "").map(str)
    return Cells(names, 1, rows.set_axis(range(len(names)), axis=1).set_axis(lines))


def _to_si(
    place: Place, chosen: dict[str, Column], values: Values, is_needed: Mapping[str, bool], notes: list[str]
) -> list[tuple[Place, Parameter, float, str]]:
    """Convert the values to SI units; return the columns with a given unit in which they are far from those of rigs.

    **Raises:** `InputError` with all columns whose unit is only assumed and unlikely; those not needed are left out.
    """
    unusual, faults, words = [], [], []
    for key, numbers in list(values.items()):
        known = np.abs(numbers[np.isfinite(numbers) & (numbers != 0)])
        median = float(np.median(known)) if known.size else np.nan
        chosen[key] = column = in_unit_of_rigs(key, chosen[key], median)
        values[key] = column.factor * numbers
        if not known.size or (word := likely_words(key, column, median)) is None:
            continue
        low, high = KNOWN[key].usual or (0.0, 0.0)
        fault = f"{key} {median:.6g} {column.unit} ({low:g} to {high:g} {UNITS[KNOWN[key].unit][0]})"
        if not column.assumed:
            here, advice = place.at(f"{column.header}, the median of its column"), f"likely --columns {word}"
            unusual.append((here, KNOWN[key], median * column.factor, advice))
        elif is_needed[key]:
            faults.append(fault)
            words.append(word)
        else:
            notes.append(f"{fault} is far outside what rigs have and left out: no unit is given; likely {word}")
            del values[key]
    if faults:
        fault = f"no unit is given, and the median is far outside what rigs have: {', '.join(faults)}"
        choice = " (choose one unit)" * any(" or " in word for word in words)
        raise place.error(f"{fault}; likely --columns {' '.join(words)}{choice}")
    return unusual


def _check_cells(
    place: Place, bad: Mapping[str, np.ndarray], chosen: Mapping[str, Column], text: Mapping[str, pd.Series], mark: str
) -> None:
    """Raise `InputError` that lists the first cells that are neither numbers nor stand for a missing value."""
    faults = sorted((int(row), key) for key, mask in bad.items() for row in np.flatnonzero(mask))
    if not faults:
        return
    cells = [(text[key].index[row], chosen[key].header, str(text[key].iloc[row]).strip()) for row, key in faults]
    listed = "; ".join(f"line {line}, column {header}: {shown(cell)}" for line, header, cell in cells[:_MOST_LISTED])
    right = (
        f"write a number, leave the cell empty, or say that it stands for a missing value: --nulls {shown(cells[0][2])}"
    )
    if "," in cells[0][2] and mark != ".":
        right = f"commas are ambiguous: {ambiguous_commas(mark)}; write decimal points"
    more = f"; and {len(faults) - _MOST_LISTED} more" if len(faults) > _MOST_LISTED else ""
    verb = "is not a number" if len(faults) == 1 else f"are not numbers ({len(faults)} cells)"
    raise place.error(f"{listed}{more} {verb}; {right}")


def _times(header: list[str], column: Column, rows: pd.DataFrame) -> tuple[Float[np.ndarray, " rows"], np.ndarray]:
    """Return the times since the first row in the column's unit, and where a cell is not a time.

    Cells hold numbers, dates with times, times of the day that may pass midnight, or days and times in two columns.
    """
    cells = rows.iloc[:, column.index or 0].fillna("").str.strip()
    date = next((k for k, cell in enumerate(header) if recognise(cell)[0] == DATE and k != column.index), None)
    empty = (cells == "").to_numpy()
    if date is None and all(is_number(cell) or not cell for cell in cells):
        values = np.array([float(cell) if cell else np.nan for cell in cells])
        return values - values[np.isfinite(values)][:1].sum(), np.zeros(len(rows), bool)
    if date is None and cells[~empty].str.fullmatch(_CLOCK).mean() > 0.5:
        clock = cells.where(cells.str.fullmatch(_CLOCK)).where(cells.str.count(":") != 1, cells + ":00")
        values = pd.to_timedelta(clock, errors="coerce").dt.total_seconds().to_numpy(float, copy=True)
        known = np.isfinite(values)
        values[known] += _DAY * np.cumsum(np.diff(values[known], prepend=values[known][:1]) < -_DAY / 2)
    else:
        day = rows.iloc[:, date].fillna("").str.strip() + " " if date is not None else ""
        stamps = pd.to_datetime((day + cells).str.replace("/", "-"), format="ISO8601", utc=True, errors="coerce")
        values = (stamps - stamps.min()).dt.total_seconds().to_numpy(float)
    seconds = (values - values[np.isfinite(values)][:1].sum()) / column.factor
    return seconds, np.isnan(values) & ~empty
