"""Rig logs as tables in SI units, of the rows that a user's conditions choose and that are drilling."""

import json
import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import InputError, Place, counted, shown, suggestion
from vibrojax.io import log_columns as known
from vibrojax.io import tables
from vibrojax.io.attributes import attribute_of, table_of, text_of
from vibrojax.io.log_columns import DEPTH, KNOWN, LINE, RATE, ROTATION_SPEED, TIME, WEIGHT, Column
from vibrojax.physics.units import UNITS, factor, is_unit

# Numbers and texts in small letters that stand for a missing value in every file, as an empty cell does.
NULLS = {"-999.25", "-999", "-9999", "-9999.25", "null", "(null)", "none", "nan", "na", "n/a", "#n/a", "-", "--"}

LIMITS_OF_LOGS = (
    "Rotary rig data are not percussive data: they can inform the friction at the bit and C of the law, "
    "not the striker, the gap or the contact"
)
"""What summaries and pictures of a log say about it."""

RPM = 2 * np.pi / 60  # rad/s; a string that rotates more slowly stands
OFF_BOTTOM = 0.5  # m from the hole's end, above which the bit does not drill; depths are rounded to 0.3 m or less
_LISTED = 8  # columns that a note lists

LIMITS = {RATE: 500 * 0.3048 / 3600, WEIGHT: 800e3, ROTATION_SPEED: 500 * RPM, "torque": 200e3, "pressure": 150e6}
"""Greatest values [SI] within reason: 500 ft/h, 180 klbf, 500 rpm. Connections, slips and faults leave larger ones."""

_DAY = 86400.0
_CLOCK = r"\d{1,2}:\d\d:\d\d(\.\d*)?|([01]?\d|2[0-3]):\d\d"  # two numbers above 23:59 are minutes and seconds

Source: TypeAlias = str | PathLike[str] | pd.DataFrame
Where: TypeAlias = str | Sequence[str] | Mapping[str, object] | None
Nulls: TypeAlias = Sequence[str | float] | None
Rows: TypeAlias = Float[np.ndarray, " rows"]
Mask: TypeAlias = Bool[np.ndarray, " rows"]


