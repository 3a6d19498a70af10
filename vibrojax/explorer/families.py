"""What a page holds of families of orbits: their points as cells, their branches as lines, their special points."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import Place
from vibrojax.explorer.cells import Cell
from vibrojax.explorer.document import Document, about, coordinate_document, maps_of, reduced, text
from vibrojax.explorer.document import variable_document as described
from vibrojax.explorer.packed import packed
from vibrojax.explorer.recorded import LANES, recorded
from vibrojax.explorer.run import options_of, run_document
from vibrojax.explorer.sampled import Begin
from vibrojax.io.attributes import parameters_of, text_of
from vibrojax.io.branches import FAMILY, along_name, kind_names, numbers_of, places, runs, stability
from vibrojax.io.variables import orbit_name
from vibrojax.periodic.measured import DRIVEN_RETURNS
from vibrojax.plot.branches import MARKS, curves_of
from vibrojax.sweep.input.point import Point, read_point

_SHAPES = {"s": "square", "o": "circle", "*": "diamond", "v": "triangle", "|": "bar", "D": "diamond", "x": "cross"}
_FIRST = ("impact_velocity", "bit_amplitude", "multiplier_abs", "stable", "period")
_DURATION = 2.0  # s, of the command of a cell, which begins on the orbit


def family_document(ds: xr.Dataset) -> Document:
    """The document of families, as `follow` gives them."""
    along, point = along_name(ds), _point(ds)
    count = ds.sizes["point"]
    columns = [coordinate_document(ds[along])]
    of = numbers_of(ds, "point")
    for name, data in ds.coords.items():
        if data.dims == (FAMILY,) and name != FAMILY:
            columns.append(
                coordinate_document(xr.DataArray(data.values[of], dims="point", name=name, attrs=data.attrs))
            )
    scene = point.system.driving_part()
    for name in point.system.start_states:
        known = ds[orbit_name(name)].values if orbit_name(name) in ds else np.zeros(count)
        columns.append(coordinate_document(xr.DataArray(known, dims="point", name=f"start_{name}")) | {"silent": True})
    names = [str(name) for name, data in ds.data_vars.items() if "point" in data.dims and data.dtype.kind in "fiu"]
    names = [name for name in names if name not in (along, "point_family")]
    names = [name for name in _FIRST if name in names] + [name for name in names if name not in _FIRST]
    variables = [described(reduced(ds[name])) for name in names]
    axis = coordinate_document(xr.DataArray(np.arange(count), dims="point", name="point"))
    run = run_document(ds) | {"start": None, "duration": _DURATION}
    if scene is not point.system:
        run["states"] = []
    return {
        "format": 1,
        "kind": "family",
        **about(ds),
        "axes": [axis | {"columns": columns}],
        "variables": variables,
        "maps": maps_of(variables),
        "lanes": packed(np.arange(count, dtype=np.int32)) | {"axes": ["point"]},
        "fixed": {},
        "region": None,
        "run": run,
        "curves": None,
        "family": _branches(ds),
        "view": [f"point:{along}"],
        "cells": None,
    }


def _branches(ds: xr.Dataset) -> Document:
    """The branches as stretches of one stability, and the special points on them."""
    found: list[Document] = []
    special: list[Document] = []
    kinds, notes = kind_names(ds), ds["special_note"].values.tolist()
    for curve in curves_of(ds):
        branch = curve.branch
        for first, last, stable in runs(stability(ds, branch)):
            found.append({"colour": curve.colour, "stable": stable, "points": branch.points[first : last + 1].tolist()})
        for which, place in zip(branch.special.tolist(), places(ds, branch).tolist(), strict=True):
            shape = _SHAPES[str(MARKS[kinds[which]]["marker"])]
            special.append({"kind": kinds[which], "point": place, "shape": shape, "note": text(notes[which])})
    return {"runs": found, "special": special, "kinds": {name: mark["color"] for name, mark in MARKS.items()}}


def family_cells(ds: xr.Dataset) -> Iterator[Cell]:
    """The orbits of families as cells, in the order of their points."""
    point = _point(ds)
    scene, count = point.system, ds.sizes["point"]
    driving = scene.driving_part()
    parameters = {name: np.full(count, value) for name, value in point.parameters.items()}
    of = numbers_of(ds, "point")
    varied = {str(name): data.values[of] for name, data in ds.coords.items() if data.dims == (FAMILY,)}
    varied[along_name(ds)] = ds[along_name(ds)].values
    parameters |= {name: np.asarray(x, float) for name, x in varied.items() if name in parameters}
    state = np.zeros((len(scene.states), count))
    for name in driving.return_states:
        state[scene.place(name)] = ds[orbit_name(name)].values
    cycles, period = ds["cycles"].values.astype(int), ds["period"].values
    duration = cycles * period
    before = (DRIVEN_RETURNS if driving is not scene else 0) * period
    begin = Begin(state, np.ones(count, bool), before, duration, before + duration + 1e-3 * period, cycles)
    multipliers = np.stack([ds[f"multiplier_{name}"].values for name in ("abs", "arg")], axis=2)
    for first in range(0, count, LANES):
        some = np.arange(first, min(first + LANES, count))
        part = Begin(*(x[..., some] for x in begin))
        for lane, cell in zip(some, recorded(scene, {n: x[some] for n, x in parameters.items()}, part), strict=True):
            known = multipliers[lane] if np.isfinite(multipliers[lane]).all() else None
            yield replace(cell, lane=int(lane), multipliers=known)


def _point(ds: xr.Dataset) -> Point:
    """What is the same for all points."""
    given: dict[str, Any] = {**parameters_of(ds), **options_of(ds)}
    return read_point(Place("explore"), text_of(ds, "scene"), given)
