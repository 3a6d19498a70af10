"""Test a loop with tangents against jax's own derivative, for parts with and without a derivative."""

from functools import partial
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


def is_unfinished(carry):
    return jnp.any(carry.count < 5)


def run_loop(x):
    c, first = begin(x)
    return jax.lax.while_loop(is_unfinished, lambda carry: advance(c, carry), first)


X = jnp.array([0.3, -0.7])
DIRECTIONS = jnp.stack([jnp.ones(2), jnp.array([0.0, 2.0]), jnp.array([-1.0, 0.5])])


def x_and_total(carry):
    return carry.x, carry.total


def test_tangents_agree_with_jvp_of_loop():
    last, moved = Loop(begin, advance, is_unfinished, x_and_total).with_tangents(DIRECTIONS).run(X)
    expected = run_loop(X)
    for name in Carry._fields:
        np.testing.assert_array_equal(getattr(last, name), getattr(expected, name), name)
    slope = jax.vmap(lambda along: jax.jvp(lambda x: run_loop(x).x, (X,), (along,))[1])(DIRECTIONS)
    np.testing.assert_array_equal(moved.x, slope)
    np.testing.assert_array_equal(moved.total, np.zeros((3, 2)))
    assert moved.count is None and moved.sign is None


@pytest.mark.parametrize("first", [DIRECTIONS, DIRECTIONS[2:]])
def test_second_tangents_agree_with_jvp_of_jvp(first):
    """The loop depends on a second argument, which has no first tangents."""

    def begin_from(arguments):
        x, factor = arguments
        c, carry = begin(x)
        return c | {"rate": factor * c["rate"]}, carry

    def slope_of_end(x, factor, along):
        def end(x):
            return jax.lax.while_loop(is_unfinished, partial(advance, begin_from((x, factor))[0]), begin(x)[1]).x

        return jax.jvp(end, (x,), (along,))[1]

    factor, second = jnp.array([0.8, 1.2]), (jnp.array([[1.0, 0.0]]), jnp.array([[0.5, 2.0]]))
    twice = Loop(begin_from, advance, is_unfinished, x_and_total).with_tangents((first, None)).with_tangents(second)
    (last, _), (slope, bent) = twice.run((X, factor))
    changes = tuple(change[0] for change in second)
    expected = jax.vmap(lambda along: jax.jvp(partial(slope_of_end, along=along), (X, factor), changes)[1])(first)
    np.testing.assert_allclose(bent.x[0], expected, rtol=1e-14)
    assert np.all(np.abs(expected[-1]) > 1)
    assert bent.x.shape == (1, *first.shape) and slope.x.shape == (1, 2) and bent.count is None and last.x.shape == (2,)
    np.testing.assert_array_equal(bent.total, np.zeros_like(bent.x))


def test_unnamed_part_with_derivative_is_error():
    with pytest.raises(AssertionError, match="has a derivative that `varies` does not name"):
        Loop(begin, advance, is_unfinished, lambda carry: (carry.total,)).with_tangents(DIRECTIONS).run(X)
