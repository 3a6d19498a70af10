"""The explorer's view of families: branches with their special points, and the orbits of all points."""

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
from vibrojax.io.variables import orbit_name
from vibrojax.maps.read import Point, read_point
from vibrojax.maps.sweep import with_substitutes
from vibrojax.periodic.measuring import DRIVEN_RETURNS
from vibrojax.pictures.branches import (
    MARKS,
    along_name,
    branches,
    family_coordinates,
    kind_names,
    mark_of,
    places,
    runs,
    stability,
)

LEADING_ORBIT_VARIABLES = ("impact_velocity", "bit_amplitude", "multiplier_abs", "stable", "period")


def family_document(ds: xr.Dataset) -> Document:
    """Return the JSON document of families, given the dataset of `follow`."""
    along, point, count = along_name(ds), _base_point(ds), ds.sizes["point"]
    columns = [coordinate_document(ds[along])]
    for name, values in family_coordinates(ds, "point").items():
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
    family = _branches(ds)
    # The middle of the longest stable stretch, or of the longest one if none is stable.
    longest = max(family["runs"], key=lambda run: (run["stable"] == 1, len(run["points"])), default={"points": [0]})
    return document_with(
        ds,
        "family",
        variables,
        axes=[axis | {"columns": columns}],
        lanes=pack(np.arange(count, dtype=np.int32)) | {"axes": ["point"]},
        run=run,
        family=family,
        view=[f"point:{along}"],
        first={"point": int(longest["points"][len(longest["points"]) // 2])},
    )


def _branches(ds: xr.Dataset) -> Document:
    """Return the branches, split where their stability changes, and the special points on them."""
    stretches: list[Document] = []
    special: list[Document] = []
    kinds, notes = kind_names(ds), ds["special_note"].values.tolist()
    for branch in branches(ds):
        for first, last, stable in runs(stability(ds, branch)):
            points = branch.points[first : last + 1].tolist()
            stretches.append({"colour": branch.colour, "stable": stable, "points": points})
        for index, place in zip(branch.special.tolist(), places(ds, branch).tolist(), strict=True):
            look = {"shape": str(mark_of(kinds[index])["marker"]), "note": one_line(notes[index])}
            special.append({"kind": kinds[index], "point": place} | look)
    colours = {name: mark_of(name)["colour"] for name in (*MARKS, *kinds)}
    return {"runs": stretches, "special": special, "kinds": colours}


def family_cells(ds: xr.Dataset) -> Iterator[Cell]:
    """Yield the recorded orbits of families, in the order of their points."""
    point = _base_point(ds)
    scene, count = point.system, ds.sizes["point"]
    driving = scene.driving_part()
    varied = family_coordinates(ds, "point") | {along_name(ds): ds[along_name(ds)].values}
    values = with_substitutes(scene, point.parameters | varied)
    parameters = {name: np.broadcast_to(values[name], count).astype(float) for name in point.parameters}
    state = np.zeros((len(scene.states), count))
    for name in driving.return_states:
        state[scene.place(name)] = ds[orbit_name(name)].values
    cycles, period = ds["cycles"].values.astype(int), ds["period"].values
    repeat, skipped = cycles * period, (DRIVEN_RETURNS if driving is not scene else 0) * period
    recorded = skipped + repeat + REPEAT_MARGIN * period
    begin = np.full(count, skipped)
    excerpt = Excerpt(np.ones(count, bool), begin, repeat, begin, recorded, cycles)
    multipliers = np.stack([ds[f"multiplier_{name}"].values for name in ("abs", "arg")], axis=2)
    for index, cell in enumerate(record_cells(scene, parameters, state, excerpt)):
        own = multipliers[index] if np.isfinite(multipliers[index]).all() else None
        yield replace(cell, lane=index, multipliers=own)


def _base_point(ds: xr.Dataset) -> Point:
    """Return the parameter point with the values that all points share."""
    fixed: dict[str, Any] = {**parameters_of(ds), **options_of(ds)}
    return read_point(Place("explore"), text_of(ds, "scene"), fixed)
