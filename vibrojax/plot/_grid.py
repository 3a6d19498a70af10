"""The axes of a sweep: which are drawn along which, where cells end, and whether they are logarithmic."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from vibrojax.errors import InputError, suggestion

START, POINT, RETURN, FORM = "start", "point", "return_index", "form"
_PLAIN = {START, POINT, RETURN, FORM}
_EACH = ("regime", "rate_of_penetration", "C")  # what every lane has one of: of a drill, of rock, of a fit
_MANY = 9  # values from which lines, one for each, are too many
_ENOUGH = 6  # values from which an axis is one to draw along, rather than a choice between a few


def lane_dims(ds: xr.Dataset) -> tuple[str, ...]:
    """The dimensions of the lanes of a sweep, or of the groups of a fit; none where there are neither."""
    data = next((ds[name] for name in _EACH if name in ds), None)
    return () if data is None else tuple(str(name) for name in data.dims if name != FORM)


def swept(ds: xr.Dataset) -> tuple[str, ...]:
    """The grid's axes of more than one value that are numbers, in the order of the lanes' dimensions."""
    names = [name for name in lane_dims(ds) if name not in _PLAIN and name in ds.coords]
    return tuple(name for name in names if ds.sizes[name] > 1 and is_numeric(ds[name]))


def to_draw(ds: xr.Dataset) -> tuple[str, ...]:
    """The axes worth drawing along: beta and gamma, or those of six values and more, or whatever there is."""
    axes = swept(ds)
    if {"beta", "gamma"} <= set(axes):
        return ("gamma", "beta")
    long = tuple(name for name in axes if ds.sizes[name] >= _ENOUGH)
    return long or axes


def to_map(ds: xr.Dataset) -> tuple[str, ...]:
    """The axes of so many values that maps show more of them than lines: the frequency, then the longest."""
    long = [name for name in swept(ds) if ds.sizes[name] >= _MANY]
    return tuple(sorted(long, key=lambda name: (name != "frequency", -ds.sizes[name])))


def chosen(ds: xr.Dataset, x: str | None, y: str | None) -> tuple[str, str]:
    """The axes of a map: `x` and `y` where given, else those worth drawing along.

    Raises `InputError` where one is no axis, both are the same, or there is no second one.
    """
    axes = swept(ds)
    for name in (x, y):
        if name is not None and name not in axes:
            raise InputError(f'no map along "{name}": {suggestion(name, axes)}')
    if x is not None and x == y:
        raise InputError(f'a map needs two axes, "{x}" is given twice; choose from {", ".join(axes)}')
    rest = [name for name in (*to_draw(ds), *axes) if name not in (x, y)]
    if len(axes) < 2:
        raise InputError(f"no map: {', '.join(axes) or 'none'} is all that varies, and two axes are needed")
    first = x if x is not None else rest.pop(0)
    return first, y if y is not None else next(name for name in rest if name != first)


def without_single(ds: xr.Dataset) -> xr.Dataset:
    """`ds` with its axes of one value as scalars."""
    single = tuple(name for name in lane_dims(ds) if ds.sizes[name] == 1 and name != POINT)
    return ds.isel({name: 0 for name in single if name in ds.coords})


def is_geometric(values: np.ndarray) -> bool:
    """Whether `values` grow by a constant factor (and not, within the same bound, by a constant step)."""
    if values.size < 3 or values[0] <= 0 or np.any(np.diff(values) <= 0):
        return False
    factors, steps = values[1:] / values[:-1], np.diff(values)
    return bool(np.ptp(factors) <= 1e-3 * factors.mean() and np.ptp(steps) > 1e-3 * steps.mean())


def edges(values: np.ndarray) -> np.ndarray:
    """The n + 1 ends of the cells around n > 1 increasing `values`: halfway, in the logarithm for geometric ones."""
    if is_geometric(values):
        return np.exp(edges(np.log(values)))
    half = np.diff(values) / 2
    return np.concatenate([values[:1] - half[:1], values[:-1] + half, values[-1:] + half[-1:]])


def shape_axis(axes: Axes, which: str, values: np.ndarray) -> None:
    """Make the x or y axis of `axes` logarithmic for geometric `values`, with its ends at the ends of the cells."""
    ends = edges(values)
    limit, set_scale = (axes.set_xlim, axes.set_xscale) if which == "x" else (axes.set_ylim, axes.set_yscale)
    if is_geometric(values):
        set_scale("log")
        _plain_log_ticks(axes.xaxis if which == "x" else axes.yaxis, ends)
    limit(ends[0], ends[-1])


def _plain_log_ticks(axis: Axis, ends: np.ndarray) -> None:
    """1, 2, 5 and so on as plain numbers, where the axis spans less than three decades."""
    if ends[-1] / ends[0] < 1e3:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def is_numeric(data: xr.DataArray) -> bool:
    """Whether the values of `data` are numbers, rather than names."""
    return bool(np.issubdtype(data.dtype, np.number))
