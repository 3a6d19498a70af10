"""Selection of the lanes that a picture shows: those at specified values, or not more than can be drawn."""

import re
from collections.abc import Mapping
from math import prod

import numpy as np
import xarray as xr
from jaxtyping import Int

from vibrojax.errors import InputError, shown, suggestion
from vibrojax.io.kinds import kind_of
from vibrojax.io.riglog import read_conditions
from vibrojax.io.tables import is_number
from vibrojax.physics.meanings import suggest_coordinate
from vibrojax.physics.units import factor
from vibrojax.pictures.axes import short
from vibrojax.pictures.branches import FAMILY, numbers_of
from vibrojax.pictures.contents import FORM, is_numeric, lane_dims, named_groups

Value = float | int | str

MOST_LANES = 300_000  # the greatest number of lanes in a picture: more take minutes and show nothing new
_DIGITS = 1e-4  # relative tolerance: about as many digits as a picture prints
_LISTED_VALUES, _LISTED_NAMES = 12, 5


def select(ds: xr.Dataset, where: Mapping[str, Value]) -> xr.Dataset:
    """Return the lanes at specified values of axes, or of coordinates along axes.

    Families are selected by the coordinates that distinguish them, or by `branch`.

    **Arguments:** `where`: values by name: numbers in the dataset's unit, accurate to four digits, or strings; or
    conditions such as "v (mm/s) < 2".

    **Raises:** `InputError` if there is no such axis, or the axis has no such value.
    """
    if not isinstance(where, Mapping):
        raise InputError(f'where: {shown(where)} does not say which axis; give {{"delta": 0.005}}')
    if kind_of(ds) == "family":
        return _select_families(ds, where)
    ds = named_groups(ds)
    for name, value in where.items():
        dims = (*lane_dims(ds), FORM)
        choices = [str(key) for key, data in ds.coords.items() if len(data.dims) == 1 and data.dims[0] in dims]
        if name not in choices:
            about = {key: ds[key].attrs for key in choices}
            advice = suggest_coordinate(str(name), about) if choices else "there are none"
            raise InputError(f"where: {shown(name)} is none of the dataset's axes; {advice}")
        indices = _find(ds[name], value)
        (dimension,) = ds[name].dims
        ds = ds.isel({dimension: int(indices[0]) if len(indices) == 1 and dimension == name else indices})
    return ds


def _select_families(ds: xr.Dataset, where: Mapping[str, Value]) -> xr.Dataset:
    """Return the points and special points of the selected families, or of one branch."""
    for name, value in where.items():
        choices = [*(str(key) for key, data in ds.coords.items() if data.dims == (FAMILY,)), "branch"]
        if name not in choices:
            raise InputError(f"where: {shown(name)} tells no families apart; {suggestion(str(name), choices)}")
        indices = _find(ds[name], value)
        if name == "branch":
            members = ds["branch"].values[indices]
            numbers = {"point": ds["branch"].values, "special": ds["special_branch"].values}
        else:
            members = ds[FAMILY].values[indices]
            numbers = {which: numbers_of(ds, which) for which in ("point", "special")}
            single = len(indices) == 1
            ds = ds.isel({FAMILY: int(indices[0])}).drop_vars(FAMILY) if single else ds.isel({FAMILY: indices})
        ds = ds.isel({which: np.flatnonzero(np.isin(of, members)) for which, of in numbers.items()})
    return ds


def _find(data: xr.DataArray, value: Value) -> Int[np.ndarray, " indices"]:
    """Return the indices of a value; raise `InputError` that lists the existing values if it does not occur."""
    if is_numeric(data) and isinstance(value, str) and re.search("[<>=]", value):
        return _compared(data, value)
    if is_numeric(data):
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = np.nan
        finite = np.unique(data.values[np.isfinite(data.values)])
        near = finite[np.abs(finite - number) <= _DIGITS * np.abs(finite) + np.finfo(float).tiny]
        if near.size:
            return np.flatnonzero(data.values == near[np.argmin(np.abs(near - number))])
        texts = [f"{item:.6g}" for item in finite]
        choices = ", ".join(texts)
        if finite.size > _LISTED_VALUES:
            choices = f"{finite.size} from {texts[0]} to {texts[-1]}"
            above = int(np.searchsorted(finite, number))
            if 0 < above < finite.size:
                choices += f", beside it {texts[above - 1]} and {texts[above]}"
    else:
        names = [str(name) for name in data.values]
        indices = np.flatnonzero([value == name or short(str(value)) == short(name) for name in names])
        if indices.size:
            return indices
        names = list(dict.fromkeys(map(short, names)))
        more = f" and {len(names) - _LISTED_NAMES} more" if len(names) > _LISTED_NAMES else ""
        choices = ", ".join(names[:_LISTED_NAMES]) + more
    raise InputError(f"where: no lane has {data.name} = {value}; there are {choices}")


def _compared(data: xr.DataArray, text: str) -> Int[np.ndarray, " indices"]:
    """Return the indices of the values that meet a condition, such as "v (mm/s) < 2"."""
    (condition,) = read_conditions(text)
    scale = 1.0 if condition.unit is None else factor(condition.unit, str(data.attrs.get("units", "1")))
    if scale is None or not is_number(condition.value):
        raise InputError(
            f"where: {text} does not suit {data.name} [{data.attrs.get('units', '1')}]; write a number in its unit"
        )
    indices = np.flatnonzero(condition.holds(data.values, float(condition.value) * scale))
    if not indices.size:
        raise InputError(f"where: no lane has {text}; there are {data.values.min():.6g} to {data.values.max():.6g}")
    return indices


def thin_out(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset, or, if it has too many lanes, every n-th value of the longest axes, loaded into memory."""
    steps = _thinning_steps(ds)
    if not steps:
        return ds
    part = ds.isel({name: slice(None, None, step) for name, step in steps.items()})
    for variable in part.variables.values():  # one by one: a variable is read completely before it is thinned
        variable.load()
    return part


def thinned_text(ds: xr.Dataset) -> str:
    """Describe which values of a dataset are drawn; return "" if all are drawn."""
    ordinals = {2: "second", 3: "third"}
    steps = _thinning_steps(ds).items()
    parts = [f"every {ordinals.get(step, f'{step}th')} value of {name}" for name, step in steps]
    return f"drawn is {' and '.join(parts)}" if parts else ""


def _thinning_steps(ds: xr.Dataset) -> dict[str, int]:
    """Return n by dimension, for those dimensions of which only every n-th value is drawn."""
    steps = dict.fromkeys(lane_dims(ds), 1)
    while prod(-(-ds.sizes[name] // step) for name, step in steps.items()) > MOST_LANES:
        steps[max(steps, key=lambda name: ds.sizes[name] / steps[name])] += 1
    return {name: step for name, step in steps.items() if step > 1}
