"""Lanes carried up and down along an axis: both ways in one picture, with their jumps."""

from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.analyses.sweep.strips import Stack, dot_size, draw_stacks, draw_values, select_start, start_names
from vibrojax.errors import InputError, shown
from vibrojax.io.attributes import run_of
from vibrojax.measures.labels import COMPARED, FAILED, SAME_WITHIN, UNDECIDED
from vibrojax.plot.axes import number, pretty_unit, scale, values_along, with_unit
from vibrojax.plot.colours import Value, values_beside
from vibrojax.plot.contents import DIRECTION, REGIME, RETURN, RETURNS, START, regimes_in
from vibrojax.plot.overlays import (
    OF_RETURNS,
    Overlays,
    as_layers,
    check_families,
    draw_over,
    over_handles,
    over_text,
    special_points,
)
from vibrojax.plot.style import INK, Mark, start_colour, styled

Places = Int[np.ndarray, " _"]

_MARKERS = {"up": ">", "down": "<"}
_ABOUT = "Each lane starts from where its neighbour ended; where the two ways differ, two motions coexist"


@styled
def hysteresis(ds: xr.Dataset, over: Overlays = None) -> Figure:
    """Draw lanes carried up and down along an axis, with the jumps of both ways, above the regimes of each.

    The curves are the impact velocity at each return if these were kept, else impact velocity and period. A jump is a
    place where the two ways begin or cease to differ.

    **Arguments:** `over`: families of orbits along the axis from `vj.follow`, drawn over the lanes. The note gives the
    special point nearest to each jump, ends left aside.
    """
    along = str(run_of(ds).get("carry"))
    if along not in ds.dims:
        raise InputError(f"attribute run: carry: {shown(along)} is not an axis of the carried lanes")
    ds = regimes_in(ds.rename({DIRECTION: START}))
    values = () if RETURNS in ds else values_beside(ds)
    layers = as_layers(over)
    check_families(ds, layers, along)
    ways = [(name, start_colour(name, position)) for position, name in enumerate(start_names(ds)) if name]
    handles: list[Artist] = [
        Line2D([], [], color=colour, marker=_MARKERS.get(name, "o"), label=name) for name, colour in ways
    ]
    handles.append(Line2D([], [], color=INK, linestyle="--", linewidth=1.0, label="jump of that way"))
    note = ". ".join(filter(None, (_ABOUT, over_text(ds, layers), jumps_text(ds, along, layers))))
    height = 3.4 if len(values) < 2 else 1.9
    draw = partial(_draw, values=values, x=along, layers=layers)
    return draw_stacks(ds, along, max(len(values), 1), (height, height), draw, handles + over_handles(layers), note)


def jumps(ds: xr.Dataset, along: str) -> tuple[Places, Places]:
    """Return the jumps of each way, as indices of the lane before.

    A way jumps if the two begin or cease to differ there, and it is the one that changes more. Lanes that are undecided
    or failed count as their neighbours.
    """
    ways = [select_start(ds, position) for position in range(2)]
    regimes = [way[REGIME].values.astype(int) for way in ways]
    names = [name for name in COMPARED if name in ways[0]]
    # Two ways that repeat differ as starts do: in the label, or by more than their errors.
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
    changes = []  # from each lane to the next
    for way, regime in zip(ways, regimes, strict=True):
        steps = [np.nan_to_num(_relative_difference(way[name].values[1:], way[name].values[:-1])) for name in names]
        changes.append(np.sum([*steps, np.diff(regime) != 0], axis=0)[ends])
    which = np.argmax(changes, axis=0)
    return ends[which == 0], ends[which == 1]


def jumps_text(ds: xr.Dataset, along: str, layers: tuple[xr.Dataset, ...]) -> str:
    """Return the values between which each way jumps, and the nearest special point of the families.

    Empty if more than that axis varies.
    """
    if not layers or set(ds[REGIME].dims) != {along, START}:
        return ""
    special = [point for over in layers for point in special_points(over)]
    values, (factor, unit) = np.asarray(ds[along].values), scale(ds[along])
    texts = []
    for name, places in zip(start_names(ds), jumps(ds, along), strict=True):
        for place in places.tolist():
            low, high = values[place], values[place + 1]
            text = f"{name} between {number(factor * low)} and {number(factor * high)} {pretty_unit(unit)}".rstrip()
            if special:
                kind, value = min(special, key=lambda point: abs(point[1] - (low + high) / 2))
                text += f" ({kind} at {number(factor * value)})"
            texts.append(text)
    return f"Jumps, and the nearest special point: {'; '.join(texts)}" if texts else ""


def _relative_difference(a: Float[np.ndarray, " lanes"], b: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, " lanes"]:
    """Return the difference over the greater of the two, 0 if both are zero."""
    greater = np.maximum(np.abs(a), np.abs(b))
    return np.abs(a - b) / np.where(greater > 0, greater, 1.0)


def _draw(stack: Stack, values: tuple[Value, ...], x: str, layers: tuple[xr.Dataset, ...]) -> None:
    """Draw the values, or the returns of both ways over each other, with families and jumps."""
    facet, names = stack.facet, start_names(stack.facet)
    along = values_along(facet[x])
    if values:
        draw_values(stack, values, x)
        factors = {value.name: value.factor for value in values}
    else:
        factor, unit = scale(facet[RETURNS])
        factors = {OF_RETURNS: factor}
        for position, name in enumerate(names):
            returns = select_start(facet, position)[RETURNS].transpose(x, RETURN)
            size = dot_size(facet.sizes[x]) * (0.5 if position else 1.4)  # the way below shows around the one above
            places = np.repeat(along, returns.sizes[RETURN])
            look: dict[str, Any] = {"linewidths": 0, "color": start_colour(name, position), "rasterized": True}
            stack.curves[0].scatter(places, factor * returns.values.ravel(), s=size, **look)
        if stack.first:
            stack.curves[0].set_ylabel(with_unit("impact velocity at each return", unit))
    for axes, (variable, factor) in zip(stack.curves, factors.items(), strict=True):
        draw_over(axes, layers, facet, x, variable, factor)
    between = (along[1:] + along[:-1]) / 2
    for position, (name, places) in enumerate(zip(names, jumps(facet, x), strict=True)):
        colour = start_colour(name, position)
        mark = Mark(marker=_MARKERS.get(name, "o"), markersize=7.0, color=colour, markeredgecolor="white")
        for axes in stack.curves:
            for place in between[places].tolist():
                axes.axvline(place, color=colour, linestyle="--", linewidth=1.0, zorder=0.5)
                axes.plot([place], [0.95], transform=axes.get_xaxis_transform(), linestyle="none", **mark)
