"""Random programs of every primitive in every number type: kernels and XLA compute the same bits.

After each instruction, floats become multiples of 1/8 up to 4. Sums and products of a few of these are exact, and what
is rounded is far from the bounds between them. So no comparison needs a tolerance, and no rounding error decides which
element a choice, an index or a loop takes.
"""

from inspect import isgenerator, signature

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.interpreters import ad

from tests.kernels.test_kernel import put
from vibrojax.compile import elementwise, native, rows, translation
from vibrojax.compile.assembly import LLVM_TYPES
from vibrojax.compile.native import Kernel, trace

ROWS, LANES, PROGRAMS = 4, 16, 32
TYPES = tuple(map(str, LLVM_TYPES))
FLOATS, NUMBERS = ("float64", "float32"), tuple(name for name in TYPES if name != "bool")
ROW_NUMBERS = [name for name in NUMBERS if "int" in name and name != "uint64"]


@jax.custom_jvp
def exact(x):
    """Return a multiple of 1/8 near a float. The bounds between them are no quotients of such multiples."""
    return jnp.where(x == x, jnp.clip(jnp.floor(8 * x + 0.3), -32, 32) / 8, -3.5)


@jax.custom_vjp
def less(x):
    return x * x - x


exact.defjvp(lambda x, slope: (exact(*x), exact(*slope)))
less.defvjp(lambda x: (less(x), None), lambda _, slope: (slope,))

FUNCTIONS = {
    **{name: getattr(lax, f"bitwise_{name}") for name in ("and", "or", "xor", "not")},
    **{name: lambda x, name=name: getattr(lax, name)(x / 4.25) for name in ("asin", "acos", "atanh")},
    **{name: lambda x, name=name: getattr(lax, name)(abs(x) + 1.125) for name in ("sqrt", "log", "log1p", "acosh")},
    "copy": jnp.copy,
    "add_any": ad.add_jaxvals,
    "custom_vjp_call": less,
}


