"""LLVM IR of one function: its instructions, the memory that they use, and the arrays that it reads and fills."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from vibrojax.compile.kernels.operands import (
    BOOL,
    LANES,
    Entry,
    Operand,
    Slot,
    Untranslatable,
    Value,
    build,
    dtype_of,
    element,
    varies,
    without_lanes,
)


class Assembly:
    """Instructions for a group of `width` lanes, appended one by one. A vector has one element per lane.

    - `lines`: the instructions. `places`: instructions that reserve memory, emitted before `lines`.
    - `declared`: declarations of external functions.
    - `workspace`: size of the workspace so far [bytes]. The workspace is memory that the caller of the kernel provides.
    - `positive`: registers with floats whose sign bit is not set, or that are NaN.
    - `arrays`: position of each variable among the kernel's arrays (arguments, then results).
    - `filled`: positions of the arrays that a loop writes row by row.
    """

    def __init__(self, width: int) -> None:
        self.width = width
        self.lines: list[str] = []
        self.places: list[str] = []
        self.declared: set[str] = set()
        self.workspace = 0
        self.arrays: dict[object, int] = {}
        self.filled: set[int] = set()
        self.positive: set[str] = set()
        self._names = 0
        self._read: dict[str, Operand] = {}

    def fresh(self, prefix: str) -> str:
        """Return an unused name, without LLVM's prefix `%`."""
        self._names += 1
        return f"{prefix}{self._names}"

    def do(self, instruction: str) -> None:
        """Append an instruction without a result."""
        self.lines.append(f"  {instruction}")

    def let(self, instruction: str) -> str:
        """Append an instruction and return the register of its result."""
        name = f"%{self.fresh('v')}"
        self.lines.append(f"  {name} = {instruction}")
        return name

    def label(self, name: str) -> None:
        """Append a label, the target of a jump."""
        self.lines.append(f"{name}:")
        self.forget()

    def forget(self) -> None:
        """Discard cached reads. Values in memory may have changed and are loaded again at their next use."""
        self._read = {}

    def repeat(self, turns: int, turn: Callable[[str], None]) -> None:
        """Append a loop of `turns` iterations.

        `turn(number)` emits the body. `number` is the register with the number of the iteration, counted from 0. The
        number of iterations is known. A loop of no iterations is therefore omitted, and every other loop tests its end
        after the body.
        """
        if turns < 1:
            return
        body, done = self.fresh("body"), self.fresh("done")
        count = self.slot(np.dtype(np.int64), False, in_registers=True).pointer
        self.do(f"store i64 0, ptr {count}, align 8")
        self.do(f"br label %{body}")
        self.label(body)
        number = self.let(f"load i64, ptr {count}, align 8")
        turn(number)
        next_number = self.let(f"add i64 {number}, 1")
        self.do(f"store i64 {next_number}, ptr {count}, align 8")
        self.do(f"br i1 {self.let(f'icmp slt i64 {next_number}, {turns}')}, label %{body}, label %{done}")
        self.label(done)

    def type(self, dtype: np.dtype, varying: bool) -> str:
        """Return the LLVM type of a register, a vector if `varying`."""
        return f"<{self.width} x {element(dtype)}>" if varying else element(dtype)

    def type_in_memory(self, dtype: np.dtype, varying: bool) -> str:
        """Return the LLVM type of a value in memory. It is the register's type, except that booleans are bytes."""
        return self.type(np.dtype(np.int8) if dtype == BOOL else dtype, varying)

    def register(self, entry: Entry) -> Operand:
        """Return an array element as a register or literal; a slot is loaded from memory."""
        if isinstance(entry, Operand):
            return entry
        if not entry.pointer:
            raise Untranslatable("an array that a loop goes along, and something else wants")
        if entry.pointer not in self._read:
            self._read[entry.pointer] = self.load(entry, self._alignment(entry.varying))
        return self._read[entry.pointer]

    def vector(self, entry: Entry) -> str:
        """Return the IR text of an array element as a vector, even if the element is the same for all lanes."""
        x = self.register(entry)
        if x.varying:
            return x.text
        kind, whole = element(x.dtype), self.type(x.dtype, True)
        if x.is_literal:
            return f"splat ({kind} {x.text})"
        first = self.let(f"insertelement {whole} poison, {kind} {x.text}, i64 0")
        return self.let(f"shufflevector {whole} {first}, {whole} poison, <{self.width} x i32> zeroinitializer")

    def text(self, entry: Entry, varying: bool) -> str:
        """Return the operand for an array element in IR syntax: as a vector if `varying`, else as a scalar."""
        return self.vector(entry) if varying else self.register(entry).text

    def load(self, slot: Slot, alignment: int) -> Operand:
        """Emit a load of a slot and return the register of the value."""
        kind = self.type_in_memory(slot.dtype, slot.varying)
        x = self.let(f"load {kind}, ptr {slot.pointer}, align {alignment}")
        if slot.dtype == BOOL:
            x = self.let(f"trunc {kind} {x} to {self.type(BOOL, slot.varying)}")
        return Operand(x, slot.dtype, slot.varying)

    def store(self, entry: Entry, slot: Slot, alignment: int | None = None) -> None:
        """Emit a store of an array element to a slot."""
        x = self.text(entry, slot.varying)
        kind = self.type_in_memory(slot.dtype, slot.varying)
        if slot.dtype == BOOL:
            x = self.let(f"zext {self.type(BOOL, slot.varying)} {x} to {kind}")
        self.do(f"store {kind} {x}, ptr {slot.pointer}, align {alignment or self._alignment(slot.varying)}")

    def slot(self, dtype: np.dtype, varying: bool, in_registers: bool) -> Slot:
        """Return a new slot. If `in_registers`, LLVM may turn it into a register; else it is in the workspace."""
        name = f"%{self.fresh('p')}"
        if in_registers:
            kind = self.type_in_memory(dtype, varying)
            self.places.append(f"  {name} = alloca {kind}, align {self._alignment(varying)}")
            return Slot(name, dtype, varying)
        offset = self.workspace
        self.places.append(f"  {name} = getelementptr i8, ptr %workspace, i64 {offset}")
        self.workspace += self.alignment
        return Slot(name, dtype, varying, offset)

    def call(self, function: str, arguments: Sequence[str], gives: str, takes: str | None = None) -> str:
        """Emit a call of an external function with the result type `gives`.

        All arguments have the type `takes`, by default the type of the result.
        """
        takes = takes or gives
        self.declared.add(f"declare {gives} @{function}({', '.join([takes] * len(arguments))})")
        return self.let(f"call {gives} @{function}({', '.join(f'{takes} {x}' for x in arguments)})")

    def intrinsic(self, name: str, arguments: Sequence[str], dtype: np.dtype, varying: bool) -> str:
        """Emit a call of an intrinsic function of LLVM whose arguments have the type of its result."""
        lanes = f"v{self.width}" if varying else ""
        return self.call(f"llvm.{name}.{lanes}{self.suffix(dtype)}", arguments, self.type(dtype, varying))

    def suffix(self, dtype: np.dtype) -> str:
        """Return the suffix of an intrinsic function's name for a number type, such as `f64`."""
        return ("f" if dtype.kind == "f" else "i") + str(1 if dtype == BOOL else 8 * dtype.itemsize)

    @property
    def alignment(self) -> int:
        """Alignment of vectors in memory and of the workspace [bytes]."""
        return 8 * self.width

    def _alignment(self, varying: bool) -> int:
        return self.alignment if varying else 8


