"""A kernel gives what the function gives: against numpy and XLA, for any number of lanes, each lane by itself.

Random functions (test_random_functions.py) compare every primitive with XLA, for all types and at the ends of types.
Here are exact references, and what random functions do not reach: more rows, all pairs of ends, refusals.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from random_functions import put

from vibrojax.compile.kernels import Kernel, Untranslatable, translation

RANDOM = np.random.default_rng(20)
X, Y = RANDOM.normal(size=(2, 21))
ROWS = RANDOM.normal(size=(7, 21))
WHICH = RANDOM.integers(-2, 9, 21)
FLOATS = ["float64", "float32"]
INTEGERS = ["int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"]
BEYOND = [np.nan, np.inf, -np.inf, 1e30, -1e30, 300.0, -300.0, -0.5, 2.0**31, 2.0**63, -(2.0**63), 2.0**64, 255.7]


def of_lanes(function, *arguments, **options):
    return Kernel(function, *arguments, **options)(*arguments)


def assert_as_jax(function, *arguments, roundings=4):
    """To a few roundings of what XLA gives, NaN like NaN; whole numbers and truth values exactly."""
    found, expected = of_lanes(function, *arguments), jax.jit(function)(*arguments)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.shape == other.shape and one.dtype == other.dtype
        tolerance = roundings * np.finfo(one.dtype).eps if one.dtype.kind == "f" else 0
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)


def ends(dtype):
    """Pairs of the least, the greatest and some numbers in between."""
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
    """To twenty roundings; random functions allow XLA's larger errors at the ends of ranges."""
    assert_as_jax(FUNCTIONS[name], X.astype(dtype), Y.astype(dtype), roundings=20)


def test_powers_of_integer_exponents():
    n = np.arange(-3, 18)
    assert_as_jax(lambda x, n: (lax.pow(x, n), lax.pow(x.astype(jnp.float32), n.astype(jnp.int8))), X, n, roundings=20)


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


@pytest.mark.parametrize("name", ARRANGED)
def test_arranged(name):
    with jax.numpy_rank_promotion("allow"):
        assert_as_jax(ARRANGED[name], ROWS, roundings=8)


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
def test_rows_that_do_not_exist(dtype):
    """They are filled with the fill value, or with jax's own: NaN, the least or the greatest integer."""
    rows, which = (ROWS * 10).astype(dtype), np.stack([WHICH, WHICH[::-1] * 3])
    assert_as_jax(lambda rows, which: {name: of(rows, which) for name, of in ROW_NUMBERS.items()}, rows, which)


@pytest.mark.parametrize("given", FLOATS)
def test_floats_become_integers(given):
    """The nearest there is, and 0 for NaN."""
    x = np.array([*BEYOND, *X], given)
    assert_as_jax(lambda x: [(x.astype(to), (x > 0).astype(to)) for to in [*INTEGERS, "bool"]], x)


@pytest.mark.parametrize("dtype", INTEGERS)
def test_integers_become_others(dtype):
    assert_as_jax(lambda x: [x.astype(to) for to in [*INTEGERS, *FLOATS, "bool"]], ends(dtype)[0], roundings=1)


def test_zeros_have_signs(width):
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

    def function(x, np=jnp):
        return x > 0, x == 0, x * 2, x * 0.5, x + x, abs(x), np.sign(x), np.maximum(x, 0.0), np.floor(x), -x

    found, expected = of_lanes(function, x), function(x, np)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_row_is_replaced(width):
    """Where there is one with that number (negative ones count from the end); what was there is left as it is."""

    def function(rows, which, new):
        found = put(rows, which, new, "drop")
        return found, rows * 1.0

    found, before = of_lanes(function, ROWS, WHICH, X)
    expected = ROWS.copy()
    for lane, row in enumerate(WHICH):
        if row < len(ROWS):
            expected[row, lane] = X[lane]
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(before, ROWS)


