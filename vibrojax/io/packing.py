"""The choice of the variables to compress, by HDF5's shuffle and zlib, which every reader has."""

import zlib
from collections import Counter
from collections.abc import Mapping

import numpy as np

LEVEL = 1
"""Level of zlib: higher ones take several times as long and save a hundredth more of measured numbers."""

UP_TO = 64e6
"""Bytes of a dataset up to which all variables are compressed; of a larger one those that halve.

One core compresses 50 to 100 MB/s of measured numbers, to four fifths; a disk takes several hundred. Flags, counts and
variables that most lanes lack shrink to a fifth or less, as fast as a disk."""

HALF = 0.5
"""Largest compressed share of a variable that is compressed in a large dataset."""


class Sizes:
    """The plain and compressed sizes of the variables of some lanes of a sweep; `lanes` counts them."""

    def __init__(self) -> None:
        self.lanes = 0
        self._plain: Counter[str] = Counter()
        self._packed: Counter[str] = Counter()

    def add(self, variables: Mapping[str, np.ndarray]) -> None:
        """Add lanes, whose variables are (lanes,) or (lanes, rows)."""
        self.lanes += max((len(x) for x in variables.values()), default=0)
        for name, x in variables.items():
            # HDF5's shuffle: the first bytes of all numbers, then all second bytes, ...
            shuffled = x.reshape(-1).view(np.uint8).reshape(-1, x.dtype.itemsize).T.tobytes()
            self._plain[name] += x.nbytes
            self._packed[name] += len(zlib.compress(shuffled, LEVEL))

    @property
    def lane_bytes(self) -> float:
        """Bytes of a lane without compression."""
        return self._plain.total() / max(self.lanes, 1)

    def plain(self, lanes: int) -> frozenset[str]:
        """Return the names of the variables that stay uncompressed in a dataset of `lanes` lanes."""
        if self.lane_bytes * lanes <= UP_TO:
            return frozenset()
        return frozenset(name for name, size in self._plain.items() if self._packed[name] > HALF * size)

    def left(self, lanes: int) -> float:
        """Return the size of such a dataset over its uncompressed size."""
        plain = self.plain(lanes)
        size = sum(size if name in plain else self._packed[name] for name, size in self._plain.items())
        return size / max(self._plain.total(), 1)
