"""The processor's treatment of subnormal numbers: XLA treats them as 0, kernels keep them."""

import ctypes
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

import llvmlite.binding as llvm

from vibrojax.compile import native

IS_X86 = platform.machine() in ("x86_64", "AMD64")

SUBNORMALS_ARE_ZERO = 0x8040
"""Flags for results and operands: bits 15 and 6 of MXCSR (Intel SDM, volume 1, section 10.2.3)."""

SWAP = """
define i32 @swap(i32 %bits) {
  %place = alloca i32
  call void @llvm.x86.sse.stmxcsr(ptr %place)
  %before = load i32, ptr %place
  store i32 %bits, ptr %place
  call void @llvm.x86.sse.ldmxcsr(ptr %place)
  ret i32 %before
}
declare void @llvm.x86.sse.stmxcsr(ptr)
declare void @llvm.x86.sse.ldmxcsr(ptr)
"""


@cache
def _swap() -> tuple[Callable[[int], int], object]:
    """Return the function that sets MXCSR and returns its old value, and the object that holds the function's code."""
    library = llvm.JITLibraryBuilder().add_ir(SWAP).export_symbol("swap").link(native._jit(), "mxcsr")
    return ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint32)(library["swap"]), library


@contextmanager
def as_xla() -> Iterator[None]:
    """Treat subnormal numbers as 0 in this thread, on processors that can."""
    if not IS_X86:
        yield
        return
    swap, _ = _swap()
    before = swap(0x1F80 | SUBNORMALS_ARE_ZERO)
    try:
        yield
    finally:
        swap(before)
