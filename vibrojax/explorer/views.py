"""Contents of the explorer page of a dataset: its JSON document, and its motions.

The analysis of the dataset's kind states the `view`: a map, families, a single motion, curves on a map, or plots.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, shown
from vibrojax.explorer import document
from vibrojax.explorer.document import Document
from vibrojax.explorer.encoding import Cell, pack
from vibrojax.explorer.map_view import REPEAT_MARGIN, lane_cells, map_document, overlay_document
from vibrojax.explorer.plots_view import figure_document
from vibrojax.explorer.recording import Excerpt, cell_of, record_cells
from vibrojax.io.attributes import flags, parameters_of, run_of, text_of
from vibrojax.io.dataset import check_dataset
from vibrojax.io.kinds import kind_of
from vibrojax.io.runs import with_events
from vibrojax.io.variables import orbit_name
from vibrojax.maps.read import Point, read_point
from vibrojax.maps.rerun import at_coordinates, has_lanes_of, rerun_problem, sweep_of_dataset
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep, with_substitutes
from vibrojax.periodic.measuring import DRIVEN_RETURNS
from vibrojax.pictures import branches
from vibrojax.pictures.axes import symbols_of, value_text
from vibrojax.pictures.branches import MARKS
from vibrojax.pictures.contents import FORM, POINT, START, is_numeric, long_axes
from vibrojax.pictures.overlays import axes_of
from vibrojax.pictures.starts import described
from vibrojax.progress import LOG
from vibrojax.scenes import SCENES
from vibrojax.studies.analysis import SummaryPart, analysis_of

PAGE_MAX_LANES = 40_000  # number of lanes above which a page contains no motions; browsers open a larger file slowly
MAP_LEAST_POINTS = 8  # points of a list below which they are chosen in the plots of their analysis, without a map
HISTORY_BINS = 1200  # time intervals of which the extremes are shown: one per pixel of a wide plot


class Contents(NamedTuple):
    """Contents of a page: the dataset, its JSON document, and its motions, which are computed as they are iterated."""

    dataset: xr.Dataset
    document: Document
    cells: Iterable[Cell]


def contents_of(
    ds: xr.Dataset, over: xr.Dataset | None = None, own: Sweep | None = None, progress: bool = True
) -> Contents:
    """Return what the page of a dataset shows; for borders alone, run their sweep again for the map below them.

    **Arguments:** `over`: borders or curves to draw on the map; `own`: the dataset's sweep, if it contains unnamed
    objects.

    **Raises:** `InputError` if there is nothing to show, or `over` does not belong to the dataset.
    """
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is not a dataset; open it first: vj.open_dataset(PATH)")
    check_dataset(ds)
    view = analysis_of(ds).view_of(ds)
    if view == "curves" and over is None:
        sweep = sweep_of_dataset(ds, orbits=False)
        if reason := _rerun_problem(sweep):
            raise InputError(f"explore: the sweep of the borders is not run again: {reason}")
        over, ds = ds, run_sweep(sweep, progress=progress)
        view = analysis_of(ds).view_of(ds)
    document.check_names(ds)
    if over is not None:
        if view in ("families", "orbits", "motion", "plots"):
            raise InputError("over: borders and curves need the map of a sweep, which the dataset does not hold")
        check_dataset(over)
    cells: Iterable[Cell] = ()
    if view == "motion":
        page, cells = _motion_document(ds), map(cell_of, [ds], [0])
    elif view == "families":
        ds = branches.with_selected_families(ds)
        page, cells = family_document(ds), orbit_cells(ds)
        page["figure"] = _picture_document(ds, page)
    elif view == "orbits" and text_of(ds, "scene") in SCENES:
        page, cells = curves_document(ds), orbit_cells(ds)
    elif (held := analysis_of(ds).page_cells(ds)) is not None:
        page = map_document(*held)
        page["figure"] = figure_document(analysis_of(ds).plots(ds), held[0], page["axes"], maps=True)
        few = held[0].sizes.get(POINT, MAP_LEAST_POINTS) < MAP_LEAST_POINTS and "sign" not in held[0].dims
        if held[1] is None or few:
            page["map"] = False
        if held[1] is not None:
            page["without"] = _rerun_problem(held[1])
            cells = lane_cells(held[1], progress)
    else:
        page, cells = _map_contents(ds, over, own, progress) if view not in ("plots", "orbits") else ({}, ())
        if not page:
            try:
                figure = figure_document(analysis_of(ds).plots(ds), ds, [])
            except InputError as error:
                raise InputError(f"explore: {error}") from None
            page = document.document_with(ds, "plots", _numbers(ds), figure=figure, without="")
    return Contents(ds, page | {"summary": summary_parts(ds)}, cells)


def _map_contents(
    ds: xr.Dataset, over: xr.Dataset | None, own: Sweep | None, progress: bool
) -> tuple[Document, Iterable[Cell]]:
    """Return the document and the motions of a dataset over axes; the document is empty if no variable can be shown."""
    sweep, problem = sweep_of(ds, own)
    page = map_document(ds, sweep)
    if sweep is not None:
        others = "the dataset holds other lanes than the sweep that it names, and therefore no motions"
        problem = _rerun_problem(sweep) if has_lanes_of(ds, sweep) else others
    cells = lane_cells(sweep, progress) if sweep is not None and not problem else ()
    if page:
        page |= {"without": problem} | (overlay_document(ds, over) if over is not None else {})
        # A map over two parameters is drawn by the page; what else the picture shows is added.
        is_map = kind_of(ds) == "sweep" and (len(long_axes(ds)) >= 2 or len(page["axes"][0]["columns"] or ()) >= 2)
        page["figure"] = None if is_map else _picture_document(ds, page)
    return page, cells


def _picture_document(ds: xr.Dataset, page: Document) -> Document | None:
    """Return the description of the dataset's picture without what the page draws itself; None without a picture.

    The page of a dataset that its picture does not fit is complete without it.
    """
    drawn = [page["variables"][0]["name"]]
    try:
        lanes = described(ds) if START in ds.dims else ds
        figure = figure_document(analysis_of(ds).plots(ds), lanes, page["axes"], drawn)
    except Exception as error:
        LOG.info("explore: no picture: %s", error)
        return None
    # The legend of the map has these.
    coloured = drawn == ["regime"] or "inner" in page["variables"][0]
    known = set(document.REGIME_MEANINGS) if coloured else set()
    known = {"stable", "unstable", *document.BORDER_MEANINGS} if page["kind"] == "family" else known
    figure["keys"] = [key for key in figure["keys"] if key["text"].split(" ")[0] not in known]
    return figure if figure["plots"] or figure["images"] else None


def _numbers(ds: xr.Dataset) -> list[Document]:
    numbers = [data for data in ds.data_vars.values() if data.ndim == 0 and data.dtype.kind in "fiu"]
    return [document.variable_document(data) | {"map": None} for data in numbers]


def _motion_document(ds: xr.Dataset) -> Document:
    if not ds.sizes["time"]:
        raise InputError("explore: the motion has no samples")
    along = [data.values for data in ds.data_vars.values() if "time" in data.dims and data.dtype.kind == "f"]
    if any(np.isinf(values).any() for values in along):
        raise InputError("explore: the motion has values that are not finite")
    run = document.run_document(ds) | {"duration": document.command_seconds(float(ds["time"][-1]))}
    lanes = pack(np.zeros(1, np.int32)) | {"axes": []}
    # All variables along time, reduced to the two extremes in each time interval, in order of time.
    time, data = with_events(ds)
    bins = np.array_split(np.arange(len(time)), min(HISTORY_BINS, len(time)))
    columns: list[Document] = []
    for name, x in data.items():
        extremes = [sorted((part[np.argmin(x.values[part])], part[np.argmax(x.values[part])])) for part in bins]
        units, long_name = (document.one_line(x.attrs.get(key, "")) for key in ("units", "long_name"))
        column = pack(x.values[np.ravel(extremes)].astype(float))
        columns.append({"name": name, "units": units, "long_name": long_name or name, "data": column})
    ends = np.ravel([[time[part[0]], time[part[-1]]] for part in bins])
    history = {"time": pack(ends), "columns": columns, "observed_from": run_of(ds).get("settle")}
    return document.document_with(ds, "motion", _numbers(ds), lanes=lanes, run=run, history=history)


def summary_parts(ds: xr.Dataset) -> list[Document]:
    """Return the parts of the analysis's summary with their lines of text; empty if it does not fit the dataset."""
    try:
        parts = analysis_of(ds).page_text(ds)
    except Exception as error:
        LOG.info("explore: no summary: %s", error)
        return []
    signs = {name: sign for name, sign in symbols_of(ds).items() if not sign.isascii()}
    names = re.compile(rf"\b({'|'.join(signs) or '(?!)'})\b")

    def lines(part: SummaryPart) -> list[str]:
        whole = (_with_values(document.one_line(line), ds) for line in part.lines[:200])
        texts = (names.sub(lambda name: signs[name[0]], line) for line in whole)
        minus = (re.sub(r"(?<![\w)−-])-(?=\d)", "−", text) for text in texts)
        return ["  " * line.startswith(" ") + text for line, text in zip(part.lines, minus, strict=False)]

    return [{"name": part.name, "lines": lines(part)} for part in parts if part.lines]


