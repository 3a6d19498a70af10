"""Values that are likely in another unit than the SI unit they are taken in: a warning of one line, never a refusal."""

import sys
import warnings
from pathlib import Path

import numpy as np

from vibrojax.errors import Place
from vibrojax.models.physics.parameters import Parameter
from vibrojax.models.physics.units import UNITS, likely_units

_SMALLEST = 100.0
"""Of what may be zero: the greatest usual value over the least that a unit is told by."""
_PACKAGE = str(Path(__file__).parents[2])


class UnusualValue(UserWarning):
    """A value is so far from what the source and rigs have that it may be in another unit than it is read in.

    **Example:**

    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always", vj.UnusualValue)  # "error" would end here, "ignore" say nothing
    ...     sweep = vj.read_sweep({"scene": "vibro-impact", "grid": {"delta": [5.0]}})
    >>> str(told[0].message).partition(";")[0]
    'sweep: grid.delta: 5 m is far outside what the source and rigs have (-0.02 to 0.02 m)'
    """


def warn_if_far(place: Place, parameter: Parameter, values: object, likely: str = "", meant: str = "") -> None:
    """Warn, on one line, where one of `values` is far from the usual ones.

    **Arguments:** `place`: where they stand; `parameter`: what they are of; `values`: a number or many, of any shape;
    `likely`: which unit they are likely in, and what to do, where other words than the usual ones are needed; `meant`:
    what to do where they are meant so.
    """
    if parameter.usual is None:
        return
    many = np.atleast_1d(np.asarray(values, float)).ravel()
    far = [value for value in np.unique(many).tolist() if parameter.is_far(value)]
    if not far:
        return
    worst = max(far, key=lambda value: _farness(abs(value), parameter.usual or (0.0, 1.0)))
    subject = f"{_with_unit(worst, parameter)} is"
    if many.size > 1:
        subject = f"{np.isin(many, far).sum()} of {many.size} values, such as {_with_unit(worst, parameter)}, are"
    low, high = parameter.usual
    usual = f"{low:g} to {_with_unit(high, parameter)}" if low != high else _with_unit(high, parameter)
    line = (
        f"{subject} far outside what the source and rigs have ({usual}); {likely or _likely(worst, parameter)}{meant}"
    )
    warnings.warn(str(place.error(line)), UnusualValue, stacklevel=_level_of_caller())


def _likely(value: float, parameter: Parameter) -> str:
    """In which unit it would be a usual one."""
    low, high = parameter.usual or (0.0, 0.0)
    units = likely_units(abs(value), parameter.unit, (low if low > 0 else high / _SMALLEST, high))
    besides = ["of a rotation give rpm and bit_radius"] if parameter.name == "v" else []
    if not units:
        return ", or ".join(besides) or "check its unit"
    right = [f"if in {unit}, write {_with_unit(value * scale, parameter)}" for unit, scale in units.items()]
    return "; ".join([*right, *besides])


def _farness(size: float, usual: tuple[float, float]) -> float:
    low, high = usual
    return max(size / max(abs(low), abs(high)), low / size if low > 0 else 0.0)


def _with_unit(value: float, parameter: Parameter) -> str:
    unit = UNITS.get(parameter.unit, (parameter.unit,))[0]
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"


def _level_of_caller() -> int:
    """The `stacklevel` of a warning by which it points to whom this package was called by."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    return level
