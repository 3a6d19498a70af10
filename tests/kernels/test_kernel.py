"""Tests of kernels against numpy and XLA at limits of numbers, for any number of lanes, their object code and trees."""

import struct
import sys
from collections import OrderedDict, namedtuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from vibrojax.compile import cache, native, translation
from vibrojax.compile.assembly import Untranslatable
from vibrojax.compile.native import Kernel, kernel_for, trace
from vibrojax.compile.trees import flatten, map_leaves, unflatten

RANDOM = np.random.default_rng(20)
X, Y = RANDOM.normal(size=(2, 21))
FLOATS = ["float64", "float32"]
INTEGERS = ["int8", "int64", "uint16", "uint32", "uint64"]
BEYOND = [np.nan, np.inf, -np.inf, 1e30, -1e30, 300.0, -300.0, -0.5, 2.0**31, 2.0**63, -(2.0**63), 2.0**64, 255.7]


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
    numbers = [limits.min, limits.min + 1, -int(limits.min < 0), 0, 1, 2, 7, limits.max // 2 + 1, limits.max]
    return tuple(grid.ravel() for grid in np.meshgrid(np.array(numbers, dtype), np.array(numbers, dtype)))


@pytest.mark.parametrize("dtype", FLOATS)
def test_functions(dtype):
    """They are accurate to some roundings."""

    def function(x, y):
        yield from (x**2, x**3, x**-3, x**-5, x**7, x**0, jnp.abs(x) ** y, jnp.sqrt(jnp.abs(x)), jnp.cbrt(x))
        yield from (jnp.exp(x), jnp.expm1(x), jnp.exp2(x), jnp.log(jnp.abs(x)), jnp.log1p(jnp.abs(x)))
        yield from (jnp.sin(x), jnp.cos(x), jnp.tan(x), jnp.arctan(x), jnp.arctan2(x, y), jax.scipy.special.erf(x))
        yield from (jnp.tanh(x), jnp.sinh(x), jnp.cosh(x), jnp.arcsinh(x), jnp.arcsin(jnp.tanh(x)))

    assert_matches_xla(lambda x, y: list(function(x, y)), X.astype(dtype), Y.astype(dtype), roundings=20)


@pytest.mark.parametrize("dtype", INTEGERS)
def test_integers(dtype):
    """Unsigned integers have no sign. Division by 0 and shifts by any number agree with jax."""
    x, y = limit_pairs(dtype)

    def function(x, y):
        yield from (x < y, x <= y, x > y, x >= y, x == y, x != y, lax.max(x, y), lax.min(x, y))
        yield from (lax.div(x, y), lax.rem(x, y), x // y, x % y)
        yield from (x << y, x >> y, lax.shift_right_logical(x, y), x << 3, lax.shift_right_arithmetic(x, y))
        yield from (x + y, x - y, x * y, -x, lax.sign(x), x**2, x**3, lax.integer_pow(x, 7), lax.integer_pow(x, 0))
        yield from (lax.abs(x) if dtype.startswith("i") else ~x, jnp.sort(jnp.stack([x, y, jnp.maximum(x, y)]), 0))

    assert_matches_xla(lambda x, y: list(function(x, y)), x, y)


@pytest.mark.parametrize("given", [*FLOATS, *INTEGERS])
def test_conversions(given):
    """A float becomes the nearest integer of the type, and NaN becomes 0."""
    x = np.array([*BEYOND, *X], given) if given in FLOATS else limit_pairs(given)[0]
    to = [*INTEGERS, "bool"] if given in FLOATS else [*INTEGERS, *FLOATS, "bool"]
    assert_matches_xla(lambda x: [(x.astype(name), (x > 0).astype(name)) for name in to], x, roundings=1)


def test_signs_of_zeros(width):
    zeros = np.array([0.0, -0.0, 0.0, -0.0, 1.0, np.nan]), np.array([-0.0, 0.0, 0.0, -0.0, np.nan, -1.0])

    def function(x, y):
        extremes = lax.max(x, y), lax.min(x, y), jnp.maximum(x, 0.0), jnp.maximum(0.0, x), jnp.minimum(x, -0.0)
        extremes += jnp.minimum(-0.0, x), jnp.minimum(x, 0.0), jnp.maximum(x, -0.0), jnp.maximum(abs(x), -abs(y))
        extremes += jnp.maximum(x, abs(y)), jnp.minimum(abs(x), y), jnp.minimum(abs(x), abs(y)), jnp.clip(x, -0.0, 1.0)
        return extremes

    with jax.debug_nans(False):
        actual, expected = run_kernel(function, *zeros), jax.jit(function)(*zeros)
    for result, correct in zip(actual, map(np.asarray, expected), strict=True):
        np.testing.assert_array_equal(result, correct)
        known = ~np.isnan(correct)
        np.testing.assert_array_equal(np.signbit(result)[known], np.signbit(correct)[known])


def test_subnormal_numbers_are_kept():
    """Every rule keeps them, as numpy does. XLA sets the processor to treat them as 0."""
    x = np.array([5e-324, -1e-310, 2.2e-308, -0.0, 1e-300])

    def function(x, np=jnp):
        return x > 0, x == 0, x * 2, x * 0.5, x + x, abs(x), np.sign(x), np.maximum(x, 0.0), np.floor(x), -x

    for result, correct in zip(run_kernel(function, x), function(x, np), strict=True):
        np.testing.assert_array_equal(result, correct)


def put(rows, numbers, new, mode):
    """Return rows in which each lane has replaced one."""
    return jax.vmap(lambda rows, number, new: rows.at[number].set(new, mode=mode), -1, -1)(rows, numbers, new)


def test_rows_are_replaced_in_a_loop(width):
    """Rows are replaced in place, unless something else needs them."""

    def function(rows, which, new):
        def turn(k, carried):
            rows, total = carried
            after = put(rows, (which + k) % 7, new + 1.0 * k, "drop")
            return after, total + rows[0] + after[0]

        return lax.fori_loop(0, 30, turn, (rows, new))

    rows = np.stack([X * k for k in range(7)] * 4)
    assert_matches_xla(function, rows, np.arange(21) % 7, X)


def test_bits_and_tangents_of_integers():
    """With a conversion from i8 to i8, LLVM 22 omitted a later store."""
    traced = trace(lambda x, bits: (x, lax.bitcast_convert_type(bits, jnp.int8)), X, np.uint8(3))
    assert "bitcast" not in translation.kernel_text(traced.jaxpr, 8).text
    # They have no content, and must not occupy memory of other values.
    function = lambda x: jax.jvp(lambda x: (x * x, jnp.floor(x).astype(jnp.int32), x > 0), (x,), (jnp.ones_like(x),))
    (square, whole, sign), (slope, *_) = run_kernel(function, X)
    for result, correct in ((square, X * X), (slope, 2 * X), (whole, np.floor(X)), (sign, X > 0)):
        np.testing.assert_array_equal(result, correct)


def collatz(n):
    """Return how many steps each number takes to 1; every lane continues until the last is done."""

    def turn(now):
        n, steps = now
        moving = n != 1
        after = jnp.where(n % 2 == 0, n // 2, 3 * n + 1)
        return jnp.where(moving, after, n), jnp.where(moving, steps + 1, steps)

    return lax.while_loop(lambda now: jnp.any(now[0] != 1), turn, (n, jnp.zeros_like(n)))[1]


@pytest.mark.parametrize("lanes", [1, 33])
@pytest.mark.parametrize("registers", [1, 2])
def test_any_number_of_lanes(lanes, registers, width):
    """The bits do not depend on the number of lanes, nor on the other lanes."""
    n = (np.arange(lanes) * 7919) % 97 + 1
    x = np.linspace(-3, 3, lanes)
    function = lambda n, x: (collatz(n), jnp.exp(jnp.sin(x)) * x**3 + jnp.sqrt(jnp.abs(x)))
    together, single = run_kernel(function, n, x, registers=registers), Kernel(function, n[:1], x[:1])
    alone = [single(n[lane : lane + 1], x[lane : lane + 1]) for lane in range(lanes)]
    np.testing.assert_array_equal(together, np.concatenate(alone, axis=1))
    expected = [0, 1, 7, 2, 5, 8, 16, 3, 19, 6]  # OEIS A006577
    np.testing.assert_array_equal(run_kernel(collatz, np.arange(1, 11)), expected)


REFUSED = {
    "argmax": lambda x: jnp.argmax(jnp.stack([x, -x]), 0),
    "no rows": lambda x: lax.reduce_max(jnp.zeros((0, *x.shape)), (0,)),
    "a choice of three": lambda x: lax.select_n((x > 0).astype(jnp.int32), x, -x, 2 * x),
    "half precision": lambda x: x.astype(jnp.float16),
    "a mean over lanes": lambda x: x - x.mean(),
    "some lanes": lambda x: x[::2],
    "lanes by number": lambda x: x[jnp.array([0, 0, 1])],
    "along the lanes": lambda x: lax.scan(lambda total, y: (total + y, total), 0.0, x)[1],
    "along a stack": lambda x: lax.scan(lambda a, row: (a + row, None), x, jnp.stack([x, x]))[0],
    "an unsigned row number": lambda x: jnp.take(jnp.arange(3.0), (x > 0).astype(jnp.uint64)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    with pytest.raises(Untranslatable, match=r"\w"):
        Kernel(REFUSED[name], X)


def test_refused_functions_are_traced_once_and_unknown_parameters_refused():
    """A later jax cannot change the meaning of a primitive silently."""
    for name in translation.primitives():
        with pytest.raises(Untranslatable, match=f"{name} with(out)? the (unknown )?parameter"):
            translation.check_parameters(name, {"of a later jax": True})
    for name, parameters, words in (
        ("mul", {"out_dtype": "float32"}, "with out_dtype = float32"),
        ("sort", {"dimension": 0, "is_stable": True}, "without the parameter num_keys"),
        ("gather", {"dimension_numbers": None, "mode": "ONE_HOT", "fill_value": None}, "with mode = ONE_HOT"),
    ):
        with pytest.raises(Untranslatable, match=f"{name} {words}"):
            translation.check_parameters(name, parameters)
    assert set(translation.PARAMETERS) <= translation.primitives()
    # Each later call runs on XLA at once.
    traced = []

    def function(x):
        traced.append(x)
        return x[::2]

    for _ in range(2):
        with pytest.raises(Untranslatable, match="some of the lanes"):
            kernel_for(function, (), X)
    assert len(traced) == 1


RELOCATIONS, WHOLE_ADDRESS = 4, 1  # SHT_RELA, R_X86_64_64 (ELF-64 and x86-64 psABI)


def references(code: bytes) -> list[int]:
    """Return the types of all references in an ELF object file."""
    start, size, count = struct.unpack_from("<Q", code, 40)[0], *struct.unpack_from("<HH", code, 58)
    types = []
    for section in range(count):
        kind, offset, length = struct.unpack_from("<4xI16xQQ", code, start + section * size)
        if kind == RELOCATIONS:
            types += [struct.unpack_from("<8xI", code, offset + entry)[0] for entry in range(0, length, 24)]
    return types


@pytest.mark.skipif(sys.platform != "linux" or "x86_64" not in native.processor().triple, reason="reads ELF for x86-64")
def test_references_are_whole_addresses(monkeypatch, tmp_path):
    """Shorter references once ended the process in one of some dozens of kernels, whose parts lay too far apart."""
    monkeypatch.setenv("VIBROJAX_CACHE", str(tmp_path))
    x = np.linspace(0.1, 2.0, 9)
    function = lambda x: jnp.exp(x) * 3.7 + jnp.arctan2(x, 0.3) + jnp.where(x > 1.1, -x, x)
    np.testing.assert_allclose(Kernel(function, x)(x), np.asarray(function(x)), rtol=1e-14)
    [file] = cache.folder().iterdir()
    code = file.read_bytes()[cache.HEADER :]
    assert references(code) and set(references(code)) == {WHOLE_ADDRESS}


DTYPES = {"float64": 1.5, "float32": 1.5, "int8": 3, "int16": 3, "bool": True}


@pytest.mark.parametrize("length", [0, 1, 7, 40])
def test_selected_lanes_in_place(length):
    """Lanes at any index, of numbers of every size, are read and written at their own places only."""
    random = np.random.default_rng(length)
    rows = {name: random.permutation(40 * 3).reshape(3, 40).astype(name) for name in DTYPES}

    def function(rows, factor):
        return {name: x ^ True if name == "bool" else x * factor.astype(name) for name, x in rows.items()}

    bound = Kernel(function, rows, np.float64(2)).bind(rows, np.float64(2))
    for result in bound.results.values():
        result[...] = 1
    lanes = random.permutation(40)[:length]
    bound(lanes)
    for name, result in bound.results.items():
        expected = np.ones_like(rows[name])
        expected[:, lanes] = ~rows[name][:, lanes] if name == "bool" else rows[name][:, lanes] * np.array(2, name)
        np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize("lanes", [[0, 40], [-1], [2**62], [0.0], [[0]]], ids=str)
def test_wrong_index_writes_nothing(lanes):
    """It is refused before the machine code runs, which would overwrite other memory."""
    x = np.linspace(0.1, 2.0, 40)
    bound = Kernel(lambda x: x + 1.0, x).bind(x)
    bound.results[...] = 7.0
    with pytest.raises(IndexError, match="lanes"):
        bound(np.array(lanes))
    assert (bound.results == 7.0).all()


def test_trees_are_those_of_jax():
    """Kernels number their arguments as jax does, and results are put together again from their numbers."""
    pair = namedtuple("Pair", "first second", defaults=((),))
    tree = {2: 1, -1: OrderedDict(b=np.ones(2), a=[2, None, (), []])}, pair([pair({"b": 1, "B": "3"}), jnp.ones(2)]), {}
    leaves, structure = flatten(tree)
    expected, by_jax = jax.tree.flatten(tree)
    assert list(map(id, leaves)) == list(map(id, expected)) and structure != flatten(tree[1])[1]
    numbers = range(len(leaves))
    assert repr(unflatten(structure, numbers)) == repr(jax.tree.unflatten(by_jax, numbers))
    assert repr(map_leaves(lambda *x: x, tree, tree)) == repr(jax.tree.map(lambda *x: x, tree, tree))
