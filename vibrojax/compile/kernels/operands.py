"""Operands of instructions: registers, literals and places in memory. Arrays of them stand for jax's arrays."""

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

BOOL = np.dtype(bool)

LANES = 1009
"""Length of the axis of lanes while a function is traced: a prime, so that no other axis is taken for it.
A kernel does not have this axis: each entry of an array stands for the lanes of a vector."""

LLVM_TYPES = {
    "float64": "double",
    "float32": "float",
    **{f"{sign}int{bits}": f"i{bits}" for bits in (64, 32, 16, 8) for sign in ("", "u")},
    "bool": "i1",
}
"""LLVM's name of each type of numbers."""


class Untranslatable(Exception):
    """A construct that no kernel can express, named in the message."""


class Operand(NamedTuple):
    """A register or a literal. It is a vector with one element per lane if `varying`, else the same for all lanes."""

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
    """A value in memory, which is read where it is used.

    - `pointer`: its register; empty for a placeholder, which cannot be read.
    - `offset`: position in the workspace [bytes], None for other memory.
    """

    pointer: str
    dtype: np.dtype
    varying: bool
    offset: int | None = None


Entry = Operand | Slot

Value = np.ndarray[Any, np.dtype[np.object_]]
"""A jax array in a kernel: a numpy array of entries, whose axis of lanes has the length 1."""


def build(shape: tuple[int, ...], entry: Callable[[tuple[int, ...]], Entry]) -> Value:
    """Return an array with `entry(index)` at each index, called in row-major order."""
    array = np.empty(shape, object)
    for index in np.ndindex(array.shape):
        array[index] = entry(index)
    return array


def element(dtype: np.dtype) -> str:
    """Return LLVM's name of a type of numbers; raise `Untranslatable` if a kernel does not support it."""
    try:
        return LLVM_TYPES[np.dtype(dtype).name]
    except KeyError:
        raise Untranslatable(f"numbers of type {dtype}") from None


def literal(x: Any, dtype: np.dtype) -> Operand:
    """Return a number that is known when the kernel is written; raise `Untranslatable` for an unsupported type."""
    dtype = np.dtype(dtype)
    element(dtype)
    if dtype.kind == "f":
        # LLVM takes the bits of a double for floats of either width.
        text = f"0x{struct.unpack('<Q', struct.pack('<d', float(dtype.type(x))))[0]:016X}"
    else:
        text = str(bool(x)).lower() if dtype.kind == "b" else str(int(x))
    return Operand(text, dtype, False)


def literals(x: Any) -> Value:
    """Return the entries of an array of known numbers, which are the same for all lanes."""
    x = np.asarray(x)
    if x.dtype == jax.dtypes.float0:
        x = np.zeros(x.shape, bool)
    if LANES in x.shape:
        raise Untranslatable("an array that is captured and has lanes")
    return build(x.shape, lambda index: literal(x[index], x.dtype))


def without_lanes(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape that an array has in a kernel."""
    if shape.count(LANES) > 1:
        raise Untranslatable("an array with lanes along two axes")
    return tuple(1 if length == LANES else length for length in shape)


def varies(aval: Any) -> bool:
    """Return whether an array has an axis of lanes."""
    return LANES in aval.shape


def dtype_of(aval: Any) -> np.dtype:
    """Return numpy's type of an array's numbers. Tangents of integers (float0) are booleans in a kernel.

    **Raises:** `Untranslatable` for types that numpy does not have, such as keys of random numbers.
    """
    if not isinstance(aval.dtype, np.dtype):
        raise Untranslatable(f"numbers of type {aval.dtype}")
    return BOOL if aval.dtype == jax.dtypes.float0 else aval.dtype
