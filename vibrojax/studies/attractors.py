"""The analysis `attractors`: coexisting attractors of a sweep, and the fraction of initial conditions of each."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float, Int
from matplotlib.colors import BoundaryNorm, ListedColormap, to_hex, to_rgb

from vibrojax.errors import InputError, counted
from vibrojax.io.attributes import flags, parameters_of
from vibrojax.io.kinds import OF_ATTRACTORS
from vibrojax.io.variables import described
from vibrojax.lanes.labels import of_orbits, variables_of
from vibrojax.maps.rerun import sweep_with_orbits
from vibrojax.maps.run import run_sweep
from vibrojax.maps.starts import DEFAULT_STARTS, list_of
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import SINGLE_IMPACT, blow_frequency
from vibrojax.periodic.orbits import SAME_ORBIT
from vibrojax.pictures.axes import axis, edges, map_axis, margins, scale, share_text, values_along, with_unit
from vibrojax.pictures.colours import (
    REGIME_COLOURS,
    cell_keys,
    no_value_key,
    regime_names,
    regime_value,
    share_value,
    value_of,
)
from vibrojax.pictures.contents import ATTRACTOR, HIDDEN, NAMED, REGIME, START, axes_of_map, swept, without_single
from vibrojax.pictures.layout import MOST_PANELS, at, facets
from vibrojax.pictures.maps import cell_layers, maps_of
from vibrojax.pictures.plots import Axis, Bars, Cells, Key, Layer, Line, Look, Plot, Sheet, Text, bars, dots, patch
from vibrojax.pictures.starts import PREFIX, on_axes
from vibrojax.studies import attractor_groups as grouping
from vibrojax.studies.analysis import PictureRule, Source, SummaryPart, analyse
from vibrojax.studies.attractor_groups import Motion
from vibrojax.studies.subjects import SweepAnalysis

MEASURED = ("period", "impacts", "impact_velocity", "impact_power", "stick_slip_index", "specific_energy")
"""Variables whose medians over an attractor's lanes are stored."""

SETTINGS = {
    "method": "lanes of a point are one motion if their orbits are within same_within over the scales of labels; "
    "irregular ones if chains of lanes join them, each within irregular_within and standard_errors of the next in "
    "period, impact velocity and amplitudes, or, where exponents are known, within exponent_within standard errors. "
    "Irregular lanes are observed for more windows of the sweep's observe, from the first to the second of the numbers "
    "in windows, until the relative standard errors of these statistics are below least_precision; lanes that reach an "
    "orbit or do not converge are unassigned, and lanes that differ are observed for at least windows_at_a_split. A "
    "motion that nowhere has fewest lanes does not count beside another of more, nor, without exponents, one of fewer "
    "within irregular_factor of it. Motions of neighbouring points are one attractor if the orbit of one, continued as "
    "a stable one and never farther than aside over the scales from its prediction, becomes that of the other; "
    "irregular ones if they are nearest, and within irregular_factor. Numbers from 0 by falling share over the grid",
    "same_within": SAME_ORBIT,
    "irregular_within": grouping.IRREGULAR_WITHIN,
    "standard_errors": grouping.RESOLUTION_STDERRS,
    "windows": [grouping.FEWEST_WINDOWS, grouping.MOST_WINDOWS],
    "windows_at_a_split": grouping.SPLIT_MIN_WINDOWS,
    "least_precision": grouping.CONVERGED_STDERR,
    "exponent_within": grouping.EXPONENT_STDERRS,
    "irregular_factor": grouping.SIMILAR_FACTOR,
    "fewest": grouping.IRREGULAR_MIN_LANES,
    "aside": grouping.PREDICTION_WITHIN,
}

LANES = "lane_attractor"
BEYOND = "#A8A8A8"
"""Colour of the attractors beyond the first eight."""

