"""Attractors: the share of starts of each along an axis, and how hard it strikes; or where starts of one point end."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from vibrojax.errors import InputError
from vibrojax.io.kinds import kind_of
from vibrojax.plot.axes import edges, label, point_text, scale, shape_axis, share_text, values_along, with_unit
from vibrojax.plot.colours import regime_names
from vibrojax.plot.contents import ATTRACTOR, HIDDEN, REGIME, START, swept
from vibrojax.plot.margins import legend_at_right, write_margins
from vibrojax.plot.sheet import columns, facets
from vibrojax.plot.starts import PREFIX, on_axes
from vibrojax.plot.style import UNDEFINED, new_figure, styled

LANES = "lane_attractor"
COLOURS = ("#0072B2", "#E69F00", "#6A1B5D", "#009E73", "#D55E00", "#56B4E9", "#222222", "#B5468B")
"""Of the attractors from 0; those beyond share the last place in the legend."""

BEYOND = "#A8A8A8"
_VELOCITY = "impact_velocity"
_MOST, _WIDE, _PANEL = 6, 3, (4.2, 2.0)  # facets, side by side, inches


@styled
def attractor_shares(ds: xr.Dataset) -> Figure:
    """The shares of attractors, with their standard errors, and their impact velocities, over the longest axis.

    Further axes become panels. Of one point: its plane of starts in the colours of the attractors, or its shares.

    **Arguments:** `ds`: what `attractors` gives.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no attractors.
    """
    if kind_of(ds) != "attractors":
        raise InputError("no attractors to draw: the dataset holds no lane_attractor, as vj.attractors gives it")
    single = [name for name in ds["share"].dims if name != ATTRACTOR and ds.sizes[name] == 1]
    ds = ds.isel(dict.fromkeys(single, 0))
    along = swept(ds)
    marked = ""
    if along:
        figure = _over_axis(ds, max(along, key=lambda name: ds.sizes[name]))
    else:
        figure, marked = _of_point(ds)
    legend_at_right(figure, _handles(ds))
    unassigned = int(ds["unassigned"].sum())
    about = f"{ds.sizes[START]} starts at each point" + ("; upright lines: one standard error" if along else "")
    write_margins(
        figure,
        str(ds.attrs.get("title", "")),
        point_text(ds),
        about,
        marked,
        f"{unassigned} lanes of {ds[LANES].size} end in none that could be told" if unassigned else "",
    )
    return figure


def _over_axis(ds: xr.Dataset, x: str) -> Figure:
    ds = ds.sortby(x)
    panels = facets(ds, (x, ATTRACTOR), _MOST)
    curves = ["share", *([_VELOCITY] if _VELOCITY in ds and np.isfinite(ds[_VELOCITY]).any() else [])]
    wide = columns(panels, _WIDE)
    rows = -(-len(panels) // wide)
    figure = new_figure(_PANEL[0] * wide + 1.8, _PANEL[1] * rows * len(curves) + 0.8)
    grid = figure.subplots(rows * len(curves), wide, squeeze=False, sharex=True, sharey=False)
    for k, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        for which, name in enumerate(curves):
            axes = grid[k // wide * len(curves) + which, k % wide]
            _draw(axes, facet, x, name)
            shape_axis(axes, "x", values_along(ds[x]))
            axes.grid(True)
            if which == 0:
                axes.set_title(title)
            if which == len(curves) - 1:
                axes.set_xlabel(label(ds[x]))
                axes.tick_params(labelbottom=True)
            if k % wide == 0:
                unit = scale(ds[_VELOCITY])[1] if name == _VELOCITY else ""
                axes.set_ylabel(with_unit("impact velocity", unit) if unit else "share of starts [%]")
    for k in range(len(panels), rows * wide):
        for which in range(len(curves)):
            grid[k // wide * len(curves) + which, k % wide].remove()
    return figure


def _draw(axes: Axes, facet: xr.Dataset, x: str, name: str) -> None:
    """A quantity of every attractor where there is one, the greatest shares above the others."""
    values = facet[name].transpose(x, ATTRACTOR).values * (100.0 if name == "share" else scale(facet[name])[0])
    error = 100.0 * facet["share_stderr"].transpose(x, ATTRACTOR).values if name == "share" else None
    there = facet["share"].transpose(x, ATTRACTOR).values > 0
    at = values_along(facet[x])
    for k in range(values.shape[1] - 1, -1, -1):
        y = np.where(there[:, k], values[:, k], np.nan)
        axes.plot(at, y, color=_colour(k), linewidth=1.3, marker="o", markersize=2.6, zorder=2.5 - 0.001 * k)
        if error is not None:
            low, high = np.clip([y - error[:, k], y + error[:, k]], 0.0, 100.0)
            axes.vlines(at, low, high, color=_colour(k), linewidth=0.7, zorder=2)
    if name == "share":
        axes.set_ylim(-3.0, 103.0)


def _of_point(ds: xr.Dataset) -> tuple[Figure, str]:
    """The figure of one point, and what is to be said of what is marked in it."""
    lanes = ds[[LANES]].assign({REGIME: ds[LANES]})
    spread = on_axes(lanes.drop_vars(HIDDEN, errors="ignore"))
    states = [name for name in spread[LANES].dims if name != START]
    figure = new_figure(6.6, 4.4)
    axes = figure.add_subplot()
    if len(states) != 2:
        _draw_bars(axes, ds)
        return figure, ""
    x, y = (str(name) for name in states)
    cells = np.asarray(spread[LANES].transpose(y, x).values)
    shown = np.minimum(np.where(cells < 0, len(COLOURS) + 1, cells), len(COLOURS) + (cells < 0))
    colours = ListedColormap([*COLOURS, BEYOND, UNDEFINED])
    ends = edges(values_along(spread[x])), edges(values_along(spread[y]))
    mesh = axes.pcolormesh(*ends, shown, cmap=colours, norm=BoundaryNorm(np.arange(-0.5, colours.N), colours.N))
    mesh.set_rasterized(True)
    axes.set_xlabel(label(spread[x]))
    axes.set_ylabel(label(spread[y]))
    return figure, _mark(axes, ds, spread, x, y)


def _mark(axes: Axes, ds: xr.Dataset, spread: xr.Dataset, x: str, y: str) -> str:
    """Mark where orbits pass the section, projected on the plane of starts; what is to be said of it."""
    at = [_at_section(ds, name) * scale(spread[name])[0] for name in (x, y)]
    limits = axes.get_xlim(), axes.get_ylim()
    inside = np.all([(min(ends) <= one) & (one <= max(ends)) for one, ends in zip(at, limits, strict=True)], axis=0)
    orbits = np.isfinite(at).all(axis=0)
    for k in np.flatnonzero(inside):
        axes.plot(at[0][k], at[1][k], "o", markersize=11, markerfacecolor="white", markeredgecolor="black", zorder=3)
        axes.annotate(str(k), (at[0][k], at[1][k]), ha="center", va="center", fontsize=7.5, color="black", zorder=4)
    beyond = ", ".join(map(str, np.flatnonzero(orbits & ~inside)))
    texts = (
        "circles: where the orbits pass the section" if inside.any() else "",
        f"the section of {beyond} lies beyond the picture" if beyond else "",
        f"no orbit: {', '.join(map(str, np.flatnonzero(~orbits)))}" if orbits.any() and not orbits.all() else "",
    )
    return "; ".join(filter(None, texts))


def _at_section(ds: xr.Dataset, start_state: str) -> np.ndarray:
    """A state of all attractors where they pass the section, NaN of those without an orbit."""
    name = f"orbit_{start_state.removeprefix(PREFIX)}"
    if name in ds:
        return np.asarray(ds[name].values, float)
    others = [one.values for key, one in ds.data_vars.items() if str(key).startswith("orbit_")]
    # What is no state of the return map is zero there: the velocity that the section is told by.
    return np.where(np.isfinite(others[0]), 0.0, np.nan) if others else np.full(ds.sizes[ATTRACTOR], np.nan)


def _draw_bars(axes: Axes, ds: xr.Dataset) -> None:
    share, error = 100.0 * ds["share"].values, 100.0 * ds["share_stderr"].values
    number = np.arange(share.size)
    axes.bar(number, share, yerr=error, color=[_colour(int(k)) for k in number], ecolor="0.3")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("attractor")
    axes.set_ylabel("share of starts [%]")


def _colour(number: int) -> str:
    return COLOURS[number] if number < len(COLOURS) else BEYOND


def _handles(ds: xr.Dataset) -> list[Artist]:
    """The attractors by colour: number, the regime of most of its starts, and share over the grid."""
    many = ds.sizes[ATTRACTOR]
    shape = ds["unassigned"].size, many
    share, regime = (ds[name].transpose(..., ATTRACTOR).values.reshape(shape) for name in ("share", REGIME))
    found: list[Artist] = []
    names = regime_names(ds[REGIME])
    for k in range(min(many, len(COLOURS))):
        most = int(np.argmax(np.bincount(regime[:, k], weights=share[:, k])))
        found.append(Patch(color=_colour(k), label=f"{k}: {names[most]}, {share_text(float(share[:, k].mean()))}"))
    if many > len(COLOURS):
        found.append(Patch(color=BEYOND, label=f"{many - len(COLOURS)} others"))
    if int(ds["unassigned"].sum()) and shape[0] == 1:
        found.append(Patch(color=UNDEFINED, label="could not be told"))
    return found
