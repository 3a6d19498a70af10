"""Bifurcation diagrams: the impact velocity at each stored return to the section, over the swept axis."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.analyses.sweep.strips import Lanes, Stack, dot_size, draw_stacks, of_lanes, of_start, start_names
from vibrojax.errors import InputError
from vibrojax.plot.axes import scale, values_along, with_unit
from vibrojax.plot.colours import flags
from vibrojax.plot.contents import REGIME, RETURN, RETURNS, START, many_starts, swept, without_single
from vibrojax.plot.overlays import OF_RETURNS, check_over, draw_over, over_handles, over_text, several
from vibrojax.plot.style import Mark, start_colour, styled

_HIGH = {1: (3.6, 2.6), 2: (2.4, 2.0), 3: (1.9, 1.6)}  # inches of a diagram by the starts: of one facet, of several
_LOW = (1.5, 1.3)
_OTHERS = "#CFCFCF"
_GREY = Mark(linestyle="none", marker="o", markersize=4.0, color=_OTHERS)


@styled
def bifurcation(ds: xr.Dataset, over: xr.Dataset | Sequence[xr.Dataset] | None = None) -> Figure:
    """The impact velocity at each stored return over the swept axis: a diagram for each start, over those of all.

    Where the dots of a start leave those of the others, grey, two motions coexist. Many starts are in one diagram, in
    the colours of their regimes. Below, the regimes along the axis, a row for each start, or the shares of many. The
    swept axis is the one of most values; others become panels.

    **Arguments:**

    - `ds`: a sweep's dataset with `regime` and `return_impact_velocity` [m/s] along `return_index`.
    - `over`: families of orbits along the swept axis, as `vj.follow` gives them, in one dataset or several: drawn over
      the returns, solid where they are stable, dashed where not. Each panel has the families of its parameters.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no returns, or nothing is swept; where `over` has no families along that
    axis, or of another machine.
    """
    if RETURNS not in ds or REGIME not in ds:
        raise InputError(f"no returns to draw: the dataset holds no {RETURNS}; run the sweep with keep_returns above 0")
    ds = without_single(ds)
    if not swept(ds):
        raise InputError("no bifurcation diagram: none of the grid's axes has more than one value")
    x = max(swept(ds), key=lambda name: ds.sizes[name])
    diagrams = 1 if many_starts(ds) else len(start_names(ds))
    of_one, of_several = _HIGH.get(diagrams, _LOW)
    every = several(over)
    for one in every:
        check_over(ds, one, x)
    draw = partial(_draw_returns, x=x, every=every)
    handles: list[Artist] = [Line2D([], [], label="all other starts", **_GREY)] if diagrams > 1 else []
    handles += over_handles(every)
    about = over_text(ds, every, OF_RETURNS)
    return draw_stacks(ds, x, diagrams, lambda count: of_one if count == 1 else of_several, draw, handles, about)


def _draw_returns(stack: Stack, x: str, every: Sequence[xr.Dataset]) -> None:
    factor, unit = scale(stack.facet[RETURNS])
    names = start_names(stack.facet)
    first = stack.curves[0]
    for at, axes in enumerate(stack.curves):
        if not axes.get_shared_y_axes().joined(axes, first):
            axes.sharey(first)
        if many_starts(stack.facet):
            returns = stack.facet[RETURNS].transpose(x, START, RETURN)
            regimes = np.repeat(flags(stack.facet[REGIME].transpose(x, START)).ravel(), returns.sizes[RETURN])
            of_lanes(axes, *_dots(stack.facet, returns, x, factor), regimes, dot_size(stack.facet.sizes[x]) / 2)
        else:
            _draw_start(axes, stack, x, at, factor)
            if names[at]:
                axes.set_title(", ".join(part for part in (stack.title, f"start: {names[at]}") if part), loc="left")
        for over in every:
            draw_over(axes, over, stack.facet, x, OF_RETURNS, factor)
    if stack.left:  # written once, as high as the diagrams together
        middle = stack.curves[len(stack.curves) // 2]
        middle.set_ylabel(with_unit("impact velocity at each return", unit), y=0.5 if len(stack.curves) % 2 else 1.1)


def _draw_start(axes: Axes, stack: Stack, x: str, at: int, factor: float) -> None:
    """Draw the returns of the start at `at`, over those of all other starts."""
    size = dot_size(stack.facet.sizes[x])
    for other, name in enumerate(start_names(stack.facet)):
        along, values = _dots(stack.facet, of_start(stack.facet, other)[RETURNS].transpose(x, RETURN), x, factor)
        known, own = np.isfinite(values), other == at
        colour = start_colour(name, other) if own else _OTHERS
        dots = axes.scatter(along[known], values[known], s=size, color=colour, linewidths=0, zorder=2 + own)
        dots.set_label(name if own else f"_{name}")
        dots.set_rasterized(True)


def _dots(facet: xr.Dataset, returns: xr.DataArray, x: str, factor: float) -> tuple[Lanes, Lanes]:
    """Where the dots lie: along the axis `x`, and up."""
    along = np.repeat(values_along(facet[x]), returns.size // returns.sizes[x])
    return along, factor * returns.values.ravel()
