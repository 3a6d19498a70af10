"""Sources of a sweep: a file, a bundled name or a dict. `--set NAME=VALUE` overrides single values.

This module also converts a dict to TOML. A general TOML writer (tomli-w) puts tables after values, which would change
the order of a grid's axes.
"""

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.io.files import read_text
from vibrojax.physics.arrays import check_untraced
from vibrojax.physics.friction import FrictionLaw
from vibrojax.physics.units import magnitude, stated_scale, stated_unit
from vibrojax.scenes import Scene
from vibrojax.settings.names import read_names
from vibrojax.settings.run_settings import RunSettings
from vibrojax.settings.values import TOP_KEYS, require_number
from vibrojax.stepping import Stepper

_PACKAGE = Path(__file__).parents[1]
# A wheel contains the sweeps inside the package. In a checkout, they are in the root folder. Studies and designs have
# folders of their own there.
_CHECKOUT = (_PACKAGE.parent,) if (_PACKAGE.parent / "pyproject.toml").exists() else ()
BUNDLED_FOLDERS = tuple(folder / "sweeps" for folder in (_PACKAGE, *_CHECKOUT))
_SUBFOLDERS = {"sweep": "", "study": "studies", "design": "designs"}

TABLES = ("parameters", "grid", "run")

Units = Callable[[], Mapping[str, str]]
"""Function that returns units by the name of what is assigned."""

_OBJECTS = (Scene, FrictionLaw, Stepper)
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")

_DECIMAL_COMMA = re.compile(r"^\s*([\w.]+)\s*=\s*(-?\d+),(\d+)\s*$", re.MULTILINE)


@dataclass(frozen=True)
class Source:
    """A sweep before validation.

    - `name`: name of the sweep.
    - `file`: file name in messages.
    - `folder`: folder to which paths in the sweep are relative.
    - `text`: the sweep as TOML. `tables`: the parsed TOML.
    """

    name: str
    file: str
    folder: Path
    text: str
    tables: dict[str, object]


def read_source(source: str | PathLike[str] | Mapping[str, object], noun: str = "sweep") -> Source:
    """Read a sweep from the path of a TOML file, the name of a bundled sweep, or a dict with the same structure.

    `noun`: "sweep", or "study", "design" or "calibration", which are read in the same way. In a dict, a scene, a
    friction law or a stepper may be an object instead of a name.
    """
    if hasattr(source, "data_vars"):
        raise InputError(f"{noun}: a dataset is not a {noun}; give a path, a bundled name or a dict")
    if isinstance(source, Mapping):
        tables = plain_table(Place(noun), source)
        return Source(noun, noun, Path(), render(tables), tables)
    if not isinstance(source, (str, PathLike)):
        raise InputError(f"{noun}: {shown(source)} is not a {noun}; give a path, a bundled name or a dict")
    is_name = isinstance(source, str) and Path(source).name == source and not source.endswith(".toml")
    bundled = {path.stem.replace("_", "-"): path for path in reversed(_bundled(noun))} if is_name else {}
    path = bundled.get(str(source).replace("_", "-"), Path(source))
    if is_name and path == Path(source) and not path.exists():
        if not (names := bundled_names(noun)):
            raise InputError(f"{source}: no such file; give the path of a {noun}, which ends in .toml")
        raise InputError(f"{source}: no such bundled {noun} or file; {suggestion(str(source), names)}")
    if path.suffix in (".nc", ".zarr") and path.exists():
        raise InputError(f"{path}: is a dataset, not a {noun}; vibrojax info {path} and vibrojax plot {path} take it")
    text = read_text(path)
    try:
        tables = tomllib.loads(text)
    except ValueError as error:  # not TOMLDecodeError: numbers with thousands of digits raise a ValueError
        comma = _DECIMAL_COMMA.search(text)
        right = f"; {comma[0].strip()}: write a decimal point, {comma[1]} = {comma[2]}.{comma[3]}" if comma else ""
        list_of = f", or a list, {comma[1]} = [{comma[2]}, {comma[3]}]" if comma else ""
        raise Place(str(path)).error(f"not TOML: {error}{right}{list_of}") from None
    except RecursionError:
        raise InputError(f"{path}: not TOML: tables or lists nested too deep") from None
    return Source(path.stem if path == Path(source) else str(source), str(path), path.parent, text, tables)


def with_changes(source: Source, words: Iterable[str]) -> Source:
    """Return the sweep with values replaced according to `words`, strings of the form NAME=VALUE.

    NAME is a key of [run], `scene`, `title`, `starts` or `unusual`, or a parameter. A number or a name fixes a
    parameter, and a list or a range makes it an axis, no matter in which table it was before. NAME may include the
    table, as in `run.settle`, `parameters.k1` and `grid.beta`.

    **Raises:** `InputError` if a string does not have the form NAME=VALUE.
    """
    tables = {key: dict(value) if isinstance(value, dict) else value for key, value in source.tables.items()}
    place, known = Place("--set"), set[str]()
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name:
            raise place.error(f"{shown(word)} is not NAME=VALUE; write one, like k1=312500 or run.settle=200")
        if name in known:
            raise place.at(name).error(f"{shown(text)} is a second value; give one")
        known.add(name)
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except (ValueError, RecursionError):
            value = text
        here, (table, dot, key) = place.at(name), name.partition(".")
        if dot and table not in TABLES:
            raise here.error(f"unknown table {shown(table)}; {suggestion(table, TABLES)}")
        if not dot:
            key, varies = name, isinstance(value, (list, dict))
            is_setting = name in RunSettings.__dataclass_fields__
            table = "" if name in TOP_KEYS else "run" if is_setting else "grid" if varies else "parameters"
        if table in ("parameters", "grid"):
            for former in (tables.get("parameters"), tables.get("grid")):
                if isinstance(former, dict):
                    former.pop(key, None)
        home = tables.setdefault(table, {}) if table else tables
        if not isinstance(home, dict):
            raise here.error(f"[{table}] is not a table in the sweep; nothing can be set in it")
        home[key] = value
    return replace(source, tables=tables, text=render(tables))


