"""Validation of values, tables and axes, with warnings about values that are probably not in SI units."""

import re
import sys
import warnings
from collections.abc import Collection, Hashable, Mapping, Sequence
from functools import partial
from numbers import Integral, Real
from pathlib import Path

import numpy as np

from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.physics.arrays import check_untraced
from vibrojax.physics.parameters import Parameter
from vibrojax.physics.units import UNITS, likely_units, magnitude, stated_scale, stated_unit

TOP_KEYS = ("scene", "title", "starts", "unusual")
"""Keys before the tables of a sweep."""

AXIS_MAX_VALUES = 10**7
"""Maximum number of values of an axis (80 MB). A longer axis is certainly a mistake, and would exhaust the memory
before the number of lanes is checked."""

STATE = Parameter("state", 0.0, "1", "state at t = 0", "y")
"""Stand-in parameter for initial states, which admits any finite number."""

_DECIMAL_COMMA = re.compile(r"([+-]?\d+),(\d+)")
_WITH_UNIT = re.compile(r"([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*[^\d\s.,].*")
_RANGE_KEYS = ("start", "stop", "num", "spacing")
_RANGE_ADVICE = {
    "step": "give num, how many values there are from start to stop, both included",
    "scale": 'did you mean "spacing"?',
    "log": 'write spacing = "log"',
}
_AXIS_EXAMPLE = "write a list like [0.3, 0.4], or { start = 0.3, stop = 0.6, num = 7 }"


def require_number(place: Place, value: object, unit: str = "") -> float:
    """Return `value` as a float, which may be NaN or infinite; raise if it is not a number, like true or "0.4".

    `unit`: the parameter's unit, for the message in case that `value` is a string with a number and a unit.
    """
    if isinstance(value, str):
        text, advice = value.strip(), "write a number, without quotes"
        if comma := _DECIMAL_COMMA.fullmatch(text):
            advice = f"write {comma[1]}.{comma[2]}, with a point"
        elif _WITH_UNIT.fullmatch(text):
            advice = f"write the number alone, in {unit if unit not in ('', '1') else 'SI units'}"
        raise place.error(f"{shown(value)} is text; {advice}")
    check_untraced(place.error, value)
    if isinstance(value, bool) or not isinstance(value, Real):
        raise place.error(f"{shown(value)} is not a number; write one, like 0.4 or 50e6")
    try:
        return float(value)
    except OverflowError:
        raise place.error(f"{shown(value)} is too large; a finite number is needed") from None


def quantity(place: Place, value: object, parameter: Parameter) -> float:
    """Return `value`, converted from its stated unit, as a float; raise if it is not admissible for `parameter`."""
    scale = 1.0
    if hasattr(value, "__array__"):  # of NumPy, JAX, xarray or pint
        check_untraced(place.error, value)
        if (unit := stated_unit(value)) is not None:
            scale = stated_scale(place.error, unit, parameter.unit)
        number = np.asarray(magnitude(value))
        value = value if number.ndim else number.item()
    checked = scale * require_number(place, value, parameter.unit)
    problem = parameter.problem(checked)
    if problem is not None:
        raise place.error(problem)
    return checked


def read_pair(place: Place, value: object, noun: str, parameter: Parameter | None = None) -> tuple[float, float]:
    """Return two numbers, or two values of a parameter; `noun`: what they are, and an example."""
    if not isinstance(value, list) or len(value) != 2:
        raise place.error(f"{shown(value)} is not {noun}")
    read = require_number if parameter is None else partial(quantity, parameter=parameter)
    first, second = (read(place.item(k), number) for k, number in enumerate(value))
    return first, second


def count(place: Place, value: object, least: int, most: int | None = None) -> int:
    """Return `value` as an integer; raise if it is not between `least` and `most` (both inclusive)."""
    whole = int(value) if isinstance(value, Integral) and not isinstance(value, bool) else None
    if whole is None or whole < least or (most is not None and whole > most):
        interval = f"of {least} or more" if most is None else f"from {least} to {most}"
        raise place.error(f"{shown(value)} does not fit; a whole number {interval} is needed")
    return whole


def flag(place: Place, value: object) -> bool:
    """Return `value`; raise if it is not a boolean."""
    if not isinstance(value, bool):
        raise place.error(f"{shown(value)} is neither true nor false; write one of them")
    return value


def choice(place: Place, value: object, choices: Collection[str]) -> str:
    """Return `value`; raise if it is not in `choices`."""
    if not isinstance(value, str):
        raise place.error(f"{shown(value)} is not a name; choose from {', '.join(choices)}")
    if value not in choices:
        raise place.error(f"{shown(value)} is unknown; {suggestion(value, choices)}")
    return value


def as_table(place: Place, value: object) -> dict[str, object]:
    """Return `value`; raise if it is not a table."""
    if not isinstance(value, dict):
        raise place.error(f"{shown(value)} is not a table; write [{place.key}] with a line for each key")
    return value


def known_keys(
    place: Place, table: dict[str, object], keys: Collection[str], advice: Mapping[str, str] | None = None
) -> None:
    """Raise at the first key of `table` that is not in `keys`. `advice`: advice for the message, by unknown key."""
    for key in table:
        if key not in keys:
            raise place.at(str(key)).error(f"unknown key; {(advice or {}).get(str(key)) or suggestion(str(key), keys)}")


