"""Propagation of stable single impacts over a plane: from the orbits of lanes to all reachable points of the grid.

A single impact is a periodic orbit with one section crossing and one impact per period. Each orbit is continued along
the grid's edges to the four neighbouring grid points. If it ceases to be a stable single impact on an edge, the kind of
this loss and the parameter value are determined.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.arclength import ENDED, STALLED, continue_branches
from vibrojax.periodic.brackets import Brackets, shrink_brackets
from vibrojax.periodic.location import TEST_FUNCTIONS, classify_event_changes
from vibrojax.periodic.newton import multipliers, spectral_radius
from vibrojax.periodic.orbits import SAME_ORBIT
from vibrojax.periodic.problem import Flags, Index, PerLane, Points, Problem, towards
from vibrojax.periodic.segments import STEP_AFTER_CORNER
from vibrojax.periodic.special_points import turn_corner
from vibrojax.scenes import Scene

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


@dataclass(frozen=True, eq=False)
class OrbitLoss:
    """Loss of a stable single impact on an edge: `kind` as a flag, and parameter `value` along the edge's axis.

    `state`: state of the orbit at the section.
    """

    kind: int
    value: float
    state: np.ndarray


@dataclass(eq=False)
class GridOrbit:
    """A stable single impact at a grid point: its state at the section and the state's scales.

    `leads`: for each step, the orbit at the neighbouring grid point, or the `OrbitLoss` on the edge.
    """

    cell: Cell
    state: np.ndarray
    scale: np.ndarray
    leads: "dict[Step, GridOrbit | OrbitLoss]" = field(default_factory=dict)


@dataclass(eq=False)
class OrbitGrid:
    """The stable single impacts at the grid points of a sweep's planes.

    - `names`, `values`: names and values of the planes' two axes.
    - `parameters`: all parameters of the scene by name, each (planes, xs, ys).
    - `most_steps`: step limit between two section crossings.
    """

    scene: Scene[Any]
    names: tuple[str, str]
    values: tuple[np.ndarray, np.ndarray]
    parameters: Mapping[str, Float[np.ndarray, "planes xs ys"]]
    most_steps: float
    orbits: dict[Cell, list[GridOrbit]] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of planes, and numbers of grid points along the two axes."""
        return next(iter(self.parameters.values())).shape

    def find(self, cell: Cell, state: np.ndarray) -> GridOrbit | None:
        """Return the known orbit with the given state at a grid point, or None if the orbit is new."""
        known = self.orbits.get(cell, ())
        return next((orbit for orbit in known if np.abs((orbit.state - state) / orbit.scale).max() < SAME_ORBIT), None)

    def add(self, cell: Cell, state: np.ndarray, scale: np.ndarray) -> GridOrbit:
        """Add an orbit at a grid point, and return it."""
        orbit = GridOrbit(cell, state, scale)
        self.orbits.setdefault(cell, []).append(orbit)
        return orbit

    def propagate(self) -> None:
        """Continue all orbits to all neighbouring grid points, then the new orbits found there, until none is new."""
        front = [orbit for of_cell in self.orbits.values() for orbit in of_cell]
        while front:
            front = [orbit for axis in (0, 1) for orbit in self._propagate_along(front, axis)]

    def _propagate_along(self, front: list[GridOrbit], axis: int) -> list[GridOrbit]:
        """Continue orbits along the edges of one axis that have not been passed yet; return the new orbits."""
        edges: list[tuple[GridOrbit, Step, Cell]] = []
        for orbit in front:
            for step in ((axis, 1), (axis, -1)):
                beside = list(orbit.cell)
                beside[1 + axis] += step[1]
                if step not in orbit.leads and 0 <= beside[1 + axis] < self.shape[1 + axis]:
                    edges.append((orbit, step, (beside[0], beside[1], beside[2])))
        if not edges:
            return []
        orbits = [orbit for orbit, _, _ in edges]
        cells = np.array([orbit.cell for orbit in orbits])
        parameters = {name: x[tuple(cells.T)] for name, x in self.parameters.items()}
        begin = self.values[axis][cells[:, 1 + axis]]
        end = self.values[axis][np.array([cell[1 + axis] for _, _, cell in edges])]
        first, last = np.minimum(begin, end), np.maximum(begin, end)
        unit, scales = (last - first) / EDGE_LENGTH, np.array([orbit.scale for orbit in orbits])
        problem = Problem(
            scene=self.scene,
            along=(self.names[axis],),
            parameters=parameters,
            scales=scales,
            unit=unit[:, None],
            first=first[:, None],
            last=last[:, None],
            most_steps=self.most_steps,
        )
        ends = _continue_edges(problem, np.array([orbit.state for orbit in orbits]), begin, end)
        new = []
        for (orbit, step, cell), state in zip(edges, ends, strict=True):
            if isinstance(state, OrbitLoss):
                orbit.leads[step] = state
                continue
            other = self.find(cell, state)
            if other is None:
                if len(self.orbits.get(cell, ())) >= MAX_ORBITS_PER_POINT:
                    continue
                other = self.add(cell, state, orbit.scale)
                new.append(other)
            orbit.leads[step] = other
            other.leads.setdefault((axis, -step[1]), orbit)
        return new


