"""From a dataset or a file to lanes: relief, rate, and whether a lane can be used."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.label import FAILED, IRREGULAR
from vibrojax.laws._rig import FORCE, RATE, RELIEF, read_rig

USUAL_AXES = ("frequency", "v", "point")
"""What a law is fitted along where nothing else is asked, the first that is there."""


@dataclass(frozen=True)
class Lanes:
    """Lanes in groups.

    - `relief` [1], `rate` [m/s], `valid`: (groups, lanes).
    - `count`: (groups,), how many lanes there are of each; what follows them is not valid and only fills up.
    - `sizes`, `coordinates`: of the groups' dimensions.
    - `along`: the axis that the lanes of a group lie on.
    """

    relief: np.ndarray
    rate: np.ndarray
    valid: np.ndarray
    count: np.ndarray
    sizes: dict[str, int]
    coordinates: dict[str, xr.DataArray | xr.Variable]
    along: str


def opened(data: xr.Dataset | str | PathLike, name: str, tables: bool = False) -> tuple[Place, xr.Dataset]:
    """The dataset that a user gave, or the path of, with the place to name in messages (`name` where it has no path).

    `tables`: whether a CSV will do.

    **Raises:** `InputError`.
    """
    if isinstance(data, xr.Dataset):
        return Place(name), data
    if not isinstance(data, (str, PathLike)):
        raise InputError(f"{name}: {shown(data)} is no data; give a dataset or a path")
    path = Path(data)
    place = Place(str(path))
    ending = path.suffix.lower()
    if tables and ending == ".csv":
        return place, read_rig(path)
    if ending != ".nc":
        wrong = "ends in neither .nc nor .csv" if tables else "does not end in .nc"
        raise place.error(f"{wrong}; give a sweep's dataset{' or a CSV file' if tables else ''}")
    from vibrojax.store.dataset import open_dataset

    return place, open_dataset(path)


def read_data(data: xr.Dataset | str | PathLike, name: str) -> tuple[Place, xr.Dataset]:
    """Data with a rate of penetration and a relief, and their place (see `opened`).

    **Raises:** `InputError`.
    """
    place, data = opened(data, name, tables=True)
    for variable in (RATE, RELIEF):
        if variable not in data:
            held = ", ".join(str(name) for name in data.data_vars) or "nothing"
            raise place.at(variable).error(f"missing; a sweep of a scene with rock has it, this holds {held}")
        if data[variable].dtype.kind not in "fiu":
            raise place.at(variable).error("does not hold numbers; the data of a sweep are needed")
    return place, data


def parameter(place: Place, data: xr.Dataset, name: str) -> xr.DataArray:
    """A parameter's values: a coordinate of a sweep, or what is fixed in it.

    **Raises:** `InputError` where it is neither, or no numbers.
    """
    if name in data.coords:
        found = data[name]
    else:
        fixed = json.loads(data.attrs.get("parameters", "{}"))
        if name not in fixed:
            raise place.at(name).error("is neither a coordinate of the data nor fixed in them; give it as a coordinate")
        found = xr.DataArray(fixed[name])
    if found.dtype.kind not in "fiu":
        raise place.at(name).error("does not hold numbers")
    return found


def usable(data: xr.Dataset) -> xr.Dataset:
    """Relief, rate and `valid` on common dimensions.

    Not valid are lanes that failed or are irregular, or have no finite values, a relief that is not above zero, or a
    negative rate: a hole does not grow shallower.
    """
    relief, rate = xr.broadcast(data[RELIEF], data[RATE])
    good = np.isfinite(relief) & np.isfinite(rate) & (relief > 0) & (rate >= 0)
    if "regime" in data:
        good = good & ~data["regime"].isin([FAILED, IRREGULAR])
    if "status" in data:
        good = good & (data["status"] == 0)
    relief, rate, good = xr.broadcast(relief, rate, good)
    found = {"relief": relief.astype(np.float64), "rate": rate.astype(np.float64), "valid": good}
    return xr.Dataset({name: variable.variable for name, variable in found.items()}, relief.coords)


def axis(place: Place, data: xr.Dataset, along: str | None) -> str:
    """The dimension to fit along; raises `InputError` where there is no such or none by itself."""
    dims = _dims(place, data)
    if along is None:
        usual = [name for name in USUAL_AXES if name in dims] or (dims if len(dims) == 1 else [])
        if not usual:
            raise place.at("along").error(f"missing; choose the axis to fit along from {', '.join(dims)}")
        return usual[0]
    if along not in dims:
        raise place.at("along").error(f"{shown(along)} is no axis of the data; {suggestion(str(along), dims)}")
    return along


def _dims(place: Place, data: xr.Dataset) -> list[str]:
    dims = [str(dim) for dim in data["rate"].dims]
    if not dims:
        raise place.at("along").error("there is one lane only; a law needs an axis of several")
    for dim in dims:
        if not data.sizes[dim]:
            raise place.at(dim).error("has no values, so there are no lanes; give at least one")
    return dims


def lanes_of(place: Place, data: xr.Dataset, along: str | None, by: Sequence[str] = ()) -> Lanes:
    """The lanes of `data` (see `usable`) in groups, one for each point of the axes that are not `along`.

    Rows of a table (one dimension) are grouped by their columns where `by` names some, or `along` is a column: then by
    all others but the mean force.

    **Raises:** `InputError`.
    """
    columns = _columns(data)
    if by or along in columns:
        return _from_table(place, data, along, by, columns)
    along = axis(place, data, along)
    dims = [str(dim) for dim in data["rate"].dims if dim != along]
    ordered = data.transpose(*dims, along)
    sizes = {dim: data.sizes[dim] for dim in dims}
    shape = (int(np.prod(list(sizes.values()))), data.sizes[along])
    arrays = {name: ordered[name].values.reshape(shape) for name in ("relief", "rate", "valid")}
    coordinates = {str(name): found for name, found in data.coords.items() if set(found.dims) <= set(dims)}
    return Lanes(**arrays, count=np.full(shape[0], shape[1]), sizes=sizes, coordinates=coordinates, along=along)


def _columns(data: xr.Dataset) -> list[str]:
    """Names of the columns of a table, which has one dimension; none of data with more."""
    dims = data["rate"].dims
    return [str(name) for name, found in data.coords.items() if len(dims) == 1 and found.dims == dims != (name,)]


def _from_table(place: Place, data: xr.Dataset, along: str | None, by: Sequence[str], columns: list[str]) -> Lanes:
    """Lanes from rows, those with the same values in the columns `by` in one group."""
    (row,) = _dims(place, data) if columns else (None,)
    for name in (*by, *([along] if along not in (None, row) else [])):
        if name not in columns:
            fault = f"; {suggestion(str(name), columns)}" if columns else ": the data are no table of rows with columns"
            raise place.at("by" if name in by else "along").error(f"{shown(name)} is no column of the data{fault}")
    keys = list(by) or [name for name in columns if name not in (along, FORCE)]
    codes = [np.unique(data[name].values, return_inverse=True)[1].ravel() for name in keys]
    codes = np.stack(codes or [np.zeros(data.sizes[row], int)], axis=1)
    _, first, group = np.unique(codes, axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    count = np.bincount(group)
    order = np.argsort(group, kind="stable")
    place_in_group = np.arange(group.size) - np.repeat(np.cumsum(count) - count, count)
    arrays = {}
    for name in ("relief", "rate", "valid"):
        values = data[name].values[order]
        arrays[name] = np.zeros((count.size, count.max()), values.dtype)
        arrays[name][group[order], place_in_group] = values
    coordinates = {name: xr.Variable("group", data[name].values[first], data[name].attrs) for name in keys}
    return Lanes(**arrays, count=count, sizes={"group": count.size}, coordinates=coordinates, along=along or row)
