"""Families of periodic orbits over a parameter: solid where stable, with their special points and multipliers."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.typing import LineStyleType

from vibrojax.errors import InputError
from vibrojax.families.stretches import (
    FAMILY,
    STABLE,
    UNKNOWN,
    UNSTABLE,
    Branch,
    along_name,
    branches,
    is_families,
    kind_names,
    places,
    runs,
    stability,
)
from vibrojax.plot._axes import label, point_text, scale, steady, value_text, values_along, with_unit
from vibrojax.plot._contents import MOST_LINES, is_numeric
from vibrojax.plot._margins import write_margins
from vibrojax.plot._starts import SYMBOLS
from vibrojax.plot.style import BIT, COLOURS, FAINT, INK, OTHER_COLOURS, Mark, new_figure, styled

LARGEST = "multiplier_abs"
_LINES: dict[int, LineStyleType] = {STABLE: "-", UNSTABLE: (0.0, (3.5, 2.0)), UNKNOWN: ":"}
_MEANINGS = {STABLE: "stable", UNSTABLE: "unstable", UNKNOWN: "stability not known"}

# Shapes and colours that are told apart in greyscale and by colour-blind eyes.
_MARKS: dict[str, Mark] = {
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
_MODULI = (1e-2, 1e2)  # greatest range of the largest modulus that is drawn
_FEW = 50.0  # between its ends, up to which 2 and 5 have ticks as well
_PLANE = (1.2, 1.5)  # half the width of the plane of multipliers, at least and at most
_FINER = 8  # times as many points as there are orbits, on a line
_HEIGHT = 2.1  # inches of a panel


Column = np.ndarray


class Curve(NamedTuple):
    """A branch and how it looks."""

    branch: Branch
    colour: str


@styled
def families(ds: xr.Dataset, names: Sequence[str] = ()) -> Figure:
    """Families over the parameter, solid where they are stable, dashed where not, with their special points.

    Above each other the impact velocity (without impacts the bit's amplitude), the bit's position at the section, and
    the largest modulus of the multipliers; beside them the multipliers in the complex plane. Of one family branches are
    told apart by their number of returns, and the multipliers are those of the first branch, in the colour of the
    parameter; of several each has its own colour.

    **Arguments:**

    - `ds`: what `follow` gives.
    - `names`: variables along `point` to draw in place of the first two.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no families, or no such variable.
    """
    if not is_families(ds):
        raise InputError("no families to draw: the dataset holds no branch and special_kind, as vj.follow gives them")
    names = (*(names or _usual(ds)), LARGEST)
    curves, many = _curves(ds), FAMILY in ds.dims
    figure = new_figure(11.0, _HEIGHT * len(names) + 0.8)
    columns = GridSpec(1, 2, figure, width_ratios=[1.75, 1.0])
    above = columns[0].subgridspec(len(names), 1)
    panels: list[Axes] = []
    for at, name in enumerate(names):
        axes = figure.add_subplot(above[at], sharex=panels[0] if panels else None)
        draw_families(axes, ds, curves, name, thin=many)
        axes.set_ylabel(_label(ds, name))
        axes.tick_params(labelbottom=at == len(names) - 1)
        axes.grid(True)
        panels.append(axes)
    _shape_moduli(panels[-1])
    panels[-1].set_xlabel(label(ds[along_name(ds)]))
    figure.align_ylabels(panels)
    beside = columns[1].subgridspec(3, 1, height_ratios=[2.55, 0.09, 0.85 * len(names) - 0.45])
    plane, bar, keys = (figure.add_subplot(beside[at]) for at in range(3))
    beyond = _draw_plane(plane, bar, ds, curves, many)
    keys.axis("off")
    keys.legend(
        handles=[*_colour_handles(ds, curves), *stability_handles(ds, curves), *special_handles(ds)],
        loc="upper left",
        ncols=2,
        borderpad=0.0,
    )
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), ranges_text(ds, names), beyond)
    return figure


def _usual(ds: xr.Dataset) -> tuple[str, ...]:
    blows = "impact_velocity" in ds and bool(np.isfinite(ds["impact_velocity"].values).any())
    states = [str(name) for name in ds.data_vars if str(name).startswith("orbit_")]
    return ("impact_velocity" if blows else "bit_amplitude", *states[:1])


# Lines and marks.


def _curves(ds: xr.Dataset) -> list[Curve]:
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


def _values(ds: xr.Dataset, name: str, factor: float) -> np.ndarray:
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
    edge = [withStroke(linewidth=2.0, foreground="white")] if over_dots else []
    factor = scale(ds[name])[0] if factor is None else factor
    along, names = values_along(ds[along_name(ds)]), kind_names(ds)
    for branch, colour in curves:
        marked, segments = places(ds, branch), stability(ds, branch)
        for shown in shown_as(ds, branch, name):
            heights = _values(ds, shown, factor)
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
    mark = _MARKS.get(kind, Mark(marker="P", color=FAINT, markersize=5.0))
    own = Mark(markersize=size * float(mark["markersize"]))
    return (
        mark | own if mark["marker"] in ("|", "x") else mark | own | Mark(markeredgecolor="white", markeredgewidth=0.5)
    )


def _label(ds: xr.Dataset, name: str) -> str:
    if name == LARGEST:
        return "largest modulus\nof the multipliers"
    unit, state = scale(ds[name])[1], name.removeprefix("orbit_")
    words = f"{SYMBOLS.get(state, state)} at the section" if name.startswith("orbit_") else name.replace("_", " ")
    return with_unit(words, unit).replace(" [", "\n[")


def _shape_moduli(axes: Axes) -> None:
    """Logarithmic, with the border of stability."""
    axes.axhline(1.0, color=INK, linewidth=0.8, zorder=1)
    low, high = (float(end) for end in axes.dataLim.intervaly)
    ends = np.array([max(min(low, 0.5), _MODULI[0]) / 1.2, min(max(high, 1.5), _MODULI[1]) * 1.2])
    axes.set_yscale("log")
    axes.set_ylim(*ends)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ends[1] / ends[0] < _FEW else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


# The plane of multipliers.


def _draw_plane(axes: Axes, bar: Axes, ds: xr.Dataset, curves: Sequence[Curve], many: bool) -> str:
    """Draw the multipliers of the first branches in the complex plane; and say how many lie beyond what is shown."""
    along = values_along(ds[along_name(ds)])
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=INK, linewidth=0.9))
    axes.axhline(0.0, color="0.85", linewidth=0.6, zorder=0)
    axes.axvline(0.0, color="0.85", linewidth=0.6, zorder=0)
    first = min((one.branch.number for one in curves), default=0)
    shown = [one for one in curves if one.branch.number == first]
    points = np.concatenate([one.branch.points for one in shown]) if shown else np.zeros(0, int)
    modulus, argument = ds[LARGEST].values[points], ds["multiplier_arg"].values[points]
    finite = modulus[np.isfinite(modulus)]
    half = float(np.clip(1.1 * finite.max(initial=0.0), *_PLANE))
    values = modulus * np.exp(1j * argument)
    norm = (
        Normalize(along[points].min(initial=np.inf), along[points].max(initial=-np.inf)) if len(points) else Normalize()
    )
    map_ = colormaps[COLOURS.get() or "viridis"]
    colours = (
        np.repeat([one.colour for one in shown], [len(one.branch.points) for one in shown])
        if many
        else map_(norm(along[points]))
    )
    size = 5.0 if many else 12.0
    for column in range(values.shape[1] if values.ndim > 1 else 0):
        for mirrored in (values[:, column], values[:, column].conj()):
            axes.scatter(mirrored.real, mirrored.imag, s=size, c=colours, linewidths=0, zorder=3)
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="real part", ylabel="imaginary part")
    axes.set_title(f"multipliers of branch {first}")
    bar.axis("off") if many else bar.figure.colorbar(
        ScalarMappable(norm, map_), cax=bar, orientation="horizontal", label=label(ds[along_name(ds)], 60)
    )
    largest = values[:, 0] if values.ndim > 1 else values
    outside = int((np.maximum(np.abs(largest.real), np.abs(largest.imag)) > half).sum())
    return f"The plane leaves out {outside} of {len(points)} orbits' largest multiplier" if outside else ""


# Legend and notes.


def _colour_handles(ds: xr.Dataset, curves: Sequence[Curve]) -> list[Artist]:
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
        for kind in (*_MARKS, *dict.fromkeys(one for one in names if one not in _MARKS))
        if kind in names
    ]


def ranges_text(ds: xr.Dataset, names: Sequence[str]) -> str:
    """What stands for several blows, in words."""
    several = any(len(shown_as(ds, one, name)) > 1 for one in branches(ds) for name in names)
    return "Of branches of several returns the least and the greatest blow" if several else ""
