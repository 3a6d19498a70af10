"""What a command found, as one JSON object on stdout: `--json`."""

import json
import math
from collections.abc import Hashable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray

HELP = "print one JSON object on stdout, and nothing else there; what is no number is null"


def print_json(facts: Mapping[str, object]) -> None:
    """Print `facts` as one JSON object: numbers as numbers, and null where one is not finite."""
    print(json.dumps(_plain(facts), ensure_ascii=False, allow_nan=False, indent=2))


def numbers(dataset: "xarray.Dataset", names: list[str]) -> dict[str, Any]:
    """Single values of a dataset by name; flags by their meanings."""
    return {name: flag_or_number(dataset[name]) for name in names}


def flag_or_number(value: "xarray.DataArray") -> Any:
    """A single value; of flags, what it means."""
    meanings = flags(value)
    return meanings[int(value)] if meanings else value.item()


def flags(variable: "xarray.DataArray") -> dict[int, str]:
    """Value and meaning of each flag, by CF's attributes."""
    import numpy as np

    values = np.atleast_1d(variable.attrs.get("flag_values", [])).tolist()
    return dict(zip(values, str(variable.attrs.get("flag_meanings", "")).split(), strict=False))


def from_json(attributes: Mapping[Hashable, Any], name: str) -> Any:
    """An attribute that holds JSON; None where it is not there, or holds none."""
    try:
        return json.loads(attributes[name])
    except (ValueError, KeyError, TypeError):
        return None


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
