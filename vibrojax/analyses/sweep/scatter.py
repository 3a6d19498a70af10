"""Pictures of lists of points: scattered over the two parameters that vary, or counted by regime."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.analyses.sweep.maps import MOST_VALUES, outline_region, region_handle, write_labels
from vibrojax.errors import InputError
from vibrojax.plot.axes import certified_text, share_text, short, values_along
from vibrojax.plot.colours import (
    REGIME_COLOURS,
    Value,
    Values,
    cell_handles,
    coloured,
    regime_counts,
    regime_names,
    values_beside,
    values_of_rock,
)
from vibrojax.plot.contents import REGIME, START, many_starts, rates_in, regimes_in, varied
from vibrojax.plot.sheet import Facets, sheet, write_margins
from vibrojax.plot.style import NOTHING, UNDEFINED, new_figure, styled

_MOST_BAR_COLUMNS = 4
_MANY_DOTS = 600  # number of points from which on dots are smaller


@styled
def regime_scatter(ds: xr.Dataset) -> Figure:
    """Draw the regimes of a list of points over the two parameters that vary, with further quantities next to them."""
    ds = regimes_in(ds)
    names = tuple(varied(ds))
    x, y = ("gamma", "beta") if set(names) == {"beta", "gamma"} else names
    return draw_scatter(ds, x, y, (None, *values_beside(ds)))


@styled
def rate_scatter(ds: xr.Dataset) -> Figure:
    """Draw the rates of penetration of a list of points over the two parameters that vary."""
    ds = rates_in(ds)
    names = tuple(varied(ds))
    if len(names) != 2:
        raise InputError(f"no map: {', '.join(names) or 'none'} is what varies over the points, not two parameters")
    regimes = (None,) if REGIME in ds else ()
    return draw_scatter(ds, *names, regimes + values_of_rock(ds)[: MOST_VALUES[3]])


@styled
def regime_bars(ds: xr.Dataset) -> Figure:
    """Draw the number of lanes in each regime, one panel per initial condition."""
    ds = regimes_in(ds)
    panels = _split_starts(ds)
    occurring = list(regime_counts(facet[REGIME] for facet in panels.data))
    names = regime_names(ds[REGIME])
    wide = min(len(panels), _MOST_BAR_COLUMNS)
    deep = -(-len(panels) // wide)
    figure = new_figure(1.6 + 3.0 * wide, 0.6 + deep * (0.6 + 0.32 * max(len(occurring), 2)))
    grid = figure.subplots(deep, wide, sharex=True, sharey=True, squeeze=False)
    colours = [REGIME_COLOURS[flag] for flag in occurring]
    for axes, title, facet in zip(grid.flat, panels.titles, panels.data, strict=False):
        counts = regime_counts([facet[REGIME]])
        lanes = [counts.get(flag, 0) for flag in occurring]
        bars = axes.barh(range(len(occurring)), lanes, color=colours, edgecolor="0.35", linewidth=0.4)
        texts = [f"{n}  ({share_text(n / facet[REGIME].size)})" if n else "" for n in lanes]
        axes.bar_label(bars, texts, padding=3)
        axes.margins(x=0.4)
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        axes.set_title(title, loc="left")
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    for axes in grid[-1]:
        axes.set_xlabel("lanes")
    grid[0, 0].set_yticks(range(len(occurring)), [names[flag] for flag in occurring])
    grid[0, 0].invert_yaxis()
    write_margins(figure, ds, certified_text(ds))
    return figure


def draw_scatter(ds: xr.Dataset, x: str, y: str, values: Values, *notes: str) -> Figure:
    """Draw `values` of a list of points over the parameters `x` and `y`, with `notes`."""
    panels = _split_starts(ds)
    drawn = sheet(panels, values)
    for panel in drawn.panels:
        draw_points(panel.axes, panel.facet, panel.value, x, y)
    for panel in drawn.panels:  # when all axis limits are known
        outline_region(panel.axes, x, y)
        write_labels(panel, ds[x], ds[y])
    drawn.finish(cell_handles(panels.data, values) + region_handle(drawn.panels[0].axes))
    write_margins(drawn.figure, ds, certified_text(ds), *notes)
    return drawn.figure


def draw_points(axes: Axes, ds: xr.Dataset, value: Value | None, x: str, y: str) -> None:
    """Draw each lane as a dot, coloured by its regime if `value` is None, else by `value`."""
    cells, colours, norm = coloured(ds, value)
    across, up = values_along(ds[x]), values_along(ds[y])
    nothing = (cells == 0) & (value is not None and value.of_rate)
    known = np.isfinite(cells) & ~nothing
    many = cells.size > _MANY_DOTS
    size, width = (20.0 * _MANY_DOTS / cells.size, 0.0) if many else (20.0, 0.3)
    for mask, colour in ((np.isnan(cells), UNDEFINED), (nothing, NOTHING), (known, cells[known])):
        mapped: dict[str, Any] = {"cmap": colours, "norm": norm} if mask is known else {}
        axes.scatter(across[mask], up[mask], s=size, c=colour, edgecolors="0.3", linewidths=width, **mapped)


def _split_starts(ds: xr.Dataset) -> Facets:
    """Return one panel per initial condition, or a single panel for many initial conditions.

    The names of the initial conditions are those of the dimension `start`, or of the coordinate `start` of the points.
    """
    if many_starts(ds):
        return Facets((f"{ds.sizes[START]} starts together",), (ds,))
    if START not in ds.coords or ds[START].ndim == 0:
        return Facets(("",), (ds,))
    (dimension,) = ds[START].dims
    values = ds[START].values.astype(str)
    starts = list(dict.fromkeys(values.tolist()))
    if dimension == START:
        data = tuple(ds.isel({START: position}) for position in range(len(starts)))
    else:
        data = tuple(ds.isel({dimension: np.flatnonzero(values == name)}) for name in starts)
    return Facets(tuple(f"start: {short(name)}" for name in starts), data, (len(starts),))
