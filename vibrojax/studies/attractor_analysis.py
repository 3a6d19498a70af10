"""The analysis `attractors`: coexisting attractors of a sweep, and the fraction of initial conditions of each."""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, ListedColormap

from vibrojax.errors import counted
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import OF_ATTRACTORS
from vibrojax.maps.sweep import Sweep
from vibrojax.pictures.axes import axis, edges, map_axis, margins, scale, share_text, values_along, with_unit
from vibrojax.pictures.colours import Values, no_value_key, regime_keys, regime_names, share_value, value_of
from vibrojax.pictures.contents import ATTRACTOR, HIDDEN, NAMED, REGIME, START, axes_of_map, swept, without_single
from vibrojax.pictures.maps import cell_layers, map_plot
from vibrojax.pictures.plots import Area, Axis, Bars, Cells, Layer, Line, Plot, Sheet, Text, bars, dots, patch
from vibrojax.pictures.sheet import MOST_PANELS, at, columns, facets, layout
from vibrojax.pictures.starts import PREFIX, on_axes
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


def attractor_shares(ds: xr.Dataset) -> Sheet:
    """Draw basin fractions of attractors, with standard errors, and impact velocities over the longest axis.

    Each value of further axes gets a panel. For a single point, the plane of initial conditions is drawn in the colours
    of the attractors. If the initial conditions form no plane, the basin fractions are drawn as bars.
    """
    ds = ds.isel({name: 0 for name in ds["share"].dims if name != ATTRACTOR and ds.sizes[name] == 1})
    along, note = swept(ds), ""
    about, lanes = f"{ds.sizes[START]} starts" + " at each point" * bool(along), ds[LANES].size
    if along:
        sheet = _shares_along(ds, max(along, key=lambda name: ds.sizes[name]))
        about += "; upright lines: one standard error"
        about += f"; legend: most frequent regime, and share of all {lanes} lanes"
    else:
        plot, note = _shares_at_point(ds)
        sheet = Sheet([plot], (6.6, 4.4))
    unassigned = int(ds["unassigned"].sum())
    lost = counted(unassigned, f"lane of {ds[LANES].size} ends", f"lanes of {ds[LANES].size} end")
    lost += " in none that could be told"
    return replace(sheet, keys=[_keys(ds)], **margins(ds, about, note, lost if unassigned else ""))


