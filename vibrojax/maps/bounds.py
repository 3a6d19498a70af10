"""Specifications whose parameters vary between bounds: their tables, bounds, and the sweep over points within."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from vibrojax.errors import InputError, Place, shown
from vibrojax.maps.read import read_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.toml import Source
from vibrojax.settings.values import as_table, known_keys, warn_if_far

MAX_VARIED = 12
"""Largest number of varied parameters: a dozen, as many as a person chooses by hand."""

MAX_TOLERANCES = 6
"""Largest number of parameters with a tolerance; six have 64 corners, and 192 edges."""

_EXAMPLE = "write one like gamma = [0.6, 0.8]"


def read_specification(origin: Source, keys: Collection[str]) -> tuple[Place, dict[str, Any], dict[str, object], Names]:
    """Return the place and tables of a specification with these keys, its fixed parameters, and the scene's names."""
    place, tables = Place(origin.file), dict(origin.tables)
    known_keys(place, tables, keys)
    if "scene" not in tables:
        raise place.at("scene").error('missing; write the scene\'s name, like scene = "vibro-impact"')
    fixed = dict(as_table(place.at("parameters"), tables.get("parameters", {})))
    return place, tables, fixed, read_names(place.at("scene"), tables["scene"], dict(fixed), place.at("parameters"))


def read_bounds(
    place: Place, value: object, names: Names, fixed: Mapping[str, object], unusual: bool = False
) -> dict[str, tuple[float, float]]:
    """Return the bounds of each varied parameter; `fixed`: values of the others; `unusual`: True to warn of nothing."""
    table = as_table(place, {} if value is None else value)
    if not table:
        raise place.error(f"{'missing' if value is None else 'empty'}, so nothing varies; {_EXAMPLE}")
    if len(table) > MAX_VARIED:
        raise place.error(f"{len(table)} parameters vary; give at most {MAX_VARIED}")
    bounds = {}
    for name, pair in table.items():
        here = place.at(name)
        parameter = names.parameter(here, name)
        if name in fixed:
            raise here.error("is in [parameters] as well; give it in one of the two")
        if not isinstance(pair, list) or len(pair) != 2:
            raise here.error(f"{shown(pair)} is not a pair of a least and a greatest value; {_EXAMPLE}")
        low, high = (names.quantity(here.item(k), name, end) for k, end in enumerate(pair))
        if not low < high:
            why = "the least value comes first" if low > high else "move one value to [parameters]"
            raise here.error(f"{shown(pair)} is no interval; {why}")
        bounds[name] = (low, high)
        if not unusual:
            warn_if_far(here, parameter, np.array(bounds[name]), meant="; unusual = true says that it is meant")
    places = {name: Place(place.file, f"parameters.{name}") for name in fixed}
    names.check_substitutes(places | {name: place.at(name) for name in bounds})
    return bounds


def read_points_of(file: str, tables: Mapping[str, object]) -> Sweep:
    """Return the sweep over the points of another specification, whose file and table the messages name."""
    run = tables.get("run")
    if isinstance(run, dict) and "carry" in run:
        raise Place(file, "run.carry").error("points have no axis along which lanes continue; leave it out")
    try:
        return read_sweep(tables)
    except InputError as error:
        words = str(error).replace("sweep:", f"{file}:", 1)
        raise InputError(words.replace(f"{file}: points.", f"{file}: vary.", 1)) from None
