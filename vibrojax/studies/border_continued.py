"""Continued borders: curves of special points through the located vertices of a region's border.

Each run of vertices of one kind begins a curve in the plane. Vertices that lie on a curve are replaced by the part of
the curve between them, up to the point where the next curve begins.
"""

from collections.abc import Sequence
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np

from vibrojax.periodic.codim2 import CONTINUED
from vibrojax.periodic.curve_following import crossings, follow_curves
from vibrojax.progress import Progress
from vibrojax.studies.border_chains import Vertex
from vibrojax.studies.border_lines import (
    End,
    Line,
    Plane,
    cell_width,
    end_near,
    line_through,
    meeting,
    nearest_place,
)
from vibrojax.studies.border_propagation import OrbitGrid, OrbitLoss
from vibrojax.studies.curve_run import problem_through

ON_CURVE = 1e-2
"""Largest scaled distance of a vertex from the chords of its curve. Curves of one kind are farther apart."""

MOST_ROUNDS = 3
"""Largest number of times that curves begin at the vertices that lie on none of the curves before."""

NO_EQUATIONS = "located between points of the grid: no equations of an orbit hold along this border"
NO_CURVE = "located between points of the grid: no curve was found that passes here"


class Border(NamedTuple):
    """A piece of a border with a single kind: its points (points, 2), in order.

    `line`: the curve on which it lies, None if it joins vertices of the grid; `span`: its first and last place there.
    """

    kind: str
    points: Plane
    line: Line | None = None
    span: tuple[float, float] = (0.0, 0.0)

    @property
    def note(self) -> str:
        """Say where and why the curve ends, or why there is none."""
        if self.line is not None:
            return self.line.note
        return NO_CURVE if self.kind in CONTINUED else NO_EQUATIONS


