"""Starts and points of a sweep.

Initial conditions are a list of names and vectors, a random sample of a box, or a plane of states. A list of points,
from a CSV file or a table of columns, takes the place of a grid.
"""

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass
from math import prod
from pathlib import Path
from sys import intern
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from vibrojax.errors import Place, shown
from vibrojax.io.tables import read_table
from vibrojax.lazy import qmc
from vibrojax.settings.fields import Settings, setting
from vibrojax.settings.names import Names
from vibrojax.settings.values import (
    AXIS_MAX_VALUES,
    STATE,
    as_table,
    check_distinct,
    known_keys,
    quantity,
    read_axis,
    read_pair,
)

VECTOR = "start_"
"""Prefix of the columns that together define the initial states of each point: `start_x1`, `start_v1`, ..."""

CellPlace = Callable[[str, int], Place]
"""Function that returns the place of a cell from its column and index."""

DEFAULT_STARTS = ("drive", "stuck")
"""Initial conditions of a sweep that specifies none, if the scene has them."""

Start = str | tuple[float, ...]
"""An initial condition: a name or a vector."""


def examples(states: Sequence[str]) -> tuple[str, str]:
    """Return how a sample and a plane of initial states are written, for messages and the catalogue."""
    box = ", ".join(f"{name} = [-0.05, 0.05]" for name in states[:2])
    axes = ", ".join(f"{name} = {{ start = -0.05, stop = 0.05, num = 50 }}" for name in states[:2])
    return f'{{ sample = "sobol", count = 256, seed = 0, box = {{ {box} }} }}', f"{{ plane = {{ {axes} }} }}"


@dataclass(frozen=True, eq=False)
class Starts:
    """The initial conditions of a sweep, in their order.

    - `names`: names of the named initial conditions, without duplicates.
    - `states`: names of the states in a vector.
    - `number` (starts,): index of each initial condition in `names`; the number of names for a vector.
    - `vectors` (starts, states): initial states [m, m/s]; NaN for named initial conditions.
    - `listed`: True if the file lists the initial conditions. Those of a sample or a plane are only numbered.
    """

    names: tuple[str, ...]
    states: tuple[str, ...]
    number: Int[np.ndarray, " starts"]
    vectors: Float[np.ndarray, "starts states"]
    listed: bool = True

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, index: int) -> Start:
        number = int(self.number[index])
        return self.names[number] if number < len(self.names) else tuple(self.vectors[index].tolist())

    def __iter__(self) -> Iterator[Start]:
        return (self[index] for index in range(len(self)))

    @property
    def has_vectors(self) -> bool:
        return bool(np.any(self.number == len(self.names)))

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The vectors by names of their coordinates, `start_x1` and so on, each (starts,)."""
        return {f"{VECTOR}{name}": x for name, x in zip(self.states, self.vectors.T, strict=True)}


def list_of(starts: Sequence[Start], states: tuple[str, ...]) -> Starts:
    """Return the initial conditions in a list of names and vectors. `states`: names of the states in a vector."""
    names = tuple(dict.fromkeys(start for start in starts if isinstance(start, str)))
    undefined = (np.nan,) * len(states)
    vectors = np.array([undefined if isinstance(start, str) else start for start in starts], float)
    number = np.array([names.index(start) if isinstance(start, str) else len(names) for start in starts], int)
    return Starts(names, states, number, vectors.reshape(len(starts), len(states)))


def read_starts(place: Place, value: object, names: Names) -> Starts | None:
    """Return the initial conditions specified at `place`, or the defaults if `value` is None.

    Return None for a scene without selectable initial conditions.
    """
    if not names.has_starts:
        if value is not None:
            raise place.error(f"scene {shown(names.scene)} has no starts; leave it out")
        return None
    states = names.system.start_states
    if value is None:
        defaults = [start for start in DEFAULT_STARTS if start in names.starts] or names.starts[:1]
        return list_of(defaults, states) if defaults else None
    if isinstance(value, dict):
        return _read_many(place, value, names)
    if not isinstance(value, list) or not value:
        has_names = set(DEFAULT_STARTS) <= set(names.starts)
        example = '["drive", "stuck"]' if has_names else shown([[0.1] * len(states)])
        raise place.error(
            f"{shown(value)} is not a list of starts; write one like {example}, a sample of a box or a plane"
        )
    if not any(isinstance(item, str | list | tuple | dict) for item in value) and states:
        raise place.error(f"{shown(value)} are numbers; write one list for each start: [[{', '.join(states)}]]")
    starts = [names.start(place.item(index), item) for index, item in enumerate(value)]
    check_distinct(place, starts, "start")
    return list_of(starts, states)


def _read_many(place: Place, table: dict[str, object], names: Names) -> Starts:
    """Return the initial conditions of a sample, or of a plane in row-major order over the listed states."""
    states = names.system.start_states
    if not states:
        raise place.error(f"scene {shown(names.scene)} accepts no initial states; give names")
    kind = next((kind for key, kind in (("plane", _Plane), ("sample", _Sample)) if key in table), None)
    if kind is None:
        raise place.error(f"neither a sample nor a plane; write one like {' or '.join(examples(states))}")
    many = kind.read(place, table)
    columns = many.columns(place, states)
    known_keys(place.at("at"), many.at, states)
    for name in many.at:
        if name in columns:
            raise place.at("at").at(name).error("varies already; leave it out")
    fixed = {name: quantity(place.at("at").at(name), x, STATE) for name, x in many.at.items()}
    rows = len(next(iter(columns.values())))
    vectors = np.stack([columns.get(name, np.full(rows, fixed.get(name, 0.0))) for name in states], axis=1)
    return Starts((), states, np.zeros(rows, int), vectors, listed=False)


@dataclass(frozen=True, kw_only=True)
class _Sample(Settings):
    """A scrambled Sobol sequence (Owen 1998) in a box, or independent and uniform samples."""

    sample: str = setting(MISSING, "kind of sample", choices=("sobol", "random"))
    count: int = setting(MISSING, "give the number of starts", least=1, most=AXIS_MAX_VALUES)
    box: dict[str, object] = setting(
        MISSING, "give the ends of some states, like { x1 = [-0.05, 0.05] }", read=as_table
    )
    seed: int = setting(0, "seed of the random numbers", least=0)
    at: dict[str, object] = setting(dict, "values of the other states", read=as_table)

    def columns(self, place: Place, states: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Return the sampled states by name, each (count,)."""
        known_keys(place.at("box"), self.box, states)
        if not self.box:
            raise place.at("box").error(f"empty; write one like {examples(states)[0]}")
        sides = []
        for name, side in self.box.items():
            here = place.at("box").at(name)
            sides.append(read_pair(here, side, "a side of a box; write its two ends, like [-0.05, 0.05]", STATE))
            if not sides[-1][0] < sides[-1][1]:
                problem = "from {:g} to {:g} is not a side of a box; the first end must be below the second"
                raise here.error(problem.format(*sides[-1]))
        low, high = np.array(sides).T
        random = np.random.default_rng(self.seed)
        if self.sample == "sobol":
            sobol = qmc.Sobol(len(sides), rng=random)
            unit = np.asarray(sobol.random_base2((self.count - 1).bit_length())[: self.count])
        else:
            unit = random.random((self.count, len(sides)))
        return dict(zip(self.box, (low + (high - low) * unit).T, strict=True))


