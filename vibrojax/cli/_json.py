"""What a command found, as one JSON object on stdout: `--json`."""

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from vibrojax.errors import escape_json, printable

if TYPE_CHECKING:
    import xarray

_LONGEST_TEXT = 300
"""Characters of a value that is a text."""

_LONGEST_MEANING = 60
"""Characters of a flag's meaning that are shown."""

HELP = "print one JSON object on stdout, and nothing else there; what is no number is null"


def print_json(facts: Mapping[str, object]) -> None:
    """Print `facts` as one JSON object: numbers as numbers, and null where one is not finite."""
    print(escape_json(json.dumps(_plain(facts), ensure_ascii=False, allow_nan=False, indent=2)))


def numbers(dataset: "xarray.Dataset", names: list[str]) -> dict[str, Any]:
    """Single values of a dataset by name; flags by their meanings."""
    return {name: flag_or_number(dataset[name]) for name in names}


def flag_or_number(value: "xarray.DataArray") -> Any:
    """A single value; of flags, what it means."""
    meanings = flags(value)
    if meanings:
        return meanings[int(value)]
    item = value.item()
    return printable(item, _LONGEST_TEXT) if isinstance(item, str) else item


def flags(variable: "xarray.DataArray") -> dict[int, str]:
    """Value and meaning of each flag, by CF's attributes."""
    import numpy as np

    values = np.atleast_1d(variable.attrs.get("flag_values", [])).tolist()
    meanings = str(variable.attrs.get("flag_meanings", "")).split()
    return {value: printable(meaning, _LONGEST_MEANING) for value, meaning in zip(values, meanings, strict=False)}


def _plain(value: Any) -> Any:
    """`value` of what JSON has."""
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if hasattr(value, "tolist"):  # of numpy
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
