"""Maps over two parameters, as cells of a grid or as dots of a list of points: regimes, other quantities, rates."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool

from vibrojax.errors import InputError
from vibrojax.io.kinds import kind_of
from vibrojax.pictures import axes, colours, contents
from vibrojax.pictures.colours import Value
from vibrojax.pictures.contents import HIDDEN, POINT, REGIME, SENSITIVE, START, lane_dims, varied
from vibrojax.pictures.layout import LEGEND_WIDTH, MOST_PANELS, Facets, at, facets, is_narrow
from vibrojax.pictures.lines import across, dot_size, lane_dots
from vibrojax.pictures.overlays import check_borders, codim2_layers, over_map_text, over_panel
from vibrojax.pictures.plots import Cells, Layer, Line, Look, Plot, Points, Sheet, colours_of, dots, one_colour
from vibrojax.pictures.style import DASHED, NO_VALUE, NOTHING

Values = Sequence[Value]

_MOST_BESIDE = 3  # for up to this many facets, quantities are to the right of the regimes, else below
_MOST_COLUMNS = 6
_NARROW_COLUMNS = 2  # of a narrow picture, in which many facets show one quantity
_SQUARE_FROM, _SQUARE_COLUMNS = 4, (2, 3)  # number of quantities from which a single facet has several rows
_MOST_RATES = {1: 4, 2: 3, 3: 3}  # quantities on maps of rates, by the number of facets; else only the rate
_MANY_VALUES = 4  # number of quantities from which on half as many facets are drawn
_LETTERS_PER_INCH = 17  # number of characters that fit on an axis label per inch of the axis
_DOT, _MANY_DOTS = 4.5, 600  # diameter of a dot [pt], and number of points from which on dots are smaller
_SYMBOLS = {"mean_force": "P", "relief": "P/D"}
_MOST_DOT_COLUMNS = 4

# The region of parameters with "best" stable single impacts (source, chapter 5).
REGION = {"beta": (0.25, 0.60), "gamma": (0.60, 0.80)}


def maps_of(
    panels: Facets,
    values: Values,
    x: xr.DataArray,
    y: xr.DataArray,
    layers_of: Callable[[xr.Dataset, Value], list[Layer]],
    points: bool = False,
) -> Sheet:
    """Return maps of `values` over `x` and `y`, one for each facet, in the colours of all facets.

    Up to three facets have one row each. Four or more quantities of a single facet have two columns, or three if the
    last row is then fuller. With more facets, the maps of each quantity are a block of rows. `points`: whether the
    lanes are a list of points, rather than a grid.
    """
    count, many = len(panels), len(values)
    if blocks := count > _MOST_BESIDE or (is_narrow() and count == _NARROW_COLUMNS):
        of_facets = panels.places(_NARROW_COLUMNS if is_narrow() else _MOST_COLUMNS)
        block = 1 + max(row for row, _ in of_facets)
        places = [(row + i * block, column) for row, column in of_facets for i in range(many)]
    else:
        across = many
        if count == 1 and many >= _SQUARE_FROM:
            across = min(_SQUARE_COLUMNS, key=lambda wide: -many % wide / wide)
        places = [divmod(k, across) for k in range(count * many)]
    deep, wide = (max(ends) + 1 for ends in zip(*places, strict=True))
    width, height = (2.75 if wide <= 4 else 2.2, 2.1) if blocks else (3.4 if wide > 1 else 4.4, 2.7)
    of, letters = axes.axis if points else axes.map_axis, int(_LETTERS_PER_INCH * 0.75 * height)
    # Few ticks: no "-2.5", which would touch the tick labels of the next panel.
    right, up = of(x, group="x", intervals=6), of(y, label=axes.label(y, letters), group="y")
    plots = []
    for k, (title, facet) in enumerate(panels):
        for value, place in zip(values, places[k * many :], strict=False):
            words = ", ".join(filter(None, (title * (blocks or not place[1]), value.label * value.counted)))
            words = axes.broken_title(words, int(13 * width))
            layers, scale = [*layers_of(facet, value), *region(x, y)], None if value.counted else value
            plots.append(Plot(layers, right, up, words, place, at(facet), scale=scale))
    bars = sum(not value.counted for value in values) if blocks or wide < many else 1
    size = width * wide + LEGEND_WIDTH + 0.3, height * deep + 0.6 * bars + 0.6
    return Sheet(sorted(plots, key=lambda plot: plot.place), size)


def region(x: xr.DataArray, y: xr.DataArray) -> list[Line]:
    """Return the border of the source's region of best single impacts, open where the map cuts it."""
    if {x.name, y.name} != set(REGION):
        return []
    (west, east), (south, north) = (REGION[str(data.name)] for data in (x, y))
    xs, ys = np.array([west, east, east, west, west]), np.array([south, south, north, north, south])
    across, up = (np.clip(at, float(data.min()), float(data.max())) for at, data in ((xs, x), (ys, y)))
    if not (np.ptp(across) and np.ptp(up)):
        return []
    # A side that the map cuts off is moved at both of its ends.
    cut = [(a != b)[:-1] & (a != b)[1:] & (np.diff(a) == 0) for a, b in ((xs, across), (ys, up))]
    gaps = 1 + np.flatnonzero(cut[0] | cut[1])
    path = np.insert(across, gaps, np.nan), np.insert(up, gaps, np.nan)
    return [Line(*path, width=1.3, dash=DASHED, halo=0.6, label="source's best region", order=3.0)]


