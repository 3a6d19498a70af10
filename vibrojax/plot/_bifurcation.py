"""Bifurcation diagrams: the impact velocity at each stored return to the section, over the swept axis."""

from functools import partial

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.plot._axes import scale, values_along, with_unit
from vibrojax.plot._contents import REGIME, RETURN, RETURNS, swept, without_single
from vibrojax.plot._strips import Stack, draw_stacks, of_start, start_names
from vibrojax.plot.style import start_colour, styled


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
    if RETURNS not in ds or REGIME not in ds:
        raise InputError(f"no returns to draw: the dataset holds no {RETURNS}; run the sweep with keep_returns above 0")
    ds = without_single(ds)
    if not swept(ds):
        raise InputError("no bifurcation diagram: none of the grid's axes has more than one value")
    x = max(swept(ds), key=lambda name: ds.sizes[name])
    factor, unit = scale(ds[RETURNS])
    label = with_unit("impact velocity at each return", unit)
    return draw_stacks(
        ds,
        x,
        1,
        lambda count: 3.6 if count == 1 else 2.6,
        partial(_draw_returns, x=x, factor=factor, label=label),
        "none",
    )


def _draw_returns(stack: Stack, x: str, factor: float, label: str) -> None:
    axes = stack.curves[0]
    for at, name in enumerate(start_names(stack.facet)):
        returns = of_start(stack.facet, at)[RETURNS].transpose(x, RETURN)
        along = np.repeat(values_along(stack.facet[x])[:, None], returns.sizes[RETURN], axis=1)
        known = np.isfinite(returns.values)
        # Later starts as smaller dots, so that a motion reached from both shows both colours.
        size = float(np.clip(1200.0 / stack.facet.sizes[x], 5.0, 20.0)) / (1 + at)
        colour = start_colour(name, at)
        dots = axes.scatter(along[known], factor * returns.values[known], s=size, color=colour, linewidths=0)
        dots.set_label(name)
        dots.set_rasterized(True)
    if stack.left:
        axes.set_ylabel(label)
