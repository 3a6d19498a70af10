"""Kernels: functions of lanes that jax traces and LLVM compiles to native code, each once per process."""

import ctypes
import gc
import threading
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from itertools import count
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding as llvm
import numpy as np
from jaxtyping import Int

from vibrojax.compile import cache as store
from vibrojax.compile.assembly import LANES, Untranslatable, dtype_of, refuse_if, varies
from vibrojax.compile.translation import kernel_text
from vibrojax.lazy import jax, jnp

PASSES = ("sroa", "aggressive_dce")
"""LLVM's optimization passes before instruction selection. With all other passes as well, compilation takes ten times
as long and a time step is no faster, because jax's equations are plain arithmetic already."""

REFERENCES = {"codemodel": "large", "reloc": "static"}
"""Code refers to its constants and to external functions by 64-bit addresses. The sections of an object file may be
loaded farther apart than shorter references can reach, in which case LLVM aborts the process. The cost of full
addresses is too small to measure."""


class Processor(NamedTuple):
    """The processor for which code is compiled."""

    triple: str
    name: str
    features: str


@cache
def processor() -> Processor:
    """Return the processor of this computer."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    return Processor(llvm.get_process_triple(), llvm.get_host_cpu_name(), features)


@cache
def vector_bytes() -> int:
    """Return the width of the widest vector registers [bytes].

    Tests replace this function, because kernels must be correct for every width.
    """
    features = processor().features.split(",")
    return 64 if "+avx512f" in features else 32 if "+avx2" in features else 16


def _machine() -> llvm.TargetMachine:
    target = llvm.Target.from_triple(processor().triple)
    return target.create_target_machine(cpu=processor().name, features=processor().features, opt=2, **REFERENCES)


def _object_code(text: str) -> bytes:
    """Return the object code of a kernel, or raise `Untranslatable` if LLVM rejects its IR text."""
    try:
        module, machine = llvm.parse_assembly(text), _machine()
    except RuntimeError as error:
        raise Untranslatable(f"a text that LLVM refuses: {str(error).strip()}") from error
    passes = llvm.create_new_module_pass_manager()
    for name in PASSES:
        getattr(passes, f"add_{name}_pass")()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2)))
    return bytes(machine.emit_object(module))


@cache
def _jit() -> llvm.LLJIT:
    return llvm.create_lljit_compiler(_machine())


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

    Attributes: `key`, the hash of the kernel's IR text, the processor and the version of llvmlite; `text`, this text
    and the size of the workspace; `code`, the native function.

    **Raises:** `Untranslatable` if the function has a construct that no kernel can express.
    """

    def __init__(self, function: Callable[..., Any], *examples: Any, registers: int = 1) -> None:
        traced = trace(function, *examples)
        inner = traced.jaxpr.jaxpr
        self._arguments = [(dtype_of(var.aval), varies(var.aval)) for var in inner.invars]
        self._shapes = [(len(var.aval.shape), var.aval.shape[:-1]) for var in inner.invars]
        self._results = [(dtype_of(var.aval), var.aval.shape, varies(var.aval)) for var in inner.outvars]
        refuse_if(not any(varying for _, varying in self._arguments), "no argument has lanes")
        self._tree = jax.tree.structure(traced.out_info)
        widest = max((dtype.itemsize for dtype, _ in self._arguments if dtype.kind == "f"), default=8)
        self.width = registers * vector_bytes() // widest
        self.text = kernel_text(traced.jaxpr, self.width)
        parts = (llvmlite.__version__, *processor(), *PASSES, *REFERENCES.values(), self.text.text)
        self.key = sha256("\n".join(parts).encode()).hexdigest()
        code = store.read(self.key)
        if code is None:
            code = _object_code(self.text.text)
            store.write(self.key, code)
        builder = llvm.JITLibraryBuilder().add_object_img(code).export_symbol("lanes").add_current_process()
        self._library = builder.link(_jit(), f"kernel {next(_number)}")  # keeps the code in memory
        kinds = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
        self.code = ctypes.CFUNCTYPE(None, *kinds)(self._library["lanes"])  # a call releases the interpreter lock

    def __call__(self, *arguments: Any) -> Any:
        """Return the function's results as numpy arrays. The interpreter lock is released during the computation."""
        return self.bind(*arguments).whole()

    def bind(self, *arguments: Any) -> "BoundKernel":
        """Return the kernel bound to arguments, to compute some lanes at a time."""
        return self.bind_leaves(jax.tree.leaves(arguments))

    def bind_leaves(self, leaves: list[Any]) -> "BoundKernel":
        """Return the kernel bound to the leaves of arguments; see `bind`."""
        arrays = [
            np.ascontiguousarray(leaf, dtype) if varying else np.asarray(leaf, dtype)
            for leaf, (dtype, varying) in zip(leaves, self._arguments, strict=True)
        ]
        lengths = {x.shape[-1] for x, (_, varying) in zip(arrays, self._arguments, strict=True) if varying}
        shapes = [(x.ndim, x.shape[:-1]) for x in arrays]
        if len(lengths) != 1 or shapes != self._shapes:
            raise ValueError(f"arrays of {sorted(lengths)} lanes and shapes {shapes}, not {self._shapes}")
        [lanes] = lengths
        results = [
            np.empty((*shape[:-1], lanes) if varying else shape, dtype) for dtype, shape, varying in self._results
        ]
        return BoundKernel(self, lanes, [*arrays, *results], jax.tree.unflatten(self._tree, results))


