"""The analysis `borders`: curves around the stable single impact in a plane of two parameters."""

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from os import PathLike
from textwrap import fill
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, counted, printable, shown
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import BORDER_KINDS, OF_BORDERS
from vibrojax.io.variables import described
from vibrojax.maps.dataset import parameter_attributes, shared_attributes
from vibrojax.maps.rerun import sweep_with_orbits
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import SINGLE_IMPACT, UNDECIDED
from vibrojax.periodic.orbits import orbits_of
from vibrojax.periodic.problem import check_changes_orbits
from vibrojax.physics.parameters import REPLACED, substitutes
from vibrojax.pictures.axes import axis, margins, share_text, value_text, values_along
from vibrojax.pictures.overlays import ANY, axes_of, beyond, border_layers
from vibrojax.pictures.plots import Plot, Sheet, Text, dots
from vibrojax.scenes import HasImpacts
from vibrojax.studies.analysis import PictureRule, Source, SummaryPart, analyse
from vibrojax.studies.border_curves import Border, ContinuedBorders, crossings_of
from vibrojax.studies.border_grid import GridOrbit, OrbitGrid, OrbitLoss, Vertex, around_region
from vibrojax.studies.curves import read_line
from vibrojax.studies.subjects import SweepAnalysis

_PANEL = (3.3, 3.0)  # inches
_STABLE = "#F2CC6B"
_POINT, _POINTS = 3.5, 60.0  # size of a point of the grid [pt], and of a row of points together
_MOST_SHOWN = 4  # largest numbers of rows and of columns


