"""Plots of an analysis as JSON, which the explorer page draws and links to its cursor.

A description holds the plots, the entries of their legends, and figures as images:

    {"note": text, "plots": [{"title", "x", "y": {"label", "limits", "log", "reversed", "ticks": [[value, text]] | null,
                                    "direction": id of the page's direction along the axis, or null},
                "at": {axis: index}: the map cells that the plot shows, "wide", "low", "square", "track", "bare": a
                track beside another of the same axis, "items": [...]}],
     "keys": [{"text", "colour", "shape": "line", "patch" or a mark, "dash": [...], "marker", "hollow", "size"}],
     "bars": [{"label", "low", "high", "log", "extend", "map": colours}]: a plot has the number of its own as "bar",
     "images": [{"title", "data": a PNG file as a data URL}]}

Items are in data coordinates, each with a "kind": "line" (x, y, label, colour, width, dash), "points" (x, y, label,
colours, sizes, shape, hollow: false or what fills it, "none" or "white"), "area" (x, y, label, colour or "hatched",
alpha, at: the end of a bar), "cells" (x, y: edges; colours; data: packed indices of colours; values; names of values;
hatched) and "text". A shape is a marker of matplotlib.
"""

import base64
import re
from collections.abc import Iterator, Sequence
from io import BytesIO
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm, to_hex
from matplotlib.figure import Figure

from vibrojax.explorer.document import Document, json_value, one_line
from vibrojax.explorer.encoding import pack
from vibrojax.io.attributes import LONGEST_TEXT
from vibrojax.measures.labels import REGIMES
from vibrojax.pictures import plots
from vibrojax.pictures.axes import certified_text, point_text
from vibrojax.pictures.colours import Value
from vibrojax.pictures.plots import Plot, Sheet
from vibrojax.pictures.style import INK, settings

ITEM_MAX_POINTS = 20_000  # points of an item above which only every n-th is described

LABEL_MAX_CHARACTERS = 120

LOW_INCHES, WIDE_SHARE = 1.4, 0.62  # height up to which a plot is a strip; share of the width from which it is alone
LEAST_LINE = 0.03  # length of a line, as a share of the axes, below which it has no entry in the legend

IMAGE_DPI = 160

BAR_COLOURS = 64

_DASHES = {"--": (3.7, 1.6), ":": (1.0, 1.65), "-.": (6.4, 1.6, 1.0, 1.6)}


def figure_document(
    picture: plots.Picture | Figure,
    ds: xr.Dataset,
    axes: Sequence[Document],
    drawn: Sequence[str] = (),
    maps: bool = False,
) -> Document:
    """Return the description of a picture: its plots, or a figure as an image.

    Plots over the `axes` of the page's document are linked to them. The page itself draws the variables `drawn` over
    these axes, and maps over two of them unless `maps` is True.
    """
    if isinstance(picture, Figure):
        return {"plots": [], "keys": [], "bars": [], "images": [_image(picture)], "note": ""}
    sheet, bars = plots.as_sheet(picture), list[Document]()
    panels = [*_plots(sheet, ds, axes, drawn, maps, bars)]
    keys = {key["text"]: key for key in _keys(sheet)}
    note = sheet.note  # without what the head of the page says of the dataset
    for known in (point_text(ds), point_text(ds.squeeze()), certified_text(ds)):
        note = note.removeprefix(known).removeprefix(". ")
    items = [item for plot in panels for item in plot["items"]]
    colours = {colour for item in items for colour in (*item.get("colours", ()), item.get("colour", ""))}
    shapes = {item["shape"] for item in items if item["kind"] == "points"}
    # What the page draws itself has no entry here. A sign in ink stands for marks of any colour.
    occurring = [k for k in keys.values() if k["colour"] in colours or (k["colour"] == INK and k["shape"] in shapes)]
    shown = [_as_drawn(key, items) for key in occurring if not _is_hidden(key["text"], panels)]
    note = one_line(note, LONGEST_TEXT)
    return {"plots": panels, "keys": shown, "bars": bars, "images": [], "note": note}


