"""Tests of the reference of kernels: numpy's rules give the bits of XLA."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from vibrojax.compile import reference

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 1e300, -1e-300, np.inf, -np.inf, np.nan, 3.0]
FLOATS = np.array(SPECIAL + list(np.random.default_rng(3).normal(size=52)))
OTHERS = np.random.default_rng(4).permutation(FLOATS)
INTEGERS = np.arange(-32, 32)


def integers(x, y):
    return x + y, x - y, x * y, -x, abs(x), x & y, x | y, x ^ y, ~x, x // 3, jnp.maximum(x, y), x < y, ~(x < y)


CASES = {
    "arithmetic": lambda x, y: (x + y, x - y, x * y, x / y, lax.rem(x, y), -x, abs(x), jnp.sqrt(x)),
    "order": lambda x, y: (jnp.maximum(x, y), lax.min(x, y), x < y, x <= y, x > y, x >= y, x == y, x != y),
    "rounding": lambda x, y: (lax.floor(x), lax.ceil(x), lax.is_finite(x), lax.round(x)),
    "choice": lambda x, y: (jnp.where(x > y, x, y), jnp.where(x > 0, 1.0, y), lax.select_n(x > 0, y, x)),
    "types": lambda x, y: (x.astype("float32"), (x > y).astype(float), jnp.floor(3 * jnp.tanh(y)).astype(int)),
    "integers": lambda x, y: integers((x > y).astype(int) + INTEGERS, (y > 0).astype(int)),
    "arrangement": lambda x, y: (
        jnp.stack([x, y])[:, ::3],
        jnp.concatenate([x, y]).reshape(8, -1).T,
        jnp.broadcast_to(x[:, None], (64, 3)),
        lax.optimization_barrier((x, y)),
        jnp.stack([x, y], axis=1)[2:3].squeeze(0),
    ),
    "masks": lambda x, y: (jnp.all(x > y), jnp.any((x > y).reshape(4, -1), axis=0), x + lax.iota(x.dtype, 64)),
    "bits": lambda x, y: lax.bitcast_convert_type(x, f"int{8 * x.dtype.itemsize}"),
    "scan": lambda x, y: lax.scan(lambda z, row: (0.5 * z + row * y, z - row), x, jnp.stack([x, y]), reverse=True),
    "empty scan": lambda x, y: lax.scan(lambda z, row: (z * y, z), x, jnp.zeros((0, 64))),
    "loop": lambda x, y: lax.fori_loop(0, 3, lambda _, z: 0.5 * (z + jnp.sin(y)), x),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_rules_have_bits_of_xla(name, dtype):
    with np.errstate(over="ignore"):
        x, y = FLOATS.astype(dtype), OTHERS.astype(dtype)
    x, y = (np.where(np.abs(z) < np.finfo(dtype).tiny, 0.0, z).astype(dtype) for z in (x, y))
    with jax.debug_nans(False):
        traced = jax.jit(CASES[name]).trace(x, y)
        values = reference.evaluate(traced.jaxpr, x, y)
        by_xla = jax.core.eval_jaxpr(traced.jaxpr.jaxpr, traced.jaxpr.consts, x, y)
    for value, other in zip(values, by_xla, strict=True):
        assert np.asarray(value).dtype == other.dtype
        np.testing.assert_array_equal(value, other)


def test_every_rule_is_tested():
    used = set()

    def add(jaxpr):
        for equation in jaxpr.eqns:
            used.add(equation.primitive.name)
            if equation.primitive.name in reference.CALLS:
                add(equation.params[reference.CALLS[equation.primitive.name]].jaxpr)

    for function in CASES.values():
        add(jax.make_jaxpr(function)(FLOATS, OTHERS).jaxpr)
    assert set(reference.RULES) - used <= {"stack", "stop_gradient"}  # primitives of some versions of jax
