"""Identity of a trace: a digest of everything that decides what jax would trace, without tracing.

A trace is decided by the function, its static arguments, the types of the others, and the versions of jax, numpy and
Python. The digest covers all of these:

- Objects of this package, jax and numpy are identified by their names; their code, by the versions of the libraries and
  the content of this package's files.
- All other functions and classes are identified by their bytecode, closures, defaults, and the globals that they name.
- Objects are identified by their classes and attributes, arrays by their bytes.

Where something cannot be identified with certainty, there is no digest, and every process traces. This is so for
functions that import other modules, refer to other libraries, read files, clocks or random numbers, or look up names at
run time, and for objects of other libraries. A wrong digest would give the numbers of another function.
"""

import builtins
import dis
import operator
import os
import platform
import sys
import time
from collections.abc import Iterator
from functools import cache, cached_property, partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MappingProxyType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
)
from typing import Any, NamedTuple

import numpy as np

_PACKAGE = __name__.partition(".")[0]

KNOWN = frozenset(
    (_PACKAGE, "jax", "jaxlib", "numpy")
    + ("math", "cmath", "operator", "functools", "itertools", "numbers", "typing", "collections", "dataclasses")
    + ("abc", "enum", "builtins", "types", "contextlib", "_operator", "_functools", "_collections_abc", "jaxtyping")
)
"""Libraries whose objects are identified by name."""

UNCERTAIN = frozenset(
    ("open", "eval", "exec", "compile", "globals", "locals", "vars", "getattr", "setattr", "__import__", "input")
    + ("id", "hash", "random", "default_rng", "load", "loadtxt", "genfromtxt", "fromfile", "memmap", "fromregex")
    + ("pure_callback", "io_callback", "host_callback")
)
"""Names in other people's functions whose effect on a trace is not decided by the function."""

_UNCERTAIN_OPERATIONS = ("STORE_GLOBAL", "DELETE_GLOBAL")

_SKIPPED = (
    *("__dict__", "__weakref__", "__doc__", "__module__", "__slots__", "__static_attributes__", "__firstlineno__"),
    *("__annotations__", "__annotate__", "__annotations_cache__", "__annotate_func__"),
)
"""Attributes of classes that do not decide a trace."""


class _Field(NamedTuple):
    value: int


_DESCRIPTORS = (MemberDescriptorType, GetSetDescriptorType, type(vars(_Field)["value"]))
"""Types of the attributes of classes that read a field."""

_HEAP_TYPE = 1 << 9
"""Flag of classes that are defined in Python."""

_BEGINNING = time.time()


class Unidentified(Exception):
    """An object cannot be identified with certainty."""


def digest(*roots: object) -> str | None:
    """Return a digest of objects that decide a trace, with the versions of all that traces; None if there is none."""
    versions = _versions()
    if versions is None or _is_patched():
        return None
    walk = _Walk()
    try:
        for root in roots:
            walk.visit(root)
    except (Unidentified, RecursionError):
        return None
    return sha256("\n".join((versions, *walk.parts)).encode()).hexdigest()


@cache
def _versions() -> str | None:
    """Return the versions of all that traces and translates; None if this package may have changed since it began."""
    root, files = Path(__file__).parents[1], sha256()
    for folder, folders, names in os.walk(root):
        folders.sort()
        for name in sorted(name for name in names if name.endswith(".py")):
            path = Path(folder, name)
            if max(path.stat().st_mtime, path.stat().st_ctime) >= _BEGINNING:
                return None
            files.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes() + b"\0")
    libraries = [f"{name} {version(name)}" for name in ("jax", "jaxlib", "numpy")]
    return " ".join((platform.python_implementation(), sys.version, *libraries, files.hexdigest()))


def _is_patched() -> bool:
    """Return whether a function or class of this package, or a method of one, was replaced by the user's.

    Other values are not noticed.
    """
    modules = [module for name, module in sys.modules.copy().items() if _top(name) == _PACKAGE]
    values = {id(value): value for module in modules for value in list(vars(module).values())}  # modules share most
    found = [value for value in values.values() if isinstance(value, (FunctionType, type))]
    own = (value for value in found if isinstance(value, type) and _top(value.__module__) == _PACKAGE)
    found += [part for kind in own for part in vars(kind).values() if isinstance(part, FunctionType)]
    return not all(_top(value.__module__) in KNOWN or _is_library(_top(value.__module__)) for value in found)


