"""Access to the values of a fit, and texts that describe its groups."""

from itertools import product

import numpy as np
import xarray as xr
from jaxtyping import Float, Shaped

GROUPS_TABULATED = 12
"""Greatest number of groups that tables and verdicts list."""


def table(fit: xr.Dataset, name: str) -> Shaped[np.ndarray, "groups forms"]:
    """Return a variable of a dataset that `fit_rop` returned as an array with one row per group."""
    dims = [dim for dim in fit[name].dims if dim != "form"]
    return np.asarray(fit[name].transpose(*dims, "form").values.reshape(-1, fit.sizes["form"]))


def standings(fit: xr.Dataset) -> Shaped[np.ndarray, "groups forms"]:
    """Return the `Standing` of each form; all 0 in a fit that is older than it."""
    return table(fit, "standing") if "standing" in fit else np.zeros_like(table(fit, "reason"))


def formulas_of(fit: xr.Dataset) -> dict[str, str]:
    """Return the formula of each form, by name; empty if the dataset contains none."""
    return dict(part.split(": ", 1) for part in str(fit.attrs.get("formulas", "")).split("; ") if ": " in part)


def group_names(fit: xr.Dataset) -> list[str]:
    """Return the coordinates of each group as text, such as "force=200000 N, rock=granite"."""
    along = []
    for dim in (dim for dim in fit["aic"].dims if dim != "form"):
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


def range_text(values: Float[np.ndarray, " groups"]) -> str:
    """Return the least, the greatest and the median of values, or that there are none."""
    values = values[np.isfinite(values)]
    if not len(values):
        return "is not defined, since no rate varies"
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{low:.4g}" if len(values) == 1 else f"{low:.4g} to {high:.4g} (median {middle:.4g})"


def region_text(fit: xr.Dataset, groups: Shaped[np.ndarray, " groups"]) -> str:
    """Return text that describes the smallest box over the groups' axes that contains `groups`, flat indices."""
    dims = [dim for dim in fit["aic"].dims if dim != "form"]
    positions = np.unravel_index(groups, [fit.sizes[dim] for dim in dims]) if dims else ()
    ranges = []
    for dim, indices in zip(dims, positions, strict=True):
        if dim in fit.coords and len(indices):
            low, high = (value_text(fit[dim], int(index)) for index in (indices.min(), indices.max()))
            ranges.append(f"{dim} {low}" + (f" to {high}" if high != low else ""))
    return f", all of them within {', '.join(ranges)}" if ranges else ""
