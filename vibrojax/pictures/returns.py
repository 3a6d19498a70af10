"""Section crossings over an axis: bifurcation diagrams, and lanes carried up and down with their jumps."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.errors import InputError, shown
from vibrojax.io.attributes import run_of
from vibrojax.measures.labels import COMPARED, FAILED, SAME_WITHIN, UNDECIDED
from vibrojax.pictures import contents, overlays
from vibrojax.pictures.axes import broken, number, pretty_unit, scale, values_along, with_unit
from vibrojax.pictures.branches import kind_names
from vibrojax.pictures.colours import Value, regime_cells, regimes_in, values_beside
from vibrojax.pictures.contents import DIRECTION, IMPACTS_OF_RETURNS, REGIME, RETURN, START
from vibrojax.pictures.lines import Lanes, dot_size, lane_dots, motion_keys, stacks, starts_of, value_plots
from vibrojax.pictures.overlays import Overlays
from vibrojax.pictures.plots import Axis, Key, Layer, Look, Plot, Points, Sheet, dots, key, upright
from vibrojax.pictures.style import nested_line

Places = Int[np.ndarray, " _"]

_MARKERS = {"up": ">", "down": "<"}
_OTHERS = "#CFCFCF"
_HALO = 1.75  # diameter of the dots of other starts over that of a start's own: a rim shows where they coincide
_LETTERS = 26  # that fit along the label of a diagram


def bifurcation(ds: xr.Dataset, over: Overlays = None, variable: str | None = None) -> Sheet:
    """Draw `variable` at each stored section crossing over the swept axis, one diagram per initial condition.

    The default is that of `contents.returns_in`. The crossings of all other initial conditions are grey: two motions
    coexist where coloured and grey dots differ. Many initial conditions share one diagram, coloured by regime. The
    swept axis is the one with the most values; further axes become panels. Families along it, `over`, are drawn over
    the crossings that have the same parameters.

    **Raises:** `InputError` if no crossings are stored, nothing is swept, or `over` does not match the dataset.
    """
    if contents.returns_in(ds) is None or REGIME not in ds:
        raise InputError("no returns to draw: the dataset holds none; run the sweep with keep_returns above 0")
    ds = contents.without_single(ds)
    if not contents.swept(ds):
        raise InputError("no bifurcation diagram: none of the grid's axes has more than one value")
    x = max(contents.swept(ds), key=lambda name: ds.sizes[name])
    diagrams = 1 if contents.many_starts(ds) else len(starts_of(ds))
    layers = overlays.as_layers(over)
    overlays.check_families(ds, layers, x)
    grey: list[Key] = [dots(label="all other starts", size=6.5, colour=_OTHERS)] if diagrams > 1 else []
    shown = variable or str(contents.returns_in(ds))
    heights = 1.0 + 2.6 / diagrams, 1.0 + 1.6 / diagrams  # [inch], for one facet and for several
    draw = partial(_return_plots, shown=shown, x=x, layers=layers)
    return stacks(ds, x, diagrams, heights, draw, grey, overlays.over_text(ds, layers, shown))


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


def _return_plots(facet: xr.Dataset, shown: str, x: str, layers: Sequence[xr.Dataset]) -> list[Plot]:
    """Draw the section crossings of each initial condition over those of all others, then the families."""
    factor, unit = scale(facet[shown])
    words = broken(with_unit(returns_label(facet[shown]), unit), _LETTERS)
    up = Axis(words, shown, group="returns")
    families = overlays.over_layers(layers, facet, x, overlays.variable_over(shown), factor)
    size = dot_size(facet.sizes[x])
    if contents.many_starts(facet):
        regimes = np.repeat(regime_cells(facet[REGIME].transpose(x, START)).ravel(), facet.sizes[RETURN])
        crossings = lane_dots(*_dots(facet[shown], factor, x, START), regimes, size / np.sqrt(2))
        return [Plot([crossings, *families], y=up)]
    clouds, plots = [(start, *_dots(start.lanes[shown], factor, x)) for start in starts_of(facet)], []
    for start, along, values in clouds:
        grey: list[Layer] = [
            Points(x_other, y_other, _OTHERS, _HALO * size, clip=False)
            for other, x_other, y_other in clouds
            if other is not start
        ]
        own = Points(along, values, start.colour, size, order=3.0, clip=False)
        plots.append(Plot([*grey, own, *families], y=up, title=f"start: {start.name}" if start.name else ""))
    return plots


# Lanes carried up and down.


def hysteresis(ds: xr.Dataset, over: Overlays = None, variable: str | None = None) -> Sheet:
    """Draw lanes carried up and down along an axis, with the jumps of both directions, above the regimes of each.

    The curves are `variable` at each section crossing if these were stored, else impact velocity and period; families
    along the axis, `over`, are drawn over them. A jump is a place where the two directions begin or cease to differ.
    The note lists the special point nearest to each, except those of kind "end".
    """
    along = str(run_of(ds).get("carry"))
    if along not in ds.dims:
        raise InputError(f"attribute run: carry: {shown(along)} is not an axis of the carried lanes")
    ds = regimes_in(ds.rename({DIRECTION: START}))
    at_returns = variable or contents.returns_in(ds)
    values = [] if at_returns is not None else values_beside(ds)
    layers = overlays.as_layers(over)
    overlays.check_families(ds, layers, along)
    others = [name for name in ds[REGIME].dims if name not in (START, along)]
    lines = [
        ds.isel(dict(zip(others, index, strict=True))) for index in np.ndindex(*(ds.sizes[name] for name in others))
    ]
    keys: list[Key] = []
    marks: list[Key] = []
    for k, way in enumerate(starts_of(ds)):
        look = nested_line(k, 2) if values else {"dash": "", "size": 3.5 if k else 6.0}
        keys.append(key(way.name, colour=way.colour, marker="o", **look))
        if any(jumps(line, along)[k].size for line in lines):
            mark: Look = {"marker": _MARKERS.get(way.name, "o"), "size": 6.0, "dash": "--", "width": 1.0}
            marks.append(key(f"jump on the way {way.name}", colour=way.colour, **mark))
    about = "Where the two ways differ, two motions coexist"
    of_families = overlays.over_text(ds, layers, at_returns or IMPACTS_OF_RETURNS)
    note = ". ".join(filter(None, (about, of_families, _jumps_text(ds, along, layers))))
    height = 3.4 if len(values) < 2 else 1.9
    draw = partial(_way_plots, values=values, shown=str(at_returns), x=along, layers=layers)
    return stacks(
        ds, along, max(len(values), 1), (height, height), draw, [*keys, *motion_keys(ds, values), *marks], note
    )


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
    """Return where each direction jumps, and the nearest special points; "" without families, or over several axes."""
    if not layers or set(ds[REGIME].dims) != {along, START}:
        return ""
    points = [zip(kind_names(over), over["special_value"].values.tolist(), strict=True) for over in layers]
    special = [(kind, value) for some in points for kind, value in some if kind != "end"]
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


def _way_plots(
    facet: xr.Dataset, values: Sequence[Value], shown: str, x: str, layers: Sequence[xr.Dataset]
) -> list[Plot]:
    """Draw `values`, or `shown` at the section crossings of both directions in one panel, with families and jumps."""
    ways = starts_of(facet)
    if values:
        plots = value_plots(facet, values, x)
        factors = {value.name: value.factor for value in values}
    else:
        factor, unit = scale(facet[shown])
        factors = {overlays.variable_over(shown): factor}
        size = dot_size(facet.sizes[x])  # larger dots stay visible below smaller ones
        crossings = [
            Points(*_dots(way.lanes[shown], factor, x), way.colour, size * (0.7 if k else 1.2), clip=False)
            for k, way in enumerate(ways)
        ]
        plots = [Plot(crossings, y=Axis(with_unit(returns_label(facet[shown]), unit), shown))]
    along = values_along(facet[x])
    between = (along[1:] + along[:-1]) / 2
    arrows: list[Layer] = []
    for way, places in zip(ways, jumps(facet, x), strict=True):
        for place in between[places].tolist():
            arrows.append(upright(place, colour=way.colour, dash="--", width=1.0, order=0.5))
            mark = {"marker": _MARKERS.get(way.name, "o"), "size": 7.0, "colour": way.colour, "edge": "white"}
            arrows.append(dots([place], [np.inf], **mark))  # below the upper edge
    return [
        replace(plot, layers=[*plot.layers, *overlays.over_layers(layers, facet, x, variable, factor), *arrows])
        for plot, (variable, factor) in zip(plots, factors.items(), strict=True)
    ]
