"""Tests of kernels against numpy and XLA, for any number of lanes, each lane by itself.

Faults that kernels once had are among the cases: loops without turns, booleans and unsigned integers compared as
signed, scans from the end, missing rows, shifts by the width, floats beyond the integers, integer exponents.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from vibrojax.compile import translation
from vibrojax.compile.assembly import Untranslatable
from vibrojax.compile.native import Kernel

RANDOM = np.random.default_rng(20)
X, Y = RANDOM.normal(size=(2, 21))
ROWS = RANDOM.normal(size=(7, 21))
WHICH = RANDOM.integers(-2, 9, 21)
FLOATS = ["float64", "float32"]
INTEGERS = ["int8", "int64", "uint16", "uint32", "uint64"]
BEYOND = [np.nan, np.inf, -np.inf, 1e30, -1e30, 300.0, -300.0, -0.5, 2.0**31, 2.0**63, -(2.0**63), 2.0**64, 255.7]


def put(rows, numbers, new, mode):
    """Return rows in which each lane has replaced one."""
    return jax.vmap(lambda rows, number, new: rows.at[number].set(new, mode=mode), -1, -1)(rows, numbers, new)


def run_kernel(function, *arguments, **options):
    return Kernel(function, *arguments, **options)(*arguments)


def assert_matches_xla(function, *arguments, roundings=4):
    """Check agreement with XLA to a few roundings, NaN included; integers and booleans must be equal."""
    actual, expected = run_kernel(function, *arguments), jax.jit(function)(*arguments)
    for result, correct in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        assert result.shape == correct.shape and result.dtype == correct.dtype
        tolerance = roundings * np.finfo(result.dtype).eps if result.dtype.kind == "f" else 0
        np.testing.assert_allclose(result, correct, rtol=tolerance, atol=tolerance)


def limit_pairs(dtype):
    """Return pairs of the least, the greatest and some numbers in between."""
    limits = np.iinfo(dtype)
    numbers = np.array([limits.min, limits.min + 1, 0, 1, 2, 7, limits.max // 2 + 1, limits.max - 1, limits.max], dtype)
    return tuple(grid.ravel() for grid in np.meshgrid(numbers, numbers))


FUNCTIONS = {
    "powers": lambda x, y: (x**2, x**3, x**-3, x**-5, x**7, x**0, lax.square(x), jnp.abs(x) ** y),
    "roots": lambda x, y: (jnp.sqrt(jnp.abs(x)), jnp.cbrt(x), jnp.square(x)),
    "exponentials": lambda x, y: (jnp.exp(x), jnp.expm1(x), jnp.exp2(x), jnp.log(jnp.abs(x)), jnp.log1p(jnp.abs(x))),
    "circular": lambda x, y: (jnp.sin(x), jnp.cos(x), jnp.tan(x), jnp.arctan(x), jnp.arctan2(x, y)),
    "hyperbolic": lambda x, y: (jnp.tanh(x), jnp.sinh(x), jnp.cosh(x), jnp.arcsinh(x)),
    "inverse": lambda x, y: (jnp.arcsin(jnp.tanh(x)), jnp.arccos(jnp.tanh(x)), jax.scipy.special.erf(x)),
}


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name, dtype):
    assert_matches_xla(FUNCTIONS[name], X.astype(dtype), Y.astype(dtype), roundings=20)


def test_powers_of_integer_exponents():
    n = np.arange(-3, 18)
    assert_matches_xla(
        lambda x, n: (lax.pow(x, n), lax.pow(x.astype(jnp.float32), n.astype(jnp.int8))), X, n, roundings=20
    )


ARRANGEMENTS = {
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


@pytest.mark.parametrize("name", ARRANGEMENTS)
def test_arrangements(name):
    with jax.numpy_rank_promotion("allow"):
        assert_matches_xla(ARRANGEMENTS[name], ROWS, roundings=8)


@pytest.mark.parametrize("dtype", INTEGERS)
def test_integers(dtype):
    """Unsigned integers have no sign. Division by 0 and shifts by any number agree with jax."""
    x, y = limit_pairs(dtype)
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

    assert_matches_xla(function, x, y)
    if dtype.startswith("i"):
        assert_matches_xla(lambda x: lax.abs(x), x)
    rows = np.stack([x, y, np.roll(x, 5)])
    assert_matches_xla(lambda rows: (jnp.sort(rows, 0), rows.max(0), rows.min(0)), rows)


ROW_NUMBERS = {
    "usual": lambda x, which: jnp.take_along_axis(x, which, 0),
    **{
        mode: lambda x, which, mode=mode: jnp.take_along_axis(x, which, 0, mode=mode)
        for mode in ("clip", "fill", "promise_in_bounds")
    },
    "fill value": lambda x, which: jnp.take_along_axis(x, which, 0, mode="fill", fill_value=5),
    "table": lambda x, which: jnp.take(jnp.arange(3, dtype=x.dtype), which[0], mode="fill"),
    "put": lambda x, which: [put(x, which[0], x[1], mode) for mode in ("drop", "clip")],
}


@pytest.mark.parametrize("dtype", [*INTEGERS, *FLOATS])
def test_missing_rows(dtype):
    """Missing rows have the fill value, or jax's own: NaN, the least or the greatest integer."""
    rows, which = (ROWS * 10).astype(dtype), np.stack([WHICH, WHICH[::-1] * 3])
    assert_matches_xla(lambda rows, which: {name: take(rows, which) for name, take in ROW_NUMBERS.items()}, rows, which)


