"""Single values set over a sweep, as `--set NAME=VALUE` does."""

import tomllib
from collections.abc import Iterable
from dataclasses import replace

from vibrojax.errors import Place, shown, suggestion
from vibrojax.sweep.input.plain import render
from vibrojax.sweep.input.run_settings import RunSettings
from vibrojax.sweep.input.source import Source, without_objects

_TABLES = ("parameters", "grid", "run")
_TOP = ("scene", "title", "starts", "unusual")


def with_changes(source: Source, words: Iterable[str]) -> Source:
    """The sweep with values set by `words` NAME=VALUE.

    NAME is a key of [run], `scene`, `title`, `starts` or `unusual`, or a parameter: a number or a name fixes it, a list
    or a range makes it an axis, wherever it was before. `run.settle`, `parameters.k1` and `grid.beta` may be written
    out.

    **Raises:** `InputError` where a word is no NAME=VALUE.
    """
    tables = {key: dict(value) if isinstance(value, dict) else value for key, value in source.tables.items()}
    place = Place("--set")
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name:
            raise place.error(f"{shown(word)} is no NAME=VALUE; write one, like k1=312500 or run.settle=200")
        _set(place.at(name), tables, name, _value(text))
    return replace(source, tables=tables, text=render(without_objects(tables)[1]))


def _set(place: Place, tables: dict[str, object], name: str, value: object) -> None:
    table, dot, key = name.partition(".")
    if not dot:
        table, key = _home(name, value), name
    elif table not in _TABLES:
        raise place.error(f"there is no table {shown(table)}; {suggestion(table, _TABLES)}")
    if table in ("parameters", "grid"):
        for other in ("parameters", "grid"):
            where = tables.get(other)
            if isinstance(where, dict):
                where.pop(key, None)
    home = tables.setdefault(table, {}) if table else tables
    if not isinstance(home, dict):
        raise place.error(f"[{table}] is no table in the sweep; nothing can be set in it")
    home[key] = value


def _home(name: str, value: object) -> str:
    """The table in which `name` is set; empty for the top."""
    if name in _TOP:
        return ""
    if name in RunSettings.__dataclass_fields__:
        return "run"
    return "grid" if isinstance(value, (list, dict)) else "parameters"


def _value(text: str) -> object:
    """`text` as a value of TOML, or, where it is none, as itself."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text
