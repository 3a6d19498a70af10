"""LLVM IR of a kernel: operands, instructions, and memory. A jax array becomes a numpy array of operands."""

import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from vibrojax.lazy import jax

BOOL = np.dtype(bool)

LANES = 1009
"""Length of the lane axis while a function is traced: a large prime, so that no other axis is mistaken for the lane
axis. A kernel has no lane axis: each array element represents one value in all lanes of a group."""

LLVM_TYPES: dict[Any, str] = {  # any: numpy knows no common type of its dtypes
    np.dtype("float64"): "double",
    np.dtype("float32"): "float",
    **{np.dtype(f"{sign}int{bits}"): f"i{bits}" for bits in (64, 32, 16, 8) for sign in ("", "u")},
    BOOL: "i1",
}
"""LLVM's name of each number type."""


class Untranslatable(Exception):
    """No kernel can express a function. The message names the unsupported construct."""


def refuse_if(condition: Any, construct: str) -> None:
    """Raise `Untranslatable` for a construct if the condition holds."""
    if condition:
        raise Untranslatable(construct)


class Operand(NamedTuple):
    """A register or a literal: a vector with one element per lane if `varying`, else one number for all lanes."""

    text: str
    dtype: np.dtype
    varying: bool

    @property
    def is_literal(self) -> bool:
        return not self.text.startswith("%")

    @property
    def number(self) -> float | int | None:
        """Value of a literal, or None for a register."""
        if not self.is_literal:
            return None
        if self.dtype.kind == "f":
            return float(struct.unpack("<d", struct.pack("<Q", int(self.text, 16)))[0])
        return self.text == "true" if self.dtype == BOOL else int(self.text)


class Slot(NamedTuple):
    """A value in memory, which is loaded where it is used.

    - `pointer`: register with its address; empty for a placeholder, which cannot be loaded.
    - `alignment`: alignment of the address [bytes].
    - `offset`: position in the workspace [bytes]; None for other memory.
    """

    pointer: str
    dtype: np.dtype
    varying: bool
    alignment: int
    offset: int | None = None


Entry = Operand | Slot
"""An element of an array in a kernel: a register, a literal, or a slot in memory."""

Value = np.ndarray[Any, np.dtype[np.object_]]
"""A jax array in a kernel: a numpy array whose elements are `Entry`. Its lane axis has length 1."""


def build(shape: tuple[int, ...], entry: Callable[[tuple[int, ...]], Entry]) -> Value:
    """Return an array with the element `entry(index)` at each index. `entry` is called in row-major order."""
    array = np.empty(shape, object)
    for index in np.ndindex(array.shape):
        array[index] = entry(index)
    return array


def each(function: Callable[..., Entry], *values: Value) -> Value:
    """Return `function` of the elements of arrays, which are broadcast against each other, in row-major order."""
    if any(value.shape != values[0].shape for value in values):
        values = np.broadcast_arrays(*values)
    entries = zip(*(value.ravel().tolist() for value in values), strict=True)
    return np.fromiter((function(*elements) for elements in entries), object, values[0].size).reshape(values[0].shape)


def element(dtype: np.dtype) -> str:
    """Return LLVM's name of a number type; raise `Untranslatable` if kernels do not support the type."""
    if dtype not in LLVM_TYPES:
        raise Untranslatable(f"numbers of type {dtype}")
    return LLVM_TYPES[dtype]


def literal(x: Any, dtype: np.dtype) -> Operand:
    """Return the literal of a compile-time constant; raise `Untranslatable` for an unsupported type."""
    dtype = np.dtype(dtype)
    element(dtype)
    if dtype.kind == "f":
        # LLVM writes float literals of either width as the bits of a double.
        text = f"0x{struct.unpack('<Q', struct.pack('<d', float(dtype.type(x))))[0]:016X}"
    else:
        text = str(bool(x)).lower() if dtype.kind == "b" else str(int(x))
    return Operand(text, dtype, False)


