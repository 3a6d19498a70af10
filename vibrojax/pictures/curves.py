"""Curves over time or along an axis of a sweep; dense oscillations are drawn as bands."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Shaped
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D

from vibrojax.errors import InputError
from vibrojax.pictures.axes import is_geometric, label, scale, shape_axis, value_text
from vibrojax.pictures.colours import form_colour
from vibrojax.pictures.contents import FORM, MOST_LINES, POINT, START, is_numeric, lane_dims, named_axes, swept, varied
from vibrojax.pictures.sheet import LEGEND_WIDTH, Facets, new_grid
from vibrojax.pictures.style import (
    BIT,
    ROCK_COLOURS,
    SAVED_DPI,
    Mark,
    line_colours,
    other_colour,
    start_colour,
)

MOST_ROWS = 4
_PANEL_WIDTH = 3.3  # inches
_FREQUENCY = "frequency"  # preferred among axes of equal length


@dataclass(frozen=True)
class Across:
    """Horizontal axis of curves: the coordinate `name` times `factor`. `name` is empty if nothing varies.

    String values are placed at 0, 1, ...
    """

    name: str
    label: str
    values: Shaped[np.ndarray, " values"]
    factor: float
    is_number: bool

    def of(self, lanes: xr.Dataset) -> Float[np.ndarray, " lanes"]:
        """Return the positions of lanes along the axis."""
        if not self.name:
            return np.zeros(1)
        values = np.atleast_1d(lanes[self.name].values)
        if self.is_number:
            return np.asarray(values * self.factor, float)
        return np.array([float(self.values.tolist().index(value)) for value in values.tolist()])

    def shape(self, axes: Axes) -> None:
        if not self.name:
            axes.set_xticks([])
        elif not self.is_number:
            axes.set_xticks(range(len(self.values)), [str(value) for value in self.values])
            axes.set_xlim(-0.5, len(self.values) - 0.5)
        elif is_geometric(self.values):
            shape_axis(axes, "x", self.values)

    def style_of(self, ds: xr.Dataset) -> Literal["-", "none"]:
        """Return the line style along the axis, "none" for string values and for points of a list."""
        return "-" if self.is_number and POINT not in lane_dims(ds) else "none"


class Line(NamedTuple):
    """One line: its legend text `name`, its colour, and its lanes along one dimension."""

    name: str
    colour: str
    lanes: xr.Dataset


def longest_axis(ds: xr.Dataset) -> Across:
    """Return the longest numeric axis, preferably `frequency`; without numeric axes, the longest string-valued axis.

    **Raises:** `InputError` if there are several points and no parameter that distinguishes them.
    """
    numbers = varied(ds) if POINT in lane_dims(ds) else {name: ds.sizes[name] for name in swept(ds)}
    sizes = numbers or {name: ds.sizes[name] for name in named_axes(ds)}
    if not sizes:
        if ds.sizes.get(POINT, 1) > 1:
            raise InputError(f"nothing to draw over: no parameter varies along the {ds.sizes[POINT]} points")
        return Across("", "", np.zeros(1), 1.0, False)
    name = max(sizes, key=lambda name: (sizes[name], name == _FREQUENCY))
    if not numbers:
        return Across(name, name, ds[name].values, 1.0, False)
    factor = scale(ds[name])[0]
    return Across(name, label(ds[name]), np.unique(ds[name].values) * factor, factor, True)


def axis_of_lines(ds: xr.Dataset, along: str) -> str:
    """Return the axis with one line per value: the longest except `along`, `start` only if there is no other."""
    if POINT in lane_dims(ds):
        sizes = {name: count for name, count in varied(ds, names=True).items() if count <= MOST_LINES}
    else:
        sizes = {name: ds.sizes[name] for name in (*swept(ds), *named_axes(ds))}
    rest = [name for name in sizes if name != along]
    return max(rest, key=lambda name: (name != START, sizes[name], not is_numeric(ds[name])), default="")


def split_lines(ds: xr.Dataset, by: str) -> list[Line]:
    """Return the lines of a facet, one per value of the axis `by`; numeric values are sorted."""
    if not by:
        return [Line("", BIT, ds)]
    values = list(dict.fromkeys(ds[by].values.tolist()))
    values = sorted(values) if is_numeric(ds[by]) else values
    graded = line_colours(len(values))
    lines = []
    for position, value in enumerate(values):
        lanes = ds.isel({ds[by].dims[0]: np.flatnonzero(ds[by].values == value)})
        if is_numeric(ds[by]):
            colour = graded[position]
        elif by == FORM:
            colour = form_colour(value)
        else:
            colour = start_colour(value, position) if by == START else ROCK_COLOURS.get(value, other_colour(position))
        name = value_text(ds[by], value).removeprefix("rock: ").removeprefix("form: ")
        lines.append(Line(name, colour, lanes.isel({by: 0}) if by in lanes.dims else lanes))
    return lines


def line_handles(lines: Sequence[Line], mark: Mark) -> list[Artist]:
    """Return the legend entries for lines; of too many lines, an even selection from the first to the last."""
    if len(lines) == 1 and not lines[0].name:
        return []
    chosen = sorted({int(index) for index in np.linspace(0, len(lines) - 1, MOST_LINES).round()}) if lines else []
    marker = Mark(marker="o", markersize=4.0)
    return [Line2D([], [], label=lines[i].name, **marker | mark | Mark(color=lines[i].colour)) for i in chosen]


class Row(NamedTuple):
    """The panels of one facet, one per quantity. Only the row at the `bottom` has labels of the horizontal axis."""

    axes: list[Axes]
    facet: xr.Dataset
    bottom: bool

    def label(self, quantity: int, across: str, up: str) -> None:
        """Label the panel of one quantity, and draw grid lines."""
        axes = self.axes[quantity]
        axes.grid(True)
        axes.tick_params(labelbottom=self.bottom)
        axes.set_xlabel(across if self.bottom else "")
        axes.set_ylabel(up)


def new_rows(panels: Facets, quantities: int, above: float = 0.0) -> tuple[Figure, list[Row], SubplotSpec | None]:
    """Return an empty figure with room for a legend at the right, its rows of panels, and a free strip at the top.

    The panels of a quantity share their axes. The strip is `above` inches high; None is returned for zero inches.
    """
    count = len(panels)
    size = _PANEL_WIDTH * quantities + LEGEND_WIDTH, (2.9 if count == 1 else 2.3) * count + 0.8
    grid = new_grid(*size, above, [1.0] * count, [1.0] * quantities)
    rows: list[Row] = []
    for k, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        first = rows[0].axes if rows else [None] * quantities
        places = [grid.panels[k, i] for i in range(quantities)]
        axes = [grid.figure.add_subplot(place, sharex=a, sharey=a) for place, a in zip(places, first, strict=True)]
        axes[0].set_title(title, loc="left")
        rows.append(Row(axes, facet, k == count - 1))
    return grid.figure, rows, grid.above


_CYCLE_PIXELS = 5.0  # least width of a cycle that a line resolves
_COLUMN_PIXELS = 8  # a band takes minimum and maximum over this width: more than an unresolved cycle
_BAND_ALPHA = 0.3

Samples = Float[np.ndarray, " samples"]


def draw_over_time(axes: Axes, time: Samples, values: Samples, color: str, linewidth: float, label: str = "") -> Artist:
    """Draw values over time as a line, or as a band from minimum to maximum if a line would cover the panel.

    **Returns:** the line or the band, labelled `label`.
    """
    pixels = max(int(axes.bbox.width / axes.figure.dpi * SAVED_DPI), 1)
    height = float(np.ptp(values)) if values.size else 0.0
    # Number of cycles: the total variation over twice the height. Are the cycles too narrow for a line?
    if not (height > 0 and float(np.abs(np.diff(values)).sum()) / (2.0 * height) > pixels / _CYCLE_PIXELS):
        (line,) = axes.plot(time, values, color=color, linewidth=linewidth, label=label)
        return line
    count = max(pixels // _COLUMN_PIXELS, 1)
    column = np.minimum(np.floor((time - time[0]) / np.ptp(time) * count), count - 1)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    least, greatest = (reduce.reduceat(values, first) for reduce in (np.minimum, np.maximum))
    look: dict[str, Any] = {
        "facecolor": to_rgba(color, _BAND_ALPHA),
        "edgecolor": to_rgba(color, 0.9),
        "linewidth": 0.6,
    }
    ends = np.append(time[first], time[-1])  # the last column ends here
    return axes.fill_between(
        ends, np.append(least, least[-1]), np.append(greatest, greatest[-1]), label=label, step="post", **look
    )


def is_band(drawn: Artist) -> bool:
    """Return whether the artist from [vibrojax.pictures.curves.draw_over_time][] is a band."""
    return isinstance(drawn, PolyCollection)


def band_text(*panels: Axes) -> str:
    """Return the note on bands, or "" if no panel has a band."""
    if not any(is_band(drawn) for axes in panels for drawn in axes.collections):
        return ""
    return "Bands: from the least to the greatest value, where the oscillations are too many to be told apart"
