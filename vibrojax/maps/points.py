"""A list of points in place of a grid, from a CSV file or a table of columns."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.io.tables import read_table
from vibrojax.settings.names import Names
from vibrojax.settings.values import STATE, as_table, quantity

VECTOR = "start_"
"""Prefix of the columns that together define the initial states of each point: `start_x1`, `start_v1`, ..."""

CellPlace = Callable[[str, int], Place]
"""Function that returns the place of a cell from its column and index."""


@dataclass(frozen=True)
class Points:
    """A list of points, each column (points,).

    - `columns`: parameters and rocks by name.
    - `starts`: names of the initial conditions, if specified.
    - `vectors`: initial states by column name, if specified.
    """

    columns: dict[str, np.ndarray]
    starts: list[str] | None
    vectors: dict[str, np.ndarray] | None


def read_points(place: Place, value: object, folder: Path, names: Names) -> Points:
    """Read the points of a sweep from a CSV file, whose path is relative to `folder`, or from a table of columns."""
    if isinstance(value, str):
        return _from_csv(folder / value, names)
    columns = as_table(place, value)
    if not columns:
        raise place.error("no columns; name one like a parameter: beta = [0.3, 0.4]")
    lists: dict[str, list[Any]] = {}
    for name, column in columns.items():
        if not isinstance(column, list) or not column:
            raise place.at(name).error(f"{shown(column)} is not a column; write a list like [0.3, 0.4]")
        lists[name] = column
    first = next(iter(lists))
    for name, column in lists.items():
        if len(column) != len(lists[first]):
            raise place.at(name).error(f"has {len(column)} values; {len(lists[first])} are needed, as in {first}")
    _check_columns(place.at, tuple(lists), names)
    return _points(lists, lambda name, index: place.at(name).item(index), names)


def _from_csv(path: Path, names: Names) -> Points:
    """Read points from a CSV file whose first line contains the column names."""
    place = Place(str(path))
    line, header, rows = read_table(path, "point", "no points; add a line for each", "beta,gamma")
    text = ("start", *names.presets)
    lines = array("q")  # line number of each point in the file

    def cell_place(name: str, index: int) -> Place:
        return place.at(f"line {lines[index]}, column {name}")

    def column_place(name: str) -> Place:
        return place.at(f"line {line}, column {name}")

    for position, name in enumerate(header):
        if not name:
            raise place.at(f"line {line}").error(f"column {position + 1} has no name; name it like a parameter")
        if name in header[:position]:
            raise column_place(name).error("is there already; give each column once")
    _check_columns(column_place, header, names)
    columns: dict[str, Any] = {name: [] if name in text else array("d") for name in header}
    for number, row in rows:
        lines.append(number)
        for (name, column), cell in zip(columns.items(), row, strict=True):
            if name in text:
                column.append(intern(cell.strip()))
                continue
            try:
                column.append(float(cell))
            except ValueError:
                problem = f"{shown(cell.strip())} is not a number" if cell.strip() else "empty"
                raise cell_place(name, -1).error(f"{problem}; write one, like 0.4 or 50e6") from None
    return _points(columns, cell_place, names)


def _check_columns(place_of: Callable[[str], Place], columns: Sequence[str], names: Names) -> None:
    """Raise if a column is unknown, or if initial states are incomplete or combined with a column of names."""
    states = tuple(f"{VECTOR}{state}" for state in names.system.start_states)
    vector = ", ".join(states)
    for name in columns:
        if name in names.presets or name in states:
            continue
        if name.startswith(VECTOR) and names.starts:
            raise place_of(name).error(f"scene {shown(names.scene)} has no such state; a start is {vector}")
        if name != "start":
            names.parameter(place_of(name), name)
        elif not names.starts:
            raise place_of(name).error(f"scene {shown(names.scene)} has no starts; leave the column out")
    present = [name for name in states if name in columns]
    missing = [name for name in states if name not in columns]
    if present and "start" in columns:
        raise place_of("start").error(f"{present[0]} gives the start as well; give names, or {vector}")
    if present and missing:
        raise place_of(present[0]).error(f"{' and '.join(missing)} missing; a start is {vector} together")


def _points(cells: Mapping[str, Sequence[Any]], place_of: CellPlace, names: Names) -> Points:
    columns, vectors, starts = {}, {}, None
    for name, column in cells.items():
        if name.removeprefix(VECTOR) in names.system.start_states and name.startswith(VECTOR):
            vectors[name] = np.array([quantity(place_of(name, i), value, STATE) for i, value in enumerate(column)])
        elif name != "start" and name not in names.presets:
            columns[name] = _numbers(column, name, place_of, names)
    for name in names.presets:
        if name in cells:
            chosen = [names.preset(place_of(name, i), name, cell) for i, cell in enumerate(cells[name])]
            columns[name] = np.array(chosen)
    if "start" in cells:
        starts = [names.named_start(place_of("start", i), start) for i, start in enumerate(cells["start"])]
    return Points(columns, starts, vectors or None)


def _numbers(column: Sequence[Any], name: str, place_of: CellPlace, names: Names) -> np.ndarray:
    """Return the validated values of the parameter called `name`, float64 (points,)."""
    parameter = names.parameter(place_of(name, 0), name)
    if isinstance(column, array) or all(type(value) is float for value in column):
        values = np.array(column)
        # Admissible values form an interval. If minimum and maximum are in it, all cells are.
        if parameter.problem(values.min()) is None and parameter.problem(values.max()) is None:
            return values
    return np.array([names.quantity(place_of(name, index), name, value) for index, value in enumerate(column)])