def literals(x: Any) -> Value:
    """Return the literals of an array of compile-time constants, which are the same for all lanes."""
    x = np.asarray(x)
    if x.dtype == jax.dtypes.float0:
        x = np.zeros(x.shape, bool)
    refuse_if(LANES in x.shape, "an array that is captured and has lanes")
    return build(x.shape, lambda index: literal(x[index], x.dtype))


def without_lanes(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of an array in a kernel, in which the lane axis has length 1."""
    refuse_if(shape.count(LANES) > 1, "an array with lanes along two axes")
    return tuple(1 if length == LANES else length for length in shape)


def varies(aval: Any) -> bool:
    """Return whether an array has a lane axis."""
    return LANES in aval.shape


def dtype_of(aval: Any) -> np.dtype:
    """Return an array's numpy dtype. Tangents of integers (float0) are booleans in a kernel.

    **Raises:** `Untranslatable` for types that numpy does not have, such as jax's random keys.
    """
    if not isinstance(aval.dtype, np.dtype):
        raise Untranslatable(f"numbers of type {aval.dtype}")
    return BOOL if aval.dtype == jax.dtypes.float0 else aval.dtype


class Assembly:
    """Instructions for a group of `width` lanes, appended one by one. A vector has one element per lane.

    - `lines`: the instructions. `places`: instructions that reserve memory, emitted before `lines`.
    - `declared`: declarations of external functions.
    - `workspace`: size of the workspace so far [bytes]. The workspace is memory that the caller of the kernel provides.
    - `alignment`: alignment of vectors in memory and of the workspace [bytes].
    - `positive`: registers with floats whose sign bit is not set, or that are NaN.
    - `arrays`: position of each variable among the kernel's arrays (arguments, then results).
    - `filled`: positions of the arrays that a loop writes row by row.
    """

    def __init__(self, width: int) -> None:
        self.width, self.alignment = width, 8 * width
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
        self.do(f"{name} = {instruction}")
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
        pointer, dtype, varying, alignment, _ = entry
        refuse_if(not pointer, "an array that a loop goes along, and something else wants")
        if pointer not in self._read:
            kind = self.type_in_memory(dtype, varying)
            x = self.let(f"load {kind}, ptr {pointer}, align {alignment}")
            if dtype == BOOL:
                x = self.let(f"trunc {kind} {x} to {self.type(BOOL, varying)}")
            self._read[pointer] = Operand(x, dtype, varying)
        return self._read[pointer]

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

    def store(self, entry: Entry, slot: Slot) -> None:
        x = self.text(entry, slot.varying)
        kind = self.type_in_memory(slot.dtype, slot.varying)
        if slot.dtype == BOOL:
            x = self.let(f"zext {self.type(BOOL, slot.varying)} {x} to {kind}")
        self.do(f"store {kind} {x}, ptr {slot.pointer}, align {slot.alignment}")

    def store_array(self, value: Value, slots: Value) -> None:
        for entry, slot in zip(value.ravel().tolist(), slots.ravel().tolist(), strict=True):
            self.store(entry, slot)

    def slot(self, dtype: np.dtype, varying: bool, in_registers: bool) -> Slot:
        """Return a new slot. If `in_registers`, LLVM may turn it into a register; else it is in the workspace."""
        name, alignment = f"%{self.fresh('p')}", self.alignment if varying else 8
        if in_registers:
            self.places.append(f"  {name} = alloca {self.type_in_memory(dtype, varying)}, align {alignment}")
            return Slot(name, dtype, varying, alignment)
        offset = self.workspace
        self.places.append(f"  {name} = getelementptr i8, ptr %workspace, i64 {offset}")
        self.workspace += self.alignment
        return Slot(name, dtype, varying, alignment, offset)

    def slots(self, aval: Any, in_registers: bool) -> Value:
        dtype, varying = dtype_of(aval), varies(aval)
        return build(without_lanes(aval.shape), lambda _: self.slot(dtype, varying, in_registers))

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