_COLOURED, _SHADE = 8, 0.6  # attractors with a colour; the share of the colour that the next one of a regime keeps
_SHOWN = 12  # greatest number of attractors that are listed one by one
_VELOCITY = "impact_velocity"
_STRONG, _COUNT, _FROM = "strong_share", "attractors", "regime_from_"
_WHOLE = 1e-6  # shares [%] within which a column is full, and its top has no error
_MOST_FACETS, _MOST_COLUMNS, _PANEL = 6, 3, (4.2, 2.0)  # _PANEL: width and height [inch]


def attractors(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True
) -> xr.Dataset:
    """Find the attractors of a sweep, and the fraction of initial conditions that leads to each attractor.

        att = vj.attractors(ds)

    Two periodic lanes of a grid point have the same motion if their orbits are equal. Two irregular lanes have the same
    motion if their statistics over a longer observation agree, within the resolution that the dataset's attribute
    `attractors` states.

    Motions at neighbouring grid points belong to one attractor if continuation from one point to the other turns the
    first orbit into the second. At a pitchfork bifurcation, the symmetric orbit and one of the two asymmetric orbits
    that replace it count as the same attractor. Attractor 0 has the greatest fraction of initial conditions over the
    grid.

    **Arguments:**

    - `source`: dataset of a sweep with several starts, or a sweep as `run_sweep` accepts it. If the dataset has no
      orbits, its sweep is run again. If the sweep has `lyapunov = true`, irregular lanes that had not settled are left
      out.

    **Returns:** a dataset.

    - Variables over the grid and `attractor`: `share` is the fraction of initial conditions that lead to the attractor
      (basin stability). `share_stderr` is the binomial standard error of `share`; for Sobol samples, it is an upper
      bound. `regime` is the most frequent regime of the attractor's lanes. `cycles` is the period of the attractor's
      orbit in returns (0 without an orbit). Where the attractor does not exist, `share`, `regime` and `cycles` are 0.
      `period`, `impacts` and `impact_velocity` are medians over the lanes; for irregular lanes, the values come from a
      longer observation. `impact_power`, `stick_slip_index` and `specific_energy` are medians over the lanes during the
      sweep's `observe` seconds. `orbit_x1` and so on are one point of the orbit on the section.
    - Variable over the grid, `unassigned`: number of initial conditions without an attractor, because the lane failed,
      was undecided, had not settled or did not converge, or because no orbit was found.
    - Variable over the sweep's dimensions, `lane_attractor`: number of the lane's attractor, -1 if unassigned.
    - Variables over the grid and `named_start`: `named_attractor` and `named_regime` are the attractor and the regime
      of the motions from `drive` and `stuck`. These variables exist if the other initial conditions sample a box or a
      plane of states. `share` excludes the motions from `drive` and `stuck`.

    **Raises:** `InputError` unless the source is a sweep over a grid with several initial conditions, and its scene has
    a section.

    **Example:**

    >>> starts = {"scene": "vibro-impact", "parameters": {"beta": 0.4, "delta": 0.0}, "grid": {"gamma": [0.6]}}
    >>> att = vj.attractors(starts | {"starts": ["drive", "stuck", "touching"]}, progress=False)
    >>> att.share.round(2).values.tolist()
    [[0.67, 0.33]]
    >>> att.impact_velocity.round(1).values.tolist()  # m/s: both are single impacts
    [[0.7, 3.0]]
    """
    return analyse(source, Attractors(), progress)


