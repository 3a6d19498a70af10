"""Checked access to dataset attributes and flags.

`open_dataset` checks all known attributes. Code that needs an attribute reads it through this module, so that datasets
opened in another way are checked, too. Every function raises `InputError` with a one-line message that names the
attribute.
"""

import json
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any, TypedDict

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


Reader = Callable[[Place, Any], Any]
"""Function that returns a checked value."""


class Differing(TypedDict):
    """A parameter whose value differs from the default."""

    name: str
    symbol: str
    units: str
    value: float
    default: float


def check_attributes(ds: xr.Dataset) -> None:
    """Raise `InputError` if the value of a known attribute is malformed."""
    for name in _READERS:
        _read(ds, name, None)


def title_of(ds: xr.Dataset, otherwise: str = "") -> str:
    """Return the title shortened to one line, or `otherwise` if the dataset has no title."""
    return printable(_read(ds, "title", "") or otherwise, LONGEST_TITLE)


def text_of(ds: xr.Dataset, name: str, otherwise: str = "") -> str:
    """Return a string attribute shortened to one line, or `otherwise` if the attribute is missing."""
    return printable(_read(ds, name, otherwise), LONGEST_TEXT)


def run_of(ds: xr.Dataset) -> dict[str, Any]:
    """Return the run settings (empty if missing); `settle` [s], `observe` [s] and `error` are numbers where present."""
    run: dict[str, Any] = _read(ds, "run", {})
    return run


def parameters_of(ds: xr.Dataset) -> dict[str, float]:
    """Return the fixed parameters in SI units, by name."""
    return {name: float(value) for name, value in _read(ds, "parameters", {}).items()}


def differing_of(ds: xr.Dataset) -> list[Differing]:
    """Return the fixed parameters whose values differ from the defaults."""
    differing: list[Differing] = _read(ds, "differing", [])
    return differing


def hole_radius_of(ds: xr.Dataset) -> float | None:
    """Return the fixed radius of the hole [m], which only `specific_energy` states; None if there is none."""
    attributes = ds["specific_energy"].attrs if "specific_energy" in ds else {}
    if "bit_radius" not in attributes:
        return None
    return _float(Place("specific_energy: attribute bit_radius"), attributes["bit_radius"])


def history_of(ds: xr.Dataset) -> list[str]:
    """Return the first `MOST_LINES` lines of the history, newest first, each shortened."""
    return [printable(line, LONGEST_TEXT) for line in str(_read(ds, "history", "")).split("\n")[:MOST_LINES]]


def attribute_of(ds: xr.Dataset, name: str) -> Any:
    """Return the checked value of an attribute, or None if the attribute is missing."""
    return _read(ds, name, None)


def table_of(ds: xr.Dataset, name: str) -> dict[str, Any]:
    """Return an attribute that holds a JSON object as a dict, empty if the attribute is missing."""
    table: dict[str, Any] = _read(ds, name, {})
    return table


def lane_count(ds: xr.Dataset) -> int | None:
    """Return the number of lanes in a dataset, which a selection or a union of datasets changes; None without lanes."""
    return ds["status"].size if "status" in ds and "lanes" in ds.attrs else attribute_of(ds, "lanes")


def certified_of(ds: xr.Dataset) -> dict[str, Any]:
    """Return the counts over the lanes that were computed together, empty if the dataset holds others."""
    counts = table_of(ds, "certified")
    return counts if counts.get("lanes") in (None, lane_count(ds)) else {}


def _read(ds: xr.Dataset, name: str, otherwise: Any) -> Any:
    if name not in ds.attrs:
        return otherwise
    return _READERS[name](Place(f"attribute {name}"), ds.attrs[name])


def _text(place: Place, value: object) -> str:
    if not isinstance(value, str):
        raise place.error(f"{shown(value)} is not a text")
    return value


def _json(place: Place, value: object, kind: type = dict) -> Any:
    if not isinstance(value, (dict, list)):  # Zarr stores JSON values without string encoding
        try:
            value = json.loads(_text(place, value))
        except (ValueError, RecursionError):
            raise place.error(f"{shown(value)} is not JSON") from None
    if not isinstance(value, kind):
        raise place.error(f"{shown(value)} is not a JSON {'object' if kind is dict else 'list'}")
    return value


