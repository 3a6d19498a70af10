"""Branches of orbit families: points, stability, special points, and lines that are solid where orbits are stable."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Int

from vibrojax.errors import InputError, shown
from vibrojax.io.attributes import text_of
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.pictures.axes import scale, value_text, values_along
from vibrojax.pictures.contents import is_numeric, some_of
from vibrojax.pictures.plots import INK, Dash, Layer, Line, Look, dots, key
from vibrojax.pictures.style import BIT, line_colours, other_colour
from vibrojax.scenes import SCENES

STABLE, UNSTABLE, UNKNOWN = 1, 0, -1

KIND, FAMILY = "special_kind", "family"

CRITICAL = 1e-3  # distance of the largest modulus from 1 up to which a bifurcation changes stability
BEGINNINGS = ("period-doubling", "branch-point")  # kinds of special points at which other branches begin

_KIND_PRIORITY = ("fold", "period-doubling", "torus", "branch-point", "hopf", "section", "grazing", "stick", "end")
"""Kinds of special points, ordered by how well they explain a change of stability, for points with several kinds."""


class Branch(NamedTuple):
    """One branch of a family: indices of its points, in order along the branch, and of its special points.

    Several families have a colour each; the branches of a single one have the colours of their periods in returns.
    """

    family: int
    number: int
    points: Int[np.ndarray, " points"]
    special: Int[np.ndarray, " special"]
    cycles: int
    colour: str


class Interval(NamedTuple):
    """A parameter interval in which a branch is stable.

    `low_kind` and `high_kind` are the kinds of the special points at its ends, "" where there is no special point.
    """

    low: float
    high: float
    low_kind: str
    high_kind: str


def along_name(ds: xr.Dataset) -> str:
    """Return the name of the continuation parameter."""
    return str(ds.attrs["along"])


def kind_names(ds: xr.Dataset) -> list[str]:
    """Return the kind of each special point, as a string: one of `SPECIAL_KINDS`, or the name of a system's event."""
    meanings = str(ds[KIND].attrs.get("flag_meanings", "")).split()
    if wrong := [name for name in meanings if name not in SPECIAL_KINDS and not name.isidentifier()]:
        raise InputError(f"variable {KIND}: {shown(wrong)} are not kinds of special points")
    return [meanings[flag] for flag in ds[KIND].values.astype(int).tolist()]


def numbers_of(ds: xr.Dataset, which: str) -> Int[np.ndarray, " which"]:
    """Return the family number of each point (`which` = "point") or special point (`which` = "special")."""
    name = f"{which}_{FAMILY}"
    return ds[name].values.astype(int) if name in ds else np.zeros(ds.sizes[which], int)


def family_coordinates(ds: xr.Dataset, which: str) -> dict[str, np.ndarray]:
    """Return the coordinates that distinguish families, by name: their values at each point or special point.

    After a selection of one family, these are scalars. They are undefined at points of families that are left out.
    """
    numbers, labels = numbers_of(ds, which), family_numbers(ds)
    same = numbers[:, None] == labels
    coordinates = {}
    for name, data in ds.coords.items():
        if name != FAMILY and data.dims in ((), (FAMILY,)):
            values = np.broadcast_to(data.values, len(labels))[same.argmax(axis=1)]
            undefined = "" if values.dtype.kind in "UO" else np.nan
            coordinates[str(name)] = np.where(same.any(axis=1), values, undefined)
    return coordinates


