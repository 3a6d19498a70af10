"""Elementary functions that physics is written in.

Each accepts a JAX array, and any other number type that registers itself (the stepper's truncated Taylor
series do), so that an equation is written once and every stepper can use it.
"""

from functools import singledispatch

import jax.numpy as jnp


@singledispatch
def exp(x):
    """Exponential of an array or a registered number type."""
    return jnp.exp(x)


@singledispatch
def sin(x):
    """Sine of an array or a registered number type."""
    return jnp.sin(x)


@singledispatch
def arctan(x):
    """Inverse tangent of an array or a registered number type."""
    return jnp.arctan(x)


@singledispatch
def maximum(x, y):
    """The greater of two values; a series, which comes first, follows whichever is greater where it starts."""
    return jnp.maximum(x, y)


@singledispatch
def absolute(x):
    """Absolute value; a series keeps the sign that it has where it starts."""
    return jnp.abs(x)
