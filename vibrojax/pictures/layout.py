"""Layout of pictures: facets, sheets above each other, and pictures in the width of a journal's column.

A facet has the lanes at one combination of values of the axes that are neither abscissa nor ordinate. A narrow picture
has fewer panels side by side, smaller type, and the legend below.
"""

import re
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, replace
from itertools import product
from math import ceil, lcm, prod
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, shown
from vibrojax.pictures.axes import broken, broken_title, index_text, number, pretty_unit, scale, short, symbol
from vibrojax.pictures.contents import START, is_numeric, lane_dims
from vibrojax.pictures.plots import Axis, Plot, Sheet, legend_of

MOST_PANELS = 12

LEGEND_WIDTH = 1.9  # the approximate width [inch] of a legend at the right


@dataclass(frozen=True)
class Facets:
    """The facets of a picture: their titles and their lanes.

    - `counts`: numbers of values of the axes, of which the last one changes from facet to facet.
    - `note`: text that lists the values shown, empty if none are left out.
    """

    titles: tuple[str, ...]
    data: tuple[xr.Dataset, ...]
    counts: tuple[int, ...] = (1,)
    note: str = ""

    def __len__(self) -> int:
        return len(self.data)

    def __iter__(self) -> Iterator[tuple[str, xr.Dataset]]:
        return zip(self.titles, self.data, strict=True)

    def places(self, most: int) -> list[tuple[int, int]]:
        """Return the row and column of each facet, in at most `most` columns.

        Rows end where the values of an axis end; as few places as possible stay empty.
        """
        count = len(self)
        runs = np.cumprod(self.counts[::-1]).tolist()  # facets after which the values of an axis repeat
        step = max((run for run in runs if run <= most), default=1)
        wide = min(range(step, most + 1, step), key=lambda n: (n < min(count, most, 3), -count % n, -n))
        if count % wide and step > 1 and count // step <= most:  # the last axis runs downwards
            return [divmod(k, step)[::-1] for k in range(count)]
        return [divmod(k, wide) for k in range(count)]


def facets(ds: xr.Dataset, along: Sequence[str], most: int = MOST_PANELS) -> Facets:
    """Split the dataset into at most `most` facets along its lane dimensions that are not in `along`."""
    sizes = {name: ds.sizes[name] for name in lane_dims(ds) if name not in along}
    counts = dict(sizes)
    while prod(counts.values()) > most:  # initial conditions are left out last
        droppable = [name for name in counts if name != START and counts[name] > 1] or list(counts)
        counts[max(droppable, key=counts.__getitem__)] -= 1
    picks = {  # from the first to the last value; the middle value if there is room for only one
        name: [size // 2] if counts[name] == 1 else np.linspace(0, size - 1, counts[name]).round().astype(int).tolist()
        for name, size in sizes.items()
    }
    indices = [dict(zip(sizes, pick, strict=True)) for pick in product(*picks.values())]
    titles = tuple(", ".join(index_text(ds, name, i) for name, i in index.items()) for index in indices)
    texts = [
        f"{_listed(ds, name, pick)} ({len(pick)} of {sizes[name]} values)"
        for name, pick in picks.items()
        if len(pick) < sizes[name]
    ]
    note = f"Too many panels to show all; here {'; '.join(texts)}" if texts else ""
    return Facets(titles, tuple(ds.isel(index) for index in indices), tuple(counts.values()) or (1,), note)


def at(facet: xr.Dataset) -> dict[str, Any]:
    """Return the values of the axes that a facet is at."""
    return {str(name): data.values.item() for name, data in facet.coords.items() if data.ndim == 0}


def _listed(ds: xr.Dataset, name: str, pick: list[int]) -> str:
    if name not in ds.coords:
        return "; ".join(index_text(ds, name, i) for i in pick)
    values, (factor, unit) = ds[name].values[pick], scale(ds[name]) if is_numeric(ds[name]) else (1.0, "")
    texts = [number(float(x) * factor) if is_numeric(ds[name]) else short(str(x)) for x in values]
    return f"{symbol(ds[name])} = {', '.join(texts)} {pretty_unit(unit)}".rstrip()


STACK_MARGINS = 0.8  # height [inch] of title, note and axis labels of a sheet, of which `stacked` keeps one


def stacked(above: Sheet, below: Sheet) -> Sheet:
    """Return a sheet with the plots of one sheet above those of another; its legend, title and note are of the latter.

    The panels of a sheet must be of equal width.
    """
    columns, plots, first = lcm(len(above.widths), len(below.widths)), [], 0
    heights: list[float] = []
    for sheet in (above, below):
        each = columns // len(sheet.widths)
        for plot in sheet.plots:
            row, column, deep, wide = plot.span
            plots.append(replace(plot, place=(first + row, column * each, deep, wide * each)))
        first += len(sheet.heights)
        heights += [(sheet.size[1] - STACK_MARGINS) * height / sum(sheet.heights) for height in sheet.heights]
    size = max(above.size[0], below.size[0]), sum(heights) + STACK_MARGINS
    return replace(below, plots=plots, size=size, widths=[1.0] * columns, heights=heights)


# Narrow pictures.

WIDTH: ContextVar[float | None] = ContextVar("WIDTH", default=None)
"""Width [inch] that the user chose for the picture; None if each picture has its own."""

_INCHES = {"mm": 1 / 25.4, "cm": 1 / 2.54, "in": 1.0}
TALLEST = 235 / 25.4  # greatest height [inch] of a picture whose width the user chose: that of a journal's page
_NARROWEST, NARROW, _WIDEST = 1.5, 4.5, 40.0  # [inch]; a narrow picture shows fewer maps
_LEAST_PANEL, _LEAST_SHARED = 1.3, 1.1  # least width [inch] of a panel with its labels, and with those of its row
_LEAST_BESIDE = 2.0  # least width [inch] of a panel beside several rows
_MARGINS = 1.4  # approximate height [inch] of title, legend and note of a narrow sheet
_BAR, _TITLE = 0.3, 0.2  # height [inch] of a colour bar, and of a title
_SMALLER = 0.83  # type of a narrow picture, in units of that of others
_STACKED_MAP = 0.65  # height of maps below each other, in units of their width
_KEYS_PANEL = 3.6  # width [inch] from which a panel keeps a legend of its own
_MOST_ACROSS = 6
LETTERS = 14.5  # characters of small type along an inch
_MOST_SQUARE = 3.5  # greatest height [inch] of a square panel
_MAP_ASPECT = 1.2  # height of a narrow map above its label and colour bar, in units of its width with labels
_LEAST_SHARE, _LOW = 0.75, 0.7  # by which a panel gets lower at most, and height [inch] below which it stays


def read_width(width: str | float | int | None) -> float | None:
    """Return a width in inches, given as text like "85mm" or as a number of millimetres; else raise `InputError`."""
    if width is None:
        return None
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|in)?\s*", str(width))
    inches = float(match[1]) * _INCHES[match[2] or "mm"] if match else 0.0
    if not _NARROWEST <= inches <= _WIDEST:
        raise InputError(f"width: {shown(width)} is not the width of a picture; give one like 85mm or 170mm")
    return inches