def _shares_along(ds: xr.Dataset, x: str) -> Sheet:
    """Draw basin fractions and impact velocities over the axis `x`, with one panel per value of further axes."""
    ds = ds.sortby(x)
    panels = facets(ds, (x, ATTRACTOR), _MOST_FACETS)
    names = ["share", *([_VELOCITY] if _VELOCITY in ds and np.isfinite(ds[_VELOCITY]).any() else [])]
    wide = columns(panels, _MOST_COLUMNS)
    rows = -(-len(panels) // wide)
    plots = []
    for k, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        for i, name in enumerate(names):
            up = Axis("share of starts [%]", limits=(0.0, 100.0), group=name)
            if name == _VELOCITY:
                up = Axis(with_unit("impact velocity", scale(ds[name])[1]), name, group=f"{name}{k // wide}")
            place = k // wide * len(names) + i, k % wide
            across = map_axis(facet[x], group="across")
            plots.append(Plot(_curves(facet, x, name), across, up, "" if i else title, place, at(facet)))
    size = _PANEL[0] * wide + 1.8, _PANEL[1] * rows * len(names) + 0.8
    plots.sort(key=lambda plot: plot.place)
    return Sheet(plots, size, (1.0,) * wide, (1.0,) * (rows * len(names)))


def _curves(facet: xr.Dataset, x: str, name: str) -> list[Layer]:
    """Draw basin fractions stacked, or a quantity of every attractor where its fraction is above zero."""
    is_share = name == "share"
    values = facet[name].transpose(x, ATTRACTOR).values * (100.0 if is_share else scale(facet[name])[0])
    occurs = facet["share"].transpose(x, ATTRACTOR).values > 0
    along = values_along(facet[x])
    layers: list[Layer] = []
    if is_share:  # one on top of another
        tops = np.cumsum(np.nan_to_num(values), axis=1)
        for k in range(values.shape[1]):
            bottom = tops[:, k] - np.nan_to_num(values[:, k])
            error = 100.0 * facet["share_stderr"].transpose(x, ATTRACTOR).values[:, k]
            seen = occurs[:, k]
            low, high = np.clip([tops[:, k] - error, tops[:, k] + error], 0.0, 100.0)
            layers.append(Area(along, bottom, tops[:, k], _colour(k), 0.9))
            layers.append(Line(*bars(along[seen], low[seen], high[seen]), "#333333", 0.7))
        return layers
    for k in range(values.shape[1] - 1, -1, -1):
        y = np.where(occurs[:, k], values[:, k], np.nan)
        layers.append(Line(along, y, _colour(k), 1.3, marker="o", size=2.6, order=2.5 - 0.001 * k, clip=False))
    return layers


def _shares_at_point(ds: xr.Dataset) -> tuple[Plot, str]:
    """Draw the basins of one point, or basin fractions as bars; return the plot, and the note on its markers."""
    spread = on_axes(ds[[LANES]].assign({REGIME: ds[LANES]}).drop_vars(HIDDEN, errors="ignore"))
    states = [str(name) for name in spread[LANES].dims if name != START]
    if len(states) != 2:
        share, error = 100.0 * ds["share"].values, 100.0 * ds["share_stderr"].values
        places = np.arange(share.size, dtype=float)
        columns = Bars(places - 0.4, 0.0 * places, 0.0 * places + 0.8, share, [_colour(k) for k in range(share.size)])
        errors = Line(*bars(places, share - error, share + error), "#4D4D4D")
        ticks = [(k, str(int(k))) for k in places[:: max(1, -(-share.size // _SHOWN))].tolist()]
        up = Axis("share of starts [%]", limits=(0.0, None))
        return Plot([columns, errors], Axis("attractor", ticks=ticks), up, grid=""), ""
    x, y = states
    cells = np.asarray(spread[LANES].transpose(y, x).values)
    shown = np.where(cells < 0, np.nan, np.minimum(cells, len(COLOURS)))
    colours = ListedColormap([*COLOURS, BEYOND])
    ends = edges(values_along(spread[x])), edges(values_along(spread[y]))
    norm = BoundaryNorm(np.arange(-0.5, colours.N), colours.N)
    orbits, note = _orbit_marks(ds, spread, (x, y), ends)
    across, up = (axis(spread[name], limits=(float(e[0]), float(e[-1]))) for name, e in zip(states, ends, strict=True))
    return Plot([Cells(*ends, shown, colours, norm), *orbits], across, up), note


def _orbit_marks(
    ds: xr.Dataset, spread: xr.Dataset, axes: tuple[str, str], ends: tuple[np.ndarray, np.ndarray]
) -> tuple[list[Layer], str]:
    """Mark where orbits cross the section, projected onto the plane of initial conditions, with a note on this."""
    places = [_at_section(ds, name) * scale(spread[name])[0] for name in axes]
    inside = np.all([(end[0] <= p) & (p <= end[-1]) for p, end in zip(places, ends, strict=True)], axis=0)
    orbits = np.isfinite(places).all(axis=0)
    layers: list[Layer] = []
    for k in np.flatnonzero(inside):
        x, y = float(places[0][k]), float(places[1][k])
        layers.append(dots([x], [y], size=11.0, face="white", edge="black", order=3.0, clip=False))
        layers.append(Text(x, y, str(k), colour="black", size=7.5))
    outside, without = np.flatnonzero(orbits & ~inside), np.flatnonzero(~orbits)
    texts = (
        "Circles: where the orbits pass the section" if inside.any() else "",
        _numbered(outside, "passes", "pass") + " the section outside the picture" if outside.size else "",
        _numbered(without, "has", "have") + " no orbit" if orbits.any() and without.size else "",
    )
    return layers, ". ".join(filter(None, texts))


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


def _keys(ds: xr.Dataset) -> list[Layer]:
    """Return the legend entries for attractors: number, most frequent regime, and basin fraction over the grid."""
    count, points = ds.sizes[ATTRACTOR], ds["unassigned"].size
    share, regime = (ds[name].transpose(..., ATTRACTOR).values.reshape(points, count) for name in ("share", REGIME))
    names = regime_names(ds[REGIME])
    keys: list[Layer] = []
    for k in range(min(count, len(COLOURS))):
        most = int(np.argmax(np.bincount(regime[:, k], weights=share[:, k])))
        text = f"{k}: {names[most]}, {share_text(float(share[:, k].mean()))} of starts"
        keys.append(patch(_colour(k), text, edge=""))
    if count > len(COLOURS):
        keys.append(patch(BEYOND, f"{count - len(COLOURS)} others", edge=""))
    if int(ds["unassigned"].sum()) and points == 1:
        keys.append(no_value_key("could not be told"))
    return keys


def share_map(ds: xr.Dataset) -> Sheet:
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
    values: Values = (share_value(shown[_STRONG], "strong single impact"),)
    values += (None,) * len(names) if names else (value_of(shown[_COUNT]),)
    panels = facets(shown, (x, y), MOST_PANELS // len(values))
    drawn = layout(panels, values)
    plots, counts = [], dict.fromkeys(map(id, panels.data), -1)  # a facet's panels have the order of the values
    for panel in drawn.panels:
        counts[id(panel.facet)] += 1
        facet, title = panel.facet, panel.title
        if panel.value is None:
            name = names[counts[id(facet)] - 1]
            title = ", ".join(filter(None, (title, f"from {name}")))
            facet = facet.assign({REGIME: facet[_FROM + name]})
        plots.append(map_plot(panel._replace(title=title), shown[x], shown[y], cell_layers(facet, panel.value, x, y)))
    keys = regime_keys([facet[_FROM + name] for facet in panels.data for name in names]) if names else []
    strong = "Strong: the striker hits faster than the drive moves"
    about = "Of single impacts, strong or weak" if drive_speed(ds) is None else strong
    notes = margins(ds, panels.note, f"{ds.sizes[START]} starts at each point", about)
    return Sheet(plots, keys=[keys], **drawn.sheet, **notes)


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
