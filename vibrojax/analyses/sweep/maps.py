"""Maps over two axes of a sweep: of regimes with quantities beside them, and of rates of penetration."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from vibrojax.measures.labels import REGIMES
from vibrojax.plot.axes import certified_text, edges, label, point_text, shape_axis, value_text, values_along
from vibrojax.plot.borders import OVER_TEXT, border_handles, check_borders, draw_over_panel
from vibrojax.plot.colours import (
    Coloured,
    Value,
    coloured,
    regime_handles,
    sensitive_handle,
    value_handles,
    values_beside,
    values_of_rock,
)
from vibrojax.plot.contents import (
    HIDDEN,
    REGIME,
    RELIEF,
    SENSITIVE,
    axes_of_map,
    has_regimes,
    long_axes,
    rates_in,
    regimes_in,
)
from vibrojax.plot.margins import write_margins
from vibrojax.plot.sheet import MOST, Panel, facets, sheet
from vibrojax.plot.style import INK, NOTHING, styled

SINGLE = REGIMES.index("single-impact")
MOST_VALUES = {1: 4, 2: 3, 3: 3}  # on maps of rates, by the number of facets; of more facets only the rate
_MOST_FACETS = 9  # of maps of rates
_SEVERAL = 4  # values, from which there are fewer facets
_LEVELS = 5  # of lines of equal relief, about
_SAME = 1e-9  # relative, within which the relief does not vary
_LETTERS = 17  # of a label, for an inch of its axis
_NONE = ListedColormap([NOTHING], name="nothing")
_SYMBOLS = {"mean_force": "P", "relief": "P/D"}

_MARKS: dict[str, dict[str, Any]] = {
    HIDDEN: {"s": 6.0, "marker": "o", "color": INK, "edgecolors": "white", "linewidths": 0.4},
    SENSITIVE: {"s": 9.0, "marker": "x", "color": INK, "linewidths": 0.6},
}
"""The marks of cells, by the variable that is 1 there."""

# Chapter 5 of the source: stable single impact, "best".
REGION = {"beta": (0.25, 0.60), "gamma": (0.60, 0.80)}
_REGION_NAME = "source's best region"


@styled
def regime_grid(ds: xr.Dataset, x: str | None = None, y: str | None = None, over: xr.Dataset | None = None) -> Figure:
    """The regimes over two axes, with the quantities worth a panel beside them; see `regime_map`. `over`: borders to
    lay over the regimes."""
    ds = regimes_in(ds)
    return map_of(ds, (None, *values_beside(ds)), *axes_of_map(ds, x, y), over=over)


def map_of(
    ds: xr.Dataset,
    values: tuple[Value | None, ...],
    x: str,
    y: str,
    *about: str,
    over: xr.Dataset | None = None,
) -> Figure:
    """The `values` in `ds`, None for the regimes, over its axes `x` and `y`, and what there is to say `about` it.
    `over`: borders to lay over the regimes."""
    if over is not None:
        check_borders(ds, over, x, y)
    ds = ds.sortby([x, y])
    panels = facets(ds, (x, y), MOST if len(values) < _SEVERAL else MOST // 2)
    drawn = sheet(panels, values)
    marked: set[str] = set()
    kinds: list[str] = []
    for panel in drawn:
        draw_cells(panel, x, y)
        if panel.value is None:
            marked |= {name for name in _MARKS if _mark_cells(panel, x, y, name)}
        if over is not None and panel.value is None:
            kinds += draw_over_panel(panel.axes, over, panel.facet, x, y)
        outline_region(panel.axes, x, y)
        write_labels(panel, ds[x], ds[y])
    handles = regime_handles([facet[REGIME] for facet in panels.data]) if None in values else []
    handles += value_handles(panels.data, [value for value in values if value is not None])
    drawn.finish(
        handles
        + ([_hidden_handle()] if HIDDEN in marked else [])
        + ([sensitive_handle()] if SENSITIVE in marked else [])
        + _border_handle(drawn.panels)
        + border_handles(kinds)
        + region_handle(drawn.panels[0].axes)
    )
    notes = point_text(ds), certified_text(ds), panels.note, *about, OVER_TEXT if kinds else ""
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), *notes)
    return drawn.figure


@styled
def rate_grid(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """The rate of penetration over two axes, with what else varies; see `rate_map`."""
    ds = rates_in(ds)
    if x is None and y is None:
        x, y = (*long_axes(ds), None, None)[:2]
    x, y = axes_of_map(ds, x, y)
    ds = ds.sortby([x, y])
    panels = facets(ds, (x, y), _MOST_FACETS)
    values = values_of_rock(ds)
    shown = values[: MOST_VALUES.get(len(panels), 1)]
    drawn = sheet(panels, shown)
    lines = False
    for panel in drawn:
        draw_cells(panel, x, y)
        write_labels(panel, ds[x], ds[y])
        if panel.value is shown[0]:
            lines |= _draw_relief(panel, x, y)
    drawn.finish(value_handles(panels.data, shown) + ([_relief_handle()] if lines else []))
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), _same_all_over(ds, values), panels.note)
    return drawn.figure


# Cells.


class Corners(NamedTuple):
    """The ends of the cells of a map along its axes."""

    right: Float[np.ndarray, " columns+1"]
    top: Float[np.ndarray, " rows+1"]


def draw_cells(panel: Panel, x: str, y: str) -> None:
    """Draw the regimes or the value of `panel` over the axes `x` and `y`; where there is no penetration, nothing."""
    axes, value = panel.axes, panel.value
    shown = coloured(panel.facet, value, y, x)
    corners = fill_cells(panel, x, y, shown)
    if value is None or not value.of_rate:
        return
    nothing = shown.cells == 0
    if nothing.any():
        axes.pcolormesh(*corners, np.ma.masked_where(~nothing, nothing), cmap=_NONE, rasterized=True)
    if has_regimes(panel.facet):
        _outline_single(axes, panel.facet[REGIME].transpose(y, x).values == SINGLE, corners)


def fill_cells(panel: Panel, x: str, y: str, shown: Coloured) -> Corners:
    """Fill the cells (y, x) of `panel` with colours, and give their ends along the axes."""
    across, up = (values_along(panel.facet[name]) for name in (x, y))
    corners = Corners(edges(across), edges(up))
    cells = np.ma.masked_invalid(shown.cells)
    panel.axes.pcolormesh(*corners, cells, cmap=shown.colour_map, norm=shown.norm, rasterized=True)
    shape_axis(panel.axes, "x", across)
    if panel.axes.get_xscale() == "linear":  # no "-2.5", whose neighbours in the next panel would touch
        panel.axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    shape_axis(panel.axes, "y", up)
    return corners


def write_labels(panel: Panel, x: xr.DataArray, y: xr.DataArray) -> None:
    """Write the title of `panel`, and the labels of its axes where labels go."""
    if panel.title:
        panel.axes.set_title(panel.title)
    panel.axes.tick_params(labelleft=panel.left, labelbottom=panel.bottom)
    if panel.left:
        height = panel.axes.get_position().height * panel.figure.get_figheight()
        panel.axes.set_ylabel(label(y, int(_LETTERS * height)))
    if panel.bottom:
        panel.axes.set_xlabel(label(x))


# The border of the single impact, and the source's region.


def _outline_single(axes: Axes, single: Bool[np.ndarray, "rows columns"], corners: Corners) -> None:
    """Draw the sides between cells of which one is a single impact and the other is not."""
    right, top = corners
    i, j = np.nonzero(single[:, 1:] != single[:, :-1])
    upright = [((right[b + 1], top[a]), (right[b + 1], top[a + 1])) for a, b in zip(i, j, strict=True)]
    i, j = np.nonzero(single[1:] != single[:-1])
    flat = [((right[b], top[a + 1]), (right[b + 1], top[a + 1])) for a, b in zip(i, j, strict=True)]
    if upright or flat:
        for colour, width in (("white", 2.2), (INK, 1.0)):
            axes.add_collection(LineCollection([*upright, *flat], colors=colour, linewidths=width), autolim=False)


def _mark_cells(panel: Panel, x: str, y: str, name: str) -> bool:
    """Mark the cells where the variable `name` is 1, and return whether there are any."""
    if name not in panel.facet:
        return False
    cells = np.argwhere(panel.facet[name].transpose(y, x).values == 1)
    across, up = (values_along(panel.facet[axis]) for axis in (x, y))
    panel.axes.scatter(across[cells[:, 1]], up[cells[:, 0]], **_MARKS[name])
    return len(cells) > 0


def _hidden_handle() -> Artist:
    label = "same label, other motion\nfrom another start"  # on two lines, else its panel gets wider than the others
    return Line2D([], [], label=label, marker="o", markersize=3.0, markeredgewidth=0.0, linestyle="none", color=INK)


def _border_handle(panels: Sequence[Panel]) -> list[Artist]:
    """The legend's entry for the border of the single impact, where one of `panels` shows it."""
    shown = any(isinstance(one, LineCollection) for panel in panels for one in panel.axes.collections)
    return [Line2D([], [], color=INK, linewidth=1.0, label="border of single impact")] if shown else []


