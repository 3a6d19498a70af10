"""What a page holds of a dataset, by what the dataset is: its document, and its cells."""

import json
from collections.abc import Iterator

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, shown
from vibrojax.explorer.cells import Cell
from vibrojax.explorer.document import Document, grid_document
from vibrojax.explorer.motions import motions
from vibrojax.found_orbits import sweep_with_orbits
from vibrojax.input.definition import Sweep

MOST_MOTIONS = 40_000
"""Lanes above which a page holds no motions: it would be larger than a browser likes."""


def document_of(ds: xr.Dataset, over: xr.Dataset | None = None) -> Document:
    """What the page knows of a dataset, as JSON values; see `vibrojax.explorer`."""
    if not isinstance(ds, xr.Dataset):
        raise InputError(f"{shown(ds)} is no dataset; open it first: vj.open_dataset(PATH)")
    document = grid_document(ds, _sweep(ds))
    if not document:
        raise InputError("explore: the dataset holds nothing over axes that a page could show")
    return document


def cells_of(ds: xr.Dataset, progress: bool = True) -> Iterator[Cell]:
    """The motions of a dataset's lanes, or points, in the order of their numbers; none where there are none."""
    sweep = _sweep(ds)
    if sweep is not None and sweep.lanes <= MOST_MOTIONS:
        yield from motions(sweep, progress)


def _sweep(ds: xr.Dataset) -> Sweep | None:
    """The sweep that the dataset's lanes are of, None where they are of none (or of objects that no file names)."""
    if "sweep" not in ds.attrs:
        return None
    try:
        return sweep_with_orbits(ds)
    except InputError:
        return None
