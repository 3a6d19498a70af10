"""Cosine and sine, worked out together: a library's are called lane by lane on a CPU."""

from math import factorial, pi

import jax.numpy as jnp

from vibrojax.stepping.polynomial import value

_COS = [(-1.0) ** k / factorial(2 * k) for k in range(9)]
_SIN = [(-1.0) ** k / factorial(2 * k + 1) for k in range(9)]
# pi/2 in two parts, of which the first has few enough digits to be multiplied by any number of quarters met here.
_QUARTER = 1.5707963109016418
_REST = 1.5893254773528196e-08


def cos_sin(angle):
    """(cos, sin) of `angle` [rad], any shape, to a few roundings of the angle.

    Taylor polynomials within an eighth of a turn, turned by whole quarters.
    """
    quarters = jnp.round(angle * (2 / pi))
    rest = (angle - quarters * _QUARTER) - quarters * _REST
    square = rest * rest
    cos, sin = value(_COS, square), rest * value(_SIN, square)
    odd = quarters - 2 * jnp.floor(quarters / 2) > 0.5
    cos, sin = jnp.where(odd, sin, cos), jnp.where(odd, cos, sin)
    which = quarters - 4 * jnp.floor(quarters / 4)
    return jnp.where((which > 0.5) & (which < 2.5), -cos, cos), jnp.where(which > 1.5, -sin, sin)
