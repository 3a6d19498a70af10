"""Curves along an axis of a sweep: the axis, one line per value of another axis, and rows of panels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Shaped

from vibrojax.errors import InputError
from vibrojax.pictures.axes import is_geometric, label, map_axis, scale, value_text
from vibrojax.pictures.colours import form_colour
from vibrojax.pictures.contents import FORM, MOST_LINES, POINT, START, is_numeric, lane_dims, named_axes, swept, varied
from vibrojax.pictures.plots import Axis, Dash, Line, key
from vibrojax.pictures.sheet import LEGEND_WIDTH, Facets
from vibrojax.pictures.style import BIT, ROCK_COLOURS, line_colours, other_colour, start_colour

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

    def axis(self, ds: xr.Dataset, **about: Any) -> Axis:
        """Return the axis of a plot of lanes of the dataset."""
        about = {"label": self.label, "name": self.name, "group": "across"} | about
        if not self.name:
            return Axis(**{"ticks": [], **about})
        if not self.is_number:
            ticks = [(float(k), str(value)) for k, value in enumerate(self.values)]
            about = {"limits": (-0.5, len(ticks) - 0.5), **about}
            return Axis(ticks=ticks, **about)
        return map_axis(ds[self.name], **about) if is_geometric(self.values) else Axis(**about)

    def dash(self, ds: xr.Dataset) -> Dash:
        """Return the line style along the axis, none for string values and for points of a list."""
        return "-" if self.is_number and POINT not in lane_dims(ds) else ""


class Series(NamedTuple):
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


def split_lines(ds: xr.Dataset, by: str) -> list[Series]:
    """Return the lines of a facet, one per value of the axis `by`; numeric values are sorted."""
    if not by:
        return [Series("", BIT, ds)]
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
        lines.append(Series(name, colour, lanes.isel({by: 0}) if by in lanes.dims else lanes))
    return lines


def line_keys(lines: Sequence[Series], **look: Any) -> list[Line]:
    """Return the legend entries for lines; of too many lines, an even selection from the first to the last."""
    if len(lines) == 1 and not lines[0].name:
        return []
    chosen = sorted({int(index) for index in np.linspace(0, len(lines) - 1, MOST_LINES).round()}) if lines else []
    return [key(lines[i].name, **{"marker": "o", "size": 4.0, "colour": lines[i].colour, **look}) for i in chosen]


def path_of(line: Series, x: Across, values: xr.DataArray, **look: Any) -> Line:
    """Return a series as a line with markers over the axis."""
    return Line(
        x.of(line.lanes), np.ravel(values.values), **{"colour": line.colour, "marker": "o", "size": 3.0, **look}
    )


def rows_of(panels: Facets, quantities: int) -> dict[str, Any]:
    """Return the size and the ratios of a sheet with one row per facet, and room for a legend at the right."""
    count = len(panels)
    size = _PANEL_WIDTH * quantities + LEGEND_WIDTH, (2.9 if count == 1 else 2.3) * count + 0.8
    return {"size": size, "widths": (1.0,) * quantities, "heights": (1.0,) * count}
