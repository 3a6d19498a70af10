"""Curves along an axis of a sweep: above the regimes of each initial condition, or in one row of panels per facet.

For many initial conditions, the strip of regimes shows the fraction of each, and dots coloured by regime replace the
curves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Shaped

from vibrojax.errors import InputError, counted
from vibrojax.pictures import axes, colours, contents
from vibrojax.pictures.colours import Value
from vibrojax.pictures.contents import FORM, POINT, RATE, REGIME, RELIEF, SENSITIVE, START, is_numeric, lane_dims
from vibrojax.pictures.layout import LEGEND_WIDTH, STACK_MARGINS, at, facets, is_narrow
from vibrojax.pictures.plots import (
    Area,
    Axis,
    Cells,
    Dash,
    Key,
    Layer,
    Line,
    Look,
    Plot,
    Points,
    Sheet,
    dots,
    key,
    level,
)
from vibrojax.pictures.style import BIT, ROCK_COLOURS, line_colours, nested_line, other_colour, start_colour

MOST_ROWS, NARROW_ROWS = 4, 2
_PANEL_WIDTH = 3.3  # inches
_FREQUENCY = "frequency"  # preferred among axes of equal length
_STACK_WIDTHS = {1: 7.6, 2: 10.0, 3: 12.5}  # of the sheet [inch], by the number of stacks side by side
_TITLE_ROOM = 0.6  # height [inches] of the title and the labels of a stack
_SHARES_HEIGHT = 1.1  # inches
_DISTINCT_HEIGHTS = 1000  # number of heights on a panel that the eye can distinguish
_MOST_STACKS = 9
_SLIP, _PEAK = "slip_per_impact", "peak_impact_force"
_MANY_LANES = 40  # number of lanes per line from which on markers are small
_SAME_LINE = 0.01  # distance of lines, as a fraction of the greatest value, below which one hides the other
_CONSTANT = 1e-6  # largest relative range of values that count as constant
_MEAN: Look = {"face": "white", "edge_width": 0.9, "order": 2.5}  # of a motion that does not repeat
_MARKS: dict[str, tuple[str, Look]] = {
    "single": ("single impact", {"marker": "o"}),
    "other": ("other motion", {"marker": "x"}),
    "none": ("no penetration", {"marker": "o", "face": "white", "order": 4.0}),
}

Lanes = Float[np.ndarray, " lanes"]


class Series(NamedTuple):
    """One line: its legend text `name`, its colour, and its lanes along one dimension."""

    name: str
    colour: str
    lanes: xr.Dataset


def starts_of(ds: xr.Dataset) -> list[Series]:
    """Return the lanes of each initial condition, with an empty name if there is no dimension `start`."""
    lines = split_lines(ds, START if START in lane_dims(ds) else "")
    return [line._replace(name=line.name.removeprefix(f"{START}: ")) for line in lines]


# Above the regimes.


def regime_lines(ds: xr.Dataset, x: str | None = None, note: str = "", values: Sequence[Value] | None = None) -> Sheet:
    """Draw `values` (those beside regimes) along `x` (the longest axis) above the regimes of each start."""
    ds = colours.regimes_in(ds)
    values = colours.values_beside(ds) if values is None else values
    x = x or max(contents.axes_to_draw(ds), key=lambda name: ds.sizes[name])
    starts = starts_of(ds) if START in lane_dims(ds) and not contents.many_starts(ds) else []
    looks = [{"marker": "o", "colour": start.colour, **nested_line(k, len(starts))} for k, start in enumerate(starts)]
    keys: list[Key] = [key(f"start: {start.name}", **look) for start, look in zip(starts, looks, strict=True)]
    keys += [] if contents.many_starts(ds) else motion_keys(ds, values)
    height = 1.9 if len(values) > 1 else 2.4
    return stacks(ds, x, len(values), (height, height), partial(value_plots, values=values, x=x), keys, note)


def stacks(
    ds: xr.Dataset,
    x: str,
    curves: int,
    heights: tuple[float, float],
    draw: Callable[[xr.Dataset], list[Plot]],
    keys: Sequence[Key] = (),
    note: str = "",
) -> Sheet:
    """Draw a picture along `x`: for each facet, the `curves` plots that `draw` returns, above the strip of regimes.

    `heights`: height [inch] of a curve panel with one facet and with several; `keys`: legend entries above the regimes.
    """
    ds, many = ds.sortby(x), contents.many_starts(ds)
    strip = _SHARES_HEIGHT if many else 0.10 + 0.17 * ds.sizes.get(START, 1)
    height = heights[any(ds.sizes[name] > 1 for name in lane_dims(ds) if name not in (x, START))]
    stack_height = curves * height + strip + _TITLE_ROOM
    columns = len(_STACK_WIDTHS)
    panels = facets(ds, (x, START), _MOST_STACKS)
    places = panels.places(columns)
    plots: list[Plot] = []
    for (row, column), (title, facet) in zip(places, panels, strict=True):
        for i, plot in enumerate([*draw(facet), _strip(facet, x)]):
            above = ", ".join(filter(None, (title if i == 0 or plot.title else "", plot.title)))
            across, up = axes.map_axis(facet[x], group="x"), replace(plot.y, group=plot.y.group or f"y{i}")
            place = row * (curves + 1) + i, column
            plots.append(replace(plot, x=across, y=up, title=above, place=place, at=at(facet)))
    deep, wide = (max(ends) + 1 for ends in zip(*places, strict=True))
    together = f"{ds.sizes[START]} starts together, in the colours of the regimes that they end in" if many else ""
    return Sheet(
        plots,
        (_STACK_WIDTHS[wide], stack_height * deep + 0.7),
        heights=(*[height] * curves, strip) * deep,
        keys=[keys, colours.regime_keys([facet[REGIME] for facet in panels.data])],
        **axes.margins(ds, axes.certified_text(ds), panels.note, together, note),
    )


def lane_dots(along: Lanes, values: Lanes, regimes: Lanes, size: float) -> Points:
    """Return each lane as a dot in the colour of its regime, in random order, so that no regime hides another.

    Of several lanes with the same regime and the same position, only one is drawn: millions of dots would take minutes.
    """
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(regimes))
    height = np.ptp(values[known]) if known.size else 1.0
    rows = np.round(_DISTINCT_HEIGHTS * (values[known] - values[known].min(initial=np.inf)) / (height or 1.0))
    different = np.unique(np.stack([along[known], rows, regimes[known]]), axis=1, return_index=True)[1]
    order = np.random.default_rng(0).permutation(known[different])
    shown = [colours.REGIME_COLOURS[flag] for flag in regimes[order].astype(int).tolist()]
    return Points(along[order], values[order], shown, size, clip=False)


def dot_size(values: int) -> float:
    """Return the diameter of a dot [pt], given the number of values along the axis."""
    return float(np.sqrt(np.clip(1200.0 / values / (1 + is_narrow()), 5.0, 20.0)))


def _strip(facet: xr.Dataset, x: str) -> Plot:
    """Draw the regimes along `x`: a row of coloured cells per initial condition, or the regime fractions of many."""
    by_start = facet if START in lane_dims(facet) else facet.expand_dims(START)
    rows, along = colours.regime_cells(by_start[REGIME].transpose(START, x)), axes.values_along(facet[x])
    if contents.many_starts(facet):  # each column sorted, single impacts first: the height of a colour is its share
        ordered = np.sort(np.where(rows == colours.SINGLE, -1.0, rows), axis=0)
        rows = np.where(ordered == -1.0, float(colours.SINGLE), ordered)
        shares = Cells(axes.edges(along), np.linspace(0.0, 100.0, len(rows) + 1), rows, *colours.regime_colour_map())
        return Plot([shares], y=Axis("starts\n[%]", limits=(0.0, 100.0)), name="regimes")
    ends = np.arange(len(rows) + 1) - 0.5
    layers: list[Layer] = [Cells(axes.edges(along), ends, rows, *colours.regime_colour_map())]
    layers += [level(between, colour="#FFFFFF") for between in ends[1:-1]]
    if SENSITIVE in facet:
        row, column = np.nonzero(by_start[SENSITIVE].transpose(START, x).values == 1)
        layers += [replace(colours.SENSITIVE_KEY, x=along[column], y=row)] if row.size else []
    ticks = [(float(k), start.name) for k, start in enumerate(starts_of(facet)) if start.name]
    return Plot(layers, y=Axis(ticks=ticks, limits=(-0.5, len(rows) - 0.5), reversed=True), name="regimes")


def value_plots(facet: xr.Dataset, values: Sequence[Value], x: str) -> list[Plot]:
    """Draw each of the `values` along `x` on its own panel, with a line per initial condition."""
    plots = []
    for value in values:
        if contents.many_starts(facet):
            heights, regimes = (data.transpose(x, START) for data in (value.of(facet), facet[REGIME]))
            along = np.repeat(axes.values_along(facet[x]), heights.sizes[START])
            cells = colours.regime_cells(regimes).ravel()
            layers: list[Layer] = [lane_dots(along, heights.values.ravel(), cells, dot_size(facet.sizes[x]))]
        else:
            layers = value_lines(starts_of(facet), value, lambda lanes: axes.values_along(lanes[x]))
        plots.append(Plot(layers, y=colours.value_axis(value, value.label.replace(" [", "\n["))))
    return plots


def motion_keys(ds: xr.Dataset, values: Sequence[Value]) -> list[Key]:
    """Return the legend entries of what `value_plots` draws besides the lines of lanes that repeat."""
    keys: list[Key] = []
    if not values:
        return keys
    if any({f"{value.name}_min", f"{value.name}_max"} <= set(ds) for value in values):
        keys.append(Area(alpha=0.4, label="range of the blows"))
    if "cycles" in ds and bool((ds["cycles"] == 0).any()):
        keys.append(dots(label="mean: does not repeat", **_MEAN))
    return keys


def value_lines(
    lines: Sequence[Series], value: Value, place: Callable[[xr.Dataset], Lanes], dash: Dash | None = None
) -> list[Layer]:
    """Return lines of `value` over the places of their lanes, with the range over the impacts of each lane.

    Without a `dash`, a motion that several lines reach shows the colours of all of them, and means of motions that do
    not repeat are hollow.
    """
    layers: list[Layer] = []
    for k, (_, colour, lanes) in enumerate(lines):
        along, ends = place(lanes), [f"{value.name}_{end}" for end in ("min", "max")]
        if dash is None and all(end in lanes for end in ends):
            low, high = (lanes[end].values * value.factor for end in ends)
            layers.append(Area(along, low, high, colour, 0.15))
        look = nested_line(k, len(lines)) if dash is None else {"size": 3.0, "dash": dash}
        heights = np.ravel(value.of(lanes).values)
        layers.append(Line(along, heights, colour, marker="o", clip=False, **look))
        if dash is None and "cycles" in lanes and (mean := np.ravel(lanes["cycles"].values) == 0).any():
            about = _MEAN | {"size": look["size"], "colour": colour}
            layers.append(dots(along[mean], heights[mean], clip=False, **about))
    return layers


# In rows of panels.


@dataclass(frozen=True)
class Across:
    """Horizontal axis of curves: the coordinate `name` times `factor`. `name` is empty if nothing varies.

    String values are placed at 0, 1, ...
    """

    name: str
    label: str
    values: Shaped[np.ndarray, " values"]
    factor: float = 1.0
    is_number: bool = False

    def of(self, lanes: xr.Dataset) -> Float[np.ndarray, " lanes"]:
        """Return the positions of lanes along the axis."""
        if not self.name:
            return np.zeros(1)
        values = np.atleast_1d(lanes[self.name].values)
        if self.is_number:
            return np.asarray(values * self.factor, float)
        return np.array([float(self.values.tolist().index(value)) for value in values.tolist()])

    def axis(self, ds: xr.Dataset, **about: Any) -> Axis:
        """Return the axis of a plot of lanes of the dataset."""
        about = {"label": self.label, "name": self.name, "group": "across"} | about
        if self.is_number:
            return axes.map_axis(ds[self.name], **about) if axes.is_geometric(self.values) else Axis(**about)
        ticks = [(float(k), str(value)) for k, value in enumerate(self.values)] if self.name else []
        limits = (-0.5, len(ticks) - 0.5) if ticks else (None, None)
        return Axis(**{"ticks": ticks, "limits": limits, **about})

    def dash(self, ds: xr.Dataset) -> Dash:
        """Return the line style along the axis, none for string values and for points of a list."""
        return "-" if self.is_number and POINT not in lane_dims(ds) else ""


def across(ds: xr.Dataset, name: str) -> Across:
    """Return the axis of a coordinate, or one along which nothing varies if `name` is empty."""
    if not name:
        return Across("", "", np.zeros(1))
    if not is_numeric(ds[name]):
        return Across(name, name, np.array([*dict.fromkeys(ds[name].values.tolist())]))
    factor = axes.scale(ds[name])[0]
    return Across(name, axes.label(ds[name]), np.unique(ds[name].values) * factor, factor, True)


def longest_axis(ds: xr.Dataset) -> Across:
    """Return the longest numeric axis, preferably `frequency`; without numeric axes, the longest string-valued axis.

    **Raises:** `InputError` if there are several points and no parameter that distinguishes them.
    """
    numbers = contents.varied(ds) if POINT in lane_dims(ds) else {name: ds.sizes[name] for name in contents.swept(ds)}
    sizes = numbers or {name: ds.sizes[name] for name in contents.named_axes(ds)}
    if not sizes and ds.sizes.get(POINT, 1) > 1:
        raise InputError(f"nothing to draw over: no parameter varies along the {ds.sizes[POINT]} points")
    return across(ds, max(sizes, key=lambda name: (sizes[name], name == _FREQUENCY), default=""))


def axis_of_lines(ds: xr.Dataset, along: str) -> str:
    """Return the axis with one line per value: the longest except `along`, `start` only if there is no other."""
    if POINT in lane_dims(ds):
        sizes = {name: count for name, count in contents.varied(ds, names=True).items() if count <= contents.MOST_LINES}
    else:
        sizes = {name: ds.sizes[name] for name in (*contents.swept(ds), *contents.named_axes(ds))}
    rest = [name for name in sizes if name != along]
    return max(rest, key=lambda name: (name != START, sizes[name], not is_numeric(ds[name])), default="")


def split_lines(ds: xr.Dataset, by: str) -> list[Series]:
    """Return the lines of a facet, one per value of the axis `by`; numeric values are sorted."""
    if not by:
        return [Series("", BIT, ds)]
    values = list(dict.fromkeys(ds[by].values.tolist()))
    values = sorted(values) if is_numeric(ds[by]) else values
    graded, lines = line_colours(len(values)), []
    for position, value in enumerate(values):
        lanes = ds.isel({ds[by].dims[0]: np.flatnonzero(ds[by].values == value)})
        if is_numeric(ds[by]):
            colour = graded[position]
        elif by == FORM:
            colour = colours.form_colour(value)
        else:
            colour = start_colour(value, position) if by == START else ROCK_COLOURS.get(value, other_colour(position))
        name = axes.value_text(ds[by], value).removeprefix("rock: ").removeprefix("form: ")
        lines.append(Series(name, colour, lanes.isel({by: 0}) if by in lanes.dims else lanes))
    return lines


def line_keys(ds: xr.Dataset, by: str, **look: Any) -> list[Line]:
    """Return the legend entries for lines; of too many lines, an even selection from the first to the last."""
    lines = split_lines(ds, by) if by else []
    chosen = [lines[i] for i in contents.some_of(len(lines))]
    return [key(line.name, **{"marker": "o", "size": 4.0, "colour": line.colour, **look}) for line in chosen]


def row_per_facet(
    ds: xr.Dataset,
    x: Across,
    by: str,
    draws: Sequence[Callable[[list[Series]], Plot]],
    keys: Sequence[Sequence[Key]],
    *notes: str,
) -> Sheet:
    """Draw lines, one per value of `by`: a row for each facet, and a column for each of `draws`, which return plots."""
    panels, plots = facets(ds, (POINT, x.name, by), NARROW_ROWS if is_narrow() else MOST_ROWS), []
    for row, (title, facet) in enumerate(panels):
        for column, draw in enumerate(draws):
            above = "" if column else title
            plots.append(replace(draw(split_lines(facet, by)), title=above, place=(row, column), at=at(facet)))
    height = 2.9 if len(panels) == 1 else 2.3
    size = _PANEL_WIDTH * len(draws) + LEGEND_WIDTH, height * len(panels) + STACK_MARGINS
    return Sheet(plots, size, keys=keys, **axes.margins(ds, panels.note, *notes))


def curves(ds: xr.Dataset, names: Sequence[str], note: str = "") -> Sheet:
    """Draw variables over the longest axis: a row per facet, a line per value of another axis or form of a law."""
    x = longest_axis(ds)
    by = FORM if FORM in ds[names[0]].dims else axis_of_lines(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    dash, across = x.dash(ds), x.axis(ds)

    def draw(lines: list[Series], value: Value) -> Plot:
        return Plot(value_lines(lines, value, x.of, dash), across, colours.value_axis(value, group=value.name))

    draws = [partial(draw, value=colours.value_of(ds[name])) for name in names]
    return row_per_facet(ds, x, by, draws, [line_keys(ds, by, dash=dash)], note)


# Rates of penetration.


def rates(ds: xr.Dataset) -> Sheet:
    """Draw the rate of penetration over the longest axis and over the relief P/D, and the slip or the force per blow.

    Colours distinguish the values of the second longest axis. Further axes become rows, at most four; a note lists the
    values shown if not all fit. Hollow markers are lanes without penetration; crosses are motions other than a single
    impact. A list of points is drawn over the parameter with the most values.
    """
    ds = contents.rates_in(ds)
    x = longest_axis(ds)
    by = axis_of_lines(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    dash = x.dash(ds)
    named = bool(by) and not is_numeric(ds[by]) and bool(dash)  # starts or rocks, whose lines may coincide

    def from_zero(name: str, unit: str = "") -> Axis:
        """Return an axis from zero, to show whether lines pass through it."""
        return Axis(axes.with_unit(colours.words_for(name), unit), name, (0.0, None), group=name)

    def draw(lines: list[Series], name: str, over_relief: bool) -> Plot:
        factor, unit = axes.scale(ds[name])
        layers: list[Layer] = []
        for k, line in enumerate(lines):
            places = np.atleast_1d(line.lanes[RELIEF].values) if over_relief else x.of(line.lanes)
            look = nested_line(k, len(lines)) if named or (dash and _coincide(lines, name)) else {"dash": dash}
            layers += _rate_layers(line, places, factor * np.atleast_1d(line.lanes[name].values), look)
        return Plot(layers, from_zero(RELIEF) if over_relief else x.axis(ds), from_zero(name, unit))

    def varies(name: str) -> bool:
        """Return whether a variable varies along any of the lines."""
        along = [dim for dim in ds[name].dims if dim in (x.name, POINT)]
        swing = ds[name].max(along) - ds[name].min(along)
        return bool((swing > _CONSTANT * np.abs(ds[name]).max()).any())

    each_blow = [name for name in (_PEAK, _SLIP) if name in ds]
    drawn = [(RATE, False), *([(RATE, True)] if RELIEF in ds and varies(RELIEF) and bool((ds[RATE] > 0).any()) else [])]
    drawn += [(max(each_blow, key=varies), False)] if each_blow else []
    lines = line_keys(ds, by, dash=dash)
    if named:
        lines = [replace(each, **nested_line(k, len(lines))) for k, each in enumerate(lines)]
    motions = [name for name, mask in _motions(ds).items() if mask.any() and (name == "none" or REGIME in ds)]
    marks = [dots(label=_MARKS[name][0], **{"size": 4.5} | _MARKS[name][1]) for name in motions]
    count = int(np.isnan(ds[RATE].values).sum())
    missing = f"{count} of {counted(ds[RATE].size, 'lane')} without a rate" if count else ""
    draws = [partial(draw, name=name, over_relief=over_relief) for name, over_relief in drawn]
    return row_per_facet(ds, x, by, draws, [lines, marks], missing)


def _coincide(lines: Sequence[Series], name: str) -> bool:
    """Return whether two lines are on top of each other at most places where they are above zero."""
    heights = np.sort([np.atleast_1d(line.lanes[name].values) for line in lines], axis=0)
    gaps = np.where(heights[1:] > 0, np.diff(heights, axis=0), np.nan) / (np.nanmax(heights, initial=0.0) or 1.0)
    return bool((np.sum(gaps < _SAME_LINE, axis=1) > heights.shape[1] / 2).any())


def _rate_layers(line: Series, places: Lanes, values: Lanes, look: Look) -> list[Layer]:
    """Return one line, interrupted at jumps between a single impact and another motion, and markers of its motions."""
    motions = _motions(line.lanes)
    jumps = 1 + np.flatnonzero(np.diff(motions["other"].astype(int)))
    x, y = (np.insert(np.asarray(along, float), jumps, np.nan) for along in (places, values))
    layers: list[Layer] = [Line(x, y, colour=line.colour, **look)]
    size = look.get("size", 3.8) if values.size < _MANY_LANES else 2.0
    for motion, mask in motions.items():
        if mask.any():
            mark = _MARKS[motion][1] | {"size": size + (motion == "none"), "colour": line.colour, "clip": False}
            layers.append(dots(places[mask], values[mask], **mark))
    return layers


def _motions(lanes: xr.Dataset) -> dict[str, Bool[np.ndarray, "*lanes"]]:
    """Return masks of the lanes with a single impact, another motion, and a single impact without penetration."""
    nothing = np.atleast_1d(lanes[RATE].values) == 0
    single = np.atleast_1d(lanes[REGIME].values) == colours.SINGLE if REGIME in lanes else np.ones(nothing.shape, bool)
    return {"single": single & ~nothing, "other": ~single, "none": single & nothing}
