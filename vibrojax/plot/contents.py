"""What a dataset holds, by its dimensions, variables and attributes: the facts that decide which picture fits it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, printable, suggestion
from vibrojax.io.attributes import differing_of, parameters_of
from vibrojax.plot.drawable import plain

TIME, SETTING = "time", "setting"  # the dimension of a run, and of a study of speed against error
START, POINT, RETURN, FORM = "start", "point", "return_index", "form"
MULTIPLIER = "multiplier"
ATTRACTOR, NAMED = "attractor", "named_start"  # of attractors; and the scene's own starts beside others
DIRECTION = "direction"  # of lanes that are carried along an axis
_GROUP = "group"  # the dimension of groups of rows of a table
HIDDEN, SENSITIVE = "hidden_motion", "sensitive"
REGIME, RATE, RELIEF, COEFFICIENT = "regime", "rate_of_penetration", "relief", "C"
RETURNS, ERROR = "return_impact_velocity", "error_worst"
BESIDE_REGIMES = (RATE, "impact_velocity", "period", "bit_amplitude")  # the first two of these that a dataset has

MOST_LINES = 8  # in one panel, and in the legend
_NOT_SWEPT = {START, POINT, RETURN, FORM, MULTIPLIER, ATTRACTOR, NAMED}
_EACH_LANE = (REGIME, RATE, COEFFICIENT, "status")  # what every lane has one of: of a drill, rock, a fit, any sweep
_MANY = 9  # values of an axis from which lines, one for each, are too many
ENOUGH = 6  # values from which an axis is one to draw along, rather than a choice between a few


@dataclass(frozen=True)
class Contents:
    """The facts about a dataset that decide which picture fits it.

    - `variables`, `dimensions`: their names.
    - `axes`: the axes to draw along; `long`: those of so many values that a map shows more of them than lines; `wide`:
      whether two of them are more than a choice between a few.
    - `varied`: the parameters that vary along a list of points, each with its number of values.
    - `beside`: the quantities worth a panel beside the regimes.
    - `many_starts`: whether every point runs from more starts than have a panel each.
    - `swept_sine`: whether the force of a run is a sine of a frequency that changes.
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
        """One run over time."""
        return TIME in self.dimensions

    @property
    def bit_on_rock(self) -> bool:
        """A run of the bit on rock, without the drill: with the hole's bottom, without displacements on springs."""
        return self.run and "x3" in self.variables and "x1" not in self.variables

    @property
    def hole(self) -> bool:
        """A run with the bit's depth and the hole's."""
        return self.run and {"x3", "x4"} <= self.variables

    @property
    def regimes(self) -> bool:
        """A sweep that labelled its lanes."""
        return REGIME in self.variables

    @property
    def returns(self) -> bool:
        """A sweep that kept the returns to the section, over an axis at least."""
        return self.regimes and RETURNS in self.variables and bool(self.axes)

    @property
    def carried(self) -> bool:
        """A sweep whose lanes were carried up and down along an axis."""
        return self.regimes and DIRECTION in self.dimensions

    @property
    def rates(self) -> bool:
        """A sweep of a scene with rock."""
        return RATE in self.variables

    @property
    def law(self) -> bool:
        """A fit of the law in its forms."""
        return COEFFICIENT in self.variables and FORM in self.dimensions

    @property
    def points_over_two(self) -> bool:
        """A list of points over two parameters."""
        return self.points and len(self.varied) == 2

    @property
    def quantities_over_one(self) -> bool:
        """Quantities worth curves, along one axis."""
        return len(self.axes) == 1 and bool(self.beside)

    @property
    def worth_a_map(self) -> bool:
        """Whether the lanes spread over two parameters of so many values that lines, one for each, are too many."""
        if not self.points:
            return len(self.long) >= 2
        return self.points_over_two and (self.regimes or min(self.varied.values()) > MOST_LINES)


def contents(ds: xr.Dataset) -> Contents:
    """The facts about `ds`."""
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
    """Whether the lanes of `ds` are labelled."""
    return REGIME in ds


def regimes_in(ds: xr.Dataset) -> xr.Dataset:
    """`ds` without axes of one value; raises `InputError` where it holds no regimes."""
    if not has_regimes(ds) or ds[REGIME].size == 0:
        raise InputError('no regimes to draw: the dataset holds no variable "regime"')
    return without_single(ds)


def rates_in(ds: xr.Dataset) -> xr.Dataset:
    """`ds` without axes of one value; raises `InputError` where it holds no rates of penetration."""
    if RATE not in ds or ds[RATE].size == 0:
        raise InputError(f"no rates to draw: the dataset holds no variable {RATE}")
    return without_single(ds)


