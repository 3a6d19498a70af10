"""Regime maps: which motion there is at each point of a sweep, from each start."""

import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.plot._about import point_text
from vibrojax.plot._cells import draw_cells, single_handle, write_labels
from vibrojax.plot._facets import facets
from vibrojax.plot._flags import legend_handles
from vibrojax.plot._grid import POINT, chosen, to_draw, without_single
from vibrojax.plot._lines import regime_lines
from vibrojax.plot._points import regime_points
from vibrojax.plot._region import outline_handle, outline_region
from vibrojax.plot._sheet import sheet, write_margins
from vibrojax.plot._style import styled
from vibrojax.plot._values import value_handles, values_beside


@styled
def regime_map(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """The regimes of a sweep as a map, with impact velocity and period beside it.

    Further axes, and the starts, become panels: twelve at most, and the figure says which. A sweep along one axis
    becomes lines, a list of points a scatter (two parameters vary) or a count.

    **Arguments:**

    - `ds`: a sweep's dataset, with `regime` and, where the scene has them, `impact_velocity` [m/s] and `period` [s].
    - `x`, `y`: the axes to draw along; left out: gamma and beta, else the first two of six values or more, else the
      first two.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no regimes, or `x` or `y` is no axis of the sweep.
    """
    if "regime" not in ds or ds["regime"].size == 0:
        raise InputError('no regimes to draw: the dataset holds no variable "regime"')
    ds = without_single(ds)
    if POINT in ds["regime"].dims:
        return regime_points(ds)
    if x is None and y is None and len(to_draw(ds)) < 2:
        return regime_lines(ds)
    return _grid_map(ds, *chosen(ds, x, y))


def _grid_map(ds: xr.Dataset, x: str, y: str) -> Figure:
    ds = ds.sortby([x, y])
    panels = facets(ds, (x, y))
    values = values_beside(ds)
    drawn = sheet(panels, (None, *values))
    for panel in drawn:
        draw_cells(panel, x, y)
        outline_region(panel.axes, x, y)
        write_labels(panel, ds[x], ds[y])
    handles: list[Artist] = list(legend_handles([facet["regime"] for facet in panels.data]))
    handles += value_handles(panels.data, values) + single_handle(drawn.panels)
    drawn.finish(handles + outline_handle(drawn.panels[0].axes))
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), point_text(ds), panels.note)
    return drawn.figure
