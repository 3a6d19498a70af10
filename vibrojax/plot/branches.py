"""Branches of families as lines, solid where they are stable, with their special points; and what the legend says."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.typing import LineStyleType

from vibrojax.io.branches import (
    FAMILY,
    STABLE,
    UNKNOWN,
    UNSTABLE,
    Branch,
    along_name,
    branches,
    kind_names,
    places,
    runs,
    stability,
)
from vibrojax.plot.axes import scale, steady, value_text, values_along
from vibrojax.plot.contents import MOST_LINES, is_numeric
from vibrojax.plot.style import BIT, COLOURS, FAINT, INK, OTHER_COLOURS, Mark

LARGEST = "multiplier_abs"
_LINES: dict[int, LineStyleType] = {STABLE: "-", UNSTABLE: (0.0, (3.5, 2.0)), UNKNOWN: ":"}
_MEANINGS = {STABLE: "stable", UNSTABLE: "unstable", UNKNOWN: "stability not known"}

# Shapes and colours that are told apart in greyscale and by colour-blind eyes.
MARKS: dict[str, Mark] = {
    "fold": Mark(marker="s", color="#222222", markersize=5.5),
    "period-doubling": Mark(marker="o", color="#D55E00", markersize=5.5),
    "torus": Mark(marker="*", color="#CC79A7", markersize=9.0),
    "grazing": Mark(marker="v", color="#009E73", markersize=6.0),
    "stick": Mark(marker="|", color="#E69F00", markersize=6.0, markeredgewidth=1.4),
    "section": Mark(marker="D", color="#56B4E9", markersize=4.5),
    "end": Mark(marker="x", color="#222222", markersize=4.5, markeredgewidth=1.2),
}
_COLOUR_OF_CYCLES = {1: BIT, 2: "#D1570A", 4: "#2E8B57", 8: "#9B30C9"}
_VIRIDIS = (0.0, 0.87)  # its yellow end is lost on white
_FINER = 8  # times as many points as there are orbits, on a line

Column = np.ndarray


class Curve(NamedTuple):
    """A branch and how it looks."""

    branch: Branch
    colour: str


def curves_of(ds: xr.Dataset) -> list[Curve]:
    """All branches in their colours: of several families each has one, of one family each number of returns."""
    colours = family_colours(ds)
    return [Curve(one, colours[one.family] if colours else _cycles_colour(ds, one)) for one in branches(ds)]


def _cycles(ds: xr.Dataset, branch: Branch) -> int:
    return int(ds["cycles"].values[branch.points[0]])


def _cycles_colour(ds: xr.Dataset, branch: Branch) -> str:
    cycles = _cycles(ds, branch)
    return _COLOUR_OF_CYCLES.get(cycles, OTHER_COLOURS[cycles % len(OTHER_COLOURS)])


def family_colours(ds: xr.Dataset) -> dict[int, str]:
    """The colours of several families by their numbers, in the order of what differs; none where there is one."""
    if FAMILY not in ds.dims:
        return {}
    by = _telling(ds)
    values = ds[by].values
    order = np.argsort(np.argsort(values, kind="stable")) if is_numeric(ds[by]) else np.arange(len(values))
    shares = np.linspace(*_VIRIDIS, max(len(values), 2))
    colours = [to_hex(colormaps[COLOURS.get() or "viridis"](shares[at])) for at in order]
    return dict(zip(ds[FAMILY].values.tolist(), colours, strict=True))


def _telling(ds: xr.Dataset) -> str:
    """The coordinate that tells families apart: the first that was given, else their number."""
    along = [str(name) for name, data in ds.coords.items() if data.dims == (FAMILY,) and name != FAMILY]
    return along[0] if along else FAMILY


def shown_as(ds: xr.Dataset, branch: Branch, name: str) -> tuple[str, ...]:
    """The variables that stand for `name` on a branch: the least and the greatest of several returns of a blow each."""
    ends = f"{name}_min", f"{name}_max"
    first = branch.points[0]
    several = _cycles(ds, branch) > 1 and "impacts" in ds and ds["impacts"].values[first] == ds["cycles"].values[first]
    return ends if several and all(end in ds for end in ends) else (name,)


def heights_of(ds: xr.Dataset, name: str, factor: float) -> np.ndarray:
    data = ds[name]
    values = data.isel({dim: 0 for dim in data.dims[1:]}).values if data.ndim > 1 else data.values
    return factor * np.asarray(values, float)


def draw_families(
    axes: Axes,
    ds: xr.Dataset,
    curves: Sequence[Curve],
    name: str,
    thin: bool = False,
    factor: float | None = None,
    within: tuple[float, float] = (-np.inf, np.inf),
    over_dots: bool = False,
) -> None:
    """Draw the variable `name`, times `factor`, along branches, with their special points, as far as they are `within`
    values of the parameter; `over_dots` with a white edge."""
    edge = [withStroke(linewidth=1.5, foreground="white")] if over_dots else []
    factor = scale(ds[name])[0] if factor is None else factor
    along, names = values_along(ds[along_name(ds)]), kind_names(ds)
    for branch, colour in curves:
        marked, segments = places(ds, branch), stability(ds, branch)
        for shown in shown_as(ds, branch, name):
            heights = heights_of(ds, shown, factor)
            for first, last, stable in runs(segments):
                points = branch.points[first : last + 1]
                width = (0.9 if thin else 1.6) if stable == STABLE else (0.7 if thin else 1.1)
                look = Mark(color=colour, linestyle=_LINES[stable], linewidth=width, zorder=4)
                corners = np.flatnonzero(np.isin(points, marked))
                for x, y in smooth(along[points], heights[points], corners, name == LARGEST):
                    there = np.where(
                        (x >= within[0]) & (x <= within[1]), y, np.nan
                    )  # no other limits for what is not there
                    axes.plot(x, there, path_effects=edge, **look)
            for one, place in zip(branch.special, marked, strict=True):
                if not within[0] <= along[place] <= within[1]:
                    continue
                mark = _mark(names[one], 0.7 if thin or branch.number else 1.0)
                axes.plot(along[place], heights[place], linestyle="none", label=f"_{names[one]}", zorder=5, **mark)
    steady(axes)


def smooth(x: Column, y: Column, corners: Column, logarithmic: bool = False) -> Iterator[tuple[Column, Column]]:
    """Smooth lines through points, from corner to corner: by monotone cubics, which add no wiggles of their own.

    Orbits are as far apart as their continuation allows, which on a steep curve is further than the eye does.
    """
    from scipy.interpolate import PchipInterpolator  # slow to import, and no other picture needs it

    for first, last in pairwise(sorted({0, *corners.tolist(), len(x) - 1})):
        part = np.stack([x[first : last + 1], y[first : last + 1]])
        if logarithmic and (part[1] > 0).all():
            part[1] = np.log(part[1])
        size = np.ptp(part, axis=1, keepdims=True)
        steps = np.linalg.norm(np.diff(part / np.where(size > 0, size, 1.0), axis=1), axis=0)
        if len(steps) > 1 and np.isfinite(steps).all() and (steps > 0).all():
            t = np.concatenate([[0.0], np.cumsum(steps)])
            between = np.interp(np.linspace(0, len(steps), _FINER * len(steps) + 1), np.arange(len(t)), t)
            part = PchipInterpolator(t, part, axis=1)(between)
        if logarithmic and (y[first : last + 1] > 0).all():
            part[1] = np.exp(part[1])
        yield part[0], part[1]


def _mark(kind: str, size: float) -> Mark:
    mark = MARKS.get(kind, Mark(marker="P", color=FAINT, markersize=5.0))
    own = Mark(markersize=size * float(mark["markersize"]))
    return (
        mark | own if mark["marker"] in ("|", "x") else mark | own | Mark(markeredgecolor="white", markeredgewidth=0.5)
    )


# Legend and notes.


def colour_handles(ds: xr.Dataset, curves: Sequence[Curve]) -> list[Artist]:
    """The legend's entries for what colours mean."""
    entries: dict[str, str] = {}
    if FAMILY in ds.dims:
        by, colours = ds[_telling(ds)], list(family_colours(ds).values())
        chosen = sorted({int(at) for at in np.linspace(0, by.size - 1, MOST_LINES).round()})
        entries = {value_text(by, by.values[at]): colours[at] for at in chosen}
    else:
        for branch, colour in sorted(curves, key=lambda one: _cycles(ds, one.branch)):
            cycles = _cycles(ds, branch)
            entries[f"repeats after {'one return' if cycles == 1 else f'{cycles} returns'}"] = colour
    return [Line2D([], [], color=colour, label=name) for name, colour in entries.items()]


def stability_handles(ds: xr.Dataset, curves: Sequence[Curve], what: str = "") -> list[Artist]:
    """The legend's entries for solid, dashed and dotted lines, where there are any; `what` they are."""
    there = {stable for one in curves for *_, stable in runs(stability(ds, one.branch))}
    return [
        Line2D([], [], color=INK, linestyle=_LINES[stable], label=f"{_MEANINGS[stable]}{what}", linewidth=1.2)
        for stable in _LINES
        if stable in there
    ]


def special_handles(ds: xr.Dataset, count: bool = True) -> list[Artist]:
    """The legend's entries for the kinds of special points that occur, with their number if that is wanted."""
    names = kind_names(ds)
    return [
        Line2D([], [], label=kind + f"  {names.count(kind)}" * count, **_mark(kind, 1.0) | Mark(linestyle="none"))
        for kind in (*MARKS, *dict.fromkeys(one for one in names if one not in MARKS))
        if kind in names
    ]


def ranges_text(ds: xr.Dataset, names: Sequence[str]) -> str:
    """What stands for several blows, in words."""
    several = any(len(shown_as(ds, one, name)) > 1 for one in branches(ds) for name in names)
    return "Of branches of several returns the least and the greatest blow" if several else ""
