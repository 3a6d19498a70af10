"""Periodic orbits of a sweep's lanes, and sweeps of datasets that are run again.

A dataset may be edited: its lanes are those at the coordinates that it has after a selection or an assignment.
"""

import json
import tomllib
import warnings
from collections.abc import Collection, Mapping
from dataclasses import replace
from math import inf
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, counted, shown
from vibrojax.io.attributes import table_of, title_of
from vibrojax.io.identity import IDENTITY, changes, identity_text
from vibrojax.io.kinds import kind_of
from vibrojax.maps.cost import estimated_steps
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.maps.starts import VECTOR, Start, Starts
from vibrojax.maps.sweep import DIRECTIONS, Sweep
from vibrojax.settings.code_identity import is_code
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.toml import plain_table, render
from vibrojax.settings.values import UnusualValue, as_table

Coordinates = Mapping[Any, xr.DataArray]

POINTS = "points."
"""Prefix of the columns of points in the identity of a sweep."""

_PLACE = Place("dataset")

RERUN_LANE_MAX_STEPS = 2e6
"""Estimated steps of a lane above which a dataset's sweep is not run again; a dataset may come from any source. The
hardest bundled lanes take 1e6 steps."""

RERUN_MAX_STEPS = 3e9
"""Estimated steps of all lanes above which a dataset's sweep is not run again, about five minutes of one core. Analyses
do not apply the limit if the dataset contains a value for each lane; pages, which run sweeps unasked, always do."""


OTHER_PERIOD, OTHER_LANES = 1e-2, 1e-2
"""Relative difference of the period from which on an orbit is not that of the stored lane, far above the error of a
lane that is still settling; and share of such lanes up to which they may lie at the border of a basin."""


def orbits(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True
) -> xr.Dataset:
    """Find the periodic orbits of a sweep's lanes, their multipliers and their stability.

        orb = vj.orbits(ds)

    An orbit with n section crossings per period is a fixed point of the n-th iterate of the return map. Newton's method
    finds the orbit of a lane from the last section crossings of the lane.

    In the scene `penetration` the beginning of a pulse replaces the section crossing. A lane of `penetration` is
    periodic if the return map, iterated from the lane's last pulse, returns to the same state after 1 to 8 pulses.

    **Arguments:**

    - `source`: the dataset of a sweep, or a sweep as in `run_sweep`. If the dataset has no orbits, its lanes are
      simulated again.

    **Returns:** the sweep's dataset with the additional variables listed here. If the orbit of a lane was found,
    `period` and the other measures of the lane are computed on the orbit.

    - `multiplier_abs` [1], `multiplier_arg` [rad] along `multiplier`: modulus and argument of the multipliers, by
      decreasing modulus. The multipliers are the eigenvalues of the derivative of the n-th iterate of the return map.
      `stable`: 1 (stable), 0 (unstable) or -1 (no multipliers).
    - `orbit_reason`: *found*, or the reason why there is no orbit. *not-repeating*: the lane is not periodic.
      *refused*: the lane cannot be run. *not-converged*: Newton's method has not converged. *near-grazing*: the orbit
      is so close to grazing that multipliers have no meaning. *another-orbit*: the orbit is too far from the lane,
      differs from the lane in the number of impacts, is unstable, or is not confirmed by a simulation.
    - `error_estimate`: infinite for a lane near an unstable orbit.
    - `orbit_residual`: the largest scaled difference between the image of a state under the return map and the next
      state of the orbit. `grazing_margin`: how far the orbit is from a change in the order of its events; the dataset's
      attribute `orbits` states the definition.
    - `orbit_cycles`: section crossings per period of the orbit. It is less than the lane's `cycles` if the lane is
      still settling on an orbit with a shorter period.
    - `nearby_cycles`: section crossings per period of a stable orbit near a lane that is irregular or undecided, or 0
      if no such orbit was found. `nearby_impacts`: impacts per period of this nearby orbit. `nearby_distance`: distance
      of the lane from the nearby orbit, in units of the amplitudes.

    **Raises:** `InputError` if the source is neither a sweep nor the dataset of a sweep, if the sweep cannot be run, or
    if the scene has neither a section nor pulses.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
    >>> orb = vj.orbits({"scene": "vibro-impact", "parameters": point, "starts": ["stuck"]}, progress=False)
    >>> int(orb.stable.item()), orb.multiplier_abs.values.ravel().round(3).tolist()  # the bit sticks: one is 0
    (1, [0.697, 0.697, 0.0])
    """
    if isinstance(source, xr.Dataset) and holds_orbits(source):
        return source
    result = run_sweep(sweep_with_orbits(source), progress=progress)
    if isinstance(source, xr.Dataset):
        check_same_motions(source, result)
    return result


