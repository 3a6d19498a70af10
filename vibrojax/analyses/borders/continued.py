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

from vibrojax.analyses.borders.chains import Vertex
from vibrojax.analyses.borders.propagation import OrbitGrid, OrbitLoss
from vibrojax.analyses.continuation.arclength import CLOSED
from vibrojax.analyses.continuation.problem import Flags, spectral_radius
from vibrojax.analyses.continuation.segments import ENDINGS
from vibrojax.analyses.curves.extended import CurveProblem
from vibrojax.analyses.curves.following import Curve, crossings, follow_curves
from vibrojax.analyses.curves.run import problem_through
from vibrojax.analyses.curves.spec import CONTINUED
from vibrojax.progress import Progress

ON_CURVE = 1e-2
"""Largest scaled distance of a vertex from the chords of its curve. Curves of one kind are farther apart."""

MEETS = 2e-3
"""Largest scaled distance in the plane between the end of a curve, or a point of codimension two, and another curve on
which the point lies, too."""

MOST_ROUNDS = 3
"""Largest number of times that curves begin at the vertices that lie on none of the curves before."""

CRITICAL = 1e-5
"""Largest distance beyond the unit circle of the multipliers at a border of stable orbits."""

NOT_CONTINUED = "located between points of the grid: no equations of an orbit hold along this border"

Plane = Float[np.ndarray, "points 2"]


@dataclass(frozen=True, eq=False)
class Line:
    """A curve through a border of one plane.

    - `seed`: the two parameters at which it begins; `note`: its ends; `closed`: whether it returns to its first point.
    - `u` (points, unknowns): scaled states at the section, and scaled parameters. States are NaN at points with other
      numbers of section crossings. `values` (points, 2): the two parameters.
    - `corners`: indices of the ends and of the points of codimension two; `bounds` (points,): mask of the points at
      which no multiplier is beyond the unit circle.
    """

    plane: int
    kind: str
    seed: tuple[float, float]
    note: str
    closed: bool
    u: Float[np.ndarray, "points unknowns"]
    values: Plane
    corners: list[int]
    bounds: Flags
    problem: CurveProblem
    curve: Curve

    def place(self, vertex: Vertex) -> tuple[float, float]:
        """Return the place of a vertex on the curve, as an index, and its scaled distance."""
        assert vertex.loss is not None
        number, values = np.array([self.curve.number]), np.array([[vertex.x, vertex.y]])
        return _nearest(self.u, self.problem.point(number, vertex.loss.state[None, None], values)[0])

    def stop(self, place: float, way: int) -> int:
        """Return the last index in one direction (-1 or 1) up to which the curve bounds stable orbits."""
        k = int(np.floor(place) if way < 0 else np.ceil(place))
        while 0 <= k + way < len(self.u) and self.bounds[k + way]:
            k += way
        return k

    def distance(self, first: float, second: float) -> float:
        """Return the scaled length in the plane between two places."""
        steps = np.linalg.norm(np.diff(self.u[:, -2:], axis=0), axis=1)
        length = np.concatenate([[0.0], np.cumsum(steps)])
        return float(abs(np.diff(np.interp([first, second], np.arange(len(length)), length))[0]))

    def at(self, place: float) -> Float[np.ndarray, " 2"]:
        """Return the two parameters at a place."""
        turns = len(self.u) - 1
        place = place % turns if self.closed else place
        k = min(int(place), turns - 1)
        return np.asarray(self.values[k] + (place - k) * (self.values[k + 1] - self.values[k]))


class Border(NamedTuple):
    """A piece of a border with a single kind: its points (points, 2), in order.

    `line`: the curve on which it lies, None if it joins vertices of the grid; `span`: its first and last place there.
    """

    kind: str
    points: Plane
    line: Line | None = None
    span: tuple[float, float] = (0.0, 0.0)


