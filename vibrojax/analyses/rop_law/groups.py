"""Lanes with a relief and a rate, and the groups that a law is fitted to one by one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.rop_law.columns import FORCE, RATE, RELIEF
from vibrojax.errors import Place, shown, suggestion
from vibrojax.measures.labels import FAILED, IRREGULAR

USUAL_AXES = ("frequency", "v", "point")
"""What a law is fitted along where nothing else is asked, the first that is there."""


@dataclass(frozen=True)
class Groups:
    """Lanes in groups.

    - `relief` [1], `rate` [m/s], `valid`: what follows the `count` lanes of a group is not valid and only fills up.
    - `sizes`, `coordinates`: of the groups' dimensions.
    - `along`: the axis that the lanes of a group lie on.
    """

    relief: Float[np.ndarray, "groups lanes"]
    rate: Float[np.ndarray, "groups lanes"]
    valid: Bool[np.ndarray, "groups lanes"]
    count: Int[np.ndarray, " groups"]
    sizes: dict[str, int]
    coordinates: Mapping[str, xr.DataArray | xr.Variable]
    along: str


def usable_lanes(data: xr.Dataset) -> xr.Dataset:
    """Relief, rate and `valid` on common dimensions, with the coordinates of the relief.

    Not valid are lanes that failed or are irregular, or have no finite values, a relief that is not above zero, or a
    negative rate: a hole does not grow shallower.
    """
    relief, rate = xr.broadcast(data[RELIEF], data[RATE])
    valid = (relief > 0) & (relief < np.inf) & (rate >= 0) & (rate < np.inf)
    if "regime" in data:
        valid = valid & ~data["regime"].isin([FAILED, IRREGULAR])
    if "status" in data:
        valid = valid & (data["status"] == 0)
    relief, rate, valid = xr.broadcast(relief, rate, valid)
    lanes = {"relief": relief.astype(np.float64), "rate": rate.astype(np.float64), "valid": valid}
    # Broadcasting gives either the other's axes, but not what else is known along them.
    return xr.Dataset({name: values.variable for name, values in lanes.items()}, {**rate.coords, **relief.coords})


def check_axis(place: Place, lanes: xr.Dataset, along: str | None) -> str:
    """The dimension to fit along; raises `InputError` where there is no such or none by itself."""
    dims = lane_dims(place, lanes)
    if along is None:
        usual = [name for name in USUAL_AXES if name in dims] or (dims if len(dims) == 1 else [])
        if not usual:
            raise place.at("along").error(f"missing; choose the axis to fit along from {', '.join(dims)}")
        return usual[0]
    if along not in dims:
        raise place.at("along").error(f"{shown(along)} is no axis of the data; {suggestion(str(along), dims)}")
    return along


def lane_dims(place: Place, lanes: xr.Dataset) -> list[str]:
    """The dimensions of the lanes; raises `InputError` where there are none, or no lanes."""
    dims = [str(dim) for dim in lanes["rate"].dims]
    if not dims:
        raise place.at("along").error("there is one lane only; a law needs an axis of several")
    for dim in dims:
        if not lanes.sizes[dim]:
            raise place.at(dim).error("has no values, so there are no lanes; give at least one")
    return dims


def grouped(place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str] = ()) -> Groups:
    """The lanes (see `usable_lanes`) in groups, one for each point of the axes that are not `along`.

    Rows of a table (one dimension) are grouped by their columns where `by` names some, or `along` is a column: then by
    all others but the mean force.

    **Raises:** `InputError`.
    """
    columns = _columns(lanes)
    if by or along in columns:
        return _grouped_rows(place, lanes, along, by, columns)
    along = check_axis(place, lanes, along)
    dims = [str(dim) for dim in lanes["rate"].dims if dim != along]
    ordered = lanes.transpose(*dims, along)
    sizes = {dim: lanes.sizes[dim] for dim in dims}
    shape = (int(np.prod(list(sizes.values()))), lanes.sizes[along])
    relief, rate, valid = (ordered[name].values.reshape(shape) for name in ("relief", "rate", "valid"))
    coordinates = {str(name): values for name, values in lanes.coords.items() if set(values.dims) <= set(dims)}
    return Groups(relief, rate, valid, np.full(shape[0], shape[1]), sizes, coordinates, along)


def _columns(lanes: xr.Dataset) -> list[str]:
    """Names of the columns of a table, which has one dimension; none of data with more."""
    dims = lanes["rate"].dims
    return [str(name) for name, values in lanes.coords.items() if len(dims) == 1 and values.dims == dims != (name,)]


def _grouped_rows(place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str], columns: list[str]) -> Groups:
    """Groups of rows with the same values in the columns `by`."""
    row = lane_dims(place, lanes)[0] if columns else None
    for name in (*by, *([along] if along is not None and along != row else [])):
        if name not in columns:
            fault = f"; {suggestion(str(name), columns)}" if columns else ": the data are no table of rows with columns"
            raise place.at("by" if name in by else "along").error(f"{shown(name)} is no column of the data{fault}")
    keys = list(by) or [name for name in columns if name not in (along, FORCE)]
    every = np.zeros(lanes["rate"].size, int)
    codes = [np.unique(lanes[name].values, return_inverse=True)[1].ravel() for name in keys]
    _, first, group = np.unique(np.stack(codes or [every], axis=1), axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    count = np.bincount(group)
    longest = int(np.max(count))
    order = np.argsort(group, kind="stable")
    place_in_group = np.arange(group.size) - np.repeat(np.cumsum(count) - count, count)

    def filled(name: str) -> np.ndarray:
        values = lanes[name].values[order]
        rows = np.zeros((count.size, longest), values.dtype)
        rows[group[order], place_in_group] = values
        return rows

    coordinates = {name: xr.Variable("group", lanes[name].values[first], lanes[name].attrs) for name in keys}
    relief, rate, valid = (filled(name) for name in ("relief", "rate", "valid"))
    return Groups(relief, rate, valid, count, {"group": count.size}, coordinates, str(along or row))
