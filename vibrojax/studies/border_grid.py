"""Stable single impacts at the grid points of a plane, and chains of vertices around regions of grid points.

A single impact is a periodic orbit with one section crossing and one impact per period. The orbits of lanes are
continued along the grid's edges to the neighbouring grid points. If one ceases to be a stable single impact on an edge,
the kind of this loss and the parameter value are determined.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from contourpy import FillType, LineType, contour_generator
from jaxtyping import Bool, Float, Int

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.arclength import ENDED, STALLED, continue_branches
from vibrojax.periodic.brackets import Brackets, shrink_brackets
from vibrojax.periodic.location import TEST_FUNCTIONS, classify_event_changes, turn_corner
from vibrojax.periodic.newton import multipliers, spectral_radius
from vibrojax.periodic.orbits import SAME_ORBIT
from vibrojax.periodic.problem import Flags, PerLane, Points, Problem, towards
from vibrojax.periodic.segments import STEP_AFTER_CORNER
from vibrojax.scenes import Scene

MAX_ORBITS_PER_POINT = 6
"""Largest number of stable single impacts at one grid point, which limits the computing time."""

EDGE_LENGTH, EDGE_MAX_STEP = 1 / 3, 0.5
"""Length of an edge, in units of the scaled parameter, and largest scaled step length; one step covers most edges."""

MAX_CORNERS_PER_EDGE = 4

NO_ORBIT, ARRIVED = SPECIAL_KINDS.index("end"), -1
"""Kind of a loss without an explanation; and number in place of a kind if the orbit is not lost."""

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
    """

    scene: Scene[Any]
    names: tuple[str, str]
    values: tuple[np.ndarray, np.ndarray]
    parameters: Mapping[str, Float[np.ndarray, "planes xs ys"]]
    orbits: dict[Cell, list[GridOrbit]] = field(default_factory=dict)

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
                plane, *place = orbit.cell
                place[axis] += step[1]
                if step not in orbit.leads and 0 <= place[axis] < len(self.values[axis]):
                    edges.append((orbit, step, (plane, place[0], place[1])))
        if not edges:
            return []
        here, there = (np.array(cells) for cells in zip(*((orbit.cell, cell) for orbit, _, cell in edges), strict=True))
        begin, end = (self.values[axis][cells[:, 1 + axis]] for cells in (here, there))
        first, last = np.minimum(begin, end)[:, None], np.maximum(begin, end)[:, None]
        problem = Problem(
            scene=self.scene,
            along=(self.names[axis],),
            parameters={name: x[tuple(here.T)] for name, x in self.parameters.items()},
            scales=np.array([orbit.scale for orbit, _, _ in edges]),
            unit=(last - first) / EDGE_LENGTH,
            first=first,
            last=last,
        )
        new, ends = [], _continue_edges(problem, np.array([orbit.state for orbit, _, _ in edges]), begin, end)
        for (orbit, step, cell), kind, value, state in zip(edges, *ends, strict=True):
            if kind != ARRIVED:
                orbit.leads[step] = OrbitLoss(int(kind), float(value), state)
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