def check_same_motions(stored: xr.Dataset, result: xr.Dataset) -> None:
    """Raise `InputError` if the orbits of a sweep that was run again differ from the stored lanes.

    So it is where sweeps with other fixed parameters were joined: the attributes are those of one of them. Of other
    edited datasets, whose coordinates may be new, the lanes are computed without a comparison.
    """
    tables, names = tomllib.loads(str(stored.attrs["sweep"])), ("period", "cycles")
    axes = {name: axis for name, axis in tables.get("grid", {}).items() if name in stored.sizes}
    sizes = {name: x.get("num", inf) if isinstance(x, dict) else len(x) for name, x in axes.items()}
    if all(stored.sizes[name] <= size for name, size in sizes.items()):
        return
    if not all(name in stored and set(stored[name].dims) == set(result[name].dims) for name in names):
        return
    before, cycles = (np.asarray(stored[name].transpose(*result[name].dims)) for name in names)
    now = result["period"].values
    if before.shape != now.shape:
        return
    known = np.isfinite(before) & np.isfinite(now) & (cycles > 0) & (result["stable"].values == 1)
    differing = known & (np.abs(before - now) > OTHER_PERIOD * np.abs(now))
    if differing.sum() > OTHER_LANES * known.sum():
        raise InputError(
            f"orbits: {counted(int(differing.sum()), 'lane has', 'lanes have')} another period than in the dataset, "
            "which may join sweeps with different fixed parameters; find the orbits of each sweep, and join the results"
        )


def sweep_with_orbits(source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep) -> Sweep:
    """Return the sweep of `source` with `orbits = true`; raise `InputError` if `source` has no sweep."""
    if isinstance(source, xr.Dataset):
        return sweep_of_dataset(source)
    if isinstance(source, Sweep):
        return replace(source, run=replace(source.run, orbits=True))
    return read_sweep(source, ["run.orbits=true"])


def holds_orbits(dataset: xr.Dataset) -> bool:
    """Return whether a dataset holds the orbits of its lanes: those of an edited dataset may be of other lanes."""
    return "orbit_reason" in dataset and ("sweep" not in dataset.attrs or not _lanes_of_dataset(dataset, True)[1])


def sweep_of_dataset(dataset: xr.Dataset, orbits: bool = True) -> Sweep:
    """Return the sweep of the lanes at a dataset's coordinates, with the settings in its attribute `sweep`.

    **Arguments:** `orbits`: True to set `orbits = true`.

    **Raises:** `InputError` if the dataset has no sweep, if its coordinates do not define lanes, if the sweep that it
    names has changed since, or if the sweep is too expensive to run again.
    """
    sweep, _ = _lanes_of_dataset(dataset, orbits)
    if problem := rerun_problem(sweep, inf if has_lanes_of(dataset, sweep) else RERUN_MAX_STEPS):
        raise InputError(f"orbits: the sweep that the dataset names has {problem}; give the sweep itself")
    return replace(sweep, title=sweep.title or title_of(dataset))


