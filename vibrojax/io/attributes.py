"""Checked access to dataset attributes and flags.

`open_dataset` checks all known attributes. Code that needs an attribute reads it through this module, so that datasets
opened in another way are checked, too. Every function raises `InputError` with a one-line message that names the
attribute.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import Place, printable, shown

LONGEST_TITLE = 200
"""Maximum number of displayed characters of a title: they fill two lines of a picture."""

LONGEST_TEXT = 1000
"""Maximum number of displayed characters of any other string."""

MOST_LINES = 100
"""Maximum number of displayed lines of a history."""

LARGEST = 1e300
"""Numbers of at least this absolute value are rejected as infinite: their sums and squares may overflow."""

LONGEST_NAME = 100
"""Maximum length of a parameter name [characters]."""


def check_attributes(ds: xr.Dataset) -> None:
    """Raise `InputError` if the value of a known attribute is malformed."""
    for name in _SCHEMA:
        attribute_of(ds, name)


def title_of(ds: xr.Dataset, otherwise: str = "") -> str:
    """Return the title shortened to one line, or `otherwise` if the dataset has no title."""
    return printable(attribute_of(ds, "title", "") or otherwise, LONGEST_TITLE)


def text_of(ds: xr.Dataset, name: str, otherwise: str = "") -> str:
    """Return a string attribute shortened to one line, or `otherwise` if the attribute is missing."""
    return printable(attribute_of(ds, name, otherwise), LONGEST_TEXT)


def run_of(ds: xr.Dataset) -> dict[str, Any]:
    """Return the run settings (empty if missing); `settle` [s], `observe` [s] and `error` are numbers where present."""
    return dict(attribute_of(ds, "run", {}))


def parameters_of(ds: xr.Dataset) -> dict[str, float]:
    """Return the fixed parameters in SI units, by name."""
    return {name: float(value) for name, value in attribute_of(ds, "parameters", {}).items()}


def parameter_units_of(ds: xr.Dataset) -> dict[str, str]:
    """Return the units of the parameters of a scene of the user's own, by name; empty for scenes of the package."""
    return {name: printable(unit, LONGEST_NAME) for name, unit in attribute_of(ds, "parameter_units", {}).items()}


def differing_of(ds: xr.Dataset) -> list[dict[str, Any]]:
    """Return name, symbol, units, value and default of the fixed parameters that differ from the default."""
    return list(attribute_of(ds, "differing", []))


def hole_radius_of(ds: xr.Dataset) -> float | None:
    """Return the fixed radius of the hole [m], which only `specific_energy` states; None if there is none."""
    attributes = ds["specific_energy"].attrs if "specific_energy" in ds else {}
    if "bit_radius" not in attributes:
        return None
    return _float(Place("specific_energy: attribute bit_radius"), attributes["bit_radius"])


def history_of(ds: xr.Dataset) -> list[str]:
    """Return the first `MOST_LINES` lines of the history, newest first, each shortened."""
    return [printable(line, LONGEST_TEXT) for line in str(attribute_of(ds, "history", "")).split("\n")[:MOST_LINES]]


def attribute_of(ds: xr.Dataset, name: str, otherwise: Any = None) -> Any:
    """Return the checked value of an attribute, or `otherwise` if the attribute is missing."""
    return _checked(Place(f"attribute {name}"), ds.attrs[name], _SCHEMA[name]) if name in ds.attrs else otherwise


def table_of(ds: xr.Dataset, name: str) -> dict[str, Any]:
    """Return an attribute that holds a JSON object as a dict, empty if the attribute is missing."""
    return dict(attribute_of(ds, name, {}))


def lane_count(ds: xr.Dataset) -> int | None:
    """Return the number of lanes in a dataset, which a selection or a union of datasets changes; None without lanes."""
    return ds["status"].size if "status" in ds and "lanes" in ds.attrs else attribute_of(ds, "lanes")


def certified_of(ds: xr.Dataset) -> dict[str, Any]:
    """Return the counts over the lanes that were computed together, empty if the dataset holds others."""
    counts = table_of(ds, "certified")
    return counts if counts.get("lanes") in (None, lane_count(ds)) else {}


