"""Random programs of every primitive in every number type: kernels and XLA compute the same bits.

After each instruction, floats become multiples of 1/8 up to 4. Sums and products of a few of these are exact, and what
is rounded is far from the bounds between them. So no comparison needs a tolerance, and no rounding error decides which
element a choice, an index or a loop takes."""

from inspect import isgenerator, signature

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.interpreters import ad
from test_kernel import put

from vibrojax.compile import elementwise, native, rows, translation
from vibrojax.compile.assembly import LLVM_TYPES
from vibrojax.compile.native import Kernel, trace

ROWS, LANES, PROGRAMS = 4, 16, 32
TYPES = tuple(map(str, LLVM_TYPES))
FLOATS, NUMBERS = ("float64", "float32"), tuple(name for name in TYPES if name != "bool")
WHOLE = NUMBERS[2:]


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
    """Instructions on values: random, but the same in each trace. `deck`: their names, and types of the arguments."""

    def __init__(self, seed, values, deck):
        self.random, self.values, self.results = np.random.default_rng(seed), list(values), []
        self.lanes = max(x.shape[-1] for x in values if x.ndim)
        for name, dtype in deck:
            draw = getattr(self, f"_{name}", None)
            drawn = self._elementwise(name, dtype) if draw is None else draw(dtype)
            drawn = jax.tree.leaves(list(drawn) if isgenerator(drawn) else drawn)
            drawn = [exact(x) if x.dtype.kind == "f" else x for x in drawn]
            self.results += drawn
            parts = [x.reshape(-1, self.lanes) if self.lanes in x.shape else x.ravel() for x in drawn if x.ndim]
            self.values += [x[row] for x in parts for row in {0, len(x) - 1}]
            self.values += [x for x in drawn if x.shape in ((), (ROWS, self.lanes))]

    def one_of(self, items):
        return items[self.random.integers(len(items))]

    def value(self, dtype, shape=None):
        """Return an argument or one of the last values, with a shape, by default that of rows."""
        shape = (ROWS, self.lanes) if shape is None else shape
        usable = [x for x in self.values if x.dtype == dtype and (shape or not x.ndim)]
        x = self.one_of([usable[0], usable[0], *usable[-4:]])
        return jnp.broadcast_to(x[self.random.integers(ROWS)] if x.ndim > len(shape) else x, shape)

    def like(self, *dtypes):
        shape = self.one_of([(), (self.lanes,), (ROWS, self.lanes)])
        return [self.value(dtype, shape) for dtype in dtypes]

    def block(self, dtype):
        return jnp.stack([self.value(dtype), self.value(dtype)], self.one_of([0, 1]))

    def numbers(self, shape, mode):
        """Return row numbers, some of which do not exist, unless the mode promises that they do."""
        x = lax.rem(self.value("int8", shape), jnp.int8(7))
        x = abs(x) % jnp.int8(ROWS) if mode == "promise_in_bounds" else x
        return x.astype(self.one_of([name for name in WHOLE if name != "uint64"]))

    def body(self, turns=4, choices=None):
        """Return a random function of some values that returns as many of the same types."""
        seed, choices = int(self.random.integers(2**32)), choices or SIMPLE
        deck = [self.one_of(choices) for _ in range(turns)]

        def function(*carry):
            inner = Program(seed, [*self.values, *carry], deck)
            return tuple(inner.value(x.dtype, x.shape) for x in carry)

        return function

    def carry(self, dtype):
        """Return values for a loop, which keeps many in memory and few in registers."""
        return *(self.value(dtype) for _ in range(self.one_of([1, 7]))), *self.like(self.one_of(TYPES))

    def _elementwise(self, name, dtype):
        function = FUNCTIONS.get(name) or getattr(lax, name)
        count = sum(parameter.default is parameter.empty for parameter in signature(function).parameters.values())
        return function(*self.like(*[dtype] * count))

    def _pow(self, dtype):
        x, y, n = self.like(dtype, dtype, "int8")
        return lax.pow(abs(x) + 0.125, self.one_of([y, n]))

    def _integer_pow(self, dtype):
        return lax.integer_pow(*self.like(dtype), int(self.random.integers(-3 if dtype in FLOATS else 0, 5)))

    def _round(self, dtype):
        return [lax.round(self.values[2 * TYPES.index(dtype)], method) for method in lax.RoundingMethod]  # has halves

    def _convert_element_type(self, dtype):
        return [lax.convert_element_type(*self.like(dtype), to) for to in TYPES]

    def _bitcast_convert_type(self, dtype):
        same = [name for name in WHOLE if np.dtype(name).itemsize == np.dtype(dtype).itemsize and dtype != "bool"]
        bits = [lax.bitcast_convert_type(*self.like(dtype), to) for to in same or [dtype]]
        return bits, lax.bitcast_convert_type(bits[0], dtype)

    def _clamp(self, dtype):
        x, low, high = self.like(dtype, dtype, dtype)
        return lax.clamp(low, x, high), lax.clamp(self.value(dtype, ()), x, self.value(dtype, ()))

    def _select_n(self, dtype):
        flag, x, y = self.like("bool", dtype, dtype)
        return lax.select_n(flag, x, y), lax.select_n(self.value("bool", ()), x, y)

    def _reduce(self, dtype):
        for name, of_two in rows.REDUCTIONS.items():
            if accepts(of_two, dtype):
                yield getattr(lax, name)(self.block(dtype), self.one_of([(0,), (1,)]))
            if dtype == "bool" and of_two in ("or", "and"):
                yield [getattr(lax, name)(self.block(dtype), axes) for axes in ((2,), (1, 2), (0, 1))]

    def _gather(self, dtype):
        table = jnp.stack([self.value(dtype, ()) for _ in range(ROWS)])
        for mode, fill in (("clip", None), ("fill", None), ("fill", 2), ("promise_in_bounds", None)):
            yield table.at[self.numbers((self.lanes,), mode)].get(mode=mode, fill_value=fill)
            numbers = self.numbers((ROWS, self.lanes), mode)[: self.one_of([1, ROWS])]
            yield jnp.take_along_axis(self.value(dtype), numbers, 0, mode=mode, fill_value=fill)

    def _scatter(self, dtype):
        row, x = (self.lanes,), self.value(dtype)
        for mode in ("clip", "drop", "promise_in_bounds"):
            after = [put(x, self.numbers(row, mode), self.value(dtype, row), mode) for _ in range(2)]
            yield after
            x = after[0]

    def _sort(self, dtype):
        return lax.sort((self.value(dtype), self.value("uint8"), self.value(dtype)), dimension=0, num_keys=1)

    def _moves(self, dtype):
        x, y, block = self.value(dtype), self.value(dtype), self.block(dtype)
        begin, stride, axis = self.random.integers([0, 1, 0], [3, 4, 2])
        parts = lax.split(x, (begin + 1, ROWS - begin - 1), 0)
        yield parts, x[begin::stride], lax.concatenate([x, y], 0), jnp.unstack(block, axis=axis)
        yield [lax.dynamic_slice_in_dim(x, int(start), 2) for start in self.random.integers(-7, 7, 2)]
        yield lax.rev(block, self.one_of([(0,), (1,), (0, 1)])), block.transpose(1, 0, 2)
        yield x.reshape(2, -1, self.lanes), x[:, None].squeeze(1), x[None, 0], lax.optimization_barrier((x, y))
        if dtype != "bool":
            yield lax.broadcasted_iota(dtype, (ROWS, self.lanes), 0), lax.iota(dtype, ROWS)

    def _while(self, dtype):
        count, body = abs(self.value("int8", (self.lanes,))) % jnp.int8(4), self.body()
        begin = count, self.carry(dtype)
        return lax.while_loop(lambda now: jnp.any(now[0] > 0), lambda now: (now[0] - 1, body(*now[1])), begin)

    def _scan(self, dtype):
        body = self.body()
        return lax.fori_loop(0, self.one_of([0, 1, 3]), lambda k, now: body(*now), self.carry(dtype))

    def _cond(self, dtype):
        bodies, carry = (self.body(), self.body()), self.carry(dtype)
        flag = self.one_of([self.value("bool", ()), jnp.any(self.value("bool"))])
        return lax.cond(flag, *bodies, *carry), lax.switch(self.value("int32", ()), bodies, *carry)

    def _jit(self, dtype):
        return jax.jit(self.body())(*self.carry(dtype))

    def _jvp(self, dtype):
        values, slopes = ([self.value(dtype), self.value(dtype)] for _ in range(2))
        return jax.jvp(self.body(6, DERIVED), values, slopes)


