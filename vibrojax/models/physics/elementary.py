"""Elementary functions for physical equations.

Each function accepts an array, a Python number, or any other registered number type. The located stepper registers its
truncated Taylor series, so the same equation serves every stepper.

**Example:**

>>> def falling(speed, p):  # accepts numbers, arrays of lanes, and the Taylor series of a step
...     return 0.13 + 0.27 * vj.elementary.exp(-speed / p["v_s"])
>>> round(float(falling(0.0, {"v_s": 1.8})), 2)
0.4
"""

from collections.abc import Callable
from functools import singledispatch
from typing import Any

import jax.numpy as jnp


def _generic(name: str, meaning: str, function: Callable[..., Any]) -> Any:
    """Return a function of a number type; other modules register their own types with its `register`."""

    def call(x: Any) -> Any:
        return function(x)

    call.__name__ = call.__qualname__ = name
    call.__doc__ = meaning
    return singledispatch(call)


exp = _generic("exp", "Return the exponential of x.", jnp.exp)
log = _generic("log", "Return the natural logarithm of x > 0.", jnp.log)
sqrt = _generic("sqrt", "Return the square root of x > 0.", jnp.sqrt)
sin = _generic("sin", "Return the sine of x.", jnp.sin)
cos = _generic("cos", "Return the cosine of x.", jnp.cos)
tanh = _generic("tanh", "Return the hyperbolic tangent of x.", jnp.tanh)
arctan = _generic("arctan", "Return the inverse tangent of x.", jnp.arctan)
absolute = _generic(
    "absolute", "Return the absolute value of x; the sign of a Taylor series is that at the start of the step.", jnp.abs
)


@singledispatch
def power(x: Any, exponent: Any) -> Any:
    """Return `x**exponent` for positive `x`; `exponent`: a scalar or one value per lane, constant in time."""
    return x**exponent


@singledispatch
def maximum(x: Any, y: Any) -> Any:
    """Return the greater of two values.

    Pass a Taylor series as the first argument. The result is then the argument that is greater at the start of the
    step, for the whole step.
    """
    return jnp.maximum(x, y)


def raised(x: Any, exponent: Any) -> Any:
    """Return `x**exponent` for number types other than arrays; a natural exponent admits every sign of `x`."""
    if exponent == 1:
        return x
    if isinstance(exponent, int) and exponent >= 2:
        half = raised(x, exponent // 2)
        square = half * half
        return square * x if exponent % 2 else square
    if isinstance(exponent, int) and exponent < 0:
        return 1.0 / raised(x, -exponent)
    return power(x, exponent)
