"""Section crossings over an axis: bifurcation diagrams, and lanes carried up and down with their jumps."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.errors import InputError, shown
from vibrojax.io.attributes import run_of
from vibrojax.measures.labels import COMPARED, FAILED, SAME_WITHIN, UNDECIDED
from vibrojax.pictures.axes import number, pretty_unit, scale, values_along, with_unit
from vibrojax.pictures.colours import Value, regime_cells, values_beside
from vibrojax.pictures.contents import (
    DIRECTION,
    IMPACTS_OF_RETURNS,
    REGIME,
    RETURN,
    START,
    many_starts,
    regimes_in,
    returns_in,
    swept,
    without_single,
)
from vibrojax.pictures.overlays import (
    OF_RETURNS,
    Overlays,
    as_layers,
    check_families,
    draw_over,
    over_handles,
    over_text,
    special_points,
)
from vibrojax.pictures.strips import (
    Lanes,
    Stack,
    dot_size,
    draw_stacks,
    draw_values,
    scatter_lanes,
    starts_of,
)
from vibrojax.pictures.style import Mark, nested_line, styled

Places = Int[np.ndarray, " _"]

_MARKERS = {"up": ">", "down": "<"}
# Height of a diagram [inches] for one facet and for several, by the number of diagrams.
_HEIGHTS = {1: (3.6, 2.6), 2: (2.4, 2.0), 3: (1.9, 1.6)}
_OTHERS = "#CFCFCF"
_HALO = 3.0  # area of the dots of other starts over that of a start's own: a rim shows where they coincide


@styled
def bifurcation(ds: xr.Dataset, over: Overlays = None, variable: str | None = None) -> Figure:
    """Draw `variable` at each stored section crossing over the swept axis, one diagram per initial condition.

    The default is the impact velocity. It is the first state without impacts, or if some motions of a `vj.System`
    repeat without them.

    The crossings of all other initial conditions are grey: two motions coexist where coloured and grey dots differ.
    Many initial conditions share one diagram, coloured by regime. Panels below show the regimes along the axis: one row
    per initial condition, or the fractions of many. The swept axis is the one with the most values; further axes become
    panels.

    Families of orbits along the swept axis, `over`, are drawn over the crossings that have the same parameters.

    **Raises:** `InputError` if no crossings are stored, nothing is swept, or `over` does not match the dataset.
    """
    if returns_in(ds) is None or REGIME not in ds:
        raise InputError("no returns to draw: the dataset holds none; run the sweep with keep_returns above 0")
    ds = without_single(ds)
    if not swept(ds):
        raise InputError("no bifurcation diagram: none of the grid's axes has more than one value")
    x = max(swept(ds), key=lambda name: ds.sizes[name])
    diagrams = 1 if many_starts(ds) else len(starts_of(ds))
    layers = as_layers(over)
    check_families(ds, layers, x)
    grey = Line2D([], [], label="all other starts", linestyle="none", marker="o", markersize=6.5, color=_OTHERS)
    handles = ([grey] if diagrams > 1 else []) + over_handles(layers)
    shown = variable or str(returns_in(ds))
    draw = partial(_draw_returns, shown=shown, x=x, layers=layers)
    return draw_stacks(ds, x, diagrams, _HEIGHTS.get(diagrams, (1.5, 1.3)), draw, handles, over_text(ds, layers, shown))


def _dots(lanes: xr.DataArray, factor: float, x: str, *dims: str) -> tuple[Lanes, Lanes]:
    """Return the places along `x` and the values, times `factor`, of all section crossings."""
    returns = lanes.transpose(x, *dims, RETURN)
    along = np.repeat(values_along(lanes[x]), returns.size // returns.sizes[x])
    return along, factor * returns.values.ravel()


def returns_label(returns: xr.DataArray) -> str:
    """Return what a diagram of section crossings shows: "impact velocity at each return"."""
    if returns.name == IMPACTS_OF_RETURNS:
        return "impact velocity at each return"
    return str(returns.attrs.get("long_name", returns.name)).removesuffix(" at the return") + " at each return"


def _of_families(returns: str) -> str:
    """Return the variable of families that lies over the section crossings of the variable `returns`."""
    return OF_RETURNS if returns == IMPACTS_OF_RETURNS else returns.replace("return_", "orbit_", 1)


def _draw_returns(stack: Stack, shown: str, x: str, layers: Sequence[xr.Dataset]) -> None:
    """Draw the section crossings of each initial condition over those of all others, then the families."""
    facet, curves = stack.facet, stack.curves
    factor, unit = scale(facet[shown])
    size = dot_size(facet.sizes[x])
    for position, axes in enumerate(curves):
        if not axes.get_shared_y_axes().joined(axes, curves[0]):
            axes.sharey(curves[0])
        if many_starts(facet):
            regimes = regime_cells(facet[REGIME].transpose(x, START)).ravel()
            scatter_lanes(
                axes, *_dots(facet[shown], factor, x, START), np.repeat(regimes, facet.sizes[RETURN]), size / 2
            )
        else:
            for other, (name, colour, lanes) in enumerate(starts_of(facet)):
                along, values = _dots(lanes[shown], factor, x)
                known, own = np.isfinite(values), other == position
                look = Mark(color=colour, label=name) if own else Mark(color=_OTHERS, label=f"_{name}")
                area = size if own else _HALO * size
                axes.scatter(along[known], values[known], s=area, linewidths=0, zorder=2 + own, rasterized=True, **look)
                if own and name:
                    axes.set_title(", ".join(filter(None, (stack.title, f"start: {name}"))), loc="left")
        draw_over(axes, layers, facet, x, _of_families(shown), factor)
    if stack.first:  # a single label, centred on all diagrams of the stack
        middle = curves[len(curves) // 2]
        middle.set_ylabel(with_unit(returns_label(facet[shown]), unit), y=0.5 if len(curves) % 2 else 1.1)


# Lanes carried up and down.


@styled
def hysteresis(ds: xr.Dataset, over: Overlays = None, variable: str | None = None) -> Figure:
    """Draw lanes carried up and down along an axis, with the jumps of both directions, above the regimes of each.

    The curves are `variable` at each section crossing if these were stored, else impact velocity and period. The
    default is that of `bifurcation`. A jump is a place where the two directions begin or cease to differ.

    **Arguments:** `over`: families of orbits along the axis, drawn over the lanes. The note lists the special point
    nearest to each jump, except special points of the kind "end".
    """
    along = str(run_of(ds).get("carry"))
    if along not in ds.dims:
        raise InputError(f"attribute run: carry: {shown(along)} is not an axis of the carried lanes")
    ds = regimes_in(ds.rename({DIRECTION: START}))
    at_returns = variable or returns_in(ds)
    values = () if at_returns is not None else values_beside(ds)
    layers = as_layers(over)
    check_families(ds, layers, along)
    handles: list[Artist] = []
    for k, way in enumerate(starts_of(ds)):
        look = nested_line(k, 2) if values else Mark(linestyle="none", markersize=3.5 if k else 6.0)
        handles.append(Line2D([], [], color=way.colour, marker="o", label=way.name, **look))
    others = [name for name in ds[REGIME].dims if name not in (START, along)]
    lines = [ds.isel(dict(zip(others, at, strict=True))) for at in np.ndindex(*(ds.sizes[name] for name in others))]
    for k, way in enumerate(starts_of(ds)):
        if any(jumps(line, along)[k].size for line in lines):
            mark = Mark(marker=_MARKERS.get(way.name, "o"), linestyle="--", linewidth=1.0)
            handles.append(Line2D([], [], color=way.colour, label=f"jump on the way {way.name}", **mark))
    about = "Each lane starts from where its neighbour ended; where the two ways differ, two motions coexist"
    of_families = over_text(ds, layers, at_returns or IMPACTS_OF_RETURNS)
    note = ". ".join(filter(None, (about, of_families, _jumps_text(ds, along, layers))))
    height = 3.4 if len(values) < 2 else 1.9
    draw = partial(_draw_ways, values=values, shown=str(at_returns), x=along, layers=layers)
    return draw_stacks(ds, along, max(len(values), 1), (height, height), draw, handles + over_handles(layers), note)


def jumps(ds: xr.Dataset, along: str) -> tuple[Places, Places]:
    """Return the jumps of each direction, as indices of the lane before each jump.

    Where the two directions begin or cease to differ, the direction that changes more has a jump. An undecided or
    failed lane counts like the last lane before it that is neither.
    """
    ways = [way.lanes for way in starts_of(ds)]
    regimes = [way[REGIME].values.astype(int) for way in ways]
    names = [name for name in COMPARED if name in ways[0]]
    # Periodic lanes of the two directions differ if their labels differ, or other values differ by more than their
    # errors.
    repeat = np.all([way["cycles"].values > 0 for way in ways], axis=0)
    within = SAME_WITHIN + ways[0]["error_estimate"].values + ways[1]["error_estimate"].values
    with np.errstate(invalid="ignore"):
        far = [_relative_difference(*(way[name].values for way in ways)) > within for name in names]
    apart = (regimes[0] != regimes[1]) | (repeat & np.any(far, axis=0))
    known = np.flatnonzero(~np.any(np.isin(regimes, (UNDECIDED, FAILED)), axis=0))
    if not known.size:
        return known, known
    apart = apart[known[np.maximum(np.searchsorted(known, np.arange(apart.size), side="right") - 1, 0)]]
    ends = np.flatnonzero(apart[1:] != apart[:-1])
    changes = []  # change from each lane to the next
    for way, regime in zip(ways, regimes, strict=True):
        steps = [np.nan_to_num(_relative_difference(way[name].values[1:], way[name].values[:-1])) for name in names]
        changes.append(np.sum([*steps, np.diff(regime) != 0], axis=0)[ends])
    which = np.argmax(changes, axis=0)
    return ends[which == 0], ends[which == 1]


def _jumps_text(ds: xr.Dataset, along: str, layers: Sequence[xr.Dataset]) -> str:
    """Return the values between which each direction jumps, and the nearest special point of the families, as a string.

    The string is empty without families, or if another axis varies.
    """
    if not layers or set(ds[REGIME].dims) != {along, START}:
        return ""
    special = [point for over in layers for point in special_points(over)]
    values, (factor, unit) = np.asarray(ds[along].values), scale(ds[along])
    texts = []
    for way, places in zip(starts_of(ds), jumps(ds, along), strict=True):
        for low, high in zip(values[places], values[places + 1], strict=True):
            text = f"{way.name} between {number(factor * low)} and {number(factor * high)} {pretty_unit(unit)}".rstrip()
            if special:
                kind, value = min(special, key=lambda point: abs(point[1] - (low + high) / 2))
                text += f" ({kind} at {number(factor * value)})"
            texts.append(text)
    return f"Jumps, and the nearest special point: {'; '.join(texts)}" if texts else ""


def _relative_difference(a: Float[np.ndarray, " lanes"], b: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, " lanes"]:
    """Return the absolute difference divided by the larger absolute value; 0 if both values are zero."""
    greater = np.maximum(np.abs(a), np.abs(b))
    return np.abs(a - b) / np.where(greater > 0, greater, 1.0)


def _draw_ways(stack: Stack, values: tuple[Value, ...], shown: str, x: str, layers: Sequence[xr.Dataset]) -> None:
    """Draw `values`, or `shown` at the section crossings of both directions in one panel, with families and jumps."""
    facet, ways = stack.facet, starts_of(stack.facet)
    if values:
        draw_values(stack, values, x)
        factors = {value.name: value.factor for value in values}
    else:
        factor, unit = scale(facet[shown])
        factors = {_of_families(shown): factor}
        for position, way in enumerate(ways):
            size = dot_size(facet.sizes[x]) * (0.5 if position else 1.4)  # larger dots stay visible below smaller ones
            dots = _dots(way.lanes[shown], factor, x)
            stack.curves[0].scatter(*dots, s=size, linewidths=0, color=way.colour, rasterized=True)
        if stack.first:
            stack.curves[0].set_ylabel(with_unit(returns_label(facet[shown]), unit))
    along = values_along(facet[x])
    between = (along[1:] + along[:-1]) / 2
    for axes, (variable, factor) in zip(stack.curves, factors.items(), strict=True):
        draw_over(axes, layers, facet, x, variable, factor)
        for way, places in zip(ways, jumps(facet, x), strict=True):
            mark = Mark(marker=_MARKERS.get(way.name, "o"), markersize=7.0, color=way.colour, markeredgecolor="white")
            for place in between[places].tolist():
                axes.axvline(place, color=way.colour, linestyle="--", linewidth=1.0, zorder=0.5)
                axes.plot([place], [0.95], transform=axes.get_xaxis_transform(), linestyle="none", **mark)
