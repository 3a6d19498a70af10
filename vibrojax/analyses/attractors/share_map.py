"""The share of starts that end in the strong single impact, over two parameters, beside where the scene's own lead."""

from collections import Counter

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vibrojax.analyses.sweep.maps import draw_cells, outline_region, region_handle, write_labels
from vibrojax.io.attributes import parameters_of
from vibrojax.measures.labels import REGIMES
from vibrojax.plot.axes import point_text
from vibrojax.plot.colours import Value, regime_handles, share_value, value_of
from vibrojax.plot.contents import NAMED, REGIME, START, axes_of_map, without_single
from vibrojax.plot.margins import write_margins
from vibrojax.plot.sheet import MOST, Panel, facets, sheet
from vibrojax.plot.style import styled

_SINGLE = REGIMES.index("single-impact")
_STRONG, _COUNT = "strong_share", "attractors"
_ABOUT = {
    True: "Strong: the striker hits faster than the drive moves",
    False: "Of single impacts, strong or weak",
}


@styled
def share_map(ds: xr.Dataset) -> Figure:
    """The share of starts that end in the strong single impact, over two axes; beside it the regimes that the scene's
    own starts lead to, or where these were not run the number of attractors.

    An impact is strong where the striker hits faster than the drive moves: its mean velocity at impacts is above `v`.
    Further axes become rows.

    **Arguments:** `ds`: what `attractors` gives, over a grid.
    """
    ds = without_single(ds)
    x, y = axes_of_map(ds, None, None)
    ds = ds.sortby([x, y])
    names = [str(name) for name in ds[NAMED].values] if NAMED in ds.dims else []
    share = strong_share(ds)
    kept = {name: one for name, one in ds.coords.items() if set(one.dims) <= set(share.dims)}
    shown = xr.Dataset({_STRONG: share}, kept, ds.attrs)
    columns: tuple[Value | None, ...] = (share_value(shown[_STRONG], "strong single impact"),)
    if names:
        for name in names:
            shown[_from(name)] = ds["named_regime"].sel({NAMED: name}, drop=True)
        shown[REGIME] = shown[_from(names[0])]
        columns += (None,) * len(names)
    else:
        shown[_COUNT] = (ds["share"] > 0).sum("attractor").astype(float)
        shown[REGIME] = xr.zeros_like(share, np.int8)
        columns += (value_of(shown[_COUNT]),)
    panels = facets(shown, (x, y), MOST // len(columns))
    drawn = sheet(panels, columns)
    column: Counter[int] = Counter()  # the panels of a facet come in the order of the columns
    for panel in drawn:
        at = column[id(panel.facet)]
        column[id(panel.facet)] += 1
        _draw(panel, names[at - 1] if names and at else "", x, y)
        write_labels(panel, shown[x], shown[y])
    handles = regime_handles([facet[_from(name)] for facet in panels.data for name in names]) if names else []
    drawn.finish(handles + region_handle(drawn.panels[0].axes))
    about = f"{ds.sizes[START]} starts at each point", _ABOUT[_speed(ds) is not None]
    write_margins(drawn.figure, str(ds.attrs.get("title", "")), point_text(ds), panels.note, *about)
    return drawn.figure


def strong_share(ds: xr.Dataset) -> xr.DataArray:
    """The share [%] of starts that end in a stable single impact with an impact velocity above the drive's speed, over
    the grid; in any single impact where the scene has no drive."""
    strong = ds[REGIME] == _SINGLE
    speed = _speed(ds)
    if speed is not None:
        strong = strong & (ds["impact_velocity"] > speed)
    return (100.0 * ds["share"]).where(strong, 0.0).sum("attractor").assign_attrs(units="%")


def _speed(ds: xr.Dataset) -> xr.DataArray | float | None:
    """The drive's speed [m/s]."""
    if "impact_velocity" not in ds:
        return None
    return ds["v"] if "v" in ds.coords else parameters_of(ds).get("v")


def _draw(panel: Panel, start: str, x: str, y: str) -> None:
    if start:
        facet = panel.facet.assign({REGIME: panel.facet[_from(start)]})
        title = ", ".join(part for part in (panel.title, f"from {start}") if part)
        panel.axes.set_title(title)
        panel = Panel(panel.figure, panel.axes, facet, panel.title, None, panel.left, panel.bottom)
    draw_cells(panel, x, y)
    outline_region(panel.axes, x, y)


def _from(start: str) -> str:
    return f"regime_from_{start}"
