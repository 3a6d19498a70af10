"""The lanes of a dataset that a user asked a picture of: those at given values of its axes."""

from collections.abc import Mapping

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, shown, suggestion
from vibrojax.io.branches import FAMILY, numbers_of
from vibrojax.io.kinds import kind_of
from vibrojax.plot.axes import short
from vibrojax.plot.contents import FORM, is_numeric, lane_dims, named_groups

Value = float | int | str

_DIGITS = 1e-4  # relative: as many as a picture prints
_LISTED, _NAMES = 12, 5


def select(ds: xr.Dataset, where: Mapping[str, Value]) -> xr.Dataset:
    """The lanes of `ds` at the values `where` names them: of its axes, or of coordinates along these; of families those
    at values of what tells them apart, or one `branch`.

    **Arguments:** `where`: by name, a number in the unit of the dataset, right to four digits, or a name.

    **Raises:** `InputError` where there is no such axis, or no such value of it.
    """
    if not isinstance(where, Mapping):
        raise InputError(f'where: {shown(where)} does not say which axis; give {{"delta": 0.005}}')
    if kind_of(ds) == "family":
        return _of_families(ds, where)
    ds = named_groups(ds)
    for name, value in where.items():
        dims = (*lane_dims(ds), FORM)
        choices = [str(one) for one, data in ds.coords.items() if len(data.dims) == 1 and data.dims[0] in dims]
        if name not in choices:
            among = suggestion(str(name), choices) if choices else "there are none"
            raise InputError(f"where: {shown(name)} is none of the dataset's axes; {among}")
        at = _same(ds[name], value)
        (dimension,) = ds[name].dims
        ds = ds.isel({dimension: int(at[0]) if len(at) == 1 and dimension == name else at})
    selected = ds.copy()
    selected.attrs = {name: value for name, value in ds.attrs.items() if name != "certified"}  # counted over all lanes
    return selected


def _of_families(ds: xr.Dataset, where: Mapping[str, Value]) -> xr.Dataset:
    """The points and special points of some families, or of one branch."""
    for name, value in where.items():
        choices = [*(str(one) for one, data in ds.coords.items() if data.dims == (FAMILY,)), "branch"]
        if name not in choices:
            raise InputError(f"where: {shown(name)} tells no families apart; {suggestion(str(name), choices)}")
        if name == "branch":
            there = ds["branch"].isel(point=_same(ds["branch"], value)).values
            wanted = {"point": ds["branch"].values, "special": ds["special_branch"].values}
        else:
            at = _same(ds[name], value)
            there = ds[FAMILY].values[at]
            wanted = {which: numbers_of(ds, which) for which in ("point", "special")}
            ds = ds.isel({FAMILY: int(at[0])}).drop_vars(FAMILY) if len(at) == 1 else ds.isel({FAMILY: at})
        ds = ds.isel({which: np.flatnonzero(np.isin(numbers, there)) for which, numbers in wanted.items()})
    return ds


def _same(data: xr.DataArray, value: Value) -> np.ndarray:
    """Where `data` has `value`."""
    values = data.values
    if is_numeric(data):
        try:
            wanted = float(value)
        except (TypeError, ValueError):
            wanted = np.nan
        known: Float[np.ndarray, " values"] = values[np.isfinite(values)]
        nearest = float(known[np.argmin(np.abs(known - wanted))]) if known.size and np.isfinite(wanted) else np.nan
        if abs(nearest - wanted) <= _DIGITS * abs(nearest) + np.finfo(float).tiny:
            return np.flatnonzero(values == nearest)
    else:
        at = np.flatnonzero(
            [value in (name, short(name)) or short(str(value)) == short(name) for name in map(str, values)]
        )
        if at.size:
            return at
    raise InputError(f"where: no lane has {data.name} = {value}; {_there(data, value)}")


def _there(data: xr.DataArray, value: Value) -> str:
    """The values that there are, in words; of many the ends, and those beside `value`."""
    values = list(dict.fromkeys(data.values.tolist()))
    if not is_numeric(data):
        names = ", ".join(short(str(one)) for one in values[:_NAMES])
        return f"there are {names}" + (f" and {len(values) - _NAMES} more" if len(values) > _NAMES else "")
    values = sorted(one for one in values if np.isfinite(one))
    texts = [f"{one:.6g}" for one in values]
    if len(values) <= _LISTED:
        return f"there are {', '.join(texts)}"
    about = f"there are {len(values)} from {texts[0]} to {texts[-1]}"
    if not isinstance(value, (int, float)) or not values[0] < value < values[-1]:
        return about
    above = int(np.searchsorted(values, value))
    return f"{about}, beside it {texts[above - 1]} and {texts[above]}"