class _Walk:
    """A walk over objects that collects `parts`, texts that identify them.

    **Raises:** `Unidentified`.
    """

    def __init__(self) -> None:
        self.parts: list[str] = []
        self._seen: dict[int, tuple[int, object]] = {}  # the objects are kept, so that no other gets their id

    def visit(self, x: Any) -> None:
        kind = type(x)
        if x is None or kind in (bool, int, float, complex, str, bytes, type(...)):
            self.parts.append(f"{kind.__name__} {x!r}")
            return
        if id(x) in self._seen:
            self.parts.append(f"again {self._seen[id(x)][0]}")
            return
        self._seen[id(x)] = len(self._seen), x
        if name := _known_name(x):
            self.parts.append(f"known {name}")
        elif isinstance(x, np.ndarray | np.generic):
            if x.dtype.hasobject:
                raise Unidentified("an array of objects")
            self.visit(type(x))
            array = np.ascontiguousarray(x)
            self.parts.append(f"array {array.dtype.str} {np.shape(x)} {sha256(array.tobytes()).hexdigest()}")
        elif isinstance(x, np.dtype):
            self.parts.append(f"dtype {x.str}")
        elif isinstance(x, FunctionType | type) and _is_library(_top(x.__module__)):
            raise Unidentified(f"{x.__module__}.{x.__qualname__}")
        elif isinstance(x, FunctionType) and hasattr(x, "registry"):  # of `functools.singledispatch`
            self.visit(x.registry)
        elif isinstance(x, FunctionType):
            self._visit_function(x)
        elif isinstance(x, type):
            self._visit_class(x)
        elif isinstance(x, ModuleType | BuiltinFunctionType):
            raise Unidentified(repr(x))
        else:
            self.parts.append(f"object of {kind.__name__}")
            for part in self._parts_of(x):
                self.visit(part)

    def _parts_of(self, x: Any) -> Iterator[Any]:
        """Yield what decides about an object that is neither a number, an array, a function nor a class."""
        jax: Any = sys.modules.get("jax")  # without classes while another thread imports it
        jax_array: Any = getattr(jax, "Array", ())
        if isinstance(x, partial):
            yield from (x.func, x.args, x.keywords)
        elif isinstance(x, MethodType):
            yield from (x.__func__, x.__self__)
        elif isinstance(x, staticmethod | classmethod):
            yield x.__func__
        elif isinstance(x, property):
            yield from (x.fget, x.fset)
        elif isinstance(x, cached_property):
            yield x.func
        elif isinstance(x, MappingProxyType):
            yield dict(x)
        elif hasattr(x, "__wrapped__") and (type(x).__module__ or "").partition(".")[0] in KNOWN:
            yield x.__wrapped__  # a function compiled by `jax.jit`, or with a cache
        elif isinstance(x, jax_array) and not isinstance(x, jax.core.Tracer):
            yield from (repr(x.aval), np.asarray(x))
        else:
            yield type(x)
            yield from self._contents_of(x)

    def _contents_of(self, x: Any) -> Iterator[Any]:
        """Yield the items and attributes of an object."""
        python = [base for base in type(x).__mro__ if base.__flags__ & _HEAP_TYPE]
        others = {base for base in type(x).__mro__ if not base.__flags__ & _HEAP_TYPE} - {object}
        if others - {dict, tuple, list, set, frozenset}:
            raise Unidentified(f"an object of {type(x).__name__}")
        if isinstance(x, dict):
            yield from (part for item in x.items() for part in item)
        elif isinstance(x, tuple | list):
            yield len(x)
            yield from x
        elif isinstance(x, set | frozenset):
            if not all(type(item) in (bool, int, float, str, bytes) for item in x):
                raise Unidentified("a set")
            yield from sorted(map(repr, x))
        attributes = dict(getattr(x, "__dict__", {}))
        for base in python:
            slots = vars(base).get("__slots__", ())
            for name in (slots,) if isinstance(slots, str) else slots:
                if name not in ("__dict__", "__weakref__") and hasattr(x, name):
                    attributes[name] = object.__getattribute__(x, name)
            for name, value in vars(base).items():
                if isinstance(value, cached_property):  # computed when it is first used
                    attributes.pop(name, None)
        for name in sorted(attributes):
            yield from (name, attributes[name])

    def _visit_function(self, function: FunctionType) -> None:
        own = _top(function.__module__) in KNOWN and _top(function.__globals__.get("__name__")) in KNOWN
        self.parts.append(_code_text(function.__code__))
        for cell in function.__closure__ or ():
            try:
                self.visit(cell.cell_contents)
            except ValueError:  # the cell is empty
                self.parts.append("empty")
        for part in (function.__defaults__, function.__kwdefaults__, dict(vars(function))):
            self.visit(part)
        if own:
            return  # the content of the package's files decides about its globals
        names = sorted(_names(function.__code__))
        for name in names:
            if name in function.__globals__:
                self.parts.append(f"global {name}")
                self._visit_global(function.__globals__[name], names)
            elif name in UNCERTAIN and hasattr(builtins, name):
                raise Unidentified(f"a function that uses {name}")

    def _visit_global(self, value: Any, names: list[str]) -> None:
        """Visit a global of a function that uses `names`; of a module, those of its attributes that may be used."""
        if not isinstance(value, ModuleType):
            self.visit(value)
        elif _top(value.__name__) in KNOWN:
            self.parts.append(f"module {value.__name__}")
            if not UNCERTAIN.isdisjoint((*names, *value.__name__.split("."))):
                raise Unidentified(f"a function that uses {value.__name__}")
        elif _is_library(_top(value.__name__)):
            raise Unidentified(f"the module {value.__name__}")
        else:
            for name in names:
                if name in vars(value):
                    self.parts.append(f"attribute {name}")
                    self._visit_global(vars(value)[name], names)

    def _visit_class(self, kind: type) -> None:
        for base in kind.__mro__:
            name = _known_name(base)
            self.parts.append(f"class {name or base.__qualname__}")
            if name:
                continue
            if _top(type(base).__module__) not in KNOWN or not base.__flags__ & _HEAP_TYPE:
                raise Unidentified(f"the class {base.__qualname__}")
            for key, value in vars(base).items():
                generated = isinstance(value, FunctionType) and value.__code__.co_filename.startswith("<")
                internal = key in _SKIPPED or key.startswith(("__dataclass", "_abc", "__abstract", "__orig", "__param"))
                if not (internal or isinstance(value, _DESCRIPTORS) or (generated and key.startswith("__"))):
                    self.parts.append(f"attribute {key}")
                    self.visit(value)


