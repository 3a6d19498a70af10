"""A list of points instead of a grid: a CSV file, or columns."""

import csv
import io
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.models.physics.parameters import Parameter
from vibrojax.sweep.input.names import Names
from vibrojax.sweep.input.source import read_text
from vibrojax.sweep.input.values import as_table, quantity

_TEXTS = ("start", "rock")
"""Columns of names."""

VECTOR = "start_"
"""How columns begin that together give each point its start: `start_x1`, `start_v1`, ..."""

WhereFrom = Callable[[str, int], Place]
"""Where the cell of a column and an index stands."""


@dataclass(frozen=True)
class Points:
    """Columns of parameters and rocks, each (points,); and the start of each point, where the list has it: its name, or
    the states that it starts from, by the names of their columns."""

    columns: dict[str, np.ndarray]
    starts: list[str] | None
    vectors: dict[str, np.ndarray] | None


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
    lists = {name: column for name, column in columns.items() if isinstance(column, list)}
    lengths = {name: len(column) for name, column in lists.items()}
    first = next(iter(lengths))
    for name, length in lengths.items():
        if length != lengths[first]:
            raise place.at(name).error(f"has {length} values; {lengths[first]} are needed, as in {first}")
    for name in columns:
        _check_column(place.at(name), name, names)
    _check_vector(place.at, tuple(columns), names)
    return _points(lists, lambda name, index: place.at(name).item(index), names)


def _from_csv(path: Path, names: Names) -> Points:
    """Points from a CSV file with a line of column names."""
    place = Place(str(path))
    reader = csv.reader(io.StringIO(read_text(path), newline=""), skipinitialspace=True, strict=True)
    rows = ((reader.line_num, row) for row in reader if any(map(str.strip, row)))
    lines = array("q")  # of the file, one for each point

    def at(name: str, index: int) -> Place:
        return place.at(f"line {lines[index]}, column {name}")

    try:
        line, header = next(rows, (0, []))
        if not header:
            raise place.error("empty; a line of column names and a line for each point are needed")
        columns: dict[str, Any] = {
            name: [] if name in _TEXTS else array("d") for name in _header(place, line, header, names)
        }
        for line, row in rows:
            lines.append(line)
            if len(row) != len(columns):
                raise place.at(f"line {line}").error(f"has {len(row)} cells; {len(columns)} are needed, one a column")
            for (name, column), cell in zip(columns.items(), row, strict=True):
                column.append(intern(cell.strip()) if name in _TEXTS else _cell(at, name, cell))
    except csv.Error as error:
        raise place.at(f"line {reader.line_num}").error(f"not CSV: {error}") from None
    if not lines:
        raise place.error("no points; add a line for each below the column names")
    return _points(columns, at, names)


def _header(place: Place, line: int, header: list[str], names: Names) -> list[str]:
    """The names of the columns, checked; they stand in the file's `line`."""
    place, columns = place.at(f"line {line}"), [cell.strip() for cell in header]
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
    _check_vector(lambda name: Place(place.file, f"{place.key}, column {name}"), tuple(columns), names)
    return columns


def _check_column(place: Place, name: str, names: Names) -> None:
    if (name == "rock" and names.has_rock) or name in _vector(names):
        return
    if name.startswith(VECTOR) and names.starts:
        raise place.error(f"scene {shown(names.scene)} has no such state; a start is {', '.join(_vector(names))}")
    if name != "start":
        names.parameter(place, name)
    elif not names.starts:
        raise place.error(f"scene {shown(names.scene)} has no starts; leave the column out")


def _vector(names: Names) -> tuple[str, ...]:
    """The columns that together give a start."""
    return tuple(f"{VECTOR}{state}" for state in names.system.start_states)


def _check_vector(at: Callable[[str], Place], columns: Sequence[str], names: Names) -> None:
    """Raise where columns of a start's states are not all there, or stand beside a column of names; `at`: places."""
    wanted = _vector(names)
    given = [name for name in wanted if name in columns]
    missing = [name for name in wanted if name not in columns]
    if given and "start" in columns:
        raise at("start").error(f"{given[0]} gives the start as well; give names, or {', '.join(wanted)}")
    if given and missing:
        raise at(given[0]).error(f"{' and '.join(missing)} missing; a start is {', '.join(wanted)} together")


def _is_number(cell: str) -> bool:
    try:
        return float(cell) == float(cell)
    except ValueError:
        return False


def _cell(at: WhereFrom, name: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        problem = f"{shown(cell.strip())} is not a number" if cell.strip() else "empty"
        raise at(name, -1).error(f"{problem}; write one, like 0.4 or 50e6") from None


def _points(cells: Mapping[str, Sequence[Any]], at: WhereFrom, names: Names) -> Points:
    """The checked columns; `at(name, index)` is where a cell stands."""
    states = [name for name in cells if name in _vector(names)]
    vectors = {name: _states(cells[name], name, at) for name in states} or None
    numbers = (name for name in cells if name not in (*_TEXTS, *states))
    columns = {name: _numbers(cells[name], name, at, names) for name in numbers}
    if "rock" in cells:
        columns["rock"] = np.array([names.rock(at("rock", index), rock) for index, rock in enumerate(cells["rock"])])
    if "start" not in cells:
        return Points(columns, None, vectors)
    starts = [
        start if start in names.starts else names.named_start(at("start", index), start)
        for index, start in enumerate(cells["start"])
    ]
    return Points(columns, starts, None)


def _states(column: Sequence[Any], name: str, at: WhereFrom) -> np.ndarray:
    """A column of states that points start from, float64 (points,)."""
    free = Parameter(name, 0.0, "1", "state at t = 0", name)
    return np.array([quantity(at(name, index), value, free) for index, value in enumerate(column)])


def _numbers(column: Sequence[Any], name: str, at: WhereFrom, names: Names) -> np.ndarray:
    """A column of numbers that the parameter called `name` may have, float64 (points,)."""
    parameter = names.parameter(at(name, 0), name)
    if isinstance(column, array) or all(type(value) is float for value in column):
        values = np.array(column)
        # What is admissible is an interval: where both ends are in it, a million cells need no look one by one.
        if parameter.problem(values.min()) is None and parameter.problem(values.max()) is None:
            return values
    return np.array([names.quantity(at(name, index), name, value) for index, value in enumerate(column)])
