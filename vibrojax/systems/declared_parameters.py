"""Parameters and units as a system of the user declares them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from vibrojax.errors import InputError, shown
from vibrojax.lazy import jax
from vibrojax.physics.arrays import check_untraced
from vibrojax.physics.parameters import Parameter
from vibrojax.physics.units import is_drawn_unit

UNIT_EXAMPLES = "give one such as 'm s-1', 'rad', 'deg', 'N m', or '1'"
"""Advice in the refusal of a unit."""


def is_unit(unit: object) -> bool:
    """Return whether a declaration names a unit in which pictures can draw."""
    return isinstance(unit, str) and is_drawn_unit(unit)


def parameter_of(name: str, value: Any, refuse: Callable[[str], InputError]) -> Parameter:
    """Return the parameter that a number, a pair of a number and a unit, or an entry of `vj.parameters` declares.

    `refuse`: function that returns the error for the reason why a declaration is refused.
    """
    if isinstance(value, Parameter):
        if value.name != name:
            raise refuse(f"parameter {name} is declared as {shown(value.name)}; use one name")
        return value
    unit: Any = "1"
    if isinstance(value, tuple | list) and len(value) == 2:
        value, unit = value
        if not is_unit(unit):
            raise refuse(f"parameter {name} has the unit {shown(unit)}; {UNIT_EXAMPLES}")
    check_untraced(lambda problem: refuse(f"parameter {name} {problem}"), value)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float | np.number | jax.Array)
        or not math.isfinite(value)
    ):
        example = "give a finite number, a pair such as (0.5, 'rad s-2'), or an entry of vj.parameters"
        raise refuse(f"parameter {name} is {shown(value)}; {example}")
    return Parameter(name, float(value), unit, name, name)
