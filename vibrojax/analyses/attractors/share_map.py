"""The share of starts that end in the strong single impact, over two parameters, beside the scene's own starts."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vibrojax.analyses.sweep.maps import draw_cells, outline_region, region_handle, write_labels
from vibrojax.io.attributes import parameters_of
from vibrojax.plot.colours import SINGLE, Values, regime_handles, share_value, value_of
from vibrojax.plot.contents import NAMED, REGIME, START, axes_of_map, without_single
from vibrojax.plot.margins import write_margins
from vibrojax.plot.sheet import MOST_PANELS, facets, sheet
from vibrojax.plot.style import styled

_STRONG, _COUNT, _FROM = "strong_share", "attractors", "regime_from_"


@styled
def share_map(ds: xr.Dataset) -> Figure:
    """Draw the share of starts that end in the strong single impact, over two axes.

    Beside it are the regimes of the scene's own starts, or without these the number of attractors. An impact is strong
    if the striker hits faster than the drive moves: its mean velocity at impacts is above `v`. Further axes become
    rows.

    **Arguments:** `ds`: a dataset of `attractors` over a grid.
    """
    ds = without_single(ds)
    x, y = axes_of_map(ds, None, None)
    ds = ds.sortby([x, y])
    names = [str(name) for name in ds[NAMED].values] if NAMED in ds.dims else []
    share = strong_share(ds)
    coords = {name: data for name, data in ds.coords.items() if set(data.dims) <= set(share.dims)}
    shown = xr.Dataset({_STRONG: share}, coords, ds.attrs)
    for name in names:
        shown[_FROM + name] = ds["named_regime"].sel({NAMED: name}, drop=True)
    if not names:
        shown[_COUNT] = (ds["share"] > 0).sum("attractor").astype(float)
    shown[REGIME] = shown[_FROM + names[0]] if names else xr.zeros_like(share, np.int8)
    columns: Values = (share_value(shown[_STRONG], "strong single impact"),)
    columns += (None,) * len(names) if names else (value_of(shown[_COUNT]),)
    panels = facets(shown, (x, y), MOST_PANELS // len(columns))
    drawn = sheet(panels, columns)
    places = dict.fromkeys(map(id, panels.data), -1)  # the panels of a facet come in the order of the columns
    for panel in drawn:
        places[id(panel.facet)] += 1
        if panel.value is None:
            name = names[places[id(panel.facet)] - 1]
            panel.axes.set_title(", ".join(filter(None, (panel.title, f"from {name}"))))
            panel.facet[REGIME] = panel.facet[_FROM + name]
        draw_cells(panel, x, y)
        outline_region(panel.axes, x, y)
        write_labels(panel, shown[x], shown[y])
    handles = regime_handles([facet[_FROM + name] for facet in panels.data for name in names]) if names else []
    drawn.finish(handles + region_handle(drawn.panels[0].axes))
    strong = "Strong: the striker hits faster than the drive moves"
    about = "Of single impacts, strong or weak" if _drive_speed(ds) is None else strong
    write_margins(drawn.figure, ds, panels.note, f"{ds.sizes[START]} starts at each point", about)
    return drawn.figure


def strong_share(ds: xr.Dataset) -> xr.DataArray:
    """Return the share [%] of starts that end in a stable single impact faster than the drive, over the grid.

    In scenes without a drive all single impacts count.
    """
    strong = ds[REGIME] == SINGLE
    speed = _drive_speed(ds)
    if speed is not None:
        strong = strong & (ds["impact_velocity"] > speed)
    return (100.0 * ds["share"]).where(strong, 0.0).sum("attractor").assign_attrs(units="%")


def _drive_speed(ds: xr.Dataset) -> xr.DataArray | float | None:
    """Return the drive's speed [m/s]; None if there are no impacts or no drive."""
    if "impact_velocity" not in ds:
        return None
    return ds["v"] if "v" in ds.coords else parameters_of(ds).get("v")
