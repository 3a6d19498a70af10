"""Sweeps of scenes with rock, as lines: the rate of penetration over the swept axis and over the relief."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.errors import InputError
from vibrojax.plot._about import point_text
from vibrojax.plot._cells import RATE, SINGLE
from vibrojax.plot._facets import facets
from vibrojax.plot._grid import POINT, lane_dims, without_single
from vibrojax.plot._labels import scale, with_unit
from vibrojax.plot._rows import MOST_ROWS, Row, label_axes, rows
from vibrojax.plot._series import Across, Line, across, apart, line_handles, lines
from vibrojax.plot._sheet import write_margins
from vibrojax.plot._stacks import LEGEND_WIDTH, legend_at_right
from vibrojax.plot._style import INK, styled

RELIEF, SLIP, PEAK = "relief", "slip_per_impact", "peak_impact_force"
_NAMES = {RATE: "rate of penetration", SLIP: "slip per blow", PEAK: "peak impact force"}
_SEVERAL = 40  # lanes of a line, from which marks on them are small
_SAME = 1e-6  # relative, within which a value does not vary


@dataclass(frozen=True)
class _Curve:
    """What is drawn: `up` over `along`, the axis of lines or the relief."""

    up: str
    along: str
    factor: float
    label: str


@styled
def rates(ds: xr.Dataset) -> Figure:
    """The rate of penetration over the longest axis and over the relief P/D, and the slip or the force of a blow.

    The second longest axis is told apart by colours, further ones become rows: four at most, and the figure says
    which. Lanes without penetration are hollow marks, other motions than a single impact are crosses. A list of points
    is drawn over the parameter of most values.

    **Arguments:**

    - `ds`: a sweep's dataset with `rate_of_penetration` [m/s], and `relief` [1], `slip_per_impact` [m],
      `peak_impact_force` [N] and `regime` where there are any.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no rates.
    """
    if RATE not in ds or ds[RATE].size == 0:
        raise InputError(f"no rates to draw: the dataset holds no variable {RATE}")
    ds = without_single(ds)
    x = across(ds)
    by = apart(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    panels = facets(ds, (POINT, x.name, by), MOST_ROWS)
    curves = _curves(ds, x)
    figure, drawn = rows(panels, len(curves))
    joined = "-" if x.is_number and POINT not in lane_dims(ds) else "none"
    for row in drawn:
        for at, curve in enumerate(curves):
            for line in lines(row.facet, by):
                _draw(row.axes[at], line, curve, x, joined)
            label_axes(row, at, x.label if curve.along == x.name else "relief P/D", curve.label)
    _limit(drawn, curves, x)
    legend_at_right(figure, line_handles(lines(ds, by), linestyle=joined), _marks(ds))
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), panels.note, _lost(ds), legend=LEGEND_WIDTH)
    return figure


def _curves(ds: xr.Dataset, x: Across) -> list[_Curve]:
    """The rate over the axis, and over the relief where that varies; of a blow its force, or its slip."""
    pairs = [(RATE, x.name)]
    if RELIEF in ds and _varies(ds[RELIEF], x):  # along a line: else a curve over it is none
        pairs.append((RATE, RELIEF))
    of_a_blow = [name for name in (PEAK, SLIP) if name in ds]
    pairs += [(name, x.name) for name in sorted(of_a_blow, key=lambda name: not _varies(ds[name], x))[:1]]
    scales = [scale(ds[up]) for up, _ in pairs]
    return [
        _Curve(*pair, factor, with_unit(_NAMES[pair[0]], unit))
        for pair, (factor, unit) in zip(pairs, scales, strict=True)
    ]


def _varies(data: xr.DataArray, x: Across) -> bool:
    """Whether `data` varies along any of the lines."""
    dimension = x.name if x.name in data.dims else POINT
    if dimension not in data.dims:
        return False
    swing = data.max(dimension) - data.min(dimension)
    return bool((swing > _SAME * np.abs(data).max()).any())


def _draw(axes: Axes, line: Line, curve: _Curve, x: Across, joined: str) -> None:
    places = np.atleast_1d(line.lanes[RELIEF].values) if curve.along == RELIEF else x.of(line.lanes)
    values, found = (np.atleast_1d(line.lanes[name].values) for name in (curve.up, RATE))
    values = curve.factor * values
    kinds = _kinds(line.lanes, found)
    # A jump to another motion is no part of the curve.
    jumps = 1 + np.flatnonzero(np.diff(kinds["other"].astype(int)))
    path = (np.insert(np.asarray(along, float), jumps, np.nan) for along in (places, values))
    axes.plot(*path, color=line.colour, linestyle=joined, linewidth=1.2, label=line.name or curve.up)
    size = 3.8 if values.size < _SEVERAL else 2.0
    for kind, there in kinds.items():
        if there.any():
            look = _look(kind, line.colour) | {"markersize": size + (kind == "none")}
            axes.plot(places[there], values[there], linestyle="none", label=f"_{kind}", **look)


def _kinds(lanes: xr.Dataset, found: np.ndarray) -> dict[str, np.ndarray]:
    """Which lanes get which mark."""
    single = np.atleast_1d(lanes["regime"].values) == SINGLE if "regime" in lanes else np.ones(found.shape, bool)
    return {"single": single & ~(found == 0), "other": ~single, "none": single & (found == 0)}


def _look(kind: str, colour: str) -> dict[str, object]:
    marker = "x" if kind == "other" else "o"
    face = {"markerfacecolor": "white", "zorder": 4} if kind == "none" else {}
    return {"color": colour, "marker": marker, "markeredgewidth": 1.0} | face


def _limit(drawn: tuple[Row, ...], curves: list[_Curve], x: Across) -> None:
    """Show zero: the question is whether lines go through it."""
    for at, curve in enumerate(curves):
        axes = drawn[0].axes[at]
        greatest = max(row.axes[at].dataLim.y1 for row in drawn)
        top = 1.05 * greatest if 0 < greatest < np.inf else 1.0
        axes.set_ylim(-0.03 * top, top)
        if curve.along == RELIEF:
            right = axes.get_xlim()[1]
            axes.set_xlim(-0.03 * right, right)
        else:
            x.shape(axes)


def _marks(ds: xr.Dataset) -> list[Artist]:
    """The legend's entries for the marks that need words."""
    kinds = _kinds(ds, ds[RATE].values)
    texts = {"single": "single impact", "other": "other motion", "none": "no penetration"}
    wanted = [kind for kind in texts if kinds[kind].any() and (kind == "none" or "regime" in ds)]
    return [Line2D([], [], linestyle="none", markersize=4.5, label=texts[k], **_look(k, INK)) for k in wanted]


def _lost(ds: xr.Dataset) -> str:
    """How many lanes have no rate."""
    count = int(np.isnan(ds[RATE].values).sum())
    return f"{count} of {ds[RATE].size} lanes without a rate" if count else ""