def _with_values(line: str, ds: xr.Dataset) -> str:
    """Return a line in which values of coordinates with their units are as in pictures: k₃ = 100 MN/m."""
    for name, data in ds.coords.items():
        if is_numeric(data) and (unit := re.escape(str(data.attrs.get("units", "")))):
            value = re.compile(rf"\b{name}=(-?[\d.]+(?:e[+-]?\d+)?) {unit}(?!\S?\w)")
            for found in [*value.finditer(line)]:
                line = line.replace(found[0], value_text(data, float(found[1])))
    return line


def sweep_of(ds: xr.Dataset, own: Sweep | None = None) -> tuple[Sweep | None, str]:
    """Return the sweep of a dataset and an empty string, or None and the reason if it has none.

    **Raises:** `InputError` if the dataset does not have the lanes of the sweep `own`.
    """
    if own is not None:
        own = at_coordinates(own, ds.coords)
        if not has_lanes_of(ds, own):
            lanes = f"{dict(zip(own.dims, own.shape, strict=True))}, the dataset's {dict(ds.sizes)}"
            raise InputError(f"sweep: its lanes are {lanes}; give the dataset's own sweep")
        return own, ""
    if FORM in ds.dims:
        return None, "a fit has no motions" + ("; the page of its sweep has them" if "sweep" in ds.attrs else "")
    if "sweep" not in ds.attrs:
        return None, "the dataset has no sweep, and therefore no motions"
    try:
        return sweep_of_dataset(ds, orbits=False), ""
    except InputError as error:
        own_system = "its system is known only to the Python session that defined it: pass its sweep to vj.write_page"
        known = f"its motions cannot be computed: {str(error).removeprefix('orbits: ')}"
        return None, known if text_of(ds, "scene") in SCENES else own_system


