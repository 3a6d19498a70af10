"""The data of a fit: a dataset, the path of one, or rig data, a CSV file with a measurement on each line."""

import csv
import io
import json
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Shaped

from vibrojax.analyses.rop_law.columns import FORCE, KNOWN, RATE, RELIEF, THRESHOLD, Column, choose, needed, split_unit
from vibrojax.errors import InputError, Place, shell_assignment, shown
from vibrojax.io.attributes import parameters_of
from vibrojax.models.physics.units import is_unit, likely_units
from vibrojax.sweep.input.plausible import warn_if_far
from vibrojax.sweep.input.source import read_text

if TYPE_CHECKING:
    Data = xr.Dataset | str | PathLike[str]
    Columns = Mapping[str, str] | None
else:
    Data = Columns = object  # whatever a user gives is looked at by `open_data`, which refuses it in one line

_ABOUT = {
    RATE: {"units": "m s-1", "long_name": "rate of penetration"},
    RELIEF: {"units": "1", "long_name": "mean force over threshold, P/D"},
}

Rows = list[tuple[int, list[str]]]
"""The lines of a CSV that hold something, each with its number."""


def open_data(data: Data, fit: str, tables: bool = False, columns: Columns = None) -> tuple[Place, xr.Dataset]:
    """The dataset that a user gave, or the path of, with the place to name in messages (`fit` where it has no path).

    `tables`: whether a CSV will do; `columns`: which of its columns are what, see `read_rig`.

    **Raises:** `InputError`.
    """
    if columns and (isinstance(data, xr.Dataset) or str(data).lower().endswith(".nc")):
        raise Place(fit if isinstance(data, xr.Dataset) else str(data)).error(
            "has its names and units already; columns are said of a CSV"
        )
    if isinstance(data, xr.Dataset):
        return Place(fit), data
    if not isinstance(data, (str, PathLike)):
        raise InputError(f"{fit}: {shown(data)} is no data; give a dataset or a path")
    path = Path(data)
    place = Place(str(path))
    ending = path.suffix.lower()
    if tables and ending == ".csv":
        return place, read_rig(path, columns)
    if ending != ".nc":
        wrong = "ends in neither .nc nor .csv" if tables else "does not end in .nc"
        raise place.error(f"{wrong}; give a sweep's dataset{' or a CSV file' if tables else ''}")
    from vibrojax.io.dataset import open_dataset

    return place, open_dataset(path)


def open_rates(data: Data, fit: str, columns: Columns = None) -> tuple[Place, xr.Dataset]:
    """Data with a rate of penetration and a relief, and their place (see `open_data`).

    **Raises:** `InputError`.
    """
    place, dataset = open_data(data, fit, tables=True, columns=columns)
    for variable in (RATE, RELIEF):
        if variable not in dataset:
            names = ", ".join(str(name) for name in dataset.data_vars) or "nothing"
            raise place.at(variable).error(f"missing; a sweep of a scene with rock has it, this holds {names}")
        if dataset[variable].dtype.kind not in "fiu":
            raise place.at(variable).error("does not hold numbers; the data of a sweep are needed")
    return place, dataset


def parameter(place: Place, data: xr.Dataset, name: str) -> xr.DataArray:
    """A parameter's values: a coordinate of a sweep, or what is fixed in it.

    **Raises:** `InputError` where it is neither, or no numbers.
    """
    if name in data.coords:
        values = data[name]
    else:
        fixed = parameters_of(data)
        if name not in fixed:
            raise place.at(name).error("is neither a coordinate of the data nor fixed in them; give it as a coordinate")
        values = xr.DataArray(fixed[name])
    if values.dtype.kind not in "fiu":
        raise place.at(name).error("does not hold numbers")
    return values


def read_rig(path: Path, columns: Columns = None) -> xr.Dataset:
    """The columns rate_of_penetration [m/s] and relief [1], or mean_force and threshold [N], along `point`.

    Further columns become coordinates, of numbers where all their cells are. A cell that is empty or nan is a lane
    without a value. The attribute `columns` says what was taken for what, and in which unit.

    **Arguments:** `columns`: by our name the file's column with its unit, see [vibrojax.analyses.rop_law.columns][].

    **Raises:** `InputError` where it cannot be read, a column is missing, or a cell is not a number.
    """
    place, columns = Place(str(path)), _said(columns)
    (line, header), *rows = _rows(place, read_text(path))
    header = [cell.strip() for cell in header]
    _check_header(place.at(f"line {line}"), header)
    chosen = choose(place.at(f"line {line}"), header, columns)
    names = needed(place.at(f"line {line}"), header, chosen, columns)
    if not rows:
        raise place.error("no rows; add a line for each measurement below the column names")
    _check_rows(place, header, rows)
    values = {name: _in_si(place, column, rows) for name, column in chosen.items()}
    for name in names:
        _warn_of_unit(place, name, chosen[name], values[name])
    if RELIEF not in names:
        with np.errstate(divide="ignore", invalid="ignore"):
            values[RELIEF] = values[FORCE] / values[THRESHOLD]
    variables = {name: ("point", values.pop(name), _ABOUT[name]) for name in (RATE, RELIEF)}
    coordinates: dict[str, Any] = {name: ("point", x, _about(name)) for name, x in values.items()}
    taken = {column.index for column in chosen.values()}
    for index, name in enumerate(header):
        if index not in taken and name not in ("", "point", RATE, RELIEF) and name not in coordinates:
            coordinates[name] = ("point", _numbers_or_text(index, rows))
    number = ("point", np.arange(len(rows)), {"units": "1", "long_name": "number of the row"})
    attributes = {
        "title": path.name,
        "columns": json.dumps({name: column.described() for name, column in chosen.items()}),
    }
    return xr.Dataset(variables, {"point": number, **coordinates}, attributes)


