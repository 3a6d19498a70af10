"""A loop with tangents: the same as jax's own derivative of the loop, for parts with and without a derivative."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.periodic.tangent_loop import Loop


class Carry(NamedTuple):
    x: jax.Array
    total: jax.Array
    count: jax.Array
    sign: jax.Array


def begin(x):
    return {"rate": 1.0 + x**2, "fixed": jnp.full_like(x, 0.5)}, Carry(x, 0 * x, jnp.zeros(x.shape, int), jnp.sign(x))


def advance(c, carry):
    x = carry.x * c["fixed"] + jnp.sin(c["rate"])
    return Carry(x, carry.total + jax.lax.stop_gradient(x), carry.count + 1, carry.sign)


def continues(carry):
    return jnp.any(carry.count < 5)


def run(x):
    c, first = begin(x)
    return jax.lax.while_loop(continues, lambda carry: advance(c, carry), first)


X = jnp.array([0.3, -0.7])
DIRECTIONS = jnp.stack([jnp.ones(2), jnp.array([0.0, 2.0]), jnp.array([-1.0, 0.5])])


def test_it_is_the_derivative_that_jax_finds():
    def varies(carry):
        return carry.x, carry.total

    last, moved = Loop(begin, advance, continues, varies).with_tangents(DIRECTIONS).run(X)
    expected = run(X)
    for name in Carry._fields:
        np.testing.assert_array_equal(getattr(last, name), getattr(expected, name), name)
    slope = jax.vmap(lambda along: jax.jvp(lambda x: run(x).x, (X,), (along,))[1])(DIRECTIONS)
    np.testing.assert_array_equal(moved.x, slope)
    np.testing.assert_array_equal(moved.total, np.zeros((3, 2)))
    assert moved.count is None and moved.sign is None


def test_a_part_that_is_not_named_is_an_error():
    with pytest.raises(AssertionError, match="has a derivative that `varies` does not name"):
        Loop(begin, advance, continues, lambda carry: (carry.total,)).with_tangents(DIRECTIONS).run(X)
