"""A dataset in regions: runs of lanes that are written together, each the whole of one chunk of every stored array."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod

Box = tuple[slice, ...]
"""Where in an array over a sweep's dimensions something lies."""


@dataclass(frozen=True)
class Region:
    """Lanes from `first` to before `end`, in row-major order; `box`: where they lie."""

    first: int
    end: int
    box: Box

    @property
    def shape(self) -> tuple[int, ...]:
        """The sizes of the box."""
        return tuple(part.stop - part.start for part in self.box)


class Regions:
    """The regions of arrays of a `shape`, in row-major order, none of more than `most` values.

    A region is a part of one dimension, all of the dimensions after that, and one index of those before: it is a box
    and, in row-major order, a run without gaps. `chunk`: the sizes of all but those at the end of their dimension.
    """

    def __init__(self, shape: tuple[int, ...], most: int) -> None:
        self.shape = shape
        sizes, room = [], max(1, most)
        for size in reversed(shape):
            sizes.append(max(1, min(size, room)))
            # Where a part of a dimension was taken, the dimensions before it are taken one by one.
            room = room // size if size <= room else 1
        self.chunk = tuple(reversed(sizes))

    def __iter__(self) -> Iterator[Region]:
        whole = next((at for at, part in enumerate(self.chunk) if part > 1), max(len(self.shape) - 1, 0))
        if not self.shape:
            yield Region(0, 1, ())
            return
        inner = prod(self.shape[whole + 1 :])
        for outer in range(prod(self.shape[:whole])):
            before, rest = [], outer
            for size in reversed(self.shape[:whole]):
                rest, at = divmod(rest, size)
                before.append(slice(at, at + 1))
            for start in range(0, self.shape[whole], self.chunk[whole]):
                stop = min(start + self.chunk[whole], self.shape[whole])
                begin = (outer * self.shape[whole] + start) * inner
                box = (*reversed(before), slice(start, stop), *(slice(0, size) for size in self.shape[whole + 1 :]))
                yield Region(begin, begin + (stop - start) * inner, box)
