"""Writers of the accepted primitives for random functions."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from blocks import write_called, write_cond, write_for, write_while
from scopes import ANY, DTYPES, EXACT, PRODUCT, ROUNDED, Scope, Value

Writer = Callable[[Scope], Any]


FAVOURED: tuple[str, ...] = ()
"""Primitives that make up half of those written, so that a planted fault in one of them is found sooner."""


def write(scope: Scope) -> None:
    """Write one primitive, any that fits."""
    left_out = (INEXACT if scope.depth else set()) | (NESTED if scope.depth > 1 else set())
    favoured = [name for name in FAVOURED if name not in left_out]
    names = favoured if favoured and scope.often(2) else [name for name in WRITERS if name not in left_out]
    WRITERS[scope.pick(names)](scope)


def _comparable(name: str, value: Value) -> str:
    """Return the source of a value, without subnormal floats: XLA treats them as 0, and may select either of two."""
    return f"normal({name})" if value.kind == "f" else name


def _exact(call: str, kinds: str, arity: int, gives: str | None = None, accuracy: int = EXACT) -> Writer:
    """Return the writer of a function of exact values of one type."""

    def write(scope: Scope) -> None:
        first = scope.any(kinds, apart=True)
        names = [value.name for value in (first, *(scope.same(first, apart=True) for _ in range(arity - 1)))]
        if call in ("div", "rem"):
            # Compilers simplify a number divided by itself, even for 0.
            names[1] = f"lax.optimization_barrier({names[1]})"
            if call == "div" and first.kind in "iu":
                names[0] = f"numerator({', '.join(names)})"
        elif call in ("max", "min"):
            names = [_comparable(name, first) for name in names]
        is_product = accuracy == PRODUCT and first.kind == "f"
        if not (is_product and scope.depth):
            source = f"lax.{call}({', '.join(names)})"
            scope.let(source, first, dtype=gives or first.dtype, accuracy=accuracy * is_product)

    return write


def _library(call: str, arity: int = 1) -> Writer:
    """Return the writer of a function that libraries round differently. Subnormal arguments become 0 first."""

    def write(scope: Scope) -> None:
        first = scope.any("f", apart=True)
        given = [first, *(scope.same(first, apart=True) for _ in range(arity - 1))]
        scope.let(f"lax.{call}({', '.join(f'normal({x.name})' for x in given)})", first, accuracy=ROUNDED)

    return write


def _moved(source: str, kinds: str = ANY, least: int = 0, rows: tuple[int, ...] | None = None) -> Writer:
    """Return the writer of a function that moves numbers, of a value with at least this many rows."""

    def write(scope: Scope) -> None:
        x = scope.any(kinds, least=least)
        blank = replace(x, rows=(1, *x.rows, 1))
        text = source.format(x=x.name, shape=x.shape, blank=blank.shape)
        scope.let(text, x, accuracy=x.accuracy, rows=x.rows if rows is None else rows)

    return write


def _joined(scope: Scope, x: Value, other: Value, source: str, **changes: Any) -> None:
    scope.let(source, x, accuracy=max(x.accuracy, other.accuracy), **changes)


def _shift(call: str) -> Writer:
    def write(scope: Scope) -> None:
        x = scope.any("iu")
        few = f"jnp.full({x.shape}, {scope.pick([0, 1, 5, 7])}, jnp.{x.dtype})"
        scope.let(f"lax.{call}({x.name}, {scope.pick([few, scope.same(x).name])})", x)

    return write


def _integer_power(scope: Scope) -> None:
    x = scope.any("fiu" if not scope.depth else "iu", apart=True)
    exponent = scope.pick([0, 1, 2, 3, 4, 5, 7] + [-1, -2, -3] * (x.kind == "f"))
    scope.let(f"lax.integer_pow({x.name}, {exponent})", x, accuracy=PRODUCT * (x.kind == "f"))


def _power(scope: Scope) -> None:
    x = scope.any("f", apart=True)
    y = scope.same(x, apart=True, dtype=scope.dtype("fiu"))
    y = y if y.kind != "f" else scope.same(x, apart=True)
    exponent = f"normal({y.name})" if y.kind == "f" else y.name
    scope.let(f"lax.pow(normal({x.name}), {exponent})", x, accuracy=ROUNDED)


def _round(scope: Scope) -> None:
    x = scope.any("f", apart=True)
    scope.let(f"lax.round({x.name}, lax.RoundingMethod.{scope.pick(['AWAY_FROM_ZERO', 'TO_NEAREST_EVEN'])})", x)


def _bitcast(scope: Scope) -> None:
    """Write the bits of a number; floats must be normal, since a NaN has many bit patterns."""
    x = scope.any("fiu", apart=True)
    sized = [name for kind in "fiu" for name in DTYPES[kind] if np.dtype(name).itemsize == np.dtype(x.dtype).itemsize]
    to, source = scope.pick(sized), f"bits_kept({x.name})" if x.kind == "f" else x.name
    scope.let(f"lax.bitcast_convert_type({source}, jnp.{to})", x, dtype=to)


def _convert(scope: Scope) -> None:
    x, to = scope.any(apart=True), scope.dtype(ANY)
    scope.let(f"lax.convert_element_type({x.name}, jnp.{to})", x, dtype=to)


def _clamp(scope: Scope) -> None:
    x = scope.any("fiu", apart=True)  # XLA does not clamp booleans
    ends = scope.pick([x, replace(x, rows=(), lanes=False)])
    low, high = (scope.same(x, apart=True, rows=ends.rows, lanes=ends.lanes) for _ in range(2))
    low, among, high = (_comparable(value.name, x) for value in (low, x, high))
    scope.let(f"lax.clamp({low}, {among}, {high})", x)


def _select(scope: Scope) -> None:
    x = scope.any()
    y, flag = scope.same(x), scope.same(x, dtype="bool_")
    _joined(scope, x, y, f"lax.select_n({flag.name}, {x.name}, {y.name})")


def _add_any(scope: Scope) -> None:
    x = scope.any("f", apart=True)
    y = scope.same(x, apart=True)
    scope.let(f"jax.jvp(lax.add, ({x.name}, {y.name}), ({y.name}, {x.name}))[1]", x)


def _reduction(call: str, kinds: str) -> Writer:
    """Return the writer of a reduction over rows. Sums and products are of small whole numbers, exact in any order."""

    def write(scope: Scope) -> None:
        x = scope.any(kinds, apart=True, least=1)
        adds = call in ("reduce_sum", "reduce_prod")
        source = f"whole({x.name})" if adds and x.kind == "f" else _comparable(x.name, x)
        scope.let(f"lax.{call}({source}, (0,))", x, rows=())

    return write


def _logical_reduction(call: str) -> Writer:
    """Return the writer of a reduction over rows, or of booleans over lanes."""

    def write(scope: Scope) -> None:
        if scope.pick([True, False]):
            _reduction(call, "iub")(scope)
        else:
            x = scope.value("bool_", (), True)
            scope.let(f"lax.{call}({x.name}, (0,))", x, lanes=False)

    return write


def _row_numbers(scope: Scope, rows: tuple[int, ...], lanes: bool) -> str:
    """Return numbers of rows: any numbers, or such that many of the rows exist."""
    numbers = scope.value(scope.pick(["int32", "int64", "int8", "uint32"]), rows, lanes)
    return scope.pick([numbers.name, f"lax.rem({numbers.name}, jnp.full_like({numbers.name}, 5))"])


def _gather(scope: Scope) -> None:
    """Write rows that each lane selects, of its own array or of one that lanes share."""
    mode = scope.pick(
        ["'clip'", "'promise_in_bounds'", "'fill'", "'fill'", "'fill', fill_value=1", "'fill', fill_value=9"]
    )
    if scope.often(3):
        x, many = scope.any("fiu", least=1), scope.pick([1, 2])
        source = f"jnp.take_along_axis({x.name}, {_row_numbers(scope, (many,), x.lanes)}, 0, mode={mode})"
        scope.let(source, x, rows=(many,), accuracy=x.accuracy)
    else:
        x = scope.any("fiu", least=1, lanes=False)
        mode = mode.replace("promise_in_bounds", "clip")
        source = f"jnp.take({x.name}, {_row_numbers(scope, (), True)}, 0, mode={mode})"
        scope.let(source, x, rows=(), lanes=True, accuracy=x.accuracy)


def _scatter(scope: Scope) -> None:
    x = scope.any("fiu", least=1, lanes=True)
    new, numbers = scope.same(x, rows=()), _row_numbers(scope, (), True)
    _joined(scope, x, new, f"put({x.name}, {numbers}, {new.name}, '{scope.pick(['drop', 'clip', 'fill'])}')")


def _sort(scope: Scope) -> None:
    key = scope.any(apart=True, least=1)
    other = scope.same(key, apart=True, dtype=scope.dtype(ANY))
    keys = _comparable(key.name, key)
    scope.unpack(f"lax.sort(({keys}, {other.name}), dimension=0, num_keys=1)", [key, other])


def _dynamic_slice(scope: Scope) -> None:
    x = scope.any(least=1)
    size, start = scope.pick(range(1, x.rows[0] + 1)), scope.pick([-7, -1, 0, 1, 2, 100])
    source = f"lax.dynamic_slice_in_dim({x.name}, {start}, {size}, 0)"
    scope.let(source, x, rows=(size, *x.rows[1:]), accuracy=x.accuracy)


def _broadcast(scope: Scope) -> None:
    x = scope.any()
    axes = tuple(range(1, 1 + len(x.rows) + x.lanes))
    target = replace(x, rows=(scope.pick([1, 2]), *x.rows))
    if len(target.rows) == 1:
        scope.let(f"lax.broadcast_in_dim({x.name}, {target.shape}, {axes})", target, accuracy=x.accuracy)
    else:
        scope.let(f"lax.broadcast_in_dim({x.name}, {target.shape}, {axes})[-1]", x, accuracy=x.accuracy)


def _slice(scope: Scope) -> None:
    x, start, stride = scope.any(least=2), scope.pick([0, 1]), scope.pick([1, 2])
    size = len(range(start, x.rows[0], stride))
    scope.let(f"lax.slice_in_dim({x.name}, {start}, None, {stride})", x, rows=(size,), accuracy=x.accuracy)


def _concatenate(scope: Scope) -> None:
    x = scope.any(least=1)
    y = scope.same(x, rows=(1,))
    _joined(scope, x, y, f"lax.concatenate(({x.name}, {y.name}), 0)[-3:]", rows=(min(x.rows[0] + 1, 3),))


def _stack(scope: Scope) -> None:
    x = scope.value(scope.dtype(ANY), (), scope.often(4))
    y = scope.same(x)
    _joined(scope, x, y, f"jnp.stack(({x.name}, {y.name}))", rows=(2,))


def _parts(source: str, rows: tuple[int, ...]) -> Writer:
    """Return the writer of a function that splits an array of two rows."""

    def write(scope: Scope) -> None:
        x = scope.value(scope.dtype(ANY), (2,), scope.often(4), apart=True)
        scope.unpack(source.format(x=x.name), [replace(x, rows=rows)] * 2)

    return write


def _iota(scope: Scope) -> None:
    target = Value("", scope.dtype("fiu"), (scope.pick([1, 2, 3]),))
    scope.let(f"lax.broadcasted_iota(jnp.{target.dtype}, {target.shape}, 0)", target)


LIBRARY = ("exp", "exp2", "log", "sin", "cos", "tan", "tanh", "sinh", "cosh", "asin", "acos", "atan", "asinh", "acosh")
LIBRARY = (*LIBRARY, "atanh", "expm1", "log1p", "cbrt", "erf", "erfc")
INEXACT = {*LIBRARY, "atan2", "pow"}
NESTED = {"scan", "while", "cond", "jit", "custom_jvp_call", "custom_vjp_call"}

WRITERS: dict[str, Writer] = {
    **{name: _library(name) for name in LIBRARY},
    "atan2": _library("atan2", 2),
    "pow": _power,
    **{name: _exact(name, "f", 1) for name in ("floor", "ceil", "sqrt")},
    **{name: _exact(name, ANY, 2, gives="bool_") for name in ("lt", "gt", "le", "ge", "eq", "ne")},
    **{name: _exact(f"bitwise_{name}", "iub", 2) for name in ("and", "or", "xor")},
    **{name: _exact(name, ANY, 2) for name in ("max", "min")},
    **{name: _exact(name, "fiu", 2) for name in ("add", "sub", "rem")},
    **{name: _exact(name, "fiu", 2, accuracy=PRODUCT) for name in ("mul", "div")},
    "not": _exact("bitwise_not", "iub", 1),
    "sign": _exact("sign", "fiu", 1),
    "is_finite": _exact("is_finite", "f", 1, gives="bool_"),
    "square": _exact("square", "fiu", 1, accuracy=PRODUCT),
    "integer_pow": _integer_power,
    **{name: _shift(name) for name in ("shift_left", "shift_right_logical", "shift_right_arithmetic")},
    "round": _round,
    "bitcast_convert_type": _bitcast,
    "convert_element_type": _convert,
    "clamp": _clamp,
    "select_n": _select,
    "add_any": _add_any,
    "neg": _moved("lax.neg({x})", "fiu"),
    "abs": _moved("lax.abs({x})", "fi"),
    "stop_gradient": _moved("lax.stop_gradient({x})"),
    "copy": _moved("jnp.copy({x})"),
    "optimization_barrier": _moved("lax.optimization_barrier({x})"),
    "reshape": _moved("lax.reshape(lax.reshape({x}, {blank}), {shape})"),
    "squeeze": _moved("lax.squeeze({x}[:1], (0,))", least=1, rows=()),
    "transpose": _moved("jnp.moveaxis(jnp.moveaxis({x}, 0, -1)[..., ::-1], -1, 0)", least=1),
    "rev": _moved("lax.rev({x}, (0,))", least=1),
    **{f"reduce_{name}": _reduction(f"reduce_{name}", "fiu") for name in ("sum", "prod")},
    **{f"reduce_{name}": _reduction(f"reduce_{name}", ANY) for name in ("max", "min")},
    **{f"reduce_{name}": _logical_reduction(f"reduce_{name}") for name in ("or", "and")},
    "gather": _gather,
    "scatter": _scatter,
    "sort": _sort,
    "dynamic_slice": _dynamic_slice,
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "concatenate": _concatenate,
    "stack": _stack,
    "unstack": _parts("jnp.unstack({x})", ()),
    "split": _parts("jnp.split({x}, 2)", (1,)),
    "iota": _iota,
    "scan": write_for,
    "while": write_while,
    "cond": write_cond,
    "jit": write_called("jax.jit"),
    "custom_jvp_call": write_called("with_jvp"),
    "custom_vjp_call": write_called("with_vjp"),
}
