"""Facets of pictures: the lanes at each combination of values of the axes that are neither abscissa nor ordinate."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.pictures.axes import index_text, number, pretty_unit, scale, short, symbol
from vibrojax.pictures.contents import START, is_numeric, lane_dims

MOST_PANELS = 12

PAGE = (16.0, 20.0)
"""Greatest width and height [inch] of a sweep's picture, margins included."""

LEGEND_WIDTH = 1.9
"""The approximate width [inch] of a legend at the right."""


@dataclass(frozen=True)
class Facets:
    """The facets of a picture: their titles and their lanes.

    - `counts`: numbers of values of the axes, of which the last one changes from facet to facet.
    - `note`: text that lists the values shown, empty if none are left out.
    """

    titles: tuple[str, ...]
    data: tuple[xr.Dataset, ...]
    counts: tuple[int, ...] = (1,)
    note: str = ""

    def __len__(self) -> int:
        return len(self.data)

    def __iter__(self) -> Iterator[tuple[str, xr.Dataset]]:
        return zip(self.titles, self.data, strict=True)

    def places(self, most: int) -> list[tuple[int, int]]:
        """Return the row and column of each facet, in at most `most` columns.

        Rows end where the values of an axis end, or the values of the last axis are below each other; as few places as
        possible stay empty.
        """
        count, last = len(self), self.counts[-1]
        if count <= most:
            return [(0, k) for k in range(count)]
        runs = np.cumprod(self.counts[::-1]).tolist()  # facets after which the values of an axis repeat
        step = max((run for run in runs if run <= most), default=1)
        choices = [(n, False) for n in range(2, most + 1) if n % step == 0]
        choices += [(count // last, True)] if last > 1 and 1 < count // last <= most else []
        wide, turned = min(choices, key=lambda c: (c[0] < 3, -count % c[0], not c[1], -c[0]), default=(most, False))
        return [divmod(k, last)[::-1] if turned else divmod(k, wide) for k in range(count)]


def facets(ds: xr.Dataset, along: Sequence[str], most: int = MOST_PANELS) -> Facets:
    """Split the dataset into at most `most` facets along its lane dimensions that are not in `along`."""
    sizes = {name: ds.sizes[name] for name in lane_dims(ds) if name not in along}
    counts = dict(sizes)
    while prod(counts.values()) > most:  # initial conditions are left out last
        droppable = [name for name in counts if name != START and counts[name] > 1] or list(counts)
        counts[max(droppable, key=counts.__getitem__)] -= 1
    picks = {  # from the first to the last value; the middle value if there is room for only one
        name: [size // 2] if counts[name] == 1 else np.linspace(0, size - 1, counts[name]).round().astype(int).tolist()
        for name, size in sizes.items()
    }
    indices = [dict(zip(sizes, pick, strict=True)) for pick in product(*picks.values())]
    titles = tuple(", ".join(index_text(ds, name, i) for name, i in index.items()) for index in indices)
    texts = [
        f"{_listed(ds, name, pick)} ({len(pick)} of {sizes[name]} values)"
        for name, pick in picks.items()
        if len(pick) < sizes[name]
    ]
    note = f"Too many panels to show all; here {'; '.join(texts)}" if texts else ""
    return Facets(titles, tuple(ds.isel(index) for index in indices), tuple(counts.values()) or (1,), note)


def at(facet: xr.Dataset) -> dict[str, Any]:
    """Return the values of the axes that a facet is at."""
    return {str(name): data.values.item() for name, data in facet.coords.items() if data.ndim == 0}


def _listed(ds: xr.Dataset, name: str, pick: list[int]) -> str:
    if name not in ds.coords:
        return "; ".join(index_text(ds, name, i) for i in pick)
    values, (factor, unit) = ds[name].values[pick], scale(ds[name]) if is_numeric(ds[name]) else (1.0, "")
    texts = [number(float(x) * factor) if is_numeric(ds[name]) else short(str(x)) for x in values]
    return f"{symbol(ds[name])} = {', '.join(texts)} {pretty_unit(unit)}".rstrip()
