"""Digests of the code of a user's own scenes, friction laws and steppers, which are part of a result's identity."""

import hashlib
import inspect
import linecache
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from sysconfig import get_paths
from types import CodeType, FunctionType, MappingProxyType, MethodType, ModuleType
from typing import Any

import numpy as np

from vibrojax.errors import InputError
from vibrojax.measures import GAUGES
from vibrojax.physics.parameters import Parameter
from vibrojax.scenes import Scene

_PACKAGE = __name__.partition(".")[0]
_KNOWN = {_PACKAGE, "jax", "jaxlib", "numpy", "scipy", *sys.stdlib_module_names}
"""Packages whose code never counts as the user's own."""

_INSTALLED = tuple({str(Path(get_paths()[name])) for name in ("purelib", "platlib")})
_GENERATED = "<string>"
"""File name of the methods that `dataclass` generates."""

_ARRAYS = ("jax", "jaxlib")
"""Packages whose objects with `__array__` are arrays; jax itself need not be imported to recognise them."""

_FIRST: dict[Scene[Any], dict[str, object]] = {}
"""Digests at the first use of each scene in this process, under the key under which its compiled code is kept."""


def is_code(name: str) -> bool:
    """Return whether `name` is the key of a digest of code in an identity."""
    return name.startswith("code.")


def code_identity(scene: Scene[Any], options: Iterable[str] = (), **others: object) -> dict[str, object]:
    """Return digests of the code outside this package: of the scene, its `options`, and `others` (objects by name).

    The digests enter the identity of results. The dictionary is empty for scenes and laws of the package.
    """
    names = [field.name for field in fields(scene)] if is_dataclass(scene) else list(vars(scene))
    settings = [getattr(scene, name) for name in names if name not in options]
    gauges = [GAUGES.get(gauge, gauge) for gauge in scene.measures]
    roots = {"scene": [type(scene), *settings, *gauges], **{name: [getattr(scene, name)] for name in options}}
    roots |= {name: [value] for name, value in others.items()}
    digests = {f"code.{name}": code_digest(*parts) for name, parts in roots.items()}
    found: dict[str, object] = {name: digest for name, digest in digests.items() if digest is not None}
    first = _FIRST.setdefault(scene, found)
    if any(first.get(name) != found.get(name) for name in {*first, *found} - {f"code.{name}" for name in others}):
        text = "a value that its functions use has changed since its first run, which compiled code does not see"
        raise InputError(f'scene "{scene.name}": {text}; define it again, or make the value a parameter')
    return found


def code_digest(*roots: object) -> str | None:
    """Return a digest of the code outside this package that `roots` depend on, or None if there is none.

    The digest covers the source of the functions and classes, of the functions and classes to which they refer in the
    user's own modules, and the constants that they use. Code without a source is represented by its bytecode, which
    depends on the Python version.

    **Example:**

    >>> code_digest(vj.FRICTION_LAWS["stribeck"]) is None
    True
    """
    walk = _Walk()
    for root in roots:
        walk.visit(root)
    return f"sha256 {hashlib.sha256(chr(0).join(walk.parts).encode()).hexdigest()[:16]}" if walk.has_code else None


