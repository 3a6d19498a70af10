"""Drawing of pictures by matplotlib: panels, legends, colour bars, title and note."""

from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from textwrap import fill, wrap
from typing import Any, Literal

import numpy as np
from matplotlib import rcParams
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, to_rgba
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.gridspec import GridSpec, GridSpecFromSubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from vibrojax.pictures import plots
from vibrojax.pictures.axes import broken, unbroken
from vibrojax.pictures.layout import LETTERS, NARROW, TALLEST, WIDTH, in_height, in_width
from vibrojax.pictures.plots import Plot, Sheet
from vibrojax.pictures.style import NO_VALUE, plain, settings

# Sizes of type where panels are made narrower.
_SMALL = dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize"), 7.5)
_SMALL |= dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 6.5) | {"figure.titlesize": 9.0}
_LABEL_SIZE = 9.0  # of pictures that are not narrowed, to which sizes of texts refer
_MOST_UNUSED = 0.12  # area below a legend at the right, as a fraction of the sheet, above which it is below the plots
_ONE_LINE = 44  # letters of a legend entry that fit on a line below the plots
_ROUND_STEPS = [1, 2, 5, 10]
_BAR_INTERVALS, _INTERVALS_PER_INCH = 6, 2.4  # between the ticks of a colour bar, whose labels would touch else
_BAR_ASPECT = 24.0  # length over width of a colour bar below one panel
_FEW_DECADES = 1e3  # ratio of the ends of a logarithmic axis below which 1, 2 and 5 have labels, as plain numbers
_FEW_TICKS = 4  # intervals up to which such an axis of more than as many decades has only powers of ten
_NAMES_ON_ONE_LINE = 3  # greatest number of flags whose names fit side by side
_TITLE_LINES, _NOTE_LINES = 3, 6  # at most
_LINE_HEIGHT = 1.6  # line spacing in units of the font size
_FOOTER, _PADDING = 0.4, 0.08  # room of the note's first line, and around the note [inch]
_TEXT_SHARE, _LEGEND_SHARE = 0.88, 0.95  # of the width for texts, whose letters are wider at other resolutions
_BELOW_EDGE = 0.95  # height of markers at the upper edge, as a fraction of the panel
_MANY_POINTS = 1_000  # from which on points are pixels in a PDF or SVG file; of a line 20 times as many
_ABOVE = {"above": ("lower center", 0.5), "above left": ("lower left", 0.0), "above right": ("lower right", 1.0)}


