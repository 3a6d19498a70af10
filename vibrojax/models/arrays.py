"""Types of the numbers in equations and of the arrays in compiled programs.

Annotations state shapes: `lanes` is the axis of lanes, the last axis of every array in a program. Only the tests check
them at run time (`tests/conftest.py`).
"""

from typing import Any, Protocol, TypeVar, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

Array = jax.Array | np.ndarray
"""An array of either library; inside a program it is always jax's."""

Lanes = Float[Array, "*lanes"]
"""One number per lane."""

Flags = Bool[Array, "*lanes"]
"""One truth value per lane."""

Counts = Int[Array, "*lanes"]
"""One integer per lane."""

Real = Array | float
"""An array or a number, but not a series."""


@runtime_checkable
class Value(Protocol):
    """A number in an equation: an array, a Python number, or a truncated Taylor series of either.

    Equations use +, -, *, / and the functions of [vibrojax.models.physics.elementary][], so that one equation serves
    arrays and series.
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


Tree = TypeVar("Tree")


def keep(values: Tree) -> Tree:
    """Return the same values (any pytree), behind an optimization barrier.

    XLA's CPU compiler recomputes a value in every fusion that reads it. In a step, where each value depends on all
    earlier ones, that multiplies the arithmetic. A barrier ends the fusion.
    """
    return jax.lax.optimization_barrier(values)
