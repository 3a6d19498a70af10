"""In which order chunks are computed: the dearest first, so that no worker is at its last while others idle."""

from collections.abc import Collection

import numpy as np

from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.costs import lane_steps

SAMPLES = 3
"""Lanes of a chunk that are looked at for how many steps they take, from its first to its last."""

AT_ONCE = 8192
"""Chunks whose lanes are looked at together: memory does not grow with the sweep."""


def by_cost(chunks: Chunks, indices: Collection[int]) -> list[int]:
    """The `indices` of chunks, those first that take most steps; equal ones in their own order."""
    wanted = np.array(sorted(indices), int)
    if len(wanted) <= 2:
        return wanted.tolist()
    costs = [_costs(chunks, some) for some in np.split(wanted, range(AT_ONCE, len(wanted), AT_ONCE))]
    return wanted[np.argsort(-np.concatenate(costs), kind="stable")].tolist()


def _costs(chunks: Chunks, indices: np.ndarray) -> np.ndarray:
    """Steps that each chunk takes, by some of its lanes."""
    firsts, ends = indices * chunks.size, np.minimum((indices + 1) * chunks.size, chunks.sweep.lanes)
    numbers = np.linspace(firsts, ends - 1, SAMPLES).astype(int)
    return lane_steps(chunks, numbers.ravel()).reshape(numbers.shape).mean(axis=0) * (ends - firsts)
