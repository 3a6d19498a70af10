"""One panel of a map: its cells in colours, what stands along its axes, and where the motion is a single impact."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.lines import Line2D

from vibrojax.label import REGIMES
from vibrojax.plot._flags import COLOUR_MAP, NORM, flags
from vibrojax.plot._grid import edges, shape_axis
from vibrojax.plot._labels import label, scale
from vibrojax.plot._sheet import Panel
from vibrojax.plot._style import INK, NOTHING

RATE = "rate_of_penetration"
_LETTERS = 17  # of a label, for an inch of its axis
_NONE = ListedColormap([NOTHING], name="nothing")
SINGLE = REGIMES.index("single-impact")


def draw_cells(panel: Panel, x: str, y: str) -> None:
    """Draw the regimes or the value of `panel` over the axes `x` and `y`; where there is no penetration, nothing."""
    axes, value = panel.axes, panel.value
    if value is None:
        cells, colours, norm = flags(panel.facet["regime"].transpose(y, x)), COLOUR_MAP, NORM
    else:
        cells, colours, norm = value.of(panel.facet).transpose(y, x).values, value.colour_map, value.norm
    corners = fill_cells(panel, x, y, cells, colours, norm)
    if value is not None and value.of_rate and (nothing := cells == 0).any():
        axes.pcolormesh(*corners, np.ma.masked_where(~nothing, nothing), cmap=_NONE, rasterized=True)
    if value is not None and value.of_rate and "regime" in panel.facet:
        _outline_single(axes, panel.facet["regime"].transpose(y, x).values == SINGLE, *corners)


def fill_cells(
    panel: Panel, x: str, y: str, cells: np.ndarray, colours: Colormap, norm: Normalize
) -> tuple[np.ndarray, np.ndarray]:
    """Fill the `cells` (y, x) of `panel` with colours, and give their ends along the axes."""
    across, up = (panel.facet[name].values * scale(panel.facet[name])[0] for name in (x, y))
    corners = edges(across), edges(up)
    panel.axes.pcolormesh(*corners, np.ma.masked_invalid(cells), cmap=colours, norm=norm, rasterized=True)
    shape_axis(panel.axes, "x", across)
    shape_axis(panel.axes, "y", up)
    return corners


def write_labels(panel: Panel, x: xr.DataArray, y: xr.DataArray) -> None:
    """Write the title of `panel`, and the labels of its axes where labels go."""
    if panel.title:
        panel.axes.set_title(panel.title)
    panel.axes.tick_params(labelleft=panel.left, labelbottom=panel.bottom)
    if panel.left:
        height = panel.axes.get_position().height * panel.axes.get_figure().get_figheight()
        panel.axes.set_ylabel(label(y, int(_LETTERS * height)))
    if panel.bottom:
        panel.axes.set_xlabel(label(x))


def single_handle(panels: list[Panel]) -> list[Artist]:
    """The legend's entry for the border of the single impact, where one of `panels` shows it."""
    shown = any(isinstance(one, LineCollection) for panel in panels for one in panel.axes.collections)
    return [Line2D([], [], color=INK, linewidth=1.0, label="border of single impact")] if shown else []


def _outline_single(axes: Axes, single: np.ndarray, right: np.ndarray, top: np.ndarray) -> None:
    """Draw the sides between cells of which one is a single impact and the other is not."""
    i, j = np.nonzero(single[:, 1:] != single[:, :-1])
    upright = [((right[b + 1], top[a]), (right[b + 1], top[a + 1])) for a, b in zip(i, j, strict=True)]
    i, j = np.nonzero(single[1:] != single[:-1])
    flat = [((right[b], top[a + 1]), (right[b + 1], top[a + 1])) for a, b in zip(i, j, strict=True)]
    if upright or flat:
        for colour, width in (("white", 2.2), (INK, 1.0)):
            axes.add_collection(LineCollection([*upright, *flat], colors=colour, linewidths=width), autolim=False)