@pytest.mark.parametrize("given", FLOATS)
def test_conversion_of_floats(given):
    """A float becomes the nearest integer of the type, and NaN becomes 0."""
    x = np.array([*BEYOND, *X], given)
    assert_matches_xla(lambda x: [(x.astype(to), (x > 0).astype(to)) for to in [*INTEGERS, "bool"]], x)


@pytest.mark.parametrize("dtype", INTEGERS)
def test_conversion_of_integers(dtype):
    assert_matches_xla(
        lambda x: [x.astype(to) for to in [*INTEGERS, *FLOATS, "bool"]], limit_pairs(dtype)[0], roundings=1
    )


def test_signs_of_zeros(width):
    zeros = np.array([0.0, -0.0, 0.0, -0.0, 1.0, np.nan]), np.array([-0.0, 0.0, 0.0, -0.0, np.nan, -1.0])

    def function(x, y):
        extremes = lax.max(x, y), lax.min(x, y), jnp.maximum(x, 0.0), jnp.maximum(0.0, x), jnp.minimum(x, -0.0)
        extremes += jnp.minimum(-0.0, x), jnp.minimum(x, 0.0), jnp.maximum(x, -0.0), jnp.maximum(abs(x), -abs(y))
        extremes += jnp.maximum(x, abs(y)), jnp.minimum(abs(x), y), jnp.minimum(abs(x), abs(y)), jnp.clip(x, -0.0, 1.0)
        return extremes, [jnp.signbit(x) for x in extremes]

    actual, expected = run_kernel(function, *zeros), jax.jit(function)(*zeros)
    for x, (result, correct) in enumerate(
        zip(*(jax.tree.leaves(outputs) for outputs in (actual, expected)), strict=True)
    ):
        known = ~np.isnan(np.asarray(jax.tree.leaves(expected)[x % 13]))
        np.testing.assert_array_equal(result[known], correct[known])


def test_subnormal_numbers_are_kept():
    """Every rule keeps them, as numpy does. XLA sets the processor to treat them as 0."""
    x = np.array([5e-324, -1e-310, 2.2e-308, -0.0, 1e-300])

    def function(x, np=jnp):
        return x > 0, x == 0, x * 2, x * 0.5, x + x, abs(x), np.sign(x), np.maximum(x, 0.0), np.floor(x), -x

    actual, expected = run_kernel(function, x), function(x, np)
    for result, correct in zip(actual, expected, strict=True):
        np.testing.assert_array_equal(result, correct)


def test_rows_are_replaced_in_a_loop(width):
    """Rows are replaced in place, unless something else needs them."""

    def unshared(rows, which, new):
        return lax.fori_loop(0, 30, lambda k, rows: put(rows, (which + k) % 7, new + 1.0 * k, "drop"), rows)

    def shared(rows, which, new):
        def turn(k, carried):
            rows, total = carried
            after = put(rows, (which + k) % 7, new + 1.0 * k, "drop")
            return after, total + rows[0] + after[0]

        return lax.fori_loop(0, 30, turn, (rows, new))

    which = np.abs(WHICH)
    assert_matches_xla(unshared, ROWS, which, X)
    assert_matches_xla(shared, ROWS, which, X)


