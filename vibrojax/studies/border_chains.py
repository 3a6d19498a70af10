"""Chains of located vertices around a region of grid points."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from contourpy import FillType, LineType, contour_generator
from jaxtyping import Bool

from vibrojax.studies.border_propagation import OrbitLoss


class Vertex(NamedTuple):
    """Point at which a border crosses a grid edge: coordinates `x` and `y`, and the `kind` of border.

    `loss`: the loss of the orbit there, None at the border of a basin.
    """

    x: float
    y: float
    kind: str
    loss: OrbitLoss | None = None


EndFinder = Callable[[tuple[int, int], tuple[int, int]], Vertex]
"""`ends(inside, outside)`: point of the border between two neighbouring grid points."""

_Crossing = tuple[int, int, int]
"""A grid edge that a border crosses: its axis, and the two indices of its lower end point."""


def around_region(
    inside: Bool[np.ndarray, "xs ys"], x: np.ndarray, y: np.ndarray, ends: EndFinder
) -> tuple[list[list[Vertex]], float]:
    """Return the chains of vertices around a region, and the region's fraction of the area of the grid.

    A closed chain repeats its first vertex at the end. Two parts of the region that meet at a saddle remain separate.
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
