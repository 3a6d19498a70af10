"""What a page holds of one trajectory: its whole course, thinned, and its last repeat as a cell."""

import numpy as np
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.explorer.document import Document, about, text, variable_document
from vibrojax.explorer.packed import packed
from vibrojax.explorer.run import run_document, shown_duration
from vibrojax.io.attributes import run_of

_BINS = 1200
"""Stretches of time of each of which the least and the greatest value are shown."""


def motion_document(ds: xr.Dataset) -> Document:
    """The document of a trajectory, as `simulate` gives it."""
    names = [str(name) for name, data in ds.data_vars.items() if data.ndim == 0 and data.dtype.kind in "fiu"]
    if not ds.sizes["time"]:
        raise InputError("explore: the motion has no samples")
    run = run_document(ds) | {"duration": shown_duration(float(ds["time"][-1]))}
    return {
        "format": 1,
        "kind": "motion",
        **about(ds),
        "axes": [],
        "variables": [variable_document(ds[name]) | {"map": None} for name in names],
        "maps": {},
        "lanes": packed(np.zeros(1, np.int32)) | {"axes": []},
        "fixed": {},
        "region": None,
        "run": run,
        "curves": None,
        "history": _history(ds),
        "cells": None,
    }


def _history(ds: xr.Dataset) -> Document:
    """All variables along time: of each of some stretches the least and the greatest value, in their order."""
    time = ds["time"].values
    bins = np.array_split(np.arange(len(time)), min(_BINS, len(time)))
    found: list[Document] = []
    at = np.stack([[time[part[0]], time[part[-1]]] for part in bins]).ravel()
    for name, data in ds.data_vars.items():
        if data.dims != ("time",) or data.dtype.kind != "f":
            continue
        rows = np.stack([_ends(data.values[part]) for part in bins]).ravel()
        about_it = {
            "name": str(name),
            "units": text(data.attrs.get("units", "")),
            "long_name": text(data.attrs.get("long_name", "")) or str(name),
        }
        found.append(about_it | {"data": packed(rows)})
    return {"time": packed(at), "columns": found, "observed_from": run_of(ds).get("settle")}


def _ends(values: np.ndarray) -> tuple[float, float]:
    """The least and the greatest value, in the order in which they come."""
    low, high = int(np.argmin(values)), int(np.argmax(values))
    first, last = sorted((low, high))
    return float(values[first]), float(values[last])
