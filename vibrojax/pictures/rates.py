"""Curves of the rate of penetration over an axis of a sweep and over the relief, with the motion of each lane."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr
from jaxtyping import Bool

from vibrojax.errors import counted
from vibrojax.pictures.axes import scale, with_unit
from vibrojax.pictures.colours import SINGLE, words_for
from vibrojax.pictures.contents import POINT, RATE, REGIME, RELIEF, is_numeric, rates_in
from vibrojax.pictures.lines import Across, Lanes, Series, axis_of_lines, line_keys, longest_axis, row_per_facet
from vibrojax.pictures.plots import INK, Axis, Layer, Line, Look, Plot, Sheet, dots
from vibrojax.pictures.style import nested_line

_SLIP, _PEAK = "slip_per_impact", "peak_impact_force"
_MANY_LANES = 40  # number of lanes per line from which on markers are small
_CONSTANT = 1e-6  # largest relative range of values that count as constant
_BEYOND = 1.05  # greatest value on an axis, in units of the greatest value in the data
_MARKS: dict[str, tuple[str, Look]] = {
    "single": ("single impact", {"marker": "o"}),
    "other": ("other motion", {"marker": "x"}),
    "none": ("no penetration", {"marker": "o", "face": "white", "order": 4.0}),
}


def rates(ds: xr.Dataset) -> Sheet:
    """Draw the rate of penetration over the longest axis and over the relief P/D, and the slip or the force per blow.

    Colours distinguish the values of the second longest axis. Further axes become rows, at most four; a note lists the
    values shown if not all fit. Hollow markers are lanes without penetration; crosses are motions other than a single
    impact. A list of points is drawn over the parameter with the most values.
    """
    ds = rates_in(ds)
    x = longest_axis(ds)
    by = axis_of_lines(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    dash = x.dash(ds)
    named = bool(by) and not is_numeric(ds[by]) and bool(dash)  # starts or rocks, whose lines may coincide

    def from_zero(name: str, greatest: float, label: str, zero: str = "") -> Axis:
        """Return an axis from zero, to show whether lines pass through it."""
        top = _BEYOND * greatest or 1.0
        return Axis(label, name, (-0.03 * top, top), group=name, zero=zero)

    def draw(lines: list[Series], name: str, along: str) -> Plot:
        factor, unit = scale(ds[name])
        greatest = factor * float(ds[name].max(skipna=True).fillna(0.0))
        up = from_zero(name, greatest, with_unit(words_for(name), unit), zero="no penetration")
        over_relief = along == RELIEF
        across = from_zero(RELIEF, float(ds[RELIEF].max()), words_for(RELIEF)) if over_relief else x.axis(ds)
        layers: list[Layer] = []
        for k, line in enumerate(lines):
            places = np.atleast_1d(line.lanes[RELIEF].values) if over_relief else x.of(line.lanes)
            look = nested_line(k, len(lines)) if named else {"dash": dash}
            layers += _rate_layers(line, places, factor * np.atleast_1d(line.lanes[name].values), look)
        return Plot(layers, across, up)

    lines = line_keys(ds, by, dash=dash)
    if named:
        lines = [replace(each, **nested_line(k, len(lines))) for k, each in enumerate(lines)]
    motions = [name for name, mask in _motions(ds).items() if mask.any() and (name == "none" or REGIME in ds)]
    marks = [dots(label=_MARKS[name][0], colour=INK, **{"size": 4.5} | _MARKS[name][1]) for name in motions]
    count = int(np.isnan(ds[RATE].values).sum())
    missing = f"{count} of {counted(ds[RATE].size, 'lane')} without a rate" if count else ""
    draws = [partial(draw, name=name, along=along) for name, along in _curves(ds, x)]
    return row_per_facet(ds, x, by, draws, [lines, marks], missing)


def _curves(ds: xr.Dataset, x: Across) -> Iterator[tuple[str, str]]:
    """Yield pairs of a variable and what it is drawn over: the axis `x`, or the relief.

    They are the rate over the axis and over the relief, if that varies, and the force or slip per blow.
    """

    def varies(name: str) -> bool:
        """Return whether a variable varies along any of the lines."""
        dimension = x.name if x.name in ds[name].dims else POINT
        if dimension not in ds[name].dims:
            return False
        swing = ds[name].max(dimension) - ds[name].min(dimension)
        return bool((swing > _CONSTANT * np.abs(ds[name]).max()).any())

    yield RATE, x.name
    if RELIEF in ds and varies(RELIEF):
        yield RATE, RELIEF
    each_blow = [name for name in (_PEAK, _SLIP) if name in ds]
    if each_blow:
        yield max(each_blow, key=varies), x.name


def _rate_layers(line: Series, places: Lanes, values: Lanes, look: Look) -> list[Layer]:
    """Return one line, interrupted at jumps between a single impact and another motion, and markers of its motions."""
    motions = _motions(line.lanes)
    jumps = 1 + np.flatnonzero(np.diff(motions["other"].astype(int)))
    x, y = (np.insert(np.asarray(along, float), jumps, np.nan) for along in (places, values))
    layers: list[Layer] = [Line(x, y, colour=line.colour, **look)]
    size = look.get("size", 3.8) if values.size < _MANY_LANES else 2.0
    for motion, mask in motions.items():
        if mask.any():
            mark = _MARKS[motion][1] | {"size": size + (motion == "none"), "colour": line.colour, "clip": False}
            layers.append(dots(places[mask], values[mask], **mark))
    return layers


def _motions(lanes: xr.Dataset) -> dict[str, Bool[np.ndarray, "*lanes"]]:
    """Return masks of the lanes with a single impact, another motion, and a single impact without penetration."""
    nothing = np.atleast_1d(lanes[RATE].values) == 0
    single = np.atleast_1d(lanes[REGIME].values) == SINGLE if REGIME in lanes else np.ones(nothing.shape, bool)
    return {"single": single & ~nothing, "other": ~single, "none": single & nothing}