def _number(place: Place, value: object) -> float | int:
    number = value.item() if isinstance(value, np.number) else value
    if not isinstance(number, (int, float)) or isinstance(number, bool) or not abs(number) < LARGEST:
        raise place.error(f"{shown(value)} is not a finite number")
    return number


def _float(place: Place, value: object, least: float = -LARGEST) -> float:
    number = float(_number(place, value))
    if number < least:
        raise place.error(f"is {number:g}; it must not be below {least:g}")
    return number


def _axis(place: Place, value: object) -> str | None:
    return None if value is None else _text(place, value)


def _flag(place: Place, value: object) -> bool:
    if not isinstance(value, bool):
        raise place.error(f"{shown(value)} is neither true nor false")
    return value


def _name(place: Place, value: object) -> str:
    if not isinstance(value, str) or not value.isidentifier() or len(value) > LONGEST_NAME:
        raise place.error(f"{shown(value)} is not the name of a parameter")
    return value


def _numbers(place: Place, value: object) -> dict[str, float | int]:
    return {_name(place, name): _number(place.at(shown(name)), item) for name, item in _json(place, value).items()}


def _entries(place: Place, value: object, readers: Mapping[str, Reader], needed: Collection[str] = ()) -> Any:
    """Return a JSON object, in which `readers` read the entries with their names; those in `needed` must be there."""
    table = _json(place, value)
    names = [name for name in readers if name in table or name in needed]
    return table | {name: readers[name](place.at(name), table.get(name)) for name in names}


def _each(place: Place, value: object, read: Reader) -> dict[str, Any]:
    """Return a JSON object of which `read` reads every value."""
    return {name: read(place.at(shown(name)), item) for name, item in _json(place, value).items()}


def _differing(place: Place, value: object) -> list[Differing]:
    readers: dict[str, Reader] = {"name": _name, "symbol": _text, "units": _text, "value": _float, "default": _float}
    rows: list[Any] = []
    for index, row in enumerate(_json(place, value, list)):
        here = Place(f"{place.file}[{index}]")
        table = _entries(here, {"symbol": "", "units": "", **_json(here, row)}, readers, readers)
        rows.append({name: table[name] for name in readers})
    return rows


def _pair(place: Place, value: object, kind: type, what: str) -> list[Any]:
    items = np.asarray(value).ravel().tolist() if not isinstance(value, Mapping) else []
    if len(items) != 2 or not all(isinstance(item, kind) for item in items):
        raise place.error(f"{shown(value)} is not a pair of {what}")
    return items


_TIME = partial(_float, least=0.0)
_ROWS = partial(_entries, readers={"rows": _number, "lines": _text}, needed=("rows",))
_COLUMN = {"assumed": _flag, "unit": _text, "given_in": _text, "column": _text, "value": _number}

_READERS: dict[str, Reader] = {
    **dict.fromkeys(("title", "scene", "friction", "pulse_shape", "start", "source", "jax", "history"), _text),
    **dict.fromkeys(("sweep", "along", "formulas", "reference", "settings"), _text),
    **dict.fromkeys(("dialect", "detected", "notes", "error_model", "verdict"), _text),
    **dict.fromkeys(("solver", "identity", "machine", "attractors"), _json),
    **dict.fromkeys(("lanes", "wall_time_s", "rows_read", "reference_force"), _number),
    **dict.fromkeys(("parameters", "certified", "nulls"), _numbers),
    "run": partial(_entries, readers={"settle": _TIME, "observe": _TIME, "error": _TIME, "carry": _axis}),
    "robust": lambda place, value: value if isinstance(value, str) else _number(place, value),  # a loss, or 1
    "differing": _differing,
    "columns": partial(_each, read=partial(_entries, readers=_COLUMN, needed=("assumed",))),
    **dict.fromkeys(("dropped", "left_out_rows"), partial(_each, read=_ROWS)),
    "orbits": partial(_entries, readers={"grazing_limit": _float}),
    "span": partial(_pair, kind=float, what="numbers"),
    "axes": partial(_pair, kind=str, what="names"),
}


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
