"""The picture of an analysis as a JSON description of plots, which the explorer page draws and links to its cursor.

A description holds the plots of the figure and the entries of its legends:

    {"plots": [{"title", "x", "y": {"label", "limits", "log", "reversed", "ticks": [[value, text]] | null,
                                    "direction": id of the page's direction along the axis, or null},
                "at": {axis: index}: the map cells that the plot shows, "wide", "low", "square", "items": [...]}],
     "keys": [{"text", "colour", "shape": "line", "patch" or a mark, "dash": [...]}]}

Items are in data coordinates, each with a "kind": "line" (x, y, colour, width, dash), "points" (x, y, colours, sizes,
shape, hollow), "area" (x, y, colour, alpha), "cells" (x, y: edges; colours; data: packed indices of
colours) and "text".
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import Collection, LineCollection, PathCollection, PolyCollection, QuadMesh
from matplotlib.colors import BoundaryNorm, to_hex, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedFormatter, FuncFormatter
from matplotlib.transforms import IdentityTransform, Transform

from vibrojax.explorer.document import Document, json_value, one_line
from vibrojax.explorer.encoding import pack
from vibrojax.pictures.axes import label, value_text
from vibrojax.pictures.colours import REGIME_COLOURS

ITEM_MAX_POINTS = 20_000
"""Number of points of an item above which only every n-th is described; a screen has fewer pixels."""

LABEL_MAX_CHARACTERS = 120

LOW_INCHES, WIDE_SHARE = 1.1, 0.45
"""Height below which a plot is a strip, and share of the figure's width from which it has a row of its own."""

_REGIME_COLOURS = {to_hex(colour) for colour in REGIME_COLOURS.values()}

_SHAPES = {
    **{"o": "circle", ".": "circle", "s": "square", "D": "diamond", "*": "diamond", "P": "square", "X": "cross"},
    **{"^": "triangle", "v": "triangle", "<": "triangle", ">": "triangle", "x": "cross", "+": "cross", "|": "bar"},
}


def figure_document(
    figures: Sequence[Figure], ds: xr.Dataset, axes: Sequence[Document], drawn: Sequence[str] = ()
) -> Document:
    """Return the description of figures.

    **Arguments:** `axes`: the axes of the page's document, to which plots with the same labels are linked; `drawn`:
    labels of what the page draws over these axes itself. It also draws maps over two of them.
    """
    for figure in figures:
        figure.canvas.draw()
    directions = _directions(ds, axes)
    plots = []
    for panel in [panel for figure in figures for panel in figure.axes]:
        is_bar = panel.get_label() == "<colorbar>" or hasattr(panel, "_colorbar")
        if not panel.axison or is_bar or not panel.has_data():
            continue
        plot = _plot(panel, directions, ds, axes)
        is_map = bool(plot["x"]["direction"]) and bool(plot["y"]["direction"])
        is_curve = bool(plot["x"]["direction"]) and plot["y"]["label"] in drawn
        if plot["items"] and not is_map and not is_curve:
            plots.append(plot)
    keys = {key["text"]: key for figure in figures for panel in figure.axes for key in _scale_of(panel, drawn)}
    legends = [
        legend for figure in figures for legend in (*figure.legends, *(panel.get_legend() for panel in figure.axes))
    ]
    for legend in legends:
        for key in _keys(legend) if legend is not None else ():
            keys.setdefault(key["text"], key)
    return {"plots": plots, "keys": list(keys.values())}


def _directions(ds: xr.Dataset, axes: Sequence[Document]) -> dict[str, str]:
    """Return the ids of the page's directions by the labels that pictures give to axes."""
    ids = {}
    for axis in axes:
        columns = {f"{axis['name']}:{column['name']}": column["name"] for column in axis["columns"]}
        for direction, name in (columns or {axis["name"]: axis["name"]}).items():
            if name in ds.variables and ds[name].dtype.kind in "fiu":
                ids[_plain(label(ds[name]))] = direction
    return ids