class ContinuedBorders:
    """Curves through the vertices of borders in the planes of a grid."""

    def __init__(self, grid: OrbitGrid) -> None:
        self._grid = grid
        self.lines: list[Line] = []
        self._places: dict[OrbitLoss, tuple[Line, float]] = {}
        self._notes: dict[OrbitLoss, str] = {}

    def follow(self, chains: Sequence[tuple[int, list[Vertex]]], progress: bool) -> None:
        """Continue curves through the chains of vertices; each chain is given with the number of its plane."""
        for _ in range(MOST_ROUNDS):
            seeds: list[tuple[int, Vertex]] = []
            taken: set[OrbitLoss | None] = set(self._notes)
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
        """Return the curves through seeds, given with the numbers of their planes; note why a seed has none."""
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
            assert vertex.loss is not None
            self._notes[vertex.loss] = "; ".join(curve.notes)
            if sum(len(part.u) for part in curve.parts) > 1:
                lines.append(_line(problem, curve, plane, vertex))
        return lines

    def cut(self, chain: list[Vertex], extend: bool) -> list[Border]:
        """Divide a chain into pieces of one kind, on one curve or on none.

        `extend`: whether pieces follow their curves beyond a cell, as long as these bound stable orbits.
        """
        runs = [list(run) for _, run in groupby(chain, self._label)]
        joints: list[tuple[_End | None, _End | None]] = []
        for here, there in pairwise(runs):
            before = joints[-1][1] if joints else None
            joints.append(
                self._joint(self._ending(here, before), self._ending(there[::-1]), here[-1], there[0], extend)
            )
        pieces = []
        for k, run in enumerate(runs):
            first, last = joints[k - 1][1] if k else None, joints[k][0] if k < len(joints) else None
            ways = (extend and k > 0 and first is None, extend and k < len(joints) and last is None)
            pieces.append(self._piece(run, first, last, ways))
        return pieces

    def _ending(self, run: list[Vertex], before: "_End | None" = None) -> "_Ending | None":
        """Return the ending of a run at its last vertex, None if it is on no curve; `before`: its end there."""
        known = [self._places[vertex.loss] for vertex in run[-2:] if vertex.loss in self._places]
        if not known:
            return None
        line, place = known[-1]
        other = before.place if len(run) == 1 and before is not None and before.place is not None else known[0][1]
        return _Ending(line, place, int(np.sign(place - other)))

    def _piece(self, run: list[Vertex], first: "_End | None", last: "_End | None", ways: tuple[bool, bool]) -> Border:
        """Return the border of a run between its ends; `ways`: whether to follow its curve at the missing ends."""
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
        if any(ways) and not line.closed and line.kind != "stick":
            way = -1 if places[-1] < places[0] else 1
            for wanted, sign, position in zip(ways, (-way, way), (0, len(places) + 1), strict=True):
                if wanted:
                    stop = line.stop(places[0 if position == 0 else -1], sign)
                    places.insert(position, stop)
                    points.insert(position, line.values[stop])
        period = len(line.u) - 1
        along = np.unwrap(places, period=period) if line.closed else np.array(places)
        low, high = int(along.argmin()), int(along.argmax())
        inside = np.arange(np.floor(along[low]) + 1, np.ceil(along[high]), dtype=int)
        between = line.values[inside % period if line.closed else inside]
        parts = [points[low][None], between, points[high][None]] if high != low else [points[low][None]]
        return Border(run[0].kind, np.concatenate(parts), line, (float(along[low]), float(along[high])))

    def _joint(
        self, here: "_Ending | None", there: "_Ending | None", first: Vertex, second: Vertex, extend: bool
    ) -> "tuple[_End | None, _End | None]":
        """Return the ends of two neighbouring pieces, which have the neighbouring vertices `first` and `second`."""
        middle = np.array([first.x + second.x, first.y + second.y]) / 2
        cell = np.array([_width(x, value) for x, value in zip(self._grid.values, middle, strict=True)])
        if here is not None and there is not None:
            return _meeting(here, there, None if extend else (middle, cell)) or (None, None)
        if here is not None:
            own = _corner_near(here.line, middle, cell) or _End(np.array([first.x, first.y]), here.place)
            return own, _End(own.point)
        if there is not None:
            own = _corner_near(there.line, middle, cell) or _End(np.array([second.x, second.y]), there.place)
            return _End(own.point), own
        return _End(middle), _End(middle)


class _End(NamedTuple):
    """The end of a piece: a point, and its place on the curve of the piece."""

    point: Float[np.ndarray, " 2"]
    place: float | None = None


class _Ending(NamedTuple):
    """The end of a run of vertices: its curve, the place of its last vertex, and the direction (-1, 0 or 1) there."""

    line: Line
    place: float
    way: int

    def span(self) -> tuple[float, float]:
        """Return the places to which the piece may be extended."""
        low, high = (self.line.stop(self.place, way) if self.way != -way else self.place for way in (-1, 1))
        return low, high


