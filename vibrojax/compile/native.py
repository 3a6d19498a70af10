"""Kernels: functions of lanes that jax traces and LLVM compiles to native code, each once per process.

The disk cache holds the object code of each kernel, under the hash of its IR text, and its description, under a digest
of what decides the trace (`identity.py`). A process that finds the description neither traces nor translates.
"""

import ctypes
import gc
import pickle
import threading
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
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
from vibrojax.compile.identity import digest
from vibrojax.compile.translation import KernelText, kernel_text
from vibrojax.compile.trees import flatten, unflatten
from vibrojax.compile.xla import float_type
from vibrojax.lazy import jax, jnp

PASSES = ("sroa", "aggressive_dce")
"""LLVM's optimization passes before instruction selection. With all other passes as well, compilation takes ten times
as long and a time step is no faster, because jax's equations are plain arithmetic already."""

CODE_LEVEL = 2
"""LLVM's level of code generation, 0 to 3. At level 0, at which most tests run, compilation takes a third of the time;
the code has the same arithmetic, and twice as many instructions."""

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
    cpu, features = processor().name, processor().features
    return target.create_target_machine(cpu=cpu, features=features, opt=CODE_LEVEL, **REFERENCES)


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


class Array(NamedTuple):
    """Type of an argument or result: `shape` without the lanes, if it `varies` between lanes."""

    dtype: np.dtype
    shape: tuple[int, ...]
    varies: bool

    @classmethod
    def of(cls, aval: Any) -> "Array":
        return cls(dtype_of(aval), aval.shape[:-1] if varies(aval) else aval.shape, varies(aval))


class Description(NamedTuple):
    """Data that a call of a kernel needs besides the object code.

    - `key`: hash of the IR text, the processor and the version of llvmlite, under which the object code is cached.
    - `arguments`, `results`: types of the leaves; `tree`: the results, with their numbers as leaves.
    - `width`: number of lanes of a group; `text`: memory of the workspace, and the IR text if the kernel was traced.
    """

    key: str
    arguments: tuple[Array, ...]
    results: tuple[Array, ...]
    tree: Any
    width: int
    text: KernelText


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

    Attributes: `description`; `key`, the hash of the text; `code`, the native function.

    **Raises:** `Untranslatable` if the function has a construct that no kernel can express.
    """

    def __init__(self, function: Callable[..., Any], *examples: Any, registers: int = 1) -> None:
        description = _described(function, *examples, registers=registers)
        code = store.read(description.key)
        if code is None:
            code = _object_code(description.text.text)
            store.write(description.key, code)
        self._load(description, code)

    @classmethod
    def found(cls, name: str) -> "Kernel | None":
        """Return the kernel whose description is cached under this name, or None."""
        with suppress(pickle.UnpicklingError, AttributeError, ImportError):
            content = store.read(name)
            if content is not None:
                description: Description = pickle.loads(content)
                code = store.read(description.key)
                if code is not None:
                    kernel = cls.__new__(cls)
                    kernel._load(description, code)
                    return kernel
        return None

    def enter(self, name: str) -> None:
        """Cache the description under this name, unless the results have types that other processes cannot import."""
        text = self.description.text._replace(text="")
        with suppress(pickle.PicklingError, AttributeError, TypeError):
            store.write(name, pickle.dumps(self.description._replace(text=text)))

    def _load(self, description: Description, code: bytes) -> None:
        self.description, self.key = description, description.key
        _, self._tree = flatten(description.tree)
        builder = llvm.JITLibraryBuilder().add_object_img(code).export_symbol("lanes").add_current_process()
        self._library = builder.link(_jit(), f"kernel {next(_number)}")  # keeps the code in memory
        kinds = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
        self.code = ctypes.CFUNCTYPE(None, *kinds)(self._library["lanes"])  # a call releases the interpreter lock

    def __call__(self, *arguments: Any) -> Any:
        """Return the function's results as numpy arrays. The interpreter lock is released during the computation."""
        return self.bind(*arguments).whole()

    def bind(self, *arguments: Any) -> "BoundKernel":
        """Return the kernel bound to arguments, to compute some lanes at a time."""
        leaves, kinds = flatten(arguments)[0], self.description.arguments
        arrays = [
            np.ascontiguousarray(leaf, kind.dtype) if kind.varies else np.asarray(leaf, kind.dtype)
            for leaf, kind in zip(leaves, kinds, strict=True)
        ]
        lengths = {x.shape[-1] for x, kind in zip(arrays, kinds, strict=True) if kind.varies}
        shapes = [(x.ndim, x.shape[:-1]) for x in arrays]
        expected = [(len(kind.shape) + kind.varies, kind.shape) for kind in kinds]
        if len(lengths) != 1 or shapes != expected:
            raise ValueError(f"arrays of {sorted(lengths)} lanes and shapes {shapes}, not {expected}")
        [lanes] = lengths
        results = [
            np.empty((*kind.shape, lanes) if kind.varies else kind.shape, kind.dtype)
            for kind in self.description.results
        ]
        return BoundKernel(self, lanes, [*arrays, *results], unflatten(self._tree, results))


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
        kernel, width, text = self._kernel, self._kernel.description.width, self._kernel.description.text
        index = np.concatenate([lanes, np.full(-len(lanes) % width, lanes[-1])]).astype(np.int64, copy=False)
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


