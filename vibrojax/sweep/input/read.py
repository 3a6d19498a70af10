"""From a sweep file, a bundled name or a dict to a checked Sweep."""

from collections.abc import Iterable, Mapping
from os import PathLike

import numpy as np

from vibrojax.errors import Place, shown, suggestion
from vibrojax.sweep.input.axes import read_axis
from vibrojax.sweep.input.changes import with_changes
from vibrojax.sweep.input.definition import Sweep, rock_values, with_drive_speed
from vibrojax.sweep.input.names import CHOICES, Names, read_names, take_options
from vibrojax.sweep.input.plausible import warn_if_far
from vibrojax.sweep.input.points import VECTOR, Points, read_points
from vibrojax.sweep.input.run_settings import RunSettings, read_settings
from vibrojax.sweep.input.source import Source, read_source
from vibrojax.sweep.input.starts import Starts, list_of, read_starts
from vibrojax.sweep.input.values import as_table

_TOP_KEYS = ("scene", "title", "starts", "unusual", "parameters", "grid", "points", "run")
# Lanes are numbered by 64-bit integers.
_MOST_LANES = 2**62


def read_sweep(source: str | PathLike[str] | Mapping[str, object], changes: Iterable[str] = ()) -> Sweep:
    """Read and check a sweep.

    **Arguments:**

    - `source`: the path of a TOML file, a bundled name, or a dict of the same shape.
    - `changes`: words NAME=VALUE, set over it; see [vibrojax.sweep.input.changes.with_changes][].

    **Returns:** the `Sweep`, complete with defaults.

    **Raises:** `InputError`, one line, at the first thing that is wrong.

    **Example:**

    >>> sweep = vj.read_sweep("regime-map", ["run.error=1e-6", "v=2.0"])
    >>> sweep.lanes, sweep.run.error
    (8280, 1e-06)
    """
    found = read_source(source)
    if words := tuple(changes):
        found = with_changes(found, words)
    place, tables = Place(found.file), found.tables
    _check_top(place, tables)
    given = dict(as_table(place.at("parameters"), tables.get("parameters", {})))
    names = read_names(place.at("scene"), tables["scene"], take_options(given), place.at("parameters"))
    fixed = read_parameters(place.at("parameters"), given, names)
    axes, points = _read_varied(place, found, names)
    varied = points.columns if points else axes
    varying = place.at("points" if points else "grid")
    at = {name: place.at("parameters").at(name) for name in given} | {name: varying.at(name) for name in varied}
    check_rock(at)
    # By what was written as well: a rock is no number of its own.
    homes = {name: place.at("parameters").at(name) for name in (*given, *fixed)}
    for name in varied:
        home = varying.at(name)
        if name in homes:
            raise home.error("is in [parameters] as well; give it in one of the two")
        homes[name] = home
    check_drive_speed(homes)
    starts: Starts | None = read_starts(place.at("starts"), tables.get("starts"), names)
    point_starts, vectors = (points.starts, points.vectors) if points else (None, None)
    if point_starts:
        starts = list_of(tuple(dict.fromkeys(point_starts)), names.system.start_states)
    if vectors:
        vectors = {name: vectors[name] for name in (f"{VECTOR}{state}" for state in names.system.start_states)}
    sweep = Sweep(
        name=found.name,
        text=found.text,
        title=_read_title(place.at("title"), tables.get("title", "")),
        scene=names.scene,
        options=dict(names.options),
        system=names.system,
        starts=None if vectors else starts,
        parameters=_complete(fixed, varied, names),
        given=fixed,
        axes=axes,
        points=points.columns if points else None,
        point_starts=point_starts,
        point_vectors=vectors,
        run=read_settings(place.at("run"), as_table(place.at("run"), tables.get("run", {}))),
        file=found.file,
    )
    if sweep.lanes > _MOST_LANES:
        raise place.at("grid").error(f"{shown(sweep.lanes)} lanes are too many; make the axes shorter")
    if sweep.run.carry is not None:
        _check_carried(place.at("run").at("carry"), sweep)
    if sweep.run.orbits and not sweep.system.driving_part().return_states:
        raise (
            place.at("run")
            .at("orbits")
            .error(f"true has no use in {sweep.scene} without a section or pulses to return to; leave it out")
        )
    if sweep.run.lyapunov and sweep.system.section is None:
        problem = f"true has no use in {sweep.scene}, which has no section to return to; leave it out"
        raise place.at("run").at("lyapunov").error(problem)
    if not _read_unusual(place.at("unusual"), tables.get("unusual", False)):
        for name, value in {**fixed, **varied}.items():
            if name != "rock":
                warn_if_far(homes[name], names.writable[name], value, meant="; unusual = true says that it is meant")
    return sweep


