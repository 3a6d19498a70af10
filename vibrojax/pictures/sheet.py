"""Facets of pictures: the lanes at each combination of values of the axes that are neither abscissa nor ordinate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
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

    - `runs`: numbers of facets after which the values of an axis repeat, from the last axis to the first.
    - `note`: text that lists the values shown, empty if none are left out.
    """

    titles: tuple[str, ...]
    data: tuple[xr.Dataset, ...]
    runs: tuple[int, ...] = (1,)
    note: str = ""

    def __len__(self) -> int:
        return len(self.data)


def facets(ds: xr.Dataset, along: Sequence[str], most: int = MOST_PANELS) -> Facets:
    """Split the dataset into at most `most` facets along its lane dimensions that are not in `along`."""
    axes = [name for name in lane_dims(ds) if name not in along]
    sizes = {name: ds.sizes[name] for name in axes}
    counts = dict(sizes)
    while np.prod(list(counts.values()), initial=1) > most:  # initial conditions are left out last
        droppable = [name for name in counts if name != START and counts[name] > 1] or list(counts)
        counts[max(droppable, key=counts.__getitem__)] -= 1
    picks = {  # from the first to the last value; the middle value if there is room for only one
        name: [size // 2] if counts[name] == 1 else np.linspace(0, size - 1, counts[name]).round().astype(int).tolist()
        for name, size in sizes.items()
    }
    indices = [dict(zip(axes, pick, strict=True)) for pick in product(*picks.values())]
    titles = tuple(", ".join(index_text(ds, name, i) for name, i in index.items()) for index in indices)
    runs = tuple(int(run) for run in np.cumprod([counts[name] for name in reversed(axes)]))
    parts = [
        f"{_listed(ds, name, pick)} ({len(pick)} of {sizes[name]} values)"
        for name, pick in picks.items()
        if len(pick) < sizes[name]
    ]
    note = f"Too many panels to show all; here {'; '.join(parts)}" if parts else ""
    return Facets(titles, tuple(ds.isel(index) for index in indices), runs, note)


def at(facet: xr.Dataset) -> dict[str, Any]:
    """Return the values of the axes that a facet is at."""
    return {str(name): data.values.item() for name, data in facet.coords.items() if data.ndim == 0}


def _listed(ds: xr.Dataset, name: str, pick: list[int]) -> str:
    if name not in ds.coords:
        return "; ".join(index_text(ds, name, i) for i in pick)
    values, (factor, unit) = ds[name].values[pick], scale(ds[name]) if is_numeric(ds[name]) else (1.0, "")
    texts = [number(float(x) * factor) if is_numeric(ds[name]) else short(str(x)) for x in values]
    return f"{symbol(ds[name])} = {', '.join(texts)} {pretty_unit(unit)}".rstrip()


def turned(panels: Facets, most: int) -> Facets:
    """Return the facets with the few values of their last axis below each other, if the others then fit in a row."""
    count, last = len(panels), panels.runs[0]
    if not 1 < last < count or count <= most or count // last > most:
        return panels
    order = [k * last + i for i in range(last) for k in range(count // last)]
    titles, data = tuple(panels.titles[k] for k in order), tuple(panels.data[k] for k in order)
    return replace(panels, titles=titles, data=data, runs=(count // last, count))


def columns(panels: Facets, most: int) -> int:
    """Return the number of columns, at most `most`, so that rows end where an axis ends and few places stay empty."""
    count = len(panels)
    if count <= most:
        return count
    step = max([run for run in panels.runs if run <= most], default=1)
    choices = [n for n in range(most, 1, -1) if n % step == 0]
    return min(choices, key=lambda n: (n < 3, -count % n, -n), default=most)