def _columns(
    sweep: Sweep, lanes: xr.Dataset, motions: Sequence[Motion], number: Int[np.ndarray, " motions"]
) -> dict[str, Float[np.ndarray, "points attractors"]]:
    """Return the properties of each attractor at each point by name, 0 or NaN where the attractor is absent.

    They are regime, cycles, medians of `MEASURED` over the lanes, and one point of the orbit on the section.
    """
    table = pd.DataFrame({name: lanes[name].values.ravel().astype(float) for name in MEASURED if name in lanes})
    of_lane = np.full(len(table), -1)
    for index, motion in enumerate(motions):
        of_lane[motion.lanes] = index
    repeats = np.array([motion.cycles for motion in motions] + [0])[of_lane]
    if "impacts" in table:  # a lane may show a longer period than its orbit has
        of_orbit = table["impacts"] * repeats / lanes["cycles"].values.ravel()
        table["impacts"] = table["impacts"].where(repeats == 0, of_orbit)
    medians = table.where(np.isfinite(table)).groupby(of_lane).median().reindex(range(len(motions)))
    values: dict[str, Any] = {"regime": [x.regime for x in motions], "cycles": [x.cycles for x in motions]}
    values |= {name: medians[name] for name in table}
    for k, name in enumerate(of_orbits(sweep.system)):
        values[name] = [np.nan if motion.orbit is None else motion.orbit.states[0, 0, k] for motion in motions]
    shape = lanes["regime"].size // lanes.sizes[START], int(number.max(initial=-1)) + 1
    columns = {name: np.full(shape, 0.0 if name in ("regime", "cycles") else np.nan) for name in values}
    for name, column in values.items():
        columns[name][np.array([motion.cell for motion in motions], int), number] = column
    if "blow_frequency" in lanes:
        columns["blow_frequency"] = blow_frequency(columns["impacts"], columns["cycles"], columns["period"])
    return columns


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
    lost = counted(unassigned, f"lane of {lanes} ends", f"lanes of {lanes} end") + " in no known attractor"

    # Legend: number, most frequent regime, and basin fraction over the grid.
    names, shares = regime_names(ds[REGIME]), ds["share"].mean([d for d in ds["share"].dims if d != ATTRACTOR])
    rows = zip(_usual_regimes(ds), shares.values.tolist(), attractor_colours(ds)[:_COLOURED], strict=False)
    keys: list[Key] = [
        patch(colour, f"{k}: {names[flag]}, {share_text(share)} of starts", edge="")
        for k, (flag, share, colour) in enumerate(rows)
    ]
    if (others := ds.sizes[ATTRACTOR] - _COLOURED) > 0:
        keys.append(patch(BEYOND, f"{others} others", edge=""))
    if unassigned and not along:
        keys.append(no_value_key("could not be told"))
    return replace(sheet, keys=[keys], **margins(ds, about, note, lost if unassigned else ""))


def _usual_regimes(ds: xr.Dataset) -> list[int]:
    """Return the regime that each attractor has for most starts."""
    count = ds.sizes[ATTRACTOR]
    share, regime = (ds[name].transpose(ATTRACTOR, ...).values.reshape(count, -1) for name in ("share", REGIME))
    return [int(np.argmax(np.bincount(*each))) for each in zip(regime, share, strict=True)]


def attractor_colours(ds: xr.Dataset) -> list[str]:
    """Return the colour of each attractor: that of its regime, in other shades for further ones of the same regime."""
    colours: list[str] = []
    regimes = _usual_regimes(ds)
    for k, flag in enumerate(regimes[:_COLOURED]):
        colour, share = np.array(to_rgb(REGIME_COLOURS.get(flag, BEYOND))), _SHADE ** regimes[:k].count(flag)
        colours.append(to_hex(share * colour + (1 - share) * (colour.mean() < 0.5)))
    return colours + [BEYOND] * (len(regimes) - len(colours))


