"""What a page knows of a dataset over axes: a sweep, orbits, attractors, a fit; `vibrojax.explorer` has the form."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import LogNorm, to_hex

from vibrojax.analyses.attractors.shares import BEYOND
from vibrojax.analyses.attractors.shares import COLOURS as ATTRACTOR_COLOURS
from vibrojax.analyses.sweep.maps import REGION
from vibrojax.errors import InputError, printable, shown
from vibrojax.explorer.packed import packed
from vibrojax.explorer.run import LONGEST_COMMAND, run_document, window_of
from vibrojax.io.attributes import LONGEST_TEXT, text_of, title_of
from vibrojax.plot.axes import certified_text, is_geometric, point_text, pretty_unit, scale, symbol
from vibrojax.plot.borders import LINES, axes_of, beyond, check_borders
from vibrojax.plot.colours import REGIME_COLOURS, Value, flag_names, value_of
from vibrojax.plot.contents import FORM, POINT, START, axes_of_map, has_regimes, long_axes
from vibrojax.plot.starts import described, on_axes
from vibrojax.plot.style import OTHER_COLOURS
from vibrojax.sweep.input.definition import Sweep

Document = dict[str, Any]

LANE = "lane_number"
"""The variable that says which lane a cell is of."""

_LEFT_OUT = ("return_", "check_")
"""How variables begin that are of single returns, or of the check run."""

LONGEST_UNIT = 40
"""Characters of a unit or a symbol that are shown."""

_RESERVED = {"__defineGetter__", "__defineSetter__", "__lookupGetter__", "__lookupSetter__", "__proto__"}
_RESERVED |= {"constructor", "hasOwnProperty", "isPrototypeOf", "propertyIsEnumerable", "toLocaleString", "toString"}
_RESERVED |= {"valueOf"}
"""Names that every object of JavaScript has."""

_FIRST = ("lane_attractor", "regime", "rate_of_penetration", "share", "impact_velocity", "period", "bit_amplitude")


def with_lanes(ds: xr.Dataset, sweep: Sweep | None) -> xr.Dataset:
    """`ds` with the number of each lane, where it is a sweep's."""
    if sweep is None or any(ds.sizes.get(name) != size for name, size in zip(sweep.dims, sweep.shape, strict=True)):
        return ds
    return ds.assign({LANE: (sweep.dims, sweep.over_dims(np.arange(sweep.lanes)).astype(np.int32))})


def grid_document(ds: xr.Dataset, sweep: Sweep | None = None) -> Document:
    """The document of a dataset over axes; `sweep`: the one it is of, if any."""
    ds = with_lanes(ds, sweep)
    if START in ds.dims and START in ds.coords:
        ds = described(on_axes(ds))
    names = _shown(ds)
    if not names:
        return {}
    dims = list(dict.fromkeys(str(dim) for name in names for dim in reduced(ds[name]).dims))
    lanes = [str(dim) for dim in ds[LANE].dims] if LANE in ds else []
    axes = sorted(dims, key=lambda name: lanes.index(name) if name in lanes else len(lanes))
    variables = [variable_document(reduced(ds[name])) for name in names]
    return {
        "format": 1,
        "kind": "grid",
        **about(ds),
        "axes": [axis_document(ds, name) for name in axes],
        "variables": variables,
        "maps": maps_of(variables),
        "lanes": packed(ds[LANE].values) | {"axes": lanes} if LANE in ds else None,
        "fixed": {str(n): _plain(d.values.item()) for n, d in ds.coords.items() if d.ndim == 0},
        "region": {name: list(ends) for name, ends in REGION.items()},
        # A fit is over an axis that is gone: no cell of it is a point.
        "run": None if FORM in ds.dims else run_document(ds, sweep),
        "curves": None,
        "view": _view(ds),
        "cells": None,
    }


def _view(ds: xr.Dataset) -> list[str]:
    """The directions of the first map, as in the picture; none where that has no map over two axes."""
    long = long_axes(ds)
    if len(long) > 1 and not has_regimes(ds):
        return list(long[:2])
    try:
        return list(axes_of_map(ds, None, None))
    except InputError:
        return [str(name) for name in ds.dims if str(name).startswith("start_")][:2]


def about(ds: xr.Dataset) -> Document:
    """Return title, scene, source and notes: what holds for all cells."""
    notes = [point_text(ds), certified_text(ds)]
    if sum(window_of(ds)) > LONGEST_COMMAND:
        notes.append(f"Each lane ran for {sum(window_of(ds)):g} s; the commands simulate {LONGEST_COMMAND:g} s")
    return {
        "title": title_of(ds),
        "scene": text_of(ds, "scene"),
        "source": text_of(ds, "source"),
        "notes": [text(note, LONGEST_TEXT) for note in notes if note],
    }


def text(words: object, longest: int = 200) -> str:
    """Return a text of a dataset as the page shows it: on one line, shortened, without the escapes of pictures."""
    return printable(str(words).replace(r"\$", "$"), longest)


def check_names(ds: xr.Dataset) -> None:
    """Raise `InputError` if a name means something else in JavaScript, where names are keys of objects."""
    for name in (*ds.sizes, *ds.variables):
        if name in _RESERVED:
            raise InputError(f"explore: {shown(str(name))} cannot be the name of a variable in a page; rename it")


