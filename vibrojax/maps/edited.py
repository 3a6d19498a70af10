"""Sweeps of edited datasets: the lanes at the coordinates that a dataset has after a selection or an assignment."""

import json
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, shown
from vibrojax.maps.points import VECTOR
from vibrojax.maps.read import read_sweep
from vibrojax.maps.starts import Start, Starts
from vibrojax.maps.sweep import DIRECTIONS, Sweep
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.toml import plain_table, render
from vibrojax.settings.values import as_table

Coordinates = Mapping[Any, xr.DataArray]

POINTS = "points."
"""Prefix of the columns of points in the identity of a sweep."""

_PLACE = Place("dataset")


def at_coordinates(sweep: Sweep, coords: Coordinates) -> Sweep:
    """Return the sweep of the lanes at a dataset's coordinates, `sweep` itself if these are its own.

    A scalar coordinate fixes a parameter.

    **Raises:** `InputError` if a coordinate is missing or does not define lanes.
    """
    names = read_names(_PLACE, sweep.system)
    tables: dict[str, Any] = tomllib.loads(sweep.text)
    if "points" in tables:
        columns = {
            **(sweep.points or {}),
            **(sweep.point_vectors or {}),
            **({"start": 0} if sweep.point_starts else {}),
        }
        points = _read(sweep, tables | points_at(tables, columns, coords))
        return sweep if points.identity() == sweep.identity() else points
    grid, fixed = dict(tables.get("grid", {})), dict(tables.get("parameters", {}))
    changed = False
    for name in dict.fromkeys([*sweep.axes, *_parameters_in(coords, names)]):
        value = _along(coords, name, name)
        if isinstance(value, list):
            if name in sweep.axes and np.array_equal(value, sweep.axes[name]):
                continue
            grid[name] = value
            fixed.pop(name, None)
        elif name in sweep.axes or not _is_fixed(sweep, fixed, name, value):
            grid.pop(name, None)
            fixed[name] = value
        else:
            continue
        changed = True
    starts = _starts_at(sweep, coords)
    if starts is not None and (starts != list(sweep.starts or ()) or "starts" not in tables):
        changed |= starts != list(sweep.starts or ())
        tables["starts"] = [start if isinstance(start, str) else list(start) for start in starts]
    if not changed:
        return sweep
    if not grid and starts is None:  # a sweep has a dimension
        grid = {name: [fixed.pop(name)] for name in sweep.axes}
    tables |= {"parameters": fixed, "grid": grid}
    if not grid:
        del tables["grid"]
    return with_numbered_starts(_read(sweep, tables), coords)


def _read(sweep: Sweep, tables: dict[str, Any]) -> Sweep:
    """Return the sweep of other `tables`, with the objects of `sweep`, which may have no name."""
    text = render(plain_table(_PLACE, tables))
    fixed = {name: x for name, x in tables.get("parameters", {}).items() if name not in sweep.options}
    tables = tables | {"scene": sweep.system, "parameters": fixed}
    if "method" in tables.get("run", {}):
        tables["run"] = tables["run"] | {"method": sweep.run.stepper}
    kept = {name: getattr(sweep, name) for name in ("name", "file", "title", "options", "run")}
    return replace(read_sweep(tables), text=text, **kept)


def with_numbered_starts(sweep: Sweep, coords: Coordinates) -> Sweep:
    """Return the sweep, with starts that are only numbered if the dataset's are, as in a sample or a plane."""
    numbered = "start" in coords and coords["start"].dtype.kind in "iu"
    if sweep.starts is None or not sweep.starts.listed or not numbered:
        return sweep
    return replace(sweep, starts=replace(sweep.starts, listed=False))