def read_log(
    path: Source,
    columns: Mapping[str, str] | None = None,
    where: Where = None,
    nulls: Nulls = None,
    needed: Collection[str] = tuple(KNOWN),
) -> pd.DataFrame:
    """Read a rig log as it was exported (CSV, LAS, WITSML, xlsx) into a table in SI units.

    Rows without drilling are dropped, and counted by reason. If the file is not the log of a rig, but for example a
    table of relief and rate_of_penetration, all rows are kept.

    **Arguments:**

    - `path`: the file, or a DataFrame with the columns of such a file.
    - `columns`: for each quantity, its column and unit, or a value for all rows, such as {"bit_diameter": "8.5 in"}.
    - `where`: one or several conditions that rows must meet: "WOB (klb) < 35", "depth (m) >= 1200", "time (h) > 2",
      "Formation=shale". A condition on a quantity replaces the default limit above which values of this quantity count
      as missing.
    - `nulls`: further texts or numbers that mark a missing value, in addition to -999.25, NULL, N/A, - and similar
      ones.
    - `needed`: quantities for which a bad cell or an unlikely unit is an error; for other quantities, `notes` lists
      such faults.

    **Returns:** a table with `depth` [m], `time` [s] since the first row, `weight_on_bit` [N], `rate_of_penetration`
    [m/s], `rotary_speed` [rad/s], `torque` [N m], `flow` [m3/s], `pressure` [Pa], `bit_diameter` [m] and
    `stick_slip_index` (as given), if the file has these quantities; `line`, the line number of each row in the file;
    and all other columns of the file. The attributes `attrs` of the table are:

    - `units`, `sources`: unit and source of each quantity.
    - `rows_read`: number of rows in the file, dropped rows included. `dropped`, `lines`: number and line numbers of
      dropped rows, by reason.
    - `rig`: True if the file is the log of a rig.
    - `unusual`: name, quantity, median [SI] and advice for each column with an unlikely unit.
    - `notes`, `title`.

    **Raises:** `InputError`, which lists all bad cells with column and line.

    **Example:**

    >>> import pandas as pd
    >>> table = pd.DataFrame({"Depth (ft)": [5000, 5001, 5002], "WOB (klbs)": [20, -999.25, 25], "ROP (ft/h)": 60})
    >>> log = vj.read_log(table)
    >>> log.rate_of_penetration.round(5).tolist(), log.attrs["dropped"]
    ([0.00508, 0.00508], {'missing weight': 1})
    """
    columns, conditions = known.checked_columns(columns), read_conditions(where)
    if nulls is not None and (isinstance(nulls, str) or not isinstance(nulls, Sequence)):
        raise InputError(f'nulls: {shown(nulls)} is not a list; give one, like ["absent", -1]')
    if not isinstance(path, (str, PathLike, pd.DataFrame)):
        raise InputError(f"read_log: {shown(path)} is no log; give a path or a DataFrame")
    place = Place("DataFrame" if isinstance(path, pd.DataFrame) else str(path))
    cells = tables.read_cells(place, path if isinstance(path, pd.DataFrame) else Path(path))
    header, lines = list(map(str, cells.columns)), cells.index.to_numpy()
    chosen, notes = known.choose_columns(place.at(f"line {cells.attrs['line']}"), header, columns)
    notes = [*cells.attrs["notes"], *notes]
    missing = NULLS | cells.attrs["nulls"] | {str(null).strip().casefold() for null in nulls or ()}
    names = [(known.recognise(cell)[0] or "", cell) for cell in header]
    is_rig = known.RELIEF not in chosen and any(
        name in known.RIG or (name and not cell.startswith(name)) for name, cell in names
    )
    read = {column.index for column in chosen.values()}
    needed = {key for key in chosen if key in needed or key in columns}
    table, unusual = _quantities(place, cells, chosen, missing, needed, notes)
    unread = [cell for k, (name, cell) in enumerate(names) if k not in read and not name and cell not in ("", "row")]
    if is_rig and unread:
        more = f" and {counted(len(unread) - _LISTED, 'other')}" if len(unread) > _LISTED else ""
        notes.append(f"columns without a known name, which --columns can give: {', '.join(unread[:_LISTED])}{more}")
    data = pd.DataFrame(table)
    limits, masks = dict(LIMITS), dict[str, Mask]()
    for condition in conditions:
        judged, key, mask = _meets(place, condition, data, chosen)
        notes += [f"{judged.text}: in {judged.unit}, as the column"] * (judged != condition)
        masks[f"not {judged.text}"], limits[key] = ~mask, np.inf
    for key in {"pressure", "torque"} & set(chosen):
        if (large := data[key] > limits[key]).any():
            data[key] = data[key].mask(large)
            limit = f"{limits[key]:g} {UNITS[KNOWN[key].unit][0]}"
            notes.append(f"{key}: {counted(large.sum(), 'value')} above {limit} taken as missing")
    masks |= _no_drilling(data, limits) if is_rig else {}
    kept = ~np.any([np.zeros(len(data), bool), *masks.values()], axis=0)
    if is_rig and DEPTH in data:
        masks["depth not monotonic"] = _not_monotonic(place, chosen[DEPTH], data[DEPTH].to_numpy(), kept, lines)
    of_rows = pd.DataFrame(masks, index=range(len(data)))
    kept, first = ~of_rows.any(axis=1).to_numpy(bool), of_rows.cumsum(axis=1).eq(1) & of_rows
    dropped = {reason: lines[mask] for reason, mask in first.items() if mask.any()}  # a row counts for the first reason
    if not kept.any():
        texts = ", ".join(f"{name} ({counted(part.size, 'row')})" for name, part in dropped.items())
        hint = f"; is a unit wrong? {unusual[0][3]}" if unusual else ""
        raise place.at(f"line {lines[0]} to {lines[-1]}").error(f"no row is left of {len(cells)}: {texts}{hint}")
    data = data[kept].reset_index(drop=True)
    data.attrs = {
        "title": Path(place.file).name,
        "rig": is_rig,
        "rows_read": len(cells),
        "units": {key: KNOWN[key].unit for key in chosen},
        "sources": {key: column.described() for key, column in chosen.items()},
        "dropped": {name: part.size for name, part in dropped.items()},
        "lines": {name: tables.line_ranges(part) for name, part in dropped.items()},
        "notes": notes,
        "unusual": unusual,
    }
    return data


