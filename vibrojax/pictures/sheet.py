"""Facets of pictures, and the layout of maps: panels for each drawn quantity and each facet.

A facet shows the lanes at one combination of values of the axes that are neither abscissa nor ordinate. In a list of
quantities, None stands for the regimes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.pictures.axes import index_text, number, pretty_unit, scale, short, symbol
from vibrojax.pictures.colours import Value, Values
from vibrojax.pictures.contents import START, is_numeric, lane_dims
from vibrojax.pictures.plots import Scale

MOST_PANELS = 12
_MOST_BESIDE = 3  # for up to this many facets, quantities are to the right of the regimes, else below
_MOST_COLUMNS = 6
_SQUARE_FROM = 4  # number of quantities from which a single facet has two columns
_LEGEND_ROOM = 1.6  # inches at the right for the legend, if no panel of regimes leaves a place for it


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


def columns(panels: Facets, most: int) -> int:
    """Return the number of columns, at most `most`, so that rows end where an axis ends and few places stay empty."""
    count = len(panels)
    if count <= most:
        return count
    step = max([run for run in panels.runs if run <= most], default=1)
    choices = [n for n in range(most, 1, -1) if n % step == 0]
    return min(choices, key=lambda n: (n < 3, -count % n, -n), default=most)


class Panel(NamedTuple):
    """A panel of maps: its facet, its title, the quantity `value` that it shows (None: the regimes), its place."""

    facet: xr.Dataset
    title: str
    value: Value | None
    place: tuple[int, int]
    height: float


class Layout(NamedTuple):
    """The panels of a sheet of maps, and the fields of the sheet: size, ratios, colour bars and place of the legend."""

    panels: Sequence[Panel]
    sheet: dict[str, Any]


def layout(panels: Facets, values: Values) -> Layout:
    """Arrange maps of `values`, one per facet.

    Four or more quantities of a single facet are arranged in two columns, each with colour bars at its right. Up to
    three facets have one row each, with legend and colour bars at the bottom. With more facets, the panels of each
    quantity are arranged in a block, with legend and colour bars at the right. The regimes have the legend in place of
    a colour bar; without regimes, the legend is at the right of the figure.
    """
    rows, wide = len(panels), len(values)
    square = rows == 1 and wide >= _SQUARE_FROM
    cells: list[tuple[tuple[int, int], int, int, str]] = []  # place, facet, value and title
    if square:
        deep = -(-wide // 2)
        size, heights, widths = (9.2 + _LEGEND_ROOM, 2.9 * deep + 0.8), [1.0] * deep, [1.0, 0.04, 1.0, 0.04]
        cells = [((i // 2, 2 * (i % 2)), 0, i, panels.titles[0]) for i in range(wide)]
        bars: list[tuple[int, ...]] = [(i // 2, 2 * (i % 2) + 1) for i in range(wide)]
    elif rows <= _MOST_BESIDE:
        width = max(3.4 * wide, 4.6) + (0.0 if None in values else _LEGEND_ROOM)
        size, heights, widths = (width, 2.7 * rows + 1.5), [1.0] * rows + [0.05], [1.0] * wide
        cells = [
            ((row, i), row, i, panels.titles[row] if i == 0 else "") for row, i in product(range(rows), range(wide))
        ]
        bars = [(rows, i) for i in range(wide)]
    else:
        across = columns(panels, _MOST_COLUMNS)
        deep = -(-rows // across)
        width, height = (2.75 if across <= 4 else 2.2), (2.35 if deep == 1 else 2.0)
        size = width * across + 2.2, height * deep * wide + 0.9
        heights, widths = [1.0] * deep * wide, [1.0] * across + [0.05]
        for block, k in product(range(wide), range(rows)):
            row, column = divmod(k, across)
            unbroken = ", ".join(part.replace(" ", "\u00a0") for part in panels.titles[k].split(", "))
            title = fill(unbroken, int(13 * width)).replace("\u00a0", " ") if deep > 1 or block == 0 else ""
            cells.append(((block * deep + row, column), k, block, title))
        bars = [(block * deep, across, deep, 1) for block in range(wide)]
    height = 0.75 * size[1] / sum(heights)
    drawn = [Panel(panels.data[k], title, values[i], place, height) for place, k, i, title in cells]
    upright = square or rows > _MOST_BESIDE
    scales = [Scale(bar, value, upright) for bar, value in zip(bars, values, strict=True) if value is not None]
    legend = bars[values.index(None)] if None in values else ()
    return Layout(drawn, {"size": size, "heights": heights, "widths": widths, "scales": scales, "legend": legend})


PAGE = (16.0, 20.0)
"""Greatest width and height [inch] of a sweep's picture, margins included."""

LEGEND_WIDTH = 1.9
"""The approximate width [inch] of a legend at the right."""