def points_at(tables: Mapping[str, Any], needed: Collection[str], coords: Coordinates) -> dict[str, Any]:
    """Return the tables of a list of points at a dataset's coordinates: its points and fixed parameters.

    **Arguments:** `tables`: the sweep; `needed`: names of its columns, if they are known from elsewhere.

    **Raises:** `InputError` if a column is missing.
    """
    fixed = as_table(_PLACE.at("parameters"), tables.get("parameters", {}))
    names = read_names(_PLACE, tables.get("scene"), dict(fixed))
    known = list(needed or (tables["points"] if isinstance(tables["points"], dict) else ()))
    if not known:
        states = [name for state in names.system.start_states if (name := f"{VECTOR}{state}") in coords]
        known = states or [name for name in ("start",) if name in coords]
    new = [x for x in _parameters_in(coords, names) if coords[x].ndim or coords[x].item() != fixed.get(x)]
    columns = {name: _along(coords, name, "point") for name in dict.fromkeys([*known, *new])}
    size = max((len(x) for x in columns.values() if isinstance(x, list)), default=1)
    columns = {name: x if isinstance(x, list) else [x] * size for name, x in columns.items()}
    return {"points": columns, "parameters": {name: x for name, x in fixed.items() if name not in columns}}


def _parameters_in(coords: Coordinates, names: Names) -> list[str]:
    return [str(name) for name in coords if name in names.writable or name in names.presets]


def _is_fixed(sweep: Sweep, written: Mapping[str, Any], name: str, value: object) -> bool:
    """Return whether the sweep has this fixed value of a parameter or preset already."""
    return bool(value == written.get(name, sweep.given.get(name, sweep.parameters.get(name))))


def _along(coords: Coordinates, name: str, dimension: str) -> Any:
    """Return the values of a coordinate along its dimension as a list, or its only value."""
    if name not in coords:
        raise _PLACE.error(
            f"has no coordinate {name}, so its lanes are not known; select with isel or sel, without drop=True, "
            "or give the sweep itself"
        )
    data = coords[name]
    if data.dims not in ((), (dimension,)):
        along = " and ".join(map(str, data.dims))
        raise _PLACE.at(name).error(f"varies along {along}, which lanes of the sweep do not; drop the coordinate")
    return data.values.tolist()


def _starts_at(sweep: Sweep, coords: Coordinates) -> list[Start] | None:
    """Return the initial conditions at the coordinates; None if the sweep has no dimension `start`."""
    if sweep.run.carry is not None and _along(coords, "direction", "direction") != list(DIRECTIONS):
        raise _PLACE.at("direction").error(f"lanes that are carried run {' and '.join(DIRECTIONS)}; keep both")
    if not sweep.crosses_starts or sweep.starts is None:
        return None
    labels = np.atleast_1d(np.asarray(_along(coords, "start", "start"), object)).tolist()
    columns = {state: f"{VECTOR}{state}" for state in sweep.starts.states}
    if not sweep.starts.has_vectors and not any(name in coords for name in columns.values()):
        return [str(label) for label in labels]
    table = [np.atleast_1d(np.asarray(_along(coords, name, "start"), float)) for name in columns.values()]
    rows = np.array([np.broadcast_to(column, len(labels)) for column in table]).T
    return [_start(label, tuple(row), sweep.starts) for label, row in zip(labels, rows.tolist(), strict=True)]


def _start(label: object, row: tuple[float, ...], before: Starts) -> Start:
    """Return one initial condition, from its label and the coordinates of its states, NaN for one with a name.

    If the two differ, one of them was edited: it is none of the starts `before`.
    """
    if not isinstance(label, str):
        return row
    written: Start = label
    if label.startswith("["):
        try:
            written = tuple(map(float, json.loads(label)))
        except (ValueError, TypeError, RecursionError):
            raise _PLACE.at("start").error(f"{shown(label)} is not a start") from None
    if written == row or (isinstance(written, str) and np.isnan(row).all()):
        return written
    known = list(before)
    if isinstance(written, str) or (written in known) == (row in known):
        raise _PLACE.at("start").error(f"{shown(label)} is not at the states {shown(list(row))}; change both, or one")
    return row if written in known else written


def check_dimensions(dataset: xr.Dataset, sweep: Sweep) -> None:
    """Raise `InputError` if the dataset has a dimension along which its lanes have no values of the sweep."""
    for name in ("status", "orbit_reason", "lane_attractor", "valid"):
        for dimension in dataset[name].dims if name in dataset else ():
            if dimension not in sweep.dims:
                raise InputError(
                    f"dataset: lanes are along {shown(str(dimension))}, which is neither a parameter of the scene "
                    "nor the start; select one value with isel"
                )