class _Walk:
    """A walk over objects that collects the source of the user's functions, and constants, in a fixed order."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self.has_code = False
        self._seen: dict[int, object] = {}

    def visit(self, x: Any, referrer: str | None = None, searching: bool = False) -> None:
        """Visit an object once; `referrer`: top-level module of the code that refers to it.

        `searching`: whether only code counts, not constants.
        """
        if x is None or isinstance(x, (bool, int, float, complex, str, bytes)):
            if not searching:
                self.parts.append(repr(x))
            return
        if id(x) in self._seen:
            return
        self._seen[id(x)] = x
        kind, top = type(x), _top(type(x).__module__)
        if isinstance(x, (np.ndarray, np.generic)) or (top in _ARRAYS and hasattr(x, "__array__")):
            if not searching:
                array = np.ascontiguousarray(x)
                self.parts.append(f"{array.dtype.str} {array.shape} {hashlib.sha256(array.tobytes()).hexdigest()}")
        elif isinstance(x, FunctionType):
            self._visit_function(x, referrer)
        elif isinstance(x, type):
            self._visit_class(x, referrer, searching)
        elif isinstance(x, (ModuleType, Parameter)):
            return  # the values of parameters are in the identity already
        elif top == _PACKAGE and not is_dataclass(x) and not isinstance(x, tuple):
            for name, value in vars(x).items():  # what is derived from the user's functions is found again from them
                if not isinstance(getattr(kind, name, None), cached_property):
                    self.visit(value, referrer, searching=True)
        else:
            searching = searching and isinstance(x, (dict, MappingProxyType, list, tuple, set, frozenset))
            for part in self._parts_of(x, referrer):
                self.visit(part, referrer, searching)

    def _parts_of(self, x: Any, referrer: str | None) -> Iterator[Any]:
        """Yield the objects on which `x` depends, which is neither a function nor a class."""
        if isinstance(x, (dict, MappingProxyType)):
            yield from (part for item in x.items() for part in item)
        elif isinstance(x, (list, tuple)):
            yield from x
        elif isinstance(x, (set, frozenset)):
            yield from sorted(map(repr, x))
        elif isinstance(x, partial):
            yield from (x.func, x.args, x.keywords)
        elif isinstance(x, (staticmethod, classmethod, MethodType)):
            yield from (getattr(x, "__self__", None), x.__func__)
        elif isinstance(x, property):
            yield x.fget
        elif isinstance(x, cached_property):
            yield x.func
        elif hasattr(x, "__wrapped__"):  # such as a function compiled by `jax.jit`
            yield x.__wrapped__
        elif _follows(type(x).__module__, referrer):
            yield from (type(x), dict(getattr(x, "__dict__", {})))
        elif is_dataclass(x):
            # Names and references of the package's own classes do not affect results.
            yield from (getattr(x, field.name) for field in fields(x) if field.name not in ("name", "reference"))

    def _visit_function(self, function: FunctionType, referrer: str | None) -> None:
        cells, top = [], _top(function.__module__)
        for cell in function.__closure__ or ():
            with suppress(ValueError):  # the cell is empty
                cells.append(cell.cell_contents)
        if not _follows(function.__module__, referrer):
            for content in cells if top == _PACKAGE else ():
                self.visit(content, referrer, searching=True)
            return
        self.has_code = True
        self.parts += [function.__qualname__, _source(function.__code__)]
        for content in (*cells, function.__defaults__, function.__kwdefaults__):
            self.visit(content, top)
        names = sorted(_names(function.__code__))
        for value in (function.__globals__[name] for name in names if name in function.__globals__):
            used = isinstance(value, ModuleType) and _follows(value.__name__, top)
            for part in (getattr(value, name, None) for name in names) if used else (value,):
                self.visit(part, top)

    def _visit_class(self, kind: type, referrer: str | None, searching: bool) -> None:
        for base in kind.__mro__:
            if not _follows(base.__module__, referrer):
                continue
            self.has_code, top = True, _top(base.__module__)
            self.parts.append(base.__qualname__)
            for name, value in vars(base).items():
                # Of the special methods, those that are the user's, not generated by `dataclass`.
                written = isinstance(value, FunctionType) and value.__code__.co_filename != _GENERATED
                own = written and name != "__repr__" and _follows(value.__module__, top)
                if own or not name.startswith("__"):
                    self.parts.append(name)
                    self.visit(value, top, searching)


def _follows(module: str | None, referrer: str | None) -> bool:
    """Return whether the code of a module counts: it is neither known nor a library that the user's code uses."""
    top = _top(module)
    return top not in _KNOWN and (referrer in (None, top) or not _is_installed(top))


def _top(module: str | None) -> str:
    return (module or "").partition(".")[0]


@cache
def _is_installed(module: str) -> bool:
    file = getattr(sys.modules.get(module), "__file__", None)
    return file is not None and str(Path(file).absolute()).startswith(_INSTALLED)


@cache  # by code: the file may be edited after its import
def _source(code: CodeType) -> str:
    """Return the source of a function, or its bytecode if there is no source."""
    if code.co_filename != _GENERATED:
        try:
            if code.co_name != "<lambda>":
                return inspect.cleandoc(inspect.getsource(code))
            # The source of a lambda that `inspect` returns ends with its first line.
            last = max(end or 0 for _, end, *_ in code.co_positions())
            lines = linecache.getlines(code.co_filename)[code.co_firstlineno - 1 : last]
            if lines:
                return "\n".join(line.strip() for line in lines)
        except (OSError, TypeError, SyntaxError):
            pass
    constants = [
        _source(x) if isinstance(x, CodeType) else repr(sorted(map(repr, x)) if isinstance(x, frozenset) else x)
        for x in code.co_consts
    ]
    return "\n".join([code.co_code.hex(), *code.co_names, *constants])


def _names(code: CodeType) -> set[str]:
    """Return the names of globals and attributes that a function and its inner functions use."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*map(_names, inner))
