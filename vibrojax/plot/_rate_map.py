"""Maps of the rate of penetration under a given force: with the slip per blow, the mean force and the relief."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from vibrojax.errors import InputError
from vibrojax.plot._about import point_text
from vibrojax.plot._cells import RATE, draw_cells, write_labels
from vibrojax.plot._facets import facets
from vibrojax.plot._grid import POINT, chosen, lane_dims, to_map, without_single
from vibrojax.plot._labels import scale, value_text
from vibrojax.plot._points import scattered, varied
from vibrojax.plot._sheet import Panel, sheet, write_margins
from vibrojax.plot._style import INK, styled
from vibrojax.plot._values import Value, value_handles, values_of_rock

_MOST = 9  # facets
_SHOWN = {1: 4, 2: 3, 3: 3}  # values by the number of facets; of more facets only the rate
_LEVELS = 5  # of lines of equal relief, about
_SAME = 1e-9  # relative, within which the relief does not vary
RELIEF = "relief"
_SYMBOLS = {"mean_force": "P", "relief": "P/D"}


@styled
def rate_map(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """The rate of penetration as a map over two axes, with slip per blow, mean force and relief where there is room.

    Further axes become panels: nine at most, and the figure says which. What is the same all over is in the note. A
    list of points is scattered over the two parameters that vary.

    **Arguments:**

    - `ds`: a sweep's dataset with `rate_of_penetration` [m/s], and `slip_per_impact` [m], `mean_force` [N] and `relief`
      [1] where there are any.
    - `x`, `y`: the axes to draw along; left out: the frequency, then the longest.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no rates, there are no two axes, or `x` or `y` is no axis of the sweep.
    """
    if RATE not in ds or ds[RATE].size == 0:
        raise InputError(f"no rates to draw: the dataset holds no variable {RATE}")
    ds = without_single(ds)
    if POINT in lane_dims(ds):
        return _points(ds)
    if x is None and y is None:
        x, y = (*to_map(ds), None, None)[:2]
    x, y = chosen(ds, x, y)
    ds = ds.sortby([x, y])
    panels = facets(ds, (x, y), _MOST)
    values = values_of_rock(ds)
    shown = values[: _SHOWN.get(len(panels), 1)]
    drawn = sheet(panels, shown)
    lines = False
    for panel in drawn:
        draw_cells(panel, x, y)
        write_labels(panel, ds[x], ds[y])
        if panel.value is shown[0]:
            lines |= _draw_relief(panel, x, y)
    drawn.finish(value_handles(panels.data, shown) + ([_relief_handle()] if lines else []))
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), _about(ds, values), panels.note)
    return drawn.figure


def _points(ds: xr.Dataset) -> Figure:
    names = varied(ds)
    if len(names) != 2:
        raise InputError(f"no map: {', '.join(names) or 'none'} is what varies over the points, not two parameters")
    return scattered(ds, *names, values_of_rock(ds)[: _SHOWN[3]])


def _draw_relief(panel: Panel, x: str, y: str) -> bool:
    """Draw lines of equal P/D, with their values; whether there are any."""
    if RELIEF not in panel.facet:
        return False
    relief = panel.facet[RELIEF].transpose(y, x).values
    finite = relief[np.isfinite(relief)]
    if finite.size < relief.size or not all((np.ptp(relief, axis=i) > _SAME * relief.max()).any() for i in (0, 1)):
        return False  # over one of the axes nothing but straight lines
    along = (panel.facet[name].values * scale(panel.facet[name])[0] for name in (x, y))
    levels = MaxNLocator(_LEVELS).tick_values(finite.min(), finite.max())
    levels = levels[(levels > finite.min()) & (levels < finite.max())]
    if not levels.size:
        return False
    drawn = panel.axes.contour(*along, relief, levels, colors=[INK], linewidths=0.7)
    drawn.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    for text in panel.axes.clabel(drawn, fmt=lambda level: f"{level:g}", fontsize=7.5, inline_spacing=3):
        text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    return True


def _relief_handle() -> Artist:
    return Line2D([], [], color=INK, linewidth=0.7, label="equal relief P/D")


def _about(ds: xr.Dataset, values: tuple[Value, ...]) -> str:
    """What is the same all over, mean force and relief with it."""
    drawn = {value.name for value in values}
    drawn |= {"relief"} if "mean_force" in drawn else set()
    fixed = {text: ds[name] for name, text in _SYMBOLS.items() if name in ds and name not in drawn}
    texts = [
        value_text(data.assign_attrs(symbol=text), float(data.max()))
        for text, data in fixed.items()
        if data.notnull().any()
    ]
    return ", ".join(part for part in (point_text(ds), *texts) if part)
