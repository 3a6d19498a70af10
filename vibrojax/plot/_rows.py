"""The layout of curves of several quantities: a row for each facet, a column for each quantity."""

from dataclasses import dataclass

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from vibrojax.plot._facets import Facets
from vibrojax.plot._stacks import LEGEND_WIDTH
from vibrojax.plot._style import new_figure

MOST_ROWS = 4
_WIDTH = 3.3  # inches of a panel


@dataclass(frozen=True)
class Row:
    """The axes of one facet, one for each quantity; `bottom` where labels of the axis across go."""

    axes: tuple[Axes, ...]
    facet: xr.Dataset
    bottom: bool


def rows(panels: Facets, quantities: int) -> tuple[Figure, tuple[Row, ...]]:
    """An empty figure, with room for a legend at the right, and the axes of each facet of `panels`.

    The panels of a quantity share their axes.
    """
    count = len(panels)
    figure = new_figure(_WIDTH * quantities + LEGEND_WIDTH, (2.9 if count == 1 else 2.3) * count + 0.8)
    grid = GridSpec(count, quantities, figure)
    drawn: list[Row] = []
    for at, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        first = drawn[0].axes if drawn else (None,) * quantities
        axes = [figure.add_subplot(grid[at, i], sharex=first[i], sharey=first[i]) for i in range(quantities)]
        axes[0].set_title(title, loc="left")
        drawn.append(Row(tuple(axes), facet, at == count - 1))
    return figure, tuple(drawn)


def label_axes(row: Row, quantity: int, across: str, up: str) -> None:
    """Label the axes of one quantity of `row` where labels go, above a grid."""
    axes = row.axes[quantity]
    axes.grid(True)
    axes.tick_params(labelbottom=row.bottom)
    axes.set_xlabel(across if row.bottom else "")
    axes.set_ylabel(up)
