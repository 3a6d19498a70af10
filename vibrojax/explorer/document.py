"""Parts of the JSON documents that describe datasets to the explorer page: axes, variables, colour maps, commands.

A dataset may be from an untrusted source, and a user may run the command that the page shows. Documents therefore
contain only scenes and names that the package or a plugin defines, and finite numbers; `calls.js` checks them again.
"""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import LogNorm, to_hex

from vibrojax.errors import InputError, Place, printable, shown
from vibrojax.explorer.encoding import pack
from vibrojax.io.attributes import (
    LONGEST_TEXT,
    certified_of,
    differing_of,
    flags,
    hole_radius_of,
    parameters_of,
    run_of,
    text_of,
    title_of,
)
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import HOLE_RADIUS
from vibrojax.physics.parameters import REPLACED
from vibrojax.pictures.axes import certified_text, is_geometric, number, point_text, pretty_unit, scale, symbol, typeset
from vibrojax.pictures.colours import REGIME_COLOURS, value_of
from vibrojax.pictures.contents import POINT, RETURN, START
from vibrojax.pictures.style import OTHER_COLOURS
from vibrojax.scenes import SCENES
from vibrojax.settings.names import known_options, read_names
from vibrojax.studies.attractors import BEYOND

Document = dict[str, Any]

SYMBOL_MAX_CHARACTERS = 40  # maximum length of a unit or symbol in the page; more would not fit next to an axis

COMMAND_MAX_SECONDS = 10_000.0
"""Longest duration in a command; a dataset may specify a duration whose simulation takes years."""

JAVASCRIPT_NAMES = {"__defineGetter__", "__defineSetter__", "__lookupGetter__", "__lookupSetter__", "__proto__"}
JAVASCRIPT_NAMES |= {"constructor", "hasOwnProperty", "isPrototypeOf", "propertyIsEnumerable", "toLocaleString"}
JAVASCRIPT_NAMES |= {"toString", "valueOf"}
"""Names that every JavaScript object has."""


REGIME_MEANINGS = {
    "undecided": "The motion still grows or decays, or returns too seldom, when the observation ends.",
    "equilibrium": "The bit comes to rest relative to the drive.",
    "impact-free": "The motion repeats after one return, without an impact.",
    "single-impact": "The motion repeats after one return, with one impact: the working cycle of the drill.",
    "multi-impact": "The motion repeats after one return, with two or more impacts.",
    "subharmonic": "The motion repeats only after several returns.",
    "irregular": "The motion does not repeat while it is observed: it is chaotic, quasi-periodic or still settling.",
    "failed": "The state is not finite, or the simulation did not reach the end.",
}
"""One sentence on each regime, which the page shows where its name is pointed at or has the focus."""

OWN_MEANINGS = {
    "equilibrium": "The motion comes to rest.",
    "single-impact": "The motion repeats after one return, with one impact.",
    "section": "An orbit begins or ceases to cross the section: beyond it, returns are counted differently.",
}
"""Sentences in place of those that speak of the drill, for systems of users."""

BORDER_MEANINGS = {
    "fold": "A stable and an unstable orbit meet and vanish.",
    "period-doubling": "The orbit loses its stability to one that repeats after twice as many returns.",
    "torus": "The orbit loses its stability to a motion with a second frequency.",
    "grazing": "An impact, or another event, appears or vanishes.",
    "stick": "A stick or a backward slip appears or vanishes.",
    "section": "The bit just catches up with the drive: beyond it, returns are counted differently.",
    "hopf": "The amplitude of the orbit shrinks to zero at an equilibrium.",
    "branch-point": "Another family of orbits crosses.",
    "end": "A bound is reached, or the family ends.",
    "basin": "The orbit goes on and is stable, but this start no longer leads to it.",
    "not-settled": "Beyond it, motions from this start had not settled when they were observed.",
}
"""One sentence on what happens at each kind of border, curve and special point."""


def reading_text(ds: xr.Dataset) -> str:
    """Return how many motions of a sweep repeat, and how many of these are not known to the error tolerance."""
    counts, lanes = certified_of(ds), int(ds["regime"].size) if "regime" in ds else 0
    if not counts.get("estimated") or not {"within", "error"} <= set(counts):
        return certified_text(ds)
    estimated, beyond = round(counts["estimated"]), round(counts["estimated"] - counts["within"])
    total = f"{lanes:,}" if lanes >= estimated else "the"
    known = f"all but {beyond:,} of these" if beyond else "all of these"
    tolerance = np.format_float_scientific(counts["error"], trim="-", exp_digits=1)
    failed = certified_text(ds).partition(". ")[2]
    text = f"{estimated:,} of {total} motions repeat; {known} are exact to {tolerance}"
    return ". ".join(part for part in (text, failed) if part)