def _continue_edges(
    problem: Problem, states: Float[np.ndarray, "edges states"], begin: PerLane, end: PerLane
) -> list[np.ndarray | OrbitLoss]:
    """Continue orbits from the parameter values `begin` to `end`, also around corners.

    Return the state at the end of each edge if the orbit is still a stable single impact there, else its loss.
    """
    lanes, no_orbit = np.arange(len(begin)), SPECIAL_KINDS.index("end")
    ends: list[np.ndarray | OrbitLoss] = [
        OrbitLoss(no_orbit, value, state) for value, state in zip(begin.tolist(), states, strict=True)
    ]

    def enter(points: Points, kinds: Index) -> None:
        values, orbits = problem.values(points.family, points.u)[:, 0], problem.states(points.family, points.u)[:, 0]
        for k, edge in enumerate(points.family.tolist()):
            ends[edge] = OrbitLoss(int(kinds[k]), float(values[k]), orbits[k])

    def test(_: Index, points: Points) -> PerLane:
        return np.where(is_stable_single_impact(points), 1.0, -1.0)

    u = problem.unknowns(lanes, states[:, None], begin[:, None])
    with np.errstate(all="ignore"):
        points = problem.evaluate(lanes, u).along(towards(u, np.sign(end - begin)))
        step = np.full(len(lanes), EDGE_MAX_STEP)
        for _ in range(MAX_CORNERS_PER_EDGE + 1):
            branches = continue_branches(
                problem, points, step, lambda _, now: ~is_stable_single_impact(now), longest=EDGE_MAX_STEP
            )
            bounds = branches.bounds
            newest = bounds[1:] - 1
            last = branches.points.of(newest)
            sound = is_stable_single_impact(last)
            arrived = last.of(sound & (branches.status == ENDED))
            for edge, state in zip(arrived.family.tolist(), problem.states(arrived.family, arrived.u), strict=True):
                ends[edge] = state[0]
            # Other orbits cease to be stable single impacts just before their newest points, or at corners.
            places = newest[~sound] - 1
            losses, _ = shrink_brackets(problem, branches.brackets(places[places >= 0]), test)
            enter(losses.near, _kinds_of_loss(problem, losses))
            stalled = np.flatnonzero(sound & (branches.status == STALLED))
            if not len(stalled):
                break
            turned, corners = turn_corner(problem, [branches.points.of(slice(*bounds[k : k + 2])) for k in stalled])
            on = turned & is_stable_single_impact(corners.far)
            losses = corners.of(~on)
            kinds = np.where(losses.changes_events, _kinds_of_loss(problem, losses), no_orbit)
            enter(last.of(stalled[~on]), kinds)
            points = corners.far.of(on)
            step = np.full(len(points.u), STEP_AFTER_CORNER)
            if not len(points.u):
                break
    return ends


def is_stable_single_impact(points: Points) -> Flags:
    """Return a mask of the orbits that are stable single impacts."""
    stable = np.isfinite(points.residual) & (spectral_radius(points.product) < 1)
    return stable & (points.impacts == 1)


def _kinds_of_loss(problem: Problem, brackets: Brackets) -> Int[np.ndarray, " brackets"]:
    """Return the kinds of the losses within brackets.

    The kind follows from a change of events if there is one, else from the multiplier nearest to a critical value.
    """
    values = multipliers(brackets.near.product)
    real = np.abs(values.imag) < 1e-6
    to_one = np.where(real, np.abs(values - 1), np.inf).min(axis=1)
    to_minus_one = np.where(real, np.abs(values + 1), np.inf).min(axis=1)
    to_circle = np.where(real, np.inf, np.abs(np.abs(values) - 1)).min(axis=1)
    flags = np.array([SPECIAL_KINDS.index(name) for name in TEST_FUNCTIONS])
    kinds = flags[np.argmin([to_one, to_minus_one, to_circle], axis=0)]
    for k in np.flatnonzero(brackets.changes_events):
        kinds[k] = classify_event_changes(problem, brackets.of([k])).kind[0]
    return kinds
