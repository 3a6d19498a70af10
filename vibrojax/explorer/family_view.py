"""The explorer's view of families of periodic orbits: branches as lines, special points, orbits of all points."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import Place
from vibrojax.explorer.document import (
    Document,
    coordinate_document,
    document_with,
    one_line,
    options_of,
    run_document,
    variable_document,
)
from vibrojax.explorer.encoding import Cell, pack
from vibrojax.explorer.map_view import REPEAT_MARGIN
from vibrojax.explorer.recording import Excerpt, record_cells
from vibrojax.io.attributes import parameters_of, text_of
from vibrojax.io.branches import FAMILY, along_name, kind_names, numbers_of, places, runs, stability
from vibrojax.io.variables import orbit_name
from vibrojax.periodic.margin import DRIVEN_RETURNS
from vibrojax.plot.branches import MARKS, curves_of
from vibrojax.sweep.input.read import Point, read_point

MARK_SHAPES = {"s": "square", "o": "circle", "*": "diamond", "v": "triangle", "|": "bar", "D": "diamond", "x": "cross"}
"""Shapes of special points in the explorer page, by the markers that pictures use."""

LEADING_ORBIT_VARIABLES = ("impact_velocity", "bit_amplitude", "multiplier_abs", "stable", "period")


def family_document(ds: xr.Dataset) -> Document:
    """Return the JSON document of families, given the dataset of `follow`."""
    along, point, count = along_name(ds), _base_point(ds), ds.sizes["point"]
    columns = [coordinate_document(ds[along])]
    for name, values in _family_values(ds).items():
        columns.append(coordinate_document(xr.DataArray(values, dims="point", name=name, attrs=ds[name].attrs)))
    for name in point.system.start_states:
        values = ds[orbit_name(name)].values if orbit_name(name) in ds else np.zeros(count)
        column = xr.DataArray(values, dims="point", name=f"start_{name}")
        columns.append(coordinate_document(column) | {"silent": True})
    names = [str(name) for name, data in ds.data_vars.items() if "point" in data.dims and data.dtype.kind in "fiu"]
    names = [name for name in names if name not in (along, "point_family")]
    names = [name for name in LEADING_ORBIT_VARIABLES if name in names] + names
    variables = [variable_document(ds[name]) for name in dict.fromkeys(names)]
    axis = coordinate_document(xr.DataArray(np.arange(count), dims="point", name="point"))
    # The command starts on the orbit, so no settling time is needed.
    run = run_document(ds) | {"start": None, "duration": 2.0}
    if point.system.driving_part() is not point.system:
        run["states"] = []
    return document_with(
        ds,
        "family",
        variables,
        axes=[axis | {"columns": columns}],
        lanes=pack(np.arange(count, dtype=np.int32)) | {"axes": ["point"]},
        run=run,
        family=_branches(ds),
        view=[f"point:{along}"],
    )


def _branches(ds: xr.Dataset) -> Document:
    """Return the branches, split where their stability changes, and the special points on them."""
    stretches: list[Document] = []
    special: list[Document] = []
    kinds, notes = kind_names(ds), ds["special_note"].values.tolist()
    for curve in curves_of(ds):
        branch = curve.branch
        for first, last, stable in runs(stability(ds, branch)):
            points = branch.points[first : last + 1].tolist()
            stretches.append({"colour": curve.colour, "stable": stable, "points": points})
        for index, place in zip(branch.special.tolist(), places(ds, branch).tolist(), strict=True):
            shape = MARK_SHAPES[str(MARKS[kinds[index]]["marker"])]
            special.append({"kind": kinds[index], "point": place, "shape": shape, "note": one_line(notes[index])})
    return {"runs": stretches, "special": special, "kinds": {name: mark["color"] for name, mark in MARKS.items()}}


def family_cells(ds: xr.Dataset) -> Iterator[Cell]:
    """Yield the recorded orbits of families, in the order of their points."""
    point = _base_point(ds)
    scene, count = point.system, ds.sizes["point"]
    driving = scene.driving_part()
    parameters = {name: np.full(count, value) for name, value in point.parameters.items()}
    varied = _family_values(ds) | {along_name(ds): ds[along_name(ds)].values}
    parameters |= {name: np.asarray(x, float) for name, x in varied.items() if name in parameters}
    state = np.zeros((len(scene.states), count))
    for name in driving.return_states:
        state[scene.place(name)] = ds[orbit_name(name)].values
    cycles, period = ds["cycles"].values.astype(int), ds["period"].values
    repeat, skipped = cycles * period, (DRIVEN_RETURNS if driving is not scene else 0) * period
    recorded = skipped + repeat + REPEAT_MARGIN * period
    excerpt = Excerpt(state, np.ones(count, bool), skipped, repeat, recorded, cycles)
    multipliers = np.stack([ds[f"multiplier_{name}"].values for name in ("abs", "arg")], axis=2)
    for index, cell in enumerate(record_cells(scene, parameters, excerpt)):
        own = multipliers[index] if np.isfinite(multipliers[index]).all() else None
        yield replace(cell, lane=index, multipliers=own)


def _family_values(ds: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the coordinates that distinguish families, by name, with one value per point."""
    family = numbers_of(ds, "point")
    names = [str(name) for name, data in ds.coords.items() if data.dims == (FAMILY,) and name != FAMILY]
    return {name: ds[name].values[family] for name in names}


def _base_point(ds: xr.Dataset) -> Point:
    """Return the parameter point with the values that all points share."""
    fixed: dict[str, Any] = {**parameters_of(ds), **options_of(ds)}
    return read_point(Place("explore"), text_of(ds, "scene"), fixed)