def outline_region(axes: Axes, x: str, y: str) -> None:
    """Outline the region of the source's best single impacts where the axes are beta and gamma and show some of it."""
    if {x, y} != set(REGION):
        return
    (left, right), (low, high) = REGION[x], REGION[y]
    (first, last), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    if left < last and right > first and low < top and high > bottom:
        region = Rectangle((left, low), right - left, high - low, fill=False, edgecolor=INK, linewidth=1.3)
        region.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
        region.set_label(_REGION_NAME)
        axes.add_patch(region)


def region_handle(axes: Axes) -> list[Artist]:
    """The legend's entry for the source's region, where `axes` shows it."""
    shown = any(isinstance(patch, Rectangle) and patch.get_label() == _REGION_NAME for patch in axes.patches)
    return [Patch(fill=False, edgecolor=INK, linewidth=1.3, label=_REGION_NAME)] if shown else []


# The relief, and what is the same all over.


def _draw_relief(panel: Panel, x: str, y: str) -> bool:
    """Draw lines of equal P/D, with their values; whether there are any."""
    if RELIEF not in panel.facet:
        return False
    relief = panel.facet[RELIEF].transpose(y, x).values
    finite = relief[np.isfinite(relief)]
    if finite.size < relief.size or not all((np.ptp(relief, axis=i) > _SAME * relief.max()).any() for i in (0, 1)):
        return False  # over one of the axes nothing but straight lines
    levels = MaxNLocator(_LEVELS).tick_values(finite.min(), finite.max())
    levels = levels[(levels > finite.min()) & (levels < finite.max())]
    if not levels.size:
        return False
    along = values_along(panel.facet[x]), values_along(panel.facet[y])
    drawn = panel.axes.contour(*along, relief, levels, colors=[INK], linewidths=0.7)
    drawn.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    for text in panel.axes.clabel(drawn, fmt=lambda level: f"{level:g}", fontsize=7.5, inline_spacing=3):
        text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    return True


def _relief_handle() -> Artist:
    return Line2D([], [], color=INK, linewidth=0.7, label="equal relief P/D")


def _same_all_over(ds: xr.Dataset, values: Sequence[Value]) -> str:
    """What is the same all over `ds`, mean force and relief with it."""
    drawn = {value.name for value in values}
    drawn |= {"relief"} if "mean_force" in drawn else set()
    fixed = {text: ds[name] for name, text in _SYMBOLS.items() if name in ds and name not in drawn}
    texts = [
        value_text(data.assign_attrs(symbol=text), float(data.max()))
        for text, data in fixed.items()
        if data.notnull().any()
    ]
    return ", ".join(part for part in (point_text(ds), *texts) if part)
