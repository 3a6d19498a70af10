"""Borders of the stable single impact in a plane of two parameters: `borders`."""

from collections.abc import Mapping
from functools import partial
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, counted, shown
from vibrojax.io.kinds import BORDER_KINDS, OF_BORDERS
from vibrojax.io.variables import described
from vibrojax.maps.dataset import parameter_attributes, shared_attributes
from vibrojax.maps.rerun import orbits as with_orbits
from vibrojax.maps.rerun import sweep_with_orbits
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import SINGLE_IMPACT, UNDECIDED
from vibrojax.periodic.orbits import orbits_of
from vibrojax.physics.parameters import REPLACED, substitutes
from vibrojax.scenes import HasImpacts
from vibrojax.studies.border_chains import Vertex, around_region
from vibrojax.studies.border_continued import Border, ContinuedBorders, crossings_of
from vibrojax.studies.border_propagation import GridOrbit, OrbitGrid, OrbitLoss

WHERE = {
    "seed_": " from which the curve was continued; not defined for a border located between points of the grid",
    "crossing_": " where the border crosses the line",
}
"""Ends of the meanings of parameters, by prefix of their names."""

ANY_START = "any"
"""Name of the region of all orbits, whatever initial condition leads to them; used in place of an initial condition."""


def borders(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep,
    axes: tuple[str, str] | None = None,
    at: Mapping[str, float] | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Compute the borders of the stable single impact in a sweep's plane, as curves with the kind of each border.

        cur = vj.borders(ds)

    A single impact is a periodic orbit with one section crossing and one impact per period. The single impacts on which
    the sweep's lanes settle are continued along the edges of the grid, as long as they are stable single impacts. Where
    such an orbit is lost, a vertex is located. For each initial condition, curves through the vertices bound the region
    in which this initial condition leads to a stable single impact. Further curves bound the region of all stable
    single impacts, whatever initial condition leads to them.

    **Arguments:**

    - `source`: the dataset of a sweep with a grid, or a sweep as in `run_sweep`. A sweep without orbits is run again.
    - `axes`: the two axes of the plane; by default gamma and beta, else the two axes with the most values.
    - `at`: either parameter with a value, such as `{"beta": 0.5}`. The points at which continued borders pass this
      value are located like special points.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `vertex`, ordered along each curve: the two parameters, and `curve`, the number of the vertex's curve.
    - Along `curve`: `kind`, and the coordinates `start` (the initial condition, or "any" for all orbits) and the values
      of the sweep's other axes. The kinds are fold, period-doubling, torus, grazing, stick, section, hopf, end, basin
      and not-settled. At a *basin* border the orbit continues, but the initial condition no longer leads to it. A
      *not-settled* border is like a *basin* border, but the motion beyond it had not settled. `continued` is 1 for a
      part of a continued curve, which begins at `seed_NAME` of both parameters, else 0. `curve_note` says why the curve
      ends, or why there is none. The attribute `begun_from` names the grid.
    - With `at`, along `crossing`: `crossing_curve`, and `crossing_NAME` for both parameters.
    - Along `region`: `region_area`, the fraction of the plane with a stable single impact, with the coordinates
      `region_start` and so on.

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
    sweep = sweep_with_orbits(source)
    names = plane_axes(sweep, axes)
    line = line_of(sweep, names, at)
    dataset = with_orbits(source if isinstance(source, xr.Dataset) else sweep, progress)
    return Regions(sweep, dataset, names).borders(line, progress)


def line_of(sweep: Sweep, names: tuple[str, str], at: object) -> tuple[str, float] | None:
    """Return the parameter and the value at which crossings are located, or None."""
    if at is None:
        return None
    name, value = next(iter(at.items())) if isinstance(at, Mapping) and len(at) == 1 else ("", None)
    if name not in names or isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise InputError(f"borders: at: {shown(at)} is not {' or '.join(names)} with a value; give one of them")
    low, high = float(sweep.axes[name].min()), float(sweep.axes[name].max())
    if not low <= value <= high:
        raise InputError(f"borders: at: {name}: {value:g} is not between {low:g} and {high:g}, the ends of the axis")
    return name, float(value)


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
    if len(axes) != 2 or axes[0] == axes[1] or any(name not in long for name in axes):
        raise InputError(f"borders: axes {shown(axes)} are not two axes of the sweep; choose from {', '.join(long)}")
    for name in (name for name in (*axes, *sweep.parameters) if name in substitutes(sweep.system.parameters())):
        formula = ": gamma = striker_frequency/bit_frequency" if name == "striker_frequency" else ""
        instead = f"give {REPLACED[name]}, which it replaces{formula}"
        raise InputError(f"borders: {name} is not a parameter of the scene; {instead}")
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
        planes = int(np.prod(self._sizes))
        shape = (planes, dataset.sizes[names[0]], dataset.sizes[names[1]], len(self._starts))
        scene = sweep.system.driving_part()
        values, _ = sweep.lane_values(0, sweep.lanes)
        lanes = {}
        for name in scene.parameters():
            grid = xr.DataArray(values[name].reshape(sweep.shape), dims=sweep.dims).transpose(*order)
            lanes[name] = grid.values.astype(float).ravel()
        known = orbits_of(scene, dataset, lanes)
        points = {name: x.reshape(shape)[..., 0] for name, x in lanes.items()}
        axes = sweep.axes[names[0]], sweep.axes[names[1]]
        self._grid = OrbitGrid(scene, names, axes, points, max((orbits.most_steps for orbits in known), default=0.0))
        self._regime = dataset["regime"].values.reshape(shape)
        self._single = self._regime == SINGLE_IMPACT
        settled = self._single & (dataset["stable"].values.reshape(shape) == 1)
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
        x, y = self._grid.values
        reached = np.zeros(self._grid.shape, bool)
        for cell in self._grid.orbits:
            reached[cell] = True
        for plane in range(len(reached)):
            for number, start in enumerate([*self._starts, ANY_START]):
                inside = reached[plane] if start == ANY_START else self._single[plane, :, :, number]
                ends = partial(self._vertex, plane, None if start == ANY_START else number)
                around, area = around_region(inside, x, y, ends)
                chains += [(chain, plane, start) for chain in around]
                areas.append((area, plane, start))
        self._continued.follow([(plane, chain) for chain, plane, _ in chains], progress)
        curves = [(piece, plane, start) for chain, plane, start in chains for piece in self._continued.cut(chain)]
        return self._described(curves, areas, at)

    def _vertex(self, plane: int, start: int | None, inside: tuple[int, int], outside: tuple[int, int]) -> Vertex:
        """Return the border of a region between two neighbouring grid points.

        `start`: number of the initial condition whose region it is, or None for the region of all orbits.
        """
        cell = (plane, *inside)
        axis = 0 if inside[0] != outside[0] else 1
        step = (axis, outside[axis] - inside[axis])
        axes = self._grid.values
        begin, end = (float(axes[axis][place[axis]]) for place in (inside, outside))
        orbits = self._grid.orbits.get(cell, [])
        if start is not None:
            orbits = [self._own[(*cell, start)]] if (*cell, start) in self._own else []
        leads = [orbit.leads.get(step) for orbit in orbits]
        losses = [lead for lead in leads if isinstance(lead, OrbitLoss)]
        value, furthest = (begin + end) / 2, None
        if losses and len(losses) == len(leads):
            furthest = max(losses, key=lambda loss: abs(loss.value - begin))
            value, kind = furthest.value, BORDER_KINDS[furthest.kind]
        elif not leads:
            kind = "end"
        else:
            settled = start is None or self._regime[(plane, *outside, start)] != UNDECIDED
            kind = "basin" if settled else "not-settled"
        place = [float(axes[0][inside[0]]), float(axes[1][inside[1]])]
        place[axis] = value
        return Vertex(place[0], place[1], kind, furthest)

    def _described(
        self, curves: list[tuple[Border, int, str]], areas: list[tuple[float, int, str]], at: tuple[str, float] | None
    ) -> xr.Dataset:
        """Return the dataset of curves and areas, each given with its plane and initial condition."""
        sweep = self._sweep
        vertices = np.concatenate([piece.points for piece, _, _ in curves]) if curves else np.zeros((0, 2))
        lines = [piece.line for piece, _, _ in curves]
        variables: dict[str, Any] = {
            "curve": ("vertex", np.repeat(np.arange(len(curves)), [len(piece.points) for piece, _, _ in curves])),
            "kind": ("curve", [BORDER_KINDS.index(piece.kind) for piece, _, _ in curves]),
            "region_area": ("region", [area for area, _, _ in areas]),
            "continued": ("curve", [line is not None for line in lines]),
            "curve_note": ("curve", [piece.note for piece, _, _ in curves]),
        }
        seeds = np.array([(np.nan, np.nan) if line is None else line.seed for line in lines]).reshape(-1, 2)
        located = {"": ("vertex", vertices), "seed_": ("curve", seeds)}
        if at is not None:
            which = self._names.index(at[0])
            crossed = [(k, x) for k, (piece, _, _) in enumerate(curves) for x in crossings_of(piece, which, at[1])]
            variables["crossing_curve"] = ("crossing", [k for k, _ in crossed])
            located["crossing_"] = ("crossing", np.array([x for _, x in crossed]).reshape(-1, 2))
        for prefix, (dimension, points) in located.items():
            for name, values in zip(self._names, points.T, strict=True):
                about = parameter_attributes(sweep, name)
                about["long_name"] += WHERE.get(prefix, "")
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