def accepts(name, dtype):
    return np.dtype(dtype).kind in elementwise.RULES[name].kinds


OF_NUMBERS, OF_ALL = ("clamp", "gather", "scatter"), ("select_n", "sort", "reduce")
SIMPLE = [(name, dtype) for name in elementwise.RULES for dtype in TYPES if accepts(name, dtype)]
SIMPLE += [(name, dtype) for name in OF_ALL for dtype in TYPES] + [(name, x) for name in OF_NUMBERS for x in NUMBERS]
DERIVED = [(name, dtype) for name, dtype in SIMPLE if dtype in FLOATS]
CONTROL = [(name, dtype) for name in ("moves", "while", "scan", "cond", "jit") for dtype in TYPES]
CONTROL += [(name, dtype) for name in ("jvp", "custom_vjp_call") for dtype in FLOATS]
DECK = np.random.default_rng(1).permutation(SIMPLE + CONTROL).tolist()


def program(number):
    """Return a function, whose results include those of a scan along its last arguments, and its arguments."""
    random = np.random.default_rng(number)

    def some(dtype, shape):
        if dtype == "bool":
            return random.random(shape) < 0.5
        limits = [np.nan, np.inf] if dtype in FLOATS else [np.iinfo(dtype).min, np.iinfo(dtype).max]
        x = random.integers(-32, 33, shape) / 8 if dtype in FLOATS else random.integers(-4 * (limits[0] < 0), 6, shape)
        return np.where(random.random(shape) < 0.05, random.choice(np.array(limits, dtype), shape), x.astype(dtype))

    def function(arguments, along):
        drawn = Program(number, arguments, DECK[number::PROGRAMS])
        body = drawn.body(3)

        def turn(carry, row):
            results = body(*row, *carry)
            return results[2:], [x + x for x in results[:2]]

        return drawn.results, lax.scan(turn, drawn.carry("float64"), along, reverse=bool(number % 2))

    arguments = [some(dtype, shape) for dtype in TYPES for shape in ((ROWS, LANES), ())]
    return function, (arguments, [some(dtype, (number % 5, LANES)) for dtype in ("float64", "int8")])


