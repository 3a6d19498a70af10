"""The smallest writer of TOML that a sweep needs, for sweeps given as a dict.

A general writer (tomli-w) puts tables behind values, and with that the axes of a grid in another order.
"""

import json
import re
from collections.abc import Mapping
from pathlib import PurePath

import jax
import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.sweep.input.values import number

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def plain_table(place: Place, value: Mapping[str, object]) -> dict[str, object]:
    """A table with arrays and numbers of numpy or jax, tuples and paths turned into what TOML knows."""
    for key in value:
        if not isinstance(key, str):
            raise place.error(f"{shown(key)} is not a name; keys are text")
    return {key: plain(place.at(key), item) for key, item in value.items()}


def plain(place: Place, value: object) -> object:
    """`value` with arrays and numbers of numpy or jax, tuples and paths turned into what TOML knows."""
    if isinstance(value, Mapping):
        return plain_table(place, value)
    if isinstance(value, jax.core.Tracer):
        raise place.error(
            "is traced by jax (grad, jit or vmap), which does not go through here: give a number; derivatives come "
            "from vj.derivatives, in forward mode, since jax.grad does not pass through the loops of a motion"
        )
    if isinstance(value, (np.ndarray, np.generic, jax.Array)):
        return plain(place, value.tolist())
    if isinstance(value, (list, tuple, range)):
        if all(type(item) is float for item in value):
            return list(value)  # columns of points are long
        return [plain(place.item(index), item) for index, item in enumerate(value)]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, (bool, float, str)):
        return value
    if isinstance(value, int):
        number(place, value)  # Python does not write thousands of digits
        return value
    raise place.error(f"{shown(value)} cannot stand in a sweep; write a number, text, a list or a table")


def render(table: Mapping[str, object]) -> str:
    """`table`, of plain values, as TOML text: values first, then a section for each table in it."""
    values = [_line(key, value) for key, value in table.items() if not isinstance(value, dict)]
    sections = [
        "\n".join([f"[{_key(key)}]", *(_line(name, item) for name, item in value.items())])
        for key, value in table.items()
        if isinstance(value, dict)
    ]
    return "\n\n".join(part for part in ("\n".join(values), *sections) if part) + "\n"


def _line(key: str, value: object) -> str:
    return f"{_key(key)} = {_value(value)}"


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _value(key)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(_line(key, item) for key, item in value.items()) + " }" if value else "{}"
    return repr(value)
