"""Sweeps of scenes with rock, as lines: the rate of penetration over the swept axis and over the relief."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from jaxtyping import Bool
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.analyses.sweep.maps import SINGLE
from vibrojax.plot.axes import point_text, scale, with_unit
from vibrojax.plot.contents import POINT, RATE, REGIME, RELIEF, has_regimes, lane_dims, rates_in
from vibrojax.plot.curves import (
    MOST_ROWS,
    Across,
    Line,
    Row,
    across,
    axis_of_lines,
    label_axes,
    line_handles,
    lines,
    rows,
)
from vibrojax.plot.margins import legend_at_right, write_margins
from vibrojax.plot.sheet import facets
from vibrojax.plot.style import INK, Mark, styled

SLIP, PEAK = "slip_per_impact", "peak_impact_force"
_NAMES = {RATE: "rate of penetration", SLIP: "slip per blow", PEAK: "peak impact force"}
_SEVERAL = 40  # lanes of a line, from which marks on them are small
_SAME = 1e-6  # relative, within which a value does not vary

Motion = Literal["single", "other", "none"]  # a single impact, another motion, a single impact without penetration


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

    The second longest axis has a colour for each value, further ones become rows: four at most, and the figure says
    which. Lanes without penetration are hollow marks, other motions than a single impact are crosses. A list of points
    is drawn over the parameter of most values.

    **Arguments:**

    - `ds`: a sweep's dataset with `rate_of_penetration` [m/s], and `relief` [1], `slip_per_impact` [m],
      `peak_impact_force` [N] and `regime` where there are any.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no rates.
    """
    ds = rates_in(ds)
    x = across(ds)
    by = axis_of_lines(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    panels = facets(ds, (POINT, x.name, by), MOST_ROWS)
    curves = _curves(ds, x)
    figure, drawn, _ = rows(panels, len(curves))
    joined: Literal["-", "none"] = "-" if x.is_number and POINT not in lane_dims(ds) else "none"
    for row in drawn:
        for at, curve in enumerate(curves):
            for line in lines(row.facet, by):
                _draw(row.axes[at], line, curve, x, joined)
            label_axes(row, at, x.label if curve.along == x.name else "relief P/D", curve.label)
    _limit(drawn, curves, x)
    legend_at_right(figure, line_handles(lines(ds, by), Mark(linestyle=joined)), _mark_handles(ds))
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), panels.note, _without_rate(ds))
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


def _draw(axes: Axes, line: Line, curve: _Curve, x: Across, joined: Literal["-", "none"]) -> None:
    places = np.atleast_1d(line.lanes[RELIEF].values) if curve.along == RELIEF else x.of(line.lanes)
    values = curve.factor * np.atleast_1d(line.lanes[curve.up].values)
    motions = _motions(line.lanes)
    # A jump to another motion is no part of the curve.
    jumps = 1 + np.flatnonzero(np.diff(motions["other"].astype(int)))
    path = (np.insert(np.asarray(along, float), jumps, np.nan) for along in (places, values))
    axes.plot(*path, color=line.colour, linestyle=joined, linewidth=1.2, label=line.name or curve.up)
    size = 3.8 if values.size < _SEVERAL else 2.0
    for motion, there in motions.items():
        if there.any():
            mark = _mark(motion, line.colour) | Mark(linestyle="none", markersize=size + (motion == "none"))
            axes.plot(places[there], values[there], label=f"_{motion}", **mark)


def _motions(lanes: xr.Dataset) -> dict[Motion, Bool[np.ndarray, "*lanes"]]:
    """Which lanes get which mark."""
    nothing = np.atleast_1d(lanes[RATE].values) == 0
    single = np.atleast_1d(lanes[REGIME].values) == SINGLE if has_regimes(lanes) else np.ones(nothing.shape, bool)
    return {"single": single & ~nothing, "other": ~single, "none": single & nothing}


def _mark(motion: Motion, colour: str) -> Mark:
    mark = Mark(color=colour, marker="x" if motion == "other" else "o", markeredgewidth=1.0)
    return mark | Mark(markerfacecolor="white", zorder=4) if motion == "none" else mark


def _limit(drawn: Sequence[Row], curves: Sequence[_Curve], x: Across) -> None:
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


def _mark_handles(ds: xr.Dataset) -> list[Artist]:
    """The legend's entries for the marks that need words."""
    motions = _motions(ds)
    texts: dict[Motion, str] = {"single": "single impact", "other": "other motion", "none": "no penetration"}
    wanted = [motion for motion in texts if motions[motion].any() and (motion == "none" or has_regimes(ds))]
    look = Mark(linestyle="none", markersize=4.5)
    return [Line2D([], [], label=texts[motion], **look | _mark(motion, INK)) for motion in wanted]


def _without_rate(ds: xr.Dataset) -> str:
    """How many lanes have no rate."""
    count = int(np.isnan(ds[RATE].values).sum())
    return f"{count} of {ds[RATE].size} lanes without a rate" if count else ""
