"""Facts about a dataset that decide which picture fits it."""

import numpy as np
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.io.attributes import parameters_of
from vibrojax.io.variables import OWN_REGIMES

TIME, SETTING = "time", "setting"  # dimensions of a single run, and of a study of speed against error
START, POINT, RETURN, FORM = "start", "point", "return_index", "form"
MULTIPLIER = "multiplier"
ATTRACTOR, NAMED = "attractor", "named_start"  # attractors; the scene's named initial conditions, in addition to others
DIRECTION = "direction"  # up or down, of lanes carried along an axis
_GROUP = "group"  # the dimension of groups of rows of a table
HIDDEN, SENSITIVE = "hidden_motion", "sensitive"
REGIME, RATE, RELIEF, COEFFICIENT = "regime", "rate_of_penetration", "relief", "C"
IMPACTS_OF_RETURNS = "return_impact_velocity"
_NOT_STATES = ("return_time", "return_interval", "return_impacts", IMPACTS_OF_RETURNS)
BESIDE_REGIMES = (RATE, "impact_velocity", "period", "bit_amplitude")  # the first two that a dataset has
MOST_LINES = 8  # in one panel, and in the legend
ENOUGH = 6  # least number of values of an axis to draw along; fewer values are a choice between a few
_LONG = 9  # number of values of an axis from which one line per value is too many
_NOT_SWEPT = {START, POINT, RETURN, FORM, MULTIPLIER, ATTRACTOR, NAMED}
_EACH_LANE = (REGIME, RATE, COEFFICIENT, "status")  # of every lane: of a drill, of rock, of a fit, of any sweep


class Contents:
    """Facts about a dataset that decide which picture fits it."""

    def __init__(self, ds: xr.Dataset) -> None:
        self.variables = frozenset(str(name) for name in ds.variables)
        self.dimensions = frozenset(str(name) for name in ds.dims)
        # Swept axes: those to draw along, and whether a map fits.
        self.axes = axes_to_draw(ds)
        self.wide = sum(ds.sizes[name] >= ENOUGH for name in swept(ds)) > 1
        # The lanes form a list of points, rather than a grid; the parameters that vary along it; exactly two do.
        self.points = POINT in lane_dims(ds)
        self.varied = varied(ds)
        self.points_over_two = self.points and len(self.varied) == 2
        self.many_starts = many_starts(ds)
        # A single run over time; with the depths of bit and hole; of the bit on rock without the drill, which has x1.
        self.run = TIME in ds.dims
        self.hole = self.run and {"x3", "x4"} <= self.variables
        self.drill = self.run and {"x1", "v1", "x2", "v2"} <= self.variables
        self.bit_on_rock = self.run and "x3" in ds and "x1" not in ds
        self.swept_sine = ds.attrs.get("pulse_shape") == "sweep" and parameters_of(ds).get("sweep_rate", 0.0) != 0.0
        # A sweep with labelled lanes; that stored section crossings along an axis; of lanes carried up and down.
        self.regimes = REGIME in ds
        self.returns = self.regimes and returns_in(ds) is not None and bool(self.axes)
        self.carried = self.regimes and DIRECTION in ds.dims
        self.rates = RATE in ds
        self.law = COEFFICIENT in ds and FORM in ds.dims
        # Quantities along a single axis are drawn as curves, lanes with too many values for one line each as maps.
        self.quantities_over_one = len(self.axes) == 1 and bool(quantities_beside(ds))
        self.worth_a_map = len(long_axes(ds)) >= 2
        if self.points:
            self.worth_a_map = self.points_over_two and (self.regimes or min(self.varied.values()) > MOST_LINES)


def returns_in(ds: xr.Dataset) -> str | None:
    """Return the variable of section crossings that diagrams show: impact velocities, or else the first state.

    A system of the user's own whose motion repeats without impacts in some lanes is shown by its first state.
    """
    if IMPACTS_OF_RETURNS in ds and np.isfinite(ds[IMPACTS_OF_RETURNS].values).any():
        free = REGIME in ds and ds[REGIME].attrs.get("long_name") == OWN_REGIMES and {"cycles", "impacts"} <= {*ds}
        if not free or not ((ds["cycles"].values > 0) & (ds["impacts"].values == 0)).any():
            return IMPACTS_OF_RETURNS
    states = [str(name) for name in ds.data_vars if str(name).startswith("return_") and name not in _NOT_STATES]
    return states[0] if states else IMPACTS_OF_RETURNS if IMPACTS_OF_RETURNS in ds else None