def _is_hidden(label: str, panels: Sequence[Document]) -> bool:
    """Return whether all that has this label are lines too short to be seen, below the mark at their middle."""
    labelled = [(panel, item) for panel in panels for item in panel["items"] if item.get("label") == label]
    shares = [
        np.ptp([x for x in item[name] if x is not None] or [0.0]) / abs(np.ptp(panel[name]["limits"]) or 1.0)
        for panel, item in labelled
        for name in "xy"
    ]
    return bool(shares and max(shares) < LEAST_LINE and all(item["kind"] == "line" for _, item in labelled))


def _as_drawn(key: Document, items: Sequence[Document]) -> Document:
    """Give a sign in ink, which stands for marks of any colour, the colour of these marks if they have only one."""
    colours = {
        colour
        for item in items
        if item["kind"] == "points" and (item["shape"], item["sizes"][:1]) == (key["shape"], [key.get("size")])
        if any(y is not None for y in item["y"])
        for colour in item["colours"]
    }
    return key | {"colour": colours.pop()} if key["colour"] == INK and len(colours) == 1 else key


def _plots(
    sheet: Sheet, ds: xr.Dataset, axes: Sequence[Document], drawn: Sequence[str], maps: bool, bars: list[Document]
) -> Iterator[Document]:
    """Yield the descriptions of the plots of a sheet; their colour bars are added to `bars`."""
    columns = {
        column["name"]: f"{axis['name']}:{column['name']}" if axis["columns"] else axis["name"]
        for axis in axes
        for column in axis["columns"] or [axis]
    }
    directions = {n: way for n, way in columns.items() if n in ds.variables and (maps or ds[n].dtype.kind in "fiu")}
    titles: dict[int, str] = {}
    # In a picture, panels share the labels at the left and at the bottom; on the page each has its own.
    ups = {(plot.span[0], plot.y.group): plot.y.label for plot in reversed(sheet.plots) if plot.y.label}
    acrosses = {(plot.span[1], plot.x.group): plot.x.label for plot in sheet.plots if plot.x.label}
    beside: str | None = None
    for plot in plots.resolved(sheet.plots):
        x, y = directions.get(plot.x.name), directions.get(plot.y.name)
        row, column, deep, wide = plot.span
        titles.setdefault(row, plot.title)
        if not plot.layers or (x and ((y and not maps) or plot.y.name in drawn)):
            continue
        bar = None if plot.scale is None or plot.scale.name in drawn or plot.scale.names else _bar(plot.scale)
        bars += [bar] if bar and bar not in bars else []
        title = plot.title or plot.name or titles[row] or ("" if plot.x.label or plot.y.label else sheet.title)
        title = title or (bar["label"] if bar and not (plot.x.label and plot.y.label) else "")
        at = {
            name: int(indices[0])
            for name in (axis["name"] for axis in axes if axis["name"] in plot.at and axis["name"] in ds.coords)
            if (indices := np.flatnonzero(ds[name].values == plot.at[name])).size
        }
        share = sum(sheet.widths[column : column + wide]) / sum(sheet.widths)
        track, title = plot.y.reversed and plot.y.ticks is None, _plain(re.sub(r"\n(?=.*=)", ", ", title))
        bare, beside = track and beside == plot.y.label, plot.y.label if track else None
        yield {
            "title": title,
            "x": _axis(plot.x, x, acrosses.get((column, plot.x.group), "")),
            "y": _axis(plot.y, y, ups.get((row, plot.y.group), "")),
            "at": at,
            "wide": bool(share >= WIDE_SHARE),
            "low": bool(sheet.size[1] * sum(sheet.heights[row : row + deep]) / sum(sheet.heights) < LOW_INCHES),
            "square": plot.square,
            "bar": bars.index(bar) if bar else None,
            "track": track,
            "bare": bare,
            "items": items_of(plot),
        }


def _bar(value: Value) -> Document:
    colours = [to_hex(value.colour_map(level)) for level in np.linspace(0.0, 1.0, BAR_COLOURS)]
    low, high = (json_value(float(end or 0.0)) for end in (value.norm.vmin, value.norm.vmax))
    about = {"low": low, "high": high, "log": isinstance(value.norm, LogNorm), "extend": value.extend}
    return {"label": _plain(value.label), **about, "map": colours}


