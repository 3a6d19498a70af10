"""The choice of the variables to compress with HDF5's shuffle filter and zlib, which every reader supports."""

import zlib
from collections import Counter
from collections.abc import Mapping

import numpy as np

LEVEL = 1
"""Level of zlib: higher levels take several times as long, and save only 1 % more of floating-point results."""

UP_TO = 64e6
"""Size of a dataset [bytes] up to which all variables are compressed; in a larger one, those that shrink to half.

One core compresses 50 to 100 MB/s of floating-point results, to four fifths of their size; a disk writes several
hundred MB/s. Flags, counts and variables that most lanes lack shrink to a fifth or less, at the speed of a disk.
"""

HALF = 0.5
"""Largest ratio of compressed to plain size at which a variable of a large dataset is compressed."""


class Sizes:
    """The plain and compressed sizes of the variables of some lanes of a sweep; `lanes` is the number of them."""

    def __init__(self) -> None:
        self.lanes = 0
        self._plain: Counter[str] = Counter()
        self._packed: Counter[str] = Counter()

    def add(self, variables: Mapping[str, np.ndarray]) -> None:
        """Add lanes; each variable has the shape (lanes,) or (lanes, rows)."""
        self.lanes += max((len(x) for x in variables.values()), default=0)
        for name, x in variables.items():
            # HDF5's shuffle: the first bytes of all numbers, then all second bytes, ...
            shuffled = x.reshape(-1).view(np.uint8).reshape(-1, x.dtype.itemsize).T.tobytes()
            self._plain[name] += x.nbytes
            self._packed[name] += len(zlib.compress(shuffled, LEVEL))

    @property
    def lane_bytes(self) -> float:
        """Uncompressed bytes per lane."""
        return self._plain.total() / max(self.lanes, 1)

    def plain(self, lanes: int) -> frozenset[str]:
        """Return the names of the variables that stay uncompressed in a dataset of `lanes` lanes."""
        if self.lane_bytes * lanes <= UP_TO:
            return frozenset()
        return frozenset(name for name, size in self._plain.items() if self._packed[name] > HALF * size)

    def left(self, lanes: int) -> float:
        """Return the compressed size of a dataset of `lanes` lanes, divided by its uncompressed size."""
        plain = self.plain(lanes)
        size = sum(size if name in plain else self._packed[name] for name, size in self._plain.items())
        return size / max(self._plain.total(), 1)
