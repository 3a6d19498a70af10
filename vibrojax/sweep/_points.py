"""A list of points instead of a grid: a CSV file, or columns."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.sweep._names import Names
from vibrojax.sweep._numbers import as_table
from vibrojax.sweep._source import read_text

_TEXTS = ("start", "rock")
"""Columns of names."""


@dataclass(frozen=True)
class Points:
    """Columns of parameters and rocks, each (points,), and the name of each point's start where the list has it."""

    columns: dict[str, np.ndarray]
    starts: list[str] | None


def read_points(place: Place, value: object, folder: Path, names: Names) -> Points:
    """The points of a sweep: the path of a CSV file, seen from `folder`, or a table of columns."""
    if isinstance(value, str):
        return _from_csv(folder / value, names)
    columns = as_table(place, value)
    if not columns:
        raise place.error("no columns; name one like a parameter: beta = [0.3, 0.4]")
    for name, column in columns.items():
        if not isinstance(column, list) or not column:
            raise place.at(name).error(f"{shown(column)} is no column; write a list like [0.3, 0.4]")
    lengths = {name: len(column) for name, column in columns.items()}
    first = next(iter(lengths))
    for name, length in lengths.items():
        if length != lengths[first]:
            raise place.at(name).error(f"has {length} values; {lengths[first]} are needed, as in {first}")
    cells = {}
    for name, column in columns.items():
        _check_column(place.at(name), name, names)
        cells[name] = [(place.at(name).item(index), cell) for index, cell in enumerate(column)]
    return _points(cells, names)


def _from_csv(path: Path, names: Names) -> Points:
    """Points from a CSV file with a line of column names."""
    place = Place(str(path))
    reader = csv.reader(io.StringIO(read_text(path), newline=""), skipinitialspace=True, strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise place.at(f"line {reader.line_num}").error(f"not CSV: {error}") from None
    if not rows:
        raise place.error("empty; a line of column names and a line for each point are needed")
    line, header = rows[0]
    columns = _header(place.at(f"line {line}"), [cell.strip() for cell in header], names)
    if len(rows) == 1:
        raise place.error("no points; add a line for each below the column names")
    cells = {name: [] for name in columns}
    for line, row in rows[1:]:
        if len(row) != len(columns):
            raise place.at(f"line {line}").error(f"has {len(row)} cells; {len(columns)} are needed, one a column")
        for name, cell in zip(columns, row, strict=True):
            at = place.at(f"line {line}, column {name}")
            cells[name].append((at, cell.strip() if name in _TEXTS else _cell(at, cell.strip())))
    return _points(cells, names)


def _header(place: Place, columns: list[str], names: Names) -> list[str]:
    if len(columns) == 1 and any(mark in columns[0] for mark in ";\t"):
        raise place.error(f"{shown(columns[0])} is one column; separate them by commas")
    if all(_is_number(name) for name in columns):
        raise place.error(f"{shown(', '.join(columns))} are numbers; the first line names the columns, like beta,gamma")
    for position, name in enumerate(columns, 1):
        if not name:
            raise place.error(f"column {position} has no name; name it like a parameter")
        at = Place(place.file, f"{place.key}, column {name}")
        _check_column(at, name, names)
        if name in columns[: position - 1]:
            raise at.error("is there already; give each column once")
    return columns


def _check_column(place: Place, name: str, names: Names) -> None:
    if name == "rock" and names.has_rock:
        return
    if name != "start":
        names.parameter(place, name)
    elif not names.starts:
        raise place.error(f"scene {shown(names.scene)} has no starts; leave the column out")


def _is_number(cell: str) -> bool:
    try:
        return float(cell) == float(cell)
    except ValueError:
        return False


def _cell(place: Place, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        problem = f"{shown(cell)} is not a number" if cell else "empty"
        raise place.error(f"{problem}; write one, like 0.4 or 50e6") from None


def _points(cells: dict[str, list[tuple[Place, object]]], names: Names) -> Points:
    """The checked columns of (place, cell)."""
    columns = {
        name: np.array([names.quantity(place, name, cell) for place, cell in column])
        for name, column in cells.items()
        if name not in _TEXTS
    }
    if "rock" in cells:
        columns["rock"] = np.array([names.rock(place, cell) for place, cell in cells["rock"]])
    starts = [names.start(place, cell, vectors=False) for place, cell in cells["start"]] if "start" in cells else None
    return Points(columns, starts)