def borders(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep,
    axes: tuple[str, str] | None = None,
    at: Mapping[str, float] | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Find the borders of the region with a stable single impact in a parameter plane, and the cause of each border.

        cur = vj.borders(ds)

    The function continues the sweep's single-impact orbits from each grid point to its neighbours. Where an orbit ends
    or loses its stability between two grid points, the function locates a vertex of a border. The borders enclose the
    region where a given initial condition leads to a stable single impact, and the larger region where a stable single
    impact exists.

    **Arguments:**

    - `source`: the dataset of a sweep with a grid, or a sweep as in `run_sweep`. If the dataset has no orbits, its
      sweep is run again.
    - `axes`: the two axes of the plane; by default gamma and beta if the sweep varies both, else the two axes with the
      most values.
    - `at`: a value of either parameter, such as `{"beta": 0.5}`; the points at which continued borders cross this value
      are located.

    **Returns:** a dataset.

    - Variables along `vertex`, in order on each curve: both parameters, and `curve`, a number for each curve.
    - Variables along `curve`: `kind`, with the coordinates `start` (the initial condition, or "any" for all orbits) and
      the values of the sweep's other axes. Beyond a border of the kind *basin*, the orbit exists, but the initial
      condition does not lead to it. Beyond a border of the kind *not-settled*, the motion had not settled by the end of
      its simulation. The flag `continued` is 1 if the curve was computed by continuation, from the point with the
      parameters `seed_NAME`, and 0 if it joins points between grid points. The text `curve_note` states why the curve
      ends, or why it was not continued. The attribute `begun_from` describes the grid of the sweep.
    - Variables along `crossing`, if the argument `at` is given: `crossing_curve` (number of the curve), and
      `crossing_NAME` (value of each parameter).
    - Variables along `region`: `region_area`, the fraction of the plane with a stable single impact, with the
      coordinates `region_start` and so on. Variable along `region` and `cell`: `region_stable` is 1 at grid points with
      a stable single impact; `cell_NAME` are the two parameters of a grid point.

    **Raises:** `InputError` if the source is not a sweep over a grid of two parameters, or if the scene has no impacts.

    **Example:**

    >>> axes = {"beta": [0.5, 0.6], "gamma": [0.6, 0.8]}
    >>> plane = {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "grid": axes, "starts": ["stuck"]}
    >>> cur = vj.borders(plane, progress=False)
    >>> cur.region_start.values.tolist()
    ['stuck', 'any']
    >>> bool(cur.region_area[0] < cur.region_area[1])  # not every orbit is reached from this start
    True
    >>> cur.attrs["begun_from"].partition(";")[0].partition(" from ")[2]
    'points located on a grid of 2 x 2'
    """
    return analyse(source, Borders(axes, at), progress)


def plane_axes(sweep: Sweep, axes: tuple[str, str] | None) -> tuple[str, str]:
    """Return the axes of the plane; raise `InputError` if the sweep has no such plane or its scene no impacts."""
    if not isinstance(sweep.system, HasImpacts):
        raise InputError(f'borders: scene "{sweep.scene}" has no impacts; give a sweep of one with a striker')
    if sweep.run.carry is not None:
        raise InputError("borders: lanes of this sweep are carried, so they have no starts; leave carry out")
    long = {name: len(values) for name, values in sweep.axes.items() if len(values) > 1}
    if len(long) < 2:
        raise InputError("borders: the sweep has no two axes of two values or more; give one with a [grid] of two")
    if axes is None:
        first, second = sorted(long, key=lambda name: -long[name])[:2]
        axes = ("gamma", "beta") if {"gamma", "beta"} <= long.keys() else (first, second)
    if not isinstance(axes, tuple | list) or len(axes) != 2 or {*map(str, axes)} - long.keys() or axes[0] == axes[1]:
        raise InputError(f"borders: axes {shown(axes)} are not two axes of the sweep; choose from {', '.join(long)}")
    for name in (name for name in (*axes, *sweep.parameters) if name in substitutes(sweep.system.parameters())):
        formula = ": gamma = striker_frequency/bit_frequency" if name == "striker_frequency" else ""
        instead = f"give {REPLACED[name]}, which it replaces{formula}"
        raise InputError(f"borders: {name} is not a parameter of the scene; {instead}")
    for name in axes:
        check_changes_orbits(Place("borders").at("axes"), sweep.system, name)
    return axes[0], axes[1]


class Regions:
    """Regions of the stable single impact in all planes of a sweep, and their borders.

    `dataset`: the sweep's result with orbits; `names`: the axes of the planes.
    """

    def __init__(self, sweep: Sweep, dataset: xr.Dataset, names: tuple[str, str]) -> None:
        self._sweep, self._names = sweep, names
        self._others = [name for name in sweep.axes if name not in names]
        order = [*self._others, *names, *(["start"] if sweep.crosses_starts else [])]
        dataset = dataset.transpose(*order, ...)
        self._starts = [str(start) for start in dataset["start"].values] if sweep.crosses_starts else [""]
        self._sizes = tuple(dataset.sizes[name] for name in self._others)
        shape = (int(np.prod(self._sizes)), *(dataset.sizes[name] for name in names), len(self._starts))
        scene = sweep.system.driving_part()
        values, _ = sweep.lane_values(0, sweep.lanes)
        lanes = {}
        for name in scene.parameters():
            grid = xr.DataArray(values[name].reshape(sweep.shape), dims=sweep.dims).transpose(*order)
            lanes[name] = grid.values.astype(float).ravel()
        known = orbits_of(scene, dataset, lanes)
        points = {name: x.reshape(shape)[..., 0] for name, x in lanes.items()}
        axes = sweep.axes[names[0]], sweep.axes[names[1]]
        self._grid = OrbitGrid(scene, names, axes, points)
        self._regime = dataset["regime"].values.reshape(shape)
        settled = (self._regime == SINGLE_IMPACT) & (dataset["stable"].values.reshape(shape) == 1)
        self._continued = ContinuedBorders(self._grid)
        self._own: dict[tuple[int, int, int, int], GridOrbit] = {}
        for single in (orbits for orbits in known if orbits.states.shape[1] == 1):
            for lane, state, scale in zip(single.lane.tolist(), single.states[:, 0], single.scales, strict=True):
                plane, i, j, start = (int(k) for k in np.unravel_index(lane, shape))
                if settled[plane, i, j, start]:
                    own = self._grid.find((plane, i, j), state) or self._grid.add((plane, i, j), state, scale)
                    self._own[plane, i, j, start] = own
        self._grid.propagate()

    def borders(self, at: tuple[str, float] | None = None, progress: bool = True) -> xr.Dataset:
        """Return the dataset of the borders; `at`: parameter and value of the crossings."""
        chains: list[tuple[list[Vertex], int, str]] = []
        areas: list[tuple[float, int, str]] = []
        stable: list[np.ndarray] = []
        reached = np.zeros(self._regime.shape[:-1], bool)
        for cell in self._grid.orbits:
            reached[cell] = True
        for plane, number in product(range(len(reached)), [*range(len(self._starts)), None]):
            start = ANY if number is None else self._starts[number]
            inside = reached[plane] if number is None else self._regime[plane, :, :, number] == SINGLE_IMPACT
            around, area = around_region(inside, *self._grid.values, partial(self._vertex, plane, number))
            chains += [(chain, plane, start) for chain in around]
            areas.append((area, plane, start))
            stable.append(inside.ravel())
        self._continued.follow([(plane, chain) for chain, plane, _ in chains], progress)
        curves = [(piece, plane, start) for chain, plane, start in chains for piece in self._continued.cut(chain)]
        return self._dataset(curves, areas, np.array(stable), at)

    def _vertex(self, plane: int, start: int | None, inside: tuple[int, int], outside: tuple[int, int]) -> Vertex:
        """Return the border of a region between two neighbouring grid points.

        `start`: number of the initial condition whose region it is, or None for the region of all orbits.
        """
        axis, axes = (0 if inside[0] != outside[0] else 1), self._grid.values
        begin, end = (float(axes[axis][place[axis]]) for place in (inside, outside))
        if start is None:
            orbits = self._grid.orbits.get((plane, *inside), [])
        else:
            orbits = [own] if (own := self._own.get((plane, *inside, start))) else []
        leads = [orbit.leads.get((axis, outside[axis] - inside[axis])) for orbit in orbits]
        losses = [lead for lead in leads if isinstance(lead, OrbitLoss)]
        value, furthest = (begin + end) / 2, None
        if losses and len(losses) == len(leads):
            furthest = max(losses, key=lambda loss: abs(loss.value - begin))
            value, kind = furthest.value, BORDER_KINDS[furthest.kind]
        elif not leads:
            kind = "end"
        else:
            undecided = start is not None and self._regime[(plane, *outside, start)] == UNDECIDED
            kind = "not-settled" if undecided else "basin"
        place = [float(axes[0][inside[0]]), float(axes[1][inside[1]])]
        place[axis] = value
        return Vertex(place[0], place[1], kind, furthest)

    def _dataset(
        self,
        curves: list[tuple[Border, int, str]],
        areas: list[tuple[float, int, str]],
        stable: np.ndarray,
        at: tuple[str, float] | None,
    ) -> xr.Dataset:
        """Return the dataset of curves and areas, each given with its plane and initial condition.

        `stable`: which points of the grid are in each region.
        """
        sweep, pieces = self._sweep, [piece for piece, _, _ in curves]
        lines = [piece.line for piece in pieces]
        variables: dict[str, Any] = {
            "curve": ("vertex", np.repeat(np.arange(len(curves)), [len(piece.points) for piece in pieces])),
            "kind": ("curve", [BORDER_KINDS.index(piece.kind) for piece in pieces]),
            "region_area": ("region", [area for area, _, _ in areas]),
            "continued": ("curve", [line is not None for line in lines]),
            "curve_note": ("curve", [piece.note for piece in pieces]),
        }
        about = {"units": "1", "long_name": "whether a single impact is stable at a point of the grid"}
        variables["region_stable"] = (("region", "cell"), stable.astype(np.int8), about)
        for name, values in zip(self._names, np.meshgrid(*self._grid.values, indexing="ij"), strict=True):
            variables[f"cell_{name}"] = ("cell", values.ravel(), parameter_attributes(sweep, name))
        seeds = np.array([(np.nan, np.nan) if line is None else line.seed[:2] for line in lines]).reshape(-1, 2)
        vertices = np.concatenate([np.zeros((0, 2)), *(piece.points for piece in pieces)])
        seeded = " from which the curve was continued; not defined for a border located between points of the grid"
        located = {"": ("vertex", vertices, ""), "seed_": ("curve", seeds, seeded)}
        if at is not None:
            which = self._names.index(at[0])
            crossed = [(k, x) for k, piece in enumerate(pieces) for x in crossings_of(piece, which, at[1])]
            variables["crossing_curve"] = ("crossing", [k for k, _ in crossed])
            crossings = np.array([x for _, x in crossed]).reshape(-1, 2)
            located["crossing_"] = ("crossing", crossings, " where the border crosses the line")
        for prefix, (dimension, points, where) in located.items():
            for name, values in zip(self._names, points.T, strict=True):
                about = parameter_attributes(sweep, name)
                about["long_name"] += where
                variables[prefix + name] = (dimension, values, about)
        coordinates: dict[str, Any] = {}
        start_attributes = {"units": "1", "long_name": "start of the motions whose region it is; any: of all orbits"}
        for dimension, prefix, rows in (("curve", "", curves), ("region", "region_", areas)):
            planes, starts = [plane for _, plane, _ in rows], [start for _, _, start in rows]
            if sweep.crosses_starts:
                coordinates[f"{prefix}start"] = (dimension, np.array(starts, str), start_attributes)
            indices = np.unravel_index(np.array(planes, int), self._sizes) if self._sizes else ()
            for name, index in zip(self._others, indices, strict=True):
                coordinates[f"{prefix}{name}"] = (dimension, sweep.axes[name][index], parameter_attributes(sweep, name))
        title = f"Borders of the stable single impact: {sweep.title or sweep.name}"
        count = counted(len(self._continued.lines), "curve")
        size = " x ".join(str(len(x)) for x in self._grid.values)
        begun = f"{count} continued from points located on a grid of {size}; regions between its points are missed"
        attributes = {
            **shared_attributes(sweep, "borders", title, "borders"),
            "sweep": sweep.text,
            "axes": list(self._names),
            "begun_from": begun,
        }
        return xr.Dataset(described(variables, OF_BORDERS), coordinates, attributes)


def border_curves(ds: xr.Dataset) -> Sheet:
    """Draw the borders of stable single impacts over two parameters.

    The figure has a row for each plane and a column for each initial condition.
    """
    x, y = axes_of(ds)
    others = beyond(ds)
    planes = [tuple(float(ds[f"region_{name}"][k]) for name in others) for k in range(ds.sizes["region"])]
    starts = ds["region_start"].values.tolist() if "region_start" in ds.coords else [ANY] * len(planes)
    regions = {region: k for k, region in reversed([*enumerate(zip(planes, starts, strict=True))])}
    rows, columns = list(dict.fromkeys(planes)), list(dict.fromkeys(starts))
    shown_rows, shown_columns = rows[:_MOST_SHOWN], [*columns[:-1][: _MOST_SHOWN - 1], columns[-1]]
    cells = {n: values_along(ds[f"cell_{n}"]) for n in (x, y) if f"cell_{n}" in ds}
    rooms = {n: 0.03 * float(np.ptp(values)) for n, values in cells.items()}
    limits = {n: (float(values.min()) - rooms[n], float(values.max()) + rooms[n]) for n, values in cells.items()}
    plots = []
    for k, (plane, start) in enumerate(product(shown_rows, shown_columns)):
        values = dict(zip(others, plane, strict=True))
        layers = border_layers(ds, values, start, x, y)
        words = [value_text(ds[name], value) for name, value in values.items()]
        words.append("any start" if start == ANY else f"start {start}")
        area = float(ds["region_area"][regions[plane, start]])
        title = f"{', '.join(words)}: {share_text(area)}"
        if not layers:
            text = "no border" + (": a single impact is stable everywhere" if area > 0.5 else "")
            layers = [Text(0.5, 0.5, fill(text, 24), relative=True)]
        if "region_stable" in ds:  # the points of the grid
            stable = ds["region_stable"].values[regions[plane, start]] == 1
            size = min(_POINT, _POINTS / np.sqrt(stable.size))
            places = (cells[n][stable] for n in (x, y))
            layers.append(dots(*places, colour=_STABLE, size=size, order=1.0, label="a single impact\nis stable"))
        across, up = (axis(ds[n], group=n, intervals=6, limits=limits.get(n, (None, None))) for n in (x, y))
        plots.append(Plot(layers, across, up, title, divmod(k, len(shown_columns)), values))
    hidden = len(rows) - len(shown_rows), len(columns) - len(shown_columns)
    text = "Percentages: share of the plane where a single impact is stable; any start: however its orbit is reached"
    missing = f"Not shown: {counted(hidden[0], 'plane')}, {counted(hidden[1], 'start')}" if any(hidden) else ""
    widths, heights = (1.0,) * len(shown_columns), (1.0,) * len(shown_rows)
    size = _PANEL[0] * len(widths) + 1.6, _PANEL[1] * len(heights) + 0.6
    return Sheet(plots, size, widths, heights, **margins(ds, text, missing))


@dataclass(frozen=True)
class Borders(SweepAnalysis):
    """Find the borders of the region with a stable single impact in a parameter plane, and the cause of each border."""

    axes: tuple[str, str] | None = field(
        default=None,
        metadata={
            "metavar": "X,Y",
            "help": "the two axes of the plane (default: gamma and beta, or else the two axes with the most values)",
        },
    )
    at: Any = field(
        default=None,
        metadata={
            "metavar": "NAME=VALUE",
            "help": "locate where continued borders pass this value of one of the two parameters",
        },
    )

    kind = "borders"
    counted = "curve"
    view = "curves"
    variables = OF_BORDERS
    pictures = (PictureRule("borders", lambda held: True, border_curves),)

    def sweep(self, source: Source) -> Sweep:
        sweep = sweep_with_orbits(source)
        self._line(sweep)
        return sweep

    def _line(self, sweep: Sweep) -> tuple[str, float] | None:
        """Return the parameter and the value at which crossings are located, or None."""
        at = self.at
        axes = {name: sweep.axes[name] for name in plane_axes(sweep, self.axes)}
        spans = {name: (float(x.min()), float(x.max())) for name, x in axes.items()}
        if isinstance(at, str):
            name, _, text = at.partition("=")
            at = {name.strip(): text}
            with suppress(ValueError):  # the text is reported below
                at = {name.strip(): float(text)}
        return read_line(Place("borders").at("at"), sweep.system.parameters(), at, spans)

    def identity(self, sweep: Sweep) -> dict[str, object]:
        return {self.kind: [*plane_axes(sweep, self.axes), *(self._line(sweep) or ())]}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        return Regions(sweep, lanes, plane_axes(sweep, self.axes)).borders(self._line(sweep), progress)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the area fraction and the kinds of the borders of each region (plane and initial condition)."""
        meanings, sizes = flags(ds["kind"]), np.bincount(ds["curve"].values, minlength=ds.sizes["curve"])
        kinds = [meanings[flag] for flag in ds["kind"].values.tolist()]
        lines, facts = [], []
        for k in range(ds.sizes["region"]):
            here = {name: float(ds[f"region_{name}"][k]) for name in beyond(ds)}
            start = str(ds["region_start"].values[k]) if "region_start" in ds.coords else ""
            mask = np.ones(ds.sizes["curve"], bool)
            for name, value in (here | ({"start": start} if start else {})).items():
                mask &= ds[name].values == value
            counter: Counter[str] = Counter()
            for curve in np.flatnonzero(mask):
                counter[kinds[curve]] += int(sizes[curve])
            vertices, area = dict(counter.most_common()), float(ds["region_area"][k])
            words = [f"{name} = {value:g}" for name, value in here.items()]
            words.append("any start" if start in ("", ANY) else f"start {start}")
            ends = ", ".join(f"{kind} ({size})" for kind, size in vertices.items()) or "nothing"
            lines.append(f"{', '.join(words)}: {100 * area:.1f} % of the plane; ends by {ends}")
            facts.append({**here, "start": start or ANY, "area": area, "vertices": vertices})
        crossings: list[dict[str, object]] = []
        for k in range(ds.sizes.get("crossing", 0)):
            kind, place = kinds[int(ds["crossing_curve"][k])], {x: float(ds[f"crossing_{x}"][k]) for x in axes_of(ds)}
            crossings.append({"kind": kind, **place})
            lines.append(f"crossing of a {kind} at {', '.join(f'{name} = {x:.9g}' for name, x in place.items())}")
        about = {"begun_from": printable(ds.attrs["begun_from"], 300)} if "begun_from" in ds.attrs else {}
        lines += about.values()
        return [SummaryPart("borders", lines, {"borders": facts, "crossings": crossings, **about})]
