"""Which variables of a dataset are packed, by HDF5's shuffle and zlib, which every reader has; and what that leaves."""

import zlib
from collections import Counter
from collections.abc import Mapping

import numpy as np

LEVEL = 1
"""Of zlib: higher ones take several times as long for a hundredth less of measured numbers."""

UP_TO = 64e6
"""Bytes of a dataset up to which all of its variables are packed; of a larger one those that it makes half as large.

A core packs 50 to 100 MB/s of measured numbers, and leaves four fifths of them; a disk takes several hundred. Flags,
counts and what most lanes do not have are packed to a fifth and less, as fast as a disk."""

HALF = 0.5


class Sizes:
    """What the variables of some lanes of a sweep take, plain and packed; `lanes`: how many these are."""

    def __init__(self) -> None:
        self.lanes = 0
        self._plain: Counter[str] = Counter()
        self._packed: Counter[str] = Counter()

    def add(self, variables: Mapping[str, np.ndarray]) -> None:
        """Look at some lanes more, whose variables are (lanes,) or (lanes, rows)."""
        self.lanes += max((len(x) for x in variables.values()), default=0)
        for name, x in variables.items():
            self._plain[name] += x.nbytes
            self._packed[name] += len(zlib.compress(_shuffled(x), LEVEL))

    @property
    def lane_bytes(self) -> float:
        """Bytes of a lane before any is packed."""
        return self._plain.total() / max(self.lanes, 1)

    def plain(self, lanes: int) -> frozenset[str]:
        """The names of the variables that are not packed in a dataset of so many lanes."""
        if self.lane_bytes * lanes <= UP_TO:
            return frozenset()
        return frozenset(name for name, size in self._plain.items() if self._packed[name] > HALF * size)

    def left(self, lanes: int) -> float:
        """What is left of the bytes of such a dataset, a part of them."""
        plain = self.plain(lanes)
        left = sum(size if name in plain else self._packed[name] for name, size in self._plain.items())
        return left / max(self._plain.total(), 1)


def _shuffled(x: np.ndarray) -> bytes:
    """The bytes of numbers as HDF5 has them before it packs them: all first ones, all second ones, ..."""
    return x.reshape(-1).view(np.uint8).reshape(-1, x.dtype.itemsize).T.tobytes()
