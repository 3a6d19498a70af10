"""Branches of orbit families as lines, solid where orbits are stable, with special points and legend entries."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.typing import LineStyleType

from vibrojax.pictures.axes import pad_constant, scale, value_text, values_along
from vibrojax.pictures.branch_data import (
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
from vibrojax.pictures.contents import MOST_LINES, is_numeric
from vibrojax.pictures.style import BIT, INK, Mark, line_colours, other_colour

LARGEST = "multiplier_abs"
_LINES: dict[int, LineStyleType] = {STABLE: "-", UNSTABLE: (0.0, (3.5, 2.0)), UNKNOWN: ":"}
_MEANINGS = {STABLE: "stable", UNSTABLE: "unstable", UNKNOWN: "stability not known"}

# Shapes and colours that are distinct in greyscale and for colour-blind readers.
MARKS: dict[str, Mark] = {
    "fold": Mark(marker="s", color="#222222", markersize=5.5),
    "period-doubling": Mark(marker="o", color="#D55E00", markersize=5.5),
    "torus": Mark(marker="*", color="#CC79A7", markersize=9.0),
    "grazing": Mark(marker="v", color="#009E73", markersize=6.0),
    "stick": Mark(marker="|", color="#E69F00", markersize=6.0, markeredgewidth=1.4),
    "section": Mark(marker="D", color="#56B4E9", markersize=4.5),
    "hopf": Mark(marker="^", color="#882255", markersize=6.0),
    "end": Mark(marker="x", color="#222222", markersize=4.5, markeredgewidth=1.2),
}
_COLOUR_OF_CYCLES = {1: BIT, 2: "#D1570A", 4: "#2E8B57", 8: "#9B30C9"}
_POINTS_PER_STEP = 8  # vertices of a smooth line between successive orbits

Column = np.ndarray


class Curve(NamedTuple):
    """A branch and its colour."""

    branch: Branch
    colour: str


def curves_of(ds: xr.Dataset) -> list[Curve]:
    """Return all branches with colours: one per family, or, for a single family, one per period in returns."""
    colours = _family_colours(ds)
    if colours:
        return [Curve(branch, colours[branch.family]) for branch in branches(ds)]
    cycles = ((branch, _cycles(ds, branch)) for branch in branches(ds))
    return [Curve(branch, _COLOUR_OF_CYCLES.get(number, other_colour(number))) for branch, number in cycles]


def _cycles(ds: xr.Dataset, branch: Branch) -> int:
    return int(ds["cycles"].values[branch.points[0]])


def _family_colours(ds: xr.Dataset) -> dict[int, str]:
    """Return colours by family number, graded along the distinguishing coordinate; empty for a single family."""
    if FAMILY not in ds.dims:
        return {}
    by = ds[(*distinguishing_coords(ds), FAMILY)[0]]
    order = np.argsort(np.argsort(by.values, kind="stable")) if is_numeric(by) else np.arange(by.size)
    colours = line_colours(max(by.size, 2))
    return {number: colours[position] for number, position in zip(ds[FAMILY].values.tolist(), order, strict=True)}


def distinguishing_coords(ds: xr.Dataset) -> list[str]:
    """Return the names of the coordinates that distinguish several families."""
    return [str(name) for name, data in ds.coords.items() if data.dims == (FAMILY,) and name != FAMILY]


def _shown_names(ds: xr.Dataset, branch: Branch, name: str) -> tuple[str, ...]:
    """Return the names of the variables that are drawn for `name` along a branch.

    If a period has several return intervals with one impact each, they are `name`_min and `name`_max (over the impacts
    of a period), provided that the dataset contains both. Otherwise, it is `name` itself.
    """
    ends = f"{name}_min", f"{name}_max"
    cycles = _cycles(ds, branch)
    several = cycles > 1 and "impacts" in ds and ds["impacts"].values[branch.points[0]] == cycles
    return ends if several and all(end in ds for end in ends) else (name,)


def heights_of(ds: xr.Dataset, name: str, factor: float) -> np.ndarray:
    """Return a variable at all points, times `factor`; of several multipliers, only the first."""
    return factor * np.asarray(ds[name].isel({dim: 0 for dim in ds[name].dims[1:]}).values, float)


def draw_families(
    axes: Axes,
    ds: xr.Dataset,
    curves: Sequence[Curve],
    name: str,
    thin: bool = False,
    factor: float | None = None,
    within: tuple[float, float] | None = None,
) -> None:
    """Draw the variable `name` along branches, with their special points.

    `thin`: use finer lines and markers; `factor`: conversion factor of the variable, by default that of its label;
    `within`: limits of the parameter, for lines with a white edge over the dots of a sweep.
    """
    edge = [withStroke(linewidth=1.5, foreground="white")] if within else []
    factor = scale(ds[name])[0] if factor is None else factor
    along, kinds = values_along(ds[along_name(ds)]), kind_names(ds)
    low, high = within or (-np.inf, np.inf)
    for branch, colour in curves:
        special, segments = places(ds, branch), stability(ds, branch)
        for shown in _shown_names(ds, branch, name):
            heights = heights_of(ds, shown, factor)
            for first, last, stable in runs(segments):
                points = branch.points[first : last + 1]
                width = (0.9 if thin else 1.6) if stable == STABLE else (0.7 if thin else 1.1)
                look = Mark(color=colour, linestyle=_LINES[stable], linewidth=width, zorder=4)
                corners = np.flatnonzero(np.isin(points, special))
                for x, y in smooth(along[points], heights[points], corners, name == LARGEST):
                    # Points outside become NaN, so that they do not change the limits of the panel.
                    axes.plot(x, np.where((x >= low) & (x <= high), y, np.nan), path_effects=edge, **look)
            for point, place in zip(branch.special, special, strict=True):
                if low <= along[place] <= high and np.isfinite(heights[place]):
                    look = _mark(kinds[point], 0.7 if thin or branch.number else 1.0)
                    axes.plot(
                        along[place], heights[place], linestyle="none", label=f"_{kinds[point]}", zorder=5, **look
                    )
    pad_constant(axes)


def smooth(x: Column, y: Column, corners: Column, logarithmic: bool = False) -> Iterator[tuple[Column, Column]]:
    """Yield smooth lines through points, one between successive corners: monotone cubics, which do not overshoot.

    On a steep curve, continuation steps may be too long for straight segments to look smooth.
    """
    from scipy.interpolate import PchipInterpolator  # slow to import, and no other picture needs it

    for first, last in pairwise(sorted({0, *corners.tolist(), len(x) - 1})):
        part = np.stack([x[first : last + 1], y[first : last + 1]])
        logarithms = logarithmic and bool((part[1] > 0).all())
        if logarithms:
            part[1] = np.log(part[1])
        size = np.ptp(part, axis=1, keepdims=True)
        steps = np.linalg.norm(np.diff(part / np.where(size > 0, size, 1.0), axis=1), axis=0)
        if len(steps) > 1 and np.isfinite(steps).all() and (steps > 0).all():
            t = np.concatenate([[0.0], np.cumsum(steps)])
            between = np.interp(np.linspace(0, len(steps), _POINTS_PER_STEP * len(steps) + 1), np.arange(len(t)), t)
            part = PchipInterpolator(t, part, axis=1)(between)
        if logarithms:
            part[1] = np.exp(part[1])
        yield part[0], part[1]


def _mark(kind: str, size: float) -> Mark:
    """Return the marker of a kind of special point, scaled by `size`; filled markers get a white edge."""
    mark = MARKS[kind] | Mark(markersize=size * MARKS[kind]["markersize"])
    return mark if mark["marker"] in ("|", "x") else mark | Mark(markeredgecolor="white", markeredgewidth=0.5)


# Legend and notes.


def colour_handles(ds: xr.Dataset, curves: Sequence[Curve]) -> list[Artist]:
    """Return the legend entries for colours: families, or periods in returns."""
    entries: dict[str, str] = {}
    if FAMILY in ds.dims:
        by, colours = ds[(*distinguishing_coords(ds), FAMILY)[0]], list(_family_colours(ds).values())
        chosen = sorted({int(index) for index in np.linspace(0, by.size - 1, MOST_LINES).round()})
        entries = {value_text(by, by.values[index]): colours[index] for index in chosen}
    else:
        for cycles, colour in sorted((_cycles(ds, branch), colour) for branch, colour in curves):
            entries[f"repeats after {'one return' if cycles == 1 else f'{cycles} returns'}"] = colour
    return [Line2D([], [], color=colour, label=name) for name, colour in entries.items()]


def stability_handles(ds: xr.Dataset, curves: Sequence[Curve], noun: str = "") -> list[Artist]:
    """Return the legend entries for the line styles that occur; `noun` is appended to each label."""
    occurring = {stable for curve in curves for *_, stable in runs(stability(ds, curve.branch))}
    return [
        Line2D([], [], color=INK, linestyle=line, label=f"{_MEANINGS[stable]}{noun}", linewidth=1.2)
        for stable, line in _LINES.items()
        if stable in occurring
    ]


def special_handles(ds: xr.Dataset, count: bool = True) -> list[Artist]:
    """Return the legend entries for the kinds of special points that occur, with their counts if `count`."""
    names = kind_names(ds)
    return [
        Line2D([], [], label=kind + f"  {names.count(kind)}" * count, **_mark(kind, 1.0) | Mark(linestyle="none"))
        for kind in MARKS
        if kind in names
    ]


def ranges_text(ds: xr.Dataset, names: Sequence[str]) -> str:
    """Return the note that branches of several returns are drawn as minimum and maximum, or "" if there are none."""
    several = any(len(_shown_names(ds, branch, name)) > 1 for branch in branches(ds) for name in names)
    return "Of branches of several returns the least and the greatest blow" if several else ""
