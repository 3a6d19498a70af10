"""Elementary functions for physical equations.

Each function accepts an array, a Python number, or any other registered number type. The located stepper registers its
truncated Taylor series, so the same equation serves every stepper.

**Example:**

>>> def falling(speed, p):  # accepts numbers, arrays of lanes, and the Taylor series of a step
...     return 0.13 + 0.27 * vj.elementary.exp(-speed / p["v_s"])
>>> round(float(falling(0.0, {"v_s": 1.8})), 2)
0.4
"""

from functools import singledispatch
from typing import Any

import jax.numpy as jnp


@singledispatch
def exp(x: Any) -> Any:
    """Return the exponential of x."""
    return jnp.exp(x)


@singledispatch
def log(x: Any) -> Any:
    """Return the natural logarithm of x > 0."""
    return jnp.log(x)


@singledispatch
def sqrt(x: Any) -> Any:
    """Return the square root of x > 0."""
    return jnp.sqrt(x)


@singledispatch
def power(x: Any, exponent: Any) -> Any:
    """Return `x**exponent` for positive `x`; `exponent`: a scalar or one value per lane, constant in time."""
    return x**exponent


@singledispatch
def sin(x: Any) -> Any:
    """Return the sine of x."""
    return jnp.sin(x)


@singledispatch
def cos(x: Any) -> Any:
    """Return the cosine of x."""
    return jnp.cos(x)


@singledispatch
def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent of x."""
    return jnp.tanh(x)


@singledispatch
def arctan(x: Any) -> Any:
    """Return the inverse tangent of x."""
    return jnp.arctan(x)


@singledispatch
def maximum(x: Any, y: Any) -> Any:
    """Return the greater of two values.

    Pass a Taylor series as the first argument. The result is then the argument that is greater at the start of the
    step, for the whole step.
    """
    return jnp.maximum(x, y)


@singledispatch
def absolute(x: Any) -> Any:
    """Return the absolute value of x; the sign of a Taylor series is that at the start of the step."""
    return jnp.abs(x)