class Program:
    """Instructions on values, drawn anew in each trace, but the same. `deck`: names, and types of the arguments."""

    def __init__(self, seed, values, deck):
        self.random, self.values, self.results = np.random.default_rng(seed), list(values), []
        self.lanes = max(x.shape[-1] for x in values if x.ndim)
        for name, dtype in deck:
            with jax.numpy_dtype_promotion("standard"):
                results = getattr(self, f"_{name}", lambda dtype, name=name: self._elementwise(name, dtype))(dtype)
            results = [exact(x) if x.dtype.kind == "f" else x for x in jax.tree.leaves([*results] if isgenerator(results) else results)]
            self.results += results
            rows = [x.reshape(-1, self.lanes) if self.lanes in x.shape else x.ravel() for x in results if x.ndim]
            self.values += [x[row] for x in rows for row in {0, len(x) - 1}]
            self.values += [x for x in results if x.shape in ((), (ROWS, self.lanes))]

    def one_of(self, items):
        return items[self.random.integers(len(items))]

    def value(self, dtype, shape=None):
        """Return a value, broadcast to a shape, by default that of rows."""
        shape = (ROWS, self.lanes) if shape is None else shape
        x = self.one_of([x for x in self.values if x.dtype == dtype and x.ndim <= len(shape)][-6:])
        return jnp.broadcast_to(x, shape)

    def like(self, *dtypes):
        shape = self.one_of([(), (self.lanes,), (ROWS, self.lanes)])
        return [self.value(dtype, shape) for dtype in dtypes]

    def block(self, dtype):
        return jnp.stack([self.value(dtype), self.value(dtype)], self.one_of([0, 1]))

    def numbers(self, shape, mode):
        """Return row numbers, some of which do not exist, unless the mode promises that they do."""
        x = lax.rem(self.value("int8", shape), jnp.int8(7))
        x = abs(x) % ROWS if mode == "promise_in_bounds" else x
        return x.astype(self.one_of(ROW_NUMBERS))

    def body(self, turns=4, choices=None):
        """Return a random function of some values that returns as many of the same types."""
        seed, names = int(self.random.integers(2**32)), choices or SIMPLE
        deck = [self.one_of(names) for _ in range(turns)]

        def function(*carry):
            inner = Program(seed, [*self.values, *carry], deck)
            return tuple(inner.value(x.dtype, x.shape) for x in carry)

        return function

    def carry(self, dtype):
        return self.value(dtype), self.value(dtype), *self.like(self.one_of(TYPES))

    def _elementwise(self, name, dtype):
        function = FUNCTIONS.get(name) or getattr(lax, name)
        count = sum(parameter.default is parameter.empty for parameter in signature(function).parameters.values())
        return function(*self.like(*[dtype] * count))

    def _pow(self, dtype):
        x, y, n = self.like(dtype, dtype, "int8")
        return lax.pow(abs(x) + 0.125, self.one_of([y, n]))

    def _integer_pow(self, dtype):
        [x] = self.like(dtype)
        return lax.integer_pow(x, int(self.random.integers(-3 if dtype in FLOATS else 0, 5)))

    def _round(self, dtype):
        return [lax.round(*self.like(dtype), method) for method in lax.RoundingMethod]

    def _convert_element_type(self, dtype):
        return [lax.convert_element_type(x, to) for [x] in [self.like(dtype)] for to in TYPES]

    def _bitcast_convert_type(self, dtype):
        whole = [name for name in NUMBERS if "int" in name and np.dtype(name).itemsize == np.dtype(dtype).itemsize]
        bits = [lax.bitcast_convert_type(*self.like(dtype), to) for to in (whole if dtype != "bool" else ["bool"])]
        return bits, lax.bitcast_convert_type(bits[0], dtype)

    def _clamp(self, dtype):
        x, low, high = self.like(dtype, dtype, dtype)
        return lax.clamp(low, x, high), lax.clamp(self.value(dtype, ()), x, self.value(dtype, ()))

    def _select_n(self, dtype):
        flag, x, y = self.like("bool", dtype, dtype)
        return lax.select_n(flag, x, y), lax.select_n(self.value("bool", ()), x, y)

    def _reduce(self, dtype):
        names = [name for name, of_two in rows.REDUCTIONS.items() if accepts(of_two, dtype)]
        yield from (getattr(lax, name)(self.block(dtype), self.one_of([(0,), (1,)])) for name in names)
        if dtype == "bool":
            yield [reduce(self.block(dtype), axes) for reduce in (lax.reduce_or, lax.reduce_and) for axes in ((2,), (1, 2), (0, 1))]

    def _gather(self, dtype):
        mode, fill = self.one_of(["clip", "fill", "promise_in_bounds"]), self.one_of([None, 2])
        options = {"mode": mode, "fill_value": fill if mode == "fill" else None}
        table = jnp.stack([self.value(dtype, ()) for _ in range(ROWS)])
        by_lane = table.at[self.numbers((self.lanes,), mode)].get(**options)
        count = self.one_of([1, ROWS])
        return by_lane, jnp.take_along_axis(self.value(dtype), self.numbers((ROWS, self.lanes), mode)[:count], 0, **options)

    def _scatter(self, dtype):
        mode = self.one_of(["clip", "drop", "promise_in_bounds"])
        row = (self.lanes,)
        return put(self.value(dtype), self.numbers(row, mode), self.value(dtype, row), mode)

    def _sort(self, dtype):
        return lax.sort((self.value(dtype), self.value("uint8"), self.value(dtype)), dimension=0, num_keys=1)

    def _moves(self, dtype):
        """Return results of all primitives that move elements."""
        x, y, block = self.value(dtype), self.value(dtype), self.block(dtype)
        begin, stride, axis = self.random.integers([0, 1, 0], [3, 4, 2])
        parts = lax.split(x, (begin + 1, ROWS - begin - 1), 0)
        yield x[begin::stride], parts, jnp.concatenate(parts[::-1]), lax.concatenate([x, y], 0), jnp.unstack(block, axis=axis)
        yield [lax.dynamic_slice_in_dim(x, int(start), 2) for start in self.random.integers(-7, 7, 2)]
        yield lax.rev(block, self.one_of([(0,), (1,), (0, 1)])), block.transpose(1, 0, 2), lax.optimization_barrier((x, y))
        yield x.reshape(2, -1, self.lanes), block.reshape(8, self.lanes), x[:, None].squeeze(1), x[None, 0]
        if dtype != "bool":
            yield lax.broadcasted_iota(dtype, (ROWS, self.lanes), 0), lax.iota(dtype, ROWS)

    def _while(self, dtype):
        count, body = abs(self.value("int8", (self.lanes,))) % 4, self.body()
        turn = lambda now: (now[0] - 1, body(*now[1]))  # noqa: E731
        return lax.while_loop(lambda now: jnp.any(now[0] > 0), turn, (count, self.carry(dtype)))

    def _scan(self, dtype):
        body = self.body()
        return lax.fori_loop(0, self.one_of([0, 1, 3]), lambda k, now: body(*now), self.carry(dtype))

    def _cond(self, dtype):
        bodies, carry = (self.body(), self.body()), self.carry(dtype)
        flag, number = self.one_of([self.value("bool", ()), jnp.any(self.value("bool"))]), self.value("int32", ())
        return lax.cond(flag, *bodies, *carry), lax.switch(number, bodies, *carry)

    def _jit(self, dtype):
        return jax.jit(self.body())(*self.carry(dtype))

    def _jvp(self, dtype):
        x, slopes = self.like(dtype, dtype), self.like(dtype, dtype)
        x, slopes = ([self.value(dtype), self.value(dtype)] for _ in range(2))
        return jax.jvp(self.body(6, DERIVED), x, slopes)


