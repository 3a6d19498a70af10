"""Kinds of datasets: their attributes, derived variables, and checks of names, coordinates, flags and dimensions."""

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, printable, shown
from vibrojax.io.files import provenance
from vibrojax.io.variables import REGIMES, VARIABLES, Variable

KIND = "kind"
"""Name of the attribute that states which analysis made a dataset."""

LONGEST_KIND = 60
"""Maximum length of a kind [characters]: a kind is also the name of a command."""

STRUCTURES: dict[str, Callable[[xr.Dataset], bool]] = {
    "trajectory": lambda ds: "time" in ds.dims,
    "family": lambda ds: {"special_kind", "branch", str(ds.attrs.get("along", ""))} <= set(ds.variables),
    "borders": lambda ds: {"curve", "kind", "region_area"} <= set(ds.variables) and "axes" in ds.attrs,
    "curves": lambda ds: {"point_curve", "kind", "special", "curve_note"} <= set(ds.variables) and "axes" in ds.attrs,
    "attractors": lambda ds: {"share", "share_stderr", "lane_attractor"} <= set(ds.variables),
    "push": lambda ds: "sign" in ds.dims and any(str(name).startswith("push_") for name in ds.data_vars),
    "tolerance": lambda ds: "sample" in ds.dims and "place" in ds and "regime" in ds,
    "sensitivity": lambda ds: {"valid", "reason", "parameter_value"} <= set(ds.variables) and "parameter" in ds.dims,
    "study": lambda ds: {"first_order", "total_order", "effect"} <= set(ds.variables) and "of" in ds.dims,
    "rig": lambda ds: {"founder_weight", "founder_reason", "specific_energy"} <= set(ds.variables),
    "calibration": lambda ds: {"estimate", "posterior", "direction", "residual"} <= set(ds.variables),
    "design": lambda ds: "candidate" in ds.dims and {"objective", "parameter"} <= set(ds.variables),
    "accuracy": lambda ds: "setting" in ds.dims and "error_worst" in ds,
}
"""The structure that pictures and summaries of each kind require."""

_RECOGNISED = STRUCTURES | {
    "fit": lambda ds: ("C" in ds and "form" in ds["C"].dims) or "columns" in ds.attrs,
    "sweep": lambda ds: not {"regime", "status", "rate_of_penetration"}.isdisjoint(ds.variables),
}
"""The structure that identifies the kind of a dataset without the attribute. The first match is used."""


def kind_of(ds: xr.Dataset) -> str:
    """Return the kind of a dataset: its attribute, else the first kind whose structure matches, else "".

    If the variables of the stated kind are missing, say after a selection of variables, only the structure is used.
    """
    kind = str(ds.attrs.get(KIND, ""))
    if kind and STRUCTURES.get(kind, lambda _: True)(ds):
        return kind
    return next((name for name, has_structure in _RECOGNISED.items() if has_structure(ds)), "")


def check_kind(ds: xr.Dataset) -> None:
    """Raise `InputError` if the attribute `kind` is not a short string, or the structure of that kind is missing."""
    kind = ds.attrs.get(KIND, "")
    if not isinstance(kind, str) or printable(kind, LONGEST_KIND) != kind:
        raise InputError(f"attribute {KIND}: {shown(kind)} is not the name of a kind of dataset")
    if not STRUCTURES.get(kind, lambda _: True)(ds):
        raise InputError(f'attribute {KIND}: is "{kind}", but the variables and dimensions of that kind are missing')