@np.errstate(all="ignore")
def _continue_edges(
    problem: Problem, states: Float[np.ndarray, "edges states"], begin: PerLane, end: PerLane
) -> tuple[Int[np.ndarray, " edges"], PerLane, Float[np.ndarray, "edges states"]]:
    """Continue orbits from the parameter values `begin` to `end`, also around corners.

    Return the kind of each orbit's loss, or `ARRIVED`, and the parameter and the state at its last point.
    """
    lanes, kinds = np.arange(len(begin)), np.full(len(begin), NO_ORBIT)
    values, last_states = begin.copy(), states.copy()

    def enter(points: Points, kind: Any) -> None:
        edges = points.family
        kinds[edges], values[edges] = kind, problem.values(edges, points.u)[:, 0]
        last_states[edges] = problem.states(edges, points.u)[:, 0]

    u = problem.unknowns(lanes, states[:, None], begin[:, None])
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
        enter(last.of(sound & (branches.status == ENDED)), ARRIVED)
        # Other orbits cease to be stable single impacts just before their newest points, or at corners.
        before = newest[~sound] - 1
        losses, _ = shrink_brackets(
            problem,
            branches.brackets(before[before >= 0]),
            lambda _, points: np.where(is_stable_single_impact(points), 1.0, -1.0),
        )
        enter(losses.near, _kinds_of_loss(problem, losses))
        stalled = np.flatnonzero(sound & (branches.status == STALLED))
        if not len(stalled):
            break
        turned, corners = turn_corner(problem, [branches.points.of(slice(*bounds[k : k + 2])) for k in stalled])
        on = turned & is_stable_single_impact(corners.far)
        losses = corners.of(~on)
        enter(last.of(stalled[~on]), np.where(losses.changes_events, _kinds_of_loss(problem, losses), NO_ORBIT))
        points = corners.far.of(on)
        step = np.full(len(points.u), STEP_AFTER_CORNER)
        if not len(points.u):
            break
    return kinds, values, last_states


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


class Vertex(NamedTuple):
    """Point at which a border crosses a grid edge: coordinates `x` and `y`, and the `kind` of border.

    `loss`: the loss of the orbit there, None at the border of a basin.
    """

    x: float
    y: float
    kind: str
    loss: OrbitLoss | None = None


_Crossing = tuple[int, int, int]
"""A grid edge that a border crosses: its axis, and the two indices of its lower end point."""


def around_region(
    inside: Bool[np.ndarray, "xs ys"],
    x: np.ndarray,
    y: np.ndarray,
    ends: Callable[[tuple[int, int], tuple[int, int]], Vertex],
) -> tuple[list[list[Vertex]], float]:
    """Return the chains of vertices around a region, and the region's fraction of the area of the grid.

    A closed chain repeats its first vertex at the end. Two parts of the region that meet at a saddle remain separate.

    **Arguments:** `ends(inside, outside)`: point of the border between two neighbouring grid points.
    """
    # Over the indices of the grid, contours cross each edge in its middle.
    contours = contour_generator(z=inside.T + 0.0, line_type=LineType.Separate, fill_type=FillType.OuterOffset)

    @cache
    def vertex(crossing: _Crossing) -> Vertex:
        axis, i, j = crossing
        here, there = (i, j), (i + 1, j) if axis == 0 else (i, j + 1)
        return ends(here, there) if inside[here] else ends(there, here)

    lines: Any = contours.lines(0.5)  # a list of arrays with this type of lines
    chains = sorted((_in_order(line) for line in lines), key=lambda chain: (chain[0] == chain[-1], chain))
    area = 0.0
    for points, offsets in zip(*contours.filled(0.5, 1.5), strict=True):
        corners = [
            (float(x[int(i)]), float(y[int(j)])) if i % 1 == 0 == j % 1 else vertex(_crossing(i, j))[:2]
            for i, j in points.tolist()
        ]
        for first, last in pairwise(offsets.tolist()):  # holes are passed in the other direction
            px, py = np.array(corners[first:last]).T
            area += float(np.dot(px[:-1], py[1:]) - np.dot(py[:-1], px[1:])) / 2
    whole = (x[-1] - x[0]) * (y[-1] - y[0])
    return [[vertex(crossing) for crossing in chain] for chain in chains], abs(area / whole) if whole else 0.0


def _crossing(i: float, j: float) -> _Crossing:
    return (0 if i % 1 else 1), int(i), int(j)


def _in_order(line: np.ndarray) -> list[_Crossing]:
    """Return the crossings of a line from its lower end, or from its lowest crossing and with rising y if it closes."""
    chain = [_crossing(i, j) for i, j in line.tolist()]
    if chain[0] != chain[-1]:
        return min(chain, chain[::-1])
    lowest = chain.index(min(chain))
    chain = chain[lowest:-1] + chain[: lowest + 1]
    _, i, j = chain[0]
    upwards = chain[1] in ((1, i + 1, j), (0, i, j + 1), (1, i, j))
    return chain if upwards else chain[::-1]
