"""The analysis `attractors`: coexisting attractors of a sweep, and the fraction of initial conditions of each."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from vibrojax.errors import counted
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import OF_ATTRACTORS
from vibrojax.maps.sweep import Sweep
from vibrojax.pictures.axes import edges, label, scale, shape_axis, share_text, unclip_markers, values_along, with_unit
from vibrojax.pictures.colours import (
    Values,
    hatch_gaps,
    no_value_handle,
    regime_handles,
    regime_names,
    share_value,
    value_of,
)
from vibrojax.pictures.contents import ATTRACTOR, HIDDEN, NAMED, REGIME, START, axes_of_map, swept, without_single
from vibrojax.pictures.maps import draw_cells, outline_region, region_handle, write_labels
from vibrojax.pictures.sheet import MOST_PANELS, columns, facets, legend_at_right, sheet, write_margins
from vibrojax.pictures.starts import PREFIX, on_axes
from vibrojax.pictures.style import new_figure, styled
from vibrojax.studies.analysis import PictureRule, Source, SummaryPart
from vibrojax.studies.attractor_run import attractors_of, drive_speed, strong_share, sweep_of
from vibrojax.studies.sweep_analysis import SweepAnalysis

_SHOWN = 12
"""Greatest number of attractors that are listed one by one."""

LANES = "lane_attractor"
COLOURS = ("#0072B2", "#E69F00", "#6A1B5D", "#009E73", "#D55E00", "#56B4E9", "#222222", "#B5468B")
"""Colours of the attractors from number 0; all further attractors have the colour `BEYOND`."""

BEYOND = "#A8A8A8"
_VELOCITY = "impact_velocity"
_STRONG, _COUNT, _FROM = "strong_share", "attractors", "regime_from_"
_MOST_FACETS, _MOST_COLUMNS, _PANEL = 6, 3, (4.2, 2.0)  # _PANEL: width and height [inch]


@styled
def attractor_shares(ds: xr.Dataset) -> Figure:
    """Draw basin fractions of attractors, with standard errors, and impact velocities over the longest axis.

    Each value of further axes gets a panel. For a single point, the plane of initial conditions is drawn in the colours
    of the attractors. If the initial conditions form no plane, the basin fractions are drawn as bars.
    """
    ds = ds.isel({name: 0 for name in ds["share"].dims if name != ATTRACTOR and ds.sizes[name] == 1})
    along, note = swept(ds), ""
    about, lanes = f"{ds.sizes[START]} starts" + " at each point" * bool(along), ds[LANES].size
    if along:
        figure = _draw_along(ds, max(along, key=lambda name: ds.sizes[name]))
        about += "; upright lines: one standard error"
        about += f"; legend: most frequent regime, and share of all {lanes} lanes"
    else:
        figure, note = _draw_point(ds)
    legend_at_right(figure, _handles(ds))
    unassigned = int(ds["unassigned"].sum())
    lost = counted(unassigned, f"lane of {ds[LANES].size} ends", f"lanes of {ds[LANES].size} end")
    lost += " in none that could be told"
    write_margins(figure, ds, about, note, lost if unassigned else "")
    return figure


def _draw_along(ds: xr.Dataset, x: str) -> Figure:
    """Draw basin fractions and impact velocities over the axis `x`, with one panel per value of further axes."""
    ds = ds.sortby(x)
    panels = facets(ds, (x, ATTRACTOR), _MOST_FACETS)
    names = ["share", *([_VELOCITY] if _VELOCITY in ds and np.isfinite(ds[_VELOCITY]).any() else [])]
    wide = columns(panels, _MOST_COLUMNS)
    rows = -(-len(panels) // wide)
    figure = new_figure(_PANEL[0] * wide + 1.8, _PANEL[1] * rows * len(names) + 0.8)
    grid = figure.subplots(rows * len(names), wide, squeeze=False, sharex=True, sharey=False)
    blocks = grid.reshape(rows, len(names), wide).swapaxes(1, 2).reshape(rows * wide, len(names))
    for k, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        for axes, name in zip(blocks[k], names, strict=True):
            _draw_curves(axes, facet, x, name)
            shape_axis(axes, "x", values_along(ds[x]))
            unclip_markers(axes)
            axes.grid(True)
            if k % wide == 0:
                unit = scale(ds[_VELOCITY])[1] if name == _VELOCITY else ""
                axes.set_ylabel(with_unit("impact velocity", unit) if unit else "share of starts [%]")
        blocks[k][0].set_title(title)
        blocks[k][-1].set_xlabel(label(ds[x]))
        blocks[k][-1].tick_params(labelbottom=True)
    for axes in blocks[len(panels) :].flat:
        axes.remove()
    return figure


def _draw_curves(axes: Axes, facet: xr.Dataset, x: str, name: str) -> None:
    """Draw basin fractions stacked, or a quantity of every attractor where its fraction is above zero."""
    is_share = name == "share"
    values = facet[name].transpose(x, ATTRACTOR).values * (100.0 if is_share else scale(facet[name])[0])
    occurs = facet["share"].transpose(x, ATTRACTOR).values > 0
    along = values_along(facet[x])
    if is_share:  # one on top of another
        tops = np.cumsum(np.nan_to_num(values), axis=1)
        for k in range(values.shape[1]):
            axes.fill_between(
                along, tops[:, k] - np.nan_to_num(values[:, k]), tops[:, k], color=_colour(k), alpha=0.9, linewidth=0
            )
            error = 100.0 * facet["share_stderr"].transpose(x, ATTRACTOR).values[:, k]
            seen = occurs[:, k]
            low, high = np.clip([tops[:, k] - error, tops[:, k] + error], 0.0, 100.0)
            axes.vlines(along[seen], low[seen], high[seen], color="0.2", linewidth=0.7, zorder=2)
        axes.set_ylim(0.0, 100.0)
        return
    for k in range(values.shape[1] - 1, -1, -1):
        y = np.where(occurs[:, k], values[:, k], np.nan)
        axes.plot(along, y, color=_colour(k), linewidth=1.3, marker="o", markersize=2.6, zorder=2.5 - 0.001 * k)


def _draw_point(ds: xr.Dataset) -> tuple[Figure, str]:
    """Draw the basins of one point, or basin fractions as bars; return the figure, and the note on its markers."""
    spread = on_axes(ds[[LANES]].assign({REGIME: ds[LANES]}).drop_vars(HIDDEN, errors="ignore"))
    states = [str(name) for name in spread[LANES].dims if name != START]
    figure = new_figure(6.6, 4.4)
    axes = figure.add_subplot()
    if len(states) != 2:
        share, error = 100.0 * ds["share"].values, 100.0 * ds["share_stderr"].values
        axes.bar(range(share.size), share, yerr=error, color=[_colour(k) for k in range(share.size)], ecolor="0.3")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("attractor")
        axes.set_ylabel("share of starts [%]")
        return figure, ""
    x, y = states
    cells = np.asarray(spread[LANES].transpose(y, x).values)
    shown = np.where(cells < 0, np.nan, np.minimum(cells, len(COLOURS)))
    colours = ListedColormap([*COLOURS, BEYOND])
    hatch_gaps(axes, shown)
    ends = edges(values_along(spread[x])), edges(values_along(spread[y]))
    norm = BoundaryNorm(np.arange(-0.5, colours.N), colours.N)
    axes.pcolormesh(*ends, np.ma.masked_invalid(shown), cmap=colours, norm=norm, rasterized=True)
    axes.set_xlabel(label(spread[x]))
    axes.set_ylabel(label(spread[y]))
    return figure, _mark_orbits(axes, ds, spread, x, y)


def _mark_orbits(axes: Axes, ds: xr.Dataset, spread: xr.Dataset, x: str, y: str) -> str:
    """Mark where orbits cross the section, projected onto the plane of initial conditions; return the note on this."""
    places = [_at_section(ds, name) * scale(spread[name])[0] for name in (x, y)]
    limits = axes.get_xlim(), axes.get_ylim()
    inside = np.all([(min(ends) <= p) & (p <= max(ends)) for p, ends in zip(places, limits, strict=True)], axis=0)
    orbits = np.isfinite(places).all(axis=0)
    for k in np.flatnonzero(inside):
        place = places[0][k], places[1][k]
        axes.plot(*place, "o", markersize=11, markerfacecolor="white", markeredgecolor="black", zorder=3, clip_on=False)
        axes.annotate(str(k), place, ha="center", va="center", fontsize=7.5, color="black", zorder=4)
    outside, without = np.flatnonzero(orbits & ~inside), np.flatnonzero(~orbits)
    texts = (
        "Circles: where the orbits pass the section" if inside.any() else "",
        _numbered(outside, "passes", "pass") + " the section outside the picture" if outside.size else "",
        _numbered(without, "has", "have") + " no orbit" if orbits.any() and without.size else "",
    )
    return ". ".join(filter(None, texts))


def _numbered(attractors: np.ndarray, singular: str, plural: str) -> str:
    """Return the attractors by number, with a verb: "Attractor 1 has", "Attractors 0, 2 have"."""
    return f"Attractor{'s' * (attractors.size > 1)} {', '.join(map(str, attractors))} " + (
        singular if attractors.size == 1 else plural
    )


def _at_section(ds: xr.Dataset, start_state: str) -> np.ndarray:
    """Return one state of each attractor at the section, NaN for attractors without an orbit."""
    name = f"orbit_{start_state.removeprefix(PREFIX)}"
    if name in ds:
        return np.asarray(ds[name].values, float)
    others = [data.values for key, data in ds.data_vars.items() if str(key).startswith("orbit_")]
    # The state that the return map lacks is the velocity that defines the section: it is zero there.
    return np.where(np.isfinite(others[0]), 0.0, np.nan) if others else np.full(ds.sizes[ATTRACTOR], np.nan)


def _colour(number: int) -> str:
    return COLOURS[number] if number < len(COLOURS) else BEYOND


def _handles(ds: xr.Dataset) -> list[Artist]:
    """Return the legend entries for attractors: number, most frequent regime, and basin fraction over the grid."""
    count, points = ds.sizes[ATTRACTOR], ds["unassigned"].size
    share, regime = (ds[name].transpose(..., ATTRACTOR).values.reshape(points, count) for name in ("share", REGIME))
    names = regime_names(ds[REGIME])
    handles: list[Artist] = []
    for k in range(min(count, len(COLOURS))):
        most = int(np.argmax(np.bincount(regime[:, k], weights=share[:, k])))
        handles.append(
            Patch(color=_colour(k), label=f"{k}: {names[most]}, {share_text(float(share[:, k].mean()))} of starts")
        )
    if count > len(COLOURS):
        handles.append(Patch(color=BEYOND, label=f"{count - len(COLOURS)} others"))
    if int(ds["unassigned"].sum()) and points == 1:
        handles.append(no_value_handle("could not be told"))
    return handles


@styled
def share_map(ds: xr.Dataset) -> Figure:
    """Draw the fraction of initial conditions that end in the strong single impact, over two axes.

    Next to it are the regimes reached from the scene's named initial conditions, or else the number of attractors. An
    impact is strong if the mean impact velocity exceeds the drive's speed `v`. Each value of further axes gets a row.
    """
    ds = without_single(ds)
    x, y = axes_of_map(ds)
    ds = ds.sortby([x, y])
    names = [str(name) for name in ds[NAMED].values] if NAMED in ds.dims else []
    share = strong_share(ds)
    coords = {name: data for name, data in ds.coords.items() if set(data.dims) <= set(share.dims)}
    shown = xr.Dataset({_STRONG: share}, coords, ds.attrs)
    for name in names:
        shown[_FROM + name] = ds["named_regime"].sel({NAMED: name}, drop=True)
    if not names:
        shown[_COUNT] = (ds["share"] > 0).sum("attractor").astype(float)
    shown[REGIME] = shown[_FROM + names[0]] if names else xr.zeros_like(share, np.int8)
    columns: Values = (share_value(shown[_STRONG], "strong single impact"),)
    columns += (None,) * len(names) if names else (value_of(shown[_COUNT]),)
    panels = facets(shown, (x, y), MOST_PANELS // len(columns))
    drawn = sheet(panels, columns)
    places = dict.fromkeys(map(id, panels.data), -1)  # the panels of a facet come in the order of the columns
    for panel in drawn.panels:
        places[id(panel.facet)] += 1
        if panel.value is None:
            name = names[places[id(panel.facet)] - 1]
            panel.axes.set_title(", ".join(filter(None, (panel.title, f"from {name}"))))
            panel.facet[REGIME] = panel.facet[_FROM + name]
        draw_cells(panel, x, y)
        outline_region(panel.axes, x, y)
        write_labels(panel, shown[x], shown[y])
    handles = regime_handles([facet[_FROM + name] for facet in panels.data for name in names]) if names else []
    drawn.finish(handles + region_handle(drawn.panels[0].axes))
    strong = "Strong: the striker hits faster than the drive moves"
    about = "Of single impacts, strong or weak" if drive_speed(ds) is None else strong
    write_margins(drawn.figure, ds, panels.note, f"{ds.sizes[START]} starts at each point", about)
    return drawn.figure


@dataclass(frozen=True)
class Attractors(SweepAnalysis):
    """Attractors that a sweep's initial conditions lead to, and the fraction of initial conditions of each."""

    kind = "attractors"
    counted = "attractor"
    variables = OF_ATTRACTORS
    pictures = (
        PictureRule("attractors", lambda held: held.wide, share_map),
        PictureRule("attractors", lambda held: True, attractor_shares),
    )

    def sweep(self, source: Source) -> Sweep:
        """Return the validated sweep; raise `InputError` if the analysis does not apply to it."""
        return sweep_of(source)

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the attractors of a sweep, from the dataset `lanes` with orbits."""
        return attractors_of(sweep, lanes, progress)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Summarise how many attractors coexist at how many points, and fraction, points and regimes of each."""
        grid = [name for name in ds["share"].dims if name != "attractor"]
        unassigned, lanes = int(ds["unassigned"].sum()), ds["lane_attractor"].size
        share = ds["share"].values.reshape(ds["unassigned"].size, ds.sizes["attractor"])
        numbers, counts = np.unique((share > 0).sum(axis=1), return_counts=True)
        points = ", ".join(f"{number} at {count}" for number, count in zip(numbers, counts, strict=True))
        lines = [
            f"at a point: {points} (attractors at points)",
            f"{unassigned} of {counted(lanes, 'lane')} unassigned ({100 * unassigned / max(lanes, 1):.1f} %)",
        ]
        regime, meanings = ds["regime"].values.reshape(share.shape), flags(ds["regime"])
        for number in range(min(share.shape[1], _SHOWN)):
            mask = share[:, number] > 0
            kinds, sizes = np.unique(regime[mask, number], return_counts=True)
            names = ", ".join(meanings[int(kinds[k])] for k in np.argsort(-sizes, kind="stable"))
            percent = 100 * share[:, number].mean()
            lines.append(f"{number:>4}{percent:>7.1f} % of starts{int(mask.sum()):>7} points  {names}")
        if share.shape[1] > _SHOWN:
            lines.append(f"and {share.shape[1] - _SHOWN} more of smaller shares")
        facts = {"shares": ds["share"].mean(grid).values, "unassigned": unassigned}
        return [SummaryPart("shares", lines, {"attractors": facts})]