def _plain(text: str) -> str:
    return one_line(" ".join(text.replace("$", "").split()), LABEL_MAX_CHARACTERS)


def _plot(panel: Axes, directions: dict[str, str], ds: xr.Dataset, axes: Sequence[Document]) -> Document:
    title = _title(panel) or _row_title(panel)
    place, whole = panel.get_window_extent(), panel.figure.bbox
    at = {
        axis["name"]: index
        for axis in axes
        if axis["name"] in ds.coords and title
        for index, value in enumerate(ds[axis["name"]].values)
        if value_text(ds[axis["name"]], value) in title.split(", ")
    }
    items = items_of(panel)
    strips = [set(item["colours"]) for item in items if item["kind"] == "cells"]
    if not title and not panel.get_ylabel() and strips and set.union(*strips) <= _REGIME_COLOURS:
        title = "regimes"
    return {
        "title": title,
        "x": _axis(panel, "x", directions),
        "y": _axis(panel, "y", directions),
        "at": at,
        "wide": bool(place.width >= WIDE_SHARE * whole.width),
        "low": bool(place.height < LOW_INCHES * panel.figure.get_dpi()),
        "square": panel.get_aspect() == 1.0,
        "items": items,
    }


def _scale_of(panel: Axes, drawn: Sequence[str]) -> Iterator[Document]:
    """Yield the key of a colour bar, unless the page draws the bar itself."""
    bar = getattr(panel, "_colorbar", None)
    text = _plain(panel.get_ylabel() or panel.get_xlabel())
    if bar is None or isinstance(bar.norm, BoundaryNorm) or text in drawn:
        return
    low, high = (f"{x:.3g}".replace("-", "−") for x in (bar.vmin, bar.vmax))
    colours = [_hex(bar.cmap(level)) for level in np.linspace(0.0, 1.0, 9)]
    key = {"shape": "scale", "colour": colours[4], "colours": colours, "dash": []}
    yield key | {"text": f"{text}: {low} to {high}" if text else f"{low} to {high}"}


def _title(panel: Axes) -> str:
    return _plain(next(filter(None, (panel.get_title(loc) for loc in ("left", "center", "right"))), ""))


def _row_title(panel: Axes) -> str:
    """Return the title of a panel's row, which pictures write over its first panel, or of a figure without labels."""
    spec = panel.get_subplotspec()
    for first in panel.figure.axes if spec is not None else ():
        place = first.get_subplotspec()
        if place is None or first.get_gridspec() is not panel.get_gridspec() or not _title(first):
            continue
        if spec and (place.rowspan.start, place.colspan.start) == (spec.rowspan.start, 0):
            return _title(first)
    return "" if panel.get_xlabel() or panel.get_ylabel() else _plain(panel.figure.get_suptitle())


def _axis(panel: Axes, name: str, directions: dict[str, str]) -> Document:
    axis = getattr(panel, f"{name}axis")
    joined = getattr(panel, f"get_shared_{name}_axes")().get_siblings(panel)
    own = axis.get_label().get_text()
    text = _plain(own or next(filter(None, (getattr(other, f"get_{name}label")() for other in joined)), ""))
    limits = sorted(getattr(panel, f"get_{name}lim")())
    ticks = None
    if axis.get_scale() not in ("linear", "log") or isinstance(
        axis.get_major_formatter(), FixedFormatter | FuncFormatter
    ):
        places = axis.get_majorticklocs()
        texts = axis.get_major_formatter().format_ticks(places)
        inside = [(x, t) for x, t in zip(places, texts, strict=True) if limits[0] <= x <= limits[1]]
        values = _scaled(panel, name, np.array([x for x, _ in inside], float))
        ticks = [[json_value(float(x)), _plain(t)] for x, (_, t) in zip(values, inside, strict=True)]
    ends = _scaled(panel, name, np.array(limits, float))
    return {
        "label": text,
        "limits": [json_value(float(x)) for x in ends],
        "log": axis.get_scale() == "log",
        "reversed": bool(axis.get_inverted()),
        "ticks": ticks,
        "direction": directions.get(text),
    }


