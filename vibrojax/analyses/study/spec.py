"""The specification of a study: a TOML file, a bundled name or a dict, checked before anything runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from vibrojax.analyses.catalogue import list_variables
from vibrojax.analyses.study.sampling import MAX_PARAMETERS, Sampling
from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.io.variables import VARIABLES
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.names import Names, read_names
from vibrojax.sweep.input.read import read_parameters, read_sweep
from vibrojax.sweep.input.source import read_source
from vibrojax.sweep.input.values import as_table, check_distinct, count, flag, warn_if_far

DEFAULT_SAMPLES = 256
"""Number of base samples if the file gives none."""

MAX_SAMPLES = 2**16

SHARE = "share_single_impact"
"""Name in `of` for the share of starts from which a point has a single impact."""

_KEYS = ("scene", "title", "of", "starts", "samples", "seed", "unusual", "vary", "parameters", "run")
_EXAMPLE = "write one like gamma = [0.6, 0.8]"


@dataclass(frozen=True, eq=False)
class Study:
    """A checked study: the variables `of` which it explains, the samples, and a sweep with one point per sample."""

    of: list[str]
    sampling: Sampling
    sweep: Sweep
    text: str

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        bounds = {f"vary.{name}": list(x) for name, x in self.sampling.bounds.items()}
        own = {"study": True, "of": self.of, "samples": self.sampling.samples, "seed": self.sampling.seed}
        return self.sweep.identity() | own | bounds


def read_study(source: str | PathLike[str] | Mapping[str, object]) -> Study:
    """Read a study from the path of a TOML file, the name of a bundled study, or a dict with the same structure.

    **Raises:** `InputError` with a one-line message at the first error.
    """
    origin = read_source(source, "study")
    place, tables = Place(origin.file), dict(origin.tables)
    for key in tables:
        if key not in _KEYS:
            raise place.at(key).error(f"unknown key; {suggestion(key, _KEYS)}")
    if "scene" not in tables:
        raise place.at("scene").error('missing; write the scene\'s name, like scene = "drilling"')
    fixed = dict(as_table(place.at("parameters"), tables.get("parameters", {})))
    table = dict(fixed)
    names = read_names(place.at("scene"), tables["scene"], table, place.at("parameters"))
    read_parameters(place.at("parameters"), table, names)
    sampling = Sampling(
        _read_bounds(place.at("vary"), tables.get("vary"), names, fixed),
        _read_samples(place.at("samples"), tables.get("samples", DEFAULT_SAMPLES)),
        count(place.at("seed"), tables.get("seed", 0), 0),
    )
    of = _read_of(place.at("of"), tables.get("of"), names)
    if not flag(place.at("unusual"), tables.get("unusual", False)):
        for name, bounds in sampling.bounds.items():
            meant = "; unusual = true says that it is meant"
            warn_if_far(place.at("vary").at(name), names.writable[name], np.array(bounds), meant=meant)
    columns = {name: x.tolist() for name, x in zip(sampling.names, sampling.points().T, strict=True)}
    kept: dict[str, object] = {key: tables[key] for key in ("scene", "starts", "run") if key in tables}
    title = tables.get("title") or f"Study of {', '.join(of)}"
    try:
        sweep = read_sweep({**kept, "title": title, "parameters": fixed, "points": columns, "unusual": True})
    except InputError as error:  # the points follow from the study, whose file the message is about
        raise InputError(str(error).replace("sweep:", f"{origin.file}:", 1)) from None
    return Study(of, sampling, sweep, origin.text)


def _read_of(place: Place, value: object, names: Names) -> list[str]:
    if not isinstance(value, list) or not value:
        problem = "missing" if value is None else f"{shown(value)} names no variable"
        raise place.error(f'{problem}; write a list like of = ["impact_energy", "blow_frequency"]')
    known = list_variables(names.system)
    own = [str(name) for name in known.index[known["where"] == ""]]
    plain = [name for name in own if name not in VARIABLES or not (VARIABLES[name].flags or VARIABLES[name].along)]
    allowed = plain + [SHARE] * ("impacts" in plain and "regime" in own)
    for index, name in enumerate(value):
        if name not in allowed:
            raise place.item(index).error(
                f"scene {shown(names.scene)} has no variable {shown(name)}; {suggestion(str(name), allowed)}"
            )
    check_distinct(place, value, "variable")
    return list(value)


def _read_bounds(place: Place, value: object, names: Names, fixed: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    table = as_table(place, value) if value is not None else {}
    if not table:
        raise place.error(f"{'missing' if value is None else 'empty'}, so nothing varies; {_EXAMPLE}")
    if len(table) > MAX_PARAMETERS:
        raise place.error(f"{len(table)} parameters vary; give at most {MAX_PARAMETERS}")
    bounds = {}
    for name, pair in table.items():
        here = place.at(name)
        names.parameter(here, name)
        if name in fixed:
            raise here.error("is in [parameters] as well; give it in one of the two")
        if not isinstance(pair, list) or len(pair) != 2:
            raise here.error(f"{shown(pair)} is not a pair of a least and a greatest value; {_EXAMPLE}")
        low, high = (names.quantity(here.item(k), name, x) for k, x in enumerate(pair))
        if not low < high:
            raise here.error(f"{shown(pair)}: {low:g} is not below {high:g}; write the least value first")
        bounds[name] = (low, high)
    places = {name: Place(place.file, f"parameters.{name}") for name in fixed}
    names.check_substitutes(places | {name: place.at(name) for name in bounds})
    return bounds


def _read_samples(place: Place, value: object) -> int:
    samples = count(place, value, 2, MAX_SAMPLES)
    if samples & (samples - 1):
        below = 1 << (samples.bit_length() - 1)
        raise place.error(f"{samples} is not a power of two; give {below} or {2 * below}")
    return samples
