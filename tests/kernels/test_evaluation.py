"""Test numpy's rules of the reference and foreign instructions against XLA, and which foreign code is compared."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import vibrojax as vj
from tests.kernels.test_kernel import assert_matches_xla
from vibrojax.compile import reference
from vibrojax.compile.foreign import TESTED, needs_comparison
from vibrojax.compile.native import trace

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


# Which foreign code is compared with XLA at run time

RANDOM = np.random.default_rng(9)
SOME_NUMBERS = np.array([0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, np.inf, -np.inf, np.nan])


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
    x, y = (np.concatenate([RANDOM.permutation(SOME_NUMBERS), RANDOM.normal(size=54)]).astype(dtype) for _ in range(2))
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