def _quantities(
    place: Place, cells: pd.DataFrame, chosen: dict[str, Column], missing: set[str], needed: set[str], notes: list[str]
) -> tuple[dict[str, np.ndarray], list[tuple[str, str, float, str]]]:
    """Return the columns of a log, quantities in SI; and name, quantity, median and advice of those far from rigs.

    **Raises:** `InputError` with all cells of needed quantities that are not numbers, or all needed columns whose unit
    is only assumed and unlikely. Other quantities with such a unit are left out.
    """
    own = {column.index for column in chosen.values()}
    texts = {key: cells.iloc[:, column.index] for key, column in chosen.items() if column.index is not None}
    texts = {key: text.mask(text.str.casefold().isin(missing), "") for key, text in texts.items()}
    mark = tables.decimal_mark(texts[key] for key in texts if key in needed)
    mark = mark or tables.decimal_mark(column for _, column in cells.items())
    notes += ["commas are decimal marks"] * (mark == ",")
    table, unusual, faults, likely = dict[str, np.ndarray](), [], list[tuple[int, str, str]](), dict[str, str]()
    for key, column in list(chosen.items()):
        values = np.full(len(cells), (column.value or 0.0) / column.factor)
        if key in texts:
            values, wrong = tables.to_numbers(texts[key], mark, missing)
            if key == TIME:
                chosen[key] = column = replace(column, assumed=column.assumed and not wrong.any())
                values, wrong = _times(column, cells, texts[key], values, wrong)
            bad = texts[key][wrong]
            if key in needed and key != TIME:
                faults += [(int(line), column.header, value) for line, value in bad.items()]
            elif len(bad):
                fault = f"{counted(len(bad), 'cell')} taken as missing"
                notes.append(f"{key}: {fault}, such as {shown(bad.iloc[0])} in line {bad.index[0]}")
        numbers = np.abs(values[np.isfinite(values) & (values != 0)])
        median = float(np.median(numbers)) if numbers.size else np.nan
        low, high = KNOWN[key].usual or (0.0, np.inf)
        if key == ROTATION_SPEED and column.assumed and known.split_unit(column.header)[0] != key:
            for unit, scale in {"rev/s": 60 * RPM, "rpm": RPM}.items():  # the last that fits
                if low <= median * scale <= high:
                    chosen[key] = column = replace(column, unit=unit, factor=scale)
        table[key] = column.factor * values
        if (word := known.likely_words(key, column, median, LIMITS.get(key, np.inf))) is None:
            continue
        fault = f"{key} {median:.6g} {column.unit} ({low:g} to {high:g} {UNITS[KNOWN[key].unit][0]})"
        if not column.assumed:
            unusual.append((column.header, key, median * column.factor, f"likely --columns {word}"))
        elif key in needed:
            likely[fault] = word
        else:
            notes.append(f"{fault} is far outside what rigs have and left out, as no unit is given (likely {word})")
            del table[key], chosen[key]
    if faults:
        faults.sort()
        listed = tables.listed_faults([f"line {line}, column {name}: {shown(value)}" for line, name, value in faults])
        (_, name, value), unit = faults[0], known.number_of(faults[0][2])[1]
        texts_of_nulls = " ".join(map(shown, dict.fromkeys(value for *_, value in faults[: tables.MOST_LISTED])))
        right = f"correct them, or say that they stand for missing values: --nulls {texts_of_nulls}"
        if "," in value and not mark:
            right = tables.AMBIGUOUS_COMMAS
        elif unit and is_unit(unit):
            right = f"write the unit into the name of the column, like {name} ({unit}), above numbers only"
        raise place.error(f"{listed}; {counted(len(faults), 'cell is not a number', 'cells are not numbers')}; {right}")
    if likely:
        fault = f"no unit is given, and the median is far outside what rigs have: {', '.join(likely)}"
        choice = " (choose one unit)" * any(" or " in word for word in likely.values())
        raise place.error(f"{fault}; likely --columns {' '.join(likely.values())}{choice}")
    table[LINE] = cells.index.to_numpy()
    for k, name in enumerate(map(str, cells.columns)):
        if k not in own and name not in ("", "row", *table):
            numbers, wrong = tables.to_numbers(cells.iloc[:, k], mark, missing)
            table[name] = cells.iloc[:, k].to_numpy(object) if wrong.any() else numbers
    return table, unusual


