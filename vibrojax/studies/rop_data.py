"""Data of a fit: lanes of a sweep or rows of a rig log, in groups that have a law each.

A *lane* is one pair of relief and rate of penetration: a lane of a sweep, or a row of a log.
"""

import json
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.io.log_columns import (
    DEPTH,
    FORCE,
    KNOWN,
    LINE,
    RATE,
    RELIEF,
    RIG,
    THRESHOLD,
    WEIGHT,
    Column,
    checked_columns,
    required_names,
)
from vibrojax.io.riglog import FOR_LAW, LOG_ENDINGS, is_log, open_log, to_dataset
from vibrojax.measures.labels import FAILED, IRREGULAR
from vibrojax.physics.meanings import suggest_coordinate
from vibrojax.settings.values import warn_if_far

if TYPE_CHECKING:
    Data: TypeAlias = xr.Dataset | str | PathLike[str] | pd.DataFrame
    Columns = Mapping[str, str] | None
else:
    Data = Columns = object  # at run time `open_data` checks the user's argument, with a one-line error message

DEFAULT_AXES = ("frequency", "v", "point")
"""Default axes to fit along; the first of them that exists in the data is used."""

LANE_VARIABLES = ("relief", "rate", "weight", "number", "valid", "is_lane")
"""Variables of groups: `weight` is the mean force where it is known, else the relief; `number` is the line of a row."""


def open_data(data: Data, columns: Columns = None, **reading: Any) -> tuple[Place, xr.Dataset]:
    """Return the dataset, opened if `data` is a path, and the `Place` that error messages mention.

    The data must contain a rate of penetration and a relief, and may be a log or a table with `columns`; `reading` are
    the further arguments of `read_log`, `where` and `nulls`. Rows of a log have the attribute `dialect`.
    """
    if not isinstance(data, (xr.Dataset, pd.DataFrame, str, PathLike)):
        raise InputError(f"fit_rop: {shown(data)} is not data; give a dataset or a path")
    path = Path("fit_rop") if isinstance(data, (xr.Dataset, pd.DataFrame)) else Path(data)
    place, suffix = Place(str(path)), path.suffix.lower()
    if columns and (isinstance(data, xr.Dataset) or suffix == ".nc"):
        raise place.error("has its names and units already; `columns` is for a CSV")
    if isinstance(data, xr.Dataset):
        dataset = data
    elif isinstance(data, pd.DataFrame) or suffix in LOG_ENDINGS:
        given = {name: value for name, value in reading.items() if value is not None}
        dataset = read_rows(data if isinstance(data, pd.DataFrame) else path, columns, **given)
    elif suffix == ".nc":
        from vibrojax.io.dataset import open_dataset

        dataset = open_dataset(path)
    else:
        raise place.error(
            "ends in neither .nc nor .csv nor .las; give a sweep's dataset or a rig log (also .txt, .xml, .xlsx)"
        )
    for name in (RATE, RELIEF):
        if name not in dataset:
            names = ", ".join(str(name) for name in dataset.data_vars) or "nothing"
            raise place.at(name).error(f"missing; a sweep of a scene with rock has it, this holds {names}")
        if dataset[name].dtype.kind not in "fiu":
            raise place.at(name).error("does not hold numbers; the data of a sweep are needed")
    return place, dataset


def read_rows(source: Path | pd.DataFrame, columns: Columns = None, **reading: Any) -> xr.Dataset:
    """Read a rig log into a dataset with rate_of_penetration [m/s] and relief [1] along `point`, the rows.

    Without a relief, the relief is computed as mean_force/threshold; a weight on bit is a mean force. If the threshold
    is "unknown", or not given with a log of a rig, the relief is mean_force over its median, which the attribute
    `reference_force` [N] holds. The other attributes and coordinates are those of
    [vibrojax.io.riglog.to_dataset][].

    **Raises:** `InputError` if the file cannot be read, a column is missing, or a cell is not a number.
    """
    columns = checked_columns(columns)
    is_unknown = columns.get(THRESHOLD, "").strip() == "unknown"
    columns = {name: text for name, text in columns.items() if not (is_unknown and name == THRESHOLD)}
    log = open_log(source, columns, needed=FOR_LAW, name="fit_rop", **reading)
    for place, quantity, median, likely in log.unusual:
        warn_if_far(place, quantity, median, likely)
    chosen, data = dict(log.chosen), to_dataset(log.data, "point")
    if WEIGHT in chosen and FORCE not in chosen:
        chosen[FORCE] = chosen.pop(WEIGHT)
        data = data.rename({WEIGHT: FORCE})
    is_unknown |= is_log(data) and not {THRESHOLD, RELIEF} & set(chosen)
    if is_unknown and {THRESHOLD, RELIEF} & set(chosen):
        raise Place("columns", THRESHOLD).error(f"is unknown, but {log.place.file} has a threshold or relief; give one")
    standin = {THRESHOLD: Column("unknown", None, "N", 1.0)} if is_unknown else {}
    names = required_names(log.place.at(f"line {log.line}"), log.header, chosen | standin, columns)
    if is_unknown:
        data.attrs["reference_force"] = float(np.nanmedian(data[FORCE])) or 1.0
        data[RELIEF] = data[FORCE] / data.attrs["reference_force"]
    elif RELIEF not in names:
        with np.errstate(divide="ignore", invalid="ignore"):
            data[RELIEF] = data[FORCE] / data[THRESHOLD]
    if RELIEF not in names:
        data[RELIEF].attrs = {"units": KNOWN[RELIEF].unit, "long_name": KNOWN[RELIEF].long_name}
    number = ("point", np.arange(data.sizes["point"]), {"units": "1", "long_name": "number of the row"})
    data = data.assign_coords(point=number).set_coords([str(name) for name in data if name not in (RATE, RELIEF)])
    return data.assign_attrs(columns=json.dumps({name: column.described() for name, column in chosen.items()}))