def check_distinct(place: Place, items: Sequence[Hashable], noun: str) -> None:
    """Raise at the first duplicate in a list. `noun`: word for an item in the message."""
    first: dict[Hashable, int] = {}
    for index, item in enumerate(items):
        if first.setdefault(item, index) != index:
            raise place.item(index).error(f"{shown(item)} is there already, at [{first[item]}]; give each {noun} once")


def read_axis(place: Place, value: object, parameter: Parameter) -> np.ndarray:
    """Return an axis of the grid from a list or a range, float64 (values,), in the order of the file."""
    if isinstance(value, dict):
        return _read_range(place, value, parameter)
    if not isinstance(value, list):
        raise place.error(f"{shown(value)} is not an axis; {_AXIS_EXAMPLE}, or move it to [parameters]")
    if not value:
        raise place.error(f"[] has no values; {_AXIS_EXAMPLE}")
    axis = [quantity(place.item(index), item, parameter) for index, item in enumerate(value)]
    check_distinct(place, axis, "value")
    return np.array(axis)


def _read_range(place: Place, table: dict[str, object], parameter: Parameter) -> np.ndarray:
    """Return evenly spaced values from start to stop (both inclusive), on a linear or logarithmic scale."""
    known_keys(place, table, _RANGE_KEYS, _RANGE_ADVICE)
    for key in _RANGE_KEYS[:3]:
        if key not in table:
            raise place.error(f"{key} is missing; {_AXIS_EXAMPLE}")
    start, stop = (quantity(place.at(key), table[key], parameter) for key in ("start", "stop"))
    num = count(place.at("num"), table["num"], 1, AXIS_MAX_VALUES)
    spacing = choice(place.at("spacing"), table.get("spacing", "linear"), ("linear", "log"))
    if spacing == "log":
        for key, end in (("start", start), ("stop", stop)):
            if end <= 0:
                raise place.at(key).error(f'is {end:g}; spacing "log" needs ends above 0')
    if (num == 1) != (start == stop):
        advice = "both ends are included: 2 or more" if num == 1 else "the ends are equal: 1, or other ends"
        raise place.at("num").error(f"{num} does not fit from {start:g} to {stop:g}; {advice}")
    axis = np.geomspace(start, stop, num) if spacing == "log" else np.linspace(start, stop, num)
    # Neighbours that differ by less than the rounding error would be equal coordinates.
    if np.unique(axis).size != num:
        raise place.at("num").error(f"{num} values from {start!r} to {stop!r} are not all different; fewer would be")
    return axis


_USUAL_SPAN = 100.0
"""Assumed ratio of largest to smallest usual value of a parameter that may be zero, for guessing units."""

_PACKAGE = str(Path(__file__).parents[1])


class UnusualValue(UserWarning):
    """Warning about a value that is probably not in SI units, because it is far outside the range on rigs.

    **Example:**

    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", vj.UnusualValue)  # "error" would end here, "ignore" say nothing
    ...     sweep = vj.read_sweep({"scene": "vibro-impact", "grid": {"delta": [5.0]}})
    >>> str(caught[0].message).partition(";")[0]
    'sweep: grid.delta: 5 m is far outside what the source and rigs have (-0.02 to 0.02 m)'
    """


def warn_if_far(place: Place, parameter: Parameter, values: object, likely: str = "", meant: str = "") -> None:
    """Issue a one-line warning if any of `values`, a number or an array, is far outside the parameter's usual range.

    `likely` replaces the default advice about the likely unit, and says that all values are far outside. `meant` is
    advice in case the values are intended.
    """
    if parameter.usual is None:
        return
    numbers = np.atleast_1d(np.asarray(values, float)).ravel()
    far = [value for value in np.unique(numbers).tolist() if likely or parameter.is_far(value)]
    if not far:
        return
    low, high = parameter.usual
    least, greatest = low if low > 0 else 0.0, max(abs(low), abs(high))
    worst = max(far, key=lambda value: max(abs(value) / greatest, least / abs(value)))
    subject = f"{_with_unit(worst, parameter)} is"
    if numbers.size > 1:
        of = f"of {numbers.size} values, such as {_with_unit(worst, parameter)},"
        subject = counted(int(np.isin(numbers, far).sum()), f"{of} is", f"{of} are")
    usual = f"{low:g} to {_with_unit(high, parameter)}" if low != high else _with_unit(high, parameter)
    units = likely_units(abs(worst), parameter.unit, (least or high / _USUAL_SPAN, high))
    guesses = [f"if in {unit}, write {_with_unit(worst * scale, parameter)}" for unit, scale in units.items()]
    guesses += ["of a rotation give rpm and bit_radius"] if parameter.name == "v" else []
    advice = likely or "; ".join(guesses) or "check its unit"
    line = f"{subject} far outside what the source and rigs have ({usual}); {advice}{meant}"
    warnings.warn(str(place.error(line)), UnusualValue, stacklevel=_level_of_caller())


def _with_unit(value: float, parameter: Parameter) -> str:
    unit = UNITS.get(parameter.unit, (parameter.unit,))[0]
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"


def _level_of_caller() -> int:
    """Return the `stacklevel` with which a warning refers to the code that called this package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    return level
