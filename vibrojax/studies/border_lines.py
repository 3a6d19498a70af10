"""Curves of special points as lines in a plane: places on them, and meetings."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.arclength import CLOSED
from vibrojax.periodic.curve_equations import CurveProblem
from vibrojax.periodic.curve_following import Curve
from vibrojax.periodic.segments import ENDINGS
from vibrojax.studies.border_chains import Vertex

MEETS = 2e-3
"""Largest scaled distance in the plane between the end of a curve, or a point of codimension two, and another curve on
which the point lies, too."""

Plane = Float[np.ndarray, "points 2"]


@dataclass(frozen=True, eq=False)
class Line:
    """A curve through a border of one plane.

    - `seed`: the two parameters at which it begins; `note`: its ends; `closed`: whether it returns to its first point.
    - `u` (points, unknowns): scaled states at the section, and scaled parameters. States are NaN at points with other
      numbers of section crossings. `values` (points, 2): the two parameters.
    - `corners`: indices of the ends and of the points of codimension two.
    """

    plane: int
    kind: str
    seed: tuple[float, float]
    note: str
    closed: bool
    u: Float[np.ndarray, "points unknowns"]
    values: Plane
    corners: list[int]
    problem: CurveProblem
    curve: Curve

    def place(self, vertex: Vertex) -> tuple[float, float]:
        """Return the place of a vertex on the curve, as an index, and its scaled distance."""
        assert vertex.loss is not None
        number, values = np.array([self.curve.number]), np.array([[vertex.x, vertex.y]])
        return nearest_place(self.u, self.problem.unknowns(number, vertex.loss.state[None, None], values)[0])

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


class End(NamedTuple):
    """The end of a piece: a point, and its place on the curve of the piece."""

    point: Float[np.ndarray, " 2"]
    place: float | None = None


Ending = tuple[Line, float]
"""The end of a run of vertices: its curve, and the place of its last vertex there."""


def line_through(problem: CurveProblem, curve: Curve, plane: int, vertex: Vertex) -> Line:
    """Return the line of a curve that begins at a vertex in one plane."""
    size = problem.rows + 2
    parts = [part for part in curve.parts if len(part.u)]
    u = np.concatenate([_with_width(part.u, size) for part in parts])
    closed = ENDINGS[CLOSED] in curve.notes
    corners = [] if closed else [0, len(u) - 1]
    if closed:
        u = np.concatenate([u, u[:1]])
    for mark in curve.marks:
        point = _with_width(mark.orbit.u, size)
        place, _ = nearest_place(u[:, -2:], point[0, -2:])
        k = int(place) + 1
        u = np.insert(u, k, point, axis=0)
        corners = [corner + (corner >= k) for corner in corners] + [k]
    values = u[:, -2:] * problem.unit[curve.number]
    note, seed = "; ".join(curve.notes), (vertex.x, vertex.y)
    return Line(plane, vertex.kind, seed, note, closed, u, values, corners, problem, curve)


def _with_width(u: np.ndarray, size: int) -> np.ndarray:
    """Return unknowns of one section crossing; states are NaN if there are other numbers of crossings."""
    if u.shape[1] == size:
        return u
    short = np.full((len(u), size), np.nan)
    short[:, -2:] = u[:, -2:]
    return short


def nearest_place(curve: np.ndarray, point: np.ndarray) -> tuple[float, float]:
    """Return the place on a chain of chords that is nearest to a point, as an index, and its distance."""
    begin, chord = curve[:-1], np.diff(curve, axis=0)
    length = np.einsum("ij,ij->i", chord, chord)
    share = np.clip(np.einsum("ij,ij->i", point - begin, chord) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    off = np.linalg.norm(begin + share[:, None] * chord - point, axis=1)
    k = int(np.nan_to_num(off, nan=np.inf).argmin())
    return k + float(share[k]), float(off[k])


def cell_width(values: np.ndarray, value: float) -> float:
    """Return the distance of the grid points on both sides of a value."""
    ordered = np.sort(values)
    k = int(np.clip(np.searchsorted(ordered, value), 1, len(ordered) - 1))
    return float(ordered[k] - ordered[k - 1])


def end_near(line: Line, middle: np.ndarray, cell: np.ndarray) -> End | None:
    """Return the end of a curve that is nearest to a point, and at most one cell away from it."""
    ends = [] if line.closed else [0, len(line.u) - 1]
    off = {k: float((np.abs(line.values[k] - middle) / cell).max()) for k in ends}
    nearest = min(off, key=off.__getitem__, default=None)
    return End(line.values[nearest], nearest) if nearest is not None and off[nearest] <= 1 else None


def meeting(first: Ending, second: Ending, middle: np.ndarray, cell: np.ndarray) -> tuple[End, End] | None:
    """Return the ends of two curves where they meet nearest to two vertices, at most a cell away from their middle."""
    (one, first_place), (another, second_place) = first, second
    meetings: list[tuple[float, End, End]] = []

    def enter(point: np.ndarray, here: float, there: float) -> None:
        if (np.abs(point - middle) <= cell).all():
            off = one.distance(here, first_place) + another.distance(there, second_place)
            meetings.append((off, End(point, here), End(point, there)))

    for line, other in ((one, another), (another, one)):
        for k in line.corners:
            place, off = nearest_place(other.u[:, -2:], line.u[k, -2:])
            if off < MEETS:
                enter(line.values[k], *((float(k), place) if line is one else (place, float(k))))
    if not meetings:
        p, q = one.values, another.values
        a, b = np.diff(p, axis=0)[:, None], np.diff(q, axis=0)[None]
        between = q[None, :-1] - p[:-1, None]
        with np.errstate(all="ignore"):
            area = _cross(a, b)
            s, t = _cross(between, b) / area, _cross(between, a) / area
        for i, j in np.argwhere((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)).tolist():
            enter(one.at(i + s[i, j]), i + float(s[i, j]), j + float(t[i, j]))
    return min(meetings, key=lambda item: item[0])[1:] if meetings else None


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