def dataset_attributes(kind: str, title: str, command: str, **further: object) -> dict[str, object]:
    """Return the attributes of a new dataset: kind, title, provenance, history, `further` ones and the conventions.

    `command` becomes the entry of the history, with the current time in UTC.
    """
    return {
        "title": title,
        KIND: kind,
        **provenance(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {command}",
        **further,
        "Conventions": "CF-1.11",
    }


SPECIAL_KINDS = ("fold", "period-doubling", "torus", "grazing", "stick", "section", "hopf", "end", "branch-point")
"""Meanings of the flags of `special_kind`."""

BORDER_KINDS = (*SPECIAL_KINDS[:8], "basin", "not-settled")
"""Meanings of the flags of `kind`: kinds of special points, and limits beyond which an initial condition no longer
leads to an existing orbit."""

OF_FAMILIES: dict[str, Variable] = {
    "branch": Variable("1", "number of the branch; 0 is the first branch of the family", np.int32),
    "special_kind": Variable("1", "kind of the special point", np.int8, SPECIAL_KINDS),
    "special_value": Variable(
        "of the parameter",
        "value of the parameter at the special point",
        notes={"comment": "at an extrapolated graze, multipliers and impacts are those of the last computed orbit"},
    ),
    "special_branch": Variable("1", "number of the branch on which the special point lies", np.int32),
    "special_note": Variable("", "remarks on the special point", np.str_),
    "point_family": Variable("1", "number of the family to which the point belongs", np.int32),
    "special_family": Variable("1", "number of the family to which the special point belongs", np.int32),
}
"""Variables in addition to those of orbits and measures; the last two exist only for several families."""

OF_BORDERS: dict[str, Variable] = {
    "curve": Variable("1", "number of the curve on which the vertex lies", np.int32),
    "kind": Variable("1", "reason why the region of the stable single impact ends at the curve", np.int8, BORDER_KINDS),
    "region_area": Variable(
        "1", "share of the parameter plane with a stable single impact, reached from region_start (any: reached or not)"
    ),
    "continued": Variable(
        "1", "1 if the curve was computed by continuation, 0 if it joins points between grid points", np.int8
    ),
    "curve_note": Variable(
        "", "point and reason of each end of the curve, or reason why the border was not continued", np.str_
    ),
    "crossing_curve": Variable("1", "number of the curve that crosses the given value", np.int32),
}

OF_CURVES: dict[str, Variable] = {
    "point_curve": Variable("1", "number of the curve on which the point lies", np.int32),
    "kind": Variable("1", "kind of the special points that the curve consists of", np.int8, SPECIAL_KINDS),
    "special": Variable(
        "1", "index of the special point of the family at which the curve begins (-1: another point)", np.int32
    ),
    "curve_note": Variable("", "point and reason of each end of the curve", np.str_),
    "codim2_kind": Variable("", "name of the point of codimension two", np.str_),
    "codim2_curve": Variable("1", "number of the curve on which the point lies", np.int32),
    "crossing_curve": Variable("1", "number of the curve that crosses the given value", np.int32),
}
"""Variables in addition to those of orbits."""

OF_ATTRACTORS: dict[str, Variable] = {
    "share": Variable("1", "share of the starts that lead to the attractor"),
    "share_stderr": Variable("1", "binomial standard error of share"),
    "unassigned": Variable("1", "number of starts without a known attractor", np.int32),
    "lane_attractor": Variable("1", "number of the attractor in which the lane ends (-1: unknown)", np.int32),
    "named_attractor": Variable("1", "number of the attractor that the named start reaches; -1: unknown", np.int32),
    "named_regime": Variable("1", "regime of the motion from the named start", np.int8, REGIMES),
}


LONGEST_NAME = 200
"""Maximum length of a variable name [characters]: column names of a CSV file become variable names, too."""

MOST_CHECKED = 10**7
"""Number of values up to which a variable is checked: a larger variable is read only when it is used."""

LARGEST_COORDINATE = 1e100
"""Bound on the absolute values of coordinates: squares and differences of larger values may overflow."""

_DERIVED = OF_FAMILIES | OF_CURVES | OF_BORDERS | OF_ATTRACTORS

_DIMENSIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "special_kind": {
        **dict.fromkeys(("branch", "stable", "cycles", "period"), ("point",)),
        **dict.fromkeys(("special_kind", "special_value", "special_branch", "special_note"), ("special",)),
    },
    "point_curve": {
        **dict.fromkeys(("point_curve", "period", "cycles"), ("point",)),
        **dict.fromkeys(("kind", "special", "curve_note"), ("curve",)),
        **dict.fromkeys(("codim2_kind", "codim2_curve"), ("codim2",)),
        "multiplier_abs": ("point", "multiplier"),
    },
    "region_area": {"curve": ("vertex",), "kind": ("curve",), "region_area": ("region",)},
    "event_time": {"event_time": ("event",), "event_kind": ("event",)},
}
"""Dimensions of the variables of families, of curves, of borders and of a motion's events. The key is the variable
whose presence implies the others."""


