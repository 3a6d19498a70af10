"""Loops, branches, and functions within functions."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from vibrojax.compile.kernels.arrays import array_slots, elsewhere
from vibrojax.compile.kernels.assembly import IN_REGISTERS, Assembly
from vibrojax.compile.kernels.operands import LANES, Entry, Slot, Untranslatable, Value, dtype_of, varies, without_lanes

Write = Callable[[Any, Sequence[Value], Collection[int]], list[Value]]
"""Writes a closed jaxpr for its arguments; of those whose identities are given it may overwrite the memory."""

Controlled = Callable[[Assembly, Write, Any, Sequence[Value], Collection[int]], list[Value]]
"""A rule: it writes an equation of a jaxpr and, by `Write`, those within it."""


def _places(asm: Assembly, avals: Sequence[Any]) -> list[Value]:
    """Memory for arrays that are carried from one turn of a loop to the next, or out of a branch."""
    few = sum(int(np.prod(without_lanes(aval.shape))) for aval in avals) <= IN_REGISTERS
    places = []
    for aval in avals:
        slots = np.empty(without_lanes(aval.shape), object)
        for index in np.ndindex(slots.shape):
            slots[index] = asm.slot(dtype_of(aval), varies(aval), few)
        places.append(slots)
    return places


def _put(asm: Assembly, places: Sequence[Value], values: Sequence[Value]) -> None:
    """Write arrays to memory: all are read before any is written, because they may stand in each other's places."""
    moved: list[tuple[Entry, Slot]] = []
    for slots, entries in zip(places, values, strict=True):
        for slot, entry in zip(slots.ravel().tolist(), entries.ravel().tolist(), strict=True):
            if entry != slot:
                moved.append((asm.register(entry), slot))
    for entry, slot in moved:
        asm.store(entry, slot)


def _while(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    params = equation.params
    of_condition, of_both = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    carried = _places(asm, [var.aval for var in equation.outvars])
    _put(asm, carried, values[of_both:])
    again, body, done = (asm.fresh(name) for name in ("again", "body", "done"))
    asm.do(f"br label %{again}")
    asm.label(again)
    [goes_on] = write(params["cond_jaxpr"], [*values[:of_condition], *carried], ())
    flag = asm.register(goes_on.item())
    if flag.varying:
        raise Untranslatable("a loop that each lane leaves by itself")
    asm.do(f"br i1 {flag.text}, label %{body}, label %{done}")
    asm.label(body)
    _put(asm, carried, write(params["body_jaxpr"], [*values[of_condition:of_both], *carried], set(map(id, carried))))
    asm.do(f"br label %{again}")
    asm.label(done)
    return carried


def scanned(equation: Any) -> list[Any]:
    """The variables of a scan that its turns go along."""
    if equation.primitive.name != "scan":
        return []
    return _longer(equation.invars, equation.params["jaxpr"].jaxpr.invars)


def _longer(outside: Sequence[Any], inside: Sequence[Any]) -> list[Any]:
    """Those variables outside of a loop that have an axis more than within."""
    return [var for var, one in zip(outside, inside, strict=True) if one.aval.ndim < var.aval.ndim]


def _scan(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    """Write a loop of a known number of turns (`fori_loop`).

    It may go along arguments of the kernel, from either end, and the outputs of its turns may be results.
    """
    inner, length = equation.params["jaxpr"].jaxpr, equation.params["length"]
    if length == LANES:
        raise Untranslatable("a loop along the lanes")
    along, kept = scanned(equation), _longer(equation.outvars, inner.outvars)
    if any(var not in asm.arrays for var in (*along, *kept)):
        raise Untranslatable("a scan along what is no argument, or whose turns are kept and are no result")
    carries = len(equation.outvars) - len(kept)
    constant = len(values) - carries - len(along)
    carried = _places(asm, [var.aval for var in equation.outvars[:carries]])
    _put(asm, carried, values[constant : constant + carries])

    def rows(number: str, var: Any, one: Any) -> Value:
        size = int(np.prod(without_lanes(one.aval.shape)))
        return array_slots(asm, asm.arrays[var], one.aval, after=(number, size))

    def turn(number: str) -> None:
        number = _row_of_turn(asm, number, equation.params)
        read = [
            np.vectorize(partial(asm.load, alignment=1), otypes=[object])(rows(number, var, one))
            for var, one in zip(along, inner.invars[constant + carries :], strict=True)
        ]
        given = [*values[:constant], *carried, *read]
        found = write(equation.params["jaxpr"], given, set(map(id, carried)))
        for var, one, value in zip(kept, inner.outvars[carries:], found[carries:], strict=True):
            for slot, entry in zip(rows(number, var, one).ravel().tolist(), value.ravel().tolist(), strict=True):
                asm.store(entry, slot, alignment=1)
        _put(asm, carried, found[:carries])

    asm.repeated(length, turn)
    asm.filled |= {asm.arrays[var] for var in kept}
    return [*carried, *(elsewhere(var.aval) for var in kept)]


def _row_of_turn(asm: Assembly, turn: str, params: Mapping[str, Any]) -> str:
    """Return the register with the number of the row that a turn of a scan reads and writes."""
    return asm.let(f"sub i64 {params['length'] - 1}, {turn}") if params["reverse"] else turn


def _branch(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    """One of two functions, for all lanes alike."""
    index, *given = values
    which = asm.register(index.item())
    branches = equation.params["branches"]
    if which.varying or len(branches) != 2:
        raise Untranslatable("a branch that each lane takes by itself, or of more than two")
    places = _places(asm, [var.aval for var in equation.outvars])
    names = [asm.fresh("branch") for _ in branches]
    done = asm.fresh("done")
    flag = which.text
    if which.dtype != bool:
        flag = asm.let(f"icmp sgt {asm.type(which.dtype, False)} {flag}, 0")
    asm.do(f"br i1 {flag}, label %{names[1]}, label %{names[0]}")
    for name, branch in zip(names, branches, strict=True):
        asm.label(name)
        _put(asm, places, write(branch, given, ()))
        asm.do(f"br label %{done}")
    asm.label(done)
    return places


def _called(asm: Assembly, write: Write, equation: Any, values: Sequence[Value], owned: Collection[int]) -> list[Value]:
    params = equation.params
    return write(params.get("jaxpr") or params["call_jaxpr"], values, owned)


RULES: dict[str, Controlled] = {
    "while": _while,
    "scan": _scan,
    "cond": _branch,
    **dict.fromkeys(("jit", "custom_jvp_call", "custom_vjp_call"), _called),
}