def _lanes_of_dataset(dataset: xr.Dataset, orbits: bool) -> tuple[Sweep, bool]:
    """Return the sweep of a dataset's lanes, and whether they differ from the computed ones."""
    try:
        tables = tomllib.loads(str(dataset.attrs["sweep"]))
    except (KeyError, ValueError, RecursionError):
        kind = kind_of(dataset)
        why = 'it has no attribute sweep; combine_attrs="override" keeps that of joined datasets'
        why = f"its kind is {kind}" if kind and kind != "sweep" else why
        raise InputError(f"not the dataset of a sweep ({why}); give one, or a sweep") from None
    before = dict(table_of(dataset, IDENTITY))
    for name in ("attractors", "borders", "sensitivity"):  # these entries belong to derived results, not to the sweep
        before.pop(name, None)
    points = {name: x for name, x in before.items() if name.startswith(POINTS)}
    if "points" in tables:
        tables |= points_at(tables, [name.removeprefix(POINTS) for name in points], dataset.coords)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)  # reported when the sweep was run
        stored = with_numbered_starts(read_sweep(tables, ["run.orbits=true"] if orbits else ()), dataset.coords)
    now = json.loads(identity_text(stored.identity()))
    # Version 0.1.0 did not state the code of the user's own scenes and laws.
    known = {name: x for name, x in now.items() if is_code(name) and not any(map(is_code, before))}
    # Points are in the coordinates alone; whether orbits were found does not change lanes.
    free = {*points, "run.orbits", *(name for name in now if name.startswith(POINTS))}
    if stored.points is not None:
        free |= {"starts", *(f"parameters.{name}" for name in stored.points)}
    same, other = ({name: x for name, x in values.items() if name not in free} for values in (before | known, now))
    if before and (differing := changes(same, other)):
        raise InputError(f"orbits: the sweep that the dataset names has changed: {differing}; give the sweep itself")
    edited = bool(before) and any(before.get(name) != now.get(name) for name in free - {"run.orbits"})
    sweep = stored
    if kind_of(dataset) != "borders":  # their coordinates are not those of lanes
        sweep = at_coordinates(stored, dataset.coords)
    for name in ("status", "orbit_reason", "lane_attractor", "valid"):
        for dimension in dataset[name].dims if name in dataset else ():
            if dimension not in sweep.dims:
                raise InputError(
                    f"dataset: lanes are along {shown(str(dimension))}, which is neither a parameter of the scene "
                    "nor the start; select one value with isel"
                )
    return sweep, edited or sweep is not stored


def rerun_problem(sweep: Sweep, most_steps: float = RERUN_MAX_STEPS) -> str:
    """Return why a sweep is not run for a dataset, or an empty string.

    **Arguments:** `most_steps`: limit on the estimated steps of all lanes.
    """
    steps = estimated_steps(sweep)
    if steps.max() <= RERUN_LANE_MAX_STEPS and steps.mean() * sweep.lanes <= most_steps:
        return ""
    return f"{sweep.lanes} lanes of up to {steps.max():.3g} steps, more than is run for a dataset"


def has_lanes_of(dataset: xr.Dataset, sweep: Sweep) -> bool:
    """Return whether a dataset has a value for each lane of a sweep."""
    return all(dataset.sizes.get(name, 1) == size for name, size in zip(sweep.dims, sweep.shape, strict=True))


def at_coordinates(sweep: Sweep, coords: Coordinates) -> Sweep:
    """Return the sweep of the lanes at a dataset's coordinates, `sweep` itself if these are its own.

    A scalar coordinate fixes a parameter.

    **Raises:** `InputError` if a coordinate is missing or does not define lanes.
    """
    names = read_names(_PLACE, sweep.system)
    tables: dict[str, Any] = tomllib.loads(sweep.text)
    if "points" in tables:
        tables |= points_at(tables, [*(sweep.points or {}), *sweep.start_columns], coords)
    else:
        grid, fixed = dict[str, Any](), dict(tables.get("parameters", {}))
        for name in dict.fromkeys([*sweep.axes, *_parameters_in(coords, names)]):
            value = _along(coords, name, name)
            table, other = (grid, fixed) if isinstance(value, list) else (fixed, grid)
            table[name] = value
            other.pop(name, None)
        starts = _starts_at(sweep, coords)
        if starts is not None and (starts != list(sweep.starts or ()) or "starts" not in tables):
            tables["starts"] = [start if isinstance(start, str) else list(start) for start in starts]
        if not grid and starts is None:  # a sweep has a dimension
            grid = {name: [fixed.pop(name)] for name in sweep.axes}
        tables |= {"parameters": fixed, "grid": grid}
        if not grid:
            del tables["grid"]
    text = render(plain_table(_PLACE, tables))
    # The objects of the sweep, which may have no name.
    fixed = {name: x for name, x in tables.get("parameters", {}).items() if name not in sweep.options}
    tables |= {"scene": sweep.system, "parameters": fixed}
    if "method" in tables.get("run", {}):
        tables["run"] = tables["run"] | {"method": sweep.run.stepper}
    kept = {name: getattr(sweep, name) for name in ("name", "file", "title", "options", "run")}
    lanes = with_numbered_starts(replace(read_sweep(tables), text=text, **kept), coords)
    return sweep if lanes.identity() == sweep.identity() else lanes


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
