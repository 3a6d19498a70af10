"""Elementary functions for physical equations.

The functions of `vj.elementary` accept arrays, Python numbers, and registered number types such as the truncated Taylor
series of the located stepper. An equation that uses only these functions works with every stepper.

**Example:**

>>> def falling(speed, p):  # accepts numbers, arrays of lanes, and the Taylor series of a step
...     return 0.13 + 0.27 * vj.elementary.exp(-speed / p["v_s"])
>>> round(float(falling(0.0, {"v_s": 1.8})), 2)
0.4
"""

from collections.abc import Callable
from contextvars import ContextVar
from functools import singledispatch
from typing import Any

import numpy as np

from vibrojax.lazy import jnp

__all__ = [
    "absolute",
    "arctan",
    "cos",
    "exp",
    "floor",
    "log",
    "maximum",
    "minimum",
    "power",
    "sawtooth",
    "sin",
    "sqrt",
    "square",
    "tanh",
]
"""The functions for equations of users."""


def _generic(name: str, meaning: str) -> Any:
    """Return jax's function `name` of a number; other modules register their own number types with its `register`."""

    def call(x: Any) -> Any:
        return getattr(jnp, name)(x)

    call.__name__ = call.__qualname__ = name
    call.__doc__ = meaning
    return singledispatch(call)


exp = _generic("exp", "Return the exponential of x.")
log = _generic("log", "Return the natural logarithm of x > 0.")
sqrt = _generic("sqrt", "Return the square root of x > 0.")
sin = _generic("sin", "Return the sine of x.")
cos = _generic("cos", "Return the cosine of x.")
tanh = _generic("tanh", "Return the hyperbolic tangent of x.")
arctan = _generic("arctan", "Return the inverse tangent of x.")


@singledispatch
def power(x: Any, exponent: Any) -> Any:
    """Return `x**exponent` for positive `x`; `exponent`: a scalar or one value per lane, constant in time."""
    return x**exponent


class Branches:
    """The interface of a caller that decides which formula each kink of a function uses."""

    def maximum(self, x: Any, y: Any) -> Any:
        """Return the result of `maximum(x, y)`."""
        raise NotImplementedError

    def absolute(self, x: Any) -> Any:
        """Return the result of `absolute(x)`."""
        raise NotImplementedError

    def floor(self, x: Any) -> Any:
        """Return the result of `floor(x)`."""
        raise NotImplementedError

    def during(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a function whose kinks ask this object."""
        token = BRANCHES.set(self)
        try:
            return function(*arguments)
        finally:
            BRANCHES.reset(token)


BRANCHES: ContextVar[Branches | None] = ContextVar("branches", default=None)
"""The object that chooses the formula of each kink; None outside of the functions of a system."""

# Dispatch by number type. Functions of a system reach these through the functions without kinks below.
magnitude = _generic("absolute", "Return |x|; for a Taylor series, with the sign of x at the start of the step.")
whole = _generic("floor", "Return the floor of x; for a Taylor series, of its value at the start of the step.")


@singledispatch
def greater(x: Any, y: Any) -> Any:
    """Return the greater of two values; for Taylor series, the one that is greater at the start of the step."""
    return jnp.maximum(x, y)


setattr(greater, "__name__", "maximum")  # noqa: B010 (a type checker does not know the attribute)


def maximum(x: Any, y: Any) -> Any:
    """Return the greater of two values.

    In a `vj.System`, a step ends where the smaller argument becomes the greater one. In a scene, the result for the
    whole step is the argument that is greater at the start of the step. If only one argument is a Taylor series, pass
    it first.
    """
    active = BRANCHES.get()
    return greater(x, y) if active is None else active.maximum(x, y)


def minimum(x: Any, y: Any) -> Any:
    """Return the smaller of two values; see `maximum`."""
    return -maximum(-x, -y)


def absolute(x: Any) -> Any:
    """Return the absolute value of x.

    In a `vj.System`, a step ends where x changes its sign. In a scene, the absolute value of a Taylor series x uses the
    sign of x at the start of the step.
    """
    active = BRANCHES.get()
    return magnitude(x) if active is None else active.absolute(x)


def floor(x: Any) -> Any:
    """Return the greatest whole number not above x.

    In a `vj.System`, x may depend on the time and on parameters; a step ends where the result of `floor` changes.
    """
    active = BRANCHES.get()
    return whole(x) if active is None else active.floor(x)


def sawtooth(x: Any) -> Any:
    """Return a sawtooth of period 1, which rises from 0 at x = 0 to 1 and falls back to 0 at x = 1; see `floor`.

    **Example:** a ramp from 3.8 V to 8.2 V in each period T of a switched converter

    >>> round(float(3.8 + 4.4 * vj.elementary.sawtooth(0.25)), 3)
    4.9
    """
    return x - floor(x)


def square(x: Any) -> Any:
    """Return a square wave of period 1: 1 in the first half of each period and -1 in the second half; see `floor`.

    **Example:**

    >>> [float(vj.elementary.square(x)) for x in (0.25, 0.75, 1.25)]
    [1.0, -1.0, 1.0]
    """
    half = floor(2.0 * x)
    return 1.0 - 2.0 * (half - 2.0 * jnp.floor(0.5 * half))


def integer_power(x: Any, exponent: Any) -> Any:
    """Return `x**exponent` for number types other than arrays; if the exponent is whole, `x` may have any sign."""
    if not isinstance(exponent, int | float | np.number) or exponent != int(exponent):
        return power(x, exponent)
    exponent = int(exponent)
    if exponent == 1:
        return x
    if exponent >= 2:
        half = integer_power(x, exponent // 2)
        square = half * half
        return square * x if exponent % 2 else square
    return 1.0 / integer_power(x, -exponent) if exponent else 0.0 * x + 1.0