class OwnFigure(Figure):
    """A figure that pyplot does not manage, but that notebooks display."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        with settings():
            self.save_png(content)
        return content.getvalue()

    def save_png(self, target: Any, **about: Any) -> None:
        """Write the figure as PNG at its resolution; `savefig` would first draw it once more, for the layout."""
        FigureCanvasAgg(self).print_png(target, **about)


def new_figure(width: float, height: float) -> OwnFigure:
    """Return an empty figure of `width` by `height` [inch] on the Agg canvas."""
    figure = OwnFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw(picture: plots.Picture | Figure) -> Figure:
    """Draw plots; a figure is returned as it is."""
    width = WIDTH.get()
    if isinstance(picture, Figure):
        if width:
            picture.set_size_inches(width, picture.get_figheight() * width / picture.get_figwidth())
        return picture
    sheet = plots.as_sheet(picture)
    with settings(_SMALL if width and width < sheet.size[0] else {}):
        sheet = in_width(sheet, width) if width else in_height(sheet)
        figure = new_figure(*sheet.size)
        _draw_plots(figure, sheet)
        sheet = _draw_legend(figure, sheet)
        _write_margins(figure, sheet)
        # Ticks are created when the figure is rendered, under the user's settings.
        for axes in figure.axes:
            axes.tick_params(labelsize=rcParams["xtick.labelsize"])
        # A label measures the ticks of all axes that it is aligned with.
        rows = [axes for axes in figure.axes if isinstance(axes.get_gridspec(), GridSpec)]
        figure.align_ylabels([axes for axes in rows if axes.get_ylabel()])
    return figure


def _draw_plots(figure: Figure, sheet: Sheet) -> None:
    """Draw the plots of a sheet, and one colour bar below the plots of each quantity."""
    size = len(sheet.heights), len(sheet.widths)
    grid = GridSpec(*size, figure, height_ratios=sheet.heights, width_ratios=sheet.widths)
    shown, panels = plots.resolved(sheet.plots), []
    for plot in shown:
        row, column, deep, wide = plot.span
        part = grid[row : row + deep, column : column + wide]
        # The colour bar below a tall panel takes no room from the rows beside it.
        part = GridSpecFromSubplotSpec(1, 1, part)[0] if deep > 1 and plot.scale else part
        panels.append(figure.add_subplot(part))
        _draw_plot(panels[-1], plot, shown)
    for value in {id(plot.scale): plot.scale for plot in shown if plot.scale is not None}.values():
        below = [axes for axes, plot in zip(panels, shown, strict=True) if plot.scale is value]
        columns = {plot.place[1]: plot.span[3] for plot in shown if plot.scale is value}
        length = sheet.size[0] * sum(columns.values()) / len(sheet.widths)
        label, intervals = broken(value.label, int(LETTERS * length)), int(_INTERVALS_PER_INCH * length)
        _draw_scale(figure, below, value, label, _BAR_ASPECT * len(columns), min(intervals, _BAR_INTERVALS))


def _draw_plot(axes: Axes, plot: Plot, shown: Sequence[Plot]) -> None:
    for layer in plot.layers:
        _draw_layer(axes, layer, plot)
    row, column, _, wide = plot.span
    below = [p for p in shown if p.place[0] > row and p.span[1::2] == (column, wide)]
    follows = min(below, key=lambda p: p.place[0]).x.group == plot.x.group != "" if below else False
    same_row = [p for p in shown if p.y.group == plot.y.group != "" and p.place[0] == row]
    _draw_axis(axes, "x", plot.x, plot.has_cells, outer=not follows)
    _draw_axis(axes, "y", plot.y, plot.has_cells, outer=not any(p.place[1] < column for p in same_row))
    if plot.square:
        axes.set_aspect("equal")
    axes.set_title(plain(plot.title), loc="center" if plot.has_cells or plot.square else "left")
    if plot.keys:
        handles = [_handle(layer) for layer in plots.labelled_layers(plot)]
        place: dict[str, Any] = {"loc": plot.keys}
        if plot.keys in _ABOVE:
            loc, x = _ABOVE[plot.keys]
            place = {"loc": loc, "bbox_to_anchor": (x, 1.0), "borderpad": 0.0, "borderaxespad": 0.3}
            place["ncols"] = len(handles)
        axes.legend(handles=handles, **place)


def _draw_axis(axes: Axes, which: Literal["x", "y"], shown: plots.Axis, cells: bool, outer: bool) -> None:
    """Set scale, limits, ticks, grid and label of an axis; only the `outer` panels have labels."""
    axis = getattr(axes, f"{which}axis")
    low, high = shown.limits
    if shown.log:
        axes.set(**{f"{which}scale": "log"})
        if low and high and high / low < _FEW_DECADES:
            few = 0 < shown.intervals < high / low / 10.0 and shown.intervals <= _FEW_TICKS
            axis.set_major_locator(LogLocator(subs=(1.0,) if few else (1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    elif shown.intervals:
        axis.set_major_locator(MaxNLocator(shown.intervals, steps=_ROUND_STEPS))
    axis.grid(shown.ticks is None and not cells)
    axes.set(**{f"{which}lim": (high, low) if shown.reversed else (low, high)})
    if shown.ticks is not None:
        axis.set_ticks([value for value, _ in shown.ticks], [plain(text) for _, text in shown.ticks])
        axis.set_minor_locator(NullLocator())
        if shown.rotated:
            axes.tick_params(which, rotation=45)
            for text in axis.get_ticklabels():
                text.set(ha="right", rotation_mode="anchor")
    axes.tick_params(which, **{"labelbottom" if which == "x" else "labelleft": outer})
    axis.set_label_text(plain(shown.label) if outer else "")


def _draw_layer(axes: Axes, layer: plots.Layer, plot: Plot) -> None:
    stroke: dict[str, Any] = {}
    if isinstance(layer, plots.Line | plots.Text) and layer.halo:
        width = 2 * layer.halo + (layer.width if isinstance(layer, plots.Line) else 0.0)
        stroke = {"path_effects": [withStroke(linewidth=width, foreground="white")]}
    if isinstance(layer, plots.Line):
        edge = _BELOW_EDGE if layer.marker else 1.0
        x, y = np.broadcast_arrays(_inside(layer.x, plot.x), _inside(layer.y, plot.y, edge))
        (line,) = axes.plot(x, y, **_line_look(layer), **stroke, zorder=layer.order)
        line.set_clip_on(layer.clip or not (np.isfinite(x) & np.isfinite(y)).any())
        line.set_rasterized(x.size > 20 * _MANY_POINTS)
    elif isinstance(layer, plots.Points):
        x, y = _inside(layer.x, plot.x), _inside(layer.y, plot.y)
        look: dict[str, Any] = {"marker": layer.marker, "linewidths": layer.edge_width, "hatch": layer.hatch or None}
        look |= {"edgecolors": layer.edge} if layer.edge else {}
        if len(x):
            area: Any = np.square(layer.sizes) * _type_scale() ** 2
            many = len(x) > _MANY_POINTS
            shown = axes.scatter(x, y, s=area, c=layer.colours, zorder=layer.order, rasterized=many, **look)
            shown.set_clip_on(layer.clip or not (np.isfinite(x) & np.isfinite(y)).any())
    elif isinstance(layer, plots.Bars):
        x, y, wide, high = np.broadcast_arrays(layer.x, layer.y, layer.width, layer.height)
        look = {"edgecolor": layer.edge or "none", "linewidth": 0.4}
        axes.bar(x, high, wide, y, align="edge", color=layer.colours, zorder=layer.order, **look)
    elif isinstance(layer, plots.Area):
        x, low, high = _inside(layer.x, plot.x), _inside(layer.low, plot.y), _inside(layer.high, plot.y)
        look = {"facecolor": to_rgba(layer.colour, layer.alpha), "hatch": layer.hatch or None, "zorder": layer.order}
        look |= {"edgecolor": layer.edge or "none", "linewidth": 0.6 if layer.edge else 0.0}
        if x.size:
            axes.fill_between(x, low, high, step="post" if layer.step else None, **look)
    elif isinstance(layer, plots.Cells):
        if layer.hatched and np.isnan(layer.values).any():
            axes.patch.set(**NO_VALUE, linewidth=0.0)
        look = {"cmap": layer.colour_map, "norm": layer.norm, "zorder": layer.order, "rasterized": True}
        axes.pcolormesh(layer.x, layer.y, np.ma.masked_invalid(layer.values), **look)
    else:
        size = layer.size * _type_scale()
        look = {"ha": layer.align, "va": layer.baseline, "color": layer.colour, "fontsize": size}
        look |= {"xytext": layer.offset, "textcoords": "offset points", "zorder": layer.order} | stroke
        look |= {"xycoords": "axes fraction" if layer.relative else "data", "annotation_clip": False}
        axes.annotate(plain(layer.text), (layer.x, layer.y), **look)


def _type_scale() -> float:
    """Return the size of type and marks as a fraction of that in pictures that are not narrowed."""
    return float(rcParams["font.size"] / _LABEL_SIZE)


def _inside(values: plots.Places, axis: plots.Axis, edge: float = 1.0) -> np.ndarray:
    """Return coordinates in which the ends of the axis, or a fraction `edge` of it, replace infinity."""
    low, high = (float(end or 0.0) for end in axis.limits)
    array = np.atleast_1d(np.asarray(values, float))
    return np.where(np.isinf(array), np.where(array > 0, low + edge * (high - low), low), array)


def _line_look(layer: plots.Line) -> dict[str, Any]:
    look: dict[str, Any] = {"color": layer.colour, "linewidth": layer.width, "linestyle": layer.dash or "none"}
    if layer.marker:
        look |= {"marker": layer.marker, "markersize": layer.size * _type_scale(), "markeredgewidth": layer.edge_width}
        look |= {"markerfacecolor": layer.face or layer.colour, "markeredgecolor": layer.edge or layer.colour}
    return look | {"alpha": layer.alpha}


def _handle(key: plots.Key) -> Artist:
    if isinstance(key, plots.Line):
        return Line2D([], [], label=plain(key.label), **_line_look(key))
    hollow = key.colour == "none"
    look: dict[str, Any] = {"edgecolor": key.edge or "none", "linewidth": 1.3 if hollow else 0.4}
    look |= {"facecolor": "none" if hollow else to_rgba(key.colour, key.alpha), "hatch": key.hatch or None}
    return Patch(label=plain(key.label), **look)


def _draw_legend(figure: Figure, sheet: Sheet) -> Sheet:
    """Draw one legend at the right of all plots, with gaps between its groups, or below them in columns that fit.

    Return the sheet with the place of its legend: below the plots also if most of the sheet below it would stay unused.
    """
    groups = [[_handle(layer) for layer in group] for group in plots.legend_of(sheet)]
    if not groups:
        return sheet
    renderer = FigureCanvasAgg(figure).get_renderer()
    if sheet.beside:
        gap = Line2D([], [], linestyle="none", label=" ")
        handles = [handle for group in groups for handle in (gap, *group)][1:]
        legend = figure.legend(handles=handles, loc="outside right upper")
        box = legend.get_window_extent(renderer)
        if box.width * (figure.bbox.height - box.height) <= _MOST_UNUSED * figure.bbox.width * figure.bbox.height:
            return sheet
        legend.remove()
    handles = [handle for group in groups for handle in group]
    for handle in handles if sheet.size[0] > NARROW else ():
        label = str(handle.get_label())
        handle.set_label(label.replace("\n", " ") if len(label) <= _ONE_LINE else label)
    for columns in range(min(len(handles), 6), 0, -1):
        legend = figure.legend(handles=handles, loc="lower left", ncols=columns, columnspacing=1.2)
        if columns == 1 or legend.get_window_extent(renderer).width < _LEGEND_SHARE * figure.bbox.width:
            break
        legend.remove()
    return replace(sheet, beside=False)


def _draw_scale(figure: Figure, above: list[Axes], value: Any, label: str, aspect: float, intervals: int) -> None:
    look: dict[str, Any] = {"extend": value.extend, "label": plain(label), "aspect": aspect}
    mappable = ScalarMappable(value.norm, value.colour_map)
    bar = figure.colorbar(mappable, ax=above, location="bottom", extendfrac=1.0 / aspect, **look)
    if value.names:
        two_lines = len(value.names) > _NAMES_ON_ONE_LINE
        names = [name.replace("-", "-\n", 1) if two_lines else name for name in value.names.values()]
        bar.set_ticks(list(value.names), labels=[plain(name) for name in names])
        bar.minorticks_off()
    elif not value.has_values:
        bar.set_ticks([])
    elif not isinstance(value.norm, LogNorm):
        bar.set_ticks(MaxNLocator(intervals, steps=_ROUND_STEPS))


def _write_margins(figure: Figure, sheet: Sheet) -> None:
    """Write the title at the top, to the left of any legend, and the note at the bottom, below any legend.

    A legend below, and each line after the first line of title or note, makes the figure higher, up to `TALLEST`.
    """
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [legend.get_window_extent(renderer) for legend in figure.legends]
    wide, tall = max((box.width for box in boxes), default=0.0), max((box.height for box in boxes), default=0.0)

    def wrapped(text: str, font: FontProperties, beside: float, most: int) -> str:
        """Wrap a text by the mean width of its letters; an ellipsis marks omitted text, and no value is broken."""
        length = float(renderer.get_text_width_height_descent(text, font, False)[0]) if text else 1.0
        letters = max(int(len(text) * _TEXT_SHARE * (figure.bbox.width - beside) / length), 8)
        text = unbroken(text)
        while most == _TITLE_LINES and letters > 8 and len(wrap(text, letters - 1)) == len(wrap(text, letters)):
            letters -= 1  # lines of a title are of about equal length
        return plain(fill(text, letters, max_lines=most, placeholder="…").replace("\u00a0", " "))

    title_size, note_size = rcParams["figure.titlesize"], rcParams["legend.fontsize"]
    bold = FontProperties(size=title_size, weight="bold")
    title = wrapped(sheet.title, bold, wide if sheet.beside else 0.0, _TITLE_LINES)
    note = wrapped(sheet.note, FontProperties(size=note_size), 0.0, _NOTE_LINES)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontproperties=bold)
    footer = figure.supxlabel(note, x=0.01, ha="left", fontsize=note_size, color="0.3") if note else None
    more = _LINE_HEIGHT / 72.0 * (title_size * title.count("\n") + note_size * note.count("\n"))
    height, legend = figure.get_figheight() + more, tall / figure.dpi + _PADDING * bool(boxes)
    if sheet.beside:
        figure.set_figheight(min(max(height, legend + _FOOTER * bool(note) + more), TALLEST))
    else:
        height = min(height + legend, TALLEST)
        figure.set_figheight(height)
        below = footer.get_window_extent(renderer).height / figure.dpi + _PADDING if footer else 0.0
        for each in figure.legends:
            each.set_bbox_to_anchor((0.0, below / height, 1.0, 1.0), figure.transFigure)
        engine: Any = figure.get_layout_engine()
        engine.set(rect=(0.0, legend / height, 1.0, 1.0 - legend / height))
