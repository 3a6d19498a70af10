"""Rig data: a CSV file with a rate of penetration and a relief on each line."""

import csv
import io
from pathlib import Path

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, nearest, shown

RATE, RELIEF, FORCE, THRESHOLD = "rate_of_penetration", "relief", "mean_force", "threshold"
_ABOUT = {
    RATE: {"units": "m s-1", "long_name": "rate of penetration"},
    RELIEF: {"units": "1", "long_name": "mean force over threshold, P/D"},
}


def read_rig(path: Path) -> xr.Dataset:
    """The columns rate_of_penetration [m/s] and relief [1], or mean_force and threshold [N], along `point`.

    Further columns become coordinates, of numbers where all their cells are. A cell that is empty or nan is a lane
    without a value.

    **Raises:** `InputError` where it cannot be read, a column is missing, or a cell is not a number.
    """
    place = Place(str(path))
    (line, header), *rows = _rows(place, _text(path))
    header = [cell.strip() for cell in header]
    _check_header(place.at(f"line {line}"), header)
    needed = _needed(place.at(f"line {line}"), header)
    if not rows:
        raise place.error("no rows; add a line for each measurement below the column names")
    for line, row in rows:
        if len(row) != len(header):
            raise place.at(f"line {line}").error(f"has {len(row)} cells; {len(header)} are needed, one a column")
    columns = {name: _column(place, name, header.index(name), rows) for name in needed}
    if RELIEF not in columns:
        with np.errstate(divide="ignore", invalid="ignore"):
            columns[RELIEF] = columns[FORCE] / columns[THRESHOLD]
    variables = {name: ("point", columns[name], _ABOUT[name]) for name in (RATE, RELIEF)}
    further = dict.fromkeys(name for name in header if name not in ("", "point", RATE, RELIEF))
    coordinates = {name: ("point", _further(header.index(name), rows)) for name in further}
    number = ("point", np.arange(len(rows)), {"units": "1", "long_name": "number of the row"})
    return xr.Dataset(variables, {"point": number} | coordinates, {"title": path.name})


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of one that is there") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the path of a file") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def _rows(place: Place, text: str) -> list[tuple[int, list[str]]]:
    """The lines that hold something, each with its number."""
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


def _column(place: Place, name: str, index: int, rows: list[tuple[int, list[str]]]) -> np.ndarray:
    cells = [(line, row[index].strip()) for line, row in rows]
    return np.array([_number(place.at(f"line {line}, column {name}"), cell) for line, cell in cells])


def _further(index: int, rows: list[tuple[int, list[str]]]) -> np.ndarray:
    """A column that the law does not need: numbers where all cells are, else text."""
    cells = [row[index].strip() for _, row in rows]
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        return np.array(cells)


def _number(place: Place, cell: str) -> float:
    try:
        return float(cell) if cell else np.nan
    except ValueError:
        raise place.error(f"{shown(cell)} is not a number; write one, like 0.4, or leave it empty") from None
