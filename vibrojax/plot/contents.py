"""Facts about a dataset's dimensions, variables and attributes that decide which picture fits it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, suggestion
from vibrojax.io.attributes import parameters_of

TIME, SETTING = "time", "setting"  # dimensions of a single run, and of a study of speed against error
START, POINT, RETURN, FORM = "start", "point", "return_index", "form"
MULTIPLIER = "multiplier"
ATTRACTOR, NAMED = "attractor", "named_start"  # attractors; the scene's named initial conditions, in addition to others
DIRECTION = "direction"  # up or down, of lanes carried along an axis
_GROUP = "group"  # the dimension of groups of rows of a table
HIDDEN, SENSITIVE = "hidden_motion", "sensitive"
REGIME, RATE, RELIEF, COEFFICIENT = "regime", "rate_of_penetration", "relief", "C"
RETURNS = "return_impact_velocity"
BESIDE_REGIMES = (RATE, "impact_velocity", "period", "bit_amplitude")  # the first two that a dataset has

MOST_LINES = 8  # in one panel, and in the legend
ENOUGH = 6  # least number of values of an axis to draw along; fewer values are a choice between a few
_LONG = 9  # number of values of an axis from which one line per value is too many
_NOT_SWEPT = {START, POINT, RETURN, FORM, MULTIPLIER, ATTRACTOR, NAMED}
_EACH_LANE = (REGIME, RATE, COEFFICIENT, "status")  # of every lane: of a drill, of rock, of a fit, of any sweep


@dataclass(frozen=True)
class Contents:
    """Facts about a dataset that decide which picture fits it.

    - `variables`, `dimensions`: their names.
    - `axes`: swept axes to draw along; `long`: swept axes with too many values for one line each; `wide`: whether at
      least two swept axes have enough values for a map.
    - `varied`: the parameters that vary along a list of points, with their numbers of values.
    - `beside`: the quantities that get a panel next to the regimes.
    - `points`: whether the lanes form a list of points, rather than a grid.
    - `many_starts`: whether every point has more initial conditions than panels are possible.
    - `swept_sine`: whether the force of a run is a sine of changing frequency.
    """

    variables: frozenset[str]
    dimensions: frozenset[str]
    axes: tuple[str, ...]
    long: tuple[str, ...]
    wide: bool
    varied: Mapping[str, int]
    beside: tuple[str, ...]
    points: bool
    many_starts: bool
    swept_sine: bool

    @property
    def run(self) -> bool:
        """True for a single run over time."""
        return TIME in self.dimensions

    @property
    def bit_on_rock(self) -> bool:
        """True for a run of the bit on rock without the drill: it has the bit in the hole, `x3`, but no `x1`."""
        return self.run and "x3" in self.variables and "x1" not in self.variables

    @property
    def hole(self) -> bool:
        """True for a run with the depths of bit (`x3`) and hole (`x4`)."""
        return self.run and {"x3", "x4"} <= self.variables

    @property
    def regimes(self) -> bool:
        """True for a sweep whose lanes have regime labels."""
        return REGIME in self.variables

    @property
    def returns(self) -> bool:
        """True for a labelled sweep over at least one axis that stored the section crossings."""
        return self.regimes and RETURNS in self.variables and bool(self.axes)

    @property
    def carried(self) -> bool:
        """True for a labelled sweep whose lanes were carried up and down along an axis."""
        return self.regimes and DIRECTION in self.dimensions

    @property
    def rates(self) -> bool:
        """True for a sweep of a scene with rock."""
        return RATE in self.variables

    @property
    def law(self) -> bool:
        """True for a fit of several formulas of the penetration law."""
        return COEFFICIENT in self.variables and FORM in self.dimensions

    @property
    def points_over_two(self) -> bool:
        """True for a list of points over two parameters."""
        return self.points and len(self.varied) == 2

    @property
    def quantities_over_one(self) -> bool:
        """True for quantities along a single axis, which are drawn as curves."""
        return len(self.axes) == 1 and bool(self.beside)

    @property
    def worth_a_map(self) -> bool:
        """True for lanes over two parameters that both have too many values for one line each."""
        if not self.points:
            return len(self.long) >= 2
        return self.points_over_two and (self.regimes or min(self.varied.values()) > MOST_LINES)


def contents(ds: xr.Dataset) -> Contents:
    """Return the facts about a dataset that decide which picture fits it."""
    return Contents(
        variables=frozenset(str(name) for name in ds.variables),
        dimensions=frozenset(str(name) for name in ds.dims),
        axes=axes_to_draw(ds),
        long=long_axes(ds),
        wide=sum(ds.sizes[name] >= ENOUGH for name in swept(ds)) > 1,
        varied=varied(ds),
        beside=tuple(name for name in BESIDE_REGIMES if name in ds and np.isfinite(ds[name].values).any())[:2],
        points=POINT in lane_dims(ds),
        many_starts=many_starts(ds),
        swept_sine=ds.attrs.get("pulse_shape") == "sweep" and parameters_of(ds).get("sweep_rate", 0.0) != 0.0,
    )


def has_regimes(ds: xr.Dataset) -> bool:
    """Return whether the lanes have regime labels."""
    return REGIME in ds


def regimes_in(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with axes of length 1 as scalars; raise `InputError` if it holds no regimes."""
    return _require(ds, REGIME, 'no regimes to draw: the dataset holds no variable "regime"')


def rates_in(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with axes of length 1 as scalars; raise `InputError` if it holds no rates of penetration."""
    return _require(ds, RATE, f"no rates to draw: the dataset holds no variable {RATE}")


def law_in(fit: xr.Dataset) -> xr.Dataset:
    """Return the fit with axes of length 1 as scalars; raise `InputError` if it holds no C along `form`."""
    reason = "no law to draw: the dataset holds no variable C along form"
    if COEFFICIENT in fit and FORM not in fit[COEFFICIENT].dims:
        raise InputError(reason)
    return _require(named_groups(fit), COEFFICIENT, reason)


def _require(ds: xr.Dataset, name: str, reason: str) -> xr.Dataset:
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


def axes_of_map(ds: xr.Dataset, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the two axes of a map: `x` and `y`, each None replaced by the first remaining axis to draw along.

    **Raises:** `InputError` if a name is not an axis, both names are the same, or fewer than two axes vary.
    """
    axes = swept(ds)
    for name in (x, y):
        if name is not None and name not in axes:
            raise InputError(f'no map along "{name}": {suggestion(name, axes)}')
    if x is not None and x == y:
        raise InputError(f'a map needs two axes, "{x}" is given twice; choose from {", ".join(axes)}')
    if len(axes) < 2:
        raise InputError(f"no map: {', '.join(axes) or 'none'} is all that varies, and two axes are needed")
    rest = [name for name in (*axes_to_draw(ds), *axes) if name not in (x, y)]
    first = x if x is not None else rest.pop(0)
    return first, y if y is not None else next(name for name in rest if name != first)


def varied(ds: xr.Dataset, names: bool = False) -> dict[str, int]:
    """Return the parameters that vary along a list of points, with their numbers of values.

    `names`: include parameters whose values are strings.
    """
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


def is_numeric(data: xr.DataArray) -> bool:
    """Return whether the values are numeric, rather than strings."""
    return bool(np.issubdtype(data.dtype, np.number))