def _line(problem: CurveProblem, curve: Curve, plane: int, vertex: Vertex) -> Line:
    size = problem.rows + 2
    parts = [part for part in curve.parts if len(part.u)]
    u = np.concatenate([_with_width(part.u, size) for part in parts])
    # At a stick, rounding errors decide on which side the multipliers are.
    bounds = np.concatenate(
        [(spectral_radius(part.product) < 1 + CRITICAL) | (vertex.kind == "stick") for part in parts]
    )
    closed = ENDINGS[CLOSED] in curve.notes
    corners = [] if closed else [0, len(u) - 1]
    if closed:
        u, bounds = np.concatenate([u, u[:1]]), np.append(bounds, bounds[0])
    for mark in curve.marks:
        point = _with_width(mark.point.u, size)
        place, _ = _nearest(u[:, -2:], point[0, -2:])
        k = int(place) + 1
        u, bounds = (
            np.insert(u, k, point, axis=0),
            np.insert(bounds, k, bounds[k - 1] | bounds[min(k, len(bounds) - 1)]),
        )
        corners = [corner + (corner >= k) for corner in corners] + [k]
    values = u[:, -2:] * [problem.other_unit[curve.number], problem.unit[curve.number]]
    note, seed = "; ".join(curve.notes), (vertex.x, vertex.y)
    return Line(plane, vertex.kind, seed, note, closed, u, values, corners, bounds, problem, curve)


def _with_width(u: np.ndarray, size: int) -> np.ndarray:
    """Return unknowns of one section crossing; states are NaN if there are other numbers of crossings."""
    if u.shape[1] == size:
        return u
    short = np.full((len(u), size), np.nan)
    short[:, -2:] = u[:, -2:]
    return short


def _nearest(curve: np.ndarray, point: np.ndarray) -> tuple[float, float]:
    """Return the place on a chain of chords that is nearest to a point, as an index, and its distance."""
    begin, chord = curve[:-1], np.diff(curve, axis=0)
    length = np.einsum("ij,ij->i", chord, chord)
    share = np.clip(np.einsum("ij,ij->i", point - begin, chord) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    off = np.linalg.norm(begin + share[:, None] * chord - point, axis=1)
    k = int(np.nan_to_num(off, nan=np.inf).argmin())
    return k + float(share[k]), float(off[k])


def _width(values: np.ndarray, value: float) -> float:
    """Return the distance of the grid points on both sides of a value."""
    ordered = np.sort(values)
    k = int(np.clip(np.searchsorted(ordered, value), 1, len(ordered) - 1))
    return float(ordered[k] - ordered[k - 1])


def _corner_near(line: Line, middle: np.ndarray, cell: np.ndarray) -> _End | None:
    """Return the end of a curve that is nearest to a point, and at most one cell away from it."""
    ends = [] if line.closed else [0, len(line.u) - 1]
    off = {k: float((np.abs(line.values[k] - middle) / cell).max()) for k in ends}
    nearest = min(off, key=off.__getitem__, default=None)
    return _End(line.values[nearest], nearest) if nearest is not None and off[nearest] <= 1 else None


def _meeting(first: _Ending, second: _Ending, near: tuple[np.ndarray, np.ndarray] | None) -> tuple[_End, _End] | None:
    """Return the ends of two curves where they meet first, beyond the places of two vertices.

    `near`: a point, and the largest distances from it along both axes.
    """
    found: list[tuple[float, _End, _End]] = []
    (low, high), (bottom, top) = first.span(), second.span()

    def enter(point: np.ndarray, here: float, there: float) -> None:
        inside = low <= here <= high and bottom <= there <= top
        if near is not None:
            inside = bool((np.abs(point - near[0]) <= near[1]).all())
        if inside:
            off = first.line.distance(here, first.place) + second.line.distance(there, second.place)
            found.append((off, _End(point, here), _End(point, there)))

    for line, other in ((first.line, second.line), (second.line, first.line)):
        for k in line.corners:
            place, off = _nearest(other.u[:, -2:], line.u[k, -2:])
            if off < MEETS:
                enter(line.values[k], *((k, place) if line is first.line else (place, k)))
    if not found:
        p, q = first.line.values, second.line.values
        a, b = np.diff(p, axis=0)[:, None], np.diff(q, axis=0)[None]
        between = q[None, :-1] - p[:-1, None]
        with np.errstate(all="ignore"):
            area = _cross(a, b)
            s, t = _cross(between, b) / area, _cross(between, a) / area
        for i, j in np.argwhere((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)).tolist():
            enter(first.line.at(i + s[i, j]), i + float(s[i, j]), j + float(t[i, j]))
    return min(found, key=lambda item: item[0])[1:] if found else None


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def crossings_of(border: Border, which: int, value: float) -> list[np.ndarray]:
    """Return the points at which a continued border passes a value of the parameter `which` (0 or 1)."""
    line = border.line
    if line is None:
        return []
    points = []
    with np.errstate(all="ignore"):
        for part in line.curve.parts:
            for point in crossings(line.problem, part, which, value):
                place, _ = _nearest(line.u[:, -2:], point.u[0, -2:])
                turns = (0, len(line.u) - 1, 1 - len(line.u)) if line.closed else (0,)
                if any(border.span[0] <= place + turn <= border.span[1] for turn in turns):
                    points.append(line.problem.values(point.family, point.u)[0])
    return points
