"""A kernel gives what the function gives: against numpy and XLA, for any number of lanes, each lane by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from vibrojax.compile.kernels import Kernel, Untranslatable

RANDOM = np.random.default_rng(20)
X, Y = RANDOM.normal(size=(2, 21))
ROWS = RANDOM.normal(size=(7, 21))
WHICH = RANDOM.integers(-2, 9, 21)
FLAGS = X > 0
DTYPES = ["float64", "float32"]

pytestmark = pytest.mark.usefixtures("width")


def of_lanes(function, *arguments, **options):
    return Kernel(function, *arguments, **options)(*arguments)


def assert_as_jax(function, *arguments, roundings=4):
    """To a few roundings of what XLA gives, NaN like NaN; whole numbers and truth values exactly."""
    found, expected = of_lanes(function, *arguments), jax.jit(function)(*arguments)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.shape == other.shape and one.dtype == other.dtype
        tolerance = roundings * np.finfo(one.dtype).eps if one.dtype.kind == "f" else 0
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)


ELEMENTWISE = {
    "arithmetic": lambda x, y: (x + y) * (x - y) / y,
    "remainder": lambda x, y: (lax.rem(x, y), x % y),
    "powers": lambda x, y: (x**2, x**3, x**-5, x**0, jnp.abs(x) ** y),
    "comparisons": lambda x, y: (x < y, x > y, x <= y, x >= y, x == x, x != y),
    "truth": lambda x, y: ((x > 0) & (y > 0), (x > 0) | (y > 0), (x > 0) ^ (y > 0), ~(x > 0)),
    "extremes": lambda x, y: (jnp.maximum(x, y), jnp.minimum(x, y), jnp.clip(x, -0.5, 0.5)),
    "signs": lambda x, y: (jnp.sign(x), jnp.abs(x), -x, jnp.sign(x * 0)),
    "rounding": lambda x, y: (jnp.floor(3 * x), jnp.ceil(3 * x), jnp.round(3 * x)),
    "choices": lambda x, y: jnp.where(x > y, x, jnp.where(y > 0, y, 2.0)),
    "whole numbers": lambda x, y: ((10 * x).astype(jnp.int32), (x > 0).astype(jnp.int32), (x * 5).astype(jnp.int64)),
    "back again": lambda x, y: ((10 * x).astype(jnp.int32).astype(x.dtype), (x > 0).astype(x.dtype)),
    "roots": lambda x, y: (jnp.sqrt(jnp.abs(x)), jnp.cbrt(x), jnp.square(x)),
    "exponentials": lambda x, y: (jnp.exp(x), jnp.expm1(x), jnp.exp2(x), jnp.log(jnp.abs(x)), jnp.log1p(jnp.abs(x))),
    "circular": lambda x, y: (jnp.sin(x), jnp.cos(x), jnp.tan(x), jnp.arctan(x), jnp.arctan2(x, y)),
    "hyperbolic": lambda x, y: (jnp.tanh(x), jnp.sinh(x), jnp.cosh(x), jnp.arcsinh(x)),
    "inverse": lambda x, y: (jnp.arcsin(jnp.tanh(x)), jnp.arccos(jnp.tanh(x)), jax.scipy.special.erf(x)),
}


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", ELEMENTWISE)
def test_elementwise(name, dtype):
    assert_as_jax(ELEMENTWISE[name], X.astype(dtype), Y.astype(dtype), roundings=20)


@pytest.mark.parametrize("name", ["arithmetic", "extremes", "signs", "comparisons", "choices"])
def test_not_finite(name):
    """NaN and infinities go where IEEE 754 has them."""
    special = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, 1e308, 1e-300])
    x, y = (grid.ravel() for grid in np.meshgrid(special, special))
    found, expected = of_lanes(ELEMENTWISE[name], x, y), jax.jit(ELEMENTWISE[name])(x, y)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)
    finite, same = of_lanes(lambda x: (jnp.isfinite(x), lax.bitcast_convert_type(x, jnp.int64)), x)
    np.testing.assert_array_equal(finite, np.isfinite(x))
    np.testing.assert_array_equal(same, x.view(np.int64))


def test_subnormal_numbers():
    """They count (XLA takes some for zero)."""
    x = np.array([5e-324, 1e-310, -2.2e-308, 0.0])
    half, twice = of_lanes(lambda x: (x * 0.5, x + x), x)
    np.testing.assert_array_equal(half, x * 0.5)
    np.testing.assert_array_equal(twice, x + x)


def test_integers_divided_by_nothing():
    """As jax has it: -1, and the dividend; a processor would stop."""
    by = np.array([0, 1, -1, 2, -3, 0, 7], np.int32)
    x = np.array([5, 5, np.iinfo(np.int32).min, -7, -7, 0, 100], np.int32)
    assert_as_jax(lambda x, by: (lax.div(x, by), lax.rem(x, by), x % jnp.maximum(by, 1)), x, by)
    assert_as_jax(lambda x: (x << 3, lax.shift_right_arithmetic(x, jnp.int32(2)), x % 25), x)


ARRANGED = {
    "rows": lambda rows: (rows[2], rows[::2], rows[:, :], rows[::-1]),
    "stacked": lambda rows: jnp.stack([rows[0], rows[1]]) + jnp.concatenate([rows[3:4], rows[:1]]),
    "shapes": lambda rows: rows.reshape(7, 1, -1).transpose(1, 0, 2)[0] + rows[None, 0],
    "spread": lambda rows: rows + jnp.arange(7, dtype=rows.dtype)[:, None] * jnp.ones_like(rows[0]),
    "split": lambda rows: sum(jnp.split(rows, [2], axis=0)[1]),
    "sums": lambda rows: (rows.sum(0), rows.max(0), rows.min(0), rows.prod(0)),
    "any": lambda rows: ((rows > 1).any(0), (rows > -1).all(0)),
    "sorted": lambda rows: (jnp.sort(rows, axis=0), jnp.argsort(rows, axis=0)),
    "sorted ties": lambda rows: jnp.argsort(jnp.round(rows), axis=0),
    "sorted NaN": lambda rows: jnp.argsort(jnp.where(rows > 0, rows, jnp.nan), axis=0),
    "by number": lambda rows: jnp.take_along_axis(rows, jnp.argsort(rows, axis=0), axis=0),
    "by another": lambda rows: jnp.take_along_axis(rows, (rows * 4).astype(jnp.int32)[:2], axis=0),
}


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", ARRANGED)
def test_arranged(name, dtype):
    with jax.numpy_rank_promotion("allow"):
        assert_as_jax(ARRANGED[name], ROWS.astype(dtype), roundings=8)


def put(rows, which, new):
    return jax.vmap(lambda rows, which, new: rows.at[which].set(new, mode="drop"), in_axes=-1, out_axes=-1)(
        rows, which, new
    )


def test_a_row_is_replaced():
    """Where there is one with that number (negative ones count from the end); what was there is left as it is."""

    def function(rows, which, new):
        found = put(rows, which, new)
        return found, rows * 1.0

    found, before = of_lanes(function, ROWS, WHICH, X)
    expected = ROWS.copy()
    for lane, row in enumerate(WHICH):
        if row < len(ROWS):
            expected[row, lane] = X[lane]
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(before, ROWS)


def test_rows_are_replaced_in_a_loop():
    """In place, where nothing else wants them; and not where something does."""

    def alone(rows, which, new):
        return lax.fori_loop(0, 30, lambda k, rows: put(rows, (which + k) % 7, new + 1.0 * k), rows)

    def wanted(rows, which, new):
        def turn(k, carried):
            rows, total = carried
            after = put(rows, (which + k) % 7, new + 1.0 * k)
            return after, total + rows[0] + after[0]

        return lax.fori_loop(0, 30, turn, (rows, new))

    which = np.abs(WHICH)
    assert_as_jax(alone, ROWS, which, X)
    assert_as_jax(wanted, ROWS, which, X)


def collatz(n):
    """How many steps each number takes to 1; every lane goes on until the last is there."""

    def turn(now):
        n, steps = now
        moving = n != 1
        after = jnp.where(n % 2 == 0, n // 2, 3 * n + 1)
        return jnp.where(moving, after, n), jnp.where(moving, steps + 1, steps)

    return lax.while_loop(lambda now: jnp.any(now[0] != 1), turn, (n, jnp.zeros_like(n)))[1]


def test_loops():
    n = np.arange(1, 98)
    expected = [0, 1, 7, 2, 5, 8, 16, 3, 19, 6]  # OEIS A006577
    np.testing.assert_array_equal(of_lanes(collatz, n)[:10], expected)
    assert_as_jax(collatz, n)


def test_loops_that_carry_much():
    """More than registers hold, values that change places, and a loop within a loop."""

    def function(rows, x):
        def inner(k, now):
            a, b = now
            return b, a + 0.5 * b

        def turn(k, now):
            rows, x = now
            a, b = lax.fori_loop(0, 3, inner, (rows, rows[::-1]))
            return jnp.concatenate([b[1:], a[:1]]) * 0.3, x + a.sum(0)

        rows = jnp.concatenate([rows, 2 * rows, rows - 1, rows + 1, rows * rows])
        return lax.fori_loop(0, 5, turn, (rows, x))

    assert_as_jax(function, ROWS, X, roundings=100)


def test_branches():
    def function(x, y, limit):
        return lax.cond(jnp.any(x > limit), lambda: (x + y, y), lambda: (x - y, 2 * y))

    for limit in (0.0, 1e9):
        assert_as_jax(function, X[:4], Y[:4], np.asarray(limit))


def test_loops_along_arguments():
    """And results of every turn: here running sums, and products of rows with what is carried."""

    def function(rows, x):
        def turn(total, row):
            return total + row, (total * row, jnp.stack([row, total]))

        total, (products, pairs) = lax.scan(turn, x, rows)
        return total, products, pairs, total * 2

    assert_as_jax(function, ROWS, X)
    with pytest.raises(Untranslatable, match="something else wants"):
        Kernel(lambda rows, x: lax.scan(lambda a, row: (a + row, None), x, rows)[0] + rows[0], ROWS, X)


def test_one_for_all_lanes():
    """An argument without axes; a result that depends on nothing else."""
    assert_as_jax(lambda x, a, n: (x * a, x + n, jnp.where(n > 2, x, -x)), X, np.asarray(0.7), np.asarray(3.0))
    np.testing.assert_array_equal(of_lanes(lambda x, a: jnp.zeros_like(x) + a, X, np.asarray(0.7)), 0.7)


@pytest.mark.parametrize("lanes", [1, 2, 7, 8, 9, 16, 33, 1009])
@pytest.mark.parametrize("registers", [1, 2])
def test_any_number_of_lanes(lanes, registers):
    """The same bits, however many there are and whatever the others do."""
    n = (np.arange(lanes) * 7919) % 97 + 1
    found = of_lanes(collatz, n, registers=registers)
    alone = Kernel(collatz, n[:1])
    np.testing.assert_array_equal(found, [alone(n[lane : lane + 1])[0] for lane in range(lanes)])
    x = np.linspace(-3, 3, lanes)
    function = lambda x: jnp.exp(jnp.sin(x)) * x**3 + jnp.sqrt(jnp.abs(x))  # noqa: E731
    one = Kernel(function, x[:1])
    np.testing.assert_array_equal(
        of_lanes(function, x, registers=registers), [one(x[lane : lane + 1])[0] for lane in range(lanes)]
    )


def test_a_polynomial_and_its_derivative():
    """Forward mode goes through, loops included: d/dx of x^12 by repeated multiplication."""

    def function(x):
        return jax.jvp(lambda x: lax.fori_loop(0, 11, lambda k, y: y * x, x), (x,), (jnp.ones_like(x),))

    value, slope = of_lanes(function, X)
    np.testing.assert_allclose(value, X**12, rtol=1e-14)
    np.testing.assert_allclose(slope, 12 * X**11, rtol=1e-14)


def test_tangents_of_whole_numbers():
    """They say nothing, and take no room that is not theirs."""

    def function(x):
        return jax.jvp(lambda x: (x * x, jnp.floor(x).astype(jnp.int32), x > 0), (x,), (jnp.ones_like(x),))

    (square, whole, sign), (slope, *_) = of_lanes(function, X)
    np.testing.assert_array_equal(square, X * X)
    np.testing.assert_array_equal(slope, 2 * X)
    np.testing.assert_array_equal(whole, np.floor(X))
    np.testing.assert_array_equal(sign, X > 0)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: jnp.fft.fft(x).real,
        lambda x: x - x.mean(),
        lambda x: x[::2],
        lambda x: jnp.arange(len(x), dtype=x.dtype) * x,
        lambda x: x[::-1],
        lambda x: lax.scan(lambda a, b: (a, a * b), x, jnp.arange(3.0))[1] + 1.0,
    ],
)
def test_what_no_kernel_can_do(function):
    """What mixes lanes, or has no rule, is refused, with what it was."""
    with pytest.raises(Untranslatable, match=r"\w"):
        Kernel(function, X)
