"""Checked access to dataset attributes and flags.

`open_dataset` checks all known attributes. Code that needs an attribute reads it through this module, so that datasets
opened in another way are checked, too. Every function raises `InputError` with a one-line message that names the
attribute.
"""

import json
from collections.abc import Callable, Mapping
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


def _run(place: Place, value: object) -> dict[str, Any]:
    run = _json(place, value)
    for name in ("settle", "observe", "error"):
        if name in run:
            run[name] = float(_number(place.at(name), run[name]))
            if run[name] < 0:
                raise place.at(name).error(f"is {run[name]:g}; it must not be below 0")
    if not isinstance(run.get("carry", ""), (str, type(None))):
        raise place.at("carry").error(f"{shown(run['carry'])} is not the name of an axis")
    return run


def _numbers(place: Place, value: object) -> dict[str, float | int]:
    return {_name(place, name): _number(place.at(shown(name)), item) for name, item in _json(place, value).items()}


def _name(place: Place, value: object) -> str:
    if not isinstance(value, str) or not value.isidentifier() or len(value) > LONGEST_NAME:
        raise place.error(f"{shown(value)} is not the name of a parameter")
    return value


def _differing(place: Place, value: object) -> list[Differing]:
    rows: list[Differing] = []
    for index, item in enumerate(_json(place, value, list)):
        here = Place(f"{place.file}[{index}]")
        row = _json(here, item)
        rows.append(
            {
                "name": _name(here.at("name"), row.get("name")),
                "symbol": _text(here.at("symbol"), row.get("symbol", "")),
                "units": _text(here.at("units"), row.get("units", "")),
                "value": float(_number(here.at("value"), row.get("value"))),
                "default": float(_number(here.at("default"), row.get("default"))),
            }
        )
    return rows


def _columns(place: Place, value: object) -> dict[str, Any]:
    columns = _json(place, value)
    for name, about in columns.items():
        here = place.at(shown(name))
        if not isinstance(about, dict) or not isinstance(about.get("assumed"), bool):
            raise here.error(f"{shown(about)} does not say what was taken, in which unit")
        for key in ("unit", "given_in", "column"):
            _text(here.at(key), about.get(key, ""))
        if "value" in about:
            _number(here.at("value"), about["value"])
    return columns


def _dropped(place: Place, value: object) -> dict[str, Any]:
    dropped = _json(place, value)
    for reason, about in dropped.items():
        here = place.at(shown(reason))
        if not isinstance(about, dict):
            raise here.error(f"{shown(about)} does not say which rows were dropped")
        _number(here.at("rows"), about.get("rows"))
        _text(here.at("lines"), about.get("lines", ""))
    return dropped


def _orbits(place: Place, value: object) -> dict[str, Any]:
    orbits = _json(place, value)
    if "grazing_limit" in orbits:
        orbits["grazing_limit"] = float(_number(place.at("grazing_limit"), orbits["grazing_limit"]))
    return orbits


def _pair(place: Place, value: object, kind: type, what: str) -> list[Any]:
    items = np.asarray(value).ravel().tolist() if not isinstance(value, Mapping) else []
    if len(items) != 2 or not all(isinstance(item, kind) for item in items):
        raise place.error(f"{shown(value)} is not a pair of {what}")
    return items


_READERS: dict[str, Callable[[Place, object], Any]] = {
    **dict.fromkeys(("title", "scene", "friction", "pulse_shape", "start", "source", "jax", "history"), _text),
    **dict.fromkeys(("sweep", "along", "formulas", "reference", "settings"), _text),
    **dict.fromkeys(("dialect", "detected", "notes", "error_model"), _text),
    **dict.fromkeys(("solver", "identity", "machine", "attractors"), _json),
    **dict.fromkeys(("lanes", "wall_time_s", "rows_read", "reference_force"), _number),
    "run": _run,
    "parameters": _numbers,
    "differing": _differing,
    "certified": _numbers,
    "columns": _columns,
    "dropped": _dropped,
    "nulls": _numbers,
    "orbits": _orbits,
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
