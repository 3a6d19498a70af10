"""Pictures along one axis: for each facet curves above, and a strip of regimes for each start below.

Of many starts there is no strip each, but their shares of regimes, and lanes have the colours of their regimes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D

from vibrojax.plot.axes import certified_text, edges, label, point_text, shape_axis, short, steady, values_along
from vibrojax.plot.colours import (
    REGIME_MAP,
    REGIME_NORM,
    Value,
    by_share,
    flags,
    regime_handles,
    sensitive_handle,
    shape_flags,
    values_beside,
)
from vibrojax.plot.contents import REGIME, SENSITIVE, START, axes_to_draw, lane_dims, many_starts, regimes_in
from vibrojax.plot.margins import PAGE, legend_at_right, write_margins
from vibrojax.plot.sheet import MOST, Facets, columns, facets
from vibrojax.plot.style import INK, Mark, new_figure, start_colour, styled

_WIDE = 3  # stacks side by side, at most
_BETWEEN = 0.6  # inches for the titles and labels of a stack
_SHARES_HIGH = 1.1  # inches
_FINE = 1000  # heights on a panel that can be told apart
_MARGINS = 2.6  # inches of a page for title, notes and the figure's edges

Lanes = Float[np.ndarray, " lanes"]


@dataclass(frozen=True)
class Stack:
    """The axes of one facet: those of the curves, from above, and that of the strip."""

    curves: tuple[Axes, ...]
    strip: Axes
    facet: xr.Dataset
    title: str
    left: bool


@styled
def regime_lines(
    ds: xr.Dataset, x: str | None = None, about: str = "", values: tuple[Value, ...] | None = None
) -> Figure:
    """Impact velocity and period, or `values`, along `x`, one line per start, above the regimes of each start.

    `x` is the longest axis where it is left out; `about` is said of the picture in the notes.
    """
    ds = regimes_in(ds)
    values = values_beside(ds) if values is None else values
    x = x or max(axes_to_draw(ds), key=lambda name: ds.sizes[name])
    height = 1.9 if len(values) > 1 else 2.4
    return draw_stacks(
        ds, x, len(values), lambda _: height, partial(draw_values, values=values, x=x), _start_handles(ds), about
    )


def draw_stacks(
    ds: xr.Dataset,
    x: str,
    curves: int,
    height: Callable[[int], float],
    draw: Callable[[Stack], None],
    handles: Sequence[Artist] = (),
    about: str = "",
) -> Figure:
    """A picture along `x`: what `draw` draws on `curves` panels of each facet, above the regimes of each start.

    `height` [inch] of such a panel, by the number of facets; `handles` are in the legend above the regimes, `about` in
    the notes.
    """
    panels = _panels(ds.sortby(x), x, curves, height)
    figure, drawn = _stacks(panels, curves, height(len(panels)))
    for stack in drawn:
        draw(stack)
        _draw_strip(stack, x)
    regimes = regime_handles([facet[REGIME] for facet in panels.data])
    marks = [sensitive_handle()] if any(_sensitive(facet, x).any() for facet in panels.data) else []
    legend_at_right(figure, handles, regimes + marks)
    notes = point_text(ds), certified_text(ds), panels.note, shares_text(ds) if many_starts(ds) else "", about
    write_margins(figure, str(ds.attrs.get("title", "")), *notes)
    return figure


def shares_text(ds: xr.Dataset) -> str:
    """How many starts are drawn together, and how, in words."""
    return f"{ds.sizes[START]} starts together, in the colours of the regimes that they end in"


def _panels(ds: xr.Dataset, x: str, curves: int, height: Callable[[int], float]) -> Facets:
    """The facets of a picture along `x`: as many as fit on a page."""
    most = MOST
    while True:
        panels = facets(ds, (x, START), most)
        high = -(-len(panels) // columns(panels, _WIDE)) * _height(panels, curves, height(len(panels)))
        if high <= PAGE[1] - _MARGINS or most == 1:
            return panels
        most -= 1


def start_names(ds: xr.Dataset) -> list[str]:
    """The names of the starts in the dimension `start`, or the one empty name where there is no such dimension."""
    return [short(str(name)) for name in ds[START].values] if START in lane_dims(ds) else [""]


def of_start(ds: xr.Dataset, position: int) -> xr.Dataset:
    """The lanes of the start at `position`."""
    return ds.isel({START: position}) if START in lane_dims(ds) else ds


def of_lanes(axes: Axes, along: Lanes, values: Lanes, regimes: Lanes, size: float) -> None:
    """Draw a dot for each lane in the colour of its regime, in an order in which none hides all of another's.

    Of lanes of one regime that fall on the same dot, one is drawn: millions of them would take minutes.
    """
    known = np.flatnonzero(np.isfinite(values))
    height = np.ptp(values[known]) if known.size else 1.0
    rows = np.round(_FINE * (values[known] - values[known].min(initial=np.inf)) / (height or 1.0))
    different = np.unique(np.stack([along[known], rows, regimes[known]]), axis=1, return_index=True)[1]
    order = np.random.default_rng(0).permutation(known[different])
    colours = {"c": regimes[order], "cmap": REGIME_MAP, "norm": REGIME_NORM}
    dots = axes.scatter(along[order], values[order], s=size, linewidths=0, **colours)
    dots.set_rasterized(True)


def dot_size(values: int) -> float:
    """The area of a dot [pt²] where there are so many values along an axis."""
    return float(np.clip(1200.0 / values, 5.0, 20.0))


def _height(panels: Facets, curves: int, height: float) -> float:
    """Of the stack of one facet [inch]."""
    return curves * height + _strip_height(panels.data[0]) + _BETWEEN


def _strip_height(facet: xr.Dataset) -> float:
    return _SHARES_HIGH if many_starts(facet) else 0.10 + 0.17 * max(facet.sizes.get(START, 1), 1)


def _stacks(panels: Facets, curves: int, height: float) -> tuple[Figure, tuple[Stack, ...]]:
    """A figure with a stack of `curves` panels, each `height` inches high, and a strip for each facet."""
    wide = columns(panels, _WIDE)
    deep = -(-len(panels) // wide)
    strip = _strip_height(panels.data[0])
    figure = new_figure({1: 7.6, 2: 10.0, 3: 12.5}[wide], _height(panels, curves, height) * deep + 0.7)
    outer = GridSpec(deep, wide, figure)
    drawn: list[Stack] = []
    for at, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        row, column = divmod(at, wide)
        inner = outer[row, column].subgridspec(curves + 1, 1, height_ratios=[height] * curves + [strip])
        axes = [figure.add_subplot(inner[i]) for i in range(curves + 1)]
        _join(axes, drawn[0].curves if drawn else ())
        axes[0].set_title(title, loc="left")
        drawn.append(Stack(tuple(axes[:-1]), axes[-1], facet, title, column == 0))
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
    """Draw the regimes along `x` as a strip of coloured cells: a row for each start, or the shares of many."""
    starts, strip = start_names(stack.facet), stack.strip
    regimes = stack.facet[REGIME]
    rows = flags(regimes.transpose(START, x) if START in regimes.dims else regimes.expand_dims(START))
    many = many_starts(stack.facet)
    cells = np.ma.masked_invalid(by_share(rows) if many else rows)
    ends = np.linspace(0.0, 100.0, len(rows) + 1) if many else np.arange(len(rows) + 1) - 0.5
    along = values_along(stack.facet[x])
    strip.pcolormesh(edges(along), ends, cells, cmap=REGIME_MAP, norm=REGIME_NORM, rasterized=True)
    if many:
        strip.set_ylim(0.0, 100.0)
        strip.set_ylabel("starts\n[%]" if stack.left else "")
    else:
        strip.set_yticks(range(len(starts)), starts)
        strip.set_ylim(len(starts) - 0.5, -0.5)
        strip.tick_params(axis="y", length=0)
        for between in ends[1:-1]:
            strip.axhline(between, color="white", linewidth=1.2)
        row, column = np.nonzero(_sensitive(stack.facet, x))
        strip.scatter(along[column], row, s=9.0, marker="x", color=INK, linewidths=0.6)
    shape_axis(strip, "x", along)
    strip.set_xlabel(label(stack.facet[x]))


def _sensitive(facet: xr.Dataset, x: str) -> Bool[np.ndarray, "starts values"]:
    """Return the lanes of a row for each start of which rounding decides the attractor; none where rows are shares."""
    if SENSITIVE not in facet or many_starts(facet):
        return np.zeros((1, facet.sizes[x]), bool)
    rows = facet[SENSITIVE]
    return (rows if START in rows.dims else rows.expand_dims(START)).transpose(START, x).values == 1


def _start_handles(ds: xr.Dataset) -> list[Artist]:
    """An entry of the legend for each start; none where there is one only, or many."""
    if many_starts(ds):
        return []
    mark = Mark(marker="o", markersize=4.0, linewidth=1.2)
    colours = {name: start_colour(name, at) for at, name in enumerate(start_names(ds)) if name}
    return [Line2D([], [], **mark | Mark(color=colour), label=f"start: {name}") for name, colour in colours.items()]


def draw_values(stack: Stack, values: tuple[Value, ...], x: str) -> None:
    """Draw each of the `values` along `x` on a panel of the stack, a line for each start."""
    for axes, value in zip(stack.curves, values, strict=True):
        _draw_value(stack, axes, value, x)


def _draw_value(stack: Stack, axes: Axes, value: Value, x: str) -> None:
    if stack.left:
        axes.set_ylabel(value.label.replace(" [", "\n["))
    shape_flags(axes, value)
    if many_starts(stack.facet):
        values, regimes = (data.transpose(x, START) for data in (value.of(stack.facet), stack.facet[REGIME]))
        along = np.repeat(values_along(stack.facet[x]), values.sizes[START])
        of_lanes(axes, along, values.values.ravel(), flags(regimes).ravel(), dot_size(stack.facet.sizes[x]))
        return
    for at, name in enumerate(start_names(stack.facet)):
        lanes = of_start(stack.facet, at)
        along, colour = values_along(lanes[x]), start_colour(name, at)
        _draw_range(axes, lanes, value, along, colour)
        # Later starts as thinner lines, so that a motion reached from both shows both colours.
        width = Mark(linewidth=2.2, markersize=4.0) if at == 0 else Mark(linewidth=1.0, markersize=2.2)
        axes.plot(along, value.of(lanes).values, color=colour, marker="o", label=name, **width)
    steady(axes)
    shape_flags(axes, value)


def _draw_range(axes: Axes, lanes: xr.Dataset, value: Value, along: Float[np.ndarray, " lanes"], colour: str) -> None:
    """Shade from the least to the greatest of one lane's impacts, where the dataset has both."""
    least, greatest = (f"{value.name}_{end}" for end in ("min", "max"))
    if least in lanes and greatest in lanes:
        low, high = (lanes[name].values * value.factor for name in (least, greatest))
        axes.fill_between(along, low, high, color=colour, alpha=0.15, linewidth=0)
