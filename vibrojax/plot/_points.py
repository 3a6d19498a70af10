"""A list of points: a scatter over the two parameters that vary, or a count of the regimes."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.plot._about import point_text
from vibrojax.plot._cells import write_labels
from vibrojax.plot._facets import Facets
from vibrojax.plot._flags import COLOUR_MAP, NORM, REGIME_COLOURS, counts, flags, legend_handles, names
from vibrojax.plot._grid import POINT, START
from vibrojax.plot._labels import scale, share_text
from vibrojax.plot._region import outline_handle, outline_region
from vibrojax.plot._sheet import Panel, sheet, write_margins
from vibrojax.plot._style import NOTHING, UNDEFINED, new_figure
from vibrojax.plot._values import Value, value_handles, values_beside


def regime_points(ds: xr.Dataset) -> Figure:
    """The regimes of a list of points: over the two parameters that vary, else counted."""
    names = varied(ds)
    if len(names) != 2:
        return regime_counts(ds)
    x, y = ("gamma", "beta") if set(names) == {"beta", "gamma"} else names
    return scattered(ds, x, y, values_beside(ds))


def scattered(ds: xr.Dataset, x: str, y: str, values: tuple[Value, ...]) -> Figure:
    """The regimes of a list of points, where there are any, and `values`, over the parameters `x` and `y`."""
    panels = _by_start(ds)
    regimes = (None,) if "regime" in ds else ()
    drawn = sheet(panels, (*regimes, *values))
    for panel in drawn:
        _draw_points(panel, ds[x], ds[y])
    for panel in drawn:  # once all limits are known
        outline_region(panel.axes, x, y)
        write_labels(panel, ds[x], ds[y])
    handles: list[Artist] = list(legend_handles([facet["regime"] for facet in panels.data])) if regimes else []
    handles += value_handles(panels.data, values)
    drawn.finish(handles + outline_handle(drawn.panels[0].axes))
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), point_text(ds))
    return drawn.figure


def regime_counts(ds: xr.Dataset) -> Figure:
    """How many lanes there are of each regime, by start."""
    panels = _by_start(ds)
    found = list(counts(facet["regime"] for facet in panels.data))
    named = names(ds["regime"])
    figure = new_figure(1.6 + 3.0 * len(panels), 1.2 + 0.32 * max(len(found), 2))
    row = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, title, facet in zip(row, panels.titles, panels.data, strict=True):
        _draw_counts(axes, facet["regime"], found)
        axes.set_title(title, loc="left")
        axes.set_xlabel("lanes")
    row[0].set_yticks(range(len(found)), [named[flag] for flag in found])
    row[0].invert_yaxis()
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds))
    return figure


def _draw_counts(axes: Axes, regimes: xr.DataArray, found: list[int]) -> None:
    lanes = [counts([regimes]).get(flag, 0) for flag in found]
    colours = [REGIME_COLOURS[flag] for flag in found]
    bars = axes.barh(range(len(found)), lanes, color=colours, edgecolor="0.35", linewidth=0.4)
    axes.bar_label(bars, [f"{n}  ({share_text(n / regimes.size)})" if n else "" for n in lanes], padding=3)
    axes.margins(x=0.4)
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))


def varied(ds: xr.Dataset) -> tuple[str, ...]:
    """The parameters along the points that take more than one value."""
    along = {str(name): data for name, data in ds.coords.items() if data.dims == (POINT,) and name != POINT}
    numbers = {name: data.values for name, data in along.items() if np.issubdtype(data.dtype, np.number)}
    return tuple(name for name, values in numbers.items() if np.unique(values).size > 1)


def _by_start(ds: xr.Dataset) -> Facets:
    """A panel for each start: of the dimension `start`, or of the names along the points."""
    if START not in ds.coords or ds[START].ndim == 0:
        return Facets(("",), (ds,), (1,), "")
    (dimension,) = ds[START].dims
    found = list(dict.fromkeys(str(name) for name in ds[START].values))
    if dimension == START:
        data = tuple(ds.isel({START: at}) for at in range(len(found)))
    else:
        data = tuple(ds.isel({dimension: np.flatnonzero(ds[START].values.astype(str) == name)}) for name in found)
    return Facets(tuple(f"start: {name}" for name in found), data, (len(found),), "")


def _draw_points(panel: Panel, across: xr.DataArray, up: xr.DataArray) -> None:
    value = panel.value
    if value is None:
        cells, colours, norm = flags(panel.facet["regime"]), COLOUR_MAP, NORM
    else:
        cells, colours, norm = value.of(panel.facet).values, value.colour_map, value.norm
    at = [panel.facet[data.name].values * scale(data)[0] for data in (across, up)]
    nothing = (cells == 0) & (value is not None and value.of_rate)
    known = np.isfinite(cells) & ~nothing
    plain = ((np.isnan(cells), {"c": UNDEFINED}), (nothing, {"c": NOTHING}))
    for shown, colour in (*plain, (known, {"c": cells[known], "cmap": colours, "norm": norm})):
        panel.axes.scatter(*(values[shown] for values in at), edgecolors="0.3", linewidths=0.3, s=20, **colour)