def map_sheet(ds: xr.Dataset, x: str, y: str, values: Values, *notes: str, over: Sequence[xr.Dataset] = ()) -> Sheet:
    """Draw `values` over the parameters `x` and `y`, with `notes`, and with the borders `over` on the regime map."""
    for layer in over:
        check_borders(ds, layer, x, y)
    points, lines = POINT in lane_dims(ds), False
    ds = ds if points else ds.sortby([x, y])
    panels = split_starts(ds) if points else facets(ds, (x, y), MOST_PANELS // (1 + (len(values) >= _MANY_VALUES)))
    if len(panels) > (_MOST_BESIDE if is_narrow() else _MOST_COLUMNS) and values[1:]:
        names = ", ".join(value.name for value in values[1:])
        values, notes = values[:1], (*notes, f"Room for one variable; not shown: {names}")

    def layers_of(facet: xr.Dataset, value: Value) -> list[Layer]:
        nonlocal lines
        if points or not value.counted:
            return (point_layers if points else cell_layers)(facet, value, x, y)
        borders = [border for layer in over for border in over_panel(layer, facet, x, y)]
        lines |= bool(borders)
        curves = [layer for layer in over if kind_of(layer) == "curves"] if lines else []
        return [*cell_layers(facet, value, x, y), *_marks(facet, x, y), *borders, *codim2_layers(curves, x, y)]

    sheet = maps_of(panels, values, ds[x], ds[y], layers_of, points)
    texts = dict.fromkeys(over_map_text(layer, lines) for layer in over)
    about = axes.margins(ds, axes.certified_text(ds), panels.note, *notes, *texts)
    return replace(sheet, keys=[colours.cell_keys(panels.data, values)], **about)


def regime_grid(ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> Sheet:
    """Draw the regimes over two axes, with further quantities next to them, and the borders `over` on top."""
    ds = colours.regimes_in(ds)
    x, y = varied(ds) if POINT in lane_dims(ds) else contents.axes_of_map(ds)
    if (x, y) == ("beta", "gamma"):
        x, y = y, x
    # Curves and their points need the width of the page.
    alone = any(kind_of(layer) == "curves" for layer in over)
    return map_sheet(
        ds, x, y, [colours.regime_value(ds[REGIME]), *([] if alone else colours.values_beside(ds))], over=over
    )


def rate_grid(ds: xr.Dataset) -> Sheet:
    """Draw the rate of penetration over two axes, and the quantities that vary; a note lists constant ones."""
    ds = contents.rates_in(ds)
    values = colours.values_of_rock(ds)
    if POINT in lane_dims(ds):
        names = tuple(varied(ds))
        if len(names) != 2:
            raise InputError(f"no map: {', '.join(names) or 'none'} is what varies over the points, not two parameters")
        regimes = [colours.regime_value(ds[REGIME])] if REGIME in ds else []
        return map_sheet(ds, *names, [*regimes, *values[: _MOST_RATES[3]]])
    x, y = contents.axes_of_map(ds, *contents.long_axes(ds))
    panels = prod(ds.sizes[name] for name in lane_dims(ds) if name not in (x, y))
    # The values that all lanes share are in the note; the relief is proportional to a mean force that is drawn.
    given = {value.name for value in values}
    given |= {"relief"} if "mean_force" in given else set()
    fixed = [ds[name].assign_attrs(symbol=text) for name, text in _SYMBOLS.items() if name in ds and name not in given]
    texts = [axes.value_text(data, float(data.max())) for data in fixed if data.notnull().any()]
    return map_sheet(ds, x, y, values[: _MOST_RATES.get(panels, 1)], ", ".join(texts))


# Cells of a grid.


def cell_layers(facet: xr.Dataset, value: Value, x: str, y: str) -> list[Layer]:
    """Return the cells of `value` over two axes; of rates, with white ones of 0 and the border of single impacts."""
    cells = np.asarray(value.of(facet).transpose(y, x).values, float)
    right, top = (axes.edges(axes.values_along(facet[name])) for name in (x, y))
    layers: list[Layer] = [Cells(right, top, cells, value.colour_map, value.norm)]
    if not value.of_rate:
        return layers
    if (cells == 0).any():
        layers.append(one_colour(right, top, cells == 0, NOTHING, order=0.5))
    if REGIME in facet:
        single = facet[REGIME].transpose(y, x).values == colours.SINGLE
        layers += outline(single, right, top, width=1.0, label="border of single impact")
    return layers


def outline(mask: Bool[np.ndarray, "y x"], right: np.ndarray, top: np.ndarray, **look: Any) -> list[Layer]:
    """Return the line between cells inside and outside of a mask, whose edges are `right` and `top`."""
    across, along = np.argwhere(mask[:, 1:] != mask[:, :-1]), np.argwhere(mask[1:] != mask[:-1])
    lines = [(right[j + 1], right[j + 1], np.nan, top[i], top[i + 1], np.nan) for i, j in across]
    lines += [(right[j], right[j + 1], np.nan, top[i + 1], top[i + 1], np.nan) for i, j in along]
    table = np.array(lines).reshape(-1, 6)
    return [Line(table[:, :3].ravel(), table[:, 3:].ravel(), halo=0.6, **look)] if lines else []


def _marks(facet: xr.Dataset, x: str, y: str) -> list[Layer]:
    # Two lines: a longer legend entry would make its panel wider than the others.
    hidden = dots(label="same label, other motion\nfrom another start", size=2.8, edge="white", edge_width=0.4)
    layers: list[Layer] = []
    for name, mark in ((HIDDEN, hidden), (SENSITIVE, colours.SENSITIVE_KEY)):
        rows, columns = np.nonzero(facet[name].transpose(y, x).values == 1) if name in facet else ((), ())
        if len(rows):
            layers.append(replace(mark, x=axes.values_along(facet[x])[columns], y=axes.values_along(facet[y])[rows]))
    return layers


# Dots of a list of points.


def point_layers(ds: xr.Dataset, value: Value, x: str, y: str) -> list[Layer]:
    """Return each lane as a dot, coloured by `value`."""
    cells = np.asarray(value.of(ds).values, float)
    nothing = (cells == 0) & value.of_rate
    known = np.isfinite(cells) & ~nothing
    many = cells.size > _MANY_DOTS
    size, width = (_DOT * np.sqrt(_MANY_DOTS / cells.size), 0.0) if many else (_DOT, 0.3)
    gap, edge = NO_VALUE["edgecolor"], "#4D4D4D"
    looks: list[tuple[np.ndarray, Look]] = [
        (np.isnan(cells), {"colours": NO_VALUE["facecolor"], "edge": gap, "hatch": NO_VALUE["hatch"]}),
        (nothing, {"colours": NOTHING, "edge": edge}),
        (
            known,
            {"colours": colours_of(cells[known], value.colour_map, value.norm), "edge": edge, "values": cells[known]},
        ),
    ]
    across, up = axes.values_along(ds[x]), axes.values_along(ds[y])
    about: Look = {"sizes": float(size), "edge_width": width}
    return [Points(across[mask], up[mask], **about | look) for mask, look in looks if mask.any()]


def split_starts(ds: xr.Dataset) -> Facets:
    """Return a facet for each value of the dimension or coordinate `start` of points, or one for many of them."""
    if contents.many_starts(ds):
        return Facets((f"{ds.sizes[START]} starts together",), (ds,))
    if START not in ds.coords or ds[START].ndim == 0:
        return Facets(("",), (ds,))
    values = ds[START].values.astype(str)
    names = dict.fromkeys(values.tolist())
    data = tuple(ds.isel({ds[START].dims[0]: np.flatnonzero(values == name)}) for name in names)
    data = tuple(facet.squeeze(START) if START in ds.dims else facet for facet in data)
    return Facets(tuple(f"start: {axes.short(name)}" for name in names), data, (len(names),))


# Lanes without a map.


def regime_dots(ds: xr.Dataset) -> Sheet:
    """Draw the quantities beside the regimes over each parameter of a list of points, or over the starts of a machine.

    Dots have the colours of the regimes, which are the ordinate if there is no such quantity.
    """
    ds = colours.regimes_in(ds)
    values, regimes = colours.values_beside(ds) or [colours.value_of(ds[REGIME])], ds[REGIME]
    names = [*dict.fromkeys([*varied(ds), *varied(ds, names=True), *contents.named_axes(ds)])]
    places = [across(ds, name) for name in names[:_MOST_DOT_COLUMNS] or [""]]

    def of_lanes(data: xr.DataArray) -> np.ndarray:
        return np.asarray(data.broadcast_like(regimes).transpose(*regimes.dims).values, float).ravel()

    edge: Look = {"edge": "#4D4D4D", "edge_width": 0.3}
    plots, cells, size = [], colours.regime_cells(regimes).ravel(), dot_size(regimes.size)
    for row, value in enumerate(values):
        heights, up = of_lanes(value.of(ds)), colours.value_axis(value, group=value.name)
        for column, x in enumerate(places):
            along = of_lanes(xr.DataArray(x.of(ds), dims=ds[x.name].dims) if x.name else xr.zeros_like(regimes))
            shown = replace(lane_dots(along, heights, cells, size), **edge)
            place = (row, column) if places[1:] else (column, row)
            plots.append(Plot([shown], x.axis(ds, group=x.name), up, place=place))
    keys = [dots(label=x.label, colour=x.colour, size=5.0, **edge) for x in colours.regime_keys([regimes])]
    missing = [int(np.isnan(of_lanes(value.of(ds))).sum()) for value in values]
    texts = [f"{n} lanes have no {colours.words_for(x.name)}" for n, x in zip(missing, values, strict=True) if n]
    more = f"Also varied: {', '.join(names[_MOST_DOT_COLUMNS:])}" if names[_MOST_DOT_COLUMNS:] else ""
    deep, wide = (1 + max(ends) for ends in zip(*(plot.place for plot in plots), strict=True))
    sheet = 0.6 + 2.8 * wide + LEGEND_WIDTH, 0.8 + 2.3 * deep
    return Sheet(plots, sheet, keys=[keys], **axes.margins(ds, axes.certified_text(ds), *texts, more))