def _image(figure: Figure) -> Document:
    content = BytesIO()
    with settings():
        figure.savefig(content, format="png", dpi=IMAGE_DPI)
    title = figure.get_suptitle() or next((axes.get_title() for axes in figure.axes if axes.get_title()), "")
    return {"title": _plain(title), "data": f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"}


def _plain(text: str) -> str:
    return one_line(" ".join(text.split()), LABEL_MAX_CHARACTERS)


def _axis(axis: plots.Axis, direction: str | None, shared: str) -> Document:
    ticks = None if axis.ticks is None else [[json_value(float(x)), _plain(text)] for x, text in axis.ticks]
    return {
        "label": _plain(axis.label or (shared if axis.ticks is None else "")),
        "limits": [json_value(float(end or 0.0)) for end in axis.limits],
        "log": axis.log,
        "reversed": axis.reversed,
        "ticks": ticks,
        "direction": direction,
    }


def items_of(plot: Plot) -> list[Document]:
    """Return the descriptions of what a plot shows, in the order in which it is drawn."""
    layers = sorted(plot.layers, key=lambda layer: layer.order)
    return [item for layer in layers for item in _items(layer, plot)]


def _xy(plot: Plot, x: plots.Places, y: plots.Places) -> Document:
    """Return places, at most `ITEM_MAX_POINTS`; an infinite coordinate becomes the end of the axis."""
    item = {}
    pairs = np.broadcast_arrays(np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float)))
    for name, values, axis in zip("xy", pairs, (plot.x, plot.y), strict=True):
        low, high = (end or 0.0 for end in axis.limits)
        inside = np.where(values == np.inf, high, np.where(values == -np.inf, low, values))[:: _step(values)]
        item[name] = [json_value(float(value), 6) for value in inside.ravel()]
    return item


