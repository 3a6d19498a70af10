"""Pictures in the width of a journal's column: fewer panels side by side, smaller type, and the legend below."""

import re
from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import replace
from math import ceil, lcm

from vibrojax.errors import InputError, shown
from vibrojax.pictures.axes import broken, broken_title
from vibrojax.pictures.plots import Axis, Plot, Sheet, legend_of

WIDTH: ContextVar[float | None] = ContextVar("WIDTH", default=None)
"""Width [inch] that the user chose for the picture; None if each picture has its own."""

SMALL: Mapping[str, float] = {
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
}
"""Sizes of type [pt] where panels are made narrower."""

_INCHES = {"mm": 1 / 25.4, "cm": 1 / 2.54, "in": 1.0}
_NARROWEST, _WIDEST = 1.5, 40.0  # [inch]
_LEAST_PANEL, _LEAST_SHARED = 1.25, 1.1  # least width [inch] of a panel with its labels, and with those of its row
_KEYS_PANEL = 3.6  # width [inch] from which a panel keeps a legend of its own
_MOST_ACROSS = 6
_LETTERS = 14.5  # of small type along an inch
_MOST_SQUARE = 3.5  # greatest height [inch] of a square panel
_MAP_ASPECT = 1.2  # height of a narrow map above its label and colour bar, in units of its width with labels
_LEAST_SHARE, _LOW = 0.75, 0.7  # by which a panel gets lower at most, and height [inch] below which it stays


def read_width(width: str | float | int | None) -> float | None:
    """Return a width in inches, given as text like "85mm" or as a number of millimetres.

    **Raises:** `InputError` if it is neither.
    """
    if width is None:
        return None
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|in)?\s*", str(width))
    inches = float(match[1]) * _INCHES[match[2] or "mm"] if match else 0.0
    if not _NARROWEST <= inches <= _WIDEST:
        raise InputError(f"width: {shown(width)} is not the width of a picture; give one like 85mm or 170mm")
    return inches


def in_width(sheet: Sheet, width: float) -> Sheet:
    """Return a sheet in a width [inch]; if it has to be narrower, its legend is below.

    Rows of panels that would be too narrow are broken into several rows.
    """
    if width >= sheet.size[0]:
        return replace(sheet, size=(width, sheet.size[1]))
    above = in_width(replace(sheet.above, size=(sheet.size[0], sheet.above.size[1])), width) if sheet.above else None
    inside = sheet.size[1] - (sheet.above.size[1] if sheet.above else 0.0)
    inch = inside / sum(sheet.heights), (sheet.size[0] - 1.9 * bool(legend_of(sheet))) / sum(sheet.widths)
    starts: dict[tuple[bool, int], list[Plot]] = {}
    for plot in sorted(sheet.plots, key=lambda plot: (plot.span[2] > 1, plot.place)):  # tall panels come last
        starts.setdefault((plot.span[2] > 1, plot.place[0]), []).append(plot)
    rows: list[tuple[list[Plot], float, float]] = []  # with the width and height of the panels
    for row in starts.values():
        least = _LEAST_SHARED if row[0].y.group else _LEAST_PANEL
        # Maps of one axis have equal widths, also in a row that is not full.
        longest = max(len(other) for other in starts.values() if other[0].x.group == row[0].x.group)
        count = longest if row[0].x.group else len(row)
        most = min(count, max(1, int(width / least)), _MOST_ACROSS)
        across = -(-count // ceil(count / most))  # rows of equal lengths
        first, column, deep, spanned = row[0].span
        height = inch[0] * sum(sheet.heights[first : first + deep])
        if height >= _LOW:
            share = width / across / (inch[1] * sum(sheet.widths[column : column + spanned]))
            height *= min(1.0, max(share, _LEAST_SHARE))
        height = min(height, width / across, _MOST_SQUARE) if row[0].square else height
        for part in (row[k : k + across] for k in range(0, len(row), across)):
            rows.append((part, width / (across if row[0].x.group else len(part)), height))  # no gap beside the last one
    columns = lcm(*(round(width / wide) for _, wide, _ in rows))
    scales = {
        id(plot.scale): plot.scale and replace(plot.scale, label=broken(plot.scale.label, int(_LETTERS * (wide - 0.1))))
        for row, wide, _ in rows
        for plot in row
    }
    plots = []
    for k, (row, wide, height) in enumerate(rows):
        span = round(columns * wide / width)
        for i, plot in enumerate(row):
            placed = replace(plot, place=(k, i * span, 1, span), scale=scales[id(plot.scale)])
            plots.append(_narrowed(placed, wide, height))
    heights = [height for *_, height in rows]
    size = width, sum(heights) + (above.size[1] if above else 0.0) + 0.12 * len(rows)
    return replace(sheet, plots=plots, size=size, widths=[1.0] * columns, heights=heights, above=above, beside=False)


def _narrowed(plot: Plot, width: float, height: float) -> Plot:
    """Return a panel whose texts are broken, and whose ticks are fewer, in a width and height [inch]."""

    def axis(of: Axis, length: float) -> Axis:
        few = 3 if length < 1.0 else 4
        intervals = min(of.intervals or few, few) if length < 2.2 else of.intervals
        texts = [text for _, text in of.ticks or ()]
        crowded = sum(len(text) + 2 for text in texts) > 1.2 * _LETTERS * length and max(map(len, texts)) > 4
        rotated = of.rotated or (of is plot.x and crowded)
        return replace(of, label=_axis_label(of.label, int(_LETTERS * length)), intervals=intervals, rotated=rotated)

    # A legend of the plot's own would be as wide as the plot.
    keys = "" if width < _KEYS_PANEL else plot.keys
    title = broken_title(plot.title, max(int(_LETTERS * (width - 0.2)), 10))
    inside = min(height, _MAP_ASPECT * width) if plot.has_cells else height
    return replace(plot, title=title, x=axis(plot.x, width - 0.3), y=axis(plot.y, inside), keys=keys)


def _axis_label(label: str, letters: int) -> str:
    """Return a label in at most two lines of `letters` characters, if need be without the words before its symbol."""
    lines = broken(label, letters)
    return lines if lines.count("\n") < 2 else broken(label.rpartition(", ")[2], letters)