def usable_lanes(data: xr.Dataset) -> xr.Dataset:
    """Return `relief`, `rate`, `weight`, `number` and `valid`, broadcast, with all their coordinates.

    A lane is valid unless it failed or is irregular, a value is not finite, its relief is not positive, or its rate is
    negative (a hole does not get shallower).
    """
    relief, rate = xr.broadcast(data[RELIEF], data[RATE])
    valid = (relief > 0) & (relief < np.inf) & (rate >= 0) & (rate < np.inf)
    if "regime" in data:
        valid = valid & ~data["regime"].isin([FAILED, IRREGULAR])
    if "status" in data:
        valid = valid & (data["status"] == 0)
    weight = data[FORCE] if is_measured(data) and FORCE in data.coords else relief
    number = data[LINE] if LINE in data.coords else xr.zeros_like(relief)
    parts = {"relief": relief, "rate": rate, "weight": weight, "number": number, "valid": valid}
    parts = dict(zip(parts, xr.broadcast(*parts.values()), strict=True))
    lanes = {name: values.variable.astype(bool if name == "valid" else float) for name, values in parts.items()}
    # Broadcasting adds the dimensions of the other variable, but not its non-index coordinates.
    return xr.Dataset(lanes, {**rate.coords, **relief.coords})


def is_measured(data: xr.Dataset) -> bool:
    """Return whether the lanes are rows of a log or table, which have noise and may be wrong."""
    return "dialect" in data.attrs


def group_lanes(place: Place, lanes: xr.Dataset, along: str | None, by: Sequence[str] = ()) -> xr.Dataset:
    """Group lanes, as `usable_lanes` returns them: one group per combination of values on the axes other than `along`.

    Rows of a table (data with one dimension) are grouped by the columns `by`, or if `along` is a column, by all other
    columns except the mean force.

    **Returns:** `LANE_VARIABLES` over the dimensions of the groups and `lane`, padded where `is_lane` is False, with
    the attribute `along`.

    **Raises:** `InputError`.
    """
    dims = [str(dim) for dim in lanes["rate"].dims]
    if not dims:
        raise place.at("along").error("there is one lane only; a law needs an axis of several")
    for dim in dims:
        if not lanes.sizes[dim]:
            raise place.at(dim).error("has no values, so there are no lanes; give at least one")
    row = dims[0]
    columns = [str(name) for name, x in lanes.coords.items() if len(dims) == 1 and x.dims == (row,) != (name,)]
    lanes = lanes.assign(is_lane=xr.ones_like(lanes["valid"], bool))
    if by or along in columns:
        for name in (*by, *({along} - {None, row})):
            if name not in columns:
                own = [column for column in columns if not lanes[column].attrs] or columns  # not the quantities
                hint = f"; {suggestion(str(name), own)}" if own else ": the data are not a table with columns"
                raise place.at("by" if name in by else "along").error(
                    f"{shown(name)} is not a column of the data{hint}"
                )
        keys = list(by) or [name for name in columns if name not in (along, FORCE, LINE, *RIG)]
        return _group_rows(lanes, keys, row, str(along or row))
    if along is None:
        along = next((name for name in DEFAULT_AXES if name in dims), row if len(dims) == 1 else None)
        if along is None:
            raise place.at("along").error(f"missing; choose the axis to fit along from {', '.join(dims)}")
    if along not in dims:
        hint = suggest_coordinate(str(along), {dim: lanes[dim].attrs for dim in dims})
        raise place.at("along").error(f"{shown(along)} is not an axis of the data; {hint}")
    others = [dim for dim in dims if dim != along]
    variables = {name: ((*others, "lane"), lanes[name].transpose(*others, along).values) for name in LANE_VARIABLES}
    coordinates = {str(name): values for name, values in lanes.coords.items() if set(values.dims) <= set(others)}
    return xr.Dataset(variables, coordinates, {"along": along})


def _group_rows(lanes: xr.Dataset, keys: list[str], row: str, along: str) -> xr.Dataset:
    """Return the rows of a table in groups of equal values in the columns `keys`; those of a log from top to bottom."""
    depth = lanes.coords.get(DEPTH)
    table = pd.DataFrame({name: lanes[name].values for name in keys}, index=range(lanes.sizes[row]))
    grouped = table.groupby(keys or np.zeros(len(table)), sort=depth is None, dropna=False)
    group, lane = grouped.ngroup().to_numpy(), grouped.cumcount().to_numpy()
    first = np.flatnonzero(lane == 0)
    first = first[np.argsort(group[first])]
    variables = {}
    for name in LANE_VARIABLES:
        padded = np.zeros((first.size, lane.max() + 1), lanes[name].dtype)
        padded[group, lane] = lanes[name].values
        variables[name] = (("group", "lane"), padded)
    coordinates = {name: xr.Variable("group", lanes[name].values[first], lanes[name].attrs) for name in keys}
    if depth is not None and DEPTH not in (*keys, along) and depth.dtype.kind == "f":
        ends = pd.Series(depth.values).groupby(group).agg(["min", "max"])
        about = {"units": "m", "long_name": "depth of the group"}
        for name, end in (("depth_from", "min"), ("depth_to", "max")):
            coordinates[name] = xr.Variable("group", ends[end].to_numpy(), about)
    return xr.Dataset(variables, coordinates, {"along": along})