def _known_name(x: Any) -> str | None:
    """Return the name under which a known library has an object, or None if it has none."""
    module, name = getattr(x, "__module__", None), getattr(x, "__qualname__", None) or getattr(x, "__name__", None)
    if not isinstance(module, str) or not isinstance(name, str) or _top(module) not in KNOWN:
        return None
    if name in UNCERTAIN or "random" in module.split("."):
        raise Unidentified(f"{module}.{name}")
    try:
        value = operator.attrgetter(name)(sys.modules[module])
    except (KeyError, AttributeError):
        return None
    return f"{module}.{name}" if value is x else None


def _top(module: str | None) -> str:
    return (module or "").partition(".")[0]


@cache
def _is_library(top: str) -> bool:
    """Return whether a top-level module belongs to an installed library or to Python, and is not `KNOWN`."""
    file = getattr(sys.modules.get(top), "__file__", None)
    installed = file is not None and not {"site-packages", "dist-packages"}.isdisjoint(Path(file).parts)
    return top not in KNOWN and (installed or top in sys.stdlib_module_names)


@cache
def _code_text(code: CodeType) -> str:
    """Return a text with all that the execution of code depends on, except for its names of globals' values.

    **Raises:** `Unidentified` if the code imports a module that is not known, or assigns a global.
    """
    for instruction in dis.get_instructions(code):
        if instruction.opname == "IMPORT_NAME" and _top(instruction.argval) not in KNOWN:
            raise Unidentified(f"a function that imports {instruction.argval}")
        if instruction.opname in _UNCERTAIN_OPERATIONS:
            raise Unidentified("a function that assigns a global")
    constants = [
        _code_text(x)
        if isinstance(x, CodeType)
        else f"{type(x).__name__} {sorted(map(repr, x))}"
        if isinstance(x, frozenset)
        else f"{type(x).__name__} {x!r}"
        for x in code.co_consts
    ]
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    return "\n".join((code.co_code.hex(), code.co_exceptiontable.hex(), repr(counts), repr(names), *constants))


def _names(code: CodeType) -> set[str]:
    """Return the names of globals and attributes that a function and its inner functions use."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*map(_names, inner))
