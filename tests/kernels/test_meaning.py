"""Kernels mean what jax means at the ends of types and of arrays; what they cannot do, they refuse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from random_functions import put, with_jvp, with_vjp
from test_kernel import ROWS, WHICH, X, Y, assert_as_jax, of_lanes

from vibrojax.compile.kernels import Kernel, Untranslatable, parameters
from vibrojax.compile.kernels.translation import primitives

pytestmark = pytest.mark.usefixtures("width")

INTEGERS = ["int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"]
FLAGS, OTHERS = X > 0, Y > 0
BEYOND = [np.nan, np.inf, -np.inf, 1e30, -1e30, 300.0, -300.0, -0.5, 2.0**31, 2.0**63, -(2.0**63), 2.0**64, 255.7]


def ends(dtype):
    """Pairs of the least, the greatest and some numbers in between."""
    limits = np.iinfo(dtype)
    numbers = np.array([limits.min, limits.min + 1, 0, 1, 2, 7, limits.max // 2 + 1, limits.max - 1, limits.max], dtype)
    return tuple(grid.ravel() for grid in np.meshgrid(numbers, numbers))


@pytest.mark.parametrize("low, high", [(0, 0), (3, 1), (0, 1), (2, 5)])
def test_loops_of_few_turns(low, high):
    """A loop without turns does nothing."""
    assert_as_jax(lambda x: lax.fori_loop(low, high, lambda k, x: 2 * x + 1, x), X)


def test_a_scan_without_turns():
    def function(x, rows):
        return lax.scan(lambda x, row: (x + row, x), x, rows), lax.scan(lambda x, _: (2 * x, None), x, length=0)

    assert_as_jax(function, X, ROWS[:0])


def test_booleans_have_an_order():
    """False < True."""
    assert_as_jax(lambda a, b: (a < b, a <= b, a > b, a >= b, jnp.maximum(a, b), jnp.minimum(a, b)), FLAGS, OTHERS)
    rows = ROWS > 0
    assert_as_jax(lambda rows: (jnp.sort(rows, 0), jnp.argsort(rows, 0), rows.max(0), rows.min(0)), rows)


@pytest.mark.parametrize("dtype", INTEGERS)
def test_integers(dtype):
    """Unsigned ones have no sign; divided by 0, and shifted by any number, they give what jax gives."""
    x, y = ends(dtype)
    low, high = np.array([2], dtype), np.array([100], dtype)

    def function(x, y):
        return {
            "order": (x < y, x <= y, x > y, x >= y, x == y, x != y),
            "extremes": (lax.max(x, y), lax.min(x, y), lax.clamp(x.dtype.type(low[0]), x, x.dtype.type(high[0]))),
            "quotients": (lax.div(x, y), lax.rem(x, y), x // y, x % y),
            "shifts": (x << y, x >> y, lax.shift_right_logical(x, y), x << 3, lax.shift_right_arithmetic(x, y)),
            "bits": (x & y, x | y, x ^ y, ~x),
            "sums": (x + y, x - y, x * y, -x, lax.sign(x)),
            "powers": (x**2, x**3, lax.square(x), lax.integer_pow(x, 7), lax.integer_pow(x, 0)),
        }

    assert_as_jax(function, x, y)
    if dtype.startswith("i"):
        assert_as_jax(lambda x: lax.abs(x), x)
    rows = np.stack([x, y, np.roll(x, 5)])
    assert_as_jax(lambda rows: (jnp.sort(rows, 0), rows.max(0), rows.min(0)), rows)


@pytest.mark.parametrize("reverse", [False, True])
def test_a_scan_from_either_end(reverse):
    def function(x, rows):
        return lax.scan(lambda x, row: (0.5 * x + row, x - row), x, rows, reverse=reverse)

    assert_as_jax(function, X, ROWS)


ROW_NUMBERS = {
    "usual": lambda x, which: jnp.take_along_axis(x, which, 0),
    "clip": lambda x, which: jnp.take_along_axis(x, which, 0, mode="clip"),
    "fill": lambda x, which: jnp.take_along_axis(x, which, 0, mode="fill"),
    "fill value": lambda x, which: jnp.take_along_axis(x, which, 0, mode="fill", fill_value=5),
    "promised": lambda x, which: jnp.take_along_axis(x, which, 0, mode="promise_in_bounds"),
    "table": lambda x, which: jnp.take(jnp.arange(3, dtype=x.dtype), which[0], mode="fill"),
    "put": lambda x, which: [put(x, which[0], x[1], mode) for mode in ("drop", "clip")],
}


@pytest.mark.parametrize("name", ROW_NUMBERS)
@pytest.mark.parametrize("dtype", [*INTEGERS, "float32", "float64"])
def test_rows_that_do_not_exist(name, dtype):
    """They are filled with the fill value, or with jax's own: NaN, the least or the greatest integer."""
    rows, which = (ROWS * 10).astype(dtype), np.stack([WHICH, WHICH[::-1] * 3])
    assert_as_jax(lambda rows: ROW_NUMBERS[name](rows[0], rows[1]), (rows, which))


@pytest.mark.parametrize("dtype", INTEGERS)
@pytest.mark.parametrize("given", ["float32", "float64"])
def test_floats_become_integers(given, dtype):
    """The nearest there is, and 0 for NaN."""
    x = np.array([*BEYOND, *X], given)
    assert_as_jax(lambda x: (x.astype(dtype), (x > 0).astype(dtype), x.astype(bool)), x)


@pytest.mark.parametrize("dtype", INTEGERS)
@pytest.mark.parametrize("to", [*INTEGERS, "float32", "float64", "bool"])
def test_integers_become_others(dtype, to):
    assert_as_jax(lambda x: x.astype(to), ends(dtype)[0], roundings=1)


