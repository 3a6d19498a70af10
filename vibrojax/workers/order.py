"""In which order chunks are computed: the dearest first, so that no worker is at its last while others idle."""

from collections.abc import Collection

import numpy as np

from vibrojax.engine.chunks import Chunks
from vibrojax.engine.costs import lane_steps

SAMPLES = 3
"""Lanes of a chunk that are looked at for how many steps they take, from its first to its last."""

MOST_LOOKED_AT = 20_000
"""Of more chunks each is so small a part of the whole that their order saves nothing."""


def by_cost(chunks: Chunks, indices: Collection[int]) -> list[int]:
    """The `indices` of chunks, those first that take most steps; equal ones in their own order."""
    wanted = sorted(indices)
    if not 2 < len(wanted) <= MOST_LOOKED_AT:
        return wanted
    places = {index: _places(chunks, index) for index in wanted}
    cost = {index: -float(np.mean([lane_steps(chunks, at, at + 1).mean() for at in places[index]])) for index in wanted}
    return sorted(wanted, key=lambda index: (cost[index], index))


def _places(chunks: Chunks, index: int) -> list[int]:
    first, end = chunks.lanes(index)
    return np.linspace(first, end - 1, min(SAMPLES, end - first)).astype(int).tolist()