def _check_carried(place: Place, sweep: Sweep) -> None:
    """Raise where lanes cannot be carried along the axis that is named."""
    name = str(sweep.run.carry)
    if name not in sweep.axes:
        raise place.error(f"{shown(name)} is no axis of [grid]; {suggestion(name, sweep.axes)}")
    axis = sweep.axes[name]
    if axis.dtype.kind != "f" or len(axis) < 2 or np.any(np.diff(axis) <= 0):
        raise place.error(f"the values of {name} do not rise, so there is no up and down; write two or more that do")
    if sweep.starts is not None and len(sweep.starts) != 1:
        raise place.error(f'{len(sweep.starts)} starts; the first lane of each way has one: write starts = ["stuck"]')


def read_parameters(place: Place, given: dict[str, object], names: Names) -> dict[str, float]:
    """The numbers of [parameters], checked; `place` is where the table stands."""
    if "rock" in given and names.has_rock:
        rock = names.rock(place.at("rock"), given["rock"])
        given = {name: value for name, value in given.items() if name != "rock"}
        return read_parameters(place, given, names) | rock_values(rock)
    for name, value in given.items():
        names.parameter(place.at(name), name)
        if isinstance(value, (list, dict)):
            raise place.at(name).error(f"{shown(value)} is not a number; what varies belongs in [grid]")
    return {name: names.quantity(place.at(name), name, value) for name, value in given.items()}


def check_drive_speed(given: Mapping[str, Place]) -> None:
    """Raise where v is given twice, or rpm without bit_radius or the reverse; `given`: names and their places."""
    rotation = [name for name in ("rpm", "bit_radius") if name in given]
    if rotation and "v" in given:
        raise given[rotation[0]].error("v is given as well; give v, or rpm with bit_radius")
    if len(rotation) == 1:
        missing = "bit_radius [m]" if rotation == ["rpm"] else "rpm [1/min]"
        raise given[rotation[0]].error(f"{missing} is missing; only both together give v: add it, or give v")


def check_rock(given: Mapping[str, Place]) -> None:
    """Raise where `rock` is given beside the threshold or stiffness that it stands for; `given`: names and places."""
    for name in ("threshold", "k3"):
        if "rock" in given and name in given:
            raise given["rock"].error(f"{name} is given as well; give the rock, or threshold and k3")


def _check_top(place: Place, tables: dict[str, object]) -> None:
    for key in tables:
        if key in _TOP_KEYS:
            continue
        if key in RunSettings.__dataclass_fields__:
            raise place.at(key).error("unknown key at the top; it belongs in [run]")
        scene = tables.get("scene")
        names = read_names(place.at("scene"), scene) if scene is not None else None
        if key in CHOICES or key == "rock" or (names and key in names.writable):
            raise place.at(key).error("unknown key at the top; it belongs in [parameters]")
        raise place.at(key).error(f"unknown key; {suggestion(key, _TOP_KEYS)}")
    if "scene" not in tables:
        raise place.at("scene").error('missing; write the scene\'s name, like scene = "vibro-impact"')


def _read_title(place: Place, value: object) -> str:
    if not isinstance(value, str):
        raise place.error(f"{shown(value)} is not text; write it in quotes")
    return value


def _read_unusual(place: Place, value: object) -> bool:
    """Whether values far from the usual ones are meant, so that nothing is said of them."""
    if not isinstance(value, bool):
        raise place.error(f"{shown(value)} is neither true nor false; write one of them")
    return value


def _read_varied(place: Place, found: Source, names: Names) -> tuple[dict[str, np.ndarray], Points | None]:
    """The grid's axes or the points."""
    tables = found.tables
    if "points" in tables and "grid" in tables:
        raise place.at("points").error(f"{shown(tables['points'])} beside [grid]; give one of them")
    if "points" in tables:
        return {}, read_points(place.at("points"), tables["points"], found.folder, names)
    grid = as_table(place.at("grid"), tables.get("grid", {}))
    if not grid and ("grid" in tables or "starts" not in tables or not names.has_starts):
        problem = "empty" if "grid" in tables else "missing"
        raise place.at("grid").error(f"{problem}, so there is nothing to sweep; add an axis like beta = [0.3, 0.4]")
    at = place.at("grid")
    return {name: _read_grid_axis(at.at(name), name, value, names) for name, value in grid.items()}, None


def _read_grid_axis(place: Place, name: str, value: object, names: Names) -> np.ndarray:
    if name == "rock" and names.has_rock:
        if not isinstance(value, list) or not value:
            raise place.error(f'{shown(value)} is no list of rocks; write one like ["sandstone", "granite"]')
        rocks = [names.rock(place.item(index), item) for index, item in enumerate(value)]
        for index, rock in enumerate(rocks):
            if rock in rocks[:index]:
                raise place.item(index).error(f"{shown(rock)} is there already; give each rock once")
        return np.array(rocks)
    return read_axis(place, value, names.parameter(place, name))


def _complete(fixed: dict[str, float], varied: Iterable[str], names: Names) -> dict[str, float]:
    """Everything that is fixed: what is given, and the defaults of the rest."""
    by_rotation = "rpm" in {*fixed, *varied}
    absent = {*varied, "v"} if by_rotation else {*varied}
    absent |= {"threshold", "k3"} if "rock" in absent else set()
    defaults = {name: p.default for name, p in names.parameters.items() if name not in absent}
    return defaults | with_drive_speed(fixed)
