"""A list of points: scattered over the two parameters that vary, or their regimes counted."""

from collections.abc import Sequence
from typing import TypedDict

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.analyses.sweep.maps import MOST_VALUES, outline_region, region_handle, write_labels
from vibrojax.errors import InputError
from vibrojax.plot.axes import certified_text, point_text, share_text, short, values_along
from vibrojax.plot.colours import (
    REGIME_COLOURS,
    Value,
    coloured,
    regime_counts,
    regime_handles,
    regime_names,
    value_handles,
    values_beside,
    values_of_rock,
)
from vibrojax.plot.contents import REGIME, START, has_regimes, many_starts, rates_in, regimes_in, varied
from vibrojax.plot.margins import write_margins
from vibrojax.plot.sheet import Facets, Panel, sheet
from vibrojax.plot.style import NOTHING, UNDEFINED, new_figure, styled

_MOST_BESIDE = 4  # panels of bars
_MANY = 600  # points, from which dots are smaller


class Dots(TypedDict):
    """How dots look, in matplotlib's words."""

    s: float
    edgecolors: str
    linewidths: float


@styled
def regime_scatter(ds: xr.Dataset) -> Figure:
    """The regimes of a list of points over the two parameters that vary, with the quantities beside them."""
    ds = regimes_in(ds)
    names = tuple(varied(ds))
    x, y = ("gamma", "beta") if set(names) == {"beta", "gamma"} else names
    return scattered(ds, x, y, (None, *values_beside(ds)))


@styled
def rate_scatter(ds: xr.Dataset) -> Figure:
    """The rates of penetration of a list of points over the two parameters that vary."""
    ds = rates_in(ds)
    names = tuple(varied(ds))
    if len(names) != 2:
        raise InputError(f"no map: {', '.join(names) or 'none'} is what varies over the points, not two parameters")
    x, y = names
    regimes = (None,) if has_regimes(ds) else ()
    return scattered(ds, x, y, regimes + values_of_rock(ds)[: MOST_VALUES[3]])


@styled
def regime_bars(ds: xr.Dataset) -> Figure:
    """How many lanes there are of each regime, by start."""
    ds = regimes_in(ds)
    panels = _by_start(ds)
    occurring = list(regime_counts(facet[REGIME] for facet in panels.data))
    names = regime_names(ds[REGIME])
    wide = min(len(panels), _MOST_BESIDE)
    deep = -(-len(panels) // wide)
    figure = new_figure(1.6 + 3.0 * wide, 0.6 + deep * (0.6 + 0.32 * max(len(occurring), 2)))
    grid = figure.subplots(deep, wide, sharex=True, sharey=True, squeeze=False)
    for axes, title, facet in zip(grid.flat, panels.titles, panels.data, strict=False):
        _draw_bars(axes, facet[REGIME], occurring)
        axes.set_title(title, loc="left")
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    for axes in grid[-1]:
        axes.set_xlabel("lanes")
    grid[0, 0].set_yticks(range(len(occurring)), [names[flag] for flag in occurring])
    grid[0, 0].invert_yaxis()
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), certified_text(ds))
    return figure


def scattered(ds: xr.Dataset, x: str, y: str, values: tuple[Value | None, ...], *about: str) -> Figure:
    """The `values` of a list of points, None for the regimes, over the parameters `x` and `y`.

    `about` is said of it in the notes.
    """
    panels = _by_start(ds)
    drawn = sheet(panels, values)
    for panel in drawn:
        draw_points(panel, x, y)
    for panel in drawn:  # once all limits are known
        outline_region(panel.axes, x, y)
        write_labels(panel, ds[x], ds[y])
    handles = regime_handles([facet[REGIME] for facet in panels.data]) if None in values else []
    handles += value_handles(panels.data, [value for value in values if value is not None])
    drawn.finish(handles + region_handle(drawn.panels[0].axes))
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), point_text(ds), certified_text(ds), *about)
    return drawn.figure


def draw_points(panel: Panel, x: str, y: str) -> None:
    """Draw the regime or the value of each lane of `panel` as a dot."""
    value = panel.value
    shown = coloured(panel.facet, value)
    across, up = values_along(panel.facet[x]), values_along(panel.facet[y])
    nothing = (shown.cells == 0) & (value is not None and value.of_rate)
    many = shown.cells.size > _MANY
    look = Dots(s=20.0 * _MANY / shown.cells.size if many else 20.0, edgecolors="0.3", linewidths=0.0 if many else 0.3)
    for among, colour in ((np.isnan(shown.cells), UNDEFINED), (nothing, NOTHING)):
        panel.axes.scatter(across[among], up[among], c=colour, **look)
    known = np.isfinite(shown.cells) & ~nothing
    panel.axes.scatter(across[known], up[known], c=shown.cells[known], cmap=shown.colour_map, norm=shown.norm, **look)


def _draw_bars(axes: Axes, regimes: xr.DataArray, flags: Sequence[int]) -> None:
    counts = regime_counts([regimes])
    lanes = [counts.get(flag, 0) for flag in flags]
    colours = [REGIME_COLOURS[flag] for flag in flags]
    bars = axes.barh(range(len(flags)), lanes, color=colours, edgecolor="0.35", linewidth=0.4)
    axes.bar_label(bars, [f"{n}  ({share_text(n / regimes.size)})" if n else "" for n in lanes], padding=3)
    axes.margins(x=0.4)
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))


def _by_start(ds: xr.Dataset) -> Facets:
    """A panel for each start: of the dimension `start`, or of the names along the points; one panel for many."""
    if many_starts(ds):
        return Facets((f"{ds.sizes[START]} starts together",), (ds,), (1,), "")
    if START not in ds.coords or ds[START].ndim == 0:
        return Facets(("",), (ds,), (1,), "")
    (dimension,) = ds[START].dims
    starts = list(dict.fromkeys(str(name) for name in ds[START].values))
    if dimension == START:
        data = tuple(ds.isel({START: at}) for at in range(len(starts)))
    else:
        data = tuple(ds.isel({dimension: np.flatnonzero(ds[START].values.astype(str) == name)}) for name in starts)
    return Facets(tuple(f"start: {short(name)}" for name in starts), data, (len(starts),), "")