def common_text(ds: xr.Dataset) -> str:
    """Return the values common to all lanes; of a system of a user with all its parameters, which have no list."""
    point = point_text(ds)
    listed = {*ds.coords, *(row["name"] for row in differing_of(ds)), *(x.split(" = ")[0] for x in point.split(", "))}
    scene = text_of(ds, "scene")
    values = {} if not scene or scene in SCENES else parameters_of(ds)
    defaults = [f"{printable(name, 40)} = {number(value)}" for name, value in values.items() if name not in listed]
    return ", ".join(filter(None, [*defaults, point]))


def check_names(ds: xr.Dataset) -> None:
    """Raise `InputError` if a name cannot be a key of a JavaScript object, because every object has that name."""
    for name in (*ds.sizes, *ds.variables):
        if name in JAVASCRIPT_NAMES:
            raise InputError(f"explore: {shown(str(name))} cannot be the name of a variable in a page; rename it")


def one_line(text: object, longest: int = 200) -> str:
    """Return a string of a dataset on one line, shortened, without matplotlib's escapes, with subscripts of ratios."""
    return printable(typeset(str(text).replace(r"\$", "$")), longest)


def json_value(value: object, digits: int = 10) -> object:
    """Return a value for JSON: a float rounded to `digits`, or None if it is not finite; other values as strings."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if np.isfinite(value) else None
    return value if isinstance(value, int) else str(value)


def document_with(ds: xr.Dataset, kind: str, variables: list[Document], **parts: object) -> Document:
    """Return the JSON document of a dataset; `parts` are keys that only some documents have."""
    notes, own = [reading_text(ds), common_text(ds)], text_of(ds, "scene") not in SCENES
    if run_seconds(ds) > COMMAND_MAX_SECONDS:
        notes.append(f"Each lane ran for {run_seconds(ds):g} s; the commands simulate {COMMAND_MAX_SECONDS:g} s")
    map_names = dict.fromkeys(variable["map"] for variable in variables if variable["map"])
    document = {
        "format": 1,
        "kind": kind,
        "title": title_of(ds),
        "scene": text_of(ds, "scene"),
        "machine": {name: x for name, x in parameters_of(ds).items() if name in ("v", "delta", "bit_radius")},
        "source": text_of(ds, "source"),
        "common": one_line(common_text(ds), LONGEST_TEXT),
        "notes": [one_line(note, LONGEST_TEXT) for note in notes if note],
        "variables": variables,
        "meanings": REGIME_MEANINGS | BORDER_MEANINGS | (OWN_MEANINGS if own else {}),
        "maps": {name: [to_hex(colormaps[name](level)) for level in range(256)] for name in map_names},
    }
    return document | {"axes": [], "fixed": {}, "view": [], "first": {}} | parts


def axis_document(ds: xr.Dataset, name: str) -> Document:
    """Return the description of an axis: its values or names, and the coordinates along a list of points or starts."""
    counted = xr.DataArray(np.arange(ds.sizes[name]), dims=name, name=name)
    columns = [
        coordinate_document(data)
        for other, data in ds.coords.items()
        if data.dims == (name,) and str(other) != name and (data.dtype.kind in "fiu" or other != START)
    ]
    axis = coordinate_document(ds[name] if name in ds.coords else counted)
    return axis | {"columns": columns if name in (POINT, START) else []}


def coordinate_document(data: xr.DataArray) -> Document:
    """Return the description of a coordinate: label, symbol, values (SI), displayed unit, and factor to that unit."""
    numeric = data.dtype.kind in "fiu"
    factor, unit = scale(data) if numeric else (1.0, "")
    values = np.asarray(data.values, float) if numeric else data.values
    return {
        "name": str(data.name),
        "label": one_line(data.attrs.get("long_name", "")) or str(data.name).replace("_", " "),
        "symbol": one_line(symbol(data), SYMBOL_MAX_CHARACTERS),
        "units": one_line(pretty_unit(unit), SYMBOL_MAX_CHARACTERS),
        "factor": factor,
        "numeric": numeric,
        "log": bool(numeric and is_geometric(values)),
        "values": [json_value(x) if numeric else one_line(x) for x in values.tolist()],
    }


def variable_document(data: xr.DataArray, of_attractors: Sequence[str] = ()) -> Document:
    """Return the description of a variable: meaning, colours and values; of multipliers, only the largest.

    `flags` are meanings by flag; colours of other variables are those of `map`, from `low` to `high`; `inner` is the
    axis of several values of a cell, such as its returns, and `count` their number.
    """
    data = data.isel(multiplier=0) if "multiplier" in data.dims else data
    value = value_of(data)
    meanings = {str(flag): name for flag, name in flags(data).items()} if value.names else None
    palette = {number: to_hex(value.colour_map(value.norm(number))) for number in value.names}
    if data.name == "lane_attractor":
        numbers = np.unique(data.values).astype(int).tolist()
        meanings = {str(n): f"attractor {n}" if n >= 0 else "unassigned" for n in numbers}
        palette = dict.fromkeys(numbers, BEYOND) | dict(enumerate(of_attractors))
    elif meanings is not None and "single-impact" in meanings.values():
        palette = REGIME_COLOURS
    shades = [palette.get(int(flag), OTHER_COLOURS[int(flag) % len(OTHER_COLOURS)]) for flag in meanings or ()]
    label = "\n".join(one_line(line) for line in value.label.split("\n")[:3])
    return {
        "name": str(data.name),
        "label": label if meanings is None else str(data.name).replace("_", " "),
        "long_name": one_line(data.attrs.get("long_name", "")) or str(data.name),
        "units": one_line(pretty_unit(scale(data)[1]), SYMBOL_MAX_CHARACTERS) if meanings is None else "",
        "factor": value.factor,
        "axes": [str(name) for name in data.dims],
        "flags": meanings,
        "colours": None if meanings is None else dict(zip(meanings, shades, strict=True)),
        "map": None if meanings is not None else value.colour_map.name,
        "low": float(value.norm.vmin or 0.0),
        "high": float(value.norm.vmax or 1.0),
        "log": isinstance(value.norm, LogNorm),
        "extend": value.extend,
        "nothing_at_zero": value.of_rate,
        "whole": data.dtype.kind in "iu" and meanings is None,
        "data": pack(np.asarray(data.values)),
    } | ({"inner": RETURN, "count": data.sizes[RETURN]} if RETURN in data.dims else {})


def run_document(ds: xr.Dataset, sweep: Sweep | None = None) -> Document:
    """Return the parts of the command that simulates a lane: parameters other than the defaults, options and start.

    The result is `{"own_scene": True}`, without a command, if the scene with its options has no name.
    """
    try:
        scene, options = (text_of(ds, "scene"), options_of(ds)) if sweep is None else (sweep.system.name, sweep.options)
        names = read_names(Place("explore", "scene"), scene, options)
    except InputError:
        return {"own_scene": True}
    if (sweep is not None and names.system != sweep.system) or names.scene not in SCENES:
        return {"own_scene": True}
    start = start_of(ds) if names.has_starts else None
    try:
        start = None if start is None else names.start(Place("explore", "start"), start)
    except InputError:  # the scene has no such initial condition
        start = None
    return {
        "own_scene": False,
        "scene": names.scene,
        "parameters": {name: value for name, value in given_of(ds).items() if name in names.writable},
        # A command leaves out the defaults.
        "options": {key: word for key, word in names.options.items() if word not in ("stribeck", "rectangular")},
        "start": start,
        "duration": command_seconds(run_seconds(ds)),
        "names": list(names.writable),
        "starts": list(names.starts),
        "states": list(names.system.start_states),
        "rocks": list(names.presets.get("rock", ())),
    }


def run_seconds(ds: xr.Dataset) -> float:
    """Return the duration of each lane [s], settling and observation together."""
    run = run_of(ds)
    return float(run.get("settle", 40.0)) + float(run.get("observe", 8.0))


def command_seconds(seconds: float) -> float:
    """Return the duration [s] for a command, limited and rounded."""
    return float(f"{min(seconds, COMMAND_MAX_SECONDS):.6g}")


def given_of(ds: xr.Dataset) -> dict[str, Any]:
    """Return the parameters, and the names that replace one, such as `bit_frequency`, that are not the defaults."""
    radius = hole_radius_of(ds)
    given: dict[str, Any] = {row["name"]: row["value"] for row in differing_of(ds)}
    given |= {name: value for name, value in parameters_of(ds).items() if name in REPLACED}
    return given | ({} if radius in (None, HOLE_RADIUS) else {"bit_radius": radius})


def options_of(ds: xr.Dataset) -> dict[str, str]:
    """Return the options of the scene of a dataset, such as its friction law."""
    return {option: text_of(ds, option) for option in known_options() if option in ds.attrs}


def start_of(ds: xr.Dataset) -> object:
    """Return the initial condition in the attributes of a dataset: a name or a vector, or None if there is none."""
    text = text_of(ds, "start").strip('"')
    try:
        return json.loads(text) if text.startswith("[") else text or None
    except (ValueError, RecursionError):
        return text
