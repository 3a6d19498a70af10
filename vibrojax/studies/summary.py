"""The summary of a dataset, as lines of text and as facts for JSON."""

import json
from typing import Any

import xarray as xr

from vibrojax.errors import printable
from vibrojax.io.attributes import (
    attribute_of,
    certified_of,
    differing_of,
    history_of,
    hole_radius_of,
    lane_count,
    parameter_units_of,
    parameters_of,
    run_of,
    text_of,
    title_of,
)
from vibrojax.io.kinds import kind_of
from vibrojax.measures.labels import HOLE_RADIUS
from vibrojax.studies import WORDS
from vibrojax.studies.analysis import SummaryPart, analysis_of
from vibrojax.studies.sweep import lane_parts

LONGEST_LINE = 2000
"""Greatest number of characters printed per line."""

LONGEST_FACT = 300
"""Greatest number of characters of a unit, a meaning or a name in JSON."""

_TEXTS = ("title", "scene", "friction", "pulse_shape", "start", "source", "jax", "along")
_VALUES = ("parameters", "differing", "run", "solver", "columns", "wall_time_s")
_EMPTY = ("regimes", "orbits", "natures", "families", "attractors", "failures", "found")
"""JSON keys that every summary has; they hold an empty object if they do not apply."""


_COMPARED = {
    "drilling": "the hole does not act back on striker and bit; with that, in coupled-drilling, rates are others",
    "coupled-drilling": "the hole acts back on striker and bit; drilling neglects that, and its rates are others",
}
"""What one of the two drills in rock neglects and the other has."""


def summarise(ds: xr.Dataset) -> list[SummaryPart]:
    """Return the parts of a dataset's summary; parts that do not apply have no lines."""
    of_lanes, scene, run = lane_parts(ds), text_of(ds, "scene"), run_of(ds)
    times = {"settle", "observe"} <= set(run)
    lasts = f"settled for {run['settle']:g} s, observed for {run['observe']:g} s" if times else ""
    others = (name for name in run if name not in ("settle", "observe"))
    settings = ", ".join(f"{name} = {json.dumps(run[name])}" for name in others)
    shape = text_of(ds, "pulse_shape")
    return [
        SummaryPart("title", [title_of(ds)] if title_of(ds) else []),
        SummaryPart("scene", [*filter(None, [scene, _COMPARED.get(scene)])]),
        SummaryPart("grid", [_dimension(ds, str(name))[0] for name in ds.sizes]),
        SummaryPart("lanes", [f"{lane_count(ds)} (a lane: {WORDS['lane']})"] if "lanes" in ds.attrs else []),
        *(SummaryPart(name, [text_of(ds, name)] if name in ds.attrs else []) for name in ("friction", "start")),
        SummaryPart("fixed", [f"pulse_shape = {shape}"] * bool(shape) + _fixed_lines(ds)),
        SummaryPart("run", [*filter(None, [lasts, settings])]),
        *(of_lanes[name] for name in ("regimes", "orbits", "natures")),
        *analysis_of(ds).summary(ds),
        *(of_lanes[name] for name in ("failures", "accuracy")),
        SummaryPart("variables", [", ".join(str(name) for name in ds.data_vars)]),
        *(SummaryPart(name, [str(ds.attrs[name])]) for name in ("solver", "source", "jax") if name in ds.attrs),
        SummaryPart("history", history_of(ds) if "history" in ds.attrs else []),
        SummaryPart("wall time", [f"{attribute_of(ds, 'wall_time_s'):.3g} s"] if "wall_time_s" in ds.attrs else []),
    ]


def summary_lines(parts: list[SummaryPart]) -> list[str]:
    """Format a summary as lines of text; the first line of each part begins with the part's name."""

    def indented(line: str) -> str:
        words = line.lstrip(" ")
        return line[: len(line) - len(words)] + printable(words, LONGEST_LINE, keep_spaces=True)

    rows = ((part.name if index == 0 else "", line) for part in parts for index, line in enumerate(part.lines))
    return [f"{name:<9} {indented(line)}".rstrip() for name, line in rows]


