"""Drawing of pictures by matplotlib: panels, legends, colour bars, title and note."""

from io import BytesIO
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.gridspec import GridSpec, SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from vibrojax.pictures.fitting import LEGEND_LINE, SMALL, WIDTH, in_width
from vibrojax.pictures.plots import (
    Area,
    Bars,
    Cells,
    Layer,
    Line,
    Picture,
    Plot,
    Points,
    Sheet,
    Text,
    as_sheet,
    labelled_layers,
    legend_of,
    resolved,
)
from vibrojax.pictures.style import NO_VALUE, plain, settings

_TICK_SIZE, _TITLE_SIZE, _NOTE_SIZE = 8.0, 11.0, 8.0
_BAR_INTERVALS = 6  # greatest number between the ticks of a colour bar: more labels would touch each other
_BAR_ASPECT = 24.0  # length over width of a colour bar below one panel
_FEW_DECADES = 1e3  # ratio of the ends of a logarithmic axis below which 1, 2 and 5 have labels, as plain numbers
_DASHED_LENGTH = 2.8  # length of a dashed line in the legend, in units of the font size: two dashes or more
_NAMES_ON_ONE_LINE = 3  # greatest number of flags whose names fit side by side
_TITLE_LINES, _NOTE_LINES = 3, 6  # at most
_LINE_HEIGHT = 1.6  # line spacing in units of the font size
_TEXT_SHARE = 0.92  # share of the width for texts, whose letters are wider at other resolutions
_BELOW_EDGE = 0.95  # height of markers at the upper edge, as a fraction of the panel
_ABOVE = {"above": ("lower center", 0.5), "above left": ("lower left", 0.0), "above right": ("lower right", 1.0)}


class OwnFigure(Figure):
    """A figure that pyplot does not manage, but that notebooks display."""

    def _repr_png_(self) -> bytes:
        with settings():
            content = BytesIO()
            self.savefig(content, format="png", dpi=self.dpi)
        return content.getvalue()


def new_figure(width: float, height: float) -> OwnFigure:
    """Return an empty figure of `width` by `height` [inch] on the Agg canvas."""
    figure = OwnFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw(picture: Picture | Figure) -> Figure:
    """Draw plots; a figure is returned as it is."""
    width = WIDTH.get()
    if isinstance(picture, Figure):
        if width:
            picture.set_size_inches(width, picture.get_figheight() * width / picture.get_figwidth())
        return picture
    sheet = as_sheet(picture)
    with settings(SMALL if width and width < sheet.size[0] else {}):
        sheet = in_width(sheet, width) if width else sheet
        handles = _handles(sheet)
        columns, lines = _legend_below(width, handles) if width and not sheet.beside else (0, 0)
        figure = new_figure(*sheet.size)
        whole: Any = GridSpec(1, 1, figure)[0]
        if lines:
            room = LEGEND_LINE * lines + 0.1
            grid: Any = GridSpec(2, 1, figure, height_ratios=(sheet.size[1], room))
            whole, below = grid[0], grid[1]
            figure.set_figheight(sheet.size[1] + room)
            axes = figure.add_subplot(below)
            axes.set_axis_off()
            axes.legend(handles=handles, loc="upper left", ncols=columns, borderaxespad=0.0, columnspacing=1.2)
        if sheet.above is not None:
            heights = sheet.above.size[1], sheet.size[1] - sheet.above.size[1]
            above, whole = whole.subgridspec(2, 1, height_ratios=heights)
            _draw_plots(figure, above, sheet.above)
        _draw_plots(figure, whole, sheet)
        if not lines:
            _draw_legend(figure, handles)
        _write_margins(figure, sheet)
    # Ticks are created when the figure is rendered, under the user's settings.
    for axes in figure.axes:
        axes.tick_params(labelsize=_TICK_SIZE)
    return figure


