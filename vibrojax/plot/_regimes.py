"""Regime maps: which motion there is at each point of a sweep, from each start."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from vibrojax.plot._lines import regime_lines
from vibrojax.plot._points import regime_points

from vibrojax.errors import InputError
from vibrojax.plot._facets import facets
from vibrojax.plot._flags import COLOUR_MAP, NORM, flags, legend_handles
from vibrojax.plot._grid import POINT, chosen, edges, shape_axis, to_draw, without_single
from vibrojax.plot._labels import fixed_text, label, scale
from vibrojax.plot._sheet import Panel, sheet, write_margins
from vibrojax.plot._style import INK, UNDEFINED, styled
from vibrojax.plot._values import values_beside

# Where the source finds the best single impacts (its section 5, "best" region).
REGION = {"beta": (0.25, 0.60), "gamma": (0.60, 0.80)}


@styled
def regime_map(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """The regimes of a sweep as a map, with impact velocity and period beside it.

    Further axes, and the starts, become panels: twelve at most, and the figure says which. A sweep along one axis
    becomes lines, a list of points a scatter (two parameters vary) or a count.

    **Arguments:**

    - `ds`: a sweep's dataset, with `regime` and, where the scene has them, `impact_velocity` [m/s] and `period` [s].
    - `x`, `y`: the axes to draw along; left out: gamma and beta, or the first two of three values or more.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no regimes, or `x` or `y` is no axis of the sweep.
    """
    if "regime" not in ds or ds["regime"].size == 0:
        raise InputError('no regimes to draw: the dataset holds no variable "regime"')
    ds, single = without_single(ds)
    fixed = fixed_text(ds, single)
    if POINT in ds["regime"].dims:
        return regime_points(ds, fixed)
    if x is None and y is None and len(to_draw(ds)) < 2:
        return regime_lines(ds, fixed)
    return _grid_map(ds, *chosen(ds, x, y), fixed)


def _grid_map(ds: xr.Dataset, x: str, y: str, fixed: str) -> Figure:
    ds = ds.sortby([x, y])
    panels = facets(ds, (x, y))
    drawn = sheet(panels, values_beside(xr.concat(panels.data, "facet") if len(panels) > 1 else panels.data[0]))
    for panel in drawn:
        _draw_cells(panel, x, y)
        _write_labels(panel, ds[x], ds[y])
    handles: list[Artist] = list(legend_handles([facet["regime"] for facet in panels.data]))
    handles += _undefined_handle(panels.data, [value.name for value in drawn.values])
    drawn.finish(handles + outline_handle(drawn.panels[0].axes))
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), fixed and f"{fixed}.", panels.note)
    return drawn.figure


def _draw_cells(panel: Panel, x: str, y: str) -> None:
    axes, value = panel.axes, panel.value
    across, up = (panel.facet[name].values * scale(panel.facet[name])[0] for name in (x, y))
    if value is None:
        cells, colours, norm = flags(panel.facet["regime"].transpose(y, x)), COLOUR_MAP, NORM
    else:
        cells, colours, norm = value.of(panel.facet).transpose(y, x).values, value.colour_map, value.norm
    masked = np.ma.masked_invalid(cells)
    axes.pcolormesh(edges(across), edges(up), masked, cmap=colours, norm=norm, rasterized=True)
    shape_axis(axes, "x", across)
    shape_axis(axes, "y", up)
    outline_region(axes, x, y)


def _write_labels(panel: Panel, x: xr.DataArray, y: xr.DataArray) -> None:
    if panel.title:
        panel.axes.set_title(panel.title)
    panel.axes.tick_params(labelleft=panel.left, labelbottom=panel.bottom)
    if panel.left:
        panel.axes.set_ylabel(label(y))
    if panel.bottom:
        panel.axes.set_xlabel(label(x))


def outline_region(axes: Axes, x: str, y: str) -> None:
    """Outline the source's region where the axes are beta and gamma and show some of it."""
    if {x, y} != set(REGION):
        return
    (left, right), (low, high) = REGION[x], REGION[y]
    (first, last), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    if left < last and right > first and low < top and high > bottom:
        region = Rectangle((left, low), right - left, high - low, fill=False, edgecolor=INK, linewidth=1.3)
        region.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
        region.set_label("source's best region")
        axes.add_patch(region)


def outline_handle(axes: Axes) -> list[Artist]:
    """The legend's entry for the source's region, where `axes` shows it."""
    shown = any(isinstance(patch, Rectangle) and patch.get_label() == "source's best region" for patch in axes.patches)
    return [Patch(fill=False, edgecolor=INK, linewidth=1.3, label="source's best region")] if shown else []


def _undefined_handle(data: tuple[xr.Dataset, ...], names: list[str]) -> list[Artist]:
    missing = any(np.isnan(facet[name].values).any() for facet in data for name in names)
    return [Patch(facecolor=UNDEFINED, edgecolor="0.35", linewidth=0.4, label="no value")] if missing else []