def _checked(place: Place, value: Any, form: Any) -> Any:
    """Return a value that has a form of `_SCHEMA`; raise `InputError` otherwise."""
    if form is str or form is bool:
        if not isinstance(value, form):
            raise place.error(f"{shown(value)} is {'not a text' if form is str else 'neither true nor false'}")
        return value
    if isinstance(form, tuple):
        items = np.asarray(value).ravel().tolist() if not isinstance(value, Mapping) else []
        if len(items) != 2 or not all(map(isinstance, items, form)):
            raise place.error(f"{shown(value)} is not a pair of {'names' if form[0] is str else 'numbers'}")
        return items
    if not isinstance(form, (dict, list)):
        return form(place, value)
    content: Any = value
    if not isinstance(value, (dict, list)):  # Zarr stores JSON values without string encoding
        try:
            content = json.loads(_checked(place, value, str))
        except (ValueError, RecursionError):
            raise place.error(f"{shown(value)} is not JSON") from None
    wanted: Any = type(form)
    if not isinstance(content, wanted):
        raise place.error(f"{shown(content)} is not a JSON {'object' if wanted is dict else 'list'}")
    if isinstance(form, list):
        rows = [_checked(Place(f"{place.file}[{index}]"), row, form[0]) for index, row in enumerate(content)]
        return [{name.rstrip("?"): row.get(name.rstrip("?"), "") for name in form[0]} for row in rows]
    if ... in form:
        return {name: _checked(place.at(shown(name)), item, form[...]) for name, item in content.items()}
    found = {}
    for key, of in form.items():
        name = key.rstrip("?")
        if name == key or name in content:
            found[name] = _checked(place.at(name), content.get(name), of)
    return content | found


def _number(place: Place, value: object) -> float | int:
    number = value.item() if isinstance(value, np.number) else value
    if not isinstance(number, (int, float)) or isinstance(number, bool) or not abs(number) < LARGEST:
        raise place.error(f"{shown(value)} is not a finite number")
    return number


def _float(place: Place, value: object) -> float:
    return float(_number(place, value))


def _time(place: Place, value: object) -> float:
    if (number := _float(place, value)) < 0:
        raise place.error(f"is {number:g}; it must not be below 0")
    return number


def _axis(place: Place, value: object) -> str | None:
    return None if value is None else str(_checked(place, value, str))


def _name(place: Place, value: object) -> str:
    if not isinstance(value, str) or not value.isidentifier() or len(value) > LONGEST_NAME:
        raise place.error(f"{shown(value)} is not the name of a parameter")
    return value


def _numbers(place: Place, value: object) -> dict[str, float | int]:
    numbers: dict[str, float | int] = _checked(place, value, {...: _number})
    return {_name(place, name): number for name, number in numbers.items()}


_ROWS = {...: {"rows": _number, "lines?": str}}
_COLUMN = {"assumed": bool, "unit?": str, "given_in?": str, "column?": str, "value?": _number}

_SCHEMA: dict[str, Any] = {
    **dict.fromkeys(("title", "scene", "friction", "pulse_shape", "start", "source", "jax", "history"), str),
    **dict.fromkeys(("sweep", "along", "formulas", "reference", "settings"), str),
    **dict.fromkeys(("dialect", "detected", "notes", "error_model", "verdict"), str),
    **{name: {} for name in ("solver", "identity", "machine", "attractors")},
    **dict.fromkeys(("lanes", "wall_time_s", "rows_read", "reference_force"), _number),
    **dict.fromkeys(("parameters", "certified", "nulls"), _numbers),
    "run": {"settle?": _time, "observe?": _time, "error?": _time, "carry?": _axis},
    "robust": lambda place, value: value if isinstance(value, str) else _number(place, value),  # a loss, or 1
    "differing": [{"name": _name, "symbol?": str, "units?": str, "value": _float, "default": _float}],
    "parameter_units": {...: str},
    "columns": {...: _COLUMN},
    **dict.fromkeys(("dropped", "left_out_rows"), _ROWS),
    "orbits": {"grazing_limit?": _float},
    "span": (float, float),
    "axes": (str, str),
}
"""Form of each attribute: a type, a pair of types, a function that reads the value, or JSON. The entries of an object
are needed unless their name ends in `?`; `...` is any name. Of the objects in a list, other entries are left out."""


LONGEST_MEANING = 60
"""Maximum number of displayed characters of a flag's meaning: more would misalign the columns of a summary."""


def flags(variable: xr.DataArray) -> dict[int, str]:
    """Return a dict from the value of each flag to its meaning, empty if the variable has no flags."""
    values = np.atleast_1d(variable.attrs.get("flag_values", [])).tolist()
    meanings = str(variable.attrs.get("flag_meanings", "")).split()
    return {value: printable(meaning, LONGEST_MEANING) for value, meaning in zip(values, meanings, strict=False)}


def flag_counts(ds: xr.Dataset, name: str) -> dict[str, int]:
    """Return the number of values with each flag of variable `name`, keyed by meaning.

    Flags without any value are left out. The dict is empty if the variable is missing.
    """
    if name not in ds:
        return {}
    values = ds[name].values
    counts = {meaning: int((values == flag).sum()) for flag, meaning in flags(ds[name]).items()}
    return {meaning: count for meaning, count in counts.items() if count}
