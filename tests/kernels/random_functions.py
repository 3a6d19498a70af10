"""Random functions of lanes over all primitives that the translation accepts, as Python source.

`functions()` is a hypothesis strategy. Each function carries the source of its body, so that a counterexample can be
read and run again.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import writers
from hypothesis import strategies as st
from jax import lax  # sources call it
from scopes import ANY, EXACT, ROWS, Scope, Value, edges, tuple_of
from writers import write

LANES = {16: 2, 32: 3, 64: 5}
"""Lanes for each width of vectors [bytes], such that one group holds them all."""


def normal(x: jax.Array) -> jax.Array:
    """Return numbers with 0 in place of subnormal ones."""
    return jnp.where(jnp.abs(x) < jnp.finfo(x.dtype).tiny, jnp.zeros_like(x), x)


def bits_kept(x: jax.Array) -> jax.Array:
    """Return numbers with 0 in place of NaN, which has many bit patterns, and of subnormal ones."""
    return jnp.where(jnp.abs(x) >= jnp.finfo(x.dtype).tiny, x, jnp.zeros_like(x))


def numerator(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return numerators with 1 in place of 0 over 0, which XLA simplifies to 1 or computes as -1."""
    return jnp.where((x == 0) & (y == 0), jnp.ones_like(x), x)


def short(x: jax.Array) -> jax.Array:
    """Return numbers of turns, at most three."""
    return lax.rem(x, jnp.full_like(x, 4))


def whole(x: jax.Array) -> jax.Array:
    """Return small whole numbers, whose sums and products are exact; none is -0, whose sums have either sign."""
    x = jnp.round(x)
    return jnp.clip(jnp.where(x == 0, jnp.zeros_like(x), x), -8, 8)


def put(rows: jax.Array, numbers: jax.Array, new: jax.Array, mode: str) -> jax.Array:
    """Return rows in which each lane has replaced one."""
    return jax.vmap(lambda rows, number, new: rows.at[number].set(new, mode=mode), -1, -1)(rows, numbers, new)


def with_jvp(function: Callable[..., Any]) -> Callable[..., Any]:
    function = jax.custom_jvp(function)
    function.defjvp(lambda primals, tangents: (function(*primals), tangents))
    return function


def with_vjp(function: Callable[..., Any]) -> Callable[..., Any]:
    wrapped = jax.custom_vjp(function)
    wrapped.defvjp(lambda *given: (function(*given), None), lambda _, gradients: gradients)
    return wrapped


@dataclass(frozen=True, eq=False)
class Function:
    """A function of lanes as source, with its arguments, its results and the width of a vector in bytes."""

    source: str
    given: list[Value]
    results: list[Value]
    seed: int
    width: int

    def __call__(self, *arguments: Any) -> Any:
        names = globals() | {}
        exec(self.source, names)
        return names["function"](*arguments)

    def arguments(self) -> list[np.ndarray]:
        """Return arguments for some lanes, mostly numbers at which rules tend to fail."""
        random = np.random.default_rng(self.seed)
        arrays = []
        for value in self.given:
            shape = (*value.rows, *[LANES[self.width]] * value.lanes)
            numbers = random.choice(np.array(edges(value.dtype), value.dtype), shape)
            if value.kind == "f":
                usual = random.normal(0, 10, shape).astype(value.dtype)
                numbers = np.where(random.random(shape) < 0.3, usual, numbers)
            arrays.append(np.asarray(numbers, value.dtype))
        return arrays

    def __repr__(self) -> str:
        return f"{self.source}\n# vectors of {self.width} bytes, arguments: {self.arguments()}"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text("\n" + repr(self))


@st.composite
def functions(draw: Callable[[Any], Any], along: bool = True) -> Function:
    """Draw a function. With `along`, some functions have a loop along an argument of its own."""
    return random_function(Scope(draw, write, [], [0]), along)


def random_function(scope: Scope, along: bool = True) -> Function:
    """Return a function of an empty scope, which draws all that is random."""
    given = [Value(scope.fresh(), scope.dtype("f"))]
    for _ in range(scope.pick([2, 3, 4, 5])):
        lanes = scope.often(4)
        given.append(Value(scope.fresh(), scope.dtype(ANY), scope.pick(ROWS) if lanes else (), lanes))
    scope.values += given
    turns = [_along(scope)] if along and ("scan" in writers.FAVOURED or not scope.often(3)) else []
    for _ in range(scope.pick([2, 3, 4, 6, 8])):
        write(scope)
    results = [value for value in scope.values if value not in given] + [kept for _, kept in turns]
    given += [value for rows, _ in turns for value in rows]
    lines = ["L = v1.shape[-1]", *scope.lines, f"return ({tuple_of(results)})"]
    source = "\n    ".join([f"def function({tuple_of(given)}):", *lines]) + "\n"
    return Function(source, given, results, scope.number(2**16), scope.pick(LANES))


def _along(scope: Scope) -> tuple[list[Value], Value]:
    """Write a loop along an argument of its own, from either end; return the argument and the results of the turns."""
    (start, inside), name = scope.carried(), scope.fresh()
    row = Value(scope.fresh(), scope.dtype(ANY), scope.pick([(), (2,)])) if scope.often(3) else None
    inner = scope.inner([*inside, *([row] if row else [])])
    kept = inner.result(row or scope.any(apart=True, lanes=True))
    results = [inner.result(value) for value in inside]
    head = f"def {name}(carried, {row.name if row else '_'})"
    # An unchanged row would be the argument itself.
    returned = f"({tuple_of(results)}), jnp.copy({kept.name})"
    scope.define(head, [f"({tuple_of(inside)}) = carried", *inner.lines], returned)
    # Only loops whose iterations have an order reveal the planted fault.
    length, reverse = (3, True) if "scan" in writers.FAVOURED else (scope.pick([0, 1, 3]), scope.pick([True, False]))
    given = [replace(row, name=scope.fresh(), rows=(length, *row.rows))] if row else []
    kept = replace(kept, name=scope.fresh(), rows=(length, *kept.rows))
    after = [replace(value, name=scope.fresh(), accuracy=EXACT) for value in start]
    call = f"lax.scan({name}, ({tuple_of(start)}), {given[0].name if given else None}, {length}, reverse={reverse})"
    scope.lines.append(f"({tuple_of(after)}), {kept.name} = {call}")
    scope.values += after
    return given, kept
