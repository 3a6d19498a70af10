"""Chains of located vertices around a region of grid points, by marching squares."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from vibrojax.analyses.borders.propagation import OrbitLoss


class Vertex(NamedTuple):
    """Point at which a border crosses a grid edge: coordinates `x` and `y`, and the `kind` of border.

    `loss`: the loss of the orbit there, None at the border of a basin.
    """

    x: float
    y: float
    kind: str
    loss: OrbitLoss | None = None


Crossing = tuple[int, int, int]
"""A grid edge that a border crosses: its axis, and the two indices of its lower end point."""

EndFinder = Callable[[tuple[int, int], tuple[int, int]], Vertex]
"""`ends(inside, outside)`: point of the border between two neighbouring grid points."""

_Ring = list[tuple[bool, tuple[float, float], Crossing | None]]
"""Corners and crossings in order around a grid square: (is in the region, position, crossing or None)."""


def around_region(
    inside: Bool[np.ndarray, "xs ys"], x: np.ndarray, y: np.ndarray, ends: EndFinder
) -> tuple[list[list[Vertex]], float]:
    """Return the chains of vertices around a region, and the region's fraction of the area of the grid."""
    vertices: dict[Crossing, Vertex] = {}
    for axis in (0, 1):
        lower, upper = (inside[:-1], inside[1:]) if axis == 0 else (inside[:, :-1], inside[:, 1:])
        for i, j in np.argwhere(lower != upper).tolist():
            here, there = (i, j), (i + 1, j) if axis == 0 else (i, j + 1)
            vertices[axis, i, j] = ends(here, there) if inside[here] else ends(there, here)
    links: dict[Crossing, list[Crossing]] = {crossing: [] for crossing in vertices}
    area = 0.0
    for i in range(len(x) - 1):
        for j in range(len(y) - 1):
            corners = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
            sides = ((0, i, j), (1, i + 1, j), (0, i, j + 1), (1, i, j))
            ring: _Ring = []
            for corner, side in zip(corners, sides, strict=True):
                ring.append((bool(inside[corner]), (float(x[corner[0]]), float(y[corner[1]])), None))
                if side in vertices:
                    ring.append((True, (vertices[side].x, vertices[side].y), side))
            for polygon, (first, second) in _polygons(ring):
                px, py = np.array(polygon).T
                area += float(abs(np.dot(px, np.roll(py, -1)) - np.dot(py, np.roll(px, -1))) / 2)
                if first is not None and second is not None:
                    links[first].append(second)
                    links[second].append(first)
    whole = (x[-1] - x[0]) * (y[-1] - y[0])
    chains = [[vertices[crossing] for crossing in chain] for chain in _chains(links)]
    return chains, area / whole if whole else 0.0


def _polygons(ring: _Ring) -> list[tuple[list[tuple[float, float]], tuple[Crossing | None, Crossing | None]]]:
    """Return the parts of a grid square that are in the region, each with the two crossings that it joins.

    The crossings are None for a square that is completely in the region. Each part is a sequence of corners between two
    crossings, so that the two parts at a saddle remain separate.
    """
    if all(crossing is None for _, _, crossing in ring):
        return [([point for _, point, _ in ring], (None, None))] if ring[0][0] else []
    following = [*ring[1:], ring[0]]
    enters = (now[2] is not None and after[0] and after[2] is None for now, after in zip(ring, following, strict=True))
    first = list(enters).index(True)
    polygons: list[tuple[list[tuple[float, float]], tuple[Crossing | None, Crossing | None]]] = []
    polygon: list[tuple[float, float]] = []
    begin: Crossing | None = None
    for within, point, crossing in ring[first:] + ring[:first]:
        if crossing is None:
            if within and begin is not None:
                polygon.append(point)
        elif begin is None:
            polygon, begin = [point], crossing
        else:
            polygons.append(([*polygon, point], (begin, crossing)))
            begin = None
    return polygons


def _chains(links: dict[Crossing, list[Crossing]]) -> list[list[Crossing]]:
    """Return chains of joined crossings, in order; a closed chain repeats its first crossing at the end."""
    remaining = {crossing: list(others) for crossing, others in links.items()}
    chains = []
    for begin in sorted(remaining, key=lambda crossing: (len(remaining[crossing]), crossing)):
        while remaining[begin]:
            chain = [begin]
            while remaining[chain[-1]]:
                following = remaining[chain[-1]].pop()
                remaining[following].remove(chain[-1])
                chain.append(following)
            chains.append(chain)
        if not links[begin]:
            chains.append([begin])
    return chains
