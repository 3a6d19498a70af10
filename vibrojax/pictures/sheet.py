"""Layout of pictures: panels for each drawn quantity and each facet, with title, notes and legend around them.

A facet shows the lanes at one combination of values of the axes that are neither abscissa nor ordinate. In a list of
quantities, None stands for the regimes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import XAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.gridspec import GridSpec, GridSpecFromSubplotSpec, SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from vibrojax.pictures.axes import index_text, number, point_text, pretty_unit, scale, short, symbol
from vibrojax.pictures.colours import Value, Values, name_flags
from vibrojax.pictures.contents import START, is_numeric, lane_dims
from vibrojax.pictures.style import TITLE_SIZE, new_figure

MOST_PANELS = 12
_MOST_BESIDE = 3  # for up to this many facets, quantities are to the right of the regimes, else below
_MOST_COLUMNS = 6
_SQUARE_FROM = 4  # number of quantities from which a single facet has two columns
_LEGEND_ROWS, _LEGEND_ROW = 4, 0.17  # rows of a legend below the panels for which there is room; height [inch] of one
_BAR_TICKS = 6  # greatest number of intervals between the ticks of a horizontal colour bar
_DASHED_LENGTH = 2.8  # length of a dashed line in the legend, in units of the font size: two dashes or more
_LEGEND_ROOM = 1.6  # inches at the right for the legend, if no panel of regimes leaves a place for it


@dataclass(frozen=True)
class Facets:
    """The facets of a picture: their titles and their lanes.

    - `runs`: numbers of facets after which the values of an axis repeat, from the last axis to the first.
    - `note`: text that lists the values shown, empty if none are left out.
    """

    titles: tuple[str, ...]
    data: tuple[xr.Dataset, ...]
    runs: tuple[int, ...] = (1,)
    note: str = ""

    def __len__(self) -> int:
        return len(self.data)


def facets(ds: xr.Dataset, along: Sequence[str], most: int = MOST_PANELS) -> Facets:
    """Split the dataset into at most `most` facets along its lane dimensions that are not in `along`."""
    axes = [name for name in lane_dims(ds) if name not in along]
    sizes = {name: ds.sizes[name] for name in axes}
    counts = dict(sizes)
    while np.prod(list(counts.values()), initial=1) > most:  # initial conditions are left out last
        droppable = [name for name in counts if name != START and counts[name] > 1] or list(counts)
        counts[max(droppable, key=counts.__getitem__)] -= 1
    picks = {  # from the first to the last value; the middle value if there is room for only one
        name: [size // 2] if counts[name] == 1 else np.linspace(0, size - 1, counts[name]).round().astype(int).tolist()
        for name, size in sizes.items()
    }
    indices = [dict(zip(axes, pick, strict=True)) for pick in product(*picks.values())]
    titles = tuple(", ".join(index_text(ds, name, i) for name, i in index.items()) for index in indices)
    runs = tuple(int(run) for run in np.cumprod([counts[name] for name in reversed(axes)]))
    parts = [
        f"{_listed(ds, name, pick)} ({len(pick)} of {sizes[name]} values)"
        for name, pick in picks.items()
        if len(pick) < sizes[name]
    ]
    note = f"Too many panels to show all; here {'; '.join(parts)}" if parts else ""
    return Facets(titles, tuple(ds.isel(index) for index in indices), runs, note)


def _listed(ds: xr.Dataset, name: str, pick: list[int]) -> str:
    if name not in ds.coords:
        return "; ".join(index_text(ds, name, i) for i in pick)
    values, (factor, unit) = ds[name].values[pick], scale(ds[name]) if is_numeric(ds[name]) else (1.0, "")
    texts = [number(float(x) * factor) if is_numeric(ds[name]) else short(str(x)) for x in values]
    return f"{symbol(ds[name])} = {', '.join(texts)} {pretty_unit(unit)}".rstrip()


def columns(panels: Facets, most: int) -> int:
    """Return the number of columns, at most `most`, so that rows end where an axis ends and few places stay empty."""
    count = len(panels)
    if count <= most:
        return count
    step = max([run for run in panels.runs if run <= most], default=1)
    choices = [n for n in range(most, 1, -1) if n % step == 0]
    return min(choices, key=lambda n: (n < 3, -count % n, -n), default=most)


class Panel(NamedTuple):
    """One panel: its axes, its facet, and the quantity `value` that it shows (None: the regimes).

    `first`: the panel is in the first column and has y labels; `bottom`: it is the last of its column and has x labels.
    """

    axes: Axes
    facet: xr.Dataset
    title: str
    value: Value | None
    first: bool
    bottom: bool


@dataclass(frozen=True)
class Sheet:
    """A figure with its panels, and one axes per quantity for the colour bar; that of the regimes holds the legend.

    `upright`: colour bars are vertical; `above`: free strip above the panels, or None.
    """

    figure: Figure
    panels: Sequence[Panel]
    bars: Sequence[Axes]
    values: Values
    upright: bool
    above: SubplotSpec | None

    def finish(self, handles: Sequence[Artist]) -> None:
        """Draw the colour bars and the legend.

        The regimes have the legend in place of a colour bar; without regimes, the legend is at the right of the figure.
        """
        look: dict[str, Any] = {"loc": "upper left", "ncols": 1}
        if self.upright:
            look = {"loc": "center left"}
        for bar, value in zip(self.bars, self.values, strict=True):
            if value is None:
                bar.axis("off")
                rows = -(-len(handles) // look.get("ncols", 1))
                if not self.upright and rows > _LEGEND_ROWS:
                    self.figure.set_figheight(self.figure.get_figheight() + _LEGEND_ROW * (rows - _LEGEND_ROWS))
                bar.legend(handles=handles, borderaxespad=0.0, borderpad=0.0, **look)
                handles = ()  # only the first of several such places has the legend
            else:
                draw_bar(self.figure, value, cax=bar, orientation="vertical" if self.upright else "horizontal")
        if None not in self.values:
            legend_at_right(self.figure, handles)


def draw_bar(figure: Figure, value: Value, **place: Any) -> None:
    """Draw the colour bar of a quantity; `place`: keyword arguments of `Figure.colorbar`."""
    mappable = ScalarMappable(value.norm, value.colour_map)
    bar = figure.colorbar(mappable, extend=value.extend, label=value.label, **place)
    if isinstance(bar.long_axis, XAxis) and bar.long_axis.get_scale() == "linear" and not value.names:
        bar.set_ticks(MaxNLocator(_BAR_TICKS, steps=[1, 2, 5, 10]))  # more would touch each other
    if not value.has_values:
        bar.set_ticks([])
    name_flags(bar.long_axis, value)


def sheet(panels: Facets, values: Values, above: float = 0.0) -> Sheet:
    """Return an empty sheet for `panels` and `values`, with a free strip of `above` inches at the top.

    Four or more quantities of a single facet are arranged in two columns, each with colour bars at its right. Up to
    three facets have one row each, with legend and colour bars at the bottom. With more facets, the panels of each
    quantity are arranged in a block, with legend and colour bars at the right.
    """
    rows, wide = len(panels), len(values)
    square = rows == 1 and wide >= _SQUARE_FROM
    if square:
        deep = -(-wide // 2)
        grid = new_grid(9.2 + _LEGEND_ROOM, 2.9 * deep + 0.8, above, [1.0] * deep, [1.0, 0.04, 1.0, 0.04])
        cells = [((i // 2, 2 * (i % 2)), 0, i, i % 2 == 0, i + 2 >= wide, panels.titles[0]) for i in range(wide)]
        bars = [grid.panels[i // 2, 2 * (i % 2) + 1] for i in range(wide)]
    elif rows <= _MOST_BESIDE:
        width = max(3.4 * wide, 4.6) + (0.0 if None in values else _LEGEND_ROOM)
        grid = new_grid(width, 2.7 * rows + 1.5, above, [1.0] * rows + [0.05], [1.0] * wide)
        cells = [
            ((row, i), row, i, i == 0, row == rows - 1, panels.titles[row] if i == 0 else "")
            for row, i in product(range(rows), range(wide))
        ]
        bars = [grid.panels[rows, i] for i in range(wide)]
    else:
        across = columns(panels, _MOST_COLUMNS)
        deep = -(-rows // across)
        width, height = (2.75 if across <= 4 else 2.2), (2.35 if deep == 1 else 2.0)
        size = width * across + 2.2, height * deep * wide + 0.9
        grid = new_grid(*size, above, [1.0] * deep * wide, [1.0] * across + [0.05])
        cells = []
        for block, k in product(range(wide), range(rows)):
            row, column = divmod(k, across)
            unbroken = ", ".join(part.replace(" ", "\u00a0") for part in panels.titles[k].split(", "))
            title = fill(unbroken, int(13 * width)).replace("\u00a0", " ") if deep > 1 or block == 0 else ""
            last = block == wide - 1 and k + across >= rows
            cells.append(((block * deep + row, column), k, block, column == 0, last, title))
        bars = [grid.panels[block * deep : (block + 1) * deep, across] for block in range(wide)]
    drawn: list[Panel] = []
    for place, k, i, first, bottom, title in cells:
        shared = drawn[0].axes if drawn else None
        axes = grid.figure.add_subplot(grid.panels[place], sharex=shared, sharey=shared)
        drawn.append(Panel(axes, panels.data[k], title, values[i], first, bottom))
    upright = square or rows > _MOST_BESIDE
    return Sheet(grid.figure, drawn, [grid.figure.add_subplot(bar) for bar in bars], values, upright, grid.above)


class Grid(NamedTuple):
    """A figure with places for `panels`, and a free strip `above` them, or None."""

    figure: Figure
    above: SubplotSpec | None
    panels: GridSpecFromSubplotSpec


def new_grid(width: float, height: float, above: float, heights: list[float], widths: list[float]) -> Grid:
    """Return a new figure with a free strip of `above` inches, and below it a grid with ratios `heights`, `widths`."""
    figure = new_figure(width, height + above)
    strips = GridSpec(2, 1, figure, height_ratios=[above, height]) if above > 0 else GridSpec(1, 1, figure)
    ratios = {"height_ratios": heights, "width_ratios": widths}
    panels = strips[-1].subgridspec(len(heights), len(widths), **ratios)
    return Grid(figure, strips[0] if above > 0 else None, panels)


PAGE = (16.0, 20.0)
"""Greatest width and height [inch] of a sweep's picture, margins included."""

