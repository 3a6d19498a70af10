"""Continued borders: curves of special points through the located vertices of a region's border.

Each run of vertices of one kind begins a curve in the plane. Vertices that lie on a curve are replaced by the part of
the curve between them, up to the point where the next curve begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.path import Path

from vibrojax.periodic.arclength import CLOSED
from vibrojax.periodic.codim2 import CONTINUED
from vibrojax.periodic.curve_equations import CurveProblem
from vibrojax.periodic.curve_following import Curve, crossings, follow_curves
from vibrojax.periodic.segments import ENDINGS
from vibrojax.progress import Progress
from vibrojax.studies.border_grid import OrbitGrid, OrbitLoss, Vertex
from vibrojax.studies.curves import problem_through

ON_CURVE = 1e-2
"""Largest scaled distance of a vertex from the chords of its curve. Curves of one kind are farther apart."""

MEETS = 2e-3
"""Largest scaled distance in the plane between the end of a curve, or a point of codimension two, and another curve on
which the point lies, too."""

GAP_CELLS = 0.2
"""Width of the open tip of a wedge between two curves, the first of which ends there, in cells of the grid."""

WEDGE_CELLS = 2.0
"""Largest distance of the tip of a wedge between two curves from its last vertices, in cells of the grid."""

MOST_ROUNDS = 3
"""Rounds of new curves; each starts from vertices that no curve covers yet."""

NO_EQUATIONS = "located between points of the grid: no equations of an orbit hold along this border"
NO_CURVE = "located between points of the grid: no curve was found that passes here"

Point = Float[np.ndarray, " 2"]
Plane = Float[np.ndarray, "points 2"]

End = tuple[Point, float | None]
"""The end of a piece of a border: a point, and its place on the curve of the piece, if it has one."""


@dataclass(frozen=True, eq=False)
class Line:
    """A curve through the vertex `seed` of a border of one plane.

    - `u` (points, unknowns): scaled states at the section, and scaled parameters. States are NaN at points with other
      numbers of section crossings.
    - `corners`: indices of the ends and of the points of codimension two.
    - `closed`: whether the curve returns to its first point.
    """

    plane: int
    seed: Vertex
    problem: CurveProblem
    curve: Curve
    u: Float[np.ndarray, "points unknowns"]
    corners: list[int]
    closed: bool

    @classmethod
    def through(cls, problem: CurveProblem, curve: Curve, plane: int, seed: Vertex) -> "Line":
        """Return the line of a curve that begins at a vertex in one plane."""

        def of_one_crossing(u: np.ndarray) -> np.ndarray:
            states = u[:, :-2] if u.shape[1] == problem.rows + 2 else np.full((len(u), problem.rows), np.nan)
            return np.hstack([states, u[:, -2:]])

        u = np.concatenate([of_one_crossing(part.u) for part in curve.parts if len(part.u)])
        closed = ENDINGS[CLOSED] in curve.notes
        corners = [] if closed else [0, len(u) - 1]
        if closed:
            u = np.concatenate([u, u[:1]])
        for mark in curve.marks:
            point = of_one_crossing(mark.orbit.u)
            k = int(nearest_place(u[:, -2:], point[0, -2:])[0]) + 1
            u = np.insert(u, k, point, axis=0)
            corners = [corner + (corner >= k) for corner in corners] + [k]
        return cls(plane, seed, problem, curve, u, corners, closed)

    @property
    def ends(self) -> list[float]:
        """Places of the first and the last point; none of a closed curve."""
        return [] if self.closed else [0.0, len(self.u) - 1.0]

    def near(self, point: Point, cell: Point) -> list[float]:
        """Return the places of the curve's points that are at most `GAP_CELLS` from another point."""
        return [float(k) for k in np.flatnonzero((np.abs(self.values - point) < GAP_CELLS * cell).all(axis=1))]

    @property
    def values(self) -> Plane:
        """The two parameters at each point."""
        return np.asarray(self.u[:, -2:] * self.problem.unit[self.curve.number])

    def distance(self, first: float, second: float) -> float:
        """Return the scaled length in the plane between two places."""
        steps = np.linalg.norm(np.diff(self.u[:, -2:], axis=0), axis=1)
        length = np.concatenate([[0.0], np.cumsum(steps)])
        return float(abs(np.diff(np.interp([first, second], np.arange(len(length)), length))[0]))

    def between(self, first: float, last: float) -> Plane:
        """Return the points of the curve from one place to another, without the places themselves."""
        low, high = sorted((first, last))
        inside = np.arange(np.floor(low) + 1, np.ceil(high), dtype=int)
        values = self.values[inside % (len(self.u) - 1) if self.closed else inside]
        return values if first <= last else values[::-1]

    def at(self, place: float) -> Point:
        """Return the two parameters at a place."""
        turns, values = len(self.u) - 1, self.values
        place = place % turns if self.closed else place
        k = min(int(place), turns - 1)
        return np.asarray(values[k] + (place - k) * (values[k + 1] - values[k]))


