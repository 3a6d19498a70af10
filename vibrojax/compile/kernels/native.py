"""Kernels: functions of lanes that jax traces and LLVM compiles to native code, each once per process."""

import ctypes
import threading
from collections import defaultdict
from collections.abc import Callable, Hashable
from functools import cache
from hashlib import sha256
from itertools import count
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import llvmlite
import llvmlite.binding as llvm
import numpy as np

from vibrojax.compile.kernels import cache as store
from vibrojax.compile.kernels.assembly import LANES, Untranslatable, dtype_of, refuse_if, varies
from vibrojax.compile.kernels.translation import kernel_text

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

    The attribute `key` is the hash of the kernel's IR text, the processor and the version of llvmlite.

    **Raises:** `Untranslatable` if the function has a construct that no kernel can express.
    """

    def __init__(self, function: Callable[..., Any], *examples: Any, registers: int = 1) -> None:
        traced = trace(function, *examples)
        inner = traced.jaxpr.jaxpr
        self._arguments = [(dtype_of(var.aval), varies(var.aval)) for var in inner.invars]
        self._results = [(dtype_of(var.aval), var.aval.shape, varies(var.aval)) for var in inner.outvars]
        refuse_if(not any(varying for _, varying in self._arguments), "no argument has lanes")
        self._tree = jax.tree.structure(traced.out_info)
        widest = max((dtype.itemsize for dtype, _ in self._arguments if dtype.kind == "f"), default=8)
        self.width = registers * vector_bytes() // widest
        text, self._workspace, self._alignment = kernel_text(traced.jaxpr, self.width)
        parts = (llvmlite.__version__, *processor(), *PASSES, *REFERENCES.values(), text)
        self.key = sha256("\n".join(parts).encode()).hexdigest()
        code = store.read(self.key)
        if code is None:
            code = _object_code(text)
            store.write(self.key, code)
        builder = llvm.JITLibraryBuilder().add_object_img(code).export_symbol("lanes").add_current_process()
        self._library = builder.link(_jit(), f"kernel {next(_number)}")  # keeps the code in memory
        kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)  # releases the interpreter lock
        self._lanes = kind(self._library["lanes"])

    def __call__(self, *arguments: Any) -> Any:
        """Return the function's results as numpy arrays. The interpreter lock is released during the computation."""
        leaves = jax.tree.leaves(arguments)
        lanes = next(np.shape(x)[-1] for x, (_, varying) in zip(leaves, self._arguments, strict=True) if varying)
        padded = -(-lanes // self.width) * self.width
        arrays = []
        for leaf, (dtype, varying) in zip(leaves, self._arguments, strict=True):
            x = np.asarray(leaf, dtype)
            if varying and lanes != padded:
                x = np.concatenate([x, np.repeat(x[..., -1:], padded - lanes, axis=-1)], axis=-1)  # repeats a lane
            arrays.append(np.ascontiguousarray(x))
        shapes = [(*shape[:-1], padded) if varying else shape for _, shape, varying in self._results]
        results = [np.empty(shape, dtype) for shape, (dtype, *_) in zip(shapes, self._results, strict=True)]
        workspace = np.empty(self._workspace + self._alignment, np.uint8)
        pointers = np.array([x.ctypes.data for x in (*arrays, *results)], np.uintp)
        aligned = -(-workspace.ctypes.data // self._alignment) * self._alignment
        self._lanes(pointers.ctypes.data, aligned, padded)
        cut = [x[..., :lanes] if varying else x for x, (*_, varying) in zip(results, self._results, strict=True)]
        return jax.tree.unflatten(self._tree, cut)


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


def kernel_for(
    function: Callable[..., Any], static: tuple[Hashable, ...], *examples: Any, registers: int = 1
) -> Kernel:
    """Return the kernel of `function(*static, *arguments)`, which is compiled at the first call; see `Kernel`."""
    leaves, tree = jax.tree.flatten(examples)
    dtypes = (x.dtype if hasattr(x, "dtype") else np.result_type(x) for x in leaves)
    types = ((dtype, np.shape(x)[:-1], np.ndim(x)) for dtype, x in zip(dtypes, leaves, strict=True))
    key = (function, static, jnp.result_type(float), vector_bytes(), tree, *types)
    with _lock:
        lock = _locks[key]
    with lock:
        if key not in kernels:
            kernels[key] = Kernel(lambda *dynamic: function(*static, *dynamic), *examples, registers=registers)
    return kernels[key]
