"""Types of the numbers in equations and of the arrays in compiled programs.

The annotations state array shapes. `lanes` is the last axis of every array in a program; a lane is one trajectory of
the batch. Only the tests check the shapes at run time (`tests/conftest.py`).
"""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.errors import InputError
from vibrojax.lazy import jax

if TYPE_CHECKING:
    Array = jax.Array | np.ndarray
else:  # what the two have in common, since annotations are evaluated before jax is imported

    @runtime_checkable
    class Array(Protocol):
        """A JAX or NumPy array; inside a compiled program always a JAX array."""

        shape: Any
        dtype: Any


Lanes = Float[Array, "*lanes"]
"""One number per lane."""

Flags = Bool[Array, "*lanes"]
"""One boolean per lane."""

Counts = Int[Array, "*lanes"]
"""One integer per lane."""

Real = Array | float
"""An array or a Python number, but not a Taylor series."""


@runtime_checkable
class Value(Protocol):
    """A number in an equation: an array, a Python number, or a truncated Taylor series of either.

    Equations use +, -, *, / and the functions of [vibrojax.physics.elementary][], so that the same equation
    accepts arrays and Taylor series.
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


TRACED = (
    "is traced by jax (jit, grad or vmap), which does not go through here: give a number, or use vj.as_jax, whose "
    "function jax can transform; vj.sensitivity gives derivatives as numbers"
)


def check_untraced(refuse: Callable[[str], InputError], value: object) -> None:
    """Raise `refuse(problem)` if `value` is an array that jax traces, whose numbers are not known yet."""
    if "jax" in sys.modules and isinstance(value, jax.core.Tracer):
        raise refuse(TRACED)


Tree = TypeVar("Tree")


def keep(values: Tree) -> Tree:
    """Return the same values (any pytree) behind an XLA optimization barrier.

    XLA's CPU compiler recomputes a value in every fusion that reads the value. In a step, each value depends on all
    earlier values, so the recomputation multiplies the arithmetic. A barrier ends the fusion.
    """
    return jax.lax.optimization_barrier(values)
