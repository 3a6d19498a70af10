"""Bifurcation diagrams: the impact velocity at each stored return to the section, over the swept axis."""

from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.analyses.sweep.strips import (
    Lanes,
    Stack,
    dot_size,
    draw_stacks,
    scatter_lanes,
    select_start,
    start_names,
)
from vibrojax.errors import InputError
from vibrojax.plot.axes import scale, values_along, with_unit
from vibrojax.plot.colours import regime_cells
from vibrojax.plot.contents import REGIME, RETURN, RETURNS, START, many_starts, swept, without_single
from vibrojax.plot.overlays import OF_RETURNS, Overlays, as_layers, check_families, draw_over, over_handles, over_text
from vibrojax.plot.style import start_colour, styled

# Inches of a diagram: of one facet and of several, by the number of starts.
_HEIGHTS = {1: (3.6, 2.6), 2: (2.4, 2.0), 3: (1.9, 1.6)}
_LOWEST = (1.5, 1.3)
_OTHERS = "#CFCFCF"


@styled
def bifurcation(ds: xr.Dataset, over: Overlays = None) -> Figure:
    """Draw the impact velocity at each stored return over the swept axis, in one diagram for each start.

    The returns of all other starts are grey: two motions coexist where the dots leave them. Many starts share one
    diagram, in the colours of their regimes. Below are the regimes along the axis, a row for each start, or the shares
    of many. The swept axis is the one of most values; further axes become panels.

    **Arguments:**

    - `ds`: a sweep's dataset with `regime` and `return_impact_velocity` [m/s] along `return_index`.
    - `over`: families of orbits along the swept axis from `vj.follow`, in one dataset or several. They are drawn over
      the returns with their parameters, solid for stable orbits, dashed for unstable ones.

    **Returns:** a figure that pyplot does not manage.

    **Raises:** `InputError` if there are no returns, nothing is swept, or `over` does not have families of the same
    machine along that axis.
    """
    if RETURNS not in ds or REGIME not in ds:
        raise InputError(f"no returns to draw: the dataset holds no {RETURNS}; run the sweep with keep_returns above 0")
    ds = without_single(ds)
    if not swept(ds):
        raise InputError("no bifurcation diagram: none of the grid's axes has more than one value")
    x = max(swept(ds), key=lambda name: ds.sizes[name])
    diagrams = 1 if many_starts(ds) else len(start_names(ds))
    layers = as_layers(over)
    check_families(ds, layers, x)
    grey = Line2D([], [], label="all other starts", linestyle="none", marker="o", markersize=4.0, color=_OTHERS)
    handles: list[Artist] = [grey] * (diagrams > 1)
    heights = _HEIGHTS.get(diagrams, _LOWEST)
    draw = partial(_draw_returns, x=x, layers=layers)
    return draw_stacks(ds, x, diagrams, heights, draw, handles + over_handles(layers), over_text(ds, layers))


def _draw_returns(stack: Stack, x: str, layers: tuple[xr.Dataset, ...]) -> None:
    """Draw the returns of each start over those of all others, and the families over them."""
    facet, curves, names = stack.facet, stack.curves, start_names(stack.facet)
    factor, unit = scale(facet[RETURNS])
    size = dot_size(facet.sizes[x])

    def dots(returns: xr.DataArray) -> tuple[Lanes, Lanes]:
        along = np.repeat(values_along(facet[x]), returns.size // returns.sizes[x])
        return along, factor * returns.values.ravel()

    for position, axes in enumerate(curves):
        if not axes.get_shared_y_axes().joined(axes, curves[0]):
            axes.sharey(curves[0])
        if many_starts(facet):
            returns = facet[RETURNS].transpose(x, START, RETURN)
            regimes = np.repeat(regime_cells(facet[REGIME].transpose(x, START)).ravel(), returns.sizes[RETURN])
            scatter_lanes(axes, *dots(returns), regimes, size / 2)
        else:
            for other, name in enumerate(names):
                along, values = dots(select_start(facet, other)[RETURNS].transpose(x, RETURN))
                known, own = np.isfinite(values), other == position
                look: dict[str, Any] = {
                    "color": start_colour(name, other) if own else _OTHERS,
                    "label": name if own else f"_{name}",
                }
                axes.scatter(along[known], values[known], s=size, linewidths=0, zorder=2 + own, rasterized=True, **look)
            if names[position]:
                axes.set_title(", ".join(filter(None, (stack.title, f"start: {names[position]}"))), loc="left")
        draw_over(axes, layers, facet, x, OF_RETURNS, factor)
    if stack.first:  # written once, as high as the diagrams together
        middle = curves[len(curves) // 2]
        middle.set_ylabel(with_unit("impact velocity at each return", unit), y=0.5 if len(curves) % 2 else 1.1)