class BoundKernel:
    """A kernel bound to arguments with `lanes` lanes. A call computes some lanes; threads may compute different lanes.

    `results`: pytree of the results, which hold the lanes computed so far.
    """

    def __init__(self, kernel: Kernel, lanes: int, arrays: list[np.ndarray], results: Any) -> None:
        self._kernel, self._arrays = kernel, arrays  # kept because code and memory are used by address
        self._pointers = np.array([_address(x) for x in arrays], np.uintp)
        self.lanes, self.results = lanes, results

    def whole(self) -> Any:
        """Compute all lanes and return the results."""
        self(np.arange(self.lanes))
        return self.results

    def __call__(self, lanes: Int[np.ndarray, " _"]) -> None:
        """Compute the lanes with these indices. The interpreter lock is released meanwhile.

        **Raises:** `IndexError`, before anything is computed, if an index is not that of a lane.
        """
        lanes = np.asarray(lanes)
        if lanes.ndim != 1 or lanes.dtype.kind not in "iu":
            raise IndexError(f"lanes: an array of {lanes.dtype} with {lanes.ndim} axes, not of integers with one")
        if not len(lanes):
            return
        if lanes.min() < 0 or lanes.max() >= self.lanes:
            raise IndexError(f"lanes {lanes.min()} to {lanes.max()} of arrays with {self.lanes} lanes")
        # The last group is filled with copies of a lane, whose results are equal.
        kernel, text = self._kernel, self._kernel.text
        index = np.concatenate([lanes, np.full(-len(lanes) % kernel.width, lanes[-1])]).astype(np.int64, copy=False)
        start = _workspace(text.fixed + text.per_lane * len(index), text.alignment)
        kernel.code(self._pointers.ctypes.data, start, index.ctypes.data, len(index), self.lanes)


def _address(x: Any) -> int:
    """Return the address of an array's memory. For most arrays, this takes a third of the time of `x.ctypes.data`."""
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(x))
    except (TypeError, ValueError):  # read-only, or empty
        return int(x.ctypes.data)


_thread = threading.local()


def _workspace(size: int, alignment: int) -> int:
    """Return the address of this thread's workspace, which grows as required and is kept for the next call."""
    memory = getattr(_thread, "workspace", None)
    if memory is None or len(memory) < size + alignment:
        memory = _thread.workspace = np.empty(size + alignment, np.uint8)
    return -(-int(memory.ctypes.data) // alignment) * alignment


def trace(function: Callable[..., Any], *examples: Any) -> Any:
    """Trace a function of lanes with jax, for `LANES` lanes. jax caches the trace of a function."""

    def with_lanes(x: Any) -> jax.ShapeDtypeStruct:
        shape = np.shape(x) if not hasattr(x, "shape") else x.shape
        return jax.ShapeDtypeStruct((*shape[:-1], LANES) if shape else (), jnp.result_type(x))

    return jax.jit(function).trace(*jax.tree.map(with_lanes, examples))


kernels: dict[Hashable, Kernel] = {}
"""All kernels of this process."""

_locks: defaultdict[Hashable, threading.Lock] = defaultdict(threading.Lock)
_lock = threading.Lock()


def types_of(leaves: list[Any]) -> list[Hashable]:
    """Return number type and shape without lanes of each array. Kernels differ for arguments that differ in these."""
    arrays = (x if hasattr(x, "dtype") else np.asarray(x) for x in leaves)
    return [(x.dtype, x.ndim, x.shape[:-1]) for x in arrays]


def kernel_for(
    function: Callable[..., Any], static: tuple[Hashable, ...], *examples: Any, registers: int = 1
) -> Kernel:
    """Return the kernel of `function(*static, *arguments)`, which is compiled at the first call; see `Kernel`."""
    leaves, tree = jax.tree.flatten(examples)
    key = (function, static, jnp.result_type(float), vector_bytes(), tree, *types_of(leaves))
    with _lock:
        lock = _locks[key]
    with lock:
        if key not in kernels:
            with _uncollected():
                kernels[key] = Kernel(lambda *dynamic: function(*static, *dynamic), *examples, registers=registers)
    return kernels[key]


@contextmanager
def _uncollected() -> Iterator[None]:
    """Pause Python's garbage collector, which finds next to nothing in a trace but takes a sixth of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
