"""The arrays that a kernel is given and those that it fills."""

from typing import Any

import numpy as np

from vibrojax.compile.kernels.assembly import Assembly
from vibrojax.compile.kernels.operands import LANES, Slot, Untranslatable, Value, dtype_of, varies, without_lanes


def array_entries(asm: Assembly, place: int, aval: Any) -> Value:
    """An array that is given, read at once: its rows lie far apart."""
    slots = array_slots(asm, place, aval)
    entries = np.empty(slots.shape, object)
    for index in np.ndindex(slots.shape):
        entries[index] = asm.load(slots.item(index), alignment=1)
    return entries


def elsewhere(aval: Any) -> Value:
    """For an array that a loop goes along, and nothing else may want: entries that are nowhere."""
    entries = np.empty(without_lanes(aval.shape), object)
    entries.fill(Slot("", dtype_of(aval), varies(aval)))
    return entries


def array_slots(asm: Assembly, place: int, aval: Any, after: tuple[str, int] = ("0", 0)) -> Value:
    """Where the entries of an array lie, for this group of lanes, which are its last axis.

    **Arguments:**

    - `place`: its number among all arrays.
    - `after`: (how many, how large): so many like it come before, of so many rows each.
    """
    varying, dtype = varies(aval), dtype_of(aval)
    if varying and aval.shape[-1] != LANES:
        raise Untranslatable("lanes along another axis than the last")
    slots = np.empty(without_lanes(aval.shape), object)
    array = asm.let(f"load ptr, ptr {asm.let(f'getelementptr ptr, ptr %arrays, i64 {place}')}")
    before = asm.let(f"mul i64 {after[0]}, {after[1]}")
    for row, index in enumerate(np.ndindex(slots.shape)):
        number = asm.let(f"add i64 {before}, {row}")
        if varying:
            number = asm.let(f"add i64 %lane, {asm.let(f'mul i64 %count, {number}')}")
        pointer = asm.let(f"getelementptr {asm.type_in_memory(dtype, False)}, ptr {array}, i64 {number}")
        slots[index] = Slot(pointer, dtype, varying)
    return slots