def accepts(name, dtype):
    rule = elementwise.RULES.get(name)
    return rule is None or np.dtype(dtype).kind in rule.kinds


OTHERS = {"clamp": NUMBERS, "select_n": TYPES, "gather": NUMBERS, "scatter": NUMBERS, "sort": TYPES, "reduce": TYPES}
SIMPLE = [(name, dtype) for name in elementwise.RULES for dtype in TYPES if accepts(name, dtype)]
SIMPLE += [(name, dtype) for name, dtypes in OTHERS.items() for dtype in dtypes]
DERIVED = [(name, dtype) for name, dtype in SIMPLE if dtype in FLOATS]
MOVES = [("moves", dtype) for dtype in TYPES]
CONTROL = [(name, dtype) for name in ("while", "scan", "cond", "jit") for dtype in TYPES]
DECK = np.random.default_rng(1).permutation(
    [*SIMPLE, *MOVES, *CONTROL, *[(name, dtype) for name in ("jvp", "custom_vjp_call") for dtype in FLOATS]]
)


def function_of(number):
    deck = [(str(name), str(dtype)) for name, dtype in DECK[number::PROGRAMS]]

    def function(arguments, along):
        program = Program(number, jax.tree.leaves(arguments), deck)
        body = program.body(3)

        def turn(carry, row):
            results = body(*row, *carry)
            return results[2:], [x + x for x in results[:2]]

        return program.results, lax.scan(turn, program.carry("float64"), along, reverse=bool(number % 2))

    return function


def arguments_of(number):
    """Return rows and numbers of each type, and the rows of a scan, with NaN, infinity and the greatest integers."""
    random = np.random.default_rng(number)

    def some(dtype, shape):
        if dtype in FLOATS:
            x = random.integers(-32, 33, shape) / 8
            return np.where(random.random(shape) < 0.03, random.choice([np.nan, np.inf, -np.inf], shape), x).astype(dtype)
        if dtype == "bool":
            return random.random(shape) < 0.5
        x, limits = random.integers(0, 9, shape), np.iinfo(dtype)
        x = (x - 4 * (limits.min < 0)).astype(dtype)
        ends = random.choice(np.array([limits.min, limits.max], dtype), shape)
        return np.where(random.random(shape) < 0.1, ends, x)

    shapes = (ROWS, LANES), ()
    return [[some(dtype, shape) for dtype in TYPES for shape in shapes], [some(x, (number % 5, LANES)) for x in ("float64", "int8")]]


@pytest.mark.parametrize("number", range(PROGRAMS))
def test_random_programs_have_bits_of_xla(number):
    function, arguments = function_of(number), arguments_of(number)
    with jax.debug_nans(False):
        expected = jax.jit(function)(*arguments)
    twice = jax.tree.map(lambda x: np.concatenate([x, x], -1) if x.ndim else x, arguments)
    results = Kernel(function, *twice, registers=8 * LANES // native.vector_bytes())(*twice)
    for result, correct in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        whole = correct if result.shape == correct.shape else np.concatenate([correct, correct], -1)
        assert result.dtype == correct.dtype
        np.testing.assert_array_equal(result, whole)


def jaxprs(values):
    for value in values:
        yield from jaxprs(value) if isinstance(value, tuple) else [value.jaxpr] if hasattr(value, "jaxpr") else []


def names_in(jaxpr):
    """Yield the primitives of a trace and of the functions that it calls, with the type of the first argument."""
    for equation in jaxpr.eqns:
        inner = jaxprs(equation.params.values())
        yield equation.primitive.name, str((*equation.invars, *equation.outvars)[0].aval.dtype)
        for function in inner:
            yield from names_in(function)


def test_every_primitive_is_drawn():
    drawn = {x for number in range(PROGRAMS) for x in names_in(trace(function_of(number), *arguments_of(number)).jaxpr.jaxpr)}
    assert {name for name, _ in drawn} == translation.primitives()
    assert {(name, dtype) for name in elementwise.RULES for dtype in TYPES if accepts(name, dtype)} <= drawn
