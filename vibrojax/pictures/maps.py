"""Maps over two parameters, as cells of a grid or as dots of a list of points: regimes, other quantities, rates.

Many initial conditions are drawn one by one or as fractions of regimes; lanes without a map are counted by regime.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from contourpy import contour_generator
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.ticker import MaxNLocator

from vibrojax.errors import InputError
from vibrojax.io.kinds import kind_of
from vibrojax.pictures.axes import (
    axis,
    certified_text,
    edges,
    label,
    map_axis,
    margins,
    point_text,
    share_text,
    short,
    value_text,
    values_along,
)
from vibrojax.pictures.colours import (
    REGIME_COLOURS,
    SENSITIVE_KEY,
    SINGLE,
    Value,
    Values,
    cell_keys,
    coloured,
    regime_counts,
    regime_keys,
    regime_names,
    share_value,
    values_beside,
    values_of_rock,
)
from vibrojax.pictures.contents import (
    ENOUGH,
    HIDDEN,
    POINT,
    REGIME,
    RELIEF,
    SENSITIVE,
    START,
    axes_of_map,
    lane_dims,
    long_axes,
    rates_in,
    regimes_in,
    swept,
    varied,
)
from vibrojax.pictures.contents import many_starts as has_many_starts
from vibrojax.pictures.lines import regime_lines
from vibrojax.pictures.overlays import check_borders, codim2_layers, over_map_text, over_panel
from vibrojax.pictures.plots import (
    INK,
    Axis,
    Bars,
    Cells,
    Layer,
    Line,
    Look,
    Plot,
    Points,
    Scale,
    Sheet,
    Text,
    colours_of,
    dots,
)
from vibrojax.pictures.sheet import MOST_PANELS, Facets, Panel, at, facets, layout
from vibrojax.pictures.starts import (
    PREFIX,
    SHARE,
    described,
    left_out_text,
    medians,
    medians_text,
    on_axes,
    regime_shares,
    varied_states,
)
from vibrojax.pictures.style import NO_VALUE, NOTHING

_MOST_VALUES = {1: 4, 2: 3, 3: 3}  # of quantities on maps of rates, by the number of facets; else only the rate
_MOST_RATE_FACETS = 9
_MANY_VALUES = 4  # number of quantities from which on half as many facets are drawn
_RELIEF_LEVELS = 5  # approximate number of contour lines of the relief
_CONSTANT_RELIEF = 1e-9  # largest relative range of a relief that counts as constant
_LETTERS_PER_INCH = 17  # number of characters that fit on an axis label per inch of the axis
_DOT, _MANY_DOTS = 4.5, 600  # diameter of a dot [pt], and number of points from which on dots are smaller
_SYMBOLS = {"mean_force": "P", "relief": "P/D"}
_LABEL_ROOM = (0.11, 0.06)  # width and height around the label of a contour line, as fractions of the panel
_MOST_BAR_COLUMNS = 4
_MOST_SHARES = 5  # number of fractions drawn as maps if there is a single facet

# The region of parameters with "best" stable single impacts (source, chapter 5).
REGION = {"beta": (0.25, 0.60), "gamma": (0.60, 0.80)}


def regime_grid(ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> Sheet:
    """Draw the regimes over two axes, with further quantities next to them, and the borders `over` on top.

    Each value of further axes and each initial condition gets a panel, twelve at most; the figure notes which values
    are shown.
    """
    ds = regimes_in(ds)
    x, y = varied(ds) if POINT in lane_dims(ds) else axes_of_map(ds)
    if POINT in lane_dims(ds) and (x, y) == ("beta", "gamma"):
        x, y = y, x
    # Curves and their points need the width of the page.
    beside = () if any(kind_of(layer) == "curves" for layer in over) else values_beside(ds)
    return map_sheet(ds, x, y, (None, *beside), over=over)


def map_sheet(ds: xr.Dataset, x: str, y: str, values: Values, *notes: str, over: Sequence[xr.Dataset] = ()) -> Sheet:
    """Draw `values` over the parameters `x` and `y`, with `notes`, and with the borders `over` on the regime map."""
    for layer in over:
        check_borders(ds, layer, x, y)
    points = POINT in lane_dims(ds)
    ds = ds if points else ds.sortby([x, y])
    panels = split_starts(ds) if points else facets(ds, (x, y), MOST_PANELS // (1 + (len(values) >= _MANY_VALUES)))
    drawn = layout(panels, values)
    plots, lines = [], False
    for panel in drawn.panels:
        layers = point_layers(panel.facet, panel.value, x, y) if points else cell_layers(panel.facet, panel.value, x, y)
        if panel.value is None and not points:
            layers += _marks(panel.facet, x, y)
            borders = [border for layer in over for border in over_panel(layer, panel.facet, x, y)]
            lines |= bool(borders)
            layers += borders
            if lines:
                layers += codim2_layers([layer for layer in over if kind_of(layer) == "curves"], x, y)
        plots.append(map_plot(panel, ds[x], ds[y], layers, points))
    texts = dict.fromkeys(over_map_text(layer, lines) for layer in over)
    about = margins(ds, certified_text(ds), panels.note, *notes, *texts)
    return Sheet(plots, keys=[cell_keys(panels.data, values)], **drawn.sheet, **about)


def map_plot(panel: Panel, x: xr.DataArray, y: xr.DataArray, layers: list[Layer], points: bool = False) -> Plot:
    """Return the plot of a map, with the source's region of best single impacts over beta and gamma."""
    about = {"label": label(y, int(_LETTERS_PER_INCH * panel.height)), "group": "y"}
    if points:
        across, up = axis(x, limits=_around(x), group="x", intervals=6), axis(y, limits=_around(y), **about)
    else:  # few ticks: no "-2.5", which would touch the tick labels of the next panel
        across, up = map_axis(x, group="x", intervals=6), map_axis(y, **about)
    if {x.name, y.name} == set(REGION):
        (west, east), (south, north) = REGION[str(x.name)], REGION[str(y.name)]
        (first, last), (bottom, top) = across.limits, up.limits
        if west < (last or 0) and east > (first or 0) and south < (top or 0) and north > (bottom or 0):
            corners = [west, east, east, west, west], [south, south, north, north, south]
            layers = [*layers, Line(*corners, width=1.3, halo=0.85, label="source's best region")]
    return Plot(layers, across, up, panel.title, panel.place, at(panel.facet), grid="both" if points else "")


