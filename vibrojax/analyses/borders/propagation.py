"""Propagation of stable single impacts over a plane: from the orbits of lanes to all reachable points of the grid.

A single impact is a periodic orbit with one section crossing and one impact per period. Each orbit is continued along
the grid's edges to the four neighbouring grid points. If it ceases to be a stable single impact on an edge, the kind of
this loss and the parameter value are determined.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.continuation.arclength import ENDED, STALLED, BranchPoints, InitialPoints, continue_branches
from vibrojax.analyses.continuation.brackets import BranchBrackets, shrink_brackets
from vibrojax.analyses.continuation.families import STEP_AFTER_CORNER, last_before
from vibrojax.analyses.continuation.indicators import KINDS, spectral_radius
from vibrojax.analyses.continuation.problem import Evaluation, Flags, Index, PerLane, Problem, Unknowns, unit_tangent
from vibrojax.analyses.continuation.special_points import classify_event_changes
from vibrojax.analyses.continuation.switching import turn_corner
from vibrojax.models.scenes import Scene
from vibrojax.periodic.newton import multipliers

SAME_ORBIT = 1e-4
"""Scaled distance within which two orbits at one grid point count as equal."""

MAX_ORBITS_PER_POINT = 6
"""Largest number of stable single impacts at one grid point, which limits the computing time."""

EDGE_LENGTH = 1 / 3
"""Length of an edge, in units of the scaled parameter."""

EDGE_MAX_STEP = 0.5
"""Largest scaled step length; one step covers most edges."""

MAX_CORNERS_PER_EDGE = 4

Cell = tuple[int, int, int]
"""A grid point: number of its plane, and indices along the plane's two axes."""

Step = tuple[int, int]
"""A step to a neighbouring grid point: axis of the plane (0 or 1), and direction (-1 or 1)."""

GRID_STEPS: tuple[Step, ...] = ((0, 1), (0, -1), (1, 1), (1, -1))

States = Float[np.ndarray, "edges states"]
Lost = Int[np.ndarray, " lost"]


class Planes(NamedTuple):
    """Planes of a sweep: names and values of their two axes, and all `parameters` by name, each (planes, xs, ys)."""

    names: tuple[str, str]
    values: tuple[np.ndarray, np.ndarray]
    parameters: Mapping[str, Float[np.ndarray, "planes xs ys"]]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of planes, and numbers of grid points along the two axes."""
        planes, xs, ys = next(iter(self.parameters.values())).shape
        return planes, xs, ys

    def neighbour(self, cell: Cell, step: Step) -> Cell | None:
        """Return the neighbouring grid point in the direction of `step`, or None if it is outside the plane."""
        place = list(cell)
        place[1 + step[0]] += step[1]
        return (place[0], place[1], place[2]) if 0 <= place[1 + step[0]] < self.shape[1 + step[0]] else None

    def value(self, cell: Cell, axis: int) -> float:
        """Return the coordinate of a grid point along an axis."""
        return float(self.values[axis][cell[1 + axis]])


class OrbitLoss(NamedTuple):
    """Loss of a stable single impact on an edge: `kind` as a flag, and parameter `value` along the edge's axis."""

    kind: int
    value: float


@dataclass(eq=False)
class GridOrbit:
    """A stable single impact at a grid point: its state at the section and the state's scales.

    `leads`: for each step, the orbit at the neighbouring grid point, or the `OrbitLoss` on the edge.
    """

    cell: Cell
    state: np.ndarray
    scale: np.ndarray
    leads: "dict[Step, GridOrbit | OrbitLoss]" = field(default_factory=dict)


OrbitsByCell = dict[Cell, list[GridOrbit]]


def find_orbit(orbits: OrbitsByCell, cell: Cell, state: np.ndarray) -> GridOrbit | None:
    """Return the known orbit with the given state at a grid point, or None if the orbit is new."""
    for orbit in orbits.get(cell, ()):
        if np.abs((orbit.state - state) / orbit.scale).max() < SAME_ORBIT:
            return orbit
    return None


def add_orbit(orbits: OrbitsByCell, cell: Cell, state: np.ndarray, scale: np.ndarray) -> GridOrbit:
    """Add an orbit at a grid point, and return it."""
    orbit = GridOrbit(cell, state, scale)
    orbits.setdefault(cell, []).append(orbit)
    return orbit


