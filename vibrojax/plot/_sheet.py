"""The layout of maps: regimes and values, each over all facets, with one legend and one bar for each value.

What is drawn is a value, or None for the regimes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from textwrap import fill

import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec

from vibrojax.plot._facets import Facets, columns
from vibrojax.plot._style import new_figure
from vibrojax.plot._values import Value

_BESIDE = 3  # up to so many facets, the values stand beside the regimes; from there on below them
_MOST_COLUMNS = 6
_SQUARE = 4  # values of one facet, from which they stand two by two
_LEGEND_WIDTH = 1.6  # inches, where the regimes leave no place for it


@dataclass(frozen=True)
class Panel:
    """One panel: its axes, the facet drawn there, and the value; `value` is None for the regimes."""

    axes: Axes
    facet: xr.Dataset
    title: str
    value: Value | None
    left: bool
    bottom: bool


@dataclass(frozen=True)
class Sheet:
    """A figure with its panels, and one axes for the bar of each value; that of the regimes is for the legend."""

    figure: Figure
    panels: tuple[Panel, ...]
    bars: tuple[Axes, ...]
    values: tuple[Value | None, ...]
    upright: bool

    def __iter__(self) -> Iterator[Panel]:
        return iter(self.panels)

    def finish(self, handles: Sequence[Artist]) -> None:
        """Draw the legend, in the place of the regimes or at the right, and the bars of the values."""
        for bar, value in zip(self.bars, self.values, strict=True):
            if value is None:
                self._draw_legend(bar, handles)
                continue
            self.figure.colorbar(
                ScalarMappable(value.norm, value.colour_map),
                cax=bar,
                extend=value.extend,
                orientation="vertical" if self.upright else "horizontal",
                label=value.label,
            )
        if None not in self.values and handles:
            self.figure.legend(handles=handles, loc="outside right upper")

    def _draw_legend(self, axes: Axes, handles: Sequence[Artist]) -> None:
        axes.axis("off")
        where = {"loc": "center left"} if self.upright else {"loc": "upper left", "ncols": 2, "columnspacing": 1.0}
        axes.legend(handles=handles, borderaxespad=0.0, borderpad=0.0, **where)


def sheet(panels: Facets, values: tuple[Value | None, ...]) -> Sheet:
    """The empty sheet for `panels` and `values`."""
    if len(panels) == 1 and len(values) >= _SQUARE:
        return _square(panels, values)
    return _beside(panels, values) if len(panels) <= _BESIDE else _below(panels, values)


def write_margins(figure: Figure, title: str, *notes: str, legend: float = 0.0) -> None:
    """Write `title` above everything, but not over a legend that takes `legend` inches at the right; `notes` below.

    The figure grows by the lines after the first.
    """
    width = figure.get_figwidth()
    above = fill(title, int(9.5 * (width - legend)))
    below = fill(". ".join(note for note in notes if note), int(17 * width))
    if above:
        figure.suptitle(above, x=0.01, ha="left", fontweight="bold")
    if below:
        figure.supxlabel(below, x=0.01, ha="left", fontsize=8, color="0.3")
    figure.set_figheight(figure.get_figheight() + 0.18 * above.count("\n") + 0.13 * below.count("\n"))


def wrapped(title: str, width: float) -> str:
    """`title` on lines of at most `width` inches, broken after commas only."""
    kept = ", ".join(part.replace(" ", "\u00a0") for part in title.split(", "))
    return fill(kept, int(13 * width)).replace("\u00a0", " ")


def _square(panels: Facets, values: tuple[Value | None, ...]) -> Sheet:
    """The values of one facet two by two, each with its bar at its right."""
    deep = -(-len(values) // 2)
    figure = new_figure(9.2 + _LEGEND_WIDTH, 2.9 * deep + 0.8)
    grid = GridSpec(deep, 4, figure, width_ratios=[1.0, 0.04, 1.0, 0.04])
    drawn: list[Panel] = []
    for at, value in enumerate(values):
        row, column = divmod(at, 2)
        axes = _shared(figure, grid[row, 2 * column], drawn)
        drawn.append(Panel(axes, panels.data[0], panels.titles[0], value, column == 0, at + 2 >= len(values)))
    bars = [figure.add_subplot(grid[at // 2, 2 * (at % 2) + 1]) for at in range(len(values))]
    return Sheet(figure, tuple(drawn), tuple(bars), values, upright=True)


def _beside(panels: Facets, values: tuple[Value | None, ...]) -> Sheet:
    """A row for each facet; its regimes, then its values; the legend and the bars at the foot."""
    rows, wide = len(panels), len(values)
    figure = new_figure(max(3.4 * wide, 4.6) + (0.0 if None in values else _LEGEND_WIDTH), 2.7 * rows + 1.5)
    grid = GridSpec(rows + 1, wide, figure, height_ratios=[1.0] * rows + [0.05])
    drawn: list[Panel] = []
    for row, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        for column, value in enumerate(values):
            axes = _shared(figure, grid[row, column], drawn)
            name = title if column == 0 else ""
            drawn.append(Panel(axes, facet, name, value, column == 0, row == rows - 1))
    foot = [figure.add_subplot(grid[rows, column]) for column in range(wide)]
    return Sheet(figure, tuple(drawn), tuple(foot), values, upright=False)


def _below(panels: Facets, values: tuple[Value | None, ...]) -> Sheet:
    """A block of all facets for the regimes, then one for each value; the legend and the bars at the right."""
    wide = columns(panels, _MOST_COLUMNS)
    deep = -(-len(panels) // wide)
    width, height = (2.75 if wide <= 4 else 2.2), (2.35 if deep == 1 else 2.0)
    figure = new_figure(width * wide + 2.2, height * deep * len(values) + 0.9)
    grid = GridSpec(deep * len(values), wide + 1, figure, width_ratios=[1.0] * wide + [0.05])
    drawn: list[Panel] = []
    for block, value in enumerate(values):
        for at, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
            row, column = divmod(at, wide)
            axes = _shared(figure, grid[block * deep + row, column], drawn)
            lowest = block == len(values) - 1 and at + wide >= len(panels)
            name = wrapped(title, width) if deep > 1 or block == 0 else ""
            drawn.append(Panel(axes, facet, name, value, column == 0, lowest))
    right = [figure.add_subplot(grid[block * deep : (block + 1) * deep, wide]) for block in range(len(values))]
    return Sheet(figure, tuple(drawn), tuple(right), values, upright=True)


def _shared(figure: Figure, place: SubplotSpec, drawn: list[Panel]) -> Axes:
    first = drawn[0].axes if drawn else None
    return figure.add_subplot(place, sharex=first, sharey=first)
