"""The axes of a grid: lists of values and ranges."""

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.models.physics.parameters import Parameter
from vibrojax.sweep.input.values import choice, count, known_keys, quantity

MOST_VALUES = 10**7
_RANGE_KEYS = ("start", "stop", "num", "spacing")
_ADVICE = {
    "step": "give num, how many values there are from start to stop, both included",
    "scale": 'did you mean "spacing"?',
    "log": 'write spacing = "log"',
}
_EXAMPLE = "write a list like [0.3, 0.4], or { start = 0.3, stop = 0.6, num = 7 }"


def read_axis(place: Place, value: object, parameter: Parameter) -> np.ndarray:
    """One axis of the grid: shape (values,), float64, in the file's order."""
    if isinstance(value, dict):
        return _range(place, value, parameter)
    if not isinstance(value, list):
        raise place.error(f"{shown(value)} is no axis; {_EXAMPLE}, or move it to [parameters]")
    if not value:
        raise place.error(f"[] has no values; {_EXAMPLE}")
    axis = np.array([quantity(place.item(index), item, parameter) for index, item in enumerate(value)])
    seen: dict[float, int] = {}
    for index, item in enumerate(axis.tolist()):
        if item in seen:
            raise place.item(index).error(f"{item:g} is there already, at [{seen[item]}]; give each value once")
        seen[item] = index
    return axis


def _range(place: Place, given: dict[str, object], parameter: Parameter) -> np.ndarray:
    """Evenly spaced values from start to stop, both included."""
    known_keys(place, given, _RANGE_KEYS, _ADVICE)
    for key in _RANGE_KEYS[:3]:
        if key not in given:
            raise place.error(f"{key} is missing; {_EXAMPLE}")
    start, stop = (quantity(place.at(key), given[key], parameter) for key in ("start", "stop"))
    num = count(place.at("num"), given["num"], 1, MOST_VALUES)
    spacing = choice(place.at("spacing"), given.get("spacing", "linear"), ("linear", "log"))
    if spacing == "log":
        for key, end in (("start", start), ("stop", stop)):
            if end <= 0:
                raise place.at(key).error(f'is {end:g}; spacing "log" needs ends above 0')
    if (num == 1) != (start == stop):
        raise place.at("num").error(
            f"{num} does not fit from {start:g} to {stop:g}; "
            + ("both ends are included: 2 or more" if num == 1 else "the ends are equal: 1, or other ends")
        )
    axis = np.geomspace(start, stop, num) if spacing == "log" else np.linspace(start, stop, num)
    # Neighbours closer than a rounding would be one and the same coordinate.
    if np.unique(axis).size != num:
        raise place.at("num").error(f"{num} values from {start!r} to {stop!r} are not all different; fewer would be")
    return axis
