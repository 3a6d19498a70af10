"""Checks of the structure of a dataset: names, coordinates, flags, and consistent dimensions."""

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, printable, shown
from vibrojax.io.kinds import OF_ATTRACTORS, OF_BORDERS, OF_FAMILIES
from vibrojax.io.variables import VARIABLES

LONGEST_NAME = 200
"""Maximum length of a variable name [characters]: column names of a CSV file become variable names, too."""

MOST_CHECKED = 10**7
"""Number of values up to which a variable is checked: a larger variable is read only when it is used."""

LARGEST_COORDINATE = 1e100
"""Bound on the absolute values of coordinates: squares and differences of larger values may overflow."""

_DERIVED = OF_FAMILIES | OF_BORDERS | OF_ATTRACTORS
_KNOWN = VARIABLES | _DERIVED

_DIMENSIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "special_kind": {
        **dict.fromkeys(("branch", "stable", "cycles", "period"), ("point",)),
        **dict.fromkeys(("special_kind", "special_value", "special_branch", "special_note"), ("special",)),
        "multiplier_abs": ("point", "multiplier"),
    },
    "region_area": {"curve": ("vertex",), "kind": ("curve",), "region_area": ("region",)},
    "event_time": {"event_time": ("event",), "event_kind": ("event",)},
}
"""Dimensions of the variables of families, of borders and of a motion's events. The key is the variable whose presence
implies the others."""


def check_structure(ds: xr.Dataset) -> None:
    """Raise `InputError`, with a one-line message that names the variable, if the structure is inconsistent."""
    for name in (*ds.sizes, *ds.variables):
        text = str(name)
        if printable(text) != text or not 0 < len(text) <= LONGEST_NAME:
            raise InputError(f"variable {shown(text)}: the name is not a printable text of 1 to {LONGEST_NAME} letters")
    for name in ds.sizes:
        if name in ds.variables and ds[name].dims == (name,):
            _check_axis(Place(f"coordinate {name}"), ds[name])
    for name, data in ds.variables.items():
        _check_variable(Place(f"variable {name}"), str(name), data)
    for name, dimensions in _DIMENSIONS.items():
        if name in ds:
            _check_dimensions(ds, name, dimensions)
    _check_lanes(ds)


def _check_dimensions(ds: xr.Dataset, of: str, dimensions: dict[str, tuple[str, ...]]) -> None:
    for name, expected in dimensions.items():
        if name not in ds:
            raise InputError(f"variable {name}: is missing; it goes with {of}")
        if ds[name].dims != expected:
            raise InputError(f"variable {name}: its dimensions are {shown(list(ds[name].dims))}, not {shown(expected)}")


def _check_axis(place: Place, data: xr.DataArray) -> None:
    if data.dtype.kind in "fiu":
        if not (np.abs(data.values) < LARGEST_COORDINATE).all():
            raise place.error(f"its values are not all finite numbers below {LARGEST_COORDINATE:g}")
        if data.name == "time":
            rises = data.size < 2 or (data.values[-1] > data.values[0] and (np.diff(data.values) >= 0).all())
            if not rises:
                raise place.error("its values do not rise")
        elif len(np.unique(data.values)) < data.size:
            raise place.error("its values are not all different")
    elif data.dtype.kind not in "UOT":
        raise place.error(f"its values are neither numbers nor names, but {data.dtype}")


def _check_variable(place: Place, name: str, data: xr.Variable) -> None:
    known = _KNOWN.get(name)
    if known is not None and known.dtype is not np.str_ and data.dtype.kind not in "fiu":
        raise place.error(f"its values are not numbers, but {data.dtype}")
    if name in _DERIVED and known is not None and issubclass(known.dtype, np.integer) and data.dtype.kind not in "iu":
        raise place.error(f"its values are not whole numbers, but {data.dtype}")
    meanings = data.attrs.get("flag_meanings")
    if meanings is None:
        return
    if not isinstance(meanings, str):
        raise place.error(f"flag_meanings {shown(meanings)} is not a text")
    flags = np.atleast_1d(data.attrs.get("flag_values", np.arange(len(meanings.split()))))
    if flags.dtype.kind not in "iu" or len(np.unique(flags)) != len(flags) or len(flags) != len(meanings.split()):
        raise place.error(f"flag_values {shown(flags.tolist())} and flag_meanings {shown(meanings)} do not match")
    if data.dtype.kind in "fiu" and data.chunks is None and data.size <= MOST_CHECKED:
        unknown = np.setdiff1d(data.values[~np.isnan(data.values)], flags)
        if unknown.size:
            raise place.error(f"{unknown[0]} is none of its flags {shown(flags.tolist())}")


def _check_lanes(ds: xr.Dataset) -> None:
    """Raise `InputError` if the dimensions of the variables with one value per lane are inconsistent."""
    dims = {name: set(ds[name].dims) - {known.along} for name, known in VARIABLES.items() if name in ds}
    widest = max(dims, key=lambda name: len(dims[name]), default=None)
    for name, own in dims.items():
        if not own <= dims[str(widest)]:
            raise InputError(
                f"variable {name}: its dimensions {shown(sorted(map(str, own)))} are not among "
                f"{shown(sorted(map(str, dims[str(widest)])))}, those of {widest}"
            )