class ContinuedBorders:
    """Curves through the vertices of borders in the planes of a grid."""

    def __init__(self, grid: OrbitGrid) -> None:
        self._grid = grid
        self.lines: list[Line] = []
        self._places: dict[OrbitLoss, tuple[Line, float]] = {}
        self._tried: set[OrbitLoss | None] = set()

    def follow(self, chains: Sequence[tuple[int, list[Vertex]]], progress: bool) -> None:
        """Continue curves through the chains of vertices; each chain is given with the number of its plane."""
        for _ in range(MOST_ROUNDS):
            seeds: list[tuple[int, Vertex]] = []
            taken: set[OrbitLoss | None] = set(self._tried)
            runs = [(plane, list(run)) for plane, chain in chains for _, run in groupby(chain, self._label)]
            for plane, run in sorted(runs, key=lambda item: -len(item[1])):
                losses = {vertex.loss for vertex in run}
                if run[0].kind in CONTINUED and not losses & (taken | set(self._places)):
                    seeds.append((plane, run[len(run) // 2]))
                    taken |= losses
            if not seeds:
                break
            new = self._lines(seeds, progress)
            self.lines += new
            for plane, chain in chains:
                for vertex in chain:
                    if vertex.loss is None or vertex.loss in self._places:
                        continue
                    own = (line for line in new if (line.plane, line.kind) == (plane, vertex.kind))
                    places = ((line, *line.place(vertex)) for line in own)
                    found = next(((line, place) for line, place, off in places if off < ON_CURVE), None)
                    if found is not None:
                        self._places[vertex.loss] = found

    def _label(self, vertex: Vertex) -> tuple[str, int]:
        line = None if vertex.loss is None else self._places.get(vertex.loss, (None, 0))[0]
        return vertex.kind, id(line)

    def _lines(self, seeds: list[tuple[int, Vertex]], progress: bool) -> list[Line]:
        """Return the curves through seeds, given with the numbers of their planes."""
        grid = self._grid
        planes, values = [plane for plane, _ in seeds], np.array([[vertex.x, vertex.y] for _, vertex in seeds])
        parameters = {name: x[planes, 0, 0] for name, x in grid.parameters.items()}
        parameters |= dict(zip(grid.names, values.T, strict=True))
        bounds = {name: (float(x.min()), float(x.max())) for name, x in zip(grid.names, grid.values, strict=True)}
        orbits = [(1, vertex.loss.state) for _, vertex in seeds if vertex.loss is not None]
        kinds = np.array([vertex.kind for _, vertex in seeds])
        problem, unknowns = problem_through(grid.scene, bounds, parameters, kinds, orbits)
        with Progress(2 * len(seeds), "ends of curves", progress, pace=False) as bar:
            curves = follow_curves(problem, unknowns, bar.reach)
            bar.reach(2 * len(seeds))
        lines = []
        for (plane, vertex), curve in zip(seeds, curves, strict=False):
            self._tried.add(vertex.loss)
            if sum(len(part.u) for part in curve.parts) > 1:
                lines.append(line_through(problem, curve, plane, vertex))
        return lines

    def cut(self, chain: list[Vertex]) -> list[Border]:
        """Divide a chain into pieces of one kind, on one curve or on none.

        Farther than a cell beyond its last vertex, another orbit may cover a curve.
        """
        runs = [list(run) for _, run in groupby(chain, self._label)]
        joints: list[tuple[End | None, End | None]] = []
        for here, there in pairwise(runs):
            joints.append(self._joint(here[-1], there[0]))
        pieces = []
        for k, run in enumerate(runs):
            first, last = joints[k - 1][1] if k else None, joints[k][0] if k < len(joints) else None
            pieces.append(self._piece(run, first, last))
        return pieces

    def _piece(self, run: list[Vertex], first: End | None, last: End | None) -> Border:
        """Return the border of a run between its ends."""
        known = None if run[0].loss is None else self._places.get(run[0].loss)
        points = [np.array([vertex.x, vertex.y]) for vertex in run]
        if known is None:
            ends = [[] if end is None else [end.point] for end in (first, last)]
            return Border(run[0].kind, np.array([*ends[0], *points, *ends[1]]))
        line = known[0]
        places = [self._places[vertex.loss][1] for vertex in run if vertex.loss is not None]
        for end, position in ((first, 0), (last, len(places) + 1)):
            if end is not None and end.place is not None:
                places.insert(position, end.place)
                points.insert(position, end.point)
        period = len(line.u) - 1
        along = np.unwrap(places, period=period) if line.closed else np.array(places)
        low, high = int(along.argmin()), int(along.argmax())
        inside = np.arange(np.floor(along[low]) + 1, np.ceil(along[high]), dtype=int)
        between = line.values[inside % period if line.closed else inside]
        parts = [points[low][None], between, points[high][None]] if high != low else [points[low][None]]
        return Border(run[0].kind, np.concatenate(parts), line, (float(along[low]), float(along[high])))

    def _joint(self, first: Vertex, second: Vertex) -> tuple[End | None, End | None]:
        """Return the ends of two neighbouring pieces, which have the neighbouring vertices `first` and `second`."""
        here, there = (None if x.loss is None else self._places.get(x.loss) for x in (first, second))
        middle = np.array([first.x + second.x, first.y + second.y]) / 2
        cell = np.array([cell_width(x, value) for x, value in zip(self._grid.values, middle, strict=True)])
        if here is not None and there is not None:
            return meeting(here, there, middle, cell) or (None, None)
        if here is not None:
            own = end_near(here[0], middle, cell) or End(np.array([first.x, first.y]), here[1])
            return own, End(own.point)
        if there is not None:
            own = end_near(there[0], middle, cell) or End(np.array([second.x, second.y]), there[1])
            return End(own.point), own
        return End(middle), End(middle)


def crossings_of(border: Border, which: int, value: float) -> list[np.ndarray]:
    """Return the points at which a continued border passes a value of the parameter `which` (0 or 1)."""
    line = border.line
    if line is None:
        return []
    points = []
    with np.errstate(all="ignore"):
        for part in line.curve.parts:
            for point in crossings(line.problem, part, which, value):
                place, _ = nearest_place(line.u[:, -2:], point.u[0, -2:])
                turns = (0, len(line.u) - 1, 1 - len(line.u)) if line.closed else (0,)
                if any(border.span[0] <= place + turn <= border.span[1] for turn in turns):
                    points.append(line.problem.values(point.family, point.u)[0])
    return points
