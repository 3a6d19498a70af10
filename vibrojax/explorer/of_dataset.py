"""What a page holds of a dataset, by what the dataset is: its document, and its cells."""

from collections.abc import Iterator

import xarray as xr

from vibrojax.analyses.orbits.rerun import has_lanes_of, sweep_of_dataset
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import InputError, shown
from vibrojax.explorer.cells import Cell
from vibrojax.explorer.document import Document, check_names, curves_document, grid_document
from vibrojax.explorer.families import family_cells, family_document
from vibrojax.explorer.of_lanes import motions
from vibrojax.explorer.single import motion_document
from vibrojax.explorer.trajectory import cell_of
from vibrojax.io.dataset import check_dataset
from vibrojax.io.kinds import kind_of
from vibrojax.sweep.input.definition import Sweep

MOST_MOTIONS = 40_000
"""Lanes above which a page holds no motions: it would be larger than a browser likes."""


MOST_MOTION_SECONDS = 4e7
"""Simulated seconds of all lanes together above which a page holds no motions: about an hour."""


def explored(
    ds: xr.Dataset, over: xr.Dataset | None = None, progress: bool = True
) -> tuple[xr.Dataset, xr.Dataset | None]:
    """The dataset that is shown, and what lies over it: of borders the sweep that they are of, which is run again."""
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is no dataset; open it first: vj.open_dataset(PATH)")
    if over is None and kind_of(ds) == "borders":
        check_dataset(ds)
        sweep = sweep_of_dataset(ds, orbits=False)
        if why := _too_much(sweep):
            raise InputError(f"explore: the sweep of the borders is not run again: {why}")
        return run_sweep(sweep, progress=progress), ds
    return ds, over


def document_of(ds: xr.Dataset, over: xr.Dataset | None = None, own: Sweep | None = None) -> Document:
    """What the page knows of a dataset, as JSON values; see `vibrojax.explorer`.

    **Arguments:** `over`: borders over its map; `own`: the sweep that it is of, where no file names what is in that.

    **Raises:** `InputError` where there is nothing to show, or `over` does not belong there.
    """
    check_dataset(ds)
    check_names(ds)
    kind = kind_of(ds)
    if kind == "accuracy":
        raise InputError("explore: holds speed against error, over no axes; vibrojax plot draws it")
    if kind in ("family", "trajectory"):
        if over is not None:
            raise InputError("over: borders are laid over the map of a sweep, and the dataset is of no sweep")
        return family_document(ds) if kind == "family" else motion_document(ds)
    sweep, why = _sweep(ds, own)
    document = grid_document(ds, sweep)
    if not document:
        raise InputError("explore: holds nothing over axes that a page could show")
    if over is not None:
        if kind_of(over) != "borders":
            raise InputError("over: holds no borders, as vibrojax borders gives them")
        document["curves"] = curves_document(ds, over)
    return document | {"without": _why_not(ds, sweep) if sweep is not None else why}


def cells_of(ds: xr.Dataset, progress: bool = True, own: Sweep | None = None) -> Iterator[Cell]:
    """The motions of a dataset's lanes, or points, in the order of their numbers; none where there are none.

    `own`: the sweep that it is of, where no file names what is in that.
    """
    if kind_of(ds) == "family":
        yield from family_cells(ds)
    elif kind_of(ds) == "trajectory":
        yield cell_of(ds, 0)
    else:
        sweep, _ = _sweep(ds, own)
        if sweep is not None and not _why_not(ds, sweep):
            yield from motions(sweep, progress)


def _why_not(ds: xr.Dataset, sweep: Sweep) -> str:
    """Return why the motions of all lanes are not computed for a page; nothing if they are."""
    if not has_lanes_of(ds, sweep):
        return "the dataset holds other lanes than the sweep that it names, so that it has no motions"
    return _too_much(sweep)


def _too_much(sweep: Sweep) -> str:
    """Return why a sweep is not run again for a page; nothing if it is."""
    if sweep.lanes > MOST_MOTIONS:
        return f"no motions are kept of over {MOST_MOTIONS} lanes"
    seconds = sweep.lanes * (sweep.run.settle + sweep.run.observe)
    if seconds > MOST_MOTION_SECONDS:
        return f"its motions would take {seconds:.3g} simulated seconds, over {MOST_MOTION_SECONDS:.3g}"
    return ""


def _sweep(ds: xr.Dataset, own: Sweep | None) -> tuple[Sweep | None, str]:
    """The sweep that the dataset's lanes are of; none, and why, where no file names it."""
    if own is not None:
        sizes = {name: size for name, size in zip(own.dims, own.shape, strict=True)}
        if any(ds.sizes.get(name) != size for name, size in sizes.items()):
            raise InputError(
                f"sweep: its lanes are {sizes}, and the dataset's {dict(ds.sizes)}; give the one that it is of"
            )
        return own, ""
    if "sweep" not in ds.attrs:
        return None, "the dataset is of no sweep, so that it has no motions"
    try:
        sweep = sweep_of_dataset(ds, orbits=False)
    except InputError as error:
        return None, f"its motions cannot be computed: {str(error).removeprefix('orbits: ')}"
    return sweep, ""
