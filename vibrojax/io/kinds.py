"""Kinds of datasets, and the attributes and derived variables that the kinds share."""

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, printable, shown
from vibrojax.io.provenance import provenance
from vibrojax.io.variables import Variable
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
    "accuracy": lambda ds: "setting" in ds.dims and "error_worst" in ds,
}
"""The structure that pictures and summaries of each kind require."""

_RECOGNISED = STRUCTURES | {
    "fit": lambda ds: ("C" in ds and "form" in ds["C"].dims) or "columns" in ds.attrs,
    "derivatives": lambda ds: {"variable", "parameter"} <= set(ds.dims),
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


SPECIAL_KINDS = ("fold", "period-doubling", "torus", "grazing", "stick", "section", "end")
"""Meanings of the flags of `special_kind`."""

BORDER_KINDS = (*SPECIAL_KINDS, "basin", "not-settled")
"""Meanings of the flags of `kind`: kinds of special points, and limits beyond which an initial condition no longer
leads to an existing orbit."""

OF_FAMILIES: dict[str, Variable] = {
    "branch": Variable("1", "branch of the family, 0 the one that it begins with", np.int32),
    "special_kind": Variable("1", "kind of the special point", np.int8, SPECIAL_KINDS),
    "special_value": Variable("of the parameter", "value of the parameter at the special point"),
    "special_branch": Variable("1", "branch of the special point", np.int32),
    "special_note": Variable("", "what there is to say", np.str_),
    "point_family": Variable("1", "number of the family", np.int32),
    "special_family": Variable("1", "number of the family", np.int32),
}
"""Variables in addition to those of orbits and measures; the last two exist only for several families."""

OF_BORDERS: dict[str, Variable] = {
    "curve": Variable("1", "number of the curve", np.int32),
    "kind": Variable("1", "what ends the region there", np.int8, BORDER_KINDS),
    "region_area": Variable("1", "share of the plane with a stable single impact"),
}

OF_ATTRACTORS: dict[str, Variable] = {
    "share": Variable("1", "share of the starts that end in the attractor"),
    "share_stderr": Variable("1", "standard error of share, binomial"),
    "unassigned": Variable("1", "starts of which no attractor could be told", np.int32),
    "lane_attractor": Variable("1", "number of the attractor that the lane ends in; -1: none could be told", np.int32),
    "named_attractor": Variable(
        "1", "number of the attractor that the start of this name leads to; -1: none", np.int32
    ),
    "named_regime": Variable("1", "regime that the start of this name leads to", np.int8, REGIMES),
}
