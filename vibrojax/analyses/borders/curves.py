"""Curves around a region of a plane's points, from the places where it ends between neighbours (marching squares)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


class Vertex(NamedTuple):
    """Where a region ends on an edge: `x`, `y`, and the `kind` of border."""

    x: float
    y: float
    kind: str


Crossing = tuple[int, int, int]
"""An edge between two neighbours: the axis that it is along, and the lower of the points."""

Ends = Callable[[tuple[int, int], tuple[int, int]], Vertex]
"""`ends(inside, outside)`: where the region ends between two neighbouring points."""


class Border(NamedTuple):
    """A piece of a border of one kind: its vertices (vertices, 2), in order."""

    kind: str
    points: Float[np.ndarray, "vertices 2"]


def around_region(
    inside: Bool[np.ndarray, "xs ys"], x: np.ndarray, y: np.ndarray, ends: Ends
) -> tuple[list[Border], float]:
    """The borders of a region, and its share of the plane between the outermost points."""
    vertices: dict[Crossing, Vertex] = {}
    for axis in (0, 1):
        one, other = (inside[:-1], inside[1:]) if axis == 0 else (inside[:, :-1], inside[:, 1:])
        for i, j in np.argwhere(one != other).tolist():
            here, there = (i, j), (i + 1, j) if axis == 0 else (i, j + 1)
            vertices[axis, i, j] = ends(here, there) if inside[here] else ends(there, here)
    links: dict[Crossing, list[Crossing]] = {crossing: [] for crossing in vertices}
    area = 0.0
    for i in range(len(x) - 1):
        for j in range(len(y) - 1):
            for polygon, pairs in _squares(inside, x, y, vertices, i, j):
                area += _area(polygon)
                for one_end, other_end in pairs:
                    links[one_end].append(other_end)
                    links[other_end].append(one_end)
    whole = (x[-1] - x[0]) * (y[-1] - y[0])
    borders = [piece for chain in _chains(links) for piece in _pieces([vertices[one] for one in chain])]
    return borders, area / whole if whole else 0.0


def _squares(
    inside: Bool[np.ndarray, "xs ys"],
    x: np.ndarray,
    y: np.ndarray,
    vertices: dict[Crossing, Vertex],
    i: int,
    j: int,
) -> list[tuple[list[tuple[float, float]], list[tuple[Crossing, Crossing]]]]:
    """The parts of a square that are inside, as polygons, and which crossings each joins."""
    corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
    sides: list[Crossing] = [(0, i, j), (1, i + 1, j), (0, i, j + 1), (1, i, j)]
    ring: list[tuple[bool, tuple[float, float], Crossing | None]] = []
    for corner, crossing in zip(corners, sides, strict=True):
        ring.append((bool(inside[corner]), (float(x[corner[0]]), float(y[corner[1]])), None))
        if crossing in vertices:
            ring.append((True, (vertices[crossing].x, vertices[crossing].y), crossing))
    crossings = [side for _, _, side in ring if side is not None]
    if not crossings:
        return [([point for within, point, _ in ring if within], [])] if ring[0][0] else []
    # Each run of corners inside, from the crossing before it to the one behind it; two at a saddle are kept apart.
    first = next(k for k, (within, _, side) in enumerate(ring) if side is not None and _is_in(ring, k + 1))
    ring = ring[first:] + ring[:first]
    found = []
    polygon: list[tuple[float, float]] = []
    begun: list[Crossing] = []
    for within, point, side in ring:
        if side is not None:
            polygon.append(point)
            begun.append(side)
            if len(begun) == 2:
                found.append((polygon, [(begun[0], begun[1])]))
                polygon, begun = [], []
        elif within and begun:
            polygon.append(point)
    return found


def _is_in(ring: list[tuple[bool, tuple[float, float], Crossing | None]], k: int) -> bool:
    within, _, side = ring[k % len(ring)]
    return within and side is None


def _area(polygon: list[tuple[float, float]]) -> float:
    x, y = np.array(polygon).T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def _chains(links: dict[Crossing, list[Crossing]]) -> list[list[Crossing]]:
    """The crossings in the order in which they are joined; of closed chains the first is there again at the end."""
    left = {crossing: list(others) for crossing, others in links.items()}
    chains = []
    for begin in sorted(left, key=lambda crossing: (len(left[crossing]), crossing)):
        while left[begin]:
            chain = [begin]
            while left[chain[-1]]:
                following = left[chain[-1]].pop()
                left[following].remove(chain[-1])
                chain.append(following)
            chains.append(chain)
        if not links[begin]:
            chains.append([begin])
    return chains


def _pieces(chain: list[Vertex]) -> list[Border]:
    """A chain cut where its kind changes, half-way between the two vertices."""
    pieces: list[Border] = []
    points: list[tuple[float, float]] = []
    for here, following in zip(chain, [*chain[1:], None], strict=True):
        points.append((here.x, here.y))
        if following is None or following.kind != here.kind:
            if following is not None:
                middle = ((here.x + following.x) / 2, (here.y + following.y) / 2)
                points.append(middle)
            pieces.append(Border(here.kind, np.array(points)))
            points = [middle] if following is not None else []
    return pieces
