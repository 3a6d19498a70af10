"""The JSON document and the motions of a dataset for the explorer page.

The analysis of the dataset's kind defines its `view`: a map, families, a single motion, or borders on a map. Families
are shown as branches with their special points, and the orbits of all points.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, shown
from vibrojax.explorer.document import (
    BORDER_MEANINGS,
    REGIME_MEANINGS,
    Document,
    check_names,
    coordinate_document,
    document_with,
    one_line,
    options_of,
    run_document,
    variable_document,
)
from vibrojax.explorer.encoding import Cell, pack
from vibrojax.explorer.map_view import REPEAT_MARGIN, lane_cells, map_document, overlay_document
from vibrojax.explorer.plots_view import figure_document
from vibrojax.explorer.recording import Excerpt, cell_of, motion_document, record_cells
from vibrojax.io.attributes import parameters_of, text_of
from vibrojax.io.dataset import check_dataset
from vibrojax.io.kinds import kind_of
from vibrojax.io.variables import orbit_name
from vibrojax.maps.read import Point, read_point
from vibrojax.maps.rerun import at_coordinates, has_lanes_of, rerun_problem, sweep_of_dataset
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep, with_substitutes
from vibrojax.periodic.measuring import DRIVEN_RETURNS
from vibrojax.pictures.axes import symbols_of
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
    with_selected_families,
)
from vibrojax.pictures.contents import FORM, START, long_axes
from vibrojax.pictures.starts import described
from vibrojax.progress import LOG
from vibrojax.studies.analysis import analysis_of

PAGE_MAX_LANES = 40_000
"""Number of lanes above which a page contains no motions; browsers open a larger file slowly."""


def with_map(
    ds: xr.Dataset, over: xr.Dataset | None = None, progress: bool = True
) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Return the dataset to show and the borders on its map; for borders alone, run their sweep again for the map.

    **Raises:** `InputError` if `ds` is not a dataset, or the sweep of the borders is too large.
    """
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is not a dataset; open it first: vj.open_dataset(PATH)")
    view = analysis_of(ds).view_of(ds)
    if view == "families":
        check_dataset(ds)
        ds = with_selected_families(ds)
    if over is not None or view != "curves":
        return ds, over
    check_dataset(ds)
    sweep = sweep_of_dataset(ds, orbits=False)
    if reason := _rerun_problem(sweep):
        raise InputError(f"explore: the sweep of the borders is not run again: {reason}")
    return run_sweep(sweep, progress=progress), ds


def document_of(ds: xr.Dataset, over: xr.Dataset | None = None, own: Sweep | None = None) -> Document:
    """Return the JSON document of a dataset, in the format described in [vibrojax.explorer][].

    **Arguments:** `over`: borders or curves to draw on the map; `own`: the dataset's sweep, if it contains unnamed
    objects.

    **Raises:** `InputError` if there is nothing to show, or `over` does not belong to the dataset.
    """
    check_dataset(ds)
    check_names(ds)
    view = analysis_of(ds).view_of(ds)
    if view in ("families", "motion", "plots") and over is not None:
        raise InputError("over: borders and curves need the map of a sweep, which the dataset does not hold")
    parts = summary_parts(ds)
    if view == "motion":
        return motion_document(ds) | {"summary": parts}
    if view == "families":
        document = family_document(ds)
        return document | {"summary": parts, "figure": picture_document(ds, document)}
    if (lanes := analysis_of(ds).page_lanes(ds)) is not None:
        own_map = map_document(*lanes)
        plots = figure_document(analysis_of(ds).page_figures(ds), ds, own_map["axes"], maps=True)
        return own_map | {"without": _rerun_problem(lanes[1]), "summary": parts, "figure": plots}
    sweep, problem = (None, "") if view == "plots" else sweep_of(ds, own)
    document = {} if view == "plots" else map_document(ds, sweep)
    if not document:
        return plots_document(ds) | {"summary": parts}
    if over is not None:
        check_dataset(over)
        document |= overlay_document(ds, over)
    # A map over two parameters is drawn by the page; what else the picture shows is added.
    is_map = len(long_axes(ds)) >= 2 and kind_of(ds) == "sweep"
    figure = None if is_map else picture_document(ds, document)
    no_motions = problem if sweep is None else _motions_problem(ds, sweep)
    return document | {"without": no_motions, "summary": parts, "figure": figure}


def picture_document(ds: xr.Dataset, document: Document) -> Document | None:
    """Return the description of the dataset's picture without what the page draws itself; None without a picture.

    The page of a dataset that its picture does not fit is complete without it.
    """
    drawn = [document["variables"][0]["name"]]
    try:
        figure = figure_document(
            analysis_of(ds).page_figures(ds), described(ds) if START in ds.dims else ds, document["axes"], drawn
        )
    except Exception as error:
        LOG.info("explore: no picture: %s", error)
        return None
    # The legend of the map has these.
    known = {"stable", "unstable", *BORDER_MEANINGS} if document["kind"] == "family" else set(REGIME_MEANINGS)
    figure["keys"] = [key for key in figure["keys"] if key["text"].split(" ")[0] not in known]
    return figure if figure["plots"] or figure["images"] else None