def _shares_along(ds: xr.Dataset, x: str) -> Sheet:
    """Draw basin fractions as columns, and impact velocities where a fraction is above zero, over the axis `x`."""
    ds, colours = ds.sortby(x), attractor_colours(ds)
    panels = facets(ds, (x, ATTRACTOR), _MOST_FACETS)
    names = ["share", *([_VELOCITY] if _VELOCITY in ds and np.isfinite(ds[_VELOCITY]).any() else [])]
    wide = 1 + max(column for _, column in panels.places(_MOST_COLUMNS))
    rows = -(-len(panels) // wide)
    plots = []
    for k, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        facet, along = facet.transpose(..., x, ATTRACTOR), values_along(facet[x])
        share, error = 100.0 * facet["share"].values, 100.0 * facet["share_stderr"].values
        tops = np.cumsum(np.nan_to_num(share), axis=1)  # one on top of another
        ends = edges(along)
        stacked, velocities = list[Layer](), list[Layer]()
        for number in range(share.shape[1]):
            occurs, top = share[:, number] > 0, tops[:, number]
            low, high = np.clip([top - error[:, number], top + error[:, number]], 0.0, 100.0)
            heights = np.nan_to_num(share[:, number])
            stacked.append(Bars(ends[:-1], top - heights, np.diff(ends), heights, colours[number]))
            inner = occurs & (top < 100.0 - _WHOLE)
            stacked.append(Line(*bars(along[inner], low[inner], high[inner]), width=1.0, halo=0.5))
            if len(names) > 1:
                velocity = np.where(occurs, facet[_VELOCITY].values[:, number] * scale(ds[_VELOCITY])[0], np.nan)
                look: Look = {"marker": "o", "size": 3.6, "order": 2.5 - 0.001 * number, "clip": False}
                velocities.insert(0, Line(along, velocity, colours[number], 1.3, **look))
        for i, (name, layers) in enumerate(zip(names, (stacked, velocities), strict=False)):
            up = Axis("share of starts [%]", limits=(0.0, 100.0), group=name)
            if name == _VELOCITY:
                up = Axis(with_unit("impact velocity", scale(ds[name])[1]), name, group=f"{name}{k // wide}")
            place, across = (k // wide * len(names) + i, k % wide), map_axis(facet[x], group="across")
            plots.append(Plot(layers, across, up, "" if i else title, place, at(facet)))
    size = _PANEL[0] * wide + 1.8, _PANEL[1] * rows * len(names) + 0.8
    plots.sort(key=lambda plot: plot.place)
    return Sheet(plots, size)


def _shares_at_point(ds: xr.Dataset) -> tuple[Plot, str]:
    """Draw the basins of one point, or basin fractions as bars; return the plot, and the note on its markers."""
    spread = on_axes(ds[[LANES]].assign({REGIME: ds[LANES]}).drop_vars(HIDDEN, errors="ignore"))
    states = [str(name) for name in spread[LANES].dims if name != START]
    if len(states) != 2:
        share, error = 100.0 * ds["share"].values, 100.0 * ds["share_stderr"].values
        places = np.arange(share.size, dtype=float)
        columns = Bars(places - 0.4, 0.0 * places, 0.0 * places + 0.8, share, attractor_colours(ds))
        errors = Line(*bars(places, share - error, share + error), "#4D4D4D")
        ticks = [(k, str(int(k))) for k in places[:: max(1, -(-share.size // _SHOWN))].tolist()]
        up = Axis("share of starts [%]", limits=(0.0, None))
        return Plot([columns, errors], Axis("attractor", ticks=ticks), up), ""
    x, y = states
    cells = np.asarray(spread[LANES].transpose(y, x).values)
    shown, colours = np.where(cells < 0, np.nan, cells), ListedColormap(attractor_colours(ds))
    ends = edges(values_along(spread[x])), edges(values_along(spread[y]))
    across, up = (axis(spread[name], limits=(float(e[0]), float(e[-1]))) for name, e in zip(states, ends, strict=True))
    layers: list[Layer] = [Cells(*ends, shown, colours, BoundaryNorm(np.arange(-0.5, colours.N), colours.N))]

    # The orbits are marked where they cross the section, at which the velocity that defines it is zero.
    known = {str(name).removeprefix("orbit_"): x.values for name, x in ds.items() if str(name).startswith("orbit_")}
    on_section = 0.0 * next(iter(known.values()), np.full(ds.sizes[ATTRACTOR], np.nan))
    crossings = np.stack([known.get(n.removeprefix(PREFIX), on_section) * scale(spread[n])[0] for n in states], axis=1)
    low, high = np.transpose([(end[0], end[-1]) for end in ends])
    inside, orbits = np.all((low <= crossings) & (crossings <= high), axis=1), np.isfinite(crossings).all(axis=1)
    for k in np.flatnonzero(inside):
        across_at, up_at = crossings[k].tolist()
        layers.append(dots([across_at], [up_at], size=11.0, face="white", edge="black", order=3.0, clip=False))
        layers.append(Text(across_at, up_at, str(k), colour="black", size=7.5))
    notes = ["Circles: where the orbits pass the section"] * bool(inside.any())
    for mask, one, many in (
        (orbits & ~inside, "passes the section outside the picture", "pass the section outside the picture"),
        (~orbits & orbits.any(), "is not periodic", "are not periodic"),
    ):
        if numbers := [str(k) for k in np.flatnonzero(mask)]:
            several = len(numbers) > 1
            notes.append(f"Attractor{'s' * several} {', '.join(numbers)} {many if several else one}")
    return Plot(layers, across, up), ". ".join(notes)


def share_map(ds: xr.Dataset) -> Sheet:
    """Draw the fraction of initial conditions that end in the strong single impact, over two axes.

    Next to it are the regimes reached from the scene's named initial conditions, or else the number of attractors. An
    impact is strong if the mean impact velocity exceeds the drive's speed `v`; without a drive, all single impacts
    count. Each value of further axes gets a row.
    """
    ds = without_single(ds)
    x, y = axes_of_map(ds)
    ds = ds.sortby([x, y])
    names = [str(name) for name in ds[NAMED].values] if NAMED in ds.dims else []
    speed = ds.coords.get("v", parameters_of(ds).get("v")) if _VELOCITY in ds else None
    single = ds[REGIME] == SINGLE_IMPACT
    strong = single if speed is None else single & (ds[_VELOCITY] > speed)
    share = (100.0 * ds["share"]).where(strong, 0.0).sum(ATTRACTOR).assign_attrs(units="%")
    coords = {name: data for name, data in ds.coords.items() if set(data.dims) <= set(share.dims)}
    shown = xr.Dataset({_STRONG: share, REGIME: xr.zeros_like(share, np.int8)}, coords, ds.attrs)
    for name in names:
        shown[_FROM + name] = ds["named_regime"].sel({NAMED: name}, drop=True)
    if not names:
        shown[_COUNT] = (ds["share"] > 0).sum(ATTRACTOR).astype(float)
    values = [share_value(shown[_STRONG], "strong single impact")]
    values += [regime_value(shown[_FROM + name], f"from {name}") for name in names] or [value_of(shown[_COUNT])]
    panels = facets(shown, (x, y), MOST_PANELS // len(values))
    sheet = maps_of(panels, values, shown[x], shown[y], lambda facet, value: cell_layers(facet, value, x, y))
    keys = cell_keys(panels.data, [value for value in values if value.counted])
    about = "Strong: the striker hits faster than the drive moves"
    about = "Of single impacts, strong or weak" if speed is None else about
    notes = margins(ds, panels.note, f"{ds.sizes[START]} starts at each point", about)
    return replace(sheet, keys=[keys], **notes)


@dataclass(frozen=True)
class Attractors(SweepAnalysis):
    """Find the attractors to which a sweep's starts lead, and the share of the starts that lead to each."""

    kind = "attractors"
    counted = "attractor"
    variables = OF_ATTRACTORS
    pictures = (
        PictureRule("attractors", lambda held: held.wide, share_map),
        PictureRule("attractors", lambda held: True, attractor_shares),
    )

    def sweep(self, source: Source) -> Sweep:
        if isinstance(source, xr.Dataset) and LANES in source:
            raise InputError("attractors: the dataset holds attractors already; give the sweep, or its dataset")
        sweep = sweep_with_orbits(source)
        if sweep.run.carry is not None:
            raise InputError("attractors: lanes of this sweep are carried, so they have no starts; leave carry out")
        if sweep.points is not None:
            raise InputError("attractors: points of a list have no neighbours to number along; give a [grid] instead")
        if not sweep.crosses_starts or sweep.system.driving_part().section is None:
            raise InputError(f'attractors: scene "{sweep.scene}" takes no starts; give a sweep of a scene with a drill')
        return sweep

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        *dims, _ = sweep.dims
        *shape, starts = sweep.shape
        lanes = lanes.transpose(*sweep.dims, ...)
        runs = [(sweep, lanes)]
        named = [name for name in DEFAULT_STARTS if name in sweep.system.starts]
        if sweep.starts is not None and not sweep.starts.listed and named:
            own = replace(sweep, starts=list_of(named, sweep.starts.states), run=replace(sweep.run, orbits=True))
            runs.append((own, run_sweep(own, progress=progress).transpose(*sweep.dims, ...)))
        observed, motions, number = grouping.numbered_motions(runs, progress)
        of_lane = np.full(observed["regime"].size, -1)
        for motion, own_number in zip(motions, number.tolist(), strict=True):
            of_lane[motion.lanes] = own_number
        of_lane = of_lane.reshape(*shape, -1)
        of_start = of_lane[..., :starts]

        columns = _columns(sweep, observed, motions, number)
        share, assigned = np.zeros_like(columns["regime"]), np.flatnonzero(of_start >= 0)
        np.add.at(share, (assigned // starts, of_start.ravel()[assigned]), 1 / starts)
        columns = {"share": share, "share_stderr": np.sqrt(share * (1 - share).clip(0) / starts), **columns}
        data: dict[str, Any] = {name: ((*dims, ATTRACTOR), x.reshape(*shape, -1)) for name, x in columns.items()}
        data |= {"unassigned": (dims, (of_start < 0).sum(axis=-1)), LANES: (sweep.dims, of_start)}
        coordinates: dict[Any, Any] = {name: x for name, x in lanes.coords.items() if set(x.dims) <= set(sweep.dims)}
        numbers = np.arange(share.shape[1])
        coordinates[ATTRACTOR] = (ATTRACTOR, numbers, {"units": "1", "long_name": "number of the attractor"})
        if len(runs) > 1:
            names, about = runs[1][1][START].values, {"units": "1", "long_name": "start of the scene, by name"}
            coordinates[NAMED] = (NAMED, names, about)
            data["named_attractor"] = (*dims, NAMED), of_lane[..., starts:]
            data["named_regime"] = (*dims, NAMED), runs[1][1]["regime"].values
        title = (sweep.title or sweep.name).removesuffix(f": {sweep.name}")  # not two colons
        known = variables_of(sweep.system) | OF_ATTRACTORS
        return self.dataset(
            described(data, known),
            coordinates,
            of=sweep,
            title=f"Attractors: {title}",
            sweep=sweep.text,
            attractors=json.dumps(SETTINGS),
            lanes=sweep.lanes,
        )

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        grid = [name for name in ds["share"].dims if name != ATTRACTOR]
        unassigned, lanes = int(ds["unassigned"].sum()), ds[LANES].size
        share = ds["share"].values.reshape(ds["unassigned"].size, ds.sizes[ATTRACTOR])
        numbers, counts = np.unique((share > 0).sum(axis=1), return_counts=True)
        points = [f"{number} at {counted(count, 'point')}" for number, count in zip(numbers, counts, strict=True)]
        lines = [
            f"attractors at a point: {', '.join(points)}",
            f"{unassigned} of {counted(lanes, 'lane')} unassigned ({100 * unassigned / max(lanes, 1):.1f} %)",
        ]
        regime, meanings = ds["regime"].values.reshape(share.shape), flags(ds["regime"])
        for number in range(min(share.shape[1], _SHOWN)):
            mask = share[:, number] > 0
            kinds, sizes = np.unique(regime[mask, number], return_counts=True)
            names = ", ".join(meanings[int(kinds[k])] for k in np.argsort(-sizes, kind="stable"))
            percent = 100 * share[:, number].mean()
            where = counted(int(mask.sum()), "point")
            lines.append(f"attractor {number}: {percent:.1f} % of starts, at {where}: {names}")
        if share.shape[1] > _SHOWN:
            lines.append(f"and {share.shape[1] - _SHOWN} more of smaller shares")
        facts = {"shares": ds["share"].mean(grid).values, "unassigned": unassigned}
        return [SummaryPart("shares", lines, {"attractors": facts})]
