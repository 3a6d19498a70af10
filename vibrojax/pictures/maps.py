"""Maps over two parameters, as cells of a grid or as dots of a list of points: regimes, other quantities, rates."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from vibrojax.errors import InputError
from vibrojax.io.kinds import kind_of
from vibrojax.pictures.axes import certified_text, edges, label, point_text, shape_axis, short, value_text, values_along
from vibrojax.pictures.colours import (
    SINGLE,
    Coloured,
    Value,
    Values,
    cell_handles,
    coloured,
    hatch_gaps,
    sensitive_handle,
    values_beside,
    values_of_rock,
)
from vibrojax.pictures.contents import (
    HIDDEN,
    POINT,
    REGIME,
    RELIEF,
    SENSITIVE,
    START,
    axes_of_map,
    lane_dims,
    long_axes,
    many_starts,
    rates_in,
    regimes_in,
    varied,
)
from vibrojax.pictures.overlays import border_handles, check_borders, draw_codim2, draw_over_panel, over_map_text
from vibrojax.pictures.sheet import MOST_PANELS, Facets, Panel, facets, sheet, write_margins
from vibrojax.pictures.style import INK, NO_VALUE, NOTHING, styled

_MOST_VALUES = {1: 4, 2: 3, 3: 3}  # of quantities on maps of rates, by the number of facets; else only the rate
_MOST_RATE_FACETS = 9
_MANY_VALUES = 4  # number of quantities from which on half as many facets are drawn
_RELIEF_LEVELS = 5  # approximate number of contour lines of the relief
_CONSTANT_RELIEF = 1e-9  # largest relative range of a relief that counts as constant
_LETTERS_PER_INCH = 17  # number of characters that fit on an axis label per inch of the axis
_MANY_DOTS = 600  # number of points from which on dots are smaller
_SYMBOLS = {"mean_force": "P", "relief": "P/D"}

# The region of parameters with "best" stable single impacts (source, chapter 5).
REGION = {"beta": (0.25, 0.60), "gamma": (0.60, 0.80)}
_REGION_NAME = "source's best region"


@styled
def regime_grid(ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> Figure:
    """Draw the regimes over two axes, with further quantities next to them, and the borders `over` on top.

    Each value of further axes and each initial condition gets a panel, twelve at most; the figure notes which values
    are shown.
    """
    ds = regimes_in(ds)
    x, y = varied(ds) if POINT in lane_dims(ds) else axes_of_map(ds)
    if POINT in lane_dims(ds) and (x, y) == ("beta", "gamma"):
        x, y = y, x
    # Curves and their points need the width of the page.
    beside = () if any(kind_of(layer) == "curves" for layer in over) else values_beside(ds)
    return draw_map(ds, x, y, (None, *beside), over=over)


def draw_map(ds: xr.Dataset, x: str, y: str, values: Values, *notes: str, over: Sequence[xr.Dataset] = ()) -> Figure:
    """Draw `values` over the parameters `x` and `y`, with `notes`, and with the borders `over` on the regime map."""
    for layer in over:
        check_borders(ds, layer, x, y)
    points = POINT in lane_dims(ds)
    ds = ds if points else ds.sortby([x, y])
    most = MOST_PANELS if len(values) < _MANY_VALUES else MOST_PANELS // 2
    panels = split_starts(ds) if points else facets(ds, (x, y), most)
    drawn = sheet(panels, values)
    handles = cell_handles(panels.data, values)
    marks: dict[str, Artist] = {}
    kinds: list[str] = []
    corners: list[Artist] = []
    for panel in drawn.panels:
        if points:
            draw_points(panel.axes, panel.facet, panel.value, x, y)
        else:
            draw_cells(panel, x, y)
        if panel.value is None and not points:
            marks |= _mark_cells(panel, x, y)
            kinds += [kind for layer in over for kind in draw_over_panel(panel.axes, layer, panel.facet, x, y)]
            if kinds:
                corners = draw_codim2(panel.axes, [layer for layer in over if kind_of(layer) == "curves"], x, y)
    for panel in drawn.panels:  # when all axis limits are known
        outline_region(panel.axes, x, y)
        write_labels(panel, ds[x], ds[y])
    handles += [marks[name] for name in (HIDDEN, SENSITIVE) if name in marks]
    if any(isinstance(artist, LineCollection) for panel in drawn.panels for artist in panel.axes.collections):
        handles.append(Line2D([], [], color=INK, linewidth=1.0, label="border of single impact"))
    lines = dict.fromkeys(over_map_text(layer, bool(kinds)) for layer in over)
    drawn.finish([*handles, *border_handles(kinds), *corners, *region_handle(drawn.panels[0].axes)])
    write_margins(drawn.figure, ds, certified_text(ds), panels.note, *notes, *lines)
    return drawn.figure


@styled
def rate_grid(ds: xr.Dataset) -> Figure:
    """Draw the rate of penetration over two axes, and the quantities that vary.

    Each value of further axes gets a panel, nine at most; the figure notes which are shown. Constant values are in the
    note.
    """
    ds = rates_in(ds)
    values = values_of_rock(ds)
    if POINT in lane_dims(ds):
        names = tuple(varied(ds))
        if len(names) != 2:
            raise InputError(f"no map: {', '.join(names) or 'none'} is what varies over the points, not two parameters")
        return draw_map(ds, names[0], names[1], (None,) * (REGIME in ds) + values[: _MOST_VALUES[3]])
    x, y = axes_of_map(ds, *long_axes(ds))
    ds = ds.sortby([x, y])
    panels = facets(ds, (x, y), _MOST_RATE_FACETS)
    shown = values[: _MOST_VALUES.get(len(panels), 1)]
    drawn = sheet(panels, shown)
    handles = cell_handles(panels.data, shown)
    lines = False
    for panel in drawn.panels:
        draw_cells(panel, x, y)
        write_labels(panel, ds[x], ds[y])
        if panel.value is shown[0]:
            lines |= _draw_relief(panel, x, y)
    drawn.finish(handles + [Line2D([], [], color=INK, linewidth=0.7, label="equal relief P/D")] * lines)
    # The values that all lanes share are in the note; the relief is proportional to a mean force that is drawn.
    given = {value.name for value in values}
    given |= {"relief"} if "mean_force" in given else set()
    fixed = [ds[name].assign_attrs(symbol=text) for name, text in _SYMBOLS.items() if name in ds and name not in given]
    texts = [value_text(data, float(data.max())) for data in fixed if data.notnull().any()]
    write_margins(drawn.figure, ds, panels.note, point=", ".join(filter(None, (point_text(ds), *texts))))
    return drawn.figure


# Cells of a grid.


def draw_cells(panel: Panel, x: str, y: str) -> None:
    """Draw the regimes or the value of `panel` over two axes; lanes without penetration are white.

    On maps of rates, lines separate cells with and without a single impact.
    """
    value = panel.value
    cells = coloured(panel.facet, value, y, x)
    right, top = fill_cells(panel, x, y, cells)
    if value is None or not value.of_rate:
        return
    nothing = cells.cells == 0
    if nothing.any():
        white = ListedColormap([NOTHING], name="nothing")
        panel.axes.pcolormesh(right, top, np.ma.masked_where(~nothing, nothing), cmap=white, rasterized=True)
    if REGIME in panel.facet:
        single = panel.facet[REGIME].transpose(y, x).values == SINGLE
        across, along = np.argwhere(single[:, 1:] != single[:, :-1]), np.argwhere(single[1:] != single[:-1])
        lines = [((right[j + 1], top[i]), (right[j + 1], top[i + 1])) for i, j in across]
        lines += [((right[j], top[i + 1]), (right[j + 1], top[i + 1])) for i, j in along]
        for colour, width in (("white", 2.2), (INK, 1.0)) if lines else ():
            panel.axes.add_collection(LineCollection(lines, colors=colour, linewidths=width), autolim=False)


def fill_cells(panel: Panel, x: str, y: str, cells: Coloured) -> list[Float[np.ndarray, " edges"]]:
    """Draw the map cells (y, x) of `panel` in their colours, and return the edges of the cells along the axes."""
    along = [values_along(panel.facet[name]) for name in (x, y)]
    ends = [edges(values) for values in along]
    masked = np.ma.masked_invalid(cells.cells)
    hatch_gaps(panel.axes, cells.cells)
    panel.axes.pcolormesh(*ends, masked, cmap=cells.colour_map, norm=cells.norm, rasterized=True)
    shape_axis(panel.axes, "x", along[0])
    if panel.axes.get_xscale() == "linear":  # no "-2.5", which would touch the tick labels of the next panel
        panel.axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    shape_axis(panel.axes, "y", along[1])
    return ends


def write_labels(panel: Panel, x: xr.DataArray, y: xr.DataArray) -> None:
    """Write the title of `panel`, and its axis labels if the panel is at an edge of the sheet."""
    axes = panel.axes
    if panel.title:
        axes.set_title(panel.title)
    axes.tick_params(labelleft=panel.first, labelbottom=panel.bottom)
    if panel.first:
        height = axes.bbox.height / axes.figure.dpi
        axes.set_ylabel(label(y, int(_LETTERS_PER_INCH * height)))
    if panel.bottom:
        axes.set_xlabel(label(x))


def _mark_cells(panel: Panel, x: str, y: str) -> dict[str, Artist]:
    """Mark lanes with a hidden motion or sensitive to rounding errors; return the legend entries by variable."""
    # Two lines: a longer legend entry would make its panel wider than the others.
    text = "same label, other motion\nfrom another start"
    dot = Line2D([], [], label=text, marker="o", markersize=3.0, markeredgewidth=0.0, linestyle="none", color=INK)
    looks: dict[str, tuple[Artist, Mapping[str, Any]]] = {
        HIDDEN: (dot, {"s": 6.0, "marker": "o", "edgecolors": "white", "linewidths": 0.4}),
        SENSITIVE: (sensitive_handle(), {"s": 9.0, "marker": "x", "linewidths": 0.6}),
    }
    handles: dict[str, Artist] = {}
    for name, (handle, look) in looks.items():
        if name in panel.facet:
            rows, columns = np.nonzero(panel.facet[name].transpose(y, x).values == 1)
            across, up = values_along(panel.facet[x])[columns], values_along(panel.facet[y])[rows]
            panel.axes.scatter(across, up, color=INK, **look)
            handles |= {name: handle} if rows.size else {}
    return handles


def _draw_relief(panel: Panel, x: str, y: str) -> bool:
    """Draw contour lines of the relief P/D with their values; return whether there are any."""
    if RELIEF not in panel.facet:
        return False
    relief = panel.facet[RELIEF].transpose(y, x).values
    constant = _CONSTANT_RELIEF * relief.max()
    if not np.isfinite(relief).all() or not all((np.ptp(relief, axis=i) > constant).any() for i in (0, 1)):
        return False  # lines would be straight if the relief does not depend on one of the axes
    levels = MaxNLocator(_RELIEF_LEVELS).tick_values(relief.min(), relief.max())
    levels = levels[(levels > relief.min()) & (levels < relief.max())]
    if not levels.size:
        return False
    along = values_along(panel.facet[x]), values_along(panel.facet[y])
    lines = panel.axes.contour(*along, relief, levels, colors=[INK], linewidths=0.7)
    texts = panel.axes.clabel(lines, fmt=lambda level: f"{level:g}", fontsize=7.5, inline_spacing=3)
    for artist in (lines, *texts):
        artist.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    return True


# Dots of a list of points.


def draw_points(axes: Axes, ds: xr.Dataset, value: Value | None, x: str, y: str) -> None:
    """Draw each lane as a dot, coloured by its regime if `value` is None, else by `value`."""
    cells, colours, norm = coloured(ds, value)
    across, up = values_along(ds[x]), values_along(ds[y])
    nothing = (cells == 0) & (value is not None and value.of_rate)
    known = np.isfinite(cells) & ~nothing
    many = cells.size > _MANY_DOTS
    size, width = (20.0 * _MANY_DOTS / cells.size, 0.0) if many else (20.0, 0.3)
    edge: dict[str, Any] = {"edgecolors": "0.3", "linewidths": width}
    mapped = edge | {"c": cells[known], "cmap": colours, "norm": norm}
    for mask, look in ((np.isnan(cells), NO_VALUE), (nothing, edge | {"c": NOTHING}), (known, mapped)):
        axes.scatter(across[mask], up[mask], s=size, **look)


def split_starts(ds: xr.Dataset) -> Facets:
    """Return one facet per initial condition of a list of points, or a single facet for many initial conditions.

    The dimension `start`, or the coordinate `start` of the points, names the initial conditions.
    """
    if many_starts(ds):
        return Facets((f"{ds.sizes[START]} starts together",), (ds,))
    if START not in ds.coords or ds[START].ndim == 0:
        return Facets(("",), (ds,))
    values = ds[START].values.astype(str)
    starts: Sequence[str] = list(dict.fromkeys(values.tolist()))
    data = tuple(ds.isel({ds[START].dims[0]: np.flatnonzero(values == name)}) for name in starts)
    if START in ds.dims:
        data = tuple(facet.isel({START: 0}) for facet in data)
    return Facets(tuple(f"start: {short(name)}" for name in starts), data, (len(starts),))


# The source's region of parameters.


def outline_region(axes: Axes, x: str, y: str) -> None:
    """Outline the source's region of best single impacts, if the axes are beta and gamma and show this region."""
    if {x, y} != set(REGION):
        return
    (west, east), (south, north) = REGION[x], REGION[y]
    (first, last), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    if west < last and east > first and south < top and north > bottom:
        region = Rectangle((west, south), east - west, north - south, fill=False, edgecolor=INK, linewidth=1.3)
        region.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
        region.set_label(_REGION_NAME)
        axes.add_patch(region)


def region_handle(axes: Axes) -> list[Artist]:
    """Return the legend entry of the source's region, or none if `axes` does not show the region."""
    shown = any(isinstance(patch, Rectangle) and patch.get_label() == _REGION_NAME for patch in axes.patches)
    return [Patch(fill=False, edgecolor=INK, linewidth=1.3, label=_REGION_NAME)] if shown else []