def _draw_plots(figure: Figure, whole: SubplotSpec, sheet: Sheet) -> None:
    """Draw the plots of a sheet, and one colour bar below the plots of each quantity."""
    size = len(sheet.heights), len(sheet.widths)
    grid = whole.subgridspec(*size, height_ratios=sheet.heights, width_ratios=sheet.widths)
    plots, panels = resolved(sheet.plots), []
    for plot in plots:
        row, column, deep, wide = (*plot.place, 1, 1)[:4]
        panels.append(figure.add_subplot(grid[row : row + deep, column : column + wide]))
        _draw_plot(panels[-1], plot, plots)
    figure.align_ylabels(panels)
    for value in {id(plot.scale): plot.scale for plot in plots if plot.scale is not None}.values():
        below = [axes for axes, plot in zip(panels, plots, strict=True) if plot.scale is value]
        wide = len({plot.place[1] for plot in plots if plot.scale is value})
        _draw_scale(figure, below, value, _BAR_ASPECT * wide)


def _draw_plot(axes: Axes, plot: Plot, plots: list[Plot]) -> None:
    for layer in plot.layers:
        _draw_layer(axes, layer)
    outer = {
        "x": not any(
            p.x.group == plot.x.group != "" and p.place[1] == plot.place[1] and p.place[0] > plot.place[0]
            for p in plots
        ),
        "y": not any(
            p.y.group == plot.y.group != "" and p.place[0] == plot.place[0] and p.place[1] < plot.place[1]
            for p in plots
        ),
    }
    for which in ("x", "y"):
        axis, shown = getattr(axes, f"{which}axis"), getattr(plot, which)
        if shown.log:
            axes.set(**{f"{which}scale": "log"})
            low, high = shown.limits
            if high / low < _FEW_DECADES:
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
        elif shown.intervals:
            axis.set_major_locator(MaxNLocator(shown.intervals, steps=[1, 2, 5, 10]))
        axes.set(**{f"{which}lim": shown.limits[::-1] if shown.reversed else shown.limits})
        if shown.ticks is not None:
            axis.set_ticks([value for value, _ in shown.ticks], [plain(text) for _, text in shown.ticks])
            axis.set_minor_locator(NullLocator())
            if shown.rotated:
                axes.tick_params(which, rotation=45)
                for text in axis.get_ticklabels():
                    text.set(ha="right", rotation_mode="anchor")
        axes.tick_params(which, **{"labelbottom" if which == "x" else "labelleft": outer[which]})
        axis.set_label_text(plain(shown.label) if outer[which] else "")
    if plot.grid and not any(isinstance(layer, Cells) for layer in plot.layers):
        axes.grid(True, axis=plot.grid)  # type: ignore[arg-type]
    if plot.square:
        axes.set_aspect("equal")
    bold: dict[str, Any] = {"color": plot.title_colour, "fontweight": "bold"} if plot.title_colour else {}
    cells = any(isinstance(layer, Cells) for layer in plot.layers) or plot.square or plot.title_colour
    axes.set_title(plain(plot.title), loc="center" if cells else "left", **bold)
    axes.set_title(plain(plot.remark), loc="right", fontsize=8)
    if plot.keys:
        handles = [_handle(layer) for layer in labelled_layers(plot)]
        loc, x = _ABOVE.get(plot.keys, (plot.keys, None))
        place: dict[str, Any] = {"loc": loc, "ncols": plot.key_columns}
        if x is not None:
            place |= {"bbox_to_anchor": (x, 1.0), "borderpad": 0.0, "borderaxespad": 0.3}
        axes.legend(handles=handles, **place)


