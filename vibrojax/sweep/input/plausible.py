"""One-line warnings about values that are probably not in SI units."""

import sys
import warnings
from pathlib import Path

import numpy as np

from vibrojax.errors import Place
from vibrojax.models.physics.parameters import Parameter
from vibrojax.models.physics.units import UNITS, likely_units

_USUAL_SPAN = 100.0
"""Assumed ratio of largest to smallest usual value of a parameter that may be zero, for guessing units."""

_PACKAGE = str(Path(__file__).parents[2])


class UnusualValue(UserWarning):
    """A value so far outside the usual range (of the source and of rigs) that it is probably not in SI units.

    **Example:**

    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", vj.UnusualValue)  # "error" would end here, "ignore" say nothing
    ...     sweep = vj.read_sweep({"scene": "vibro-impact", "grid": {"delta": [5.0]}})
    >>> str(caught[0].message).partition(";")[0]
    'sweep: grid.delta: 5 m is far outside what the source and rigs have (-0.02 to 0.02 m)'
    """


def warn_if_far(place: Place, parameter: Parameter, values: object, likely: str = "", meant: str = "") -> None:
    """Issue a one-line warning if any of `values` is far outside the parameter's usual range.

    **Arguments:**

    - `place`: place of the values in the input.
    - `parameter`: parameter to which the values belong.
    - `values`: number or array.
    - `likely`: replacement for the default advice about the likely unit.
    - `meant`: advice in case the values are intended.
    """
    if parameter.usual is None:
        return
    numbers = np.atleast_1d(np.asarray(values, float)).ravel()
    far = [value for value in np.unique(numbers).tolist() if parameter.is_far(value)]
    if not far:
        return
    low, high = parameter.usual
    least, greatest = low if low > 0 else 0.0, max(abs(low), abs(high))
    worst = max(far, key=lambda value: max(abs(value) / greatest, least / abs(value)))
    subject = f"{_with_unit(worst, parameter)} is"
    if numbers.size > 1:
        subject = f"{np.isin(numbers, far).sum()} of {numbers.size} values, such as {_with_unit(worst, parameter)}, are"
    usual = f"{low:g} to {_with_unit(high, parameter)}" if low != high else _with_unit(high, parameter)
    advice = likely or _likely(worst, parameter, (least or high / _USUAL_SPAN, high))
    line = f"{subject} far outside what the source and rigs have ({usual}); {advice}{meant}"
    warnings.warn(str(place.error(line)), UnusualValue, stacklevel=_level_of_caller())


def _likely(value: float, parameter: Parameter, usual: tuple[float, float]) -> str:
    """Return advice: the SI value for each other unit in which `value` would be within the usual range."""
    units = likely_units(abs(value), parameter.unit, usual)
    advice = [f"if in {unit}, write {_with_unit(value * scale, parameter)}" for unit, scale in units.items()]
    if parameter.name == "v":
        advice.append("of a rotation give rpm and bit_radius")
    return "; ".join(advice) or "check its unit"


def _with_unit(value: float, parameter: Parameter) -> str:
    unit = UNITS.get(parameter.unit, (parameter.unit,))[0]
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"


def _level_of_caller() -> int:
    """Return the `stacklevel` with which a warning refers to the code that called this package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    return level