def summary_facts(ds: xr.Dataset, file: str) -> dict[str, Any]:
    """Return a summary with stable keys; values that do not apply to the dataset are null or empty.

    `file`, `kind`, `title`, `scene`, `friction`, `pulse_shape`, `start`, `source`, `jax`, `along`, `history` (lines,
    the newest first); `dimensions` and `variables` by name; `parameters`, also the radius of the hole as `bit_radius`;
    `differing`, `run`, `solver`, `columns`, `certified` as in the dataset's attributes; `lanes`; `regimes`: number of
    lanes by regime; `orbits`: number of lanes by `reason` and by `stable`; `natures`: number of lanes by nature;
    `families`: as `follow --json` prints them; `attractors`: mean fraction over the grid by attractor number
    (`shares`), and number of lanes `unassigned`; `failures`: number of lanes by reason; `accuracy`; `found`: features
    of a single trajectory; `wall_time_s`; and keys that an analysis adds.
    """
    facts: dict[str, Any] = {
        "file": file,
        "kind": kind_of(ds) or None,
        **{name: text_of(ds, name) if name in ds.attrs else None for name in _TEXTS},
        "history": history_of(ds),
        "dimensions": {str(name): _dimension(ds, str(name))[1] for name in ds.sizes},
        **{name: attribute_of(ds, name) for name in _VALUES},
        "certified": certified_of(ds) or None,
        "lanes": lane_count(ds),
        **{name: {} for name in _EMPTY},
    }
    if facts["parameters"] is not None:
        facts["parameters"] = _parameters(ds)
    for part in summarise(ds):
        facts |= part.facts
    variables = {
        str(name): {"dims": list(data.dims), **{key: _attribute(data, key) for key in ("units", "long_name")}}
        for name, data in ds.data_vars.items()
    }
    return facts | {"variables": variables}


def _parameters(ds: xr.Dataset) -> dict[str, float]:
    """Return the fixed parameters, with the radius of the hole, which no equation has."""
    radius = hole_radius_of(ds)
    return parameters_of(ds) | ({} if radius is None else {"bit_radius": radius})


def _fixed_lines(ds: xr.Dataset) -> list[str]:
    """Format the fixed parameters: one line for each that differs from its default, then one line for the others."""
    if "parameters" not in ds.attrs:
        return []
    values, changed = _parameters(ds), {}
    for row in differing_of(ds):
        unit = "" if row["units"] == "1" else f" {row['units']}"
        changed[row["name"]] = f"{row['name']} = {row['value']:g}{unit} (default {row['default']:g})"
    if "differing" in ds.attrs and values.get("bit_radius", HOLE_RADIUS) != HOLE_RADIUS:
        changed["bit_radius"] = f"bit_radius = {values['bit_radius']:g} m (default {HOLE_RADIUS:g})"
    units = parameter_units_of(ds)
    others = ", ".join(
        f"{name} = {value:g} {units.get(name, '')}".rstrip() for name, value in values.items() if name not in changed
    )
    default = "by default: " if "differing" in ds.attrs else ""
    return [*changed.values(), *([default + others] if others else [])]


def _dimension(ds: xr.Dataset, name: str) -> tuple[str, dict[str, Any]]:
    """Return the size of a dimension, and unit, first and last value of its coordinate, as text and as JSON values."""
    size = ds.sizes[name]
    if name not in ds.coords or not size:
        return f"{name}: {size}", {"size": size}
    values, units = ds[name].values, _attribute(ds[name], "units")
    first, last = values[0], values[-1]
    if values.dtype.kind in "fiu":
        unit = ds[name].attrs.get("units", "1")
        text = f"{name}: {first:g} to {last:g}{'' if unit == '1' else f' {unit}'} ({size})"
    else:
        text = f"{name}: {', '.join(map(str, values[:8]))}{', ...' if size > 8 else ''} ({size})"
        first, last = printable(first, LONGEST_FACT), printable(last, LONGEST_FACT)
    return text, {"size": size, "units": units, "first": first, "last": last}


def _attribute(data: xr.DataArray, name: str) -> str | None:
    return printable(data.attrs[name], LONGEST_FACT) if name in data.attrs else None
