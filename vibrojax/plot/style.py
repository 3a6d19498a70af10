"""How every picture looks: colours, sizes, and a figure that leaves pyplot and its settings alone."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from io import BytesIO
from typing import Any, ParamSpec, TypedDict

import xarray as xr
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec
from matplotlib.typing import ColorType, LineStyleType, MarkerType

from vibrojax.plot.drawable import drawable

INK = "#222222"
FAINT = "#9A9A9A"
UNDEFINED = "#D0D0D0"  # a lane without the value, as grey in maps of values
NOTHING = "#FFFFFF"  # a lane without penetration, in maps of values
BIT = "#00598C"
STRIKER = "#D1570A"
STICK = "#111111"
IMPACT = "#C2185B"
ROCK = "#B08D57"

# Readable apart in greyscale and by colour-blind eyes.
START_COLOURS = {"drive": "#004488", "stuck": "#CC6677", "touching": "#2E8B57"}
OTHER_COLOURS = ("#56B4E9", "#E69F00", "#9B30C9", "#222222", "#C6D937", "#7A1F1F", "#B5B5B5")
ROCK_COLOURS = {"sandstone": "#D9A441", "limestone": "#3F8FA3", "granite": "#7A2E4D"}

DASHED = (0.0, (4.0, 3.0))

FINEST = 160.0  # pixels an inch of a saved picture

TITLE_SIZE = 11.0
_TICK_SIZE = 8.0
_SETTINGS = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.7,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.axisbelow": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": _TICK_SIZE,
    "ytick.labelsize": _TICK_SIZE,
    "xtick.direction": "out",
    "ytick.direction": "out",
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "figure.titlesize": TITLE_SIZE,
    "grid.color": "#E2E2E2",
    "grid.linewidth": 0.5,
    "lines.solid_capstyle": "round",
    "savefig.dpi": FINEST,
    "figure.dpi": 110,
    "svg.fonttype": "none",
    "svg.hashsalt": "vibrojax",  # the same dataset gives the same file
    "pdf.fonttype": 42,
}

COLOURS: ContextVar[str | None] = ContextVar("COLOURS", default=None)
"""The colour map that a user asked for, of quantities; None: each its own."""

Arguments = ParamSpec("Arguments")


class Mark(TypedDict, total=False):
    """How a line and its marks look, in matplotlib's words."""

    color: ColorType
    linestyle: LineStyleType
    linewidth: float
    marker: MarkerType
    markersize: float
    markerfacecolor: ColorType
    markeredgecolor: ColorType
    markeredgewidth: float
    alpha: float
    zorder: float


class OwnFigure(Figure):
    """A figure that belongs to nobody's pyplot, and shows itself in a notebook all the same."""

    def _repr_png_(self) -> bytes:
        with settings():
            content = BytesIO()
            self.savefig(content, format="png", dpi=self.dpi)
        return content.getvalue()


@contextmanager
def settings() -> Iterator[None]:
    """Give matplotlib the settings of all pictures, whatever the user's are."""
    with style.context(["default", _SETTINGS]), warnings.catch_warnings():
        # A letter that the font lacks is drawn as a box, which says it.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


def styled(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """Return `draw` with the settings of all pictures, on datasets whose texts can be drawn."""

    @wraps(draw)
    def drawn(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Figure:
        with settings():
            figure = draw(*map(_drawable, args), **{name: _drawable(one) for name, one in kwargs.items()})
        # Ticks are made as late as at drawing, when the user's settings hold again.
        for axes in figure.axes:
            axes.tick_params(labelsize=_TICK_SIZE)
        return figure

    return drawn


def _drawable(argument: Any) -> Any:
    """Return an argument of a drawing function with datasets whose texts can be drawn."""
    if isinstance(argument, xr.Dataset):
        return drawable(argument)
    if isinstance(argument, (list, tuple)) and any(isinstance(one, xr.Dataset) for one in argument):
        return [_drawable(one) for one in argument]
    return argument


def new_figure(width: float, height: float) -> OwnFigure:
    """An empty figure of `width` by `height` [inch] on the Agg canvas."""
    figure = OwnFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def divided(figure: Figure, above: float) -> tuple[SubplotSpec | None, SubplotSpec]:
    """`figure` as a place of `above` inches, none where that is zero, and the place below it."""
    if not above > 0:
        return None, GridSpec(1, 1, figure)[0]
    places = GridSpec(2, 1, figure, height_ratios=[above, figure.get_figheight() - above])
    return places[0], places[1]


def start_colour(name: str, position: int) -> str:
    """The colour of the start `name`; starts without a fixed one take theirs by `position` among the starts."""
    if not name:
        return BIT
    return START_COLOURS.get(name, OTHER_COLOURS[position % len(OTHER_COLOURS)])