def test_rows_are_replaced_in_a_loop(width):
    """In place, where nothing else wants them; and not where something does."""

    def alone(rows, which, new):
        return lax.fori_loop(0, 30, lambda k, rows: put(rows, (which + k) % 7, new + 1.0 * k, "drop"), rows)

    def wanted(rows, which, new):
        def turn(k, carried):
            rows, total = carried
            after = put(rows, (which + k) % 7, new + 1.0 * k, "drop")
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


@pytest.mark.parametrize("lanes", [1, 7, 16, 33, 1009])
@pytest.mark.parametrize("registers", [1, 2])
def test_any_number_of_lanes(lanes, registers, width):
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
    "Fourier transforms": lambda x: jnp.fft.fft(x).real,
    "a mean over lanes": lambda x: x - x.mean(),
    "some lanes": lambda x: x[::2],
    "the numbers of lanes": lambda x: jnp.arange(len(x), dtype=x.dtype) * x,
    "lanes backwards": lambda x: x[::-1],
    "a result along a captured array": lambda x: lax.scan(lambda a, b: (a, a * b), x, jnp.arange(3.0))[1] + 1.0,
    "lanes in another order": lambda x: jnp.stack([x, x]).T.reshape(2, -1),
    "lanes beside lanes": lambda x: jnp.concatenate([x, x]),
    "lanes apart": lambda x: sum(jnp.split(x, [3])[0]),
    "lanes by number": lambda x: x[jnp.array([0, 0, 1])],
    "a lane": lambda x: lax.dynamic_slice(x, (3,), (1,)) + x,
    "shared by lanes": lambda x: jnp.zeros(8).at[(x > 0).astype(int)].set(x)[0] + x,
    "along the lanes": lambda x: lax.scan(lambda total, y: (total + y, total), 0.0, x)[1],
    "sorted lanes": lambda x: jnp.sort(x),
    "an unsigned row number": lambda x: jnp.take(jnp.arange(3.0), (x > 0).astype(jnp.uint64)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    """What mixes lanes, or has no rule, is refused, with what it was."""
    with pytest.raises(Untranslatable, match=r"\w"):
        Kernel(REFUSED[name], X)


def test_without_lanes():
    with pytest.raises(Untranslatable, match="no argument has lanes"):
        Kernel(lambda x: x + 1, 1.0)


def test_unknown_parameters():
    """A later jax cannot change a meaning silently."""
    with pytest.raises(Untranslatable, match="add with the unknown parameter saturating"):
        translation.check_parameters("add", {"saturating": True})
    with pytest.raises(Untranslatable, match="mul with out_dtype = float32"):
        translation.check_parameters("mul", {"out_dtype": "float32"})
    with pytest.raises(Untranslatable, match="sort without the parameter num_keys"):
        translation.check_parameters("sort", {"dimension": 0, "is_stable": True})
    with pytest.raises(Untranslatable, match="gather with mode = ONE_HOT"):
        translation.check_parameters("gather", {"dimension_numbers": None, "mode": "ONE_HOT", "fill_value": None})
    assert set(translation.PARAMETERS) <= translation.primitives()


def test_texts_of_refusals_are_written_only_for_refusals(monkeypatch):
    """The text of a loop's body costs more than its translation."""
    monkeypatch.setattr(type(jax.make_jaxpr(jnp.sin)(1.0)), "__str__", lambda _: pytest.fail("a body was printed"))
    monkeypatch.setattr(type(jax.make_jaxpr(jnp.sin)(1.0)), "__repr__", lambda _: pytest.fail("a body was printed"))
    halved = of_lanes(lambda x: lax.while_loop(lambda x: jnp.any(x > 1), lambda x: x / 2, x), np.array([1.0, 3.0]))
    assert halved.tolist() == [0.25, 0.75]


def test_equations_that_nothing_reads_are_left_out():
    def unused_sort(x):
        lax.sort((x, x, x), dimension=0, num_keys=2)  # kernels have no sort by two keys
        return 2 * x[0]

    assert np.array_equal(of_lanes(unused_sort, ROWS), 2 * ROWS[0])