def collatz(n):
    """Return how many steps each number takes to 1; every lane continues until the last is done."""

    def turn(now):
        n, steps = now
        moving = n != 1
        after = jnp.where(n % 2 == 0, n // 2, 3 * n + 1)
        return jnp.where(moving, after, n), jnp.where(moving, steps + 1, steps)

    return lax.while_loop(lambda now: jnp.any(now[0] != 1), turn, (n, jnp.zeros_like(n)))[1]


def test_loops():
    n = np.arange(1, 98)
    expected = [0, 1, 7, 2, 5, 8, 16, 3, 19, 6]  # OEIS A006577
    np.testing.assert_array_equal(run_kernel(collatz, n)[:10], expected)
    assert_matches_xla(collatz, n)


def test_loops_with_large_carry():
    """The loop carries more than registers hold, exchanges values, and contains a loop."""

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

    assert_matches_xla(function, ROWS, X, roundings=100)


def test_branches():
    def function(x, y, limit):
        return lax.cond(jnp.any(x > limit), lambda: (x + y, y), lambda: (x - y, 2 * y))

    for limit in (0.0, 1e9):
        assert_matches_xla(function, X[:4], Y[:4], np.asarray(limit))


def test_loops_along_arguments():
    """Every turn also gives results: running sums, and products of rows with the carried value."""

    def function(rows, x):
        def turn(total, row):
            return total + row, (total * row, jnp.stack([row, total]))

        total, (products, pairs) = lax.scan(turn, x, rows)
        return total, products, pairs, total * 2

    assert_matches_xla(function, ROWS, X)
    with pytest.raises(Untranslatable, match="something else wants"):
        Kernel(lambda rows, x: lax.scan(lambda a, row: (a + row, None), x, rows)[0] + rows[0], ROWS, X)


@pytest.mark.parametrize("lanes", [1, 33])
@pytest.mark.parametrize("registers", [1, 2])
def test_any_number_of_lanes(lanes, registers, width):
    """The bits do not depend on the number of lanes, nor on the other lanes."""
    n = (np.arange(lanes) * 7919) % 97 + 1
    together = run_kernel(collatz, n, registers=registers)
    single = Kernel(collatz, n[:1])
    np.testing.assert_array_equal(together, [single(n[lane : lane + 1])[0] for lane in range(lanes)])
    x = np.linspace(-3, 3, lanes)
    function = lambda x: jnp.exp(jnp.sin(x)) * x**3 + jnp.sqrt(jnp.abs(x))  # noqa: E731
    single_lane = Kernel(function, x[:1])
    np.testing.assert_array_equal(
        run_kernel(function, x, registers=registers), [single_lane(x[lane : lane + 1])[0] for lane in range(lanes)]
    )


def test_loops_without_turns_and_from_the_end():
    """The rows of a scan from the end are the last first; a loop without turns returns what it is given."""

    assert_matches_xla(lambda x: lax.fori_loop(0, 0, lambda _, y: y + 1.0, x), X)
    assert_matches_xla(lambda x: lax.while_loop(lambda y: jnp.any(y > 1e9), lambda y: y + 1.0, x), X)
    for rows in (ROWS, ROWS[:0]):
        assert_matches_xla(lambda rows, x: lax.scan(lambda a, b: (a * 0.5 + b, a), x, rows, reverse=True), rows, X)


def test_booleans_are_ordered():
    def function(x, y):
        a, b = x > 0, y > 0
        return a < b, a <= b, a > b, a >= b, lax.max(a, b), lax.min(a, b), jnp.sort(jnp.stack([a, b]), axis=0)

    assert_matches_xla(function, X, Y)


def test_tangents_of_integers():
    """They have no content, and must not occupy memory of other values."""

    def function(x):
        return jax.jvp(lambda x: (x * x, jnp.floor(x).astype(jnp.int32), x > 0), (x,), (jnp.ones_like(x),))

    (square, whole, sign), (slope, *_) = run_kernel(function, X)
    np.testing.assert_array_equal(square, X * X)
    np.testing.assert_array_equal(slope, 2 * X)
    np.testing.assert_array_equal(whole, np.floor(X))
    np.testing.assert_array_equal(sign, X > 0)


REFUSED = {
    "argmax": lambda x: jnp.argmax(jnp.stack([x, -x]), 0),
    "no rows": lambda x: lax.reduce_max(jnp.zeros((0, *x.shape)), (0,)),
    "a choice of three": lambda x: lax.select_n((x > 0).astype(jnp.int32), x, -x, 2 * x),
    "half precision": lambda x: x.astype(jnp.float16),
    "a mean over lanes": lambda x: x - x.mean(),
    "some lanes": lambda x: x[::2],
    "lanes by number": lambda x: x[jnp.array([0, 0, 1])],
    "along the lanes": lambda x: lax.scan(lambda total, y: (total + y, total), 0.0, x)[1],
    "an unsigned row number": lambda x: jnp.take(jnp.arange(3.0), (x > 0).astype(jnp.uint64)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    with pytest.raises(Untranslatable, match=r"\w"):
        Kernel(REFUSED[name], X)


def test_unknown_parameters():
    """A later jax cannot change the meaning of a primitive silently."""
    with pytest.raises(Untranslatable, match="add with the unknown parameter saturating"):
        translation.check_parameters("add", {"saturating": True})
    with pytest.raises(Untranslatable, match="mul with out_dtype = float32"):
        translation.check_parameters("mul", {"out_dtype": "float32"})
    with pytest.raises(Untranslatable, match="sort without the parameter num_keys"):
        translation.check_parameters("sort", {"dimension": 0, "is_stable": True})
    with pytest.raises(Untranslatable, match="gather with mode = ONE_HOT"):
        translation.check_parameters("gather", {"dimension_numbers": None, "mode": "ONE_HOT", "fill_value": None})
    assert set(translation.PARAMETERS) <= translation.primitives()