def _rerun_problem(sweep: Sweep) -> str:
    """Return the reason why a sweep is not run again for a page, or an empty string if it is."""
    if sweep.lanes > PAGE_MAX_LANES:
        return f"a page keeps the motions of at most {PAGE_MAX_LANES} lanes"
    problem = rerun_problem(sweep)
    return f"its sweep has {problem}" if problem else ""


LEADING_ORBIT_VARIABLES = ("impact_velocity", "bit_amplitude", "multiplier_abs", "stable", "period")


def family_document(ds: xr.Dataset) -> Document:
    """Return the JSON document of families, given the dataset of `follow`."""
    family = _branches(ds)
    # The middle of the longest stable stretch, or of the longest one if none is stable.
    longest = max(family["runs"], key=lambda run: (run["stable"] == 1, len(run["points"])), default={"points": [0]})
    middle = int(longest["points"][len(longest["points"]) // 2])
    return _orbits_document(ds, family=family, view=[f"point:{branches.along_name(ds)}"], first={"point": middle})


def curves_document(ds: xr.Dataset) -> Document:
    """Return the JSON document of curves of special points; each point is the orbit at which the motion changes."""
    kinds = flags(ds["kind"])
    names = [f"{k} ({kinds[int(ds['kind'][k])]})" for k in ds["point_curve"].values.tolist()]
    curve = document.coordinate_document(xr.DataArray(names, dims="point", name="curve"))
    page = _orbits_document(ds, [curve], map=False, first={"point": int((ds["point_curve"] == 0).sum()) // 2})
    page["figure"] = figure_document(analysis_of(ds).plots(ds), ds, page["axes"], maps=True)
    return page


def _orbits_document(ds: xr.Dataset, names: Sequence[Document] = (), **parts: object) -> Document:
    """Return the JSON document of periodic orbits along `point`; `names`: descriptions of columns of names."""
    point, count, varied = _base_point(ds), ds.sizes["point"], _varied(ds)
    columns = [
        document.coordinate_document(xr.DataArray(values, dims="point", name=name, attrs=ds[name].attrs))
        for name, values in varied.items()
    ]
    for name in point.system.start_states:
        values = ds[orbit_name(name)].values if orbit_name(name) in ds else np.zeros(count)
        column = xr.DataArray(values, dims="point", name=f"start_{name}")
        columns.append(document.coordinate_document(column) | {"silent": True})
    of_points = [str(name) for name, data in ds.data_vars.items() if "point" in data.dims and data.dtype.kind in "fiu"]
    of_points = [name for name in of_points if name not in varied and not name.startswith("point_")]
    of_points = [name for name in LEADING_ORBIT_VARIABLES if name in of_points] + of_points
    axis = document.coordinate_document(xr.DataArray(np.arange(count), dims="point", name="point"))
    # The command starts on the orbit, so no settling time is needed.
    run = document.run_document(ds) | {"start": None, "duration": 2.0}
    if point.system.driving_part() is not point.system:
        run["states"] = []
    return document.document_with(
        ds,
        "family",
        [document.variable_document(ds[name]) for name in dict.fromkeys(of_points)],
        axes=[axis | {"columns": [*columns, *names]}],
        lanes=pack(np.arange(count, dtype=np.int32)) | {"axes": ["point"]},
        run=run,
        **parts,
    )


def _varied(ds: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the parameters that vary along families or curves of orbits: their values at each point by name."""
    if kind_of(ds) == "curves":
        return {name: ds[name].values for name in axes_of(ds)}
    return {branches.along_name(ds): ds[branches.along_name(ds)].values} | branches.family_coordinates(ds, "point")


def _branches(ds: xr.Dataset) -> Document:
    """Return the branches, split where their stability changes, and the special points on them."""
    stretches: list[Document] = []
    special: list[Document] = []
    kinds, notes = branches.kind_names(ds), ds["special_note"].values.tolist()
    for branch in branches.branches(ds):
        for first, last, stable in branches.runs(branches.stability(ds, branch)):
            points = branch.points[first : last + 1].tolist()
            stretches.append({"colour": branch.colour, "stable": stable, "points": points})
        for index, place in zip(branch.special.tolist(), branches.places(ds, branch).tolist(), strict=True):
            look = {"shape": str(branches.mark_of(kinds[index])["marker"]), "note": document.one_line(notes[index])}
            special.append({"kind": kinds[index], "point": place} | look)
    colours = {name: branches.mark_of(name)["colour"] for name in (*MARKS, *kinds)}
    return {"runs": stretches, "special": special, "kinds": colours}


def orbit_cells(ds: xr.Dataset) -> Iterator[Cell]:
    """Yield the recorded orbits of families or curves, in the order of their points."""
    point = _base_point(ds)
    scene, count = point.system, ds.sizes["point"]
    driving = scene.driving_part()
    values = with_substitutes(scene, point.parameters | _varied(ds))
    parameters = {name: np.broadcast_to(values[name], count).astype(float) for name in point.parameters}
    state = np.zeros((len(scene.states), count))
    for name in driving.return_states:
        state[scene.place(name)] = ds[orbit_name(name)].values
    cycles, period = ds["cycles"].values.astype(int), ds["period"].values
    begin = (DRIVEN_RETURNS if driving is not scene else 0) * period
    recorded = begin + (cycles + REPEAT_MARGIN) * period
    excerpt = Excerpt(np.ones(count, bool), begin, cycles * period, begin, recorded, cycles)
    multipliers = np.stack([ds[f"multiplier_{name}"].values for name in ("abs", "arg")], axis=2)
    for index, cell in enumerate(record_cells(scene, parameters, state, excerpt)):
        own = multipliers[index] if np.isfinite(multipliers[index]).all() else None
        yield replace(cell, lane=index, multipliers=own)


def _base_point(ds: xr.Dataset) -> Point:
    fixed: dict[str, Any] = {**parameters_of(ds), **document.options_of(ds)}
    return read_point(Place("explore"), text_of(ds, "scene"), fixed)
