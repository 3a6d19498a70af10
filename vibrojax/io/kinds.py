"""Kinds of datasets: their attributes, derived variables, and checks of names, coordinates, flags and dimensions."""

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, printable, shown
from vibrojax.io.provenance import provenance
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.measures.labels import REGIMES

KIND = "kind"
"""Name of the attribute that states which analysis made a dataset."""

LONGEST_KIND = 60
"""Maximum length of a kind [characters]: a kind is also the name of a command."""

STRUCTURES: dict[str, Callable[[xr.Dataset], bool]] = {
    "trajectory": lambda ds: "time" in ds.dims,
    "family": lambda ds: {"special_kind", "branch", str(ds.attrs.get("along", ""))} <= set(ds.variables),
    "borders": lambda ds: {"curve", "kind", "region_area"} <= set(ds.variables) and "axes" in ds.attrs,
    "attractors": lambda ds: {"share", "share_stderr", "lane_attractor"} <= set(ds.variables),
    "push": lambda ds: "sign" in ds.dims and any(str(name).startswith("push_") for name in ds.data_vars),
    "tolerance": lambda ds: "sample" in ds.dims and "place" in ds and "regime" in ds,
    "sensitivity": lambda ds: {"valid", "reason", "parameter_value"} <= set(ds.variables) and "parameter" in ds.dims,
