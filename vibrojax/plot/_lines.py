"""A sweep along one axis: values as lines, regimes as a strip."""

from functools import partial

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot._grid import to_draw
from vibrojax.plot._points import regime_counts
from vibrojax.plot._stacks import Stack, draw_stacks, of_start, start_names, values_along
from vibrojax.plot._style import start_colour
from vibrojax.plot._values import Value, values_beside


def regime_lines(ds: xr.Dataset) -> Figure:
    """Impact velocity and period along the one axis worth it, one line per start, above the regimes of each start."""
    values = values_beside(ds)
    if not to_draw(ds) or not values:
        return regime_counts(ds)
    (x,) = to_draw(ds)
    height = 1.9 if len(values) > 1 else 2.4
    return draw_stacks(ds, x, len(values), lambda _: height, partial(_draw_values, values=values, x=x))


def _draw_values(stack: Stack, values: tuple[Value, ...], x: str) -> None:
    for axes, value in zip(stack.curves, values, strict=True):
        _draw_value(stack, axes, value, x)


def _draw_value(stack: Stack, axes: Axes, value: Value, x: str) -> None:
    for at, name in enumerate(start_names(stack.facet)):
        lanes = of_start(stack.facet, at)
        along, colour = values_along(lanes[x]), start_colour(name, at)
        _draw_range(axes, lanes, value, along, colour)
        # Later starts as thinner lines, so that a motion reached from both shows both colours.
        look = {"linewidth": 2.2, "markersize": 4.0} if at == 0 else {"linewidth": 1.0, "markersize": 2.2}
        axes.plot(along, value.of(lanes).values, color=colour, marker="o", label=name, **look)
    if stack.left:
        axes.set_ylabel(value.label.replace(" [", "\n["))


def _draw_range(axes: Axes, lanes: xr.Dataset, value: Value, along: np.ndarray, colour: str) -> None:
    """Shade from the least to the greatest of one lane's impacts, where the dataset has both."""
    low, high = (f"{value.name}_{end}" for end in ("min", "max"))
    if low in lanes and high in lanes:
        ends = (lanes[name].values * value.factor for name in (low, high))
        axes.fill_between(along, *ends, color=colour, alpha=0.15, linewidth=0)