def check_structure(ds: xr.Dataset) -> None:
    """Raise `InputError`, with a one-line message that names the variable, if the structure is inconsistent."""
    known = VARIABLES | _DERIVED
    for text in map(str, (*ds.sizes, *ds.variables)):
        if printable(text) != text or not 0 < len(text) <= LONGEST_NAME:
            raise InputError(f"variable {shown(text)}: the name is not a printable text of 1 to {LONGEST_NAME} letters")
    for axis in ds.sizes:
        if axis in ds.variables and ds[axis].dims == (axis,):
            _check_axis(Place(f"coordinate {axis}"), ds[axis])
    for name, data in ds.variables.items():
        place, dtype = Place(f"variable {name}"), known[str(name)].dtype if name in known else np.str_
        if dtype is not np.str_ and data.dtype.kind not in "fiu":
            raise place.error(f"its values are not numbers, but {data.dtype}")
        if name in _DERIVED and issubclass(dtype, np.integer) and data.dtype.kind not in "iu":
            raise place.error(f"its values are not whole numbers, but {data.dtype}")
        check_flags(place, data)
    for of in (name for name in _DIMENSIONS if name in ds):
        dimensions = dict(_DIMENSIONS[of])
        if of == "special_kind" and "eigenvalue_re" in ds:  # of equilibria
            dimensions |= dict.fromkeys(("eigenvalue_re", "eigenvalue_im"), ("point", "eigenvalue"))
        elif of == "special_kind":
            dimensions["multiplier_abs"] = ("point", "multiplier")
        for needed, expected in dimensions.items():
            if needed not in ds:
                raise InputError(f"variable {needed}: is missing; it goes with {of}")
            if ds[needed].dims != expected:
                found = shown(list(ds[needed].dims))
                raise InputError(f"variable {needed}: its dimensions are {found}, not {shown(expected)}")
    # Of the variables with one value per lane, one has the dimensions of all others.
    along = {name: set(ds[name].dims) - {lane.along} for name, lane in VARIABLES.items() if name in ds}
    first = max(along, key=lambda name: len(along[name]), default="")
    for lane_name, dims in along.items():
        if not dims <= along[first]:
            lists = [shown(sorted(map(str, these))) for these in (dims, along[first])]
            text = f"its dimensions {lists[0]} are not among {lists[1]}, those of {first}"
            raise InputError(f"variable {lane_name}: {text}")


def _check_axis(place: Place, data: xr.DataArray) -> None:
    if data.dtype.kind not in "fiu":
        if data.dtype.kind not in "UOT":
            raise place.error(f"its values are neither numbers nor names, but {data.dtype}")
    elif not (np.abs(data.values) < LARGEST_COORDINATE).all():
        raise place.error(f"its values are not all finite numbers below {LARGEST_COORDINATE:g}")
    elif data.name != "time":
        if len(np.unique(data.values)) < data.size:
            raise place.error("its values are not all different")
    elif data.size > 1 and not (data.values[-1] > data.values[0] and (np.diff(data.values) >= 0).all()):
        raise place.error("its values do not rise")


def check_flags(place: Place, data: xr.Variable) -> None:
    """Raise `InputError` if a variable with flags has other values, as a mean of flags has."""
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
            raise place.error(f"{unknown[0]:g} is none of its flags {shown(flags.tolist())}; flags have no mean")
