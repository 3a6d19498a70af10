"""Pictures as data: plots of lines, points, bars, areas, cells and texts, which matplotlib or the page draws.

Coordinates are in the units of the axes. An infinite coordinate is the edge of the panel: `Line([2, 2], [-inf, inf])`
is an upright line through the whole panel. A layer without coordinates is an entry of a legend.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.lazy import colors

INK = "#222222"
FAINT = "#9A9A9A"

Dash = str | tuple[float, tuple[float, ...]]
"""Style of a line as in matplotlib: "-", "--", ":", offset and lengths of the dashes, or "" for no line."""

Places = np.ndarray | Sequence[Any]  # numbers along an axis
Look = dict[str, Any]  # fields of a layer by name

_ROUNDING = 1e-6  # relative range up to which values count as equal
_MARGIN = 0.05  # free fraction of an axis at each end of the data


@dataclass(frozen=True)
class Line:
    """A line, markers (`marker`, as in matplotlib) of `size` [pt], or both; hollow markers have the `face` "white"."""

    x: Places = ()
    y: Places = ()
    colour: str = INK
    width: float = 1.2
    dash: Dash = "-"
    marker: str = ""
    size: float = 4.0
    face: str = ""
    edge: str = ""
    edge_width: float = 1.0
    label: str = ""
    order: float = 2.0
    halo: float = 0.0
    alpha: float = 1.0
    clip: bool = True


@dataclass(frozen=True)
class Points:
    """Markers with own colours and sizes [pt], or one of each; the page reads the `values` that colours stand for."""

    x: Places = ()
    y: Places = ()
    colours: str | Sequence[str] = INK
    sizes: float | Sequence[float] = 4.0
    marker: str = "o"
    edge: str = ""
    edge_width: float = 0.0
    hatch: str = ""
    label: str = ""
    order: float = 2.0
    clip: bool = True
    values: Places = ()


@dataclass(frozen=True)
class Bars:
    """Rectangles from `x` and `y` of `width` and `height`."""

    x: Places = ()
    y: Places = ()
    width: Places = ()
    height: Places = ()
    colours: str | Sequence[str] = FAINT
    edge: str = ""
    label: str = ""
    order: float = 1.0


@dataclass(frozen=True)
class Area:
    """The area from `low` to `high` over `x`; `step`: both are constant from each `x` to the next."""

    x: Places = ()
    low: Places = ()
    high: Places = ()
    colour: str = FAINT
    alpha: float = 1.0
    edge: str = ""
    hatch: str = ""
    step: bool = False
    label: str = ""
    order: float = 1.0


@dataclass(frozen=True)
class Cells:
    """Coloured cells (y, x) between the edges `x` and `y`; cells without a value are hatched, or else blank."""

    x: Places
    y: Places
    values: Float[np.ndarray, "y x"]
    colour_map: "colors.Colormap"
    norm: "colors.Normalize"
    hatched: bool = True
    order: float = 0.0


@dataclass(frozen=True)
class Text:
    """Text at one place; `relative`: in fractions of the panel; `offset`: from the place [pt]."""

    x: float
    y: float
    text: str
    align: str = "center"
    baseline: str = "center"
    colour: str = "#4D4D4D"
    size: float = 9.0
    relative: bool = False
    halo: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    order: float = 4.0


def one_colour(x: Places, y: Places, mask: Bool[np.ndarray, "y x"], colour: str, **look: Any) -> Cells:
    """Return the cells in a mask in one colour, over others."""
    shown = colors.ListedColormap([colour], name="one")
    return Cells(x, y, np.where(mask, 0.0, np.nan), shown, colors.Normalize(0.0, 1.0), hatched=False, **look)


Key = Line | Area  # an entry of a legend

Layer = Line | Points | Bars | Area | Cells | Text


def dots(*args: Any, **look: Any) -> Line:
    """Return markers without a line."""
    return Line(*args, **{"dash": "", "marker": "o"} | look)


def key(label: str, **look: Any) -> Line:
    """Return a legend entry with a line or a marker."""
    return Line(label=label, **look)


def patch(colour: str, label: str, **look: Any) -> Area:
    """Return a legend entry with an area."""
    return Area(colour=colour, label=label, **{"edge": "#595959"} | look)


def upright(x: float, **look: Any) -> Line:
    """Return an upright line through the panel."""
    return Line([x, x], [-np.inf, np.inf], **look)


def level(y: float, **look: Any) -> Line:
    """Return a level line through the panel."""
    return Line([-np.inf, np.inf], [y, y], **look)


def bars(places: Places, low: Places, high: Places) -> tuple[np.ndarray, np.ndarray]:
    """Return the path of separate bars from `low` to `high`, such as errors: places along one axis, and the other."""
    place, begin, end = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, float)) for x in (places, low, high)))
    gap = np.full(place.shape, np.nan)
    return np.stack([place, place, gap], axis=1).ravel(), np.stack([begin, end, gap], axis=1).ravel()


@dataclass(frozen=True)
class Axis:
    """One axis of a plot.

    - `name`: variable of the dataset along the axis.
    - `limits`: ends of the axis; None stands for the end of the data, with some room.
    - `ticks`: values with their texts; None for automatic ticks, of at most `intervals`.
    - `group`: axes of the same group have the same limits, and only the outer panels have labels.
    """

    label: str = ""
    name: str = ""
    limits: tuple[float | None, float | None] = (None, None)
    log: bool = False
    reversed: bool = False
    ticks: Sequence[tuple[float, str]] | None = None
    intervals: int = 0
    group: str = ""
    rotated: bool = False


@dataclass(frozen=True)
class Plot:
    """A panel with its axes and layers.

    - `place`: row and column on the sheet, and the number of rows and of columns, if more than one.
    - `at`: values of the axes of a map that the plot shows.
    - `name`: words for a plot without a title.
    - `keys`: place of the legend of its labels, in one row if it is above the plot; "" if they belong to the legend of
      the sheet.
    - `scale`: quantity whose colour bar is below the plot; plots of the same quantity share one bar.
    """

    layers: Sequence[Layer]
    x: Axis = Axis()
    y: Axis = Axis()
    title: str = ""
    place: tuple[int, ...] = (0, 0)
    at: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    square: bool = False
    keys: str = ""
    scale: Any = None

    @property
    def span(self) -> tuple[int, int, int, int]:
        """Row and column on the sheet, and the numbers of rows and of columns."""
        row, column, deep, wide = (*self.place, 1, 1)[:4]
        return row, column, deep, wide

    @property
    def has_cells(self) -> bool:
        """True if the plot is a map of cells."""
        return any(isinstance(layer, Cells) for layer in self.layers)

    @property
    def is_map(self) -> bool:
        """True if the plot is a map, of cells or of points."""
        return self.has_cells or self.scale is not None


@dataclass(frozen=True)
class Sheet:
    """A picture: its plots with ratios of their `widths` and `heights` (equal ones by default), legend, title and note.

    - `size`: width and height [inch], without the further lines of title and note.
    - `keys`: groups of legend entries, which precede the entries of layers with labels.
    - `beside`: whether the legend is at the right of the plots, not below.
    """

    plots: Sequence[Plot]
    size: tuple[float, float] = (6.4, 4.8)
    widths: Sequence[float] = ()
    heights: Sequence[float] = ()
    keys: Sequence[Sequence[Key]] = ()
    title: str = ""
    note: str = ""
    beside: bool = True

    def __post_init__(self) -> None:
        for k, name in enumerate(("heights", "widths")):
            count = max((plot.span[k] + plot.span[k + 2] for plot in self.plots), default=1)
            object.__setattr__(self, name, getattr(self, name) or (1.0,) * count)


Picture = Sheet | Sequence[Plot]


def as_sheet(plots: Picture) -> Sheet:
    """Return a sheet of plots, which are placed in rows of three unless they have places."""
    if isinstance(plots, Sheet):
        return plots
    wide = min(len(plots), 3)
    placed = [replace(plot, place=divmod(k, wide)) for k, plot in enumerate(plots)]
    return Sheet(placed, (3.6 * wide + 1.6, 3.0 * -(-len(plots) // max(wide, 1)) + 0.6))


def legend_of(sheet: Sheet) -> list[list[Key]]:
    """Return the groups of legend entries: the keys of the sheet, and those of layers with labels, each text once.

    Entries of a plot's own legend are not repeated.
    """
    own, entries = (
        {entry.label: entry for plot in sheet.plots if bool(plot.keys) == has_own for entry in labelled_layers(plot)}
        for has_own in (True, False)
    )
    labelled = [entry for label, entry in entries.items() if label not in own]
    return [group for group in (*map(list, sheet.keys), labelled) if group]


def labelled_layers(plot: Plot) -> list[Key]:
    """Return the legend entries of the layers of a plot that have a label, each text once."""
    entries: dict[str, Key] = {}
    for layer in plot.layers:
        if isinstance(layer, Cells | Text) or not layer.label:
            continue
        if isinstance(layer, Points | Bars):
            look: Look = {"colour": str(np.atleast_1d(layer.colours)[0]), "label": layer.label}
            if isinstance(layer, Points):
                entries[layer.label] = dots(marker=layer.marker, size=float(np.max(layer.sizes)), **look)
            else:
                entries[layer.label] = Area(edge=layer.edge, **look)
        else:
            entries[layer.label] = layer
    return list(entries.values())


def resolved(plots: Sequence[Plot]) -> list[Plot]:
    """Return the plots with the limits of all axes."""
    plots = list(plots)
    for which in ("x", "y"):
        groups: dict[str, list[int]] = {}
        for k, plot in enumerate(plots):
            groups.setdefault(getattr(plot, which).group or f" {k}", []).append(k)
        for members in groups.values():
            limits = _limits([plots[k] for k in members], which)
            for k in members:
                plots[k] = replace(plots[k], **{which: replace(getattr(plots[k], which), limits=limits)})
    return plots


def _limits(plots: Sequence[Plot], which: str) -> tuple[float, float]:
    """Return the limits of a group of axes."""
    axes: list[Axis] = [getattr(plot, which) for plot in plots]
    first = axes[0]
    values = np.concatenate([np.zeros(0), *(_places(layer, which) for plot in plots for layer in plot.layers)])
    values = values[np.isfinite(values) & ((values > 0) | (not first.log))]
    lows, highs = ([end for axis in axes if (end := axis.limits[k]) is not None] for k in (0, 1))
    low, high = (float(values.min()), float(values.max())) if values.size else (0.1 * first.log, 1.0)
    if lows or highs:
        low, high = min(lows, default=low), max(highs, default=high)
    forward, back = (np.log, np.exp) if first.log else (np.asarray, np.asarray)
    ends = np.asarray(forward([low, high]), float)
    if ends[1] - ends[0] <= _ROUNDING * np.abs(ends).max():
        room = np.log(1.1) if first.log else 0.1 * float(np.abs(ends).max()) or 1.0
    else:
        room = 0.0 if any(plot.has_cells for plot in plots) else _MARGIN * float(np.ptp(ends))
    low, high = (float(end) for end in back(ends + [-room * (not lows), room * (not highs)]))
    return (low, high) if high > low else (low, low + (room or 1.0))


def _places(layer: Layer, which: str) -> Float[np.ndarray, " places"]:
    """Return the coordinates of a layer along an axis; of points, those with both coordinates."""
    if isinstance(layer, Text):
        return np.zeros(0)
    if isinstance(layer, Cells):
        parts: Sequence[Places] = [layer.x if which == "x" else layer.y]
    elif isinstance(layer, Area):
        parts = [layer.x] if which == "x" else [layer.low, layer.high]
    elif isinstance(layer, Bars):
        begin, size = (layer.x, layer.width) if which == "x" else (layer.y, layer.height)
        parts = [begin, np.asarray(begin, float) + np.asarray(size, float)]
    else:
        pair = np.broadcast_arrays(np.asarray(layer.x, float), np.asarray(layer.y, float))
        here, there = pair if which == "x" else pair[::-1]
        parts = [here[~np.isnan(there)]]
    return np.concatenate([np.asarray(part, float).ravel() for part in parts])


def colours_of(values: Places, colour_map: "colors.Colormap", norm: "colors.Normalize") -> list[str]:
    """Return the colours of values."""
    return [colors.to_hex(colour) for colour in colour_map(norm(np.asarray(values, float)))]
