"""Test a loop with tangents against jax's own derivative, for parts with and without a derivative."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.periodic.tangent_loop import loop_with_tangents


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


def is_unfinished(carry):
    return jnp.any(carry.count < 5)


def run_loop(x):
    c, first = begin(x)
    return jax.lax.while_loop(is_unfinished, lambda carry: advance(c, carry), first)


X = jnp.array([0.3, -0.7])
DIRECTIONS = jnp.stack([jnp.ones(2), jnp.array([0.0, 2.0]), jnp.array([-1.0, 0.5])])


def test_tangents_agree_with_jvp_of_loop():
    last, moved = loop_with_tangents(begin, advance, is_unfinished, X, DIRECTIONS, lambda carry: (carry.x, carry.total))
    expected = run_loop(X)
    for name in Carry._fields:
        np.testing.assert_array_equal(getattr(last, name), getattr(expected, name), name)
    slope = jax.vmap(lambda along: jax.jvp(lambda x: run_loop(x).x, (X,), (along,))[1])(DIRECTIONS)
    np.testing.assert_array_equal(moved.x, slope)
    np.testing.assert_array_equal(moved.total, np.zeros((3, 2)))
    assert moved.count is None and moved.sign is None


def test_unnamed_part_with_derivative_is_error():
    with pytest.raises(AssertionError, match="has a derivative that `varies` does not name"):
        loop_with_tangents(begin, advance, is_unfinished, X, DIRECTIONS, lambda carry: (carry.total,))