def _scaled(panel: Axes, name: str, values: np.ndarray) -> np.ndarray:
    """Return values as the page draws them: those of axes that are neither linear nor logarithmic are transformed."""
    axis = getattr(panel, f"{name}axis")
    return values if axis.get_scale() in ("linear", "log") else axis.get_transform().transform(values)


def _xy(panel: Axes, points: Any, transform: Transform) -> Document:
    """Return points in the plot's data coordinates, given those before a transform to the screen."""
    points = np.asarray(points, float).reshape(-1, 2)
    if transform != panel.transData:
        points = panel.transData.inverted().transform(transform.transform(points))
    points = points[:: max(1, -(-len(points) // ITEM_MAX_POINTS))]
    names = zip("xy", points.T, strict=True)
    return {name: [json_value(float(f"{x:.6g}")) for x in _scaled(panel, name, values)] for name, values in names}


def items_of(panel: Axes) -> list[Document]:
    """Return the descriptions of what a panel shows, in the order in which it is drawn."""
    artists = sorted(panel.get_children(), key=Artist.get_zorder)
    shown_artists = [artist for artist in artists if artist.get_visible() and artist is not panel.patch]
    return [item for artist in shown_artists for item in _described(panel, artist)]


def _described(panel: Axes, artist: Artist) -> Iterator[Document]:
    """Yield the descriptions of an artist."""
    if isinstance(artist, Line2D):
        yield from _of_line(panel, artist)
    elif isinstance(artist, QuadMesh | AxesImage):
        yield _of_cells(panel, artist)
    elif isinstance(artist, PathCollection):
        yield _of_points(panel, artist)
    elif isinstance(artist, LineCollection):
        colours = [_hex(colour) for colour in artist.get_colors()] or ["#222222"]
        dash = _dash(artist.get_linestyle()[0] if len(artist.get_linestyle()) else None)
        for k, segment in enumerate(artist.get_segments()):
            look = {"colour": colours[k % len(colours)], "width": 1.2, "dash": dash}
            yield {"kind": "line", **_xy(panel, segment, artist.get_transform()), **look}
    elif isinstance(artist, PolyCollection):
        for path in artist.get_paths():
            yield from _area(panel, path.vertices, artist.get_transform(), artist)
    elif isinstance(artist, Patch):
        for polygon in artist.get_path().to_polygons(artist.get_transform()):
            if artist.get_fill():
                yield from _area(panel, polygon, IdentityTransform(), artist)
            else:
                look = {"colour": _hex(artist.get_edgecolor()), "width": 1.2, "dash": []}
                yield {"kind": "line", **_xy(panel, polygon, IdentityTransform()), **look}
    elif isinstance(artist, Text) and artist.get_text() and artist in panel.texts:
        place, transform = artist.get_position(), artist.get_transform()
        if isinstance(artist, Annotation):
            place, transform = artist.xy, panel.transAxes if artist.xycoords == "axes fraction" else panel.transData
        level = artist.get_verticalalignment()
        yield {
            "kind": "text",
            **_xy(panel, np.array(place, float), transform),
            "text": _plain(artist.get_text()),
            "colour": _hex(artist.get_color()),
            "align": artist.get_horizontalalignment(),
            "baseline": level if level in ("top", "bottom") else "middle",
        }


def _area(panel: Axes, points: Any, transform: Transform, artist: Collection | Patch) -> Iterator[Document]:
    face = to_rgba_array(artist.get_facecolor())
    if len(face) and face[0, 3] > 0:
        look = {"colour": _hex(face[0]), "alpha": json_value(float(face[0, 3]))}
        yield {"kind": "area", **_xy(panel, points, transform), **look}


def _of_line(panel: Axes, line: Line2D) -> Iterator[Document]:
    points = _xy(panel, line.get_xydata(), line.get_transform())
    if line.get_linestyle() not in ("None", "none", "", " "):
        look = {"colour": _hex(line.get_color()), "width": line.get_linewidth(), "dash": _dash(line._dash_pattern)}  # type: ignore[attr-defined]
        yield {"kind": "line", **points, **look}
    if (shape := _SHAPES.get(str(line.get_marker()))) is not None:
        yield {"kind": "points", **points, "shape": shape, "sizes": [line.get_markersize() / 2], **_faces(line)}


def _faces(line: Line2D) -> Document:
    face = line.get_markerfacecolor()
    hollow = str(face) in ("none", "white", "w")
    return {"colours": [_hex(line.get_markeredgecolor() if hollow else face)], "hollow": hollow}


def _of_points(panel: Axes, dots: PathCollection) -> Document:
    faces, edges = np.asarray(dots.get_facecolor()), np.asarray(dots.get_edgecolor())
    hollow = not len(faces) or bool((faces[:, 3] == 0).all())
    colours = [_hex(colour) for colour in (edges if hollow else faces)]
    corners = len(np.asarray(dots.get_paths()[0].vertices)) if dots.get_paths() else 0
    shape = "circle" if corners > 12 else {3: "triangle", 4: "triangle", 5: "square"}.get(corners, "diamond")
    sizes = [json_value(float(f"{np.sqrt(size) / 2:.3g}")) for size in dots.get_sizes()]
    points = _xy(panel, np.asarray(dots.get_offsets(), float), dots.get_offset_transform())
    return {"kind": "points", **points, "colours": colours, "sizes": sizes, "shape": shape, "hollow": hollow}


def _of_cells(panel: Axes, cells: ScalarMappable) -> Document:
    array = np.ma.masked_invalid(np.asarray(cells.get_array(), float))
    if isinstance(cells, QuadMesh):
        corners = np.asarray(cells.get_coordinates())
        xs, ys = corners[0, :, 0], corners[:, 0, 1]
        array = array.reshape(corners.shape[0] - 1, corners.shape[1] - 1)
    else:
        left, right, bottom, top = cells.get_extent()  # type: ignore[attr-defined]
        xs, ys = np.linspace(left, right, array.shape[1] + 1), np.linspace(bottom, top, array.shape[0] + 1)
        array = array if cells.origin == "lower" else array[::-1]  # type: ignore[attr-defined]
        if top < bottom:
            array, ys = array[::-1], ys[::-1]
    colours = cells.to_rgba(array).reshape(-1, 4)
    palette, indices = np.unique((colours * 255).round().astype(int), axis=0, return_inverse=True)
    indices = np.where(np.ma.getmaskarray(array).ravel() | (colours[:, 3] == 0), -1, indices.ravel())
    ends = {"x": xs.tolist(), "y": ys.tolist()}
    names = [_hex(colour / 255) for colour in palette]
    return {"kind": "cells", **ends, "colours": names, "data": pack(indices.astype(np.int32))}


def _hex(colour: Any) -> str:
    return str(to_hex(colour))


def _dash(pattern: Any) -> list[float]:
    dashes = pattern[1] if isinstance(pattern, tuple) and len(pattern) == 2 else None
    return [float(x) * 1.3 for x in dashes] if dashes else []


def _keys(legend: Legend) -> Iterator[Document]:
    for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
        key: Document = {"text": _plain(text.get_text()), "dash": []}
        if isinstance(handle, Line2D):
            has_line = handle.get_linestyle() not in ("None", "none", "", " ")
            shape = "line" if has_line else _SHAPES.get(str(handle.get_marker()), "circle")
            colour = handle.get_color() if has_line else _faces(handle)["colours"][0]
            key |= {"shape": shape, "colour": _hex(colour), "dash": _dash(handle._dash_pattern)}  # type: ignore[attr-defined]
        elif isinstance(handle, Patch):
            key |= {"shape": "patch", "colour": _hex(handle.get_facecolor())}
        elif isinstance(handle, Collection) and len(faces := handle.get_facecolor()):
            key |= {"shape": "circle", "colour": _hex(faces[0])}
        else:
            continue
        if key["text"]:
            yield key
