"""The layout of pictures along one axis: for each facet curves above, and a strip of regimes for each start below."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D

from vibrojax.plot._about import point_text
from vibrojax.plot._facets import Facets, columns, facets
from vibrojax.plot._flags import COLOUR_MAP, NORM, flags, legend_handles
from vibrojax.plot._grid import START, edges, lane_dims, shape_axis
from vibrojax.plot._labels import label, scale
from vibrojax.plot._sheet import write_margins
from vibrojax.plot._style import new_figure, start_colour

LEGEND_WIDTH = 1.9  # inches, about


@dataclass(frozen=True)
class Stack:
    """The axes of one facet: those of the curves, from above, and that of the strip."""

    curves: tuple[Axes, ...]
    strip: Axes
    facet: xr.Dataset
    left: bool


def draw_stacks(
    ds: xr.Dataset,
    x: str,
    curves: int,
    height: Callable[[int], float],
    draw: Callable[[Stack], None],
    linestyle: str = "-",
) -> Figure:
    """A picture along `x`: what `draw` draws on `curves` panels of each facet, above the regimes of each start.

    `height` [inch] of such a panel, by the number of facets; `linestyle` joins the marks in the legend.
    """
    panels = facets(ds.sortby(x), (x, START))
    figure, drawn = _stacks(panels, curves, height(len(panels)))
    for stack in drawn:
        draw(stack)
        _draw_strip(stack, x)
    handles = legend_handles([facet["regime"] for facet in panels.data])
    legend_at_right(figure, start_handles(ds, linestyle), list(handles))
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), panels.note, legend=LEGEND_WIDTH)
    return figure


def _stacks(panels: Facets, curves: int, height: float) -> tuple[Figure, tuple[Stack, ...]]:
    """A figure with a stack of `curves` panels, each `height` inches high, and a strip for each facet."""
    wide = columns(panels, 3)
    deep = -(-len(panels) // wide)
    strip = 0.10 + 0.17 * max(panels.data[0].sizes.get(START, 1), 1)
    figure = new_figure({1: 7.6, 2: 10.0, 3: 12.5}[wide], (curves * height + strip + 0.6) * deep + 0.7)
    outer = GridSpec(deep, wide, figure)
    drawn: list[Stack] = []
    for at, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        row, column = divmod(at, wide)
        inner = outer[row, column].subgridspec(curves + 1, 1, height_ratios=[height] * curves + [strip])
        axes = [figure.add_subplot(inner[i]) for i in range(curves + 1)]
        _join(axes, drawn[0].curves if drawn else ())
        axes[0].set_title(title, loc="left")
        drawn.append(Stack(tuple(axes[:-1]), axes[-1], facet, column == 0))
    return figure, tuple(drawn)


def _join(axes: list[Axes], first: tuple[Axes, ...]) -> None:
    """One x axis down the stack, labelled at the strip; one y axis for the same curves of all facets."""
    for above in axes[:-1]:
        above.sharex(axes[-1])
        above.tick_params(labelbottom=False)
        above.grid(True)
    for own, other in zip(axes[:-1], first, strict=bool(first)):
        own.sharey(other)


def _draw_strip(stack: Stack, x: str) -> None:
    """Draw the regimes along `x` as a strip of coloured cells, a row for each start."""
    starts = start_names(stack.facet)
    regimes = stack.facet["regime"]
    rows = flags(regimes.transpose(START, x) if START in regimes.dims else regimes.expand_dims(START))
    along = values_along(stack.facet[x])
    ends = np.arange(len(rows) + 1) - 0.5
    stack.strip.pcolormesh(edges(along), ends, np.ma.masked_invalid(rows), cmap=COLOUR_MAP, norm=NORM, rasterized=True)
    stack.strip.set_yticks(range(len(starts)), starts)
    stack.strip.set_ylim(len(starts) - 0.5, -0.5)
    stack.strip.tick_params(axis="y", length=0)
    for between in ends[1:-1]:
        stack.strip.axhline(between, color="white", linewidth=1.2)
    shape_axis(stack.strip, "x", along)
    stack.strip.set_xlabel(label(stack.facet[x]))


def values_along(data: xr.DataArray) -> np.ndarray:
    """The values of the axis `data` in the unit of its label."""
    return data.values * scale(data)[0]


def start_names(ds: xr.Dataset) -> list[str]:
    """The names of the starts in the dimension `start`, or the one empty name where there is no such dimension."""
    return [str(name) for name in ds[START].values] if START in lane_dims(ds) else [""]


def of_start(ds: xr.Dataset, position: int) -> xr.Dataset:
    """The lanes of the start at `position`."""
    return ds.isel({START: position}) if START in lane_dims(ds) else ds


def start_handles(ds: xr.Dataset, linestyle: str = "-") -> list[Artist]:
    """An entry of the legend for each start; none where there is one only."""
    look = {"marker": "o", "markersize": 4.0, "linewidth": 1.2, "linestyle": linestyle}
    colours = {name: start_colour(name, at) for at, name in enumerate(start_names(ds)) if name}
    return [Line2D([], [], color=colour, label=f"start: {name}", **look) for name, colour in colours.items()]


def legend_at_right(figure: Figure, *groups: list[Artist]) -> None:
    """One legend at the right of all axes, with `groups` set apart."""
    gap: Artist = Line2D([], [], linestyle="none", label=" ")
    handles: list[Artist] = []
    for group in groups:
        handles += ([gap] if handles and group else []) + group
    figure.legend(handles=handles, loc="outside right upper")