class _Arrivals(NamedTuple):
    """Results of edges: mask `arrived` of orbits that are still stable single impacts at the end, with their `states`.

    `kind` and `value` describe the losses of the other orbits.
    """

    arrived: Bool[np.ndarray, " edges"]
    states: States
    kind: Int[np.ndarray, " edges"]
    value: PerLane


def propagate(scene: Scene[Any], planes: Planes, orbits: OrbitsByCell, most_steps: float) -> None:
    """Continue all orbits to all neighbouring grid points, then the new orbits found there, until none is new."""
    front = [orbit for of_cell in orbits.values() for orbit in of_cell]
    while front:
        new: list[GridOrbit] = []
        for axis in (0, 1):
            edges = [
                (orbit, step, end)
                for orbit in front
                for step in GRID_STEPS
                if step[0] == axis and step not in orbit.leads
                if (end := planes.neighbour(orbit.cell, step)) is not None
            ]
            if edges:
                new += _propagate_along(scene, planes, orbits, edges, axis, most_steps)
        front = new


def _propagate_along(
    scene: Scene[Any],
    planes: Planes,
    orbits: OrbitsByCell,
    edges: list[tuple[GridOrbit, Step, Cell]],
    axis: int,
    most_steps: float,
) -> list[GridOrbit]:
    """Continue orbits along edges (orbit, step, end) of one axis; add the results to `orbits`; return new orbits."""
    cells = np.array([orbit.cell for orbit, _, _ in edges])
    parameters = {name: x[tuple(cells.T)] for name, x in planes.parameters.items()}
    begin = planes.values[axis][cells[:, 1 + axis]]
    end = planes.values[axis][np.array([cell[1 + axis] for _, _, cell in edges])]
    scales = np.array([orbit.scale for orbit, _, _ in edges])
    first, last = np.minimum(begin, end), np.maximum(begin, end)
    unit = (last - first) / EDGE_LENGTH
    problem = Problem(scene, planes.names[axis], parameters, scales, unit, first, last, most_steps)
    results = _continue_edges(problem, np.array([orbit.state for orbit, _, _ in edges]), begin, end)
    new = []
    for k, (orbit, step, cell) in enumerate(edges):
        if not results.arrived[k]:
            orbit.leads[step] = OrbitLoss(int(results.kind[k]), float(results.value[k]))
            continue
        other = find_orbit(orbits, cell, results.states[k])
        if other is None:
            if len(orbits.get(cell, ())) >= MAX_ORBITS_PER_POINT:
                continue
            other = add_orbit(orbits, cell, results.states[k], orbit.scale)
            new.append(other)
        orbit.leads[step] = other
        other.leads.setdefault((step[0], -step[1]), orbit)
    return new


def _continue_edges(problem: Problem, states: States, begin: PerLane, end: PerLane) -> _Arrivals:
    """Continue orbits from the parameter values `begin` to `end`, also around corners."""
    lanes = np.arange(len(begin))
    u = problem.unknowns(lanes, states[:, None], begin)
    towards = np.zeros_like(u)
    towards[:, -1] = np.sign(end - begin)
    kind = np.full(len(lanes), KINDS.index("end"))
    results = _Arrivals(np.zeros(len(lanes), bool), states.copy(), kind, begin.copy())
    with np.errstate(all="ignore"):
        tangent = unit_tangent(problem.evaluate(lanes, u).matrix, towards)
        step = np.full(len(lanes), EDGE_MAX_STEP)
        for _ in range(MAX_CORNERS_PER_EDGE + 1):
            none = np.full_like(u, np.nan)
            initial = InitialPoints(lanes, u, tangent, step, none, none)
            points = continue_branches(problem, initial, EDGE_MAX_STEP, lambda _, now: ~is_stable_single_impact(now))
            bounds = np.searchsorted(points.lane, np.arange(len(lanes) + 1))
            newest = bounds[1:] - 1
            sound = is_stable_single_impact(points.evaluation.of(newest))
            arrived = sound & (points.status == ENDED)
            results.arrived[lanes[arrived]] = True
            results.states[lanes[arrived]] = problem.states(lanes, points.evaluation.u[newest])[arrived, 0]
            _locate_losses(problem, lanes, points, newest[~sound], results)
            stalled = np.flatnonzero(sound & (points.status == STALLED))
            if not len(stalled):
                break
            lanes, u, tangent = _pass_corners(problem, lanes, points, bounds, stalled, results)
            step = np.full(len(lanes), STEP_AFTER_CORNER)
            if not len(lanes):
                break
    return results