def plots_document(ds: xr.Dataset) -> Document:
    """Return the JSON document of a dataset that its analysis shows as plots and a summary.

    **Raises:** `InputError` if there is no picture.
    """
    try:
        figure = figure_document(analysis_of(ds).page_figures(ds), ds, [])
    except InputError as error:
        raise InputError(f"explore: {error}") from None
    names = [str(name) for name, data in ds.data_vars.items() if data.ndim == 0 and data.dtype.kind in "fiu"]
    variables = [variable_document(ds[name]) | {"map": None} for name in names]
    return document_with(ds, "plots", variables, figure=figure, view=[], without="")


def summary_parts(ds: xr.Dataset) -> list[Document]:
    """Return the parts of the analysis's summary with their lines of text; empty if it does not fit the dataset."""
    try:
        parts = analysis_of(ds).page_text(ds)
    except Exception as error:
        LOG.info("explore: no summary: %s", error)
        return []
    greek = {name: sign for name, sign in symbols_of(ds).items() if len(sign) == 1 and not sign.isascii()}
    names = re.compile(rf"\b({'|'.join(greek) or '(?!)'})\b")
    lines = {
        part.name: [names.sub(lambda name: greek[name[0]], one_line(line)) for line in part.lines] for part in parts
    }
    return [{"name": name, "lines": text[:200]} for name, text in lines.items() if text]


def cells_of(ds: xr.Dataset, progress: bool = True, own: Sweep | None = None) -> Iterator[Cell]:
    """Yield the motions of a dataset's lanes, or points, in order; no motions if the page shows none.

    `own`: sweep of the dataset, if it contains objects without a name.
    """
    view = analysis_of(ds).view_of(ds)
    if view == "families":
        yield from family_cells(ds)
    elif view == "motion":
        yield cell_of(ds, 0)
    elif (lanes := analysis_of(ds).page_lanes(ds)) is not None:
        yield from lane_cells(lanes[1], progress)
    else:
        sweep, _ = sweep_of(ds, own)
        if sweep is not None and not _motions_problem(ds, sweep):
            yield from lane_cells(sweep, progress)


def sweep_of(ds: xr.Dataset, own: Sweep | None = None) -> tuple[Sweep | None, str]:
    """Return the sweep of a dataset and an empty string, or None and the reason if it has none.

    **Raises:** `InputError` if the dataset does not have the lanes of the sweep `own`.
    """
    if own is not None:
        own = at_coordinates(own, ds.coords)
        if not has_lanes_of(ds, own):
            sizes = dict(zip(own.dims, own.shape, strict=True))
            raise InputError(
                f"sweep: its lanes are {sizes}, the dataset's {dict(ds.sizes)}; give the dataset's own sweep"
            )
        return own, ""
    if FORM in ds.dims:
        return None, "a fit has no motions" + ("; the page of its sweep has them" if "sweep" in ds.attrs else "")
    if "sweep" not in ds.attrs:
        return None, "the dataset has no sweep, and therefore no motions"
    try:
        return sweep_of_dataset(ds, orbits=False), ""
    except InputError as error:
        return None, f"its motions cannot be computed: {str(error).removeprefix('orbits: ')}"


def _motions_problem(ds: xr.Dataset, sweep: Sweep) -> str:
    """Return the reason why a page has no motions, or an empty string if it has motions."""
    if not has_lanes_of(ds, sweep):
        return "the dataset holds other lanes than the sweep that it names, and therefore no motions"
    return _rerun_problem(sweep)


def _rerun_problem(sweep: Sweep) -> str:
    """Return the reason why a sweep is not run again for a page, or an empty string if it is."""
    if sweep.lanes > PAGE_MAX_LANES:
        return f"a page keeps the motions of at most {PAGE_MAX_LANES} lanes"
    problem = rerun_problem(sweep)
    return f"its sweep has {problem}" if problem else ""


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
    excerpt = Excerpt(state, np.ones(count, bool), skipped, repeat, recorded, cycles)
    multipliers = np.stack([ds[f"multiplier_{name}"].values for name in ("abs", "arg")], axis=2)
    for index, cell in enumerate(record_cells(scene, parameters, excerpt)):
        own = multipliers[index] if np.isfinite(multipliers[index]).all() else None
        yield replace(cell, lane=index, multipliers=own)


def _base_point(ds: xr.Dataset) -> Point:
    """Return the parameter point with the values that all points share."""
    fixed: dict[str, Any] = {**parameters_of(ds), **options_of(ds)}
    return read_point(Place("explore"), text_of(ds, "scene"), fixed)