def axis_document(ds: xr.Dataset, name: str) -> Document:
    """An axis: its values, or names, and the columns along it (of a list of points, or of starts)."""
    counted = xr.DataArray(np.arange(ds.sizes[name]), dims=name, name=name)
    data = ds[name] if name in ds.coords else counted
    columns = [
        coordinate_document(one)
        for other, one in ds.coords.items()
        if one.dims == (name,) and str(other) != name and (one.dtype.kind in "fiu" or other != START)
    ]
    return coordinate_document(data) | {"columns": columns if name in (POINT, START) else []}


def coordinate_document(data: xr.DataArray) -> Document:
    """A coordinate: name, label, symbol, unit as shown and the factor to it, values."""
    numeric = data.dtype.kind in "fiu"
    factor, unit = scale(data) if numeric else (1.0, "")
    values = np.asarray(data.values, float) if numeric else data.values
    return {
        "name": str(data.name),
        "label": text(data.attrs.get("long_name", "")) or str(data.name).replace("_", " "),
        "symbol": text(symbol(data), LONGEST_UNIT),
        "units": text(pretty_unit(unit), LONGEST_UNIT),
        "factor": factor,
        "numeric": numeric,
        "log": bool(numeric and is_geometric(values)),
        "values": [_plain(x) for x in values.tolist()] if numeric else [text(x) for x in values.tolist()],
    }


def variable_document(data: xr.DataArray) -> Document:
    """A variable: what it is, its colours, and its values."""
    value = value_of(data)
    flags = {str(flag): name for flag, name in flag_names(data).items()} if value.names else None
    colours, low, high = None, float(value.norm.vmin or 0.0), float(value.norm.vmax or 1.0)
    if data.name == "lane_attractor":
        flags, colours = _attractors(data)
    elif flags is not None:
        own = REGIME_COLOURS if "single-impact" in flags.values() else _colours_of(value)
        colours = {flag: own.get(int(flag), OTHER_COLOURS[int(flag) % len(OTHER_COLOURS)]) for flag in flags}
    return {
        "name": str(data.name),
        "label": _label(value.label) if flags is None else str(data.name).replace("_", " "),
        "long_name": text(data.attrs.get("long_name", "")) or str(data.name),
        "units": text(pretty_unit(scale(data)[1]), LONGEST_UNIT) if flags is None else "",
        "factor": value.factor,
        "axes": [str(name) for name in data.dims],
        "flags": flags,
        "colours": colours,
        "map": None if flags is not None else value.colour_map.name,
        "low": low,
        "high": high,
        "log": isinstance(value.norm, LogNorm),
        "extend": value.extend,
        "nothing_at_zero": value.of_rate,
        "whole": data.dtype.kind in "iu" and flags is None,
        "data": packed(np.asarray(data.values)),
    }


def _label(lines: str) -> str:
    return "\n".join(text(line) for line in lines.split("\n")[:3])


def _attractors(data: xr.DataArray) -> tuple[dict[str, str], dict[str, str]]:
    """Names and colours of attractors, by number."""
    numbers = [int(x) for x in np.unique(data.values)]
    colours = {n: ATTRACTOR_COLOURS[n] if 0 <= n < len(ATTRACTOR_COLOURS) else BEYOND for n in numbers}
    names = {str(n): f"attractor {n}" if n >= 0 else "could not be told" for n in numbers}
    return names, {str(n): colour for n, colour in colours.items()}


def _colours_of(value: Value) -> dict[int, str]:
    return {flag: to_hex(value.colour_map(value.norm(flag))) for flag in value.names}


def maps_of(variables: list[Document]) -> dict[str, list[str]]:
    """The colour maps in use, as 256 colours each."""
    names = dict.fromkeys(one["map"] for one in variables if one["map"])
    return {name: [to_hex(colormaps[name](at)) for at in range(256)] for name in names}


def reduced(data: xr.DataArray) -> xr.DataArray:
    """Of multipliers the largest."""
    return data.isel(multiplier=0) if "multiplier" in data.dims else data


def _shown(ds: xr.Dataset) -> list[str]:
    """The variables that a page shows, the first ones first."""
    names = [str(name) for name, data in ds.data_vars.items() if data.dtype.kind in "fiu" and data.ndim > 0]
    names = [name for name in names if name != LANE and not name.startswith(_LEFT_OUT)]
    names = [name for name in names if "return_index" not in ds[name].dims]
    first = [name for name in _FIRST if name in names]
    if "share" in first and START in ds.dims:  # of starts that are no plane, shares say more than where each ends
        first.remove("share")
        first.insert(0, "share")
    first = [name for name in names if name.startswith("push_")] + first
    return first + [name for name in names if name not in first]


def _plain(value: object) -> object:
    """A value as JSON has it: numbers to ten digits, none where they are not finite."""
    if isinstance(value, float):
        return float(f"{value:.10g}") if np.isfinite(value) else None
    return value if isinstance(value, int) else str(value)


def curves_document(ds: xr.Dataset, over: xr.Dataset) -> Document:
    """Borders, as `borders` gives them, over the map of `ds`; raises `InputError` where they do not belong there."""
    check_borders(ds, over, *axes_of(over))
    kinds, number = flag_names(over["kind"]), over["curve"].values
    planes = beyond(over)
    found: list[Document] = []
    for curve in range(over.sizes["curve"]):
        mine = number == curve
        at: Document = {name: _plain(over[name].values[curve].item()) for name in planes}
        if START in over.coords:
            at[START] = str(over[START].values[curve])
        points = {name: [_plain(x) for x in over[name].values[mine].tolist()] for name in axes_of(over)}
        found.append({"kind": kinds[int(over["kind"][curve])], "at": at, "points": points})
    return {"colours": {kind: str(line["color"]) for kind, line in LINES.items()}, "list": found}
