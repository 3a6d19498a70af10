"""The types of numbers that equations are written in, and of arrays that go through programs.

Shapes stand in the annotations: `lanes` is the axis of lanes, which comes last in every array of a program. They are
checked at run time in the tests only (`tests/conftest.py`).
"""

from typing import Any, Protocol, TypeVar, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

Array = jax.Array | np.ndarray
"""An array of either library; inside a program it is always jax's."""

Lanes = Float[Array, "*lanes"]
"""One number for each lane."""

Flags = Bool[Array, "*lanes"]
"""One truth value for each lane."""

Counts = Int[Array, "*lanes"]
"""One whole number for each lane."""


Real = Array | float
"""An array or a number, but no series."""


@runtime_checkable
class Value(Protocol):
    """A number in an equation: an array, a Python number, or a truncated Taylor series of either.

    Equations are written on it with +, -, *, / and the functions of [vibrojax.models.physics.elementary][], so that one
    equation serves arrays and series alike.
    """

    def __add__(self, other: Any, /) -> Any: ...

    def __radd__(self, other: Any, /) -> Any: ...

    def __sub__(self, other: Any, /) -> Any: ...

    def __rsub__(self, other: Any, /) -> Any: ...

    def __mul__(self, other: Any, /) -> Any: ...

    def __rmul__(self, other: Any, /) -> Any: ...

    def __truediv__(self, other: Any, /) -> Any: ...

    def __rtruediv__(self, other: Any, /) -> Any: ...

    def __neg__(self) -> Any: ...


Kept = TypeVar("Kept")


def keep(values: Kept) -> Kept:
    """The same values (any pytree), held in memory.

    XLA's CPU compiler works a value out again in every fusion that reads it; in a step, where everything depends on
    everything before, that multiplies the arithmetic. A barrier ends the fusion.
    """
    return jax.lax.optimization_barrier(values)
