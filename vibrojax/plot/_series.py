"""Lines over a sweep: what lies along them, what tells them apart, and in which colours."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D

from vibrojax.plot._grid import FORM, POINT, START, is_geometric, is_numeric, lane_dims, shape_axis, swept
from vibrojax.plot._labels import label, scale, value_text
from vibrojax.plot._style import BIT, OTHER_COLOURS, ROCK_COLOURS, start_colour

_FREQUENCY = "frequency"  # the axis to draw along where others are as long
MOST_LINES = 8  # in the legend, from the first to the last
_VIRIDIS = (0.0, 0.87)  # its yellow end is lost on white


@dataclass(frozen=True)
class Across:
    """The axis `name` that lines are drawn along, times `factor`; no name where nothing varies.

    Names are drawn at 0, 1, ...
    """

    name: str
    label: str
    values: np.ndarray
    factor: float
    is_number: bool

    def of(self, lanes: xr.Dataset) -> np.ndarray:
        """Where `lanes` lie along the axis."""
        if not self.name:
            return np.zeros(1)
        found = np.atleast_1d(lanes[self.name].values)
        if self.is_number:
            return found * self.factor
        return np.array([self.values.tolist().index(value) for value in found.tolist()])

    def shape(self, axes: Axes) -> None:
        """Give `axes` the scale and the ticks of this one."""
        if not self.name:
            axes.set_xticks([])
        elif not self.is_number:
            axes.set_xticks(range(len(self.values)), [str(value) for value in self.values])
            axes.set_xlim(-0.5, len(self.values) - 0.5)
        elif is_geometric(self.values):
            shape_axis(axes, "x", self.values)


@dataclass(frozen=True)
class Line:
    """One line: its lanes, along one dimension, the name of its value among those of its axis, and its colour."""

    name: str
    colour: str
    lanes: xr.Dataset


def across(ds: xr.Dataset) -> Across:
    """The longest axis of numbers, `frequency` among equals; an axis of names where there is no other."""
    numbers = _varied(ds) if POINT in lane_dims(ds) else {name: ds.sizes[name] for name in swept(ds)}
    sizes = numbers or {name: ds.sizes[name] for name in _named_axes(ds)}
    if not sizes:
        return Across("", "", np.zeros(1), 1.0, False)
    name = max(sizes, key=lambda name: (sizes[name], name == _FREQUENCY))
    if not numbers:
        return Across(name, str(name), ds[name].values, 1.0, False)
    factor = scale(ds[name])[0]
    return Across(name, label(ds[name]), np.unique(ds[name].values) * factor, factor, True)


def apart(ds: xr.Dataset, along: str) -> str:
    """The axis whose values are lines of one colour each: the longest but `along`, last the start."""
    if POINT in lane_dims(ds):
        sizes = {name: count for name, count in _varied(ds, names=True).items() if count <= MOST_LINES}
    else:
        sizes = {name: ds.sizes[name] for name in (*swept(ds), *_named_axes(ds))}
    rest = [name for name in sizes if name != along]
    return max(rest, key=lambda name: (name != START, sizes[name], not is_numeric(ds[name])), default="")


def lines(ds: xr.Dataset, by: str) -> list[Line]:
    """The lines of a facet, one for each value of the axis `by`, in the order of numbers."""
    if not by:
        return [Line("", BIT, ds)]
    values = list(dict.fromkeys(ds[by].values.tolist()))
    values = sorted(values) if is_numeric(ds[by]) else values
    found = [ds.isel({ds[by].dims[0]: np.flatnonzero(ds[by].values == value)}) for value in values]
    found = [lanes.isel({by: 0}) if by in lanes.dims else lanes for lanes in found]
    names = [value_text(ds[by], value).removeprefix("rock: ") for value in values]
    return [Line(*one) for one in zip(names, _colours(ds[by], values), found, strict=True)]


def line_handles(drawn: list[Line], **look: object) -> list[Artist]:
    """The legend's entries; where there are too many lines, for some of them, from the first to the last."""
    if len(drawn) == 1 and not drawn[0].name:
        return []
    shown = np.unique(np.linspace(0, len(drawn) - 1, MOST_LINES).round().astype(int)) if drawn else []
    marks: dict[str, object] = {"marker": "o", "markersize": 4.0} | look
    return [Line2D([], [], color=drawn[at].colour, label=drawn[at].name, **marks) for at in shown]


def _colours(data: xr.DataArray, values: list) -> list[str]:
    """In order for numbers; a rock's and a start's own for names."""
    if is_numeric(data):
        return [to_hex(colormaps["viridis"](share)) for share in np.linspace(*_VIRIDIS, len(values))]
    if data.name == START:
        return [start_colour(str(value), at) for at, value in enumerate(values)]
    return [ROCK_COLOURS.get(str(value), OTHER_COLOURS[at % len(OTHER_COLOURS)]) for at, value in enumerate(values)]


def _named_axes(ds: xr.Dataset) -> list[str]:
    """The axes of more than one value that are names."""
    names = [name for name in lane_dims(ds) if name in ds.coords and name not in (POINT, FORM)]
    return [name for name in names if ds.sizes[name] > 1 and not is_numeric(ds[name])]


def _varied(ds: xr.Dataset, names: bool = False) -> dict[str, int]:
    """The parameters along the points that take more than one value, and how many; those that are names if wanted."""
    along = {str(name): data for name, data in ds.coords.items() if data.dims == (POINT,) and name != POINT}
    counts = {name: len(set(data.values.tolist())) for name, data in along.items() if names or is_numeric(data)}
    return {name: count for name, count in counts.items() if count > 1}
