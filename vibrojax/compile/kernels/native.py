"""From the text of a kernel to a function of the machine, by LLVM (llvmlite)."""

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
"""`lanes(arrays, workspace, count)`; it lets other threads run."""

PASSES = ("sroa", "aggressive_dce")
"""What LLVM is to do before it chooses instructions. All the rest was tried: it takes ten times as long, and a step as
long as before, because jax's equations are plain arithmetic already."""


REFERENCES = {"codemodel": "large", "reloc": "static"}
"""How code refers to its constants and to functions outside: by whole addresses. The parts of an object file are put
wherever there is room, which may be farther apart than shorter references reach (LLVM then ends the process). It costs
nothing that could be measured."""


class Processor(NamedTuple):
    """What code is made for."""

    triple: str
    name: str
    features: str


class Native(NamedTuple):
    """A function, what keeps its code in memory, and the `key` of its code in the cache."""

    function: Function
    library: object
    key: str


@cache
def processor() -> Processor:
    """This computer's."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    return Processor(llvm.get_process_triple(), llvm.get_host_cpu_name(), features)


@cache
def vector_bytes() -> int:
    """Return the width of the widest registers. Tests force others: kernels of every width are right."""
    features = processor().features.split(",")
    return 64 if "+avx512f" in features else 32 if "+avx2" in features else 16


def native(text: str, name: str) -> Native:
    """The machine's function for the text of a kernel, from the cache if it was made before; `name` has no other."""
    made_of = (llvmlite.__version__, *processor(), *PASSES, *REFERENCES.values(), text)
    key = sha256("\n".join(made_of).encode()).hexdigest()
    code = store.read(key)
    if code is None:
        code = _compiled(text)
        store.write(key, code)
    return _loaded(code, name, key)


def _machine() -> llvm.TargetMachine:
    target = llvm.Target.from_triple(processor().triple)
    return target.create_target_machine(cpu=processor().name, features=processor().features, opt=2, **REFERENCES)


def _compiled(text: str) -> bytes:
    """Return the object code of a kernel; raise `Untranslatable` if LLVM refuses its text."""
    try:
        module, machine = llvm.parse_assembly(text), _machine()
    except RuntimeError as error:
        raise Untranslatable(f"a text that LLVM refuses: {str(error).strip()}") from error
    passes = llvm.create_new_module_pass_manager()
    for name in PASSES:
        getattr(passes, f"add_{name}_pass")()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2)))
    return bytes(machine.emit_object(module))


def _loaded(code: bytes, name: str, key: str) -> Native:
    jit = _jit()
    builder = llvm.JITLibraryBuilder().add_object_img(code).export_symbol("lanes").add_current_process()
    library = builder.link(jit, name)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
    return Native(kind(library["lanes"]), library, key)


@cache
def _jit() -> llvm.LLJIT:
    return llvm.create_lljit_compiler(_machine())