def _around(data: xr.DataArray) -> tuple[float, float]:
    values = values_along(data)
    room = 0.05 * float(np.ptp(values)) or 0.1 * float(np.abs(values).max()) or 1.0
    return float(values.min()) - room, float(values.max()) + room


def rate_grid(ds: xr.Dataset) -> Sheet:
    """Draw the rate of penetration over two axes, and the quantities that vary.

    Each value of further axes gets a panel, nine at most; the figure notes which are shown. Constant values are in the
    note.
    """
    ds = rates_in(ds)
    values = values_of_rock(ds)
    if POINT in lane_dims(ds):
        names = tuple(varied(ds))
        if len(names) != 2:
            raise InputError(f"no map: {', '.join(names) or 'none'} is what varies over the points, not two parameters")
        return map_sheet(ds, names[0], names[1], (None,) * (REGIME in ds) + values[: _MOST_VALUES[3]])
    x, y = axes_of_map(ds, *long_axes(ds))
    ds = ds.sortby([x, y])
    panels = facets(ds, (x, y), _MOST_RATE_FACETS)
    shown = values[: _MOST_VALUES.get(len(panels), 1)]
    drawn = layout(panels, shown)
    plots = []
    for panel in drawn.panels:
        layers = cell_layers(panel.facet, panel.value, x, y)
        layers += _relief_lines(panel.facet, x, y) if panel.value is shown[0] else []
        plots.append(map_plot(panel, ds[x], ds[y], layers))
    # The values that all lanes share are in the note; the relief is proportional to a mean force that is drawn.
    given = {value.name for value in values}
    given |= {"relief"} if "mean_force" in given else set()
    fixed = [ds[name].assign_attrs(symbol=text) for name, text in _SYMBOLS.items() if name in ds and name not in given]
    texts = [value_text(data, float(data.max())) for data in fixed if data.notnull().any()]
    about = margins(ds, panels.note, point=", ".join(filter(None, (point_text(ds), *texts))))
    return Sheet(plots, keys=[cell_keys(panels.data, shown)], **drawn.sheet, **about)


# Cells of a grid.