def test_powers():
    """An exponent may be an integer."""
    n = np.arange(-3, 18)
    assert_as_jax(lambda x, n: (lax.pow(x, n), lax.pow(x.astype(jnp.float32), n.astype(jnp.int8))), X, n, roundings=20)
    assert_as_jax(lambda x: (x**-3, x**7, x**0, lax.square(x)), X)


def test_zeros_have_signs():
    """+0 is the maximum of +0 and -0."""
    zeros = np.array([0.0, -0.0, 0.0, -0.0, 1.0, np.nan]), np.array([-0.0, 0.0, 0.0, -0.0, np.nan, -1.0])

    def function(x, y):
        extremes = lax.max(x, y), lax.min(x, y), jnp.maximum(x, 0.0), jnp.maximum(0.0, x), jnp.minimum(x, -0.0)
        extremes += jnp.minimum(-0.0, x), jnp.minimum(x, 0.0), jnp.maximum(x, -0.0), jnp.maximum(abs(x), -abs(y))
        extremes += jnp.maximum(x, abs(y)), jnp.minimum(abs(x), y), jnp.minimum(abs(x), abs(y)), jnp.clip(x, -0.0, 1.0)
        return extremes, [jnp.signbit(x) for x in extremes]

    found, expected = of_lanes(function, *zeros), jax.jit(function)(*zeros)
    for x, (one, other) in enumerate(zip(*(jax.tree.leaves(given) for given in (found, expected)), strict=True)):
        known = ~np.isnan(np.asarray(jax.tree.leaves(expected)[x % 13]))
        np.testing.assert_array_equal(one[known], other[known])


def test_subnormal_numbers_count():
    """Every rule takes them for what they are, as numpy does; XLA takes them for 0 (it sets the processor so)."""
    x = np.array([5e-324, -1e-310, 2.2e-308, -0.0, 1e-300])
    found = of_lanes(lambda x: (x > 0, x == 0, x * 2, abs(x), lax.sign(x), jnp.maximum(x, 0.0), lax.floor(x), -x), x)
    expected = x > 0, x == 0, x * 2, abs(x), np.sign(x), np.maximum(x, 0.0), np.floor(x), -x
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_functions_with_derivatives_of_their_own():
    assert_as_jax(lambda x: (with_jvp(lambda x: 2 * x)(x), with_vjp(lambda x: x + 1)(x)), X)


def numbers_by_lanes(x):
    return x[jnp.array([0, 0, 1])]


REFUSED = {
    "argmax": lambda x: jnp.argmax(jnp.stack([x, -x]), 0),
    "cumsum": lambda x: jnp.cumsum(jnp.stack([x, -x]), 0),
    "logistic": lambda x: jax.nn.sigmoid(x),
    "rows of booleans": lambda x: jnp.take_along_axis(jnp.stack([x > 0, x < 0]), (x > 0).astype(int)[None], 0),
    "no rows": lambda x: lax.reduce_max(jnp.zeros((0, *x.shape)), (0,)),
    "three branches": lambda x: lax.switch(jnp.int32(jnp.any(x > 0)), [lambda: x, lambda: -x, lambda: 2 * x]),
    "a choice of three": lambda x: lax.select_n((x > 0).astype(jnp.int32), x, -x, 2 * x),
    "two keys": lambda x: lax.sort((jnp.stack([x, -x]),) * 2, dimension=0, num_keys=2),
    "half precision": lambda x: x.astype(jnp.float16),
    "a short float": lambda x: x.astype(jnp.bfloat16) + 1,
    "complex numbers": lambda x: jnp.abs(lax.complex(x, x)),
    "random numbers": lambda x: x + jax.random.normal(jax.random.key(0)),
    "lanes in another order": lambda x: jnp.stack([x, x]).T.reshape(2, -1),
    "lanes beside lanes": lambda x: jnp.concatenate([x, x]),
    "lanes apart": lambda x: sum(jnp.split(x, [3])[0]),
    "lanes by number": numbers_by_lanes,
    "a lane": lambda x: lax.dynamic_slice(x, (3,), (1,)) + x,
    "shared by lanes": lambda x: jnp.zeros(8).at[(x > 0).astype(int)].set(x)[0] + x,
    "along the lanes": lambda x: lax.scan(lambda total, y: (total + y, total), 0.0, x)[1],
    "sorted lanes": lambda x: jnp.sort(x),
    "an unsigned row number": lambda x: jnp.take(jnp.arange(3.0), (x > 0).astype(jnp.uint64)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    with pytest.raises(Untranslatable, match=r"\w"):
        Kernel(REFUSED[name], X)


def test_without_lanes():
    with pytest.raises(Untranslatable, match="no argument has lanes"):
        Kernel(lambda x: x + 1, 1.0)


def test_unknown_parameters():
    """A later jax cannot change a meaning silently."""
    with pytest.raises(Untranslatable, match="add with the unknown parameter saturating"):
        parameters.check("add", {"saturating": True})
    with pytest.raises(Untranslatable, match="mul with out_dtype = float32"):
        parameters.check("mul", {"out_dtype": "float32"})
    with pytest.raises(Untranslatable, match="sort without the parameter num_keys"):
        parameters.check("sort", {"dimension": 0, "is_stable": True})
    with pytest.raises(Untranslatable, match="gather with mode = ONE_HOT"):
        parameters.check("gather", {"dimension_numbers": None, "mode": "ONE_HOT", "fill_value": None})
    assert set(parameters.PARAMETERS) <= primitives()
