"""Lanes carried up and down along an axis: both ways in one picture, and where they jump."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.analyses.sweep.strips import Stack, dot_size, draw_stacks, draw_values, of_start, start_names
from vibrojax.errors import InputError, shown
from vibrojax.io.attributes import run_of
from vibrojax.measures.labels import COMPARED, FAILED, SAME_WITHIN, UNDECIDED
from vibrojax.plot.axes import number, pretty_unit, scale, values_along, with_unit
from vibrojax.plot.colours import Value, values_beside
from vibrojax.plot.contents import DIRECTION, REGIME, RETURN, RETURNS, START, regimes_in
from vibrojax.plot.overlays import OF_RETURNS, check_over, draw_over, over_handles, over_text, several, special_points
from vibrojax.plot.style import INK, Mark, start_colour, styled

Places = Int[np.ndarray, " _"]

_WAYS = {"up": ">", "down": "<"}
_ABOUT = "Each lane starts from where its neighbour ended; where the two ways differ, two motions coexist"


@styled
def hysteresis(ds: xr.Dataset, over: xr.Dataset | Sequence[xr.Dataset] | None = None) -> Figure:
    """What lanes do that are carried up and down along an axis: the impact velocity at each return where these were
    kept, else impact velocity and period; with the jumps of both ways, above the regimes of each.

    A jump is where the two ways begin to differ, or cease to. `over`: families of orbits along the axis, as `vj.follow`
    gives them, drawn over the lanes; the note says which of their special points, but for the ends, is nearest to each
    jump.
    """
    along = str(run_of(ds).get("carry"))
    if along not in ds.dims:
        raise InputError(f"attribute run: carry: {shown(along)} is no axis of the carried lanes")
    ds = regimes_in(ds.rename({DIRECTION: START}))
    values = () if RETURNS in ds else values_beside(ds)
    every = several(over)
    for one in every:
        check_over(ds, one, along)
    draw = partial(_draw, values=values, x=along, every=every)
    height = 3.4 if len(values) < 2 else 1.9
    handles = [*_handles(ds), *over_handles(every)]
    about = ". ".join(text for text in (_ABOUT, over_text(ds, every, OF_RETURNS), jumps_text(ds, along, every)) if text)
    return draw_stacks(ds, along, max(len(values), 1), lambda count: height, draw, handles, about)


def jumps(ds: xr.Dataset, along: str) -> tuple[Places, Places]:
    """Where lanes over `along` and `start`, the two ways, jump: of each way the places between neighbours.

    Where the ways begin to differ, or cease to, one of them has jumped: the one that changes more there. Lanes that
    were not decided, or failed, count as their neighbours do.
    """
    ways = [of_start(ds, at) for at in range(2)]
    regimes = [way[REGIME].values.astype(int) for way in ways]
    unknown = np.any(np.isin(regimes, (UNDECIDED, FAILED)), axis=0)
    apart = (regimes[0] != regimes[1]) | _another(*ways)
    known = np.flatnonzero(~unknown)
    if not known.size:
        return known, known
    apart = apart[known[np.maximum(np.searchsorted(known, np.arange(apart.size), side="right") - 1, 0)]]
    ends = np.flatnonzero(apart[1:] != apart[:-1])
    changes = np.stack([_changes(way, regime)[ends] for way, regime in zip(ways, regimes, strict=True)])
    which = changes.argmax(axis=0)
    return ends[which == 0], ends[which == 1]


def jumps_text(ds: xr.Dataset, along: str, every: Sequence[xr.Dataset]) -> str:
    """Between which values each way jumps, and the special point of the families that is nearest, in words; nothing
    where more than that axis varies."""
    if not every or set(ds[REGIME].dims) != {along, START}:
        return ""
    special = [point for over in every for point in special_points(over)]
    values, (factor, unit) = np.asarray(ds[along].values), scale(ds[along])
    texts = []
    for name, where in zip(start_names(ds), jumps(ds, along), strict=True):
        for place in where.tolist():
            low, high = values[place], values[place + 1]
            text = f"{name} between {number(factor * low)} and {number(factor * high)} {pretty_unit(unit)}".rstrip()
            if special:
                kind, at = min(special, key=lambda point: abs(point[1] - (low + high) / 2))
                text += f" ({kind} at {number(factor * at)})"
            texts.append(text)
    return f"Jumps, and the nearest special point: {'; '.join(texts)}" if texts else ""


def _another(one: xr.Dataset, other: xr.Dataset) -> Bool[np.ndarray, " values"]:
    """Where two ways repeat, but not the same motion; as for starts."""
    repeat = (one["cycles"].values > 0) & (other["cycles"].values > 0)
    within = SAME_WITHIN + one["error_estimate"].values + other["error_estimate"].values
    with np.errstate(invalid="ignore"):
        return np.asarray(
            repeat & np.any([_relative(one[n].values, other[n].values) > within for n in _in(one)], axis=0)
        )


def _changes(way: xr.Dataset, regime: Int[np.ndarray, " values"]) -> Float[np.ndarray, " between"]:
    """How much changes from each lane to the next."""
    changes = [np.nan_to_num(_relative(way[name].values[1:], way[name].values[:-1])) for name in _in(way)]
    return np.asarray(np.sum([*changes, np.diff(regime) != 0], axis=0))


def _in(ds: xr.Dataset) -> list[str]:
    return [name for name in COMPARED if name in ds]


def _relative(a: Float[np.ndarray, " lanes"], b: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, " lanes"]:
    """Difference over the greater of the two, 0 where both are zero."""
    greater = np.maximum(np.abs(a), np.abs(b))
    return np.abs(a - b) / np.where(greater > 0, greater, 1.0)


def _draw(stack: Stack, values: tuple[Value, ...], x: str, every: Sequence[xr.Dataset]) -> None:
    if values:
        draw_values(stack, values, x)
    else:
        _draw_returns(stack, x)
    shown = {value.name: value.factor for value in values} or {OF_RETURNS: scale(stack.facet[RETURNS])[0]}
    for axes, (name, factor) in zip(stack.curves, shown.items(), strict=True):
        for over in every:
            draw_over(axes, over, stack.facet, x, name, factor)
    ends = values_along(stack.facet[x])
    between = (ends[1:] + ends[:-1]) / 2
    for at, (name, where) in enumerate(zip(start_names(stack.facet), jumps(stack.facet, x), strict=True)):
        for axes in stack.curves:
            _mark(axes, between[where].tolist(), name, start_colour(name, at))


def _draw_returns(stack: Stack, x: str) -> None:
    """Dots of all returns, those of both ways over each other."""
    axes = stack.curves[0]
    factor, unit = scale(stack.facet[RETURNS])
    for at, name in enumerate(start_names(stack.facet)):
        returns = of_start(stack.facet, at)[RETURNS].transpose(x, RETURN)
        along = np.repeat(values_along(stack.facet[x]), returns.sizes[RETURN])
        size = dot_size(stack.facet.sizes[x]) * (0.5 if at else 1.4)  # the way below shows around the one above
        dots = axes.scatter(along, factor * returns.values.ravel(), s=size, linewidths=0, color=start_colour(name, at))
        dots.set_rasterized(True)
    if stack.left:
        axes.set_ylabel(with_unit("impact velocity at each return", unit))


def _mark(axes: Axes, places: list[float], name: str, colour: str) -> None:
    """A dashed line at each jump, with a mark that points the way."""
    for place in places:
        axes.axvline(place, color=colour, linestyle="--", linewidth=1.0, zorder=0.5)
        mark = Mark(marker=_WAYS.get(name, "o"), markersize=7.0, color=colour, markeredgecolor="white")
        axes.plot([place], [0.95], transform=axes.get_xaxis_transform(), linestyle="none", **mark)


def _handles(ds: xr.Dataset) -> list[Line2D]:
    """The ways by colour, and what marks a jump."""
    ways = [
        Line2D([], [], color=start_colour(name, at), marker=_WAYS.get(name, "o"), label=name)
        for at, name in enumerate(start_names(ds))
        if name
    ]
    return [*ways, Line2D([], [], color=INK, linestyle="--", linewidth=1.0, label="jump of that way")]