def is_narrow(most: float = NARROW) -> bool:
    """Return whether the user chose a picture that is at most as wide as `most` [inch], by default a narrow one."""
    return (WIDTH.get() or np.inf) <= most


def in_width(sheet: Sheet, width: float) -> Sheet:
    """Return a sheet in a width [inch]; if it has to be narrower, its legend is below.

    Rows of panels that would be too narrow are broken into several rows.
    """
    if width >= sheet.size[0]:
        return replace(sheet, size=(width, sheet.size[1]))
    tall = sheet.size[1] / sum(sheet.heights)
    wide = (sheet.size[0] - LEGEND_WIDTH * bool(legend_of(sheet))) / sum(sheet.widths)
    least = width / sum(sheet.widths) * min(sheet.widths)
    if any(plot.span[2] > 1 for plot in sheet.plots) and least >= _LEAST_BESIDE:
        wide = width / sum(sheet.widths)
        squares = [wide * _part(sheet.widths, x, 1) for x in sheet.plots if x.square and x.span[2] > 1]
        height = min(_LEAST_SHARE * sheet.size[1], _MARGINS + min(squares, default=np.inf))
        tall = (height - _MARGINS) / sum(sheet.heights)
        plots = [_narrowed(x, wide * _part(sheet.widths, x, 1), tall * _part(sheet.heights, x, 0)) for x in sheet.plots]
        return replace(sheet, plots=plots, size=(width, height), beside=False)
    rows: dict[tuple[bool, int], list[Plot]] = {}
    for plot in sorted(sheet.plots, key=lambda plot: (plot.span[2] > 1, plot.place)):  # tall panels come last
        rows.setdefault((plot.span[2] > 1, plot.place[0]), []).append(plot)
    parts: list[tuple[list[Plot], float, float]] = []  # rows with the width and the height of their panels
    for row in rows.values():
        is_map = any(plot.is_map for plot in row)
        shared = {plot.y.group for plot in row} == {row[0].y.group} != {""} and not is_map
        # Maps of one axis have equal widths, also in a row that is not full.
        alike = [len(other) for other in rows.values() if other[0].x.group == row[0].x.group != ""]
        alike = alike if len(alike) > 1 and is_map else []
        count, most = max(alike, default=len(row)), int(width / (_LEAST_SHARED if shared else _LEAST_PANEL))
        across = -(-count // ceil(count / min(count, max(1, most), _MOST_ACROSS)))  # rows of equal length
        labels = [plot.x.label for plot in row if plot.x.label]
        if count % across and (is_map or len({*labels}) < len(labels)):  # panels of one axis have equal widths
            across = 1
        first, column, deep, spanned = row[0].span
        height = tall * sum(sheet.heights[first : first + deep])
        if height >= _LOW:
            share = width / across / (wide * sum(sheet.widths[column : column + spanned]))
            height *= min(1.0, max(share, _LEAST_SHARE))
        height = min(height, width / across, _MOST_SQUARE) if row[0].square else height
        height = min(height, _STACKED_MAP * width) if is_map and across < count else height
        for part in (row[k : k + across] for k in range(0, len(row), across)):
            parts.append((part, width / (across if alike else len(part)), height))  # no gap beside the last panel
    columns = lcm(*(round(width / each) for _, each, _ in parts))
    lower = min(1.0, (TALLEST - _MARGINS) / sum(height for *_, height in parts))
    parts = [(part, each, lower * height) for part, each, height in parts]
    plots = []
    for k, (part, each, height) in enumerate(parts):
        span = round(columns * each / width)
        inside = height - _TITLE * any(plot.title for plot in part)
        beside = 0.2 if len({plot.y.group for plot in part} - {""}) == 1 else 0.4  # room that a panel has for itself
        for i, plot in enumerate(part):
            plots.append(_narrowed(replace(plot, place=(k, i * span, 1, span)), each, inside, beside))
    heights = [height for *_, height in parts]
    size = width, sum(heights) + 0.12 * len(parts)
    return replace(sheet, plots=plots, size=size, widths=[1.0] * columns, heights=heights, beside=False)


def _part(sizes: Sequence[float], plot: Plot, which: int) -> float:
    """Return the heights (`which` is 0) or widths of a sheet that a plot spans."""
    first, count = plot.span[which], plot.span[which + 2]
    return sum(sizes[first : first + count])


def in_height(sheet: Sheet) -> Sheet:
    """Return a sheet that is not higher than a page, with shorter labels if it has to be lower."""
    if sheet.size[1] <= TALLEST:
        return sheet
    tall = (TALLEST - _MARGINS) / sum(sheet.heights)
    rows = {plot.place[0] for plot in sheet.plots if plot.title}
    room = [tall * _part(sheet.heights, x, 0) - _BAR * x.is_map - _TITLE * (x.place[0] in rows) for x in sheet.plots]
    plots = [replace(x, y=_shortened(x.y, _SMALLER * high)) for x, high in zip(sheet.plots, room, strict=True)]
    return replace(sheet, plots=plots, size=(sheet.size[0], TALLEST))


def _shortened(axis: Axis, length: float, across: bool = False) -> Axis:
    """Return an axis whose label is broken, and whose ticks are fewer, in a length [inch]."""
    letters, label = int(LETTERS * length), axis.label
    if max(map(len, label.splitlines()), default=0) > letters:
        label = broken(label, letters)
    if label.count("\n") > 1:  # without the words before the symbol
        label = broken(" ".join(axis.label.split()).rpartition(", ")[2], letters)
    few = 3 if length < 1.4 else 4
    intervals = min(axis.intervals or few, few) if length < 2.2 else axis.intervals
    texts = [text for _, text in axis.ticks or ()]
    crowded = sum(len(text) + 2 for text in texts) > 1.2 * LETTERS * length and max(map(len, texts)) > 4
    return replace(axis, label=label, intervals=intervals, rotated=across and crowded)


def _narrowed(plot: Plot, width: float, height: float, beside: float = 0.4) -> Plot:
    """Return a panel whose texts are broken, and whose ticks are fewer, in a width and height [inch]."""
    # A legend of the plot's own would be as wide as the plot.
    keys = "" if width < _KEYS_PANEL else plot.keys
    beside = 0.2 if plot.is_map or plot.square else beside  # a title is centred above a map, else it begins at the axis
    title = broken_title(plot.title, max(int(LETTERS * (width - beside)), 10))
    inside = (min(height, _MAP_ASPECT * width) if plot.has_cells else height) - _BAR * (plot.scale is not None)
    return replace(plot, title=title, x=_shortened(plot.x, width - 0.3, True), y=_shortened(plot.y, inside), keys=keys)
