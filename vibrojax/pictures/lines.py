"""Pictures along one axis: curves above the regimes of each initial condition, and rates of penetration.

For many initial conditions, the strip of regimes shows the fraction of each, and dots coloured by regime replace the
curves.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import counted
from vibrojax.pictures.axes import certified_text, edges, map_axis, margins, scale, short, values_along, with_unit
from vibrojax.pictures.colours import (
    REGIME_COLOURS,
    REGIME_MAP,
    REGIME_NORM,
    SENSITIVE_KEY,
    SINGLE,
    Value,
    regime_cells,
    regime_keys,
    value_axis,
    values_beside,
)
from vibrojax.pictures.contents import (
    POINT,
    RATE,
    REGIME,
    RELIEF,
    SENSITIVE,
    START,
    axes_to_draw,
    is_numeric,
    lane_dims,
    many_starts,
    rates_in,
    regimes_in,
)
from vibrojax.pictures.curves import (
    MOST_ROWS,
    Across,
    Series,
    axis_of_lines,
    line_keys,
    longest_axis,
    rows_of,
    split_lines,
)
from vibrojax.pictures.plots import INK, Area, Axis, Cells, Layer, Line, Look, Plot, Points, Sheet, dots, key, level
from vibrojax.pictures.sheet import MOST_PANELS, PAGE, at, columns, facets
from vibrojax.pictures.style import nested_line, start_colour

_MOST_COLUMNS = 3
_TITLE_ROOM = 0.6  # height [inches] of the title and the labels of a stack
_SHARES_HEIGHT = 1.1  # inches
_DISTINCT_HEIGHTS = 1000  # number of heights on a panel that the eye can distinguish
_MARGINS = 2.6  # page height [inches] for title, notes and the figure's margins
SLIP, PEAK = "slip_per_impact", "peak_impact_force"
_NAMES = {RATE: "rate of penetration", SLIP: "slip per blow", PEAK: "peak impact force"}
_MANY_LANES = 40  # number of lanes per line from which on markers are small
_CONSTANT = 1e-6  # largest relative range of values that count as constant

Lanes = Float[np.ndarray, " lanes"]


def regime_lines(
    ds: xr.Dataset, x: str | None = None, note: str = "", values: tuple[Value, ...] | None = None
) -> Sheet:
    """Draw `values` along `x` above the regimes of each initial condition.

    Defaults: impact velocity and period, along the longest axis.
    """
    ds = regimes_in(ds)
    values = values_beside(ds) if values is None else values
    x = x or max(axes_to_draw(ds), key=lambda name: ds.sizes[name])
    height = 1.9 if len(values) > 1 else 2.4
    keys: list[Layer] = []
    if not many_starts(ds):
        starts = starts_of(ds)
        for k, start in enumerate(starts if starts[0].name else ()):
            look = nested_line(k, len(starts))
            keys.append(key(f"start: {start.name}", marker="o", colour=start.colour, **look))
    return stacks(ds, x, len(values), (height, height), partial(value_plots, values=values, x=x), keys, note)


def stacks(
    ds: xr.Dataset,
    x: str,
    curves: int,
    heights: tuple[float, float],
    draw: Callable[[xr.Dataset], list[Plot]],
    keys: Sequence[Layer] = (),
    note: str = "",
) -> Sheet:
    """Draw a picture along `x`: for each facet, the `curves` plots that `draw` returns, above the strip of regimes.

    `heights`: height [inch] of a curve panel with one facet and with several; `keys`: legend entries above the regimes.
    """
    ds = ds.sortby(x)
    strip = _SHARES_HEIGHT if many_starts(ds) else 0.10 + 0.17 * ds.sizes.get(START, 1)
    for most in range(MOST_PANELS, 0, -1):  # as many facets as fit on a page
        panels = facets(ds, (x, START), most)
        height = heights[len(panels) > 1]
        wide = columns(panels, _MOST_COLUMNS)
        deep = -(-len(panels) // wide)
        stack_height = curves * height + strip + _TITLE_ROOM
        if deep * stack_height <= PAGE[1] - _MARGINS:
            break
    plots: list[Plot] = []
    for k, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        row, column = divmod(k, wide)
        for i, plot in enumerate([*draw(facet), _strip(facet, x)]):
            above = ", ".join(filter(None, (title if i == 0 or plot.title else "", plot.title)))
            up = plot.y if plot.y.group else replace(plot.y, group=f"y{i}")
            place = row * (curves + 1) + i, column
            plots.append(replace(plot, x=map_axis(facet[x], group="x"), y=up, title=above, place=place, at=at(facet)))
    colours = "starts together, in the colours of the regimes that they end in"
    together = f"{ds.sizes[START]} {colours}" if many_starts(ds) else ""
    return Sheet(
        plots,
        ({1: 7.6, 2: 10.0, 3: 12.5}[wide], stack_height * deep + 0.7),
        (1.0,) * wide,
        (*[height] * curves, strip) * deep,
        [keys, regime_keys([facet[REGIME] for facet in panels.data])],
        **margins(ds, certified_text(ds), panels.note, together, note),
    )


class Start(NamedTuple):
    """The lanes of one initial condition, its short name (empty without a dimension `start`) and its colour."""

    name: str
    colour: str
    lanes: xr.Dataset


def starts_of(ds: xr.Dataset) -> list[Start]:
    """Return the lanes of each initial condition."""
    if START not in lane_dims(ds):
        return [Start("", start_colour("", 0), ds)]
    names = [short(str(name)) for name in ds[START].values]
    return [Start(name, start_colour(name, i), ds.isel({START: i})) for i, name in enumerate(names)]


def lane_dots(along: Lanes, values: Lanes, regimes: Lanes, size: float) -> Points:
    """Return each lane as a dot in the colour of its regime, in random order, so that no regime hides another.

    Of several lanes with the same regime and the same position, only one is drawn: millions of dots would take minutes.
    """
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(regimes))
    height = np.ptp(values[known]) if known.size else 1.0
    rows = np.round(_DISTINCT_HEIGHTS * (values[known] - values[known].min(initial=np.inf)) / (height or 1.0))
    different = np.unique(np.stack([along[known], rows, regimes[known]]), axis=1, return_index=True)[1]
    order = np.random.default_rng(0).permutation(known[different])
    colours = [REGIME_COLOURS[flag] for flag in regimes[order].astype(int).tolist()]
    return Points(along[order], values[order], colours, size, clip=False)


def dot_size(values: int) -> float:
    """Return the diameter of a dot [pt], given the number of values along the axis."""
    return float(np.sqrt(np.clip(1200.0 / values, 5.0, 20.0)))


def _strip(facet: xr.Dataset, x: str) -> Plot:
    """Draw the regimes along `x`: a row of coloured cells per initial condition, or the regime fractions of many."""
    many = many_starts(facet)
    by_start = facet if START in lane_dims(facet) else facet.expand_dims(START)
    rows = regime_cells(by_start[REGIME].transpose(START, x))
    if many:  # each column is sorted, single impacts first, so that the height of a colour is its fraction
        ordered = np.sort(np.where(rows == SINGLE, -1.0, rows), axis=0)
        rows = np.where(ordered == -1.0, float(SINGLE), ordered)
    ends = np.linspace(0.0, 100.0, len(rows) + 1) if many else np.arange(len(rows) + 1) - 0.5
    along = values_along(facet[x])
    layers: list[Layer] = [Cells(edges(along), ends, rows, REGIME_MAP, REGIME_NORM)]
    if many:
        return Plot(layers, y=Axis("starts\n[%]", limits=(0.0, 100.0)), name="regimes")
    layers += [level(between, colour="#FFFFFF") for between in ends[1:-1]]
    if SENSITIVE in facet:
        row, column = np.nonzero(by_start[SENSITIVE].transpose(START, x).values == 1)
        layers += [replace(SENSITIVE_KEY, x=along[column], y=row)] if row.size else []
    ticks = [(float(k), start.name) for k, start in enumerate(starts_of(facet))]
    return Plot(layers, y=Axis(ticks=ticks, limits=(-0.5, len(rows) - 0.5), reversed=True), name="regimes")


def value_plots(facet: xr.Dataset, values: tuple[Value, ...], x: str) -> list[Plot]:
    """Draw each of the `values` along `x` on its own panel, with a line per initial condition."""
    plots = []
    for value in values:
        layers: list[Layer] = []
        if many_starts(facet):
            heights, regimes = (data.transpose(x, START) for data in (value.of(facet), facet[REGIME]))
            along = np.repeat(values_along(facet[x]), heights.sizes[START])
            colours = regime_cells(regimes).ravel()
            layers.append(lane_dots(along, heights.values.ravel(), colours, dot_size(facet.sizes[x])))
        else:
            for position, (_, colour, lanes) in enumerate(starts_of(facet)):
                along = values_along(lanes[x])
                ends = [f"{value.name}_{end}" for end in ("min", "max")]
                if all(end in lanes for end in ends):  # range over the impacts of each lane
                    low, high = (lanes[end].values * value.factor for end in ends)
                    layers.append(Area(along, low, high, colour, 0.15))
                # A motion that several initial conditions reach shows the colours of all of them.
                look = nested_line(position, facet.sizes.get(START, 1))
                layers.append(Line(along, value.of(lanes).values, colour, marker="o", clip=False, **look))
        up = value_axis(value, value.label.replace(" [", "\n["), zero="zero everywhere")
        plots.append(Plot(layers, y=up))
    return plots


# Rates of penetration.


def rates(ds: xr.Dataset) -> Sheet:
    """Draw the rate of penetration over the longest axis and over the relief P/D, and the slip or the force per blow.

    Colours distinguish the values of the second longest axis. Further axes become rows, at most four; a note lists the
    values shown if not all fit. Hollow markers are lanes without penetration; crosses are motions other than a single
    impact. A list of points is drawn over the parameter with the most values.
    """
    ds = rates_in(ds)
    x = longest_axis(ds)
    by = axis_of_lines(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    panels = facets(ds, (POINT, x.name, by), MOST_ROWS)
    dash = x.dash(ds)
    named = bool(by) and not is_numeric(ds[by]) and bool(dash)  # starts or rocks, whose lines may coincide
    plots = []
    for column, (name, along) in enumerate(_choose_curves(ds, x)):
        factor, unit = scale(ds[name])
        # Zero is included, to show whether lines pass through it.
        shown = np.concatenate([np.ravel(facet[name].values) for facet in panels.data]) * factor
        greatest = np.max(shown[np.isfinite(shown)], initial=0.0)
        top = 1.05 * float(greatest) or 1.0
        up = Axis(with_unit(_NAMES[name], unit), name, (-0.03 * top, top), group=name, zero="no penetration")
        across = x.axis(ds)
        if along == RELIEF:
            right = 1.05 * float(np.nanmax(ds[RELIEF].values))
            across = Axis("relief P/D", RELIEF, (-0.03 * right, right), group=RELIEF)
        for row, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
            lines, layers = split_lines(facet, by), []
            for k, line in enumerate(lines):
                places = np.atleast_1d(line.lanes[RELIEF].values) if along == RELIEF else x.of(line.lanes)
                look = nested_line(k, len(lines)) if named else {"dash": dash}
                layers += _rate_layers(line, places, factor * np.atleast_1d(line.lanes[name].values), look)
            plots.append(Plot(layers, across, up, "" if column else title, (row, column), at(facet)))
    lines = split_lines(ds, by)
    keys = line_keys(lines, dash=dash)
    keys = [replace(each, **nested_line(k, len(keys))) if named else each for k, each in enumerate(keys)]
    texts = {"single": "single impact", "other": "other motion", "none": "no penetration"}
    shown_motions = [name for name, mask in _motions(ds).items() if mask.any() and (name == "none" or REGIME in ds)]
    marks = [dots(label=texts[motion], **{"size": 4.5} | _mark(motion, INK)) for motion in shown_motions]
    count = int(np.isnan(ds[RATE].values).sum())
    missing = f"{count} of {counted(ds[RATE].size, 'lane')} without a rate" if count else ""
    about = margins(ds, panels.note, missing)
    return Sheet(plots, keys=[keys, marks], **rows_of(panels, 1 + max(plot.place[1] for plot in plots)), **about)


def _choose_curves(ds: xr.Dataset, x: Across) -> list[tuple[str, str]]:
    """Return pairs of a variable and what it is drawn over: the axis `x`, or the relief.

    They are the rate over the axis and over the relief, if that varies, and the force or slip per blow.
    """

    def varies(name: str) -> bool:
        """Return whether a variable varies along any of the lines."""
        dimension = x.name if x.name in ds[name].dims else POINT
        if dimension not in ds[name].dims:
            return False
        swing = ds[name].max(dimension) - ds[name].min(dimension)
        return bool((swing > _CONSTANT * np.abs(ds[name]).max()).any())

    each_blow = sorted((name for name in (PEAK, SLIP) if name in ds), key=lambda name: not varies(name))[:1]
    over_relief = [(RATE, RELIEF)] if RELIEF in ds and varies(RELIEF) else []
    return [(RATE, x.name), *over_relief, *((name, x.name) for name in each_blow)]


def _rate_layers(line: Series, places: Lanes, values: Lanes, look: Look) -> list[Layer]:
    """Return one line, interrupted at jumps between a single impact and another motion, and markers of its motions."""
    motions = _motions(line.lanes)
    jumps = 1 + np.flatnonzero(np.diff(motions["other"].astype(int)))
    x, y = (np.insert(np.asarray(along, float), jumps, np.nan) for along in (places, values))
    layers: list[Layer] = [Line(x, y, colour=line.colour, **look)]
    size = look.get("size", 3.8) if values.size < _MANY_LANES else 2.0
    for motion, mask in motions.items():
        if mask.any():
            mark = _mark(motion, line.colour)
            layers.append(dots(places[mask], values[mask], size=size + (motion == "none"), clip=False, **mark))
    return layers


def _motions(lanes: xr.Dataset) -> dict[str, Bool[np.ndarray, "*lanes"]]:
    """Return masks of the lanes with a single impact, another motion, and a single impact without penetration."""
    nothing = np.atleast_1d(lanes[RATE].values) == 0
    single = np.atleast_1d(lanes[REGIME].values) == SINGLE if REGIME in lanes else np.ones(nothing.shape, bool)
    return {"single": single & ~nothing, "other": ~single, "none": single & nothing}


def _mark(motion: str, colour: str) -> Look:
    mark: Look = {"colour": colour, "marker": "x" if motion == "other" else "o"}
    return mark | {"face": "white", "order": 4.0} if motion == "none" else mark