def law_in(fit: xr.Dataset) -> xr.Dataset:
    """`fit` without axes of one value; raises `InputError` where it holds no coefficient of the law's forms."""
    if COEFFICIENT not in fit or FORM not in fit[COEFFICIENT].dims or fit[COEFFICIENT].size == 0:
        raise InputError("no law to draw: the dataset holds no variable C along form")
    return without_single(named_groups(fit))


def lane_dims(ds: xr.Dataset) -> tuple[str, ...]:
    """The dimensions of the lanes of a sweep, or of the groups of a fit; none where there are neither."""
    data = next((ds[name] for name in _EACH_LANE if name in ds), None)
    return () if data is None else tuple(str(name) for name in data.dims if name != FORM)


def many_starts(ds: xr.Dataset) -> bool:
    """Whether every point runs from more starts than have a colour, a row or a panel each."""
    return START in lane_dims(ds) and ds.sizes[START] > MOST_LINES


def swept(ds: xr.Dataset) -> tuple[str, ...]:
    """The grid's axes of more than one value that are numbers, in the order of the lanes' dimensions."""
    names = [name for name in lane_dims(ds) if name not in _NOT_SWEPT and name in ds.coords]
    return tuple(name for name in names if ds.sizes[name] > 1 and is_numeric(ds[name]))


def named_axes(ds: xr.Dataset) -> tuple[str, ...]:
    """The axes of more than one value that are names."""
    names = [name for name in lane_dims(ds) if name in ds.coords and name not in (POINT, FORM)]
    return tuple(name for name in names if ds.sizes[name] > 1 and not is_numeric(ds[name]))


def axes_to_draw(ds: xr.Dataset) -> tuple[str, ...]:
    """The axes worth drawing along: beta and gamma, or those of six values and more, or whatever there is."""
    axes = swept(ds)
    if {"beta", "gamma"} <= set(axes):
        return ("gamma", "beta")
    long = tuple(name for name in axes if ds.sizes[name] >= ENOUGH)
    return long or axes


def long_axes(ds: xr.Dataset) -> tuple[str, ...]:
    """The axes of so many values that maps show more of them than lines: the frequency, then the longest."""
    long = [name for name in swept(ds) if ds.sizes[name] >= _MANY]
    return tuple(sorted(long, key=lambda name: (name != "frequency", -ds.sizes[name])))


def axes_of_map(ds: xr.Dataset, x: str | None, y: str | None) -> tuple[str, str]:
    """The axes of a map: `x` and `y` where given, else those worth drawing along.

    Raises `InputError` where one is no axis, both are the same, or there is no second one.
    """
    axes = swept(ds)
    for name in (x, y):
        if name is not None and name not in axes:
            raise InputError(f'no map along "{name}": {suggestion(name, axes)}')
    if x is not None and x == y:
        raise InputError(f'a map needs two axes, "{x}" is given twice; choose from {", ".join(axes)}')
    rest = [name for name in (*axes_to_draw(ds), *axes) if name not in (x, y)]
    if len(axes) < 2:
        raise InputError(f"no map: {', '.join(axes) or 'none'} is all that varies, and two axes are needed")
    first = x if x is not None else rest.pop(0)
    return first, y if y is not None else next(name for name in rest if name != first)


def varied(ds: xr.Dataset, names: bool = False) -> dict[str, int]:
    """The parameters along the points that take more than one value, and how many; those that are names if wanted."""
    along = {str(name): data for name, data in ds.coords.items() if data.dims == (POINT,) and name != POINT}
    counts = {name: len(set(data.values.tolist())) for name, data in along.items() if names or is_numeric(data)}
    return {name: count for name, count in counts.items() if count > 1}


def without_single(ds: xr.Dataset) -> xr.Dataset:
    """`ds` with its axes of one value as scalars."""
    single = tuple(name for name in lane_dims(ds) if ds.sizes[name] == 1 and name != POINT)
    return ds.isel({name: 0 for name in single if name in ds.coords})


def named_groups(fit: xr.Dataset) -> xr.Dataset:
    """`fit` with groups of rows that one column tells apart along that column, as along an axis of a sweep."""
    columns = [str(name) for name, data in fit.coords.items() if data.dims == (_GROUP,)]
    return fit.swap_dims({_GROUP: columns[0]}) if len(columns) == 1 and _GROUP not in fit.coords else fit


def differing_from_defaults(ds: xr.Dataset) -> tuple[xr.DataArray, ...]:
    """Return the fixed parameters whose values are not the defaults."""
    return tuple(
        xr.DataArray(
            parameter["value"],
            name=parameter["name"],
            attrs={name: plain(printable(parameter[name], 40)) for name in ("units", "symbol")},
        )
        for parameter in differing_of(ds)
    )


def is_numeric(data: xr.DataArray) -> bool:
    """Whether the values of `data` are numbers, rather than names."""
    return bool(np.issubdtype(data.dtype, np.number))