def cell_layers(facet: xr.Dataset, value: Value | None, x: str, y: str) -> list[Layer]:
    """Return the cells of the regimes or of `value` over two axes; lanes without penetration are white.

    On maps of rates, lines separate cells with and without a single impact.
    """
    colours = coloured(facet, value, y, x)
    right, top = (edges(values_along(facet[name])) for name in (x, y))
    layers: list[Layer] = [Cells(right, top, colours.cells, colours.colour_map, colours.norm)]
    if value is None or not value.of_rate:
        return layers
    nothing = colours.cells == 0
    if nothing.any():
        shown = np.where(nothing, 0.0, np.where(np.isnan(colours.cells), np.nan, 1.0))
        white = ListedColormap([NOTHING, "#FFFFFF00"], name="nothing")
        layers.append(Cells(right, top, np.nan_to_num(shown, nan=1.0), white, Normalize(0.0, 1.0), order=0.5))
    if REGIME in facet:
        single = facet[REGIME].transpose(y, x).values == SINGLE
        across, along = np.argwhere(single[:, 1:] != single[:, :-1]), np.argwhere(single[1:] != single[:-1])
        lines = [(right[j + 1], right[j + 1], np.nan, top[i], top[i + 1], np.nan) for i, j in across]
        lines += [(right[j], right[j + 1], np.nan, top[i + 1], top[i + 1], np.nan) for i, j in along]
        if lines:
            table = np.array(lines)
            path = table[:, :3].ravel(), table[:, 3:].ravel()
            layers.append(Line(*path, width=1.0, halo=0.6, label="border of single impact"))
    return layers


def _marks(facet: xr.Dataset, x: str, y: str) -> list[Layer]:
    """Mark lanes with a hidden motion or sensitive to rounding errors."""
    # Two lines: a longer legend entry would make its panel wider than the others.
    hidden = dots(label="same label, other motion\nfrom another start", size=2.8, edge="white", edge_width=0.4)
    layers: list[Layer] = []
    for name, mark in ((HIDDEN, hidden), (SENSITIVE, SENSITIVE_KEY)):
        if name in facet:
            rows, columns = np.nonzero(facet[name].transpose(y, x).values == 1)
            if rows.size:
                places = values_along(facet[x])[columns], values_along(facet[y])[rows]
                layers.append(replace(mark, x=places[0], y=places[1]))
    return layers


def contours(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    levels: Sequence[float],
    taken: list[tuple[float, float]],
    **look: Any,
) -> list[Layer]:
    """Return contour lines with their values, as far as labels do not lie over those at the places `taken`.

    `taken` has places as fractions of the panel, and is extended.
    """
    generator = contour_generator(x, y, np.ma.masked_invalid(z))
    low, size = np.array([x.min(), y.min()]), np.array([np.ptp(x), np.ptp(y)])
    layers: list[Layer] = []
    look = {"width": 0.7, "colour": INK, **look}

    def length(path: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(path / size, axis=0), axis=1).sum())

    for value in levels:
        found: Any = generator.lines(float(value))
        paths: list[np.ndarray] = [path for path in found if len(path) > 1]
        if not paths:
            continue
        gap = np.full((1, 2), np.nan)
        whole = np.concatenate([part for path in paths for part in (path, gap)])
        layers.append(Line(whole[:, 0], whole[:, 1], **look))
        # The label is where the most room is left, best in the middle of the longest line.
        longest = max(paths, key=length)
        places = (longest - low) / size
        inside = ((places > _LABEL_ROOM) & (places < 1 - np.array(_LABEL_ROOM) / 2)).all(axis=1)
        room = np.full(len(longest), 4.0)
        for other in taken:
            room = np.minimum(room, np.max(np.abs(places - other) / _LABEL_ROOM, axis=1))
        best = int(np.argmax(np.where(inside, room - np.abs(np.linspace(-1.0, 1.0, len(longest))), -np.inf)))
        if inside[best] and room[best] > 1.0:
            taken.append((float(places[best, 0]), float(places[best, 1])))
            across, up = longest[best].tolist()
            layers.append(Text(across, up, f"{value:g}", colour=look["colour"], size=7.5, halo=1.0))
    return layers


