"""Kernels: functions of lanes that jax traces and LLVM compiles, each once per process."""

import threading
from collections.abc import Callable, Hashable
from itertools import count
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.compile.kernels import native
from vibrojax.compile.kernels.operands import LANES, Untranslatable, dtype_of, varies
from vibrojax.compile.kernels.translation import kernel_text

_number = count()


class Kernel:
    """A jax function of arrays whose last axis is the lane axis, compiled as one native function.

    Lanes are processed in groups of `width`, the number that fills `registers` vector registers of the processor. The
    lanes of a group share only loops and branches. If the iterations of a loop leave finished lanes unchanged, each
    lane's result depends on that lane alone, to the last bit.

    **Arguments:**

    - `function`: function of pytrees that returns a pytree. It is traced in jax's current precision.
    - `examples`: example arguments, or `jax.ShapeDtypeStruct` with their types. Scalars are the same for all lanes. The
      last axis of arrays is the lane axis, which may have any length.
    - `registers`: number of vector registers that hold one value of a group.

    **Raises:** `Untranslatable` if the function has a construct that no kernel can express.
    """

    def __init__(self, function: Callable[..., Any], *examples: Any, registers: int = 1) -> None:
        traced = trace(function, *examples)
        inner = traced.jaxpr.jaxpr
        self._arguments = [(dtype_of(var.aval), varies(var.aval)) for var in inner.invars]
        self._results = [(dtype_of(var.aval), var.aval.shape, varies(var.aval)) for var in inner.outvars]
        if not any(varying for _, varying in self._arguments):
            raise Untranslatable("no argument has lanes")
        self._tree = jax.tree.structure(traced.out_info)
        widest = max((dtype.itemsize for dtype, _ in self._arguments if dtype.kind == "f"), default=8)
        self.width = registers * native.vector_bytes() // widest
        text, self._workspace, self._alignment = kernel_text(traced.jaxpr, self.width)
        self._native = native.compile_text(text, f"kernel {next(_number)}")

    @property
    def key(self) -> str:
        """Hash of the kernel's IR text, the processor and the version of llvmlite."""
        return self._native.key

    def __call__(self, *arguments: Any) -> Any:
        """Return the function's results as numpy arrays. The interpreter lock is released during the computation."""
        leaves = jax.tree.leaves(arguments)
        lanes = next(np.shape(x)[-1] for x, (_, varying) in zip(leaves, self._arguments, strict=True) if varying)
        padded = -(-lanes // self.width) * self.width
        pairs = zip(leaves, self._arguments, strict=True)
        arrays = [_padded(np.asarray(x, dtype), padded if varying else None) for x, (dtype, varying) in pairs]
        shapes = [(*shape[:-1], padded) if varying else shape for _, shape, varying in self._results]
        results = [np.empty(shape, dtype) for shape, (dtype, *_) in zip(shapes, self._results, strict=True)]
        workspace = np.empty(self._workspace + self._alignment, np.uint8)
        pointers = np.array([x.ctypes.data for x in (*arrays, *results)], np.uintp)
        aligned = -(-workspace.ctypes.data // self._alignment) * self._alignment
        self._native.function(pointers.ctypes.data, aligned, padded)
        cut = [x[..., :lanes] if varying else x for x, (*_, varying) in zip(results, self._results, strict=True)]
        return jax.tree.unflatten(self._tree, cut)


def _padded(x: np.ndarray, lanes: int | None) -> np.ndarray:
    """Return a contiguous array, padded to `lanes` lanes with copies of the last lane.

    If `lanes` is None, the array has no lane axis and is not padded.
    """
    if lanes is not None and x.shape[-1] != lanes:
        x = np.concatenate([x, np.repeat(x[..., -1:], lanes - x.shape[-1], axis=-1)], axis=-1)
    return np.ascontiguousarray(x)


def trace(function: Callable[..., Any], *examples: Any) -> Any:
    """Trace a function of lanes with jax, for `LANES` lanes. jax caches the trace of a function."""

    def with_lanes(x: Any) -> jax.ShapeDtypeStruct:
        shape = np.shape(x) if not hasattr(x, "shape") else x.shape
        return jax.ShapeDtypeStruct((*shape[:-1], LANES) if shape else (), jnp.result_type(x))

    return jax.jit(function).trace(*jax.tree.map(with_lanes, examples))


class _KernelKey(NamedTuple):
    function: Callable[..., Any]
    static: tuple[Hashable, ...]
    types: tuple[Hashable, ...]


kernels: dict[_KernelKey, Kernel] = {}
"""All kernels of this process."""

_locks: dict[_KernelKey, threading.Lock] = {}
_lock = threading.Lock()


def kernel_for(
    function: Callable[..., Any], static: tuple[Hashable, ...], *examples: Any, registers: int = 1
) -> Kernel:
    """Return the kernel of `function(*static, *arguments)`, which is compiled at the first call; see `Kernel`."""
    leaves, tree = jax.tree.flatten(examples)
    dtypes = (x.dtype if hasattr(x, "dtype") else np.result_type(x) for x in leaves)
    types = ((dtype, np.shape(x)[:-1], np.ndim(x)) for dtype, x in zip(dtypes, leaves, strict=True))
    key = _KernelKey(function, static, (jnp.result_type(float), native.vector_bytes(), tree, *types))
    with _lock:
        lock = _locks.setdefault(key, threading.Lock())
    with lock:
        if key not in kernels:
            kernels[key] = Kernel(lambda *dynamic: function(*static, *dynamic), *examples, registers=registers)
    return kernels[key]
