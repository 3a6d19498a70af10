"""Curves over a sweep: a row for each facet, a column for each quantity, a line for each value of one more axis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Float, Shaped
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D

from vibrojax.errors import InputError
from vibrojax.plot.axes import is_geometric, label, scale, shape_axis, value_text
from vibrojax.plot.colours import form_colour
from vibrojax.plot.contents import FORM, MOST_LINES, POINT, START, is_numeric, lane_dims, named_axes, swept, varied
from vibrojax.plot.margins import LEGEND_WIDTH
from vibrojax.plot.sheet import Facets
from vibrojax.plot.style import BIT, COLOURS, OTHER_COLOURS, ROCK_COLOURS, Mark, divided, new_figure, start_colour

MOST_ROWS = 4
_WIDTH = 3.3  # inches of a panel
_FREQUENCY = "frequency"  # the axis to draw along where others are as long
_VIRIDIS = (0.0, 0.87)  # its yellow end is lost on white


@dataclass(frozen=True)
class Across:
    """The axis `name` that lines are drawn along, times `factor`; no name where nothing varies.

    Names are drawn at 0, 1, ...
    """

    name: str
    label: str
    values: Shaped[np.ndarray, " values"]
    factor: float
    is_number: bool

    def of(self, lanes: xr.Dataset) -> Float[np.ndarray, " lanes"]:
        """Where `lanes` lie along the axis."""
        if not self.name:
            return np.zeros(1)
        values = np.atleast_1d(lanes[self.name].values)
        if self.is_number:
            return np.asarray(values * self.factor, float)
        return np.array([float(self.values.tolist().index(value)) for value in values.tolist()])

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


@dataclass(frozen=True)
class Row:
    """The axes of one facet, one for each quantity; `bottom` where labels of the axis across go."""

    axes: tuple[Axes, ...]
    facet: xr.Dataset
    bottom: bool


def across(ds: xr.Dataset) -> Across:
    """The longest axis of numbers, `frequency` among equals; an axis of names where there is no other.

    Raises `InputError` where there are several points and no parameter that tells them apart.
    """
    numbers = varied(ds) if POINT in lane_dims(ds) else {name: ds.sizes[name] for name in swept(ds)}
    sizes = numbers or {name: ds.sizes[name] for name in named_axes(ds)}
    if not sizes and ds.sizes.get(POINT, 1) > 1:
        raise InputError(f"nothing to draw over: no parameter varies along the {ds.sizes[POINT]} points")
    if not sizes:
        return Across("", "", np.zeros(1), 1.0, False)
    name = max(sizes, key=lambda name: (sizes[name], name == _FREQUENCY))
    if not numbers:
        return Across(name, name, ds[name].values, 1.0, False)
    factor = scale(ds[name])[0]
    return Across(name, label(ds[name]), np.unique(ds[name].values) * factor, factor, True)


def axis_of_lines(ds: xr.Dataset, along: str) -> str:
    """The axis whose values are lines of one colour each: the longest but `along`, last the start."""
    if POINT in lane_dims(ds):
        sizes = {name: count for name, count in varied(ds, names=True).items() if count <= MOST_LINES}
    else:
        sizes = {name: ds.sizes[name] for name in (*swept(ds), *named_axes(ds))}
    rest = [name for name in sizes if name != along]
    return max(rest, key=lambda name: (name != START, sizes[name], not is_numeric(ds[name])), default="")


def lines(ds: xr.Dataset, by: str) -> list[Line]:
    """The lines of a facet, one for each value of the axis `by`, in the order of numbers."""
    if not by:
        return [Line("", BIT, ds)]
    values = list(dict.fromkeys(ds[by].values.tolist()))
    values = sorted(values) if is_numeric(ds[by]) else values
    parts = [ds.isel({ds[by].dims[0]: np.flatnonzero(ds[by].values == value)}) for value in values]
    parts = [lanes.isel({by: 0}) if by in lanes.dims else lanes for lanes in parts]
    names = [value_text(ds[by], value).removeprefix("rock: ").removeprefix("form: ") for value in values]
    return [Line(*one) for one in zip(names, _colours(ds[by], values), parts, strict=True)]


def line_handles(drawn: Sequence[Line], mark: Mark) -> list[Artist]:
    """The legend's entries; where there are too many lines, for some of them, from the first to the last."""
    if len(drawn) == 1 and not drawn[0].name:
        return []
    shown = sorted({int(at) for at in np.linspace(0, len(drawn) - 1, MOST_LINES).round()}) if drawn else []
    marker = Mark(marker="o", markersize=4.0)
    return [Line2D([], [], label=drawn[at].name, **marker | mark | Mark(color=drawn[at].colour)) for at in shown]


def rows(panels: Facets, quantities: int, above: float = 0.0) -> tuple[Figure, tuple[Row, ...], SubplotSpec | None]:
    """An empty figure, with room for a legend at the right, and the axes of each facet of `panels`.

    The panels of a quantity share their axes. Last, a place `above` them of so many inches, if any.
    """
    count = len(panels)
    figure = new_figure(_WIDTH * quantities + LEGEND_WIDTH, (2.9 if count == 1 else 2.3) * count + 0.8 + above)
    over, place = divided(figure, above)
    grid = place.subgridspec(count, quantities)
    drawn: list[Row] = []
    for at, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        first = drawn[0].axes if drawn else (None,) * quantities
        axes = [figure.add_subplot(grid[at, i], sharex=first[i], sharey=first[i]) for i in range(quantities)]
        axes[0].set_title(title, loc="left")
        drawn.append(Row(tuple(axes), facet, at == count - 1))
    return figure, tuple(drawn), over


def label_axes(row: Row, quantity: int, across: str, up: str) -> None:
    """Label the axes of one quantity of `row` where labels go, above a grid."""
    axes = row.axes[quantity]
    axes.grid(True)
    axes.tick_params(labelbottom=row.bottom)
    axes.set_xlabel(across if row.bottom else "")
    axes.set_ylabel(up)


def _colours(data: xr.DataArray, values: Sequence[float | str]) -> list[str]:
    """In order for numbers; a rock's and a start's own for names."""
    if is_numeric(data):
        return [to_hex(colormaps[COLOURS.get() or "viridis"](share)) for share in np.linspace(*_VIRIDIS, len(values))]
    if data.name == FORM:
        return [form_colour(str(value)) for value in values]
    if data.name == START:
        return [start_colour(str(value), at) for at, value in enumerate(values)]
    return [ROCK_COLOURS.get(str(value), OTHER_COLOURS[at % len(OTHER_COLOURS)]) for at, value in enumerate(values)]
