"""Datasets of fits: variables with units and meanings, provenance, and access to values by group and form."""

from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Shaped

from vibrojax.errors import Place
from vibrojax.io.attributes import title_of
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import Variable
from vibrojax.studies.rop_least_squares import REASONS

_KEPT = (
    *("scene", "sweep", "parameters", "columns"),
    *("dialect", "detected", "dropped", "rows_read", "nulls", "notes", "reference_force"),
)
"""Attributes of the data that a fit keeps."""


def reason_variable(long_name: str) -> Variable:
    """Return the schema of a flag variable, with the meanings `REASONS`, that explains NaN in other variables."""
    return Variable("1", long_name, np.int8, REASONS)


GOODNESS_SCHEMA = {
    "r_squared": Variable("1", "share of the rate's variance that the law explains"),
    "aic": Variable("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "degrees_of_freedom": Variable("1", "lanes with a residual less coefficients", np.int32),
    "used": Variable("1", "lanes that the fit used, those at zero rate among them", np.int32),
    "left_out": Variable("1", "lanes left out: failed, irregular, or without usable values", np.int32),
    "reason": reason_variable("why a coefficient is not a number"),
    "r_squared_reason": reason_variable("why r_squared is not a number"),
}
"""Schema of the variables that every fit of a rate-of-penetration law contains."""

LAW_TITLE = "rate-of-penetration law"


def to_variables(
    schema: Mapping[str, Variable], values: Mapping[str, object], dims: Mapping[str, Sequence[Hashable]]
) -> dict[str, xr.Variable]:
    """Return xarray variables with the dtypes and attributes of `schema`; variables without `dims` are scalars."""
    return {
        name: xr.Variable(dims.get(name, ()), np.asarray(values[name], variable.dtype), variable.attributes())
        for name, variable in schema.items()
    }


def fit_dataset(
    place: Place,
    data: xr.Dataset,
    step: str,
    title: str,
    schema: Mapping[str, Variable],
    values: Mapping[str, object],
    dims: Mapping[str, Sequence[Hashable]],
    coordinates: Mapping[Any, Any],
    **more: str | float,
) -> xr.Dataset:
    """Return the dataset of a fit, with its provenance and the attributes of the data that remain valid.

    **Arguments:** `step`: name of the computation, for the attribute `history`; `title`: title, which is followed by
    that of the data; `schema`, `values`, `dims`: as in `to_variables`; `more`: further attributes.
    """
    own = dataset_attributes("fit", f"{title}: {title_of(data, place.file)}", f"{step} {place.file}")
    if "history" in data.attrs:
        own["history"] = f"{own['history']}\n{data.attrs['history']}"
    kept = {name: data.attrs[name] for name in _KEPT if name in data.attrs}
    return xr.Dataset(to_variables(schema, values, dims), coordinates, {**own, **kept, **more})


def table(fit: xr.Dataset, name: str) -> Shaped[np.ndarray, "groups forms"]:
    """Return a variable of a dataset that `fit_rop` returned as an array with one row per group."""
    return np.asarray(fit[name].transpose(*group_dims(fit), "form").values.reshape(-1, fit.sizes["form"]))


def group_dims(fit: xr.Dataset) -> list[Hashable]:
    """Return the dimensions of the groups of a fit."""
    return [dim for dim in fit["aic"].dims if dim != "form"]


def standings(fit: xr.Dataset) -> Shaped[np.ndarray, "groups forms"]:
    """Return the `Standing` of each form; all 0 in a fit that is older than it."""
    return table(fit, "standing") if "standing" in fit else np.zeros_like(table(fit, "reason"))


def formulas_of(fit: xr.Dataset) -> dict[str, str]:
    """Return the formula of each form, by name; empty if the dataset contains none."""
    return dict(part.split(": ", 1) for part in str(fit.attrs.get("formulas", "")).split("; ") if ": " in part)


def group_names(fit: xr.Dataset) -> list[str]:
    """Return the coordinates of each group as text, such as "force=200000 N, rock=granite"."""
    along = []
    for dim in group_dims(fit):
        names = [name for name in fit.coords if fit[name].dims == (dim,)]
        texts = (
            [f"{name}={value_text(fit[name], k)}" for name in names] or [f"{dim}={k}"] for k in range(fit.sizes[dim])
        )
        along.append([", ".join(parts) for parts in texts])
    return [", ".join(parts) or "all lanes" for parts in product(*along)]


def value_text(coordinate: xr.DataArray, index: int) -> str:
    """Return a value of a coordinate with its unit."""
    value, unit = coordinate.values[index].item(), coordinate.attrs.get("units", "1")
    return (f"{value:.6g}" if isinstance(value, float) else str(value)) + ("" if unit == "1" else f" {unit}")