class Border(NamedTuple):
    """A piece of a border with a single kind: its points, in order.

    `line`: the curve on which it lies, None if it joins vertices of the grid; `span`: its first and last place there.
    """

    kind: str
    points: Plane
    line: Line | None = None
    span: tuple[float, float] = (0.0, 0.0)

    @property
    def note(self) -> str:
        """Note on where and why the curve ends, or why there is none."""
        if self.line is not None:
            return "; ".join(self.line.curve.notes)
        return NO_CURVE if self.kind in CONTINUED else NO_EQUATIONS


class ContinuedBorders:
    """Curves through the vertices of borders in the planes of a grid."""

    def __init__(self, grid: OrbitGrid) -> None:
        self._grid = grid
        self.lines: list[Line] = []
        self._places: dict[OrbitLoss | None, tuple[Line, float]] = {}
        self._tried: set[OrbitLoss | None] = set()

    def follow(self, chains: Sequence[tuple[int, list[Vertex]]], progress: bool) -> None:
        """Continue curves through the chains of vertices; each chain is given with the number of its plane."""
        for _ in range(MOST_ROUNDS):
            seeds: list[tuple[int, Vertex]] = []
            taken = self._tried | set(self._places)
            runs = [(plane, list(run)) for plane, chain in chains for _, run in groupby(chain, self._label)]
            for plane, run in sorted(runs, key=lambda item: -len(item[1])):
                losses = {vertex.loss for vertex in run}
                if run[0].kind in CONTINUED and not losses & taken:
                    seeds.append((plane, run[len(run) // 2]))
                    taken |= losses
            if not seeds:
                break
            new = self._lines(seeds, progress)
            self.lines += new
            for plane, vertex in ((plane, vertex) for plane, chain in chains for vertex in chain):
                if vertex.loss is None or vertex.loss in self._places:
                    continue
                state, values = vertex.loss.state[None, None], np.array([[vertex.x, vertex.y]])
                for line in (line for line in new if (line.plane, line.seed.kind) == (plane, vertex.kind)):
                    u = line.problem.unknowns(np.array([line.curve.number]), state, values)[0]
                    place, off = nearest_place(line.u, u)
                    if off < ON_CURVE:
                        self._places[vertex.loss] = line, place
                        break

    def _label(self, vertex: Vertex) -> tuple[str, int]:
        return vertex.kind, id(self._places.get(vertex.loss, (None, 0))[0])

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
        self._tried |= {vertex.loss for _, vertex in seeds}
        pairs = [(curve, *seed) for curve, seed in zip(curves, seeds, strict=True)]
        return [Line.through(problem, *each) for each in pairs if sum(len(part.u) for part in each[0].parts) > 1]

    def cut(self, chain: list[Vertex]) -> list[Border]:
        """Divide a chain into pieces of one kind, on one curve or on none.

        Farther than a cell beyond its last vertex, another orbit may cover a curve.
        """
        runs = [list(run) for _, run in groupby(chain, self._label)]
        joints = [self._joint(here[-1], there[0]) for here, there in pairwise(runs)]
        firsts, lasts = [None, *(after for _, after in joints)], [*(before for before, _ in joints), None]
        return [self._piece(run, *ends) for run, *ends in zip(runs, firsts, lasts, strict=True)]

    def _piece(self, run: list[Vertex], first: End | None, last: End | None) -> Border:
        """Return the border of a run between its ends."""
        points = [np.array([vertex.x, vertex.y]) for vertex in run]
        if run[0].loss not in self._places:
            ends = [[] if end is None else [end[0]] for end in (first, last)]
            return Border(run[0].kind, np.array([*ends[0], *points, *ends[1]]))
        line, _ = self._places[run[0].loss]
        places = [self._places[vertex.loss][1] for vertex in run]
        for end, position in ((first, 0), (last, len(places) + 1)):
            if end is not None and end[1] is not None:
                places.insert(position, end[1])
                points.insert(position, end[0])
        along = np.unwrap(places, period=len(line.u) - 1) if line.closed else np.array(places)
        low, high = int(along.argmin()), int(along.argmax())
        between = line.between(along[low], along[high])
        parts = [points[low][None], between, points[high][None]] if high != low else [points[low][None]]
        return Border(run[0].kind, np.concatenate(parts), line, (float(along[low]), float(along[high])))

    def _joint(self, first: Vertex, second: Vertex) -> tuple[End | None, End | None]:
        """Return the ends of two neighbouring pieces, which have the neighbouring vertices `first` and `second`."""
        here, there = self._places.get(first.loss), self._places.get(second.loss)
        middle = np.array([first.x + second.x, first.y + second.y]) / 2
        widths = []  # of the cell: distances of the grid points on both sides of the middle
        for axis, value in zip(self._grid.values, middle, strict=True):
            ordered = np.sort(axis)
            above = int(np.clip(np.searchsorted(ordered, value), 1, len(ordered) - 1))
            widths.append(float(ordered[above] - ordered[above - 1]))
        cell = np.array(widths)
        if here is not None and there is not None:
            return self._meeting(here, there, middle, cell) or (None, None)
        known = here or there
        if known is None:
            return (middle, None), (middle, None)
        (line, place), vertex = known, first if here is not None else second
        own: End = np.array([vertex.x, vertex.y]), place
        off, k = min(((float((np.abs(line.at(k) - middle) / cell).max()), k) for k in line.ends), default=(np.inf, 0.0))
        if off <= 1:
            own = line.values[int(k)], k
        return (own, (own[0], None)) if here is not None else ((own[0], None), own)

    def _meeting(
        self, first: tuple[Line, float], second: tuple[Line, float], middle: Point, cell: Point
    ) -> tuple[End, End] | None:
        """Return the ends of two curves where they meet nearest to two vertices, or where one ends next to the other.

        They meet at most a cell away from the middle of the vertices. A wedge may be longer: its tip is up to
        `WEDGE_CELLS` cells away, if no point of the grid is between the two curves. The tip is open if one curve ends
        within `GAP_CELLS` of the other, which then is followed to that distance.

        **Arguments:** `first`, `second`: the two curves, and the places of the vertices on them.
        """
        (one, first_place), (another, second_place) = first, second
        grid = np.stack(np.meshgrid(*self._grid.values), axis=-1).reshape(-1, 2)

        def nearest(meetings: list[tuple[Point, float, Point, float]], tips: bool = False) -> tuple[End, End] | None:
            """Return the nearest of meetings, or the farthest of tips, given by points and places on both curves."""
            known: list[tuple[float, End, End]] = []
            for p, here, q, there in meetings:
                cells = float((np.abs(p - middle) / cell).max())
                sides = one.between(first_place, here), p[None], q[None], another.between(there, second_place)
                wedge = Path(np.concatenate([one.at(first_place)[None], *sides, another.at(second_place)[None]]))
                is_wedge = cells <= WEDGE_CELLS and not wedge.contains_points(grid).any()
                if is_wedge or (cells <= 1 and not tips):
                    way = one.distance(here, first_place) + another.distance(there, second_place)
                    known.append((way, (p, here), (q, there)))
            return (max if tips else min)(known, key=lambda x: x[0])[1:] if known else None

        meet: list[tuple[Point, float, Point, float]] = []
        for k in one.corners:
            place, off = nearest_place(another.u[:, -2:], one.u[k, -2:])
            meet += [(one.values[k], float(k), one.values[k], place)] * (off < MEETS)
        for k in another.corners:
            place, off = nearest_place(one.u[:, -2:], another.u[k, -2:])
            meet += [(another.values[k], place, another.values[k], float(k))] * (off < MEETS)
        a, b = np.diff(one.values, axis=0)[:, None], np.diff(another.values, axis=0)[None]
        between = another.values[None, :-1] - one.values[:-1, None]
        with np.errstate(all="ignore"):
            area = _cross(a, b)
            s, t = _cross(between, b) / area, _cross(between, a) / area
        crossing = []
        for i, j in np.argwhere((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)).tolist():
            p = one.at(i + s[i, j])
            crossing.append((p, i + float(s[i, j]), p, j + float(t[i, j])))
        tips = [(one.at(k), k, another.at(j), j) for k in one.ends for j in another.near(one.at(k), cell)]
        tips += [(one.at(j), j, another.at(k), k) for k in another.ends for j in one.near(another.at(k), cell)]
        return nearest(meet) or nearest(crossing) or nearest(tips, tips=True)


def crossings_of(border: Border, which: int, value: float) -> list[np.ndarray]:
    """Return the points at which a continued border passes a value of the parameter `which` (0 or 1)."""
    line = border.line
    if line is None:
        return []
    points = []
    with np.errstate(all="ignore"):
        for point in (point for part in line.curve.parts for point in crossings(line.problem, part, which, value)):
            place, _ = nearest_place(line.u[:, -2:], point.u[0, -2:])
            turns = (0, len(line.u) - 1, 1 - len(line.u)) if line.closed else (0,)
            if any(border.span[0] <= place + turn <= border.span[1] for turn in turns):
                points.append(line.problem.values(point.family, point.u)[0])
    return points


def nearest_place(curve: np.ndarray, point: np.ndarray) -> tuple[float, float]:
    """Return the place on a chain of chords that is nearest to a point, as an index, and its distance."""
    begin, chord = curve[:-1], np.diff(curve, axis=0)
    length = np.einsum("ij,ij->i", chord, chord)
    share = np.clip(np.einsum("ij,ij->i", point - begin, chord) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    off = np.linalg.norm(begin + share[:, None] * chord - point, axis=1)
    k = int(np.nan_to_num(off, nan=np.inf).argmin())
    return k + float(share[k]), float(off[k])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
