"""Elementary functions that physics is written in.

Each accepts an array or a Python number, and any other number type that registers itself (the stepper's truncated
Taylor series do), so that an equation is written once and every stepper can use it.

**Example:**

>>> def falling(speed, p):  # serves numbers, arrays of lanes, and the Taylor series of a step
...     return 0.13 + 0.27 * vj.elementary.exp(-speed / p["v_s"])
>>> round(float(falling(0.0, {"v_s": 1.8})), 2)
0.4
"""

from functools import singledispatch
from typing import Any

import jax.numpy as jnp


@singledispatch
def exp(x: Any) -> Any:
    """Exponential."""
    return jnp.exp(x)


@singledispatch
def log(x: Any) -> Any:
    """Natural logarithm, x > 0."""
    return jnp.log(x)


@singledispatch
def sqrt(x: Any) -> Any:
    """Square root, x > 0."""
    return jnp.sqrt(x)


@singledispatch
def power(x: Any, exponent: Any) -> Any:
    """x to the `exponent`, x > 0; the exponent is a number or an array of lanes, and does not change with time."""
    return x**exponent


@singledispatch
def sin(x: Any) -> Any:
    """Sine."""
    return jnp.sin(x)


@singledispatch
def cos(x: Any) -> Any:
    """Cosine."""
    return jnp.cos(x)


@singledispatch
def tanh(x: Any) -> Any:
    """Hyperbolic tangent."""
    return jnp.tanh(x)


@singledispatch
def arctan(x: Any) -> Any:
    """Inverse tangent."""
    return jnp.arctan(x)


@singledispatch
def maximum(x: Any, y: Any) -> Any:
    """The greater of two values; a series, which comes first, follows whichever is greater where it starts."""
    return jnp.maximum(x, y)


@singledispatch
def absolute(x: Any) -> Any:
    """Absolute value; a series keeps the sign that it has where it starts."""
    return jnp.abs(x)