def quantities_beside(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the names of the quantities that get a panel next to the regimes."""
    return tuple(name for name in BESIDE_REGIMES if name in ds and np.isfinite(ds[name].values).any())[:2]


def rates_in(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with axes of length 1 as scalars; raise `InputError` if it holds no rates of penetration."""
    return require(ds, RATE, f"no rates to draw: the dataset holds no variable {RATE}")


def law_in(fit: xr.Dataset) -> xr.Dataset:
    """Return the fit with axes of length 1 as scalars; raise `InputError` if it holds no C along `form`."""
    name = COEFFICIENT if COEFFICIENT in fit and FORM in fit[COEFFICIENT].dims else ""
    return require(named_groups(fit), name, "no law to draw: the dataset holds no variable C along form")


def require(ds: xr.Dataset, name: str, reason: str) -> xr.Dataset:
    """Return the dataset with axes of length 1 as scalars; raise `InputError` if it lacks the variable."""
    if name not in ds or ds[name].size == 0:
        raise InputError(reason)
    return without_single(ds)


def lane_dims(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the dimensions of a sweep's lanes or of a fit's groups; empty if the dataset has neither."""
    data = next((ds[name] for name in _EACH_LANE if name in ds), None)
    return () if data is None else tuple(str(name) for name in data.dims if name != FORM)


def many_starts(ds: xr.Dataset) -> bool:
    """Return whether every point has more initial conditions than colours, rows or panels are possible."""
    return START in lane_dims(ds) and ds.sizes[START] > MOST_LINES


def swept(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the grid's numeric axes with more than one value, in the order of the lane dimensions."""
    names = [name for name in lane_dims(ds) if name not in _NOT_SWEPT and name in ds.coords]
    return tuple(name for name in names if ds.sizes[name] > 1 and is_numeric(ds[name]))


def named_axes(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the string-valued axes with more than one value."""
    names = [name for name in lane_dims(ds) if name in ds.coords and name not in (POINT, FORM)]
    return tuple(name for name in names if ds.sizes[name] > 1 and not is_numeric(ds[name]))


def axes_to_draw(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the axes to draw along: gamma and beta if both vary, else axes with six or more values, else all."""
    axes = swept(ds)
    if {"beta", "gamma"} <= set(axes):
        return ("gamma", "beta")
    return tuple(name for name in axes if ds.sizes[name] >= ENOUGH) or axes


def long_axes(ds: xr.Dataset) -> tuple[str, ...]:
    """Return the axes with too many values for one line each: the frequency first, then by decreasing length."""
    names = [name for name in swept(ds) if ds.sizes[name] >= _LONG]
    return tuple(sorted(names, key=lambda name: (name != "frequency", -ds.sizes[name])))


def axes_of_map(ds: xr.Dataset, *preferred: str) -> tuple[str, str]:
    """Return the two axes of a map: the `preferred` ones, and then those to draw along.

    **Raises:** `InputError` if fewer than two axes vary.
    """
    axes = swept(ds)
    if len(axes) < 2:
        raise InputError(f"no map: {', '.join(axes) or 'none'} is all that varies, and two axes are needed")
    x, y, *_ = dict.fromkeys((*preferred, *axes_to_draw(ds), *axes))
    return x, y


def varied(ds: xr.Dataset, names: bool = False) -> dict[str, int]:
    """Return the parameters that vary along points, also those of strings if `names`, with their numbers of values."""
    along = {str(name): data for name, data in ds.coords.items() if data.dims == (POINT,) and name != POINT}
    counts = {name: len(set(data.values.tolist())) for name, data in along.items() if names or is_numeric(data)}
    return {name: count for name, count in counts.items() if count > 1}


def without_single(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with axes of length 1 as scalars."""
    names = (name for name in lane_dims(ds) if ds.sizes[name] == 1 and name != POINT)
    return ds.isel({name: 0 for name in names if name in ds.coords})


def named_groups(fit: xr.Dataset) -> xr.Dataset:
    """Return the fit with its groups as an axis like that of a sweep, if a single column distinguishes them."""
    columns = [str(name) for name, data in fit.coords.items() if data.dims == (_GROUP,)]
    return fit.swap_dims({_GROUP: columns[0]}) if len(columns) == 1 and _GROUP not in fit.coords else fit


def some_of(count: int) -> list[int]:
    """Return the indices of at most `MOST_LINES` of `count` items, evenly spread from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_LINES)).round().astype(int)).tolist()


def is_numeric(data: xr.DataArray) -> bool:
    """Return whether the values are numeric, rather than strings."""
    return bool(np.issubdtype(data.dtype, np.number))
