"""Lanes (here, pairs of relief and rate of penetration) in groups; the law is fitted to each group separately."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import xarray as xr

from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.log_columns import DEPTH, FORCE, LINE, RATE, RELIEF, RIG
from vibrojax.io.variables import Variable
from vibrojax.measures.labels import FAILED, IRREGULAR
from vibrojax.physics.meanings import suggest_coordinate
from vibrojax.studies.rop_dataset import to_variables

DEFAULT_AXES = ("frequency", "v", "point")
"""Default axes to fit along; the first of them that exists in the data is used."""

NO_LANE, FITTED, CENSORED, LEFT_OUT = range(4)
"""Flag values of the variable `data_use`."""

_LANE_VARIABLES = ("relief", "rate", "valid", "is_lane")
_DATA_SCHEMA = {
    "data_relief": Variable("1", "relief of the lanes that were fitted"),
    "data_rate_of_penetration": Variable("m s-1", "rate of penetration of the lanes that were fitted"),
    "data_use": Variable("1", "what became of a lane", np.int8, ("no-lane", "fitted", "censored", "left-out")),
}


def data_variables(groups: xr.Dataset) -> dict[str, xr.Variable]:
    """Return relief, rate and use (`data_use`) of lanes as variables over the groups' dimensions and `lane`.

    Lanes with zero rate are censored. Lanes that failed, are irregular or have no usable values are left out.
    """
    is_lane, valid, rate = (groups[name].values for name in ("is_lane", "valid", "rate"))
    use = np.select([~is_lane, valid & (rate > 0), valid], [NO_LANE, FITTED, CENSORED], LEFT_OUT)
    values = (np.where(is_lane, groups["relief"].values, np.nan), np.where(is_lane, rate, np.nan), use)
    dims = dict.fromkeys(_DATA_SCHEMA, groups["rate"].dims)
    return to_variables(_DATA_SCHEMA, dict(zip(_DATA_SCHEMA, values, strict=True)), dims)


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


def group_lanes(place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str] = ()) -> xr.Dataset:
    """Group lanes, as `usable_lanes` returns them: one group per combination of values on the axes other than `along`.

    The result has `relief` [1], `rate` [m/s], `valid` and `is_lane` over the dimensions of the groups and `lane`. Short
    groups are padded where `is_lane` is False. The attribute `along` is the axis of the lanes.

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
    ordered = lanes.transpose(*others, along).assign(is_lane=xr.ones_like(lanes["valid"], bool))
    variables = {name: ((*others, "lane"), ordered[name].transpose(*others, along).values) for name in _LANE_VARIABLES}
    coordinates = {str(name): values for name, values in lanes.coords.items() if set(values.dims) <= set(others)}
    return xr.Dataset(variables, coordinates, {"along": along})


def _group_rows(
    place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str], columns: list[str]
) -> xr.Dataset:
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
    group, lane = grouped.ngroup().to_numpy(), grouped.cumcount().to_numpy()
    first = np.flatnonzero(lane == 0)
    first = first[np.argsort(group[first])]
    rows = lanes.assign(is_lane=xr.ones_like(lanes["valid"], bool))
    variables = {}
    for name in _LANE_VARIABLES:
        padded = np.zeros((first.size, lane.max() + 1), rows[name].dtype)
        padded[group, lane] = rows[name].values
        variables[name] = (("group", "lane"), padded)
    coordinates = {name: xr.Variable("group", lanes[name].values[first], lanes[name].attrs) for name in keys}
    if DEPTH in columns and DEPTH not in (*keys, along) and lanes[DEPTH].dtype.kind == "f":
        about, depths = {"units": "m", "long_name": "depth of the group"}, pd.Series(lanes[DEPTH].values).groupby(group)
        coordinates["depth_from"] = xr.Variable("group", depths.min().to_numpy(), about)
        coordinates["depth_to"] = xr.Variable("group", depths.max().to_numpy(), about)
    return xr.Dataset(variables, coordinates, {"along": str(along or row)})