def array_slots(asm: Assembly, place: int, aval: Any, block: tuple[str, int] = ("0", 0)) -> Value:
    """Return the slots of one of the kernel's arrays for this group of lanes. The lane axis must be the last axis.

    **Arguments:**

    - `place`: position of the array among all arguments and results.
    - `aval`: abstract value (shape and type) of the array, or of one block of it.
    - `block`: (index, rows) if the array is a stack of blocks: the register with the index of the block, and the number
      of rows per block.
    """
    varying, dtype = varies(aval), dtype_of(aval)
    if varying and aval.shape[-1] != LANES:
        raise Untranslatable("lanes along another axis than the last")
    shape = without_lanes(aval.shape)
    array = asm.let(f"load ptr, ptr {asm.let(f'getelementptr ptr, ptr %arrays, i64 {place}')}")
    first = asm.let(f"mul i64 {block[0]}, {block[1]}")

    def slot(index: tuple[int, ...]) -> Slot:
        row = int(np.ravel_multi_index(index, shape)) if index else 0
        number = asm.let(f"add i64 {first}, {row}")
        if varying:
            number = asm.let(f"add i64 %lane, {asm.let(f'mul i64 %count, {number}')}")
        pointer = asm.let(f"getelementptr {asm.type_in_memory(dtype, False)}, ptr {array}, i64 {number}")
        return Slot(pointer, dtype, varying)

    return build(shape, slot)


def array_entries(asm: Assembly, place: int, aval: Any) -> Value:
    """Return an argument of the kernel in registers. It is loaded only once: its rows are far apart in memory."""
    slots = array_slots(asm, place, aval)
    return build(slots.shape, lambda index: asm.load(slots.item(index), alignment=1))


def placeholder(aval: Any) -> Value:
    """Return a placeholder for an array that only a loop reads or writes, row by row; its slots cannot be loaded."""
    return build(without_lanes(aval.shape), lambda _: Slot("", dtype_of(aval), varies(aval)))
