"""The JSON document and the motions of a dataset for the explorer page.

The analysis of the dataset's kind defines its `view`: a map, families, a single motion, or borders on a map.
"""

from collections.abc import Iterator

import xarray as xr

from vibrojax.analyses.analysis import analysis_of
from vibrojax.analyses.orbits.rerun import has_lanes_of, sweep_of_dataset
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import InputError, shown
from vibrojax.explorer.document import Document, check_names
from vibrojax.explorer.encoding import Cell
from vibrojax.explorer.family_view import family_cells, family_document
from vibrojax.explorer.map_view import curves_document, lane_cells, map_document
from vibrojax.explorer.trajectory_view import cell_of, motion_document
from vibrojax.io.dataset import check_dataset
from vibrojax.sweep.input.definition import Sweep

PAGE_MAX_LANES = 40_000
"""Number of lanes above which a page contains no motions; browsers open a larger file slowly."""

RERUN_MAX_LANE_SECONDS = 4e7
"""Simulated time of all lanes [s] above which a sweep is not run again; it takes about an hour to compute."""


def with_map(
    ds: xr.Dataset, over: xr.Dataset | None = None, progress: bool = True
) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Return the dataset to show and the borders on its map; for borders alone, run their sweep again for the map.

    **Raises:** `InputError` if `ds` is not a dataset, or the sweep of the borders is too large.
    """
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is not a dataset; open it first: vj.open_dataset(PATH)")
    if over is not None or analysis_of(ds).view != "curves":
        return ds, over
    check_dataset(ds)
    sweep = sweep_of_dataset(ds, orbits=False)
    if reason := _rerun_problem(sweep):
        raise InputError(f"explore: the sweep of the borders is not run again: {reason}")
    return run_sweep(sweep, progress=progress), ds


def document_of(ds: xr.Dataset, over: xr.Dataset | None = None, own: Sweep | None = None) -> Document:
    """Return the JSON document of a dataset, in the format described in [vibrojax.explorer][].

    **Arguments:** `over`: borders to draw on the map; `own`: the dataset's sweep, if it contains unnamed objects.

    **Raises:** `InputError` if there is nothing to show, or `over` does not belong to the dataset.
    """
    check_dataset(ds)
    check_names(ds)
    analysis = analysis_of(ds)
    if analysis.view == "none":
        raise InputError(f"explore: {analysis.no_view}")
    if analysis.view in ("families", "motion"):
        if over is not None:
            raise InputError("over: borders need the map of a sweep, which the dataset does not hold")
        return family_document(ds) if analysis.view == "families" else motion_document(ds)
    sweep, problem = sweep_of(ds, own)
    document = map_document(ds, sweep)
    if not document:
        raise InputError("explore: holds nothing over axes that a page could show")
    if over is not None:
        if analysis_of(over).view != "curves":
            raise InputError("over: holds no borders; give the dataset of vibrojax borders")
        document["curves"] = curves_document(ds, over)
    return document | {"without": problem if sweep is None else _motions_problem(ds, sweep)}


def cells_of(ds: xr.Dataset, progress: bool = True, own: Sweep | None = None) -> Iterator[Cell]:
    """Yield the motions of a dataset's lanes, or points, in order; no motions if the page shows none.

    `own`: sweep of the dataset, if it contains objects without a name.
    """
    view = analysis_of(ds).view
    if view == "families":
        yield from family_cells(ds)
    elif view == "motion":
        yield cell_of(ds, 0)
    else:
        sweep, _ = sweep_of(ds, own)
        if sweep is not None and not _motions_problem(ds, sweep):
            yield from lane_cells(sweep, progress)


def sweep_of(ds: xr.Dataset, own: Sweep | None = None) -> tuple[Sweep | None, str]:
    """Return the sweep of a dataset and an empty string, or None and the reason if there is no sweep.

    **Raises:** `InputError` if the dataset does not have the lanes of the sweep `own`.
    """
    if own is not None:
        if not has_lanes_of(ds, own):
            sizes = dict(zip(own.dims, own.shape, strict=True))
            raise InputError(
                f"sweep: its lanes are {sizes}, the dataset's {dict(ds.sizes)}; give the dataset's own sweep"
            )
        return own, ""
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
    seconds = sweep.lanes * (sweep.run.settle + sweep.run.observe)
    if seconds > RERUN_MAX_LANE_SECONDS:
        return f"its motions would take {seconds:.3g} simulated seconds, over {RERUN_MAX_LANE_SECONDS:.3g}"
    return ""
