"""What stands around the panels: title, notes and legend, on a page."""

from collections.abc import Iterable, Sequence

from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from vibrojax.plot.style import TITLE_SIZE

PAGE = (16.0, 20.0)
"""The greatest width and height [inch] of a picture of a sweep, its margins included."""

LEGEND_WIDTH = 1.9
"""The width [inch] of a legend at the right, about."""

_NOTE_SIZE = 8.0
_MOST_LINES = {"title": 3, "note": 6}
_LINE = 1.6  # of the letters' size, from one line to the next
_BESIDE_LEGEND = 0.15  # inches left free


def write_margins(figure: Figure, title: str, *notes: str) -> None:
    """Write `title` above everything, but not over a legend at the right; `notes` below.

    The figure grows by the lines after the first, of which there are a few at most.
    """
    width = figure.get_figwidth() * 0.98
    bold = FontProperties(size=TITLE_SIZE, weight="bold")
    above = _wrapped(figure, title, bold, width - _legend_width(figure), _MOST_LINES["title"])
    note = ". ".join(note for note in notes if note)
    # Small letters are wider, by a hundredth, on the finer pixels of a saved picture.
    below = _wrapped(figure, note, FontProperties(size=_NOTE_SIZE), 0.985 * width, _MOST_LINES["note"])
    if above:
        figure.suptitle("\n".join(above), x=0.01, ha="left", fontproperties=bold)
    if below:
        figure.supxlabel("\n".join(below), x=0.01, ha="left", fontsize=_NOTE_SIZE, color="0.3")
    more = TITLE_SIZE * max(len(above) - 1, 0) + _NOTE_SIZE * max(len(below) - 1, 0)
    figure.set_figheight(figure.get_figheight() + _LINE * more / 72.0)


def legend_at_right(figure: Figure, *groups: Sequence[Artist]) -> None:
    """One legend at the right of all axes, with `groups` set apart."""
    gap: Artist = Line2D([], [], linestyle="none", label=" ")
    handles: list[Artist] = []
    for group in groups:
        handles += ([gap] if handles and group else []) + list(group)
    if handles:
        figure.legend(handles=handles, loc="outside right upper")


def _legend_width(figure: Figure) -> float:
    """The width [inch] of the figure's legend; nothing where there is none."""
    legends: Iterable[Legend] = figure.legends
    widths = [legend.get_window_extent(_canvas(figure).get_renderer()).width for legend in legends]
    return max(widths) / figure.dpi + _BESIDE_LEGEND if widths else 0.0


def _wrapped(figure: Figure, text: str, font: FontProperties, width: float, most: int) -> list[str]:
    """`text` on at most `most` lines of `width` [inch]; what goes beyond is cut off, and an ellipsis says so."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and _width(figure, longer, font) <= width:
            lines[-1] = longer
        else:
            lines.append(_cut(figure, word, font, width))
        if len(lines) > most:
            return [*lines[: most - 1], _cut(figure, f"{lines[most - 1]} …", font, width)]
    return lines


def _cut(figure: Figure, text: str, font: FontProperties, width: float) -> str:
    """`text`, or as much of it as `width` [inch] holds, with an ellipsis at its end."""
    if _width(figure, text, font) <= width:
        return text
    while text and _width(figure, f"{text}…", font) > width:
        text = text[:-1].rstrip(" …")
    return f"{text}…"


def _width(figure: Figure, text: str, font: FontProperties) -> float:
    """The width [inch] of `text` on one line."""
    width, *_ = _canvas(figure).get_renderer().get_text_width_height_descent(text, font, False)
    return float(width) / figure.dpi


def _canvas(figure: Figure) -> FigureCanvasAgg:
    canvas = figure.canvas
    return canvas if isinstance(canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
