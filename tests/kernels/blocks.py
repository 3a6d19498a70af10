"""Writers of loops, branches and nested functions for random functions."""

from collections.abc import Callable
from dataclasses import replace

from scopes import Scope, Value, tuple_of


def write_for(scope: Scope) -> None:
    """Write a loop with a known number of turns, often none."""
    (start, inside), name, turn = scope.carried(), scope.fresh(), scope.fresh()
    inner = scope.inner([*inside, Value(turn, "int64", lanes=False)])
    results = [inner.result(value) for value in inside]
    lines = [f"({tuple_of(inside)}) = carried", *inner.lines]
    scope.define(f"def {name}({turn}, carried)", lines, f"({tuple_of(results)})")
    low, high = scope.pick([(0, 0), (3, 1), (0, 1), (0, 2), (2, 5)])
    scope.unpack(f"lax.fori_loop({low}, {high}, {name}, ({tuple_of(start)}))", start)


def write_while(scope: Scope) -> None:
    """Write a loop that runs while a counter is too small: one counter for all lanes, or that of any lane."""
    (start, inside), name, turn = scope.carried(), scope.fresh(), scope.fresh()
    limit = scope.value("int64", (), scope.pick([True, False]))
    limit = scope.let(f"short({limit.name})", limit)
    inner = scope.inner([*inside, replace(limit, name=turn)])
    results = [inner.result(value) for value in inside]
    lines = [f"({turn}, {tuple_of(inside)}) = carried", *inner.lines]
    scope.define(f"def {name}(carried)", lines, f"({turn} + 1, {tuple_of(results)})")
    more = f"lambda carried: {'jnp.any' * limit.lanes}(carried[0] < {limit.name})"
    first = f"jnp.zeros_like({limit.name})"
    scope.unpack(f"lax.while_loop({more}, {name}, ({first}, {tuple_of(start)}))[1:]", start)


def write_cond(scope: Scope) -> None:
    (given, _), names = scope.carried(), (scope.fresh(), scope.fresh())
    for name in names:
        inner = scope.inner([])
        results = [inner.result(value) for value in given]
        scope.define(f"def {name}()", inner.lines, f"({tuple_of(results)})")
    which = scope.value(scope.pick(["bool_", "int32"]), (), False)
    if which.kind == "b":
        scope.unpack(f"lax.cond({which.name}, {names[0]}, {names[1]})", given)
    else:
        scope.unpack(f"lax.switch({which.name}, ({names[0]}, {names[1]}))", given)


def write_called(wrapper: str) -> Callable[[Scope], None]:
    def write(scope: Scope) -> None:
        (start, inside), name = scope.carried(), scope.fresh()
        inner = scope.inner(inside, closed=True)
        results = [inner.result(value) for value in inside]
        scope.define(f"def {name}({tuple_of(inside)})", inner.lines, f"({tuple_of(results)})")
        scope.unpack(f"{wrapper}({name})({tuple_of(start)})", start)

    return write
