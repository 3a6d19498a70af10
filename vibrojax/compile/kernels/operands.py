"""What instructions take: values in registers, literals, places in memory; and arrays of them, for jax's."""

import struct
from typing import Any, NamedTuple

import jax
import numpy as np

BOOL = np.dtype(bool)

LANES = 1009
"""The length by which the axis of lanes is told from others while a function is traced: a prime that nothing else has.
In a kernel that axis is gone: each entry of an array stands for the lanes of a vector."""

TYPES = {
    "float64": "double",
    "float32": "float",
    "int64": "i64",
    "int32": "i32",
    "int16": "i16",
    "int8": "i8",
    "uint64": "i64",
    "uint32": "i32",
    "uint16": "i16",
    "uint8": "i8",
    "bool": "i1",
}
"""LLVM's name of each type of numbers."""


class Untranslatable(Exception):
    """A function does what no kernel can do; it says what."""


class Operand(NamedTuple):
    """A value: a register or a literal; one for all lanes, or (`varying`) a vector with one for each."""

    text: str
    dtype: np.dtype
    varying: bool

    @property
    def is_literal(self) -> bool:
        return not self.text.startswith("%")

    @property
    def number(self) -> float | int | None:
        """The number of a literal; None for a register."""
        if not self.is_literal:
            return None
        if self.dtype.kind == "f":
            return float(struct.unpack("<d", struct.pack("<Q", int(self.text, 16)))[0])
        return self.text == "true" if self.dtype == BOOL else int(self.text)


class Slot(NamedTuple):
    """A value that is read from memory where it is used, nowhere if it has no `pointer`; `offset` [bytes] into the
    workspace, None if not there."""

    pointer: str
    dtype: np.dtype
    varying: bool
    offset: int | None = None


Entry = Operand | Slot

Value = np.ndarray[Any, np.dtype[np.object_]]
"""A jax array in a kernel: a numpy array of entries, whose axis of lanes has the length 1."""


def element(dtype: np.dtype) -> str:
    """LLVM's name of a type of numbers; raises `Untranslatable` where a kernel has none."""
    try:
        return TYPES[np.dtype(dtype).name]
    except KeyError:
        raise Untranslatable(f"numbers of type {dtype}") from None


def literal(x: Any, dtype: np.dtype) -> Operand:
    """Return a number that is known when the kernel is written; raise `Untranslatable` for an unknown type."""
    dtype = np.dtype(dtype)
    element(dtype)
    if dtype.kind == "f":
        # The bits, as LLVM wants floats of either width: as those of a double.
        text = f"0x{struct.unpack('<Q', struct.pack('<d', float(dtype.type(x))))[0]:016X}"
    else:
        text = str(bool(x)).lower() if dtype.kind == "b" else str(int(x))
    return Operand(text, dtype, False)


def literals(x: Any) -> Value:
    """An array whose numbers are known, the same for all lanes."""
    x = np.asarray(x)
    if x.dtype == jax.dtypes.float0:
        x = np.zeros(x.shape, bool)
    if LANES in x.shape:
        raise Untranslatable("an array that is captured and has lanes")
    entries = np.empty(x.shape, object)
    for index in np.ndindex(x.shape):
        entries[index] = literal(x[index], x.dtype)
    return entries


def without_lanes(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape that an array has in a kernel."""
    if shape.count(LANES) > 1:
        raise Untranslatable("an array with lanes along two axes")
    return tuple(1 if length == LANES else length for length in shape)


def varies(aval: Any) -> bool:
    """Whether an array has an axis of lanes."""
    return LANES in aval.shape


def dtype_of(aval: Any) -> np.dtype:
    """Return numpy's type of an array's numbers. Tangents of integers (float0) are booleans here.

    **Raises:** `Untranslatable` for types that numpy does not have, such as keys of random numbers.
    """
    if not isinstance(aval.dtype, np.dtype):
        raise Untranslatable(f"numbers of type {aval.dtype}")
    return BOOL if aval.dtype == jax.dtypes.float0 else aval.dtype