def _step(values: np.ndarray) -> int:
    return max(1, -(-len(values) // ITEM_MAX_POINTS))


def _items(layer: plots.Layer, plot: Plot) -> Iterator[Document]:
    about = {"label": "" if isinstance(layer, plots.Cells | plots.Text) else _plain(layer.label)}
    if isinstance(layer, plots.Line | plots.Points) and np.size(layer.x):
        points = _xy(plot, layer.x, layer.y)
        step = _step(np.broadcast_arrays(np.atleast_1d(layer.x), layer.y)[0])
        hollow = isinstance(layer, plots.Line) and layer.face in ("none", "white") and layer.face
        if isinstance(layer, plots.Line):
            if layer.dash:
                look = {"colour": to_hex(layer.colour), "width": layer.width, "dash": _dash(layer.dash, layer.width)}
                yield {"kind": "line", **about, **points, **look}
            colour = layer.colour if hollow else layer.face or layer.colour
            layer = plots.Points(layer.x, layer.y, colour, layer.size, layer.marker)
        if layer.marker:
            colours = [layer.colours] if isinstance(layer.colours, str) else list(layer.colours)[::step]
            sizes = [json_value(float(size) / 2, 3) for size in np.atleast_1d(layer.sizes)[::step]]
            look = {"colours": [to_hex(colour) for colour in colours], "sizes": sizes, "hollow": hollow}
            look["values"] = [json_value(float(value), 5) for value in np.asarray(layer.values)[::step]]
            yield {"kind": "points", **about, **points, **look, "shape": layer.marker}
    elif isinstance(layer, plots.Bars):
        sides = np.broadcast_arrays(layer.x, layer.y, layer.width, layer.height)
        colours = [layer.colours] if isinstance(layer.colours, str) else list(layer.colours)
        level = plot.y.ticks is not None and plot.x.ticks is None
        for k, (x, y, width, height) in enumerate(np.stack(sides, axis=-1).reshape(-1, 4)):
            corners = _xy(plot, [x, x + width, x + width, x], [y, y, y + height, y + height])
            tip = _xy(plot, [x + width / (2 - level)], [y + height / (1 + level)])
            look = {"colour": to_hex(colours[k % len(colours)]), "alpha": 1.0}
            yield {"kind": "area", **about, **corners, **look, "at": [tip["x"][0], tip["y"][0]]}
    elif isinstance(layer, plots.Area):
        x, low, high = (np.atleast_1d(np.asarray(values, float)) for values in (layer.x, layer.low, layer.high))
        if layer.step:
            x, low, high = np.repeat(x, 2)[1:], np.repeat(low, 2)[:-1], np.repeat(high, 2)[:-1]
        known = ~(np.isnan(x) | np.isnan(low) | np.isnan(high))
        for part in np.split(np.arange(len(x)), np.flatnonzero(~known)):  # a polygon for each part without gaps
            part = part[known[part]]
            if len(part):
                place = _xy(plot, np.append(x[part], x[part][::-1]), np.append(low[part], high[part][::-1]))
                colour = "hatched" if layer.hatch else to_hex(layer.colour)
                alpha = layer.alpha if layer.alpha < 0.9 else 1.0  # as in the legend
                yield {"kind": "area", **about, **place, "colour": colour, "alpha": alpha}
    elif isinstance(layer, plots.Cells):
        rgba = layer.colour_map(layer.norm(np.ma.masked_invalid(layer.values))).reshape(-1, 4)
        known = ~np.isnan(layer.values).ravel() & (rgba[:, 3] > 0)
        palette, levels = np.unique((rgba[known] * 255).round().astype(int), axis=0, return_inverse=True)
        indices = np.full(known.size, -1)
        indices[known] = levels.ravel()
        ends = {"x": np.asarray(layer.x, float).tolist(), "y": np.asarray(layer.y, float).tolist()}
        names = [to_hex(colour / 255) for colour in palette]
        texts = {str(flag): name for flag, name in enumerate(REGIMES)} if layer.colour_map.name == "regimes" else {}
        values = [json_value(value, 5) for value in layer.values.ravel().tolist()]
        packed = {"colours": names, "data": pack(indices.astype(np.int32)), "hatched": layer.hatched}
        yield {"kind": "cells", **ends, **packed, "values": values, "names": texts}
    elif isinstance(layer, plots.Text):
        places = [layer.x, layer.y]
        for k, axis in enumerate((plot.x, plot.y) if layer.relative else ()):
            share = 1 - places[k] if axis.reversed else places[k]
            begin, end = (limit or 0.0 for limit in axis.limits)
            places[k] = begin * (end / begin) ** share if axis.log else begin + share * (end - begin)
        yield {
            "kind": "text",
            **_xy(plot, places[:1], places[1:]),
            "text": _plain(layer.text),
            "colour": to_hex(layer.colour),
            "align": layer.align,
            "baseline": layer.baseline if layer.baseline in ("top", "bottom") else "middle",
        }


def _dash(dash: plots.Dash, width: float) -> list[float]:
    lengths = _DASHES.get(dash, ()) if isinstance(dash, str) else dash[1]
    return [round(1.3 * width * float(x), 3) for x in lengths]


def _keys(sheet: Sheet) -> Iterator[Document]:
    """Yield the entries of the legends."""
    own = [entry for plot in sheet.plots if plot.keys for entry in plots.labelled_layers(plot)]
    for entry in (*own, *(entry for group in plots.legend_of(sheet) for entry in group)):
        key: dict[str, Any] = {"text": _plain(entry.label), "dash": [], "hollow": False}
        if isinstance(entry, plots.Area):
            yield key | {"shape": "patch", "colour": "hatched" if entry.hatch else to_hex(entry.colour)}
            continue
        key |= {"colour": to_hex(entry.colour), "hollow": entry.face in ("none", "white")}
        if not entry.dash:
            yield key | {"shape": entry.marker or "o", "size": json_value(float(entry.size) / 2, 3)}
            continue
        marker = {"marker": entry.marker} if entry.marker else {}
        yield key | {"shape": "line", "dash": _dash(entry.dash, entry.width)} | marker