def _times(about: Column, cells: pd.DataFrame, text: pd.Series, numbers: Rows, wrong: Mask) -> tuple[Rows, Mask]:
    """Return the times since the first row in the column's unit, and where a cell is not a time.

    The `text` holds `numbers` (except where `wrong`), dates with times, times of the day that may pass midnight, or
    times beside a column of days.
    """
    dates = [k for k, name in enumerate(cells) if known.recognise(str(name))[0] == known.DATE and k != about.index]
    days, empty = cells.iloc[:, dates[0]] if dates else None, (text == "").to_numpy()
    stamps = text if days is None else days + " " + text
    stamps = pd.to_datetime(stamps.str.replace("/", "-"), format="ISO8601", utc=True, errors="coerce")
    if days is None and not wrong.any():
        values = about.factor * numbers
    elif not stamps.notna().any() and text[~empty].str.fullmatch(_CLOCK).mean() > 0.5:
        clock = text.where(text.str.fullmatch(_CLOCK)).where(text.str.count(":") != 1, text + ":00")
        elapsed = pd.to_timedelta(clock, errors="coerce").dt.total_seconds()
        turns = (elapsed.ffill().diff() < -_DAY / 2).cumsum()
        values = (elapsed + _DAY * turns).to_numpy()
    else:
        values = (stamps - stamps.min()).dt.total_seconds().to_numpy(float)
    return (values - values[np.isfinite(values)][:1].sum()) / about.factor, np.isnan(values) & ~empty


# Rows


_same = partial(np.isclose, rtol=1e-4, atol=0.0)  # about as many digits as a picture prints
_COMPARE: dict[str, Callable[[Any, Any], Any]] = {"<=": np.less_equal, ">=": np.greater_equal, "==": _same}
_COMPARE |= {"!=": lambda x, y: ~_same(x, y), "=": _same, "<": np.less, ">": np.greater}
_CONDITION = re.compile(rf"\s*([^<>=!]+?)\s*(?:[(\[]([^()\[\]<>=!]+)[)\]]\s*)?({'|'.join(_COMPARE)})\s*([^<>=!]+?)\s*")


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
        return np.asarray(_COMPARE[self.operator](values, value), bool)


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


def _meets(
    place: Place, condition: Condition, data: pd.DataFrame, chosen: Mapping[str, Column]
) -> tuple[Condition, str, Mask]:
    """Return a condition with its unit, the column of `data` that it is on, and where it holds.

    **Raises:** `InputError` if there is no such column, the value does not suit it, or no cell has a text.
    """
    here, headers = place.at(f"where {condition.text}"), {name: column.header for name, column in chosen.items()}
    spellings = [(str(name), str(name)) for name in data]
    spellings += [(text, name) for name, cell in headers.items() for text in (cell, known.split_unit(cell)[0])]
    names = {known.normalised(text): name for text, name in spellings}
    key = names.get(known.normalised(condition.name), known.recognise(condition.name)[0])
    if key not in chosen and condition.unit:  # of another column, the unit is a part of its name
        key = names.get(known.normalised(f"{condition.name} {condition.unit}"))
    if key is None or key not in data:
        hint = suggestion(condition.name, [*headers, *headers.values(), *map(str, data)])
        raise here.error(f"the file has no column {shown(condition.name)}; {hint}")
    value, unit = known.number_of(condition.value)
    if key in chosen:
        own = "" if unit or chosen[key].unit == "1" else chosen[key].unit
        condition = replace(condition, unit=condition.unit or own or None)
        units = [text for text in (condition.unit, unit) if text] or ["1"]
        scales = [factor(text, KNOWN[key].unit) for text in units]
        if value is None or None in scales:
            right = ", ".join(UNITS[KNOWN[key].unit])
            raise here.error(f"{shown(condition.value)} does not suit {key}; write a number with a unit of {right}")
        if len({*scales}) > 1:
            raise here.error(f"the unit is {' and '.join(units)}; give one of them")
        return condition, key, condition.holds(data[key], value * (scales[0] or 1.0))
    if value is not None and not unit and data[key].dtype.kind in "fi":
        return condition, key, condition.holds(data[key], value)
    if condition.operator not in ("=", "==", "!="):
        raise here.error(f"{shown(condition.value)}: texts are only compared by = or !=")
    texts = data[key].astype(str)
    is_equal = (texts == condition.value).to_numpy(bool)
    if condition.operator != "!=" and not is_equal.any():
        values = texts.unique().tolist()
        more = f" and {len(values) - _LISTED} more" * (len(values) > _LISTED)
        fault = f"no row of column {key} is {shown(condition.value)}"
        raise here.error(f"{fault}; it has {', '.join(values[:_LISTED])}{more}")
    return condition, key, is_equal ^ (condition.operator == "!=")


