"""One panel for each value of the axes that are not drawn along."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr

from vibrojax.plot._grid import START, lane_dims
from vibrojax.plot._labels import number, pretty_unit, scale, symbol, value_text

MOST = 12


@dataclass(frozen=True)
class Facets:
    """The panels of a picture.

    `titles` and `data` belong together; `runs` are the numbers of panels after which an axis begins anew, from the
    last axis; `note` says what was left out, and is empty where nothing was.
    """

    titles: tuple[str, ...]
    data: tuple[xr.Dataset, ...]
    runs: tuple[int, ...]
    note: str

    def __len__(self) -> int:
        return len(self.data)


def facets(ds: xr.Dataset, along: Sequence[str], most: int = MOST) -> Facets:
    """`ds` cut into panels over the dimensions of its lanes that are not in `along`; at most `most`."""
    axes = [name for name in lane_dims(ds) if name not in along]
    sizes = {name: ds.sizes[name] for name in axes}
    counts = _representative(sizes, most)
    picks = {name: _spread(sizes[name], counts[name]) for name in axes}
    indices = [dict(zip(axes, (int(i) for i in pick), strict=True)) for pick in product(*picks.values())]
    titles = tuple(", ".join(value_text(ds[name], ds[name].values[i]) for name, i in at.items()) for at in indices)
    runs = tuple(int(run) for run in np.cumprod([counts[name] for name in reversed(axes)]))
    return Facets(titles, tuple(ds.isel(at) for at in indices), runs, _note(ds, sizes, picks))


def columns(panels: Facets, most: int) -> int:
    """How many panels stand side by side, at most `most`: such that rows end where an axis does, with few gaps."""
    count = len(panels)
    if count <= most:
        return count
    step = max([run for run in panels.runs if run <= most], default=1)
    choices = [n for n in range(most, 1, -1) if n % step == 0]
    return min(choices, key=lambda n: (n < 3, -count % n, -n), default=most)


def _representative(sizes: dict[str, int], most: int) -> dict[str, int]:
    """How many values of each axis to show, at most `most` together; starts are dropped last."""
    counts = dict(sizes)
    while np.prod(list(counts.values()), initial=1) > most:
        droppable = [name for name in counts if name != START and counts[name] > 1] or list(counts)
        longest = max(droppable, key=counts.__getitem__)
        counts[longest] -= 1
    return counts


def _spread(size: int, count: int) -> np.ndarray:
    """`count` of `size` indices, from the first to the last; the middle one where it is one."""
    return np.array([size // 2]) if count == 1 else np.linspace(0, size - 1, count).round().astype(int)


def _note(ds: xr.Dataset, sizes: dict[str, int], picks: dict[str, np.ndarray]) -> str:
    parts = [
        f"{symbol(ds[name])} = {_listed(ds[name], pick)} ({pick.size} of {sizes[name]} values)"
        for name, pick in picks.items()
        if pick.size < sizes[name]
    ]
    return f"Too many panels to show all; here {'; '.join(parts)}" if parts else ""


def _listed(coordinate: xr.DataArray, pick: np.ndarray) -> str:
    values = coordinate.values[pick]
    if not np.issubdtype(values.dtype, np.number):
        return ", ".join(str(value) for value in values)
    factor, unit = scale(coordinate)
    return f"{', '.join(number(value * factor) for value in values)} {pretty_unit(unit)}".rstrip()
