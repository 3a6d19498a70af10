"""Checks of single values: numbers, counts, choices."""

import re
from collections.abc import Collection, Mapping
from numbers import Integral, Real

from vibrojax.errors import Place, shown, suggestion
from vibrojax.models.physics.parameters import Parameter

_WITH_COMMA = re.compile(r"([+-]?\d+),(\d+)")
_WITH_UNIT = re.compile(r"([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*[^\d\s.,].*")


def number(place: Place, value: object, unit: str = "") -> float:
    """`value` as a float; raises where it is no number (true and "0.4" are none). It may be NaN or infinite.

    `unit`: its own, to be named where one was written beside the number.
    """
    if isinstance(value, str):
        raise place.error(f"{shown(value)} is text; {_right(value.strip(), unit)}")
    if isinstance(value, bool) or not isinstance(value, Real):
        raise place.error(f"{shown(value)} is not a number; write one, like 0.4 or 50e6")
    try:
        return float(value)
    except OverflowError:
        raise place.error(f"{shown(value)} is too large; a finite number is needed") from None


def _right(text: str, unit: str) -> str:
    """What to write in place of a `text` that is no number."""
    if comma := _WITH_COMMA.fullmatch(text):
        return f"write {comma[1]}.{comma[2]}, with a point"
    if _WITH_UNIT.fullmatch(text):
        return f"write the number alone, in {unit if unit not in ('', '1') else 'SI units'}"
    return "write a number, without quotes"


def quantity(place: Place, value: object, parameter: Parameter) -> float:
    """`value` as a float that `parameter` may have."""
    checked = number(place, value, parameter.unit)
    problem = parameter.problem(checked)
    if problem is not None:
        raise place.error(problem)
    return checked


def count(place: Place, value: object, least: int, most: int | None = None) -> int:
    """`value` as a whole number from `least` to `most`."""
    whole = int(value) if isinstance(value, Integral) and not isinstance(value, bool) else None
    if whole is None or whole < least or (most is not None and whole > most):
        wanted = f"of {least} or more" if most is None else f"from {least} to {most}"
        raise place.error(f"{shown(value)} does not fit; a whole number {wanted} is needed")
    return whole


def choice(place: Place, value: object, choices: Collection[str]) -> str:
    """`value` as one of `choices`."""
    if not isinstance(value, str):
        raise place.error(f"{shown(value)} is not a name; choose from {', '.join(choices)}")
    if value not in choices:
        raise place.error(f"{shown(value)} is unknown; {suggestion(value, choices)}")
    return value


def as_table(place: Place, value: object) -> dict[str, object]:
    """`value` as a table."""
    if not isinstance(value, dict):
        raise place.error(f"{shown(value)} is not a table; write [{place.key}] with a line for each key")
    return value


def known_keys(
    place: Place, table: dict[str, object], keys: Collection[str], advice: Mapping[str, str] | None = None
) -> None:
    """Raise at the first key of `table` that is none of `keys`, with the `advice` for that key if there is any."""
    for key in table:
        if key not in keys:
            right = (advice or {}).get(str(key)) or suggestion(str(key), keys)
            raise place.at(str(key)).error(f"unknown key; {right}")