def _draw_layer(axes: Axes, layer: Layer) -> None:
    stroke: dict[str, Any] = {}
    if isinstance(layer, Line | Text) and layer.halo:
        width = 2 * layer.halo + (layer.width if isinstance(layer, Line) else 0.0)
        stroke = {"path_effects": [withStroke(linewidth=width, foreground="white")]}
    if isinstance(layer, Line):
        _draw_line(axes, layer, stroke)
    elif isinstance(layer, Points):
        x, y = np.atleast_1d(layer.x), np.atleast_1d(layer.y)
        look: dict[str, Any] = {"marker": layer.marker, "linewidths": layer.edge_width, "hatch": layer.hatch or None}
        look |= {"edgecolors": layer.edge} if layer.edge else {}
        if len(x):
            area: Any = np.square(layer.sizes)
            shown = axes.scatter(x, y, s=area, c=layer.colours, zorder=layer.order, rasterized=len(x) > 1000, **look)
            shown.set_clip_on(layer.clip or not (np.isfinite(x) & np.isfinite(y)).any())
    elif isinstance(layer, Bars):
        look = {"edgecolor": layer.edge or "none", "linewidth": 0.4, "hatch": layer.hatch or None}
        x, y, wide, high = np.broadcast_arrays(layer.x, layer.y, layer.width, layer.height)
        colours = layer.colours if isinstance(layer.colours, str) else list(layer.colours)
        axes.bar(x, high, wide, y, align="edge", color=colours, zorder=layer.order, **look)
    elif isinstance(layer, Area):
        _draw_area(axes, layer)
    elif isinstance(layer, Cells):
        if layer.hatched and np.isnan(layer.values).any():
            axes.patch.set(**NO_VALUE, linewidth=0.0)
        masked = np.ma.masked_invalid(layer.values)
        axes.pcolormesh(
            layer.x, layer.y, masked, cmap=layer.colour_map, norm=layer.norm, rasterized=True, zorder=layer.order
        )
    else:
        look = {"ha": layer.align, "va": layer.baseline, "color": layer.colour, "fontsize": layer.size}
        if layer.box:
            look |= {"bbox": {"facecolor": "white", "edgecolor": "none", "pad": 1.5}}
        look |= {"xytext": layer.offset, "textcoords": "offset points", "zorder": layer.order} | stroke
        look |= {"xycoords": "axes fraction" if layer.relative else "data", "annotation_clip": False}
        axes.annotate(plain(layer.text), (layer.x, layer.y), **look)


def _draw_line(axes: Axes, layer: Line, stroke: dict[str, Any]) -> None:
    x, y = np.broadcast_arrays(np.asarray(layer.x, float), np.asarray(layer.y, float))
    look = _line_look(layer) | stroke | {"zorder": layer.order, "alpha": layer.alpha}
    if np.isinf(y).any() and layer.marker:
        axes.plot(x, np.full(x.shape, _BELOW_EDGE), transform=axes.get_xaxis_transform(), **look)
    elif np.isinf(x).any():
        axes.axhline(float(y.flat[0]), **look)
    elif np.isinf(y).any():
        axes.axvline(float(x.flat[0]), **look)
    else:
        (line,) = axes.plot(np.atleast_1d(x), np.atleast_1d(y), **look)
        line.set_clip_on(layer.clip or not (np.isfinite(x) & np.isfinite(y)).any())
        line.set_rasterized(x.size > 20_000)


def _line_look(layer: Line) -> dict[str, Any]:
    look: dict[str, Any] = {"color": layer.colour, "linewidth": layer.width, "linestyle": layer.dash or "none"}
    if layer.marker:
        look |= {"marker": layer.marker, "markersize": layer.size, "markeredgewidth": layer.edge_width}
        look |= {"markerfacecolor": layer.face or layer.colour, "markeredgecolor": layer.edge or layer.colour}
    return look


def _draw_area(axes: Axes, layer: Area) -> None:
    x, low, high = (np.asarray(values, float) for values in (layer.x, layer.low, layer.high))
    look: dict[str, Any] = {"facecolor": to_rgba(layer.colour, layer.alpha), "zorder": layer.order}
    look |= {"edgecolor": layer.edge or "none", "linewidth": 0.6 if layer.edge else 0.0}
    if np.isinf(x).any():
        axes.axhspan(float(low.flat[0]), float(high.flat[0]), **look)
    elif np.isinf(low).any() and np.isinf(high).any():
        axes.axvspan(float(x.flat[0]), float(x.flat[-1]), **look)
    elif x.size:
        axes.fill_between(x, low, high, step="post" if layer.step else None, hatch=layer.hatch or None, **look)


def _handle(layer: Layer) -> Artist:
    """Return the legend entry of a layer."""
    text = plain(layer.label) if not isinstance(layer, Cells) else ""
    if isinstance(layer, Line):
        return Line2D([], [], label=text, **_line_look(layer) | {"alpha": layer.alpha})
    if isinstance(layer, Points):
        colour = layer.colours if isinstance(layer.colours, str) else layer.colours[0]
        size = float(np.max(layer.sizes))
        return Line2D([], [], label=text, linestyle="none", marker=layer.marker, color=colour, markersize=size)
    if isinstance(layer, Bars | Area):
        several = isinstance(layer, Bars) and not isinstance(layer.colours, str)
        colour = layer.colour if isinstance(layer, Area) else layer.colours[0] if several else str(layer.colours)
        face = to_rgba(colour, layer.alpha if isinstance(layer, Area) else 1.0) if colour != "none" else "none"
        edge: dict[str, Any] = {"edgecolor": layer.edge or "none", "linewidth": 1.3 if colour == "none" else 0.4}
        return Patch(facecolor=face, hatch=layer.hatch or None, label=text, **edge)
    return Line2D([], [], linestyle="none", label=text)


