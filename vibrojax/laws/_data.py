"""The data of a fit: a dataset, the path of one, or rig data, a CSV file with a measurement on each line."""

import csv
import io
import json
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from jaxtyping import Float, Shaped

from vibrojax.errors import InputError, Place, nearest, shown
from vibrojax.input.source import read_text

if TYPE_CHECKING:
    Data = xr.Dataset | str | PathLike[str]
else:
    Data = object  # whatever a user gives is looked at by `open_data`, which refuses it in one line

RATE, RELIEF, FORCE, THRESHOLD = "rate_of_penetration", "relief", "mean_force", "threshold"
_ABOUT = {
    RATE: {"units": "m s-1", "long_name": "rate of penetration"},
    RELIEF: {"units": "1", "long_name": "mean force over threshold, P/D"},
}

Rows = list[tuple[int, list[str]]]
"""The lines of a CSV that hold something, each with its number."""


def open_data(data: Data, fit: str, tables: bool = False) -> tuple[Place, xr.Dataset]:
    """The dataset that a user gave, or the path of, with the place to name in messages (`fit` where it has no path).

    `tables`: whether a CSV will do.

    **Raises:** `InputError`.
    """
    if isinstance(data, xr.Dataset):
        return Place(fit), data
    if not isinstance(data, (str, PathLike)):
        raise InputError(f"{fit}: {shown(data)} is no data; give a dataset or a path")
    path = Path(data)
    place = Place(str(path))
    ending = path.suffix.lower()
    if tables and ending == ".csv":
        return place, read_rig(path)
    if ending != ".nc":
        wrong = "ends in neither .nc nor .csv" if tables else "does not end in .nc"
        raise place.error(f"{wrong}; give a sweep's dataset{' or a CSV file' if tables else ''}")
    from vibrojax.store.dataset import open_dataset

    return place, open_dataset(path)


def open_rates(data: Data, fit: str) -> tuple[Place, xr.Dataset]:
    """Data with a rate of penetration and a relief, and their place (see `open_data`).

    **Raises:** `InputError`.
    """
    place, dataset = open_data(data, fit, tables=True)
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
        fixed = json.loads(data.attrs.get("parameters", "{}"))
        if name not in fixed:
            raise place.at(name).error("is neither a coordinate of the data nor fixed in them; give it as a coordinate")
        values = xr.DataArray(fixed[name])
    if values.dtype.kind not in "fiu":
        raise place.at(name).error("does not hold numbers")
    return values


def read_rig(path: Path) -> xr.Dataset:
    """The columns rate_of_penetration [m/s] and relief [1], or mean_force and threshold [N], along `point`.

    Further columns become coordinates, of numbers where all their cells are. A cell that is empty or nan is a lane
    without a value.

    **Raises:** `InputError` where it cannot be read, a column is missing, or a cell is not a number.
    """
    place = Place(str(path))
    (line, header), *rows = _rows(place, read_text(path))
    header = [cell.strip() for cell in header]
    _check_header(place.at(f"line {line}"), header)
    needed = _needed(place.at(f"line {line}"), header)
    if not rows:
        raise place.error("no rows; add a line for each measurement below the column names")
    for line, row in rows:
        if len(row) != len(header):
            raise place.at(f"line {line}").error(f"has {len(row)} cells; {len(header)} are needed, one a column")
    columns = {name: _numbers(place, name, header.index(name), rows) for name in needed}
    if RELIEF not in columns:
        with np.errstate(divide="ignore", invalid="ignore"):
            columns[RELIEF] = columns[FORCE] / columns[THRESHOLD]
    variables = {name: ("point", columns[name], _ABOUT[name]) for name in (RATE, RELIEF)}
    further = dict.fromkeys(name for name in header if name not in ("", "point", RATE, RELIEF))
    coordinates = {name: ("point", _numbers_or_text(header.index(name), rows)) for name in further}
    number = ("point", np.arange(len(rows)), {"units": "1", "long_name": "number of the row"})
    return xr.Dataset(variables, {"point": number, **coordinates}, {"title": path.name})


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


def _needed(place: Place, header: list[str]) -> list[str]:
    """The names of the columns to read; relief goes before force and threshold."""
    names = [RATE, RELIEF] if RELIEF in header else [RATE, FORCE, THRESHOLD]
    missing = [name for name in names if name not in header]
    if RATE in missing:
        raise place.error(f"column {RATE} [m/s] is missing; {_meant(RATE, header)}")
    if len(missing) == 2:
        raise place.error(f"column {RELIEF} is missing, or {FORCE} and {THRESHOLD}; {_meant(RELIEF, header)}")
    if missing:
        raise place.error(f"column {missing[0]} [N] is missing, or {RELIEF}; {_meant(missing[0], header)}")
    for name in names:
        if header.count(name) > 1:
            raise place.error(f"column {name} is there {header.count(name)} times; give it once")
    return names


def _meant(name: str, header: list[str]) -> str:
    """What a column that is missing may be called in the file."""
    known = {RATE, RELIEF, FORCE, THRESHOLD}
    like = nearest(name, [column for column in header if column and column not in known])
    if like is None:
        return f"the file has {', '.join(column or 'a column without a name' for column in header)}"
    return f"rename {shown(like)} if that is it"


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
