"""Compilation of a kernel's LLVM IR to a native function with llvmlite."""

import ctypes
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from typing import NamedTuple

import llvmlite
import llvmlite.binding as llvm

from vibrojax.compile.kernels import cache as store
from vibrojax.compile.kernels.operands import Untranslatable

Function = Callable[[int, int, int], None]
"""`lanes(arrays, workspace, count)`, which releases the interpreter lock."""

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


class Native(NamedTuple):
    """A native function, the object that keeps its code in memory, and the code's `key` in the disk cache."""

    function: Function
    library: object
    key: str


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


def compile_text(text: str, name: str) -> Native:
    """Return the native function of a kernel's IR text, from the disk cache if it is there.

    `name` must be unique in the process.
    """
    parts = (llvmlite.__version__, *processor(), *PASSES, *REFERENCES.values(), text)
    key = sha256("\n".join(parts).encode()).hexdigest()
    code = store.read(key)
    if code is None:
        code = _object_code(text)
        store.write(key, code)
    builder = llvm.JITLibraryBuilder().add_object_img(code).export_symbol("lanes").add_current_process()
    library = builder.link(_jit(), name)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
    return Native(kind(library["lanes"]), library, key)


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
