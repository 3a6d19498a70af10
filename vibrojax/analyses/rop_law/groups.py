"""Lanes (here, pairs of relief and rate of penetration) in groups; the law is fitted to each group separately."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.rop_law.dataset import to_variables
from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.riglog.columns import DEPTH, FORCE, LINE, RATE, RELIEF, RIG
from vibrojax.io.variables import Variable
from vibrojax.measures.labels import FAILED, IRREGULAR
from vibrojax.models.physics.meanings import suggest_coordinate

DEFAULT_AXES = ("frequency", "v", "point")
"""Default axes to fit along; the first of them that exists in the data is used."""

NO_LANE, FITTED, CENSORED, LEFT_OUT = range(4)
"""Flag values of the variable `data_use`."""

_DATA_SCHEMA = {
    "data_relief": Variable("1", "relief of the lanes that were fitted"),
    "data_rate_of_penetration": Variable("m s-1", "rate of penetration of the lanes that were fitted"),
    "data_use": Variable("1", "what became of a lane", np.int8, ("no-lane", "fitted", "censored", "left-out")),
}


@dataclass(frozen=True)
class Groups:
    """Lanes in groups, one row per group. A row holds `count` lanes; the rest is padding, which is not `valid`.

    `relief` is dimensionless and `rate` in m/s. `sizes` and `coordinates` describe the dimensions of the groups;
    `along` is the axis along which the lanes of a group vary.
    """

    relief: Float[np.ndarray, "groups lanes"]
    rate: Float[np.ndarray, "groups lanes"]
    valid: Bool[np.ndarray, "groups lanes"]
    count: Int[np.ndarray, " groups"]
    sizes: dict[str, int]
    coordinates: Mapping[str, xr.DataArray | xr.Variable]
    along: str

    def data_variables(self) -> dict[str, xr.Variable]:
        """Return relief, rate and use (`data_use`) of the lanes as variables over the groups' dimensions and `lane`.

        Lanes with zero rate are censored. Lanes that failed, are irregular or have no usable values are left out.
        """
        lane = np.arange(self.rate.shape[1]) < self.count[:, None]
        use = np.select([~lane, self.valid & (self.rate > 0), self.valid], [NO_LANE, FITTED, CENSORED], LEFT_OUT)
        values = (np.where(lane, self.relief, np.nan), np.where(lane, self.rate, np.nan), use)
        shape = (*self.sizes.values(), self.rate.shape[1])
        shaped = {name: value.reshape(shape) for name, value in zip(_DATA_SCHEMA, values, strict=True)}
        return to_variables(_DATA_SCHEMA, shaped, dict.fromkeys(_DATA_SCHEMA, (*self.sizes, "lane")))


def usable_lanes(data: xr.Dataset) -> xr.Dataset:
    """Return `relief`, `rate` and `valid`, broadcast to common dimensions and with all their coordinates.

    A lane is valid unless it failed or is irregular, a value is not finite, its relief is not positive, or its rate is
    negative (a hole does not get shallower).
    """
    relief, rate = xr.broadcast(data[RELIEF], data[RATE])
    valid = (relief > 0) & (relief < np.inf) & (rate >= 0) & (rate < np.inf)
    if "regime" in data:
        valid = valid & ~data["regime"].isin([FAILED, IRREGULAR])
    if "status" in data:
        valid = valid & (data["status"] == 0)
    relief, rate, valid = xr.broadcast(relief, rate, valid)
    lanes = {"relief": relief.astype(np.float64), "rate": rate.astype(np.float64), "valid": valid}
    # Broadcasting adds the dimensions of the other variable, but not its non-index coordinates.
    return xr.Dataset({name: values.variable for name, values in lanes.items()}, {**rate.coords, **relief.coords})


def check_axis(place: Place, lanes: xr.Dataset, along: str | None) -> str:
    """Return the dimension to fit along: `along`, or a default if `along` is None.

    **Raises:** `InputError` if the data do not have the dimension, or if there is no default.
    """
    dims = _lane_dims(place, lanes)
    if along is None:
        defaults = [name for name in DEFAULT_AXES if name in dims] or (dims if len(dims) == 1 else [])
        if not defaults:
            raise place.at("along").error(f"missing; choose the axis to fit along from {', '.join(dims)}")
        return defaults[0]
    if along not in dims:
        hint = suggest_coordinate(str(along), {dim: lanes[dim].attrs for dim in dims})
        raise place.at("along").error(f"{shown(along)} is not an axis of the data; {hint}")
    return along


def _lane_dims(place: Place, lanes: xr.Dataset) -> list[str]:
    dims = [str(dim) for dim in lanes["rate"].dims]
    if not dims:
        raise place.at("along").error("there is one lane only; a law needs an axis of several")
    for dim in dims:
        if not lanes.sizes[dim]:
            raise place.at(dim).error("has no values, so there are no lanes; give at least one")
    return dims


def group_lanes(place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str] = ()) -> Groups:
    """Group lanes, as `usable_lanes` returns them: one group per combination of values on the axes other than `along`.

    Rows of a table (data with one dimension) are grouped by the columns `by`. If `along` is a column and `by` is empty,
    the rows are grouped by all other columns except the mean force.

    **Raises:** `InputError`.
    """
    dims = lanes["rate"].dims
    columns = [name for name, values in lanes.coords.items() if len(dims) == 1 and values.dims == dims != (name,)]
    if by or along in columns:
        return _group_rows(place, lanes, along, by, [str(name) for name in columns])
    along = check_axis(place, lanes, along)
    others = [str(dim) for dim in dims if dim != along]
    ordered = lanes.transpose(*others, along)
    sizes = {dim: lanes.sizes[dim] for dim in others}
    shape = (int(np.prod(list(sizes.values()))), lanes.sizes[along])
    relief, rate, valid = (ordered[name].values.reshape(shape) for name in ("relief", "rate", "valid"))
    coordinates = {str(name): values for name, values in lanes.coords.items() if set(values.dims) <= set(others)}
    return Groups(relief, rate, valid, np.full(shape[0], shape[1]), sizes, coordinates, along)


def _group_rows(place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str], columns: list[str]) -> Groups:
    """Return the rows of a table in groups of equal values in the columns `by`."""
    row = _lane_dims(place, lanes)[0] if columns else None
    for name in (*by, *([along] if along is not None and along != row else [])):
        if name not in columns:
            own = [column for column in columns if not lanes[column].attrs] or columns  # of a CSV: not the quantities
            fault = f"; {suggestion(str(name), own)}" if own else ": the data are not a table with columns"
            raise place.at("by" if name in by else "along").error(f"{shown(name)} is not a column of the data{fault}")
    keys = list(by) or [name for name in columns if name not in (along, FORCE, LINE, *RIG)]
    table = pd.DataFrame({name: lanes[name].values for name in keys}, index=range(lanes["rate"].size))
    # Groups of a log are from top to bottom, rather than by name.
    grouped = table.groupby(keys or np.zeros(len(table)), sort=DEPTH not in columns, dropna=False)
    group, lane, count = grouped.ngroup().to_numpy(), grouped.cumcount().to_numpy(), grouped.size().to_numpy()
    order, first = np.argsort(group, kind="stable"), np.flatnonzero(lane == 0)
    first = first[np.argsort(group[first])]

    def padded(name: str) -> np.ndarray:
        values = lanes[name].values
        rows = np.zeros((count.size, int(np.max(count))), values.dtype)
        rows[group, lane] = values
        return rows

    coordinates = {name: xr.Variable("group", lanes[name].values[first], lanes[name].attrs) for name in keys}
    if DEPTH in columns and DEPTH not in (*keys, along) and lanes[DEPTH].dtype.kind == "f":
        about = {"units": "m", "long_name": "depth of the group"}
        for name, depth in (("depth_from", np.fmin), ("depth_to", np.fmax)):
            ends = depth.reduceat(lanes[DEPTH].values[order], np.cumsum(count) - count)
            coordinates[name] = xr.Variable("group", ends, about)
    relief, rate, valid = (padded(name) for name in ("relief", "rate", "valid"))
    return Groups(relief, rate, valid, count, {"group": count.size}, coordinates, str(along or row))