def _no_drilling(data: pd.DataFrame, limits: Mapping[str, float]) -> dict[str, Mask]:
    """Return masks of the rows that are no drilling, by reason; `limits`: greatest values within reason."""
    of = data.reindex(columns=[RATE, WEIGHT, ROTATION_SPEED, DEPTH, known.BIT_DEPTH])
    rate, weight, speed, depth, bit = of.to_numpy(float).T
    tests = [
        (RATE, "missing rate", np.isnan(rate)),
        (WEIGHT, "missing weight", ~(weight > 0)),
        (ROTATION_SPEED, "no rotation", ~(speed >= RPM)),
        (DEPTH, "missing depth", np.isnan(depth)),
        (known.BIT_DEPTH, "off bottom", bit < depth - OFF_BOTTOM),
    ]
    for name, word, x in ((RATE, "rate", rate), (WEIGHT, "weight", weight), (ROTATION_SPEED, "rotation", speed)):
        tests.append((name, f"{word} beyond reason", (x < 0) | (x > limits[name])))
    return {reason: mask for name, reason, mask in tests if name in data}


def _not_monotonic(place: Place, column: Column, depth: Rows, kept: Mask, lines: np.ndarray) -> Mask:
    """Return a mask of the `kept` rows outside the longest sequence whose depth does not fall.

    **Raises:** `InputError` if that sequence holds less than half of the rows.
    """
    rows, dropped = np.flatnonzero(kept), kept.copy()
    ends: list[float] = []  # least end of a sequence of each length (patience sorting)
    lengths = []  # of the longest sequence that ends at a row
    for value in depth[rows].tolist():
        lengths.append(bisect_right(ends, value))
        ends[lengths[-1] : lengths[-1] + 1] = [value]
    if 2 * len(ends) < rows.size:
        here = place.at(f"line {lines[rows[int(np.argmax(np.diff(depth[rows]) < 0)) + 1]]}, column {column.header}")
        raise here.error(f"the depth falls in most rows (only {len(ends)} of {rows.size} in order); sort them by depth")
    wanted, greatest = len(ends) - 1, np.inf
    for row, length in zip(rows[::-1].tolist(), lengths[::-1], strict=True):
        if length == wanted and depth[row] <= greatest:
            dropped[row], wanted, greatest = False, wanted - 1, depth[row]
    return dropped


# Datasets


def to_dataset(log: pd.DataFrame, dim: str = "row") -> xr.Dataset:
    """Return a log as a dataset along `dim`: quantities as variables, other columns as coordinates.

    Its attributes are the attributes of the table, as texts: `columns`, `dropped` (JSON), `rows_read`, `notes`,
    `title`, and `dialect` ("log" or "plain").
    """
    columns = {name: x.to_numpy() if x.dtype.kind in "fiu" else np.array(list(x), str) for name, x in log.items()}
    data = xr.Dataset({name: (dim, x) for name, x in columns.items()})
    for name in log.attrs["units"]:
        data[name].attrs = {"units": KNOWN[name].unit, "long_name": KNOWN[name].long_name}
    data[LINE].attrs = {"units": "1", "long_name": "line in the file"}
    dropped = {name: {"rows": n, "lines": log.attrs["lines"][name]} for name, n in log.attrs["dropped"].items()}
    data.attrs = {
        "title": log.attrs["title"],
        "dialect": "log" if log.attrs["rig"] else "plain",
        "columns": json.dumps(log.attrs["sources"]),
        "rows_read": log.attrs["rows_read"],
        "dropped": json.dumps(dropped),
        "notes": "; ".join(log.attrs["notes"]),
    }
    return data.set_coords([name for name in data if name not in KNOWN])


def is_log(data: xr.Dataset) -> bool:
    """Return whether a dataset holds, or was made from, an exported log of a rig."""
    return text_of(data, "dialect", "plain") != "plain"


def log_lines(data: xr.Dataset) -> list[str]:
    """Return lines of text: the source and unit of each quantity, and what was dropped and why."""
    lines = []
    for name, source in table_of(data, "columns").items():
        si = UNITS[KNOWN[name].unit][0] if name in KNOWN else ""
        value = f"{source['value']:g} {si} for all rows" if "value" in source else f"column {shown(source['column'])}"
        unit = "" if "value" in source else f", in {source['unit']}"
        lines.append(f"{name}: {value}{unit}{', since no unit is given' * source['assumed']}")
    if dropped := table_of(data, "dropped"):
        total, read = sum(about["rows"] for about in dropped.values()), attribute_of(data, "rows_read")
        lines.append(f"dropped {total} of {counted(read, 'row')}:")
        lines += [f"  {reason}: {about['rows']} (line {about['lines']})" for reason, about in dropped.items()]
    return lines + [part for part in text_of(data, "notes").split("; ") if part]
