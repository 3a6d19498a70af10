"""The layout of maps: a panel for each value of the axes that are not drawn along, for the regimes and each quantity.

What is drawn on a panel is a quantity, or None for the regimes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from textwrap import fill

import numpy as np
import xarray as xr
from jaxtyping import Int
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from vibrojax.plot.axes import index_text, number, pretty_unit, scale, short, symbol
from vibrojax.plot.colours import Value, name_flags
from vibrojax.plot.contents import START, is_numeric, lane_dims
from vibrojax.plot.style import divided, new_figure

MOST = 12
_BESIDE = 3  # up to so many facets, the values stand beside the regimes; from there on below them
_MOST_COLUMNS = 6
_SQUARE = 4  # values of one facet, from which they stand two by two
_ROOM_AT_RIGHT = 1.6  # inches for the legend, where the regimes leave no place for it

Indices = Int[np.ndarray, " values"]


@dataclass(frozen=True)
class Facets:
    """The panels of a picture.

    `titles` and `data` belong together; `runs` are the numbers of panels after which an axis begins anew, from the
    last axis; `note` says what was left out, and is empty where nothing was.
    """

    titles: tuple[str, ...]
    data: tuple[xr.Dataset, ...]
    runs: tuple[int, ...]
    note: str

    def __len__(self) -> int:
        return len(self.data)


def facets(ds: xr.Dataset, along: Sequence[str], most: int = MOST) -> Facets:
    """`ds` cut into panels over the dimensions of its lanes that are not in `along`; at most `most`."""
    axes = [name for name in lane_dims(ds) if name not in along]
    sizes = {name: ds.sizes[name] for name in axes}
    counts = _representative(sizes, most)
    picks = {name: _spread(sizes[name], counts[name]) for name in axes}
    indices = [dict(zip(axes, (int(i) for i in pick), strict=True)) for pick in product(*picks.values())]
    titles = tuple(", ".join(index_text(ds, name, i) for name, i in at.items()) for at in indices)
    runs = tuple(int(run) for run in np.cumprod([counts[name] for name in reversed(axes)]))
    return Facets(titles, tuple(ds.isel(at) for at in indices), runs, _note(ds, sizes, picks))


def columns(panels: Facets, most: int) -> int:
    """How many panels stand side by side, at most `most`: such that rows end where an axis does, with few gaps."""
    count = len(panels)
    if count <= most:
        return count
    step = max([run for run in panels.runs if run <= most], default=1)
    choices = [n for n in range(most, 1, -1) if n % step == 0]
    return min(choices, key=lambda n: (n < 3, -count % n, -n), default=most)


def _representative(sizes: dict[str, int], most: int) -> dict[str, int]:
    """How many values of each axis to show, at most `most` together; starts are dropped last."""
    counts = dict(sizes)
    while np.prod(list(counts.values()), initial=1) > most:
        droppable = [name for name in counts if name != START and counts[name] > 1] or list(counts)
        longest = max(droppable, key=counts.__getitem__)
        counts[longest] -= 1
    return counts


def _spread(size: int, count: int) -> Indices:
    """`count` of `size` indices, from the first to the last; the middle one where it is one."""
    return np.array([size // 2]) if count == 1 else np.linspace(0, size - 1, count).round().astype(int)


def _note(ds: xr.Dataset, sizes: dict[str, int], picks: dict[str, Indices]) -> str:
    parts = [
        f"{_listed(ds, name, pick)} ({pick.size} of {sizes[name]} values)"
        for name, pick in picks.items()
        if pick.size < sizes[name]
    ]
    return f"Too many panels to show all; here {'; '.join(parts)}" if parts else ""


def _listed(ds: xr.Dataset, name: str, pick: Indices) -> str:
    if name not in ds.coords:
        return "; ".join(index_text(ds, name, i) for i in pick.tolist())
    values = ds[name].values[pick]
    if not is_numeric(ds[name]):
        return f"{symbol(ds[name])} = {', '.join(short(str(value)) for value in values)}"
    factor, unit = scale(ds[name])
    return f"{symbol(ds[name])} = {', '.join(number(float(x) * factor) for x in values)} {pretty_unit(unit)}".rstrip()


@dataclass(frozen=True)
class Panel:
    """One panel: its axes on the figure, the facet drawn there, and the value; `value` is None for the regimes."""

    figure: Figure
    axes: Axes
    facet: xr.Dataset
    title: str
    value: Value | None
    left: bool
    bottom: bool


@dataclass(frozen=True)
class Sheet:
    """A figure with its panels, and one axes for the bar of each value; that of the regimes is for the legend.

    `above` the panels there may be a place for others.
    """

    figure: Figure
    panels: tuple[Panel, ...]
    bars: tuple[Axes, ...]
    values: tuple[Value | None, ...]
    upright: bool
    above: SubplotSpec | None = None

    def __iter__(self) -> Iterator[Panel]:
        return iter(self.panels)

    def finish(self, handles: Sequence[Artist]) -> None:
        """Draw the legend, in the place of the regimes or at the right, and the bars of the values."""
        for bar, value in zip(self.bars, self.values, strict=True):
            if value is None:
                self._draw_legend(bar, handles)
                handles = ()  # of several such places the first
                continue
            drawn = self.figure.colorbar(
                ScalarMappable(value.norm, value.colour_map),
                cax=bar,
                extend=value.extend,
                orientation="vertical" if self.upright else "horizontal",
                label=value.label,
            )
            name_flags(drawn.long_axis, value)
        if None not in self.values and handles:
            self.figure.legend(handles=handles, loc="outside right upper")

    def _draw_legend(self, axes: Axes, handles: Sequence[Artist]) -> None:
        axes.axis("off")
        if self.upright:
            axes.legend(handles=handles, borderaxespad=0.0, borderpad=0.0, loc="center left")
        else:
            axes.legend(handles=handles, borderaxespad=0.0, borderpad=0.0, loc="upper left", ncols=2, columnspacing=1.0)


def sheet(panels: Facets, values: tuple[Value | None, ...], above: float = 0.0) -> Sheet:
    """The empty sheet for `panels` and `values`, with a place of so many inches `above` them."""
    if len(panels) == 1 and len(values) >= _SQUARE:
        return _square(panels, values, above)
    return (_beside if len(panels) <= _BESIDE else _below)(panels, values, above)


def _wrapped(title: str, width: float) -> str:
    """`title` on lines of at most `width` inches, broken after commas only."""
    unbroken = ", ".join(part.replace(" ", "\u00a0") for part in title.split(", "))
    return fill(unbroken, int(13 * width)).replace("\u00a0", " ")


def _square(panels: Facets, values: tuple[Value | None, ...], above: float) -> Sheet:
    """The values of one facet two by two, each with its bar at its right."""
    deep = -(-len(values) // 2)
    figure = new_figure(9.2 + _ROOM_AT_RIGHT, 2.9 * deep + 0.8 + above)
    over, place = divided(figure, above)
    grid = place.subgridspec(deep, 4, width_ratios=[1.0, 0.04, 1.0, 0.04])
    drawn: list[Panel] = []
    for at, value in enumerate(values):
        row, column = divmod(at, 2)
        axes = _shared(figure, grid[row, 2 * column], drawn)
        drawn.append(Panel(figure, axes, panels.data[0], panels.titles[0], value, column == 0, at + 2 >= len(values)))
    bars = [figure.add_subplot(grid[at // 2, 2 * (at % 2) + 1]) for at in range(len(values))]
    return Sheet(figure, tuple(drawn), tuple(bars), values, True, over)


def _beside(panels: Facets, values: tuple[Value | None, ...], above: float) -> Sheet:
    """A row for each facet; its regimes, then its values; the legend and the bars at the foot."""
    rows, wide = len(panels), len(values)
    figure = new_figure(max(3.4 * wide, 4.6) + (0.0 if None in values else _ROOM_AT_RIGHT), 2.7 * rows + 1.5 + above)
    over, place = divided(figure, above)
    grid = place.subgridspec(rows + 1, wide, height_ratios=[1.0] * rows + [0.05])
    drawn: list[Panel] = []
    for row, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        for column, value in enumerate(values):
            axes = _shared(figure, grid[row, column], drawn)
            name = title if column == 0 else ""
            drawn.append(Panel(figure, axes, facet, name, value, column == 0, row == rows - 1))
    foot = [figure.add_subplot(grid[rows, column]) for column in range(wide)]
    return Sheet(figure, tuple(drawn), tuple(foot), values, False, over)


def _below(panels: Facets, values: tuple[Value | None, ...], above: float) -> Sheet:
    """A block of all facets for the regimes, then one for each value; the legend and the bars at the right."""
    wide = columns(panels, _MOST_COLUMNS)
    deep = -(-len(panels) // wide)
    width, height = (2.75 if wide <= 4 else 2.2), (2.35 if deep == 1 else 2.0)
    figure = new_figure(width * wide + 2.2, height * deep * len(values) + 0.9 + above)
    over, place = divided(figure, above)
    grid = place.subgridspec(deep * len(values), wide + 1, width_ratios=[1.0] * wide + [0.05])
    drawn: list[Panel] = []
    for block, value in enumerate(values):
        for at, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
            row, column = divmod(at, wide)
            axes = _shared(figure, grid[block * deep + row, column], drawn)
            lowest = block == len(values) - 1 and at + wide >= len(panels)
            name = _wrapped(title, width) if deep > 1 or block == 0 else ""
            drawn.append(Panel(figure, axes, facet, name, value, column == 0, lowest))
    right = [figure.add_subplot(grid[block * deep : (block + 1) * deep, wide]) for block in range(len(values))]
    return Sheet(figure, tuple(drawn), tuple(right), values, True, over)


def _shared(figure: Figure, place: SubplotSpec, drawn: list[Panel]) -> Axes:
    first = drawn[0].axes if drawn else None
    return figure.add_subplot(place, sharex=first, sharey=first)