def with_selected_families(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with the points and special points of its families alone, for example after `isel`."""
    labels = family_numbers(ds)
    return ds.isel({name: np.isin(numbers_of(ds, name), labels) for name in ("point", "special")})


def family_numbers(ds: xr.Dataset) -> Int[np.ndarray, " families"]:
    """Return the numbers of a dataset's families."""
    if FAMILY in ds.coords:
        return np.atleast_1d(ds[FAMILY].values)
    return np.unique(np.concatenate([numbers_of(ds, name) for name in ("point", "special")]))


def branches(ds: xr.Dataset) -> Iterator[Branch]:
    """Yield the branches of all families, in stored order."""
    of_points, of_special = numbers_of(ds, "point"), numbers_of(ds, "special")
    number, special = ds["branch"].values.astype(int), ds["special_branch"].values.astype(int)
    colours = _family_colours(ds)
    for family, branch in dict.fromkeys(zip(of_points.tolist(), number.tolist(), strict=True)):
        points = np.flatnonzero((of_points == family) & (number == branch))
        at_special = np.flatnonzero((of_special == family) & (special == branch))
        cycles = int(ds["cycles"].values[points[0]]) if "cycles" in ds else 1
        colour = colours.get(family) or _COLOUR_OF_CYCLES.get(cycles, other_colour(cycles))
        yield Branch(family, branch, points, at_special, cycles, colour)


def places(ds: xr.Dataset, branch: Branch) -> Int[np.ndarray, " special"]:
    """Return, for each special point of a branch, the index of the same point among the points.

    Several special points at the same parameter value are assigned to different points if possible.
    """
    values, special_values = ds[along_name(ds)].values[branch.points], ds["special_value"].values[branch.special]
    taken = np.zeros(len(values), int)
    indices = []
    for value in special_values:
        nearest = int(np.lexsort((taken, np.abs(values - value)))[0])
        taken[nearest] += 1
        indices.append(branch.points[nearest])
    return np.array(indices, int)


def stability(ds: xr.Dataset, branch: Branch) -> Int[np.ndarray, " segments"]:
    """Return the stability of each segment between successive points of a branch: 1, 0, or -1 if unknown.

    Multipliers at a special point hold on only one side of it. The stability of the neighbouring point is used instead.
    Between two successive bifurcations, stability is the opposite of that beside them.
    """
    stable, at = ds["stable"].values[branch.points].astype(int), places(ds, branch)
    special = np.isin(branch.points, at)
    here, following = stable[:-1], stable[1:]
    either = np.where(special[1:] & ~special[:-1], here, np.minimum(here, following))
    either = np.where(special[:-1] & ~special[1:], following, either)
    result = np.where(here == following, here, either)
    if LARGEST in ds:
        names = np.array(kind_names(ds), object)[branch.special]
        changes = np.isin(branch.points, at[np.isin(names, ("fold", "period-doubling", "torus"))])
        changes &= np.abs(heights_of(ds, LARGEST, 1.0)[branch.points] - 1) < CRITICAL
        for k in np.flatnonzero(changes[:-1] & changes[1:]).tolist():
            beside = result[k - 1 if k else len(result) > 1]
            result[k] = {STABLE: UNSTABLE, UNSTABLE: STABLE}.get(beside, beside)
    return result


def runs(segments: Int[np.ndarray, " segments"]) -> Iterator[tuple[int, int, int]]:
    """Yield each run of segments with equal stability, as (first point, last point, stability)."""
    ends = np.flatnonzero(np.diff(segments)) + 1
    for first, last in zip([0, *ends.tolist()], [*ends.tolist(), len(segments)], strict=True):
        if last > first:
            yield first, last, int(segments[first])


def stable_intervals(ds: xr.Dataset, branch: Branch) -> list[Interval]:
    """Return the parameter intervals in which a branch is stable."""
    values, names = ds[along_name(ds)].values[branch.points], kind_names(ds)
    ranks, kinds = {kind: k for k, kind in enumerate(_KIND_PRIORITY)}, dict[int, str]()
    for special, point in zip(branch.special.tolist(), places(ds, branch).tolist(), strict=True):
        both = kinds.get(point, names[special]), names[special]
        kinds[point] = min(both, key=lambda kind: ranks.get(kind, ranks["stick"]))
    # Special points of other branches, at which this one begins or which it crosses.
    begins = [k for k, name in enumerate(names) if name in BEGINNINGS and branch.number]
    for special in begins:
        for point in branch.points[values == ds["special_value"].values[special]].tolist():
            kinds.setdefault(point, names[special])

    def end(index: int) -> tuple[float, str]:
        return float(values[index]), kinds.get(int(branch.points[index]), "")

    intervals = []
    for first, last, stable in runs(stability(ds, branch)):
        if stable == STABLE:
            (low, low_kind), (high, high_kind) = sorted((end(first), end(last)))
            intervals.append(Interval(low, high, low_kind, high_kind))
    return intervals


# Lines.

LARGEST, LEADING = "multiplier_abs", "eigenvalue_re"
_LINES: dict[int, Dash] = {STABLE: "-", UNSTABLE: (0.0, (3.5, 2.0)), UNKNOWN: ":"}
_MEANINGS = {STABLE: "stable", UNSTABLE: "unstable", UNKNOWN: "stability not known"}

# Shapes and colours that are distinct in greyscale and for colour-blind readers.
MARKS: dict[str, Look] = {
    "fold": {"marker": "s", "colour": "#222222", "size": 5.5},
    "period-doubling": {"marker": "o", "colour": "#D55E00", "size": 5.5},
    "torus": {"marker": "*", "colour": "#B5468B", "size": 9.0},
    "branch-point": {"marker": "P", "colour": "#117733", "size": 6.5},
    "grazing": {"marker": "v", "colour": "#009E73", "size": 6.0},
    "stick": {"marker": "|", "colour": "#E69F00", "size": 6.0, "edge_width": 1.4},
    "section": {"marker": "D", "colour": "#0072B2", "size": 4.5},
    "hopf": {"marker": "^", "colour": "#882255", "size": 6.0},
    "end": {"marker": "x", "colour": "#222222", "size": 4.5, "edge_width": 1.2},
}
_WORDS = {
    "torus": "second frequency",
    "grazing": "an impact begins or ends",
    "stick": "begins or ends",
    "section": "the bit meets the drive",
    "basin": "the start leads elsewhere",
}
_OWN_EVENT: Look = {"marker": ">", "colour": "#E69F00", "size": 6.0}
_COLOUR_OF_CYCLES = {0: BIT, 1: BIT, 2: "#D1570A", 4: "#2E8B57", 8: "#9B30C9"}
_POINTS_PER_STEP = 8  # vertices of a smooth line between successive orbits

Column = np.ndarray


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

    If a period has several return intervals with at most one impact each, they are `name`_min and `name`_max (over the
    impacts of a period), provided that the dataset contains both. Otherwise, it is `name` itself.
    """
    ends = f"{name}_min", f"{name}_max"
    several = "impacts" in ds and 1 < ds["impacts"].values[branch.points[0]] <= branch.cycles
    return ends if several and all(end in ds for end in ends) else (name,)


def heights_of(ds: xr.Dataset, name: str, factor: float) -> np.ndarray:
    """Return a variable at all points, times `factor`; of several multipliers, only the first."""
    return factor * np.asarray(ds[name].isel({dim: 0 for dim in ds[name].dims[1:]}).values, float)


def family_layers(
    ds: xr.Dataset,
    shown: Iterable[Branch],
    name: str,
    factor: float | None = None,
    within: tuple[float, float] | None = None,
) -> list[Layer]:
    """Return the variable `name` along branches as lines, with their special points.

    `factor`: conversion factor of the variable, by default that of its label; `within`: limits of the parameter, for
    black lines with a white edge over the dots of a sweep, labelled by their stability and kinds.
    """
    factor = scale(ds[name])[0] if factor is None else factor
    over_dots = within is not None
    thin = over_dots or FAMILY in ds.dims
    along, kinds = values_along(ds[along_name(ds)]), kind_names(ds)
    low, high = within or (-np.inf, np.inf)
    layers: list[Layer] = []
    for branch in shown:
        special, segments = places(ds, branch), stability(ds, branch)
        colour = INK if over_dots else branch.colour
        for drawn in _shown_names(ds, branch, name):
            heights = heights_of(ds, drawn, factor)
            for first, last, stable in runs(segments):
                points = branch.points[first : last + 1]
                width = (0.9 if thin else 1.6) if stable == STABLE else (0.7 if thin else 1.1)
                corners = np.flatnonzero(np.isin(points, special))
                # The modulus at a special point may hold beyond it.
                solid = np.minimum(heights, 1.0) if name == LARGEST and stable == STABLE else heights
                smoothed = [*smooth(along[points], solid[points], corners, name == LARGEST)]
                x, y = (np.concatenate(part) for part in zip(*smoothed, strict=True))
                # Points outside become NaN, so that they do not change the limits of the panel.
                inside = np.where((x >= low) & (x <= high), y, np.nan)
                text = f"{_MEANINGS[stable]} orbit" if over_dots and np.isfinite(inside).any() else ""
                look: Look = {"halo": 0.3 * over_dots, "order": 4.0, "label": text}
                layers.append(Line(x, inside, colour, width, _LINES[stable], **look))
            for point, place in zip(branch.special, special, strict=True):
                if low <= along[place] <= high and np.isfinite(heights[place]):
                    mark = _mark(kinds[point], 0.7 if thin or branch.number else 1.0)
                    mark["label"] = kind_label(ds, kinds[point]) if over_dots else ""
                    layers.append(dots([along[place]], [heights[place]], order=5.0, **mark))
    return layers


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


def mark_of(kind: str) -> Look:
    """Return the marker of a kind of special point, or of the event that bears its own name."""
    return MARKS.get(kind, _OWN_EVENT)


def _mark(kind: str, size: float) -> Look:
    """Return the marker of a kind of special point, scaled by `size`; filled markers get a white edge."""
    look = mark_of(kind)
    mark = look | {"size": size * look["size"]}
    return mark if mark["marker"] in ("|", "x") else mark | {"edge": "white", "edge_width": 0.5}


# Legend and notes.


def colour_keys(ds: xr.Dataset) -> list[Line]:
    """Return the legend entries for colours: families, or periods in returns; equilibria have none."""
    if FAMILY in ds.dims:
        by, colours = ds[(*distinguishing_coords(ds), FAMILY)[0]], list(_family_colours(ds).values())
        return [key(value_text(by, by.values[k]), colour=colours[k]) for k in some_of(by.size)]
    if LEADING in ds:
        return []
    periods = dict(sorted((branch.cycles, branch.colour) for branch in branches(ds)))
    texts = {cycles: "one return" if cycles == 1 else f"{cycles} returns" for cycles in periods}
    return [key(f"repeats after {texts[cycles]}", colour=colour) for cycles, colour in periods.items()]


def stability_keys(ds: xr.Dataset) -> list[Line]:
    """Return the legend entries for the line styles that occur."""
    occurring = {stable for branch in branches(ds) for *_, stable in runs(stability(ds, branch))}
    return [key(_MEANINGS[stable], dash=line) for stable, line in _LINES.items() if stable in occurring]


def special_keys(ds: xr.Dataset) -> list[Line]:
    """Return the legend entries for the kinds of special points that occur, with their counts."""
    names = kind_names(ds)
    kinds = [*(kind for kind in MARKS if kind in names), *dict.fromkeys(name for name in names if name not in MARKS)]
    return [dots(label=f"{kind_label(ds, kind)}  {names.count(kind)}", **_mark(kind, 1.0)) for kind in kinds]


def kind_label(ds: xr.Dataset, kind: str) -> str:
    """Return a kind of special point or border, with words on what happens there if its name does not say it."""
    name = "Hopf" if kind == "hopf" else kind
    says_it = kind not in _WORDS or (kind == "section" and text_of(ds, "scene") not in SCENES)
    return name if says_it else f"{name} ({_WORDS[kind]})"


def ranges_text(ds: xr.Dataset, names: Sequence[str]) -> str:
    """Return the note that branches of several returns are drawn as minimum and maximum, or "" if there are none."""
    several = any(len(_shown_names(ds, branch, name)) > 1 for branch in branches(ds) for name in names)
    return "Of branches of several returns the least and the greatest blow" if several else ""
