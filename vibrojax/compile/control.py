"""Translation rules for loops, branches and function calls."""

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from vibrojax.compile.assembly import (
    LANES,
    Assembly,
    Entry,
    Slot,
    Value,
    build,
    dtype_of,
    each,
    refuse_if,
    varies,
    without_lanes,
)

LOOP_VALUES_IN_REGISTERS = 24
"""Maximum number of values that a loop carries in registers. If a loop carries more, all its values stay in memory and
are loaded at each use."""

Write = Callable[[Any, Sequence[Value], Collection[int]], list[Value]]
"""`write(jaxpr, arguments, owned)` emits the instructions of a closed jaxpr and returns its results. It may overwrite
arguments whose `id` is in `owned`."""

ControlRule = Callable[[Assembly, Write, Any, Sequence[Value], Collection[int]], list[Value]]
"""A rule that emits an equation of a jaxpr and, using `Write`, the jaxprs that the equation contains."""


def array_slots(asm: Assembly, place: int, aval: Any, block: tuple[str, int] = ("0", 0)) -> Value:
    """Return the slots of one of the kernel's arrays for this group of lanes. The lane axis must be the last axis.

    **Arguments:**

    - `place`: position of the array among all arguments and results.
    - `aval`: abstract value (shape and type) of the array, or of one block of it.
    - `block`: (index, rows) if the array is a stack of blocks: the register with the index of the block, and the
      number of rows per block.
    """
    varying, dtype = varies(aval), dtype_of(aval)
    refuse_if(varying and aval.shape[-1] != LANES, "lanes along another axis than the last")
    shape = without_lanes(aval.shape)
    array = asm.let(f"load ptr, ptr {asm.let(f'getelementptr ptr, ptr %arrays, i64 {place}')}")
    first = asm.let(f"mul i64 {block[0]}, {block[1]}")

    def slot(index: tuple[int, ...]) -> Slot:
        row = int(np.ravel_multi_index(index, shape)) if index else 0
        number = asm.let(f"add i64 {first}, {row}")
        if varying:
            number = asm.let(f"add i64 %lane, {asm.let(f'mul i64 %count, {number}')}")
        pointer = asm.let(f"getelementptr {asm.type_in_memory(dtype, False)}, ptr {array}, i64 {number}")
        return Slot(pointer, dtype, varying, 1)  # rows of lanes begin anywhere

    return build(shape, slot)


def placeholder(aval: Any) -> Value:
    """Return a placeholder for an array that only a loop reads or writes, row by row; its slots cannot be loaded."""
    return build(without_lanes(aval.shape), lambda _: Slot("", dtype_of(aval), varies(aval), 1))


def _reserve(asm: Assembly, variables: Sequence[Any]) -> list[Value]:
    """Return slots for arrays that are carried from one iteration of a loop to the next, or out of a branch."""
    few = sum(int(np.prod(without_lanes(var.aval.shape))) for var in variables) <= LOOP_VALUES_IN_REGISTERS
    return [asm.slots(var.aval, few) for var in variables]


def _put(asm: Assembly, places: Sequence[Value], values: Sequence[Value]) -> None:
    """Emit stores of arrays to slots. All arrays are loaded before the first store: their memory may overlap."""
    moves: list[tuple[Entry, Slot]] = []
    for slots, entries in zip(places, values, strict=True):
        for slot, entry in zip(slots.ravel().tolist(), entries.ravel().tolist(), strict=True):
            if entry != slot:
                moves.append((asm.register(entry), slot))
    for entry, slot in moves:
        asm.store(entry, slot)


