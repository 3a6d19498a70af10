"""The text of one function in LLVM's language: instructions one after the other, and the memory that they use."""

from collections.abc import Callable, Sequence

import numpy as np

from vibrojax.compile.kernels.operands import BOOL, Entry, Operand, Slot, Untranslatable, element

IN_REGISTERS = 24
"""Values that a loop may carry in registers; those of larger loops stay in memory, where each is read as it is used."""


class Assembly:
    """Instructions for a group of `width` lanes, written one by one. A vector has one element for each lane.

    - `lines`, and before them `places`: the instructions; `declared`: functions from outside; `workspace`: bytes of it.
    - `positive`: registers with floats that have no sign (or are NaN).
    - `arrays`: which of the kernel's arrays a variable is; `filled`: those that are written within a loop.
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
        """A name that nothing else has, without its sign."""
        self._names += 1
        return f"{prefix}{self._names}"

    def do(self, instruction: str) -> None:
        """An instruction that gives nothing."""
        self.lines.append(f"  {instruction}")

    def let(self, instruction: str) -> str:
        """The register that holds what an instruction gives."""
        name = f"%{self.fresh('v')}"
        self.lines.append(f"  {name} = {instruction}")
        return name

    def label(self, name: str) -> None:
        """Where a jump leads."""
        self.lines.append(f"{name}:")
        self.forget()

    def forget(self) -> None:
        """What was read from memory is read again: it may have changed since."""
        self._read = {}

    def repeated(self, turns: int, turn: Callable[[str], None]) -> None:
        """Write a loop of `turns` turns. `turn` writes the body, and is given the register that counts from 0.

        The number of turns is known here, so that a loop without turns is left out and others test after their body.
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
        made = self.let(f"add i64 {number}, 1")
        self.do(f"store i64 {made}, ptr {count}, align 8")
        self.do(f"br i1 {self.let(f'icmp slt i64 {made}, {turns}')}, label %{body}, label %{done}")
        self.label(done)

    def type(self, dtype: np.dtype, varying: bool) -> str:
        """The type of a register."""
        return f"<{self.width} x {element(dtype)}>" if varying else element(dtype)

    def type_in_memory(self, dtype: np.dtype, varying: bool) -> str:
        """The type of a place in memory: that of the register, but that truth values are bytes."""
        return self.type(np.dtype(np.int8) if dtype == BOOL else dtype, varying)

    def register(self, entry: Entry) -> Operand:
        """An entry, read from memory if that is where it is."""
        if isinstance(entry, Operand):
            return entry
        if not entry.pointer:
            raise Untranslatable("an array that a loop goes along, and something else wants")
        if entry.pointer not in self._read:
            self._read[entry.pointer] = self.load(entry, self._alignment(entry.varying))
        return self._read[entry.pointer]

    def vector(self, entry: Entry) -> str:
        """The text of an entry as a vector, whether it varies or not."""
        x = self.register(entry)
        if x.varying:
            return x.text
        kind, whole = element(x.dtype), self.type(x.dtype, True)
        if x.is_literal:
            return f"splat ({kind} {x.text})"
        first = self.let(f"insertelement {whole} poison, {kind} {x.text}, i64 0")
        return self.let(f"shufflevector {whole} {first}, {whole} poison, <{self.width} x i32> zeroinitializer")

    def text(self, entry: Entry, varying: bool) -> str:
        """The text of an entry, as a vector where `varying`."""
        return self.vector(entry) if varying else self.register(entry).text

    def load(self, slot: Slot, alignment: int) -> Operand:
        """What is in memory now."""
        held = self.type_in_memory(slot.dtype, slot.varying)
        x = self.let(f"load {held}, ptr {slot.pointer}, align {alignment}")
        if slot.dtype == BOOL:
            x = self.let(f"trunc {held} {x} to {self.type(BOOL, slot.varying)}")
        return Operand(x, slot.dtype, slot.varying)

    def store(self, entry: Entry, slot: Slot, alignment: int | None = None) -> None:
        """Write an entry to memory."""
        x = self.text(entry, slot.varying)
        held = self.type_in_memory(slot.dtype, slot.varying)
        if slot.dtype == BOOL:
            x = self.let(f"zext {self.type(BOOL, slot.varying)} {x} to {held}")
        self.do(f"store {held} {x}, ptr {slot.pointer}, align {alignment or self._alignment(slot.varying)}")

    def slot(self, dtype: np.dtype, varying: bool, in_registers: bool) -> Slot:
        """A new place for a value: one that the compiler may turn into a register, or one in the workspace."""
        name = f"%{self.fresh('p')}"
        if in_registers:
            held = self.type_in_memory(dtype, varying)
            self.places.append(f"  {name} = alloca {held}, align {self._alignment(varying)}")
            return Slot(name, dtype, varying)
        offset = self.workspace
        self.places.append(f"  {name} = getelementptr i8, ptr %workspace, i64 {offset}")
        self.workspace += self.alignment
        return Slot(name, dtype, varying, offset)

    def call(self, function: str, arguments: Sequence[str], gives: str, takes: str | None = None) -> str:
        """The register that holds what a function outside gives of arguments of one type."""
        takes = takes or gives
        self.declared.add(f"declare {gives} @{function}({', '.join([takes] * len(arguments))})")
        return self.let(f"call {gives} @{function}({', '.join(f'{takes} {x}' for x in arguments)})")

    def intrinsic(self, name: str, arguments: Sequence[str], dtype: np.dtype, varying: bool) -> str:
        """The register that holds what one of LLVM's own functions gives of arguments of the type of its result."""
        lanes = f"v{self.width}" if varying else ""
        return self.call(f"llvm.{name}.{lanes}{self.suffix(dtype)}", arguments, self.type(dtype, varying))

    def suffix(self, dtype: np.dtype) -> str:
        """How names of LLVM's own functions tell of a type of numbers."""
        return ("f" if dtype.kind == "f" else "i") + str(1 if dtype == BOOL else 8 * dtype.itemsize)

    @property
    def alignment(self) -> int:
        """Of vectors in memory, and so of the workspace [bytes]."""
        return 8 * self.width

    def _alignment(self, varying: bool) -> int:
        return self.alignment if varying else 8