def _said(columns: Columns) -> Mapping[str, str]:
    if columns is not None and not isinstance(columns, Mapping):
        raise InputError(f'columns: {shown(columns)} names no columns; give a dict like {{"{RATE}": "ROP (m/h)"}}')
    for name, text in (columns or {}).items():
        if not isinstance(text, str) or not text.strip():
            example = f'{name}="ROP (m/h)"'
            raise Place("columns", str(name)).error(
                f"{shown(text)} is no column; write one with its unit, like {example}"
            )
    return columns or {}


def _check_rows(place: Place, header: list[str], rows: Rows) -> None:
    for line, row in rows:
        if len(row) != len(header):
            raise place.at(f"line {line}").error(f"has {len(row)} cells; {len(header)} are needed, one a column")
    line, first = rows[0]
    cells = [cell.strip(" []()") for cell in first if cell.strip()]
    if any(is_unit(cell) for cell in cells) and not any(_is_number(cell) for cell in cells):
        like = f"{header[0]} ({cells[0]})"
        raise place.at(f"line {line}").error(f"holds units; write them behind the names, like {like}, and leave it out")


def _about(name: str) -> dict[str, str]:
    parameter = KNOWN[name]
    return {"units": parameter.unit, "long_name": parameter.long_name}


def _in_si(place: Place, column: Column, rows: Rows) -> Float[np.ndarray, " rows"]:
    """A column's values, in SI."""
    if column.index is None:
        return np.full(len(rows), np.nan if column.value is None else column.value)
    return column.factor * _numbers(place, column.header, column.index, rows)


def _warn_of_unit(place: Place, name: str, column: Column, values: Float[np.ndarray, " rows"]) -> None:
    """Warn where a column as a whole is far from the usual values, as one in another unit is."""
    known = np.abs(values[np.isfinite(values) & (values != 0)])
    if not known.size:
        return
    median, parameter = float(np.median(known)), KNOWN[name]
    units = likely_units(median / column.factor, parameter.unit, parameter.usual or (0.0, 0.0))[:3]
    unit = units[0] if units else "UNIT"
    right = f"{column.header} {unit}" if column.index is None else f"{split_unit(column.header)[0]} ({unit})"
    say = f"--columns {shell_assignment(name, right)}"
    likely = f"it is likely in {' or '.join(units)}; say which, like {say}" if units else f"say its unit by {say}"
    warn_if_far(place.at(f"{column.header}, the median of its column"), parameter, median, likely)


def _rows(place: Place, text: str) -> Rows:
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise place.at(f"line {reader.line_num}").error(f"not CSV: {error}") from None
    if not rows:
        raise place.error("empty; a line of column names and a line for each measurement are needed")
    return rows


def _check_header(place: Place, header: list[str]) -> None:
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        raise place.error(f"{shown(header[0])} is one column; separate them by commas")
    if all(_is_number(name) for name in header):
        example = f"{RELIEF},{RATE}"
        raise place.error(f"{shown(', '.join(header))} are numbers; the first line names the columns, like {example}")


def _is_number(cell: str) -> bool:
    try:
        return float(cell) == float(cell)
    except ValueError:
        return False


def _numbers(place: Place, name: str, index: int, rows: Rows) -> Float[np.ndarray, " rows"]:
    """A column that the law needs."""
    values = np.full(len(rows), np.nan)
    for position, (line, row) in enumerate(rows):
        if cell := row[index].strip():
            try:
                values[position] = float(cell)
            except ValueError:
                fault = f"{shown(cell)} is not a number; write one, like 0.4, or leave it empty"
                raise place.at(f"line {line}, column {name}").error(fault) from None
    return values


def _numbers_or_text(index: int, rows: Rows) -> Shaped[np.ndarray, " rows"]:
    """A column that the law does not need: numbers where all cells are, else text."""
    cells = [row[index].strip() for _, row in rows]
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        return np.array(cells)