def _while(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    params = equation.params
    of_condition, of_both = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    carried = _reserve(asm, equation.outvars)
    _put(asm, carried, values[of_both:])
    again, body, done = (asm.fresh(name) for name in ("again", "body", "done"))
    asm.do(f"br label %{again}")
    asm.label(again)
    [goes_on] = write(params["cond_jaxpr"], [*values[:of_condition], *carried], ())
    flag = asm.register(goes_on.item())
    refuse_if(flag.varying, "a loop that each lane leaves by itself")
    asm.do(f"br i1 {flag.text}, label %{body}, label %{done}")
    asm.label(body)
    _put(asm, carried, write(params["body_jaxpr"], [*values[of_condition:of_both], *carried], set(map(id, carried))))
    asm.do(f"br label %{again}")
    asm.label(done)
    return carried


def scanned(equation: Any) -> list[Any]:
    """Return the input arrays that a jaxpr equation scans row by row; an empty list if it is not a `scan`."""
    is_scan = equation.primitive.name == "scan"
    return _with_rows(equation.invars, equation.params["jaxpr"].jaxpr.invars) if is_scan else []


def _with_rows(outside: Sequence[Any], inside: Sequence[Any]) -> list[Any]:
    """Return the outer variables of a loop that have one axis more than the matching inner variables."""
    return [var for var, row in zip(outside, inside, strict=True) if row.aval.ndim < var.aval.ndim]


def _scan(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    """Emit a `scan` equation, a loop of a known number of iterations.

    The scan may read arguments of the kernel and fill results of the kernel row by row, forwards or backwards.
    """
    inner, length = equation.params["jaxpr"].jaxpr, equation.params["length"]
    refuse_if(length == LANES, "a loop along the lanes")
    along, kept = scanned(equation), _with_rows(equation.outvars, inner.outvars)
    unknown = any(var not in asm.arrays for var in (*along, *kept))
    refuse_if(unknown, "a scan along an array that is neither an argument nor a result")
    carries = len(equation.outvars) - len(kept)
    constant = len(values) - carries - len(along)
    carried = _reserve(asm, equation.outvars[:carries])
    _put(asm, carried, values[constant : constant + carries])

    def row_slots(number: str, var: Any, row: Any) -> Value:
        size = int(np.prod(without_lanes(row.aval.shape)))
        return array_slots(asm, asm.arrays[var], row.aval, block=(number, size))

    def turn(number: str) -> None:
        if equation.params["reverse"]:
            number = asm.let(f"sub i64 {length - 1}, {number}")
        pairs = zip(along, inner.invars[constant + carries :], strict=True)
        rows = [each(asm.register, row_slots(number, var, row)) for var, row in pairs]
        results = write(equation.params["jaxpr"], [*values[:constant], *carried, *rows], set(map(id, carried)))
        for var, row, value in zip(kept, inner.outvars[carries:], results[carries:], strict=True):
            asm.store_array(value, row_slots(number, var, row))
        _put(asm, carried, results[:carries])

    asm.repeat(length, turn)
    asm.filled |= {asm.arrays[var] for var in kept}
    return [*carried, *(placeholder(var.aval) for var in kept)]


def _branch(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    """Emit a branch between two functions. The condition is shared by all lanes."""
    index, *arguments = values
    which = asm.register(index.item())
    branches = equation.params["branches"]
    refuse_if(which.varying or len(branches) != 2, "a branch that each lane takes by itself, or of more than two")
    places = _reserve(asm, equation.outvars)
    names = [asm.fresh("branch") for _ in branches]
    done = asm.fresh("done")
    flag = which.text
    if which.dtype != bool:
        flag = asm.let(f"icmp sgt {asm.type(which.dtype, False)} {flag}, 0")
    asm.do(f"br i1 {flag}, label %{names[1]}, label %{names[0]}")
    for name, branch in zip(names, branches, strict=True):
        asm.label(name)
        _put(asm, places, write(branch, arguments, ()))
        asm.do(f"br label %{done}")
    asm.label(done)
    return places


CALLS = ("jit", "custom_jvp_call", "custom_vjp_call")
"""Primitives that call a function. jax caches the trace of a function, which may have had another caller."""


def called(equation: Any) -> Any:
    """Return the closed jaxpr of the function that an equation calls."""
    return equation.params.get("jaxpr") or equation.params["call_jaxpr"]


def _call(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    return write(called(equation), values, owned)


RULES: dict[str, ControlRule] = {"while": _while, "scan": _scan, "cond": _branch, **dict.fromkeys(CALLS, _call)}