LEGEND_WIDTH = 1.9
"""The approximate width [inch] of a legend at the right."""

_NOTE_SIZE = 8.0
# Small text is wider by some per cent at other resolutions, and with the hinting of a notebook.
_NOTE_SHARE = 0.955
_TITLE_LINES, _NOTE_LINES = 3, 6  # at most
_LINE_HEIGHT = 1.6  # line spacing in units of the font size
_BESIDE_LEGEND = 0.15  # inches left free


def write_margins(figure: Figure, ds: xr.Dataset, *notes: str, point: str | None = None) -> None:
    """Write the dataset's title at the top, to the left of any legend, and the notes at the bottom.

    The notes begin with `point`, by default the values common to all lanes. Each line after the first line of title or
    notes makes the figure higher.
    """
    renderer = FigureCanvasAgg(figure).get_renderer()
    width = 0.98 * figure.get_figwidth()
    legends = [legend.get_window_extent(renderer).width / figure.dpi + _BESIDE_LEGEND for legend in figure.legends]

    def wrap(text: str, font: FontProperties, width: float, most: int) -> list[str]:
        """Wrap the text to at most `most` lines of `width` [inch]; an ellipsis marks omitted text."""

        def fits(text: str) -> bool:
            return bool(float(renderer.get_text_width_height_descent(text, font, False)[0]) / figure.dpi <= width)

        def cut(text: str) -> str:
            if fits(text):
                return text
            while text and not fits(f"{text}…"):
                text = text[:-1].rstrip(" …")
            return f"{text}…"

        lines: list[str] = []
        for word in text.split():
            longer = f"{lines[-1]} {word}" if lines else word
            if lines and fits(longer):
                lines[-1] = longer
            else:
                lines.append(cut(word))
            if len(lines) > most:
                return [*lines[: most - 1], cut(f"{lines[most - 1]} …")]
        return lines

    title = str(ds.attrs.get("title") or ds.attrs.get("scene", ""))
    note = ". ".join(filter(None, (point_text(ds) if point is None else point, *notes)))
    bold = FontProperties(size=TITLE_SIZE, weight="bold")
    above = wrap(title, bold, width - max(legends, default=0.0), _TITLE_LINES)
    below = wrap(note, FontProperties(size=_NOTE_SIZE), _NOTE_SHARE * width, _NOTE_LINES)
    if above:
        figure.suptitle("\n".join(above), x=0.01, ha="left", fontproperties=bold)
    if below:
        figure.supxlabel("\n".join(below), x=0.01, ha="left", fontsize=_NOTE_SIZE, color="0.3")
    more = TITLE_SIZE * max(len(above) - 1, 0) + _NOTE_SIZE * max(len(below) - 1, 0)
    figure.set_figheight(figure.get_figheight() + _LINE_HEIGHT * more / 72.0)


def legend_at_right(figure: Figure, *groups: Sequence[Artist]) -> None:
    """Draw one legend at the right of all axes, with a gap between `groups` of legend entries."""
    gap: Artist = Line2D([], [], linestyle="none", label=" ")
    handles: list[Artist] = []
    for group in groups:
        handles += ([gap] if handles and group else []) + list(group)
    if handles:
        dashed = any(isinstance(handle, Line2D) and handle.is_dashed() for handle in handles)
        figure.legend(
            handles=handles, loc="outside right upper", **({"handlelength": _DASHED_LENGTH} if dashed else {})
        )