def _relief_lines(facet: xr.Dataset, x: str, y: str) -> list[Layer]:
    """Return contour lines of the relief P/D with their values."""
    if RELIEF not in facet:
        return []
    relief = facet[RELIEF].transpose(y, x).values
    constant = _CONSTANT_RELIEF * relief.max()
    if not np.isfinite(relief).all() or not all((np.ptp(relief, axis=i) > constant).any() for i in (0, 1)):
        return []  # lines would be straight if the relief does not depend on one of the axes
    levels = MaxNLocator(_RELIEF_LEVELS).tick_values(relief.min(), relief.max())
    levels = levels[(levels > relief.min()) & (levels < relief.max())]
    along = values_along(facet[x]), values_along(facet[y])
    return contours(*along, relief, levels.tolist(), [], halo=0.65, label="equal relief P/D")


# Dots of a list of points.


def point_layers(ds: xr.Dataset, value: Value | None, x: str, y: str) -> list[Layer]:
    """Return each lane as a dot, coloured by its regime if `value` is None, else by `value`."""
    cells, colour_map, norm = coloured(ds, value)
    across, up = values_along(ds[x]), values_along(ds[y])
    nothing = (cells == 0) & (value is not None and value.of_rate)
    known = np.isfinite(cells) & ~nothing
    many = cells.size > _MANY_DOTS
    size, width = (_DOT * np.sqrt(_MANY_DOTS / cells.size), 0.0) if many else (_DOT, 0.3)
    gap, edge = NO_VALUE["edgecolor"], "#4D4D4D"
    looks: list[tuple[np.ndarray, Look]] = [
        (np.isnan(cells), {"colours": NO_VALUE["facecolor"], "edge": gap, "hatch": NO_VALUE["hatch"]}),
        (nothing, {"colours": NOTHING, "edge": edge}),
        (known, {"colours": colours_of(cells[known], colour_map, norm), "edge": edge}),
    ]
    return [
        Points(across[mask], up[mask], sizes=float(size), edge_width=width, **look)
        for mask, look in looks
        if mask.any()
    ]


def split_starts(ds: xr.Dataset) -> Facets:
    """Return one facet per initial condition of a list of points, or a single facet for many initial conditions.

    The dimension `start`, or the coordinate `start` of the points, names the initial conditions.
    """
    if has_many_starts(ds):
        return Facets((f"{ds.sizes[START]} starts together",), (ds,))
    if START not in ds.coords or ds[START].ndim == 0:
        return Facets(("",), (ds,))
    values = ds[START].values.astype(str)
    starts: Sequence[str] = list(dict.fromkeys(values.tolist()))
    data = tuple(ds.isel({ds[START].dims[0]: np.flatnonzero(values == name)}) for name in starts)
    if START in ds.dims:
        data = tuple(facet.isel({START: 0}) for facet in data)
    return Facets(tuple(f"start: {short(name)}" for name in starts), data, (len(starts),))


# Many initial conditions, and lanes without a map.


