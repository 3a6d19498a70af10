"""Operands of instructions: registers, literals and slots in memory. A jax array becomes a numpy array of operands."""

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

BOOL = np.dtype(bool)

LANES = 1009
"""Length of the lane axis while a function is traced: a large prime, so that no other axis is mistaken for the lane
axis. A kernel has no lane axis: each array element represents one value in all lanes of a group."""

LLVM_TYPES = {
    "float64": "double",
    "float32": "float",
    **{f"{sign}int{bits}": f"i{bits}" for bits in (64, 32, 16, 8) for sign in ("", "u")},
    "bool": "i1",
}
"""LLVM's name of each number type."""


class Untranslatable(Exception):
    """No kernel can express a function. The message names the unsupported construct."""


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
    - `offset`: position in the workspace [bytes]; None for other memory.
    """

    pointer: str
    dtype: np.dtype
    varying: bool
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


def element(dtype: np.dtype) -> str:
    """Return LLVM's name of a number type; raise `Untranslatable` if kernels do not support the type."""
    try:
        return LLVM_TYPES[np.dtype(dtype).name]
    except KeyError:
        raise Untranslatable(f"numbers of type {dtype}") from None


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
    if LANES in x.shape:
        raise Untranslatable("an array that is captured and has lanes")
    return build(x.shape, lambda index: literal(x[index], x.dtype))


def without_lanes(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of an array in a kernel, in which the lane axis has length 1."""
    if shape.count(LANES) > 1:
        raise Untranslatable("an array with lanes along two axes")
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
