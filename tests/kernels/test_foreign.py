"""Test which foreign code is compared with XLA at run time, and that the tests compare all the rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import vibrojax as vj
from tests.kernels.test_kernel import assert_matches_xla
from vibrojax.compile.foreign import TESTED, needs_comparison
from vibrojax.compile.native import trace

RANDOM = np.random.default_rng(9)
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, np.inf, -np.inf, np.nan])


def instructions(x, y):
    """Return the results of every tested instruction, of numbers, masks and rows."""
    flag, size = x > y, jnp.abs(x) + 0.25
    rows = jnp.stack([x, y, x * y])
    numbers = x + y, x - y, x / y, -x, lax.sign(x), jnp.maximum(x, y), lax.min(x, y), lax.square(x), x**3, size**y
    functions = [f(x) for f in (lax.exp, jnp.sin, jnp.cos, jnp.tan, jnp.tanh, jnp.arctan, lax.floor, lax.is_finite)]
    functions += [jnp.sqrt(size), jnp.log(size)]
    orders = flag, x < y, x >= y, x <= y, x == y, x != y, flag & (x > 0), flag | (x > 0), ~flag, flag < (x > 0)
    others = jnp.where(flag, x, y), flag.astype(x.dtype), lax.stop_gradient(x), *lax.optimization_barrier((x, y))
    moved = jnp.concatenate([rows[1:], rows[None, 0]]), rows.reshape(3, 1, -1).transpose(1, 0, 2)[0], jnp.copy(rows)
    slopes = jax.vmap(lambda d: jax.jvp(lambda z: z * jnp.where(z > 0.3, jnp.sin(z), z), (x,), (d,))[1])(rows)
    return numbers, functions, orders, others, moved, slopes


def primitives(jaxpr):
    for equation in jaxpr.eqns:
        yield equation.primitive.name
        for value in equation.params.values():
            if hasattr(getattr(value, "jaxpr", value), "eqns"):
                yield from primitives(getattr(value, "jaxpr", value))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_tested_instructions_agree_with_xla(dtype):
    """Twenty roundings, infinite and missing numbers included."""
    x, y = (np.concatenate([RANDOM.permutation(SPECIAL), RANDOM.normal(size=54)]).astype(dtype) for _ in range(2))
    with jax.debug_nans(False):
        assert_matches_xla(instructions, x, y, roundings=20)
    used = set(primitives(trace(instructions, x, y).jaxpr.jaxpr))
    assert not TESTED - used


X = np.linspace(-1.0, 2.0, 5)


@jax.jit
def looped(x):
    return lax.fori_loop(0, 3, lambda _, z: 0.5 * z, x)


COMPARED = {
    "branch": lambda x: lax.cond(x.sum() > 0, jnp.sin, jnp.cos, x),
    "loop": looped,
    "sum": lambda x: jnp.stack([x, x * x]).sum(0),
    "index": lambda x: jnp.take(jnp.array([1.0, 2.0, 3.0]), jnp.where(x > 0, 1, 0)),
    "integer": lambda x: x * (x.astype(int) + 1).astype(float),
    "function": lambda x: jax.scipy.special.erf(x),
}

PLAIN = {
    "arithmetic": lambda x: 2.0 * x**2 - jnp.maximum(x, 0.1) / (1.0 + jnp.abs(x)),
    "package": lambda x: vj.elementary.tanh(x) + jnp.where(x > 0.5, 1.0, vj.elementary.sin(x)),
    "jitted": jax.jit(lambda x: jnp.clip(x, 0.0, 1.0) + jnp.stack([x, x])[0]),
}


@pytest.mark.parametrize("name", [*COMPARED, *PLAIN])
def test_foreign_instructions(name):
    """Also within a derivative, where jax writes the instructions on behalf of the function."""
    function = {**COMPARED, **PLAIN}[name]
    assert needs_comparison(trace(function, X).jaxpr.jaxpr) == (name in COMPARED)
    slope = trace(lambda x: jax.jvp(function, (x,), (x,)), X).jaxpr.jaxpr
    assert needs_comparison(slope) == (name in COMPARED)