def _legend_below(width: float, handles: list[Artist]) -> tuple[int, int]:
    """Return the columns and lines of a legend below the plots, without the gaps between groups."""
    texts = [str(handle.get_label()) for handle in handles if str(handle.get_label()).strip()]
    handles[:] = [handle for handle in handles if str(handle.get_label()).strip()]
    longest = max((len(line) for text in texts for line in text.split("\n")), default=0)
    columns = max(1, min(len(texts), int((width - 0.6) / (0.055 * longest + 0.45)))) if texts else 0
    return columns, -(-sum(text.count("\n") + 1 for text in texts) // columns) if texts else 0


def _handles(sheet: Sheet) -> list[Artist]:
    """Return the entries of the legend of a sheet, with a gap between groups."""
    handles: list[Artist] = []
    for group in legend_of(sheet):
        handles += [Line2D([], [], linestyle="none", label=" ")] * bool(handles) + [_handle(layer) for layer in group]
    return handles


def _draw_legend(figure: Figure, handles: list[Artist]) -> None:
    """Draw one legend at the right of all plots."""
    if handles:
        dashed = any(isinstance(handle, Line2D) and handle.is_dashed() for handle in handles)
        look: dict[str, Any] = {"handlelength": _DASHED_LENGTH} if dashed else {}
        figure.legend(handles=handles, loc="outside right upper", **look)


def _draw_scale(figure: Figure, above: list[Axes], value: Any, aspect: float) -> None:
    look: dict[str, Any] = {"extend": value.extend, "label": plain(value.label), "aspect": aspect}
    look["extendfrac"] = 1.0 / aspect
    mappable = ScalarMappable(value.norm, value.colour_map)
    bar = figure.colorbar(mappable, ax=above, location="bottom", **look)
    if value.names:
        two_lines = len(value.names) > _NAMES_ON_ONE_LINE
        names = [name.replace("-", "-\n", 1) if two_lines else name for name in value.names.values()]
        bar.set_ticks(list(value.names), labels=[plain(name) for name in names])
        bar.minorticks_off()
    elif not value.has_values:
        bar.set_ticks([])
    elif isinstance(value.norm, Normalize) and not isinstance(value.norm, LogNorm):
        bar.set_ticks(MaxNLocator(_BAR_INTERVALS, steps=[1, 2, 5, 10]))


def _write_margins(figure: Figure, sheet: Sheet) -> None:
    """Write the title at the top, to the left of any legend, and the note at the bottom.

    Each line after the first line of title or note makes the figure higher.
    """
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [legend.get_window_extent(renderer) for legend in figure.legends]

    def wrapped(text: str, font: FontProperties, beside: float, most: int) -> str:
        """Wrap a text by the mean width of its letters; an ellipsis marks omitted text."""
        length = float(renderer.get_text_width_height_descent(text, font, False)[0]) if text else 1.0
        letters = len(text) * _TEXT_SHARE * (figure.bbox.width - beside) / length
        return plain(fill(text, max(int(letters), 8), max_lines=most, placeholder="…"))

    bold = FontProperties(size=_TITLE_SIZE, weight="bold")
    title = wrapped(sheet.title, bold, max((box.width for box in boxes), default=0.0), _TITLE_LINES)
    note = wrapped(sheet.note, FontProperties(size=_NOTE_SIZE), 0.0, _NOTE_LINES)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontproperties=bold)
    if note:
        figure.supxlabel(note, x=0.01, ha="left", fontsize=_NOTE_SIZE, color="0.3")
    tall = max((box.height for box in boxes), default=0.0) / figure.dpi + 0.3 * bool(note)
    more = _TITLE_SIZE * title.count("\n") + _NOTE_SIZE * note.count("\n")
    figure.set_figheight(max(figure.get_figheight(), tall) + _LINE_HEIGHT * more / 72.0)
