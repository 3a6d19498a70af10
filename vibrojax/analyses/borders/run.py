"""The borders of the stable single impact in a plane of two parameters: `borders`."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool

from vibrojax.analyses.borders.curves import Border, Vertex, around_region
from vibrojax.analyses.borders.spread import Cell, Loss, Orbits, Planes, spread
from vibrojax.analyses.orbits.rerun import orbits as with_orbits
from vibrojax.analyses.orbits.rerun import sweep_with_orbits
from vibrojax.errors import InputError, shown
from vibrojax.io.derived import BORDER_KINDS, OF_BORDERS
from vibrojax.io.provenance import provenance
from vibrojax.measures.labels import SINGLE_IMPACT, UNDECIDED
from vibrojax.models.physics.parameters import differing
from vibrojax.models.scenes import HasContact
from vibrojax.periodic.of_dataset import known_orbits
from vibrojax.sweep.input.definition import Sweep

ANY = "any"
"""Instead of a start: the region of orbits, however they are reached."""

USUAL_AXES = ("gamma", "beta")


def borders(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep,
    axes: tuple[str, str] | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """The borders of the stable single impact in a sweep's plane, as curves named by what happens there.

        cur = vj.borders(ds)

    The single impacts on which the sweep's lanes settle are followed along the lines of the grid, from point to point,
    as far as they are stable single impacts; where one ceases to be that, a vertex is located. The vertices are joined
    to curves around the region to which each start leads, and around that of all orbits however they are reached.

    **Arguments:**

    - `source`: the dataset of a sweep with a grid, or a sweep as `run_sweep` takes it. One without orbits is run again.
    - `axes`: the two axes of the plane; by default gamma and beta, else the two with most values.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset. Along `vertex`: the two parameters, and `curve`, the number of the curve that it belongs to;
    in order along the curve. Along `curve`: `kind` (fold, period-doubling, torus, grazing, stick, section, end; basin:
    the orbit goes on, but this start no longer leads to it; not-settled: nor had the motion settled there), and as
    coordinates `start` ("any": of all orbits) and the values of the axes beyond the two. Along `region`: `region_area`,
    the share of the plane with a stable single impact, with the coordinates `region_start` and so on.

    **Raises:** `InputError` where it is no sweep over a grid of two parameters, or the scene has no impacts.

    **Example:**

    >>> axes = {"beta": [0.3, 0.5, 0.7], "gamma": [0.6, 0.8, 1.0]}
    >>> plane = {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "grid": axes, "starts": ["stuck"]}
    >>> cur = vj.borders(plane, progress=False)
    >>> cur.region_start.values.tolist()
    ['stuck', 'any']
    >>> bool(cur.region_area[0] < cur.region_area[1])  # where this start leads to one is less than where there is one
    True
    """
    sweep = sweep_with_orbits(source)
    names = checked(sweep, axes)
    dataset = with_orbits(source if isinstance(source, xr.Dataset) else sweep, progress)
    return borders_of(sweep, dataset, names)


def borders_of(sweep: Sweep, dataset: xr.Dataset, names: tuple[str, str]) -> xr.Dataset:
    """The borders in the plane of two axes of a sweep, from its dataset with orbits; see `borders`."""
    return _Regions(sweep, dataset, names).dataset()


def checked(sweep: Sweep, axes: tuple[str, str] | None) -> tuple[str, str]:
    """The axes of the plane; raises `InputError` where the sweep has no such plane, or no impacts."""
    if not isinstance(sweep.system, HasContact):
        raise InputError(f'borders: scene "{sweep.scene}" has no impacts; give a sweep of one with a striker')
    if sweep.run.carry is not None:
        raise InputError("borders: lanes of this sweep are carried, so they have no starts; leave carry out")
    long = {name: len(values) for name, values in sweep.axes.items() if len(values) > 1}
    if len(long) < 2:
        raise InputError("borders: the sweep has no two axes of two values or more; give one with a [grid] of two")
    if axes is None:
        if all(name in long for name in USUAL_AXES):
            return USUAL_AXES
        first, second = sorted(long, key=lambda name: -long[name])[:2]
        return first, second
    if len(axes) != 2 or axes[0] == axes[1] or any(name not in long for name in axes):
        raise InputError(f"borders: axes {shown(axes)} are no two axes of the sweep; choose from {', '.join(long)}")
    return axes[0], axes[1]


class _Regions:
    """The regions of the single impact in all planes of a sweep, and their borders."""

    def __init__(self, sweep: Sweep, dataset: xr.Dataset, names: tuple[str, str]) -> None:
        self._sweep, self._names = sweep, names
        self._others = [name for name in sweep.axes if name not in names]
        order = [*self._others, *names, *(["start"] if sweep.crosses_starts else [])]
        dataset = dataset.transpose(*order, ...)
        self._starts = [str(one) for one in dataset["start"].values] if sweep.crosses_starts else [""]
        self._sizes = tuple(dataset.sizes[name] for name in self._others)
        planes = int(np.prod(self._sizes))
        shape = (planes, dataset.sizes[names[0]], dataset.sizes[names[1]], len(self._starts))
        values, _ = sweep.lane_values(0, sweep.lanes)
        laid_out = {
            name: xr.DataArray(x.reshape(sweep.shape), dims=sweep.dims).transpose(*order).values.reshape(shape)
            for name, x in values.items()
        }
        self._regime = dataset["regime"].values.reshape(shape)
        scene = sweep.system.driving_part()
        lanes = {name: laid_out[name].astype(float).ravel() for name in scene.parameters()}
        known = known_orbits(scene, dataset, lanes)
        points = {name: x.reshape(shape)[..., 0] for name, x in lanes.items()}
        self._planes = Planes(names, (sweep.axes[names[0]], sweep.axes[names[1]]), points)
        self._own = np.full(shape, -1)
        self._orbits = Orbits()
        single = self._regime == SINGLE_IMPACT
        stable = dataset["stable"].values.reshape(shape) == 1
        for k, lane in enumerate(known.lanes.tolist()):
            plane, i, j, start = (int(one) for one in np.unravel_index(lane, shape))
            if not (single[plane, i, j, start] and stable[plane, i, j, start] and len(known.states[k]) == 1):
                continue
            cell, state = (plane, i, j), known.states[k][0]
            number = self._orbits.known(cell, state)
            self._own[plane, i, j, start] = self._orbits.add(cell, state, known.scales[k]) if number is None else number
        spread(scene, self._planes, self._orbits, known.most_steps)
        self._single = single

    def dataset(self) -> xr.Dataset:
        """The curves and areas of all regions."""
        found: list[tuple[Border, int, str]] = []
        areas: list[tuple[int, str, float]] = []
        x, y = self._planes.values
        for plane in range(self._planes.shape[0]):
            for number, start in enumerate([*self._starts, ANY]):
                inside = self._reached(plane) if start == ANY else self._inside(plane, number)
                pieces, area = around_region(inside, x, y, self._ends(plane, None if start == ANY else number))
                found += [(piece, plane, start) for piece in pieces]
                areas.append((plane, start, area))
        return self._described(found, areas)

    def _inside(self, plane: int, start: int) -> Bool[np.ndarray, "xs ys"]:
        """Where a start leads to a single impact."""
        return self._single[plane, :, :, start]

    def _reached(self, plane: int) -> Bool[np.ndarray, "xs ys"]:
        """Where there is a stable single impact."""
        inside = np.zeros(self._planes.shape[1:], bool)
        for which, i, j in self._orbits.at:
            inside[i, j] |= which == plane
        return inside

    def _ends(self, plane: int, start: int | None) -> Any:
        """Where the region of a start, or of all orbits, ends between two points."""

        def ends(here: tuple[int, int], there: tuple[int, int]) -> Vertex:
            cell: Cell = (plane, *here)
            axis = 0 if here[0] != there[0] else 1
            step = (axis, there[axis] - here[axis])
            numbers = self._orbits.at.get(cell, []) if start is None else [int(self._own[(*cell, start)])]
            losses = [self._orbits.leads[n].get(step) for n in numbers if n >= 0]
            where = [loss for loss in losses if isinstance(loss, Loss)]
            if len(where) == len(losses) and where:
                begin = self._planes.value(cell, axis)
                furthest = max(where, key=lambda loss: abs(loss.value - begin))
                return self._vertex(cell, axis, furthest.value, BORDER_KINDS[furthest.kind])
            middle = (self._planes.value(cell, axis) + self._planes.value((plane, *there), axis)) / 2
            if not losses:
                return self._vertex(cell, axis, middle, "end")
            settled = start is None or self._regime[(plane, *there, start)] != UNDECIDED
            return self._vertex(cell, axis, middle, "basin" if settled else "not-settled")

        return ends

    def _vertex(self, cell: Cell, axis: int, value: float, kind: str) -> Vertex:
        at = [self._planes.value(cell, 0), self._planes.value(cell, 1)]
        at[axis] = value
        return Vertex(at[0], at[1], kind)

    def _described(self, found: list[tuple[Border, int, str]], areas: list[tuple[int, str, float]]) -> xr.Dataset:
        parameters = self._sweep.system.parameters()

        def about(name: str, long_name: str = "") -> dict[str, str]:
            one = parameters[name]
            return {"units": one.unit, "long_name": long_name or one.long_name, "symbol": one.symbol}

        vertices = np.concatenate([piece.points for piece, _, _ in found]) if found else np.zeros((0, 2))
        number = np.repeat(np.arange(len(found)), [len(piece.points) for piece, _, _ in found])
        kinds = np.array([BORDER_KINDS.index(piece.kind) for piece, _, _ in found], np.int8)
        variables: dict[str, Any] = {
            "curve": ("vertex", number.astype(np.int32), OF_BORDERS["curve"].attributes()),
            "kind": ("curve", kinds, OF_BORDERS["kind"].attributes()),
            "region_area": ("region", np.array([area for *_, area in areas]), OF_BORDERS["region_area"].attributes()),
        }
        for k, name in enumerate(self._names):
            variables[name] = ("vertex", vertices[:, k], about(name))
        coordinates: dict[str, Any] = {}
        for dimension, prefix, planes, starts in (
            ("curve", "", [plane for _, plane, _ in found], [start for *_, start in found]),
            ("region", "region_", [plane for plane, *_ in areas], [start for _, start, _ in areas]),
        ):
            of = {"units": "1", "long_name": "start of the motions whose region it is; any: of all orbits"}
            if self._sweep.crosses_starts:
                coordinates[f"{prefix}start"] = (dimension, np.array(starts, str), of)
            at = np.unravel_index(np.array(planes, int), self._sizes) if self._sizes else ()
            for name, places in zip(self._others, at, strict=True):
                coordinates[f"{prefix}{name}"] = (dimension, self._sweep.axes[name][places], about(name))
        attributes = {
            "title": f"Borders of the stable single impact: {self._sweep.title or self._sweep.name}",
            "scene": self._sweep.scene,
            **provenance(),
            "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} borders",
            "sweep": self._sweep.text,
            **self._sweep.options,
            "axes": list(self._names),
            "parameters": json.dumps(self._sweep.parameters),
            "differing": json.dumps(differing(self._sweep.system.parameters(), self._sweep.parameters)),
            "Conventions": "CF-1.11",
        }
        return xr.Dataset(variables, coordinates, attributes)
