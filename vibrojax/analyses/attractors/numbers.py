"""Numbers of attractors over a grid: motions that are linked have the same, no two of one point do."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from vibrojax.analyses.attractors.neighbours import Link


def numbered(
    cells: Sequence[int], lanes: Sequence[int], links: Sequence[Link], order: Sequence[tuple[float, ...]]
) -> Int[np.ndarray, " motions"]:
    """The number of each motion's attractor: from 0, that which most lanes end in.

    Links are taken from the nearest to the farthest, and left out where they would give two motions of one point the
    same number: around a cusp two attractors go over into each other. So numbers do not depend on the way in which the
    grid is gone along.

    **Arguments:** of each motion, `cells`: its point; `lanes`: how many end in it; `order`: by what attractors of as
    many lanes are ordered, the least of any of their motions first.
    """
    parent = list(range(len(cells)))
    points = [{cell} for cell in cells]

    def root(number: int) -> int:
        while parent[number] != number:
            parent[number] = parent[parent[number]]
            number = parent[number]
        return number

    for link in sorted(links, key=lambda link: (link.distance, sorted((order[link.one], order[link.other])))):
        one, other = root(link.one), root(link.other)
        if one != other and points[one].isdisjoint(points[other]):
            if len(points[one]) < len(points[other]):
                one, other = other, one
            parent[other] = one
            points[one] |= points[other]
    roots = [root(number) for number in range(len(cells))]
    total: dict[int, int] = {}
    first: dict[int, tuple[float, ...]] = {}
    for one, count, key in zip(roots, lanes, order, strict=True):
        total[one] = total.get(one, 0) + count
        first[one] = min(first.get(one, key), key)
    number = {one: place for place, one in enumerate(sorted(first, key=lambda one: (-total[one], first[one])))}
    return np.array([number[one] for one in roots], int)
