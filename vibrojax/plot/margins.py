"""Title, notes and legend around the panels of a figure."""

from collections.abc import Sequence

import xarray as xr
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D

from vibrojax.plot.axes import point_text
from vibrojax.plot.style import TITLE_SIZE

PAGE = (16.0, 20.0)
"""Greatest width and height [inch] of a sweep's picture, margins included."""

LEGEND_WIDTH = 1.9
"""The approximate width [inch] of a legend at the right."""

_NOTE_SIZE = 8.0
_TITLE_LINES, _NOTE_LINES = 3, 6  # at most
_LINE_HEIGHT = 1.6  # line spacing in units of the font size
_BESIDE_LEGEND = 0.15  # inches left free


def write_margins(figure: Figure, ds: xr.Dataset, *notes: str, point: str | None = None) -> None:
    """Write the dataset's title at the top, to the left of any legend, and the notes at the bottom.

    The notes begin with `point`, by default the values common to all lanes. Each line after the first line of title or
    notes makes the figure higher.
    """
    title = str(ds.attrs.get("title") or ds.attrs.get("scene", ""))
    note = ". ".join(filter(None, (point_text(ds) if point is None else point, *notes)))
    width = 0.98 * figure.get_figwidth()
    renderer = _canvas(figure).get_renderer()
    legends = [legend.get_window_extent(renderer).width / figure.dpi + _BESIDE_LEGEND for legend in figure.legends]
    bold = FontProperties(size=TITLE_SIZE, weight="bold")
    above = _wrap(figure, title, bold, width - max(legends, default=0.0), _TITLE_LINES)
    # At the higher resolution of a saved picture, small text is wider by a hundredth.
    below = _wrap(figure, note, FontProperties(size=_NOTE_SIZE), 0.985 * width, _NOTE_LINES)
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
        figure.legend(handles=handles, loc="outside right upper")


def _wrap(figure: Figure, text: str, font: FontProperties, width: float, most: int) -> list[str]:
    """Wrap the text to at most `most` lines of `width` [inch]; an ellipsis marks omitted text."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and _text_width(figure, longer, font) <= width:
            lines[-1] = longer
        else:
            lines.append(_cut(figure, word, font, width))
        if len(lines) > most:
            return [*lines[: most - 1], _cut(figure, f"{lines[most - 1]} …", font, width)]
    return lines


def _cut(figure: Figure, text: str, font: FontProperties, width: float) -> str:
    """Truncate the text with an ellipsis if it is wider than `width` [inch]."""
    if _text_width(figure, text, font) <= width:
        return text
    while text and _text_width(figure, f"{text}…", font) > width:
        text = text[:-1].rstrip(" …")
    return f"{text}…"


def _text_width(figure: Figure, text: str, font: FontProperties) -> float:
    """Return the rendered width [inch] of a text on one line."""
    width, *_ = _canvas(figure).get_renderer().get_text_width_height_descent(text, font, False)
    return float(width) / figure.dpi


def _canvas(figure: Figure) -> FigureCanvasAgg:
    return figure.canvas if isinstance(figure.canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
