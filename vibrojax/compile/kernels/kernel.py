"""A function of lanes as one function of the machine: traced once by jax, translated, and compiled by LLVM."""

from collections.abc import Callable
from itertools import count
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.compile.kernels import native
from vibrojax.compile.kernels.operands import LANES, Untranslatable, dtype_of, varies
from vibrojax.compile.kernels.translation import kernel_text

_number = count()


class Kernel:
    """A jax function of arrays whose last axis is the lanes', as one function of the machine.

    Lanes go through in groups of `width`: as many as fill `registers` of the processor's registers. Only loops and
    branches, which a group takes together, know of other lanes: where a turn of a loop leaves a lane that is done as it
    is, each lane's result depends on that lane alone, to the last bit.

    **Arguments:**

    - `function`: takes and returns any pytrees. It is traced in the precision that is set.
    - `examples`: its arguments, or their like (`jax.ShapeDtypeStruct`): arrays without axes are one for all lanes, of
      others the last axis is the lanes', of any length.
    - `registers`: how many each value of a group fills.

    **Raises:** `Untranslatable`, where the function does what no kernel can do.
    """

    def __init__(self, function: Callable[..., Any], *examples: Any, registers: int = 1) -> None:
        traced = trace(function, *examples)
        inner = traced.jaxpr.jaxpr
        self._given = [(dtype_of(var.aval), varies(var.aval)) for var in inner.invars]
        self._found = [(dtype_of(var.aval), var.aval.shape, varies(var.aval)) for var in inner.outvars]
        if not any(varying for _, varying in self._given):
            raise Untranslatable("no argument has lanes")
        self._tree = jax.tree.structure(traced.out_info)
        widest = max((dtype.itemsize for dtype, _ in self._given if dtype.kind == "f"), default=8)
        self.width = registers * native.vector_bytes() // widest
        text, self._workspace, self._alignment = kernel_text(traced.jaxpr, self.width)
        self._native = native.native(text, f"kernel {next(_number)}")

    @property
    def key(self) -> str:
        """Digest of the kernel's text, the processor and the version of llvmlite."""
        return self._native.key

    def __call__(self, *arguments: Any) -> Any:
        """The function's results, as numpy arrays. Other threads run meanwhile."""
        leaves = jax.tree.leaves(arguments)
        lanes = next(np.shape(x)[-1] for x, (_, varying) in zip(leaves, self._given, strict=True) if varying)
        padded = -(-lanes // self.width) * self.width
        given = [
            self._prepared(x, dtype, varying, padded) for x, (dtype, varying) in zip(leaves, self._given, strict=True)
        ]
        found = [np.empty((*shape[:-1], padded) if varying else shape, dtype) for dtype, shape, varying in self._found]
        workspace = np.empty(self._workspace + self._alignment, np.uint8)
        pointers = np.array([x.ctypes.data for x in (*given, *found)], np.uintp)
        aligned = -(-workspace.ctypes.data // self._alignment) * self._alignment
        self._native.function(pointers.ctypes.data, aligned, padded)
        cut = [x[..., :lanes] if varying else x for x, (*_, varying) in zip(found, self._found, strict=True)]
        return jax.tree.unflatten(self._tree, cut)

    def _prepared(self, x: Any, dtype: np.dtype, varying: bool, padded: int) -> np.ndarray:
        """An argument as the kernel reads it; where the last group is not full its last lane is there again."""
        x = np.asarray(x, dtype)
        if varying and x.shape[-1] != padded:
            x = np.concatenate([x, np.repeat(x[..., -1:], padded - x.shape[-1], axis=-1)], axis=-1)
        return np.ascontiguousarray(x)


def trace(function: Callable[..., Any], *examples: Any) -> Any:
    """Trace a function of lanes by jax, with `LANES` lanes; a second trace of the same function costs nothing."""
    return jax.jit(function).trace(*jax.tree.map(_with_lanes, examples))


def _with_lanes(x: Any) -> jax.ShapeDtypeStruct:
    shape = np.shape(x) if not hasattr(x, "shape") else x.shape
    return jax.ShapeDtypeStruct((*shape[:-1], LANES) if shape else (), jnp.result_type(x))