def is_stable_single_impact(evaluation: Evaluation) -> Flags:
    """Return a mask of the orbits that are stable single impacts."""
    stable = np.isfinite(evaluation.residual) & (spectral_radius(evaluation.product) < 1)
    return stable & (evaluation.impacts == 1)


def _locate_losses(problem: Problem, lanes: Index, points: BranchPoints, lost: Lost, results: _Arrivals) -> None:
    """Locate the losses of stable single impacts just before the points `lost`, and enter them in `results`."""
    place = lost - 1
    place = place[place >= 0]
    place = place[points.lane[place] == points.lane[place + 1]]
    if not len(place):
        return
    family = lanes[points.lane[place]]

    def test(_: Index, now: Evaluation, __: Unknowns) -> PerLane:
        return np.where(is_stable_single_impact(now), 1.0, -1.0)

    shrunk, _ = shrink_brackets(problem, points.brackets(family, place), test, np.ones(len(place), bool))
    results.kind[family] = _kinds_of_loss(problem, shrunk)
    results.value[family] = problem.value(family, shrunk.near.u)


def _kinds_of_loss(problem: Problem, brackets: BranchBrackets) -> Int[np.ndarray, " brackets"]:
    """Return the kinds of the losses within brackets.

    The kind follows from a change of events if there is one, else from the multiplier nearest to a critical value.
    """
    values = multipliers(brackets.near.product)
    real = np.abs(values.imag) < 1e-6
    to_one = np.where(real, np.abs(values - 1), np.inf).min(axis=1)
    to_minus_one = np.where(real, np.abs(values + 1), np.inf).min(axis=1)
    to_circle = np.where(real, np.inf, np.abs(np.abs(values) - 1)).min(axis=1)
    flags = np.array([KINDS.index(name) for name in ("fold", "period-doubling", "torus")])
    kinds = flags[np.argmin([to_one, to_minus_one, to_circle], axis=0)]
    same = (brackets.near.signature == brackets.far.signature).all(axis=1)
    for k in np.flatnonzero(~same):
        kinds[k] = classify_event_changes(problem, brackets.of(np.array([k])))[0][0][0]
    return kinds


def _pass_corners(
    problem: Problem,
    lanes: Index,
    points: BranchPoints,
    bounds: Int[np.ndarray, " bounds"],
    stalled: Int[np.ndarray, " stalled"],
    results: _Arrivals,
) -> tuple[Int[np.ndarray, " on"], Float[np.ndarray, "on unknowns"], Float[np.ndarray, "on unknowns"]]:
    """Return lanes, unknowns and tangents of stalled orbits that are stable single impacts beyond a corner.

    The losses of the other stalled orbits are entered in `results`.
    """
    newest = bounds[stalled + 1] - 1
    last, tangent = points.evaluation.of(newest), points.tangent[newest]
    slices = (slice(bounds[k], bounds[k + 1]) for k in stalled)
    before = Evaluation.join([last_before(points.evaluation.of(lane)) for lane in slices])
    family = lanes[stalled]
    corner = turn_corner(problem, family, last, tangent, before)
    on = corner.turned & is_stable_single_impact(corner.evaluation)
    off = np.flatnonzero(~on)
    if len(off):
        brackets = BranchBrackets(family, bounds[stalled], before, tangent, corner.evaluation, tangent).of(off)
        same = (brackets.near.signature == brackets.far.signature).all(axis=1)
        results.kind[family[off]] = np.where(same, KINDS.index("end"), _kinds_of_loss(problem, brackets))
        results.value[family[off]] = problem.value(family, last.u)[off]
    return family[on], corner.evaluation.u[on], corner.tangent[on]
