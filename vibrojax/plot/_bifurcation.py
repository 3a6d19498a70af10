"""Bifurcation diagrams: the impact velocity at each stored return to the section, over the swept axis."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.plot._about import point_text
from vibrojax.plot._facets import facets
from vibrojax.plot._flags import legend_handles
from vibrojax.plot._grid import RETURN, START, swept, without_single
from vibrojax.plot._labels import scale, with_unit
from vibrojax.plot._sheet import write_margins
from vibrojax.plot._stacks import (
    LEGEND_WIDTH,
    Stack,
    draw_strip,
    legend_at_right,
    of_start,
    stacks,
    start_handles,
    start_names,
    values_along,
)
from vibrojax.plot._style import start_colour, styled

RETURNS = "return_impact_velocity"


@styled
def bifurcation(ds: xr.Dataset) -> Figure:
    """The impact velocity at each stored return over the swept axis, all starts in one picture.

    Where the dots of two starts part, two motions coexist. Below, the regimes along the axis, a row for each start.
    The swept axis is the one of most values; others become panels.

    **Arguments:**

    - `ds`: a sweep's dataset with `regime` and `return_impact_velocity` [m/s] along `return_index`.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no returns, or nothing is swept.
    """
    if RETURNS not in ds or "regime" not in ds:
        raise InputError(f"no returns to draw: the dataset holds no {RETURNS}; run the sweep with keep_returns above 0")
    ds = without_single(ds)
    if not swept(ds):
        raise InputError("no bifurcation diagram: none of the grid's axes has more than one value")
    x = max(swept(ds), key=lambda name: ds.sizes[name])
    panels = facets(ds.sortby(x), (x, START))
    figure, drawn = stacks(panels, 1, 3.6 if len(panels) == 1 else 2.6)
    for stack in drawn:
        _draw_returns(stack, x)
        draw_strip(stack, x)
        if stack.left:
            stack.curves[0].set_ylabel(with_unit("impact velocity at each return", scale(ds[RETURNS])[1]))
    handles = legend_handles([facet["regime"] for facet in panels.data])
    legend_at_right(figure, start_handles(ds, linestyle="none"), list(handles))
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), panels.note, legend=LEGEND_WIDTH)
    return figure


def _draw_returns(stack: Stack, x: str) -> None:
    axes: Axes = stack.curves[0]
    for at, name in enumerate(start_names(stack.facet)):
        returns = of_start(stack.facet, at)[RETURNS].transpose(x, RETURN)
        along = np.repeat(values_along(stack.facet[x])[:, None], returns.sizes[RETURN], axis=1)
        there = np.isfinite(returns.values)
        # Later starts as smaller dots, so that a motion reached from both shows both colours.
        size = float(np.clip(1200.0 / stack.facet.sizes[x], 5.0, 20.0)) / (1 + at)
        dots = axes.scatter(along[there], returns.values[there], s=size, color=start_colour(name, at), linewidths=0)
        dots.set_label(name)
        dots.set_rasterized(True)
