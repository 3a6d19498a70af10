"""Pictures along one axis: for each facet, curves above a strip that shows the regimes of each initial condition.

For many initial conditions, the strip shows the fraction of each regime, and dots coloured by regime replace the
curves.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D

from vibrojax.pictures.axes import (
    certified_text,
    edges,
    label,
    pad_constant,
    shape_axis,
    shape_zero,
    short,
    unclip_markers,
    values_along,
)
from vibrojax.pictures.colours import (
    REGIME_MAP,
    REGIME_NORM,
    SINGLE,
    Value,
    hatch_gaps,
    regime_cells,
    regime_handles,
    sensitive_handle,
    shape_flags,
    values_beside,
)
from vibrojax.pictures.contents import REGIME, SENSITIVE, START, axes_to_draw, lane_dims, many_starts, regimes_in
from vibrojax.pictures.sheet import MOST_PANELS, PAGE, columns, facets, legend_at_right, write_margins
from vibrojax.pictures.style import INK, Mark, nested_line, new_figure, start_colour, styled

_MOST_COLUMNS = 3
_TITLE_ROOM = 0.6  # height [inches] of the title and the labels of a stack
_SHARES_HEIGHT = 1.1  # inches
_DISTINCT_HEIGHTS = 1000  # number of heights on a panel that the eye can distinguish
_MARGINS = 2.6  # page height [inches] for title, notes and the figure's margins

Lanes = Float[np.ndarray, " lanes"]


class Stack(NamedTuple):
    """The panels of one facet: `curves`, from top to bottom, and `strip`; `first`: whether it is the leftmost stack."""

    curves: Sequence[Axes]
    strip: Axes
    facet: xr.Dataset
    title: str
    first: bool


@styled
def regime_lines(
    ds: xr.Dataset, x: str | None = None, note: str = "", values: tuple[Value, ...] | None = None
) -> Figure:
    """Draw `values` along `x` above the regimes of each initial condition.

    Defaults: impact velocity and period, along the longest axis.
    """
    ds = regimes_in(ds)
    values = values_beside(ds) if values is None else values
    x = x or max(axes_to_draw(ds), key=lambda name: ds.sizes[name])
    height = 1.9 if len(values) > 1 else 2.4
    handles: list[Artist] = []
    if not many_starts(ds):
        starts = starts_of(ds)
        for k, start in enumerate(starts if starts[0].name else ()):
            look = nested_line(k, len(starts)) | Mark(color=start.colour, label=f"start: {start.name}")
            handles.append(Line2D([], [], marker="o", **look))
    draw = partial(draw_values, values=values, x=x)
    return draw_stacks(ds, x, len(values), (height, height), draw, handles, note)


def draw_stacks(
    ds: xr.Dataset,
    x: str,
    curves: int,
    heights: tuple[float, float],
    draw: Callable[[Stack], None],
    handles: Sequence[Artist] = (),
    note: str = "",
) -> Figure:
    """Draw a picture along `x`: for each facet, `curves` panels, which `draw` fills, above the strip of regimes.

    `heights`: height [inch] of a curve panel with one facet and with several; `handles`: legend entries above the
    regimes.
    """
    ds = ds.sortby(x)
    strip = _SHARES_HEIGHT if many_starts(ds) else 0.10 + 0.17 * ds.sizes.get(START, 1)
    for most in range(MOST_PANELS, 0, -1):  # as many facets as fit on a page
        panels = facets(ds, (x, START), most)
        height = heights[len(panels) > 1]
        wide = columns(panels, _MOST_COLUMNS)
        deep = -(-len(panels) // wide)
        stack_height = curves * height + strip + _TITLE_ROOM
        if deep * stack_height <= PAGE[1] - _MARGINS:
            break
    figure = new_figure({1: 7.6, 2: 10.0, 3: 12.5}[wide], stack_height * deep + 0.7)
    outer = GridSpec(deep, wide, figure)
    shared: Sequence[Axes] = ()
    sensitive = False
    stacks: list[Stack] = []
    for k, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        inner = outer[divmod(k, wide)].subgridspec(curves + 1, 1, height_ratios=[height] * curves + [strip])
        *above, below = (figure.add_subplot(inner[i]) for i in range(curves + 1))
        for i, axes in enumerate(above):
            axes.sharex(below)
            axes.tick_params(labelbottom=False)
            axes.grid(True)
            if shared:
                axes.sharey(shared[i])
        shared = shared or above
        (above[0] if above else below).set_title(title, loc="left")
        stack = Stack(above, below, facet, title, k % wide == 0)
        draw(stack)
        stacks.append(stack)
        sensitive |= _draw_strip(stack, x)
    figure.align_ylabels()
    for axes in (axes for stack in stacks for axes in stack.curves):
        unclip_markers(axes)
    for i in range(curves):
        shape_zero([stack.curves[i] for stack in stacks], "zero everywhere")
    regimes = regime_handles([facet[REGIME] for facet in panels.data])
    legend_at_right(figure, handles, regimes + [sensitive_handle()] * sensitive)
    colours = "starts together, in the colours of the regimes that they end in"
    together = f"{ds.sizes[START]} {colours}" if many_starts(ds) else ""
    write_margins(figure, ds, certified_text(ds), panels.note, together, note)
    return figure


class Start(NamedTuple):
    """The lanes of one initial condition, its short name (empty without a dimension `start`) and its colour."""

    name: str
    colour: str
    lanes: xr.Dataset


def starts_of(ds: xr.Dataset) -> list[Start]:
    """Return the lanes of each initial condition."""
    if START not in lane_dims(ds):
        return [Start("", start_colour("", 0), ds)]
    names = [short(str(name)) for name in ds[START].values]
    return [Start(name, start_colour(name, i), ds.isel({START: i})) for i, name in enumerate(names)]


def scatter_lanes(axes: Axes, along: Lanes, values: Lanes, regimes: Lanes, size: float) -> None:
    """Draw each lane as a dot in the colour of its regime, in random order, so that no regime hides another.

    Of several lanes with the same regime and the same position, only one is drawn: millions of dots would take minutes.
    """
    known = np.flatnonzero(np.isfinite(values))
    height = np.ptp(values[known]) if known.size else 1.0
    rows = np.round(_DISTINCT_HEIGHTS * (values[known] - values[known].min(initial=np.inf)) / (height or 1.0))
    different = np.unique(np.stack([along[known], rows, regimes[known]]), axis=1, return_index=True)[1]
    order = np.random.default_rng(0).permutation(known[different])
    colours = {"c": regimes[order], "cmap": REGIME_MAP, "norm": REGIME_NORM}
    axes.scatter(along[order], values[order], s=size, linewidths=0, rasterized=True, **colours)


def dot_size(values: int) -> float:
    """Return the area of a dot [pt²], given the number of values along the axis."""
    return float(np.clip(1200.0 / values, 5.0, 20.0))


def _draw_strip(stack: Stack, x: str) -> bool:
    """Draw the regimes along `x`: a row of coloured cells per initial condition, or the regime fractions of many.

    Return whether any lane is marked as sensitive to rounding.
    """
    facet, strip, many = stack.facet, stack.strip, many_starts(stack.facet)
    by_start = facet if START in lane_dims(facet) else facet.expand_dims(START)
    rows = regime_cells(by_start[REGIME].transpose(START, x))
    if many:  # each column is sorted, single impacts first, so that the height of a colour is its fraction
        ordered = np.sort(np.where(rows == SINGLE, -1.0, rows), axis=0)
        rows = np.where(ordered == -1.0, float(SINGLE), ordered)
    ends = np.linspace(0.0, 100.0, len(rows) + 1) if many else np.arange(len(rows) + 1) - 0.5
    along = values_along(facet[x])
    hatch_gaps(strip, rows)
    strip.pcolormesh(edges(along), ends, np.ma.masked_invalid(rows), cmap=REGIME_MAP, norm=REGIME_NORM, rasterized=True)
    shape_axis(strip, "x", along)
    strip.set_xlabel(label(facet[x]))
    if many:
        strip.set_ylim(0.0, 100.0)
        strip.set_ylabel("starts\n[%]" if stack.first else "")
        return False
    strip.set_yticks(range(len(rows)), [start.name for start in starts_of(facet)])
    strip.set_ylim(len(rows) - 0.5, -0.5)
    strip.tick_params(axis="y", length=0)
    for between in ends[1:-1]:
        strip.axhline(between, color="white", linewidth=1.2)
    if SENSITIVE not in facet:
        return False
    row, column = np.nonzero(by_start[SENSITIVE].transpose(START, x).values == 1)
    strip.scatter(along[column], row, s=9.0, marker="x", color=INK, linewidths=0.6)
    return bool(row.size)


def draw_values(stack: Stack, values: tuple[Value, ...], x: str) -> None:
    """Draw each of the `values` along `x` on its own panel of the stack, with a line per initial condition."""
    facet = stack.facet
    for axes, value in zip(stack.curves, values, strict=True):
        if stack.first:
            axes.set_ylabel(value.label.replace(" [", "\n["))
        if many_starts(facet):
            heights, regimes = (data.transpose(x, START) for data in (value.of(facet), facet[REGIME]))
            along = np.repeat(values_along(facet[x]), heights.sizes[START])
            scatter_lanes(axes, along, heights.values.ravel(), regime_cells(regimes).ravel(), dot_size(facet.sizes[x]))
        else:
            for position, (name, colour, lanes) in enumerate(starts_of(facet)):
                along = values_along(lanes[x])
                ends = [f"{value.name}_{end}" for end in ("min", "max")]
                if all(end in lanes for end in ends):  # range over the impacts of each lane
                    low, high = (lanes[end].values * value.factor for end in ends)
                    axes.fill_between(along, low, high, color=colour, alpha=0.15, linewidth=0)
                # A motion that several initial conditions reach shows the colours of all of them.
                look = nested_line(position, facet.sizes.get(START, 1)) | Mark(color=colour, marker="o", label=name)
                axes.plot(along, value.of(lanes).values, **look)
            pad_constant(axes)
        shape_flags(axes, value)
