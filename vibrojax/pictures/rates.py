"""Line plots of sweeps with rock: the rate of penetration over the swept axis and over the relief."""

import numpy as np
import xarray as xr
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.errors import counted
from vibrojax.pictures.axes import scale, shape_zero, with_unit
from vibrojax.pictures.colours import SINGLE
from vibrojax.pictures.contents import POINT, RATE, REGIME, RELIEF, is_numeric, rates_in
from vibrojax.pictures.curves import (
    MOST_ROWS,
    Across,
    Line,
    Samples,
    axis_of_lines,
    line_handles,
    longest_axis,
    new_rows,
    split_lines,
)
from vibrojax.pictures.sheet import facets, legend_at_right, write_margins
from vibrojax.pictures.style import INK, Mark, nested_line, styled

SLIP, PEAK = "slip_per_impact", "peak_impact_force"
_NAMES = {RATE: "rate of penetration", SLIP: "slip per blow", PEAK: "peak impact force"}
_MANY_LANES = 40  # number of lanes per line from which on markers are small
_CONSTANT = 1e-6  # largest relative range of values that count as constant


@styled
def rates(ds: xr.Dataset) -> Figure:
    """Draw the rate of penetration over the longest axis and over the relief P/D, and the slip or the force per blow.

    Colours distinguish the values of the second longest axis. Further axes become rows, at most four; a note lists the
    values shown if not all fit. Hollow markers are lanes without penetration; crosses are motions other than a single
    impact. A list of points is drawn over the parameter with the most values.
    """
    ds = rates_in(ds)
    x = longest_axis(ds)
    by = axis_of_lines(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    panels = facets(ds, (POINT, x.name, by), MOST_ROWS)
    curves = _choose_curves(ds, x)
    figure, rows, _ = new_rows(panels, len(curves))
    style = x.style_of(ds)
    named = bool(by) and not is_numeric(ds[by])  # starts or rocks, whose lines may coincide
    for row in rows:
        for i, (name, along) in enumerate(curves):
            factor, unit = scale(ds[name])
            lines = split_lines(row.facet, by)
            for k, line in enumerate(lines):
                places = np.atleast_1d(line.lanes[RELIEF].values) if along == RELIEF else x.of(line.lanes)
                look = nested_line(k, len(lines)) if named and style == "-" else Mark(linestyle=style)
                _draw(row.axes[i], line, places, factor * np.atleast_1d(line.lanes[name].values), look, name)
            row.label(i, x.label if along == x.name else "relief P/D", with_unit(_NAMES[name], unit))
    for i, (_, along) in enumerate(curves):  # include zero, to show whether lines pass through it
        axes = rows[0].axes[i]
        if not shape_zero([row.axes[i] for row in rows], "no penetration"):
            greatest = max(row.axes[i].dataLim.y1 for row in rows)
            top = 1.05 * greatest if 0 < greatest < np.inf else 1.0
            axes.set_ylim(-0.03 * top, top)
        if along == RELIEF:
            right = axes.get_xlim()[1]
            axes.set_xlim(-0.03 * right, right)
        else:
            x.shape(axes)
    handles = line_handles(split_lines(ds, by), Mark(linestyle=style))
    for k, handle in enumerate(handles if named and style == "-" else ()):
        handle.set(**nested_line(k, len(handles)))
    texts = {"single": "single impact", "other": "other motion", "none": "no penetration"}
    shown = [motion for motion, mask in _motions(ds).items() if mask.any() and (motion == "none" or REGIME in ds)]
    look = Mark(linestyle="none", markersize=4.5)
    marks = [Line2D([], [], label=texts[motion], **look | _mark(motion, INK)) for motion in shown]
    legend_at_right(figure, handles, marks)
    count = int(np.isnan(ds[RATE].values).sum())
    write_margins(
        figure, ds, panels.note, f"{count} of {counted(ds[RATE].size, 'lane')} without a rate" if count else ""
    )
    return figure


def _choose_curves(ds: xr.Dataset, x: Across) -> list[tuple[str, str]]:
    """Return pairs of a variable and what it is drawn over: the axis `x`, or the relief.

    They are the rate over the axis and over the relief, if that varies, and the force or slip per blow.
    """

    def varies(name: str) -> bool:
        """Return whether a variable varies along any of the lines."""
        dimension = x.name if x.name in ds[name].dims else POINT
        if dimension not in ds[name].dims:
            return False
        swing = ds[name].max(dimension) - ds[name].min(dimension)
        return bool((swing > _CONSTANT * np.abs(ds[name]).max()).any())

    each_blow = sorted((name for name in (PEAK, SLIP) if name in ds), key=lambda name: not varies(name))[:1]
    over_relief = [(RATE, RELIEF)] if RELIEF in ds and varies(RELIEF) else []
    return [(RATE, x.name), *over_relief, *((name, x.name) for name in each_blow)]


def _draw(axes: Axes, line: Line, places: Samples, values: Samples, look: Mark, name: str) -> None:
    """Draw one line with the markers of its motions.

    The line is interrupted at jumps between a single impact and another motion.
    """
    motions = _motions(line.lanes)
    jumps = 1 + np.flatnonzero(np.diff(motions["other"].astype(int)))
    path = (np.insert(np.asarray(along, float), jumps, np.nan) for along in (places, values))
    style = Mark(linewidth=1.2) | look | Mark(markersize=None)
    axes.plot(*path, color=line.colour, label=line.name or name, **style)
    size = look.get("markersize", 3.8) if values.size < _MANY_LANES else 2.0
    for motion, mask in motions.items():
        if mask.any():
            mark = _mark(motion, line.colour) | Mark(linestyle="none", markersize=size + (motion == "none"))
            axes.plot(places[mask], values[mask], label=f"_{motion}", **mark)


def _motions(lanes: xr.Dataset) -> dict[str, Bool[np.ndarray, "*lanes"]]:
    """Return masks of the lanes with a single impact, another motion, and a single impact without penetration."""
    nothing = np.atleast_1d(lanes[RATE].values) == 0
    single = np.atleast_1d(lanes[REGIME].values) == SINGLE if REGIME in lanes else np.ones(nothing.shape, bool)
    return {"single": single & ~nothing, "other": ~single, "none": single & nothing}


def _mark(motion: str, colour: str) -> Mark:
    mark = Mark(color=colour, marker="x" if motion == "other" else "o", markeredgewidth=1.0)
    return mark | Mark(markerfacecolor="white", zorder=4) if motion == "none" else mark