def _described(function: Callable[..., Any], *examples: Any, registers: int) -> Description:
    """Trace a function and translate the trace."""
    traced = trace(function, *examples)
    inner = traced.jaxpr.jaxpr
    arguments, results = (tuple(Array.of(var.aval) for var in variables) for variables in (inner.invars, inner.outvars))
    refuse_if(not any(kind.varies for kind in arguments), "no argument has lanes")
    structure: Any = jax.tree.structure(traced.out_info)
    widest = max((kind.dtype.itemsize for kind in arguments if kind.dtype.kind == "f"), default=8)
    width = registers * vector_bytes() // widest
    text = kernel_text(traced.jaxpr, width)
    key = sha256("\n".join((*_compiler(), text.text)).encode()).hexdigest()
    tree = jax.tree.unflatten(structure, range(structure.num_leaves))
    return Description(key, arguments, results, tree, width, text)


def _compiler() -> tuple[str, ...]:
    """Return what decides about the object code of a text."""
    return llvmlite.__version__, *processor(), *PASSES, str(CODE_LEVEL), *REFERENCES.values()


def trace(function: Callable[..., Any], *examples: Any) -> Any:
    """Trace a function of lanes with jax, for `LANES` lanes. jax caches the trace of a function."""

    def with_lanes(x: Any) -> jax.ShapeDtypeStruct:
        shape = np.shape(x) if not hasattr(x, "shape") else x.shape
        return jax.ShapeDtypeStruct((*shape[:-1], LANES) if shape else (), jnp.result_type(x))

    return jax.jit(function).trace(*jax.tree.map(with_lanes, examples))


kernels: dict[Hashable, Kernel | str] = {}
"""All kernels of this process, and the constructs for which others cannot be made."""

# A thread may come here twice: where jax imports a script of the user's that has the name of a standard module.
_locks: "defaultdict[Hashable, threading.RLock]" = defaultdict(threading.RLock)
_lock = threading.Lock()


def types_of(leaves: list[Any]) -> list[Hashable]:
    """Return number type and shape without lanes of each array. Kernels differ for arguments that differ in these."""
    arrays = (x if hasattr(x, "dtype") else np.asarray(x) for x in leaves)
    return [(x.dtype, x.ndim, x.shape[:-1]) for x in arrays]


def kernel_for(
    function: Callable[..., Any], static: tuple[Hashable, ...], *examples: Any, registers: int = 1
) -> Kernel:
    """Return the kernel of `function(*static, *arguments)`, which is compiled at the first call; see `Kernel`.

    **Raises:** `Untranslatable` if no kernel can be made.
    """
    leaves, tree = flatten(examples)
    key = (function, static, float_type(), vector_bytes(), tree, *types_of(leaves))
    with _lock:
        lock = _locks[key]
    with lock:
        if key not in kernels:
            types = unflatten(tree, [str(kind) for kind in types_of(leaves)])
            settings = registers, vector_bytes(), float_type().name, _compiler()
            name = digest(function, static, types, settings)
            kernel = None if name is None else Kernel.found(name)
            if kernel is None:
                try:
                    with _uncollected():
                        kernel = Kernel(lambda *dynamic: function(*static, *dynamic), *examples, registers=registers)
                except Untranslatable as error:
                    kernels[key] = str(error)  # no later call traces the function again
                    raise
                if name is not None:
                    kernel.enter(name)
            kernels[key] = kernel
        known = kernels[key]
    if isinstance(known, str):
        raise Untranslatable(known)
    return known


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