@dataclass(frozen=True, kw_only=True)
class _Plane(Settings):
    """All combinations of values of some states."""

    plane: dict[str, object] = setting(MISSING, "axes of the plane", read=as_table)
    at: dict[str, object] = setting(dict, "values of the other states", read=as_table)

    def columns(self, place: Place, states: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Return the states by name, each (starts,)."""
        here = place.at("plane")
        known_keys(here, self.plane, states)
        if not self.plane:
            raise here.error(f"empty; write one like {examples(states)[1]}")
        values = [read_axis(here.at(name), axis, STATE) for name, axis in self.plane.items()]
        if prod(map(len, values)) > AXIS_MAX_VALUES:
            raise here.error(f"{prod(map(len, values))} starts are too many; {AXIS_MAX_VALUES} at most")
        return dict(zip(self.plane, map(np.ravel, np.meshgrid(*values, indexing="ij")), strict=True))


def read_points(place: Place, value: object, folder: Path, names: Names) -> tuple[dict[str, np.ndarray], Starts | None]:
    """Read the points of a sweep from a CSV file, whose path is relative to `folder`, or from a table of columns.

    **Returns:** columns of parameters and rocks, each (points,), by name, and the initial condition of each point, None
    if other keys specify them.
    """
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


def _from_csv(path: Path, names: Names) -> tuple[dict[str, np.ndarray], Starts | None]:
    """Read points from a CSV file whose first line contains the column names."""
    place = Place(str(path))
    line, header, rows = read_table(path)
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
                column.append(float(cell.replace("_", "?")))  # Python would read 1_2 as 12
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


def _points(
    cells: Mapping[str, Sequence[Any]], place_of: CellPlace, names: Names
) -> tuple[dict[str, np.ndarray], Starts | None]:
    columns, vectors, starts = {}, {}, None
    states = names.system.start_states
    for name, column in cells.items():
        state = name.removeprefix(VECTOR)
        if state in states and name != state:
            vectors[state] = np.array([quantity(place_of(name, i), value, STATE) for i, value in enumerate(column)])
        elif name != "start" and name not in names.presets:
            parameter = names.parameter(place_of(name, 0), name)
            if isinstance(column, array) or all(type(value) is float for value in column):
                values = np.array(column)
                # Admissible values form an interval. If minimum and maximum are in it, all cells are.
                if parameter.problem(values.min()) is None and parameter.problem(values.max()) is None:
                    columns[name] = values
                    continue
            columns[name] = np.array([names.quantity(place_of(name, i), name, value) for i, value in enumerate(column)])
    for name in names.presets:
        if name in cells:
            chosen = [names.preset(place_of(name, i), name, cell) for i, cell in enumerate(cells[name])]
            columns[name] = np.array(chosen)
    if "start" in cells:
        starts = list_of([names.named_start(place_of("start", i), x) for i, x in enumerate(cells["start"])], states)
    elif vectors:
        rows = np.stack([vectors[name] for name in states], axis=1)
        starts = Starts((), states, np.zeros(len(rows), int), rows)
    return columns, starts