@pytest.mark.parametrize("number", range(PROGRAMS))
def test_random_programs_have_bits_of_xla(number):
    """Each of two groups of lanes has all lanes, because loops and branches look at those of a group."""
    function, arguments = program(number)
    with jax.debug_nans(False):
        expected = jax.jit(function)(*arguments)
    twice = jax.tree.map(lambda x: np.concatenate([x, x], -1) if x.ndim else x, arguments)
    results = Kernel(function, *twice, registers=8 * LANES // native.vector_bytes())(*twice)
    for result, correct in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        correct = correct if result.shape == correct.shape else np.concatenate([correct, correct], -1)
        assert result.dtype == correct.dtype
        np.testing.assert_array_equal(result, correct)


def names_in(x):
    """Yield the primitives in a trace or in parameters of an equation, with the type of the first (chosen) argument."""
    for equation in getattr(x, "eqns", ()):
        first = [*equation.invars, *equation.outvars][equation.primitive.name == "select_n"]
        yield equation.primitive.name, str(first.aval.dtype)
        yield from names_in(tuple(equation.params.values()))
    for part in x if isinstance(x, tuple) else ():
        yield from names_in(part)


def test_every_primitive_is_drawn():
    traces = [trace(function, *arguments) for function, arguments in map(program, range(PROGRAMS))]
    drawn = {pair for traced in traces for pair in names_in(traced.jaxpr)}
    assert {name for name, _ in drawn} == translation.primitives()
    of_rows = [(name, dtype) for name, of_two in rows.REDUCTIONS.items() for dtype in TYPES if accepts(of_two, dtype)]
    missing = {*SIMPLE, *of_rows} - drawn
    assert {name for name, _ in missing} == {"reduce"}