def regime_bars(ds: xr.Dataset) -> Sheet:
    """Draw the number of lanes in each regime, one panel per initial condition."""
    ds = regimes_in(ds)
    panels = split_starts(ds)
    counts = [regime_counts([facet[REGIME]]) for facet in panels.data]
    occurring = sorted(set().union(*counts))
    names = regime_names(ds[REGIME])
    wide = min(len(panels), _MOST_BAR_COLUMNS)
    deep = -(-len(panels) // wide)
    colours = [REGIME_COLOURS[flag] for flag in occurring]
    most = max((n for count in counts for n in count.values()), default=1)
    ticks = None if most >= _MOST_SHARES else [(float(k), str(k)) for k in range(most + 1)]
    across = Axis("lanes", limits=(0.0, 1.4 * most), ticks=ticks, intervals=5, group="lanes")
    places = np.arange(len(occurring), dtype=float)
    up = Axis(
        limits=(-0.5, max(len(occurring), 1) - 0.5),
        ticks=[(float(k), names[flag]) for k, flag in enumerate(occurring)],
        reversed=True,
        group="regimes",
    )
    plots = []
    for k, (title, facet, count) in enumerate(zip(panels.titles, panels.data, counts, strict=True)):
        lanes = [count.get(flag, 0) for flag in occurring]
        texts = [
            Text(float(n), float(place), f"{n}  ({share_text(n / facet[REGIME].size)})", "left", offset=(3.0, 0.0))
            for n, place in zip(lanes, places, strict=True)
            if n
        ]
        bars = Bars(np.zeros(len(lanes)), places - 0.4, np.array(lanes), np.full(len(lanes), 0.8), colours, "#595959")
        plots.append(Plot([bars, *texts], across, up, title, divmod(k, wide), grid=""))
    size = 1.6 + 3.0 * wide, 0.6 + deep * (0.6 + 0.32 * max(len(occurring), 2))
    return Sheet(plots, size, (1.0,) * wide, (1.0,) * deep, **margins(ds, certified_text(ds)))


def many_starts(ds: xr.Dataset, values: Values | None = None) -> Sheet:
    """Draw the regimes that many initial conditions lead to.

    Initial states on a grid become maps over these states, and initial states on a line become curves. Other initial
    conditions are scattered over the phase planes of bit and striker. If parameters vary over more values than there
    can be panels, the fraction of initial conditions in each regime is drawn, or the median of `values`. If specified,
    `values` replace the regimes and the quantities next to them.
    """
    ds = regimes_in(ds)
    quantities = None if values is None else tuple(value for value in values if value is not None)
    if POINT in lane_dims(ds):
        return _over_two(ds, tuple(varied(ds)), values) if len(varied(ds)) == 2 else regime_bars(ds)
    axes, spread = swept(ds), on_axes(ds)
    shown = values or (None, *values_beside(ds))
    states = [name for name in swept(spread) if name.startswith(PREFIX)]
    long = [name for name in axes if ds.sizes[name] >= ENOUGH]
    if len(states) >= 2 and not long:
        return map_sheet(spread, states[0], states[1], shown, left_out_text(ds))
    if len(states) == 1 and len(long) == 1:
        return map_sheet(spread, long[0], states[0], shown, left_out_text(ds))
    if len(states) == 1 and not long:
        return regime_lines(spread, states[0], left_out_text(ds), quantities)
    if not axes:
        return _phase_planes(described(ds), shown) if varied_states(ds) else regime_bars(ds)
    if len(axes) == 1 or len(long) == 1:
        return regime_lines(ds, values=quantities)
    return _over_two(ds, axes_of_map(ds), values)


def _over_two(ds: xr.Dataset, axes: tuple[str, ...], values: Values | None) -> Sheet:
    """Draw the medians of `values` over two parameters, or the fraction of initial conditions in each regime.

    The first fractions get a map each; a note lists the other regimes.
    """
    x, y = axes
    if values is not None:
        return map_sheet(medians(ds, [value.name for value in values if value]), x, y, values, medians_text(ds))
    most = 1 if set(swept(ds)) - set(axes) else _MOST_SHARES
    shares = regime_shares(ds)
    names = [str(name) for name in shares.data_vars if str(name).startswith(SHARE)]
    shown = tuple(share_value(shares[name], name.removeprefix(SHARE)) for name in names[:most])
    rest = ", ".join(name.removeprefix(SHARE) for name in names[most:])
    note = f"Without a map of its share: {rest}" if rest else ""
    about = f"The regime that most of {ds.sizes[START]} starts end in, and the share of them that ends in each"
    return map_sheet(shares, x, y, (None, *shown), about, note)


def _phase_planes(ds: xr.Dataset, shown: Values) -> Sheet:
    """Draw the values `shown` over pairs of states, for initial conditions that form no grid."""
    names = varied_states(ds)
    pairs = list(zip(names[::2], names[1::2], strict=False)) or [(names[0], names[0])]
    pairs += [(names[0], names[-1])] if len(names) > 1 and len(names) % 2 else []
    pairs = pairs[:3]
    shuffled = ds.isel({START: np.random.default_rng(0).permutation(ds.sizes[START])})  # so none is always in front
    plots = [
        Plot(
            point_layers(shuffled, value, x, y),
            axis(ds[x], group=f"x{row}", intervals=6),
            axis(ds[y], group=f"y{row}"),
            place=(row, column),
            grid="",
        )
        for row, (x, y) in enumerate(pairs)
        for column, value in enumerate(shown)
    ]
    bars = [Scale((len(pairs), column), value) for column, value in enumerate(shown) if value is not None]
    keys = regime_keys([ds[REGIME]]) if None in shown else []
    size = 3.6 * len(shown) + 1.6, 3.0 * len(pairs) + 1.2
    heights = [1.0] * len(pairs) + [0.05] * bool(bars)
    about = margins(ds, certified_text(ds), f"{ds.sizes[START]} starts", left_out_text(ds))
    return Sheet(plots, size, (1.0,) * len(shown), heights, keys=[keys], scales=bars, **about)