def bundled_names(noun: str = "sweep") -> list[str]:
    """Return the names of the bundled sweeps, or of the studies or designs if `noun` is "study" or "design".

    Hyphens and underscores are interchangeable in these names.
    """
    return sorted({path.stem.replace("_", "-") for path in _bundled(noun)})


def _bundled(noun: str) -> list[Path]:
    folders = [folder / _SUBFOLDERS[noun] for folder in BUNDLED_FOLDERS] if noun in _SUBFOLDERS else []
    return [path for folder in folders for path in sorted(folder.glob("*.toml"))]


def plain_table(place: Place, value: Mapping[str, object], units: Units = dict) -> dict[str, object]:
    """Return a table with its values converted by [vibrojax.settings.toml.plain][].

    A table with a scene has the units of this scene.
    """
    for key in value:
        if not isinstance(key, str):
            raise place.error(f"{shown(key)} is not a name; keys are text")
    if "scene" in value:
        options: Any = value["parameters"] if isinstance(value.get("parameters"), Mapping) else {}
        units = lambda: read_names(place.at("scene"), value["scene"], dict(options), place.at("parameters")).units  # noqa: E731
    return {key: plain(place.at(key), item, units) for key, item in value.items()}


def plain(place: Place, value: object, units: Units = dict) -> object:
    """Return `value` as TOML types. Arrays, series and numbers, tuples, paths and DataFrames are converted.

    Scenes, friction laws and steppers are returned unchanged, because a sweep accepts them in place of their names.

    **Arguments:** `units`: function that returns units by name. An array that states its unit is converted to that of
    its name; without one, it must be in SI units.
    """
    if hasattr(value, "data_vars"):  # of xarray, where a parameter may be a coordinate
        dataset: Any = value
        value = {name: x for name, x in dataset.variables.items() if name in dataset.data_vars or name in units()}
    if isinstance(value, Mapping):
        return plain_table(place, value, units)
    check_untraced(place.error, value)
    if hasattr(value, "columns") and hasattr(value, "to_dict"):
        frame: Any = value  # of pandas or polars; the index is not a column
        names = list(frame.columns)
        for name in names:
            if names.count(name) > 1:
                raise place.at(str(name)).error("is there already; give each column once")
        return plain_table(place, {name: frame[name] for name in names}, units)
    if hasattr(value, "__array__"):  # of NumPy, JAX, pandas, xarray or pint
        array = np.asarray(magnitude(value))
        if array.dtype.kind in "iuf" and (unit := stated_unit(value)) is not None:
            scale = stated_scale(place.error, unit, _unit_at(place, units()))
            array = array if scale == 1.0 else scale * array
        return plain(place, array.tolist())
    if isinstance(value, (list, tuple, range)):
        if all(type(item) is float for item in value):
            return list(value)  # a fast path, because columns of points are long
        return [plain(place.item(index), item, units) for index, item in enumerate(value)]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, int) and not isinstance(value, bool):
        require_number(place, value)  # rejects numbers with thousands of digits, which Python cannot format
    if isinstance(value, (bool, int, float, str, *_OBJECTS)):
        return value
    raise place.error(f"{shown(value)} cannot stand in a sweep; write a number, text, a list or a table")


def _unit_at(place: Place, units: Mapping[str, str]) -> str | None:
    """Return the unit of the number at a place, such as `grid.v.stop` or `starts[0][1]`; None if it is not known."""
    for part in reversed(place.key.split(".")):
        name, _, index = part.partition("[")
        of_start = f"start[{index.rpartition('[')[2]}" if name == "starts" else name
        for item in (part, of_start, name):
            if item in units:
                return units[item]
    return None


def render(table: Mapping[str, object]) -> str:
    """Return a table of plain values as TOML: first the values, then one section per nested table.

    Scenes, friction laws and steppers are represented by their names.
    """
    values = "\n".join(_line(key, value) for key, value in table.items() if not isinstance(value, dict))
    sections = [(key, value) for key, value in table.items() if isinstance(value, dict)]
    parts = ["\n".join([f"[{_key(key)}]", *(_line(*item) for item in value.items())]) for key, value in sections]
    return "\n\n".join(part for part in (values, *parts) if part) + "\n"


def _line(key: str, value: object) -> str:
    return f"{_key(key)} = {_literal(value)}"


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _literal(key)


def _literal(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(map(_literal, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(_line(key, item) for key, item in value.items()) + " }" if value else "{}"
    return json.dumps(value.name) if isinstance(value, _OBJECTS) else repr(value)
