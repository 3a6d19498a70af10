"""Choice of the compiler: kernels of foreign code run only if they agree with XLA.

Foreign code (code from outside the package) may use any function of jax. A fault in its translation would silently give
wrong numbers. So before a kernel of foreign code runs, the caller's `KernelComparison` compares that code with XLA. If
the results differ, XLA runs all code of the same owner, such as a scene. The disk cache stores the outcome under the
hashes of the compared kernels and of each kernel that it allows, so that each owner is compared once.

The tests compare the package's own code with XLA for the versions in `TESTED_VERSIONS`. With newer versions, the
package's own code is compared at run time as well.
"""

import threading
import types
import warnings
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import suppress
from functools import cache, partial, wraps
from hashlib import sha256
from inspect import signature
from typing import Any, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
import llvmlite
from jaxlib import version as jaxlib

from vibrojax.compile.agreement import Difference
from vibrojax.compile.kernels import Untranslatable, kernel_for
from vibrojax.compile.kernels import cache as store
from vibrojax.compile.xla import jitted

TESTED_VERSIONS = {"jax": ("0.10.2", "0.12.0.1"), "llvmlite": ("0.50.0",)}
"""Versions with which all tests have passed, oldest first."""

AGREES = b"agrees"
"""Verdict on kernels that agree with XLA."""

OWN_PACKAGES = ("vibrojax", "builtins", "functools", "typing", "numpy", "jax", "jaxlib")
"""Packages whose objects are not foreign, unless they contain foreign objects."""


class KernelRefused(UserWarning):
    """Warning that a kernel differs from XLA and that XLA therefore runs all lanes of the same owner."""


class KernelComparison(Protocol):
    """Comparison of kernels with XLA. Its constructor raises `Untranslatable` if the kernels cannot be made."""

    @property
    def key(self) -> str:
        """Hash of the kernels that are compared with XLA."""

    def difference(self) -> Difference | None:
        """Return the first difference, or None if the kernels agree with XLA."""


class Subject(NamedTuple):
    """The code from which a kernel is compiled.

    - `owner`: object to which the code belongs. If one kernel is rejected, all kernels of its owner are.
    - `label`: name of the owner in messages.
    - `code`: objects that the kernel calls, to be searched for foreign code.
    - `variant`: variant of the code. There is one comparison per owner, variant and precision.
    - `compare`: function that makes the comparison.
    """

    owner: Hashable
    label: str
    code: Hashable
    variant: Hashable
    compare: Callable[[], KernelComparison]


Policy = Callable[[tuple[Hashable, ...], tuple[Any, ...], bool], Subject | None]
"""`policy(static, arguments, derives)` returns the subject of a call, or None if its kernel is always trusted.
`derives` is True if the function computes derivatives."""

_verdicts: dict[Hashable, bytes] = {}
"""Verdicts of this process by owner, variant and precision: `AGREES`, or a message that describes the difference."""

_refused: dict[Hashable, str] = {}
"""Rejected owners, with the reason."""

_trusted: set[str] = set()
"""Keys of trusted kernels."""

_locks: defaultdict[Hashable, threading.Lock] = defaultdict(threading.Lock)
_lock = threading.Lock()


def run_kernel(
    function: Callable[..., Any],
    static: tuple[Hashable, ...],
    *arguments: Any,
    registers: int = 1,
    derives: bool = False,
    policy: Policy | None = None,
) -> Any:
    """Return `function(*static, *arguments)`, computed by a trusted kernel.

    **Arguments:**

    - `static`, `arguments`: static and traced arguments of the function.
    - `registers`: see `vibrojax.compile.kernels.Kernel`.
    - `derives`, `policy`: see `Policy`.

    **Raises:** `Untranslatable` if no kernel can be made, or if kernels of the same owner differ from XLA.
    """
    subject = policy(static, arguments, derives) if policy is not None else None
    if subject is None or not (is_foreign(subject.code) or newer_than_tested()):
        return kernel_for(function, static, *arguments, registers=registers)(*arguments)
    _raise_if_refused(subject)
    kernel = kernel_for(function, static, *arguments, registers=registers)
    if kernel.key not in _trusted:
        with _lock:
            lock = _locks[subject.owner]
        with lock:
            _verify(kernel.key, subject)
    return kernel(*arguments)


def _raise_if_refused(subject: Subject) -> None:
    if subject.owner in _refused:
        raise Untranslatable(_refused[subject.owner])


def _verify(key: str, subject: Subject) -> None:
    """Mark the kernel with this key as trusted, or raise `Untranslatable`.

    The first time an owner is rejected, also warn.
    """
    _raise_if_refused(subject)
    name = _verdict_name(key)
    if store.read(name) != AGREES:
        compared = (subject.owner, subject.variant, jnp.result_type(float).name)
        if compared not in _verdicts:
            try:
                _verdicts[compared] = _verdict(subject)
            except Untranslatable as error:  # raised by code that the comparison needs and this kernel does not
                _refused[subject.owner] = str(error)
                raise
        verdict = _verdicts[compared]
        if verdict != AGREES:
            _refused[subject.owner] = verdict.decode()
            warnings.warn(_refused[subject.owner], KernelRefused, stacklevel=2)
            _raise_if_refused(subject)
        store.write(name, verdict)
    _trusted.add(key)


def _verdict(subject: Subject) -> bytes:
    """Return the outcome of the comparison with XLA, from the disk cache if possible: `AGREES`, or a message."""
    comparison = subject.compare()
    name = _verdict_name(comparison.key)
    verdict = store.read(name)
    if verdict is None:
        difference = comparison.difference()
        verdict = AGREES
        if difference is not None:
            verdict = (
                f"{subject.label}: its kernel and XLA differ by {difference.relative:.1e} in {difference.quantity}; "
                "XLA runs its lanes, which takes longer"
            ).encode()
        store.write(name, verdict)
    return verdict


def _verdict_name(key: str) -> str:
    """Return the cache key for the outcome of a comparison, given the hash of the compared kernels."""
    return sha256("\n".join(("agreement 1", key, jax.__version__, jaxlib.__version__)).encode()).hexdigest()


@cache
def newer_than_tested() -> bool:
    """Return whether jax or llvmlite is newer than every tested version."""
    return any(
        _version_numbers(installed) > max(map(_version_numbers, TESTED_VERSIONS[package]))
        for package, installed in (("jax", jax.__version__), ("llvmlite", llvmlite.__version__))
    )


def _version_numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("+")[0].split(".") if part.isdecimal())


@cache
def is_foreign(code: Hashable) -> bool:
    """Return whether an object is, or contains, code from outside the package.

    Fields and closures are searched as well: a `vj.FrictionLaw`, for example, belongs to the package but holds
    functions that its user wrote.
    """
    seen: set[int] = set()

    def foreign(x: Any) -> bool:
        if id(x) in seen:
            return False
        seen.add(id(x))
        module = getattr(x if isinstance(x, types.FunctionType | type) else type(x), "__module__", None) or ""
        return module.split(".")[0] not in OWN_PACKAGES or any(map(foreign, _contents(x)))

    return foreign(code)


def _contents(x: Any) -> Iterator[Any]:
    """Yield the parts of an object that may be code: items, fields, closure variables, defaults, wrapped functions."""
    if isinstance(x, Mapping):
        yield from x.values()
    elif isinstance(x, list | tuple | set | frozenset):
        yield from x
    elif isinstance(x, types.MethodType):
        yield from (x.__func__, x.__self__)
    elif isinstance(x, partial):
        yield from (x.func, x.args, x.keywords)
    elif hasattr(x, "__wrapped__"):
        yield x.__wrapped__
    elif isinstance(x, types.FunctionType):
        yield from x.__defaults__ or ()
        for cell in x.__closure__ or ():
            with suppress(ValueError):  # the cell is empty
                yield cell.cell_contents
    elif not isinstance(x, type | types.ModuleType):
        yield from getattr(x, "__dict__", {}).values()


R = TypeVar("R")


def lane_function(
    static: int, *, derives: bool = False, registers: int = 1, policy: Policy | None = None
) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Return a decorator that compiles a function of lanes, whose first `static` arguments are static and hashable.

    The other arguments and the results are pytrees of scalars and of arrays whose last axis is the lane axis. The
    function is compiled on its first call with each combination of argument types.

    **Arguments:**

    - `static`: number of static arguments.
    - `derives`: whether the function computes derivatives.
    - `registers`: number of vector registers that hold one value of a group of lanes.
    - `policy`: callable that decides which calls require a comparison with XLA first. By default, all kernels are
      trusted.
    """

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        by_xla = jitted(tuple(signature(function).parameters)[:static])(function)

        @wraps(function)
        def call(*args: Any) -> R:
            options: dict[str, Any] = {"registers": registers, "derives": derives, "policy": policy}
            try:
                return run_kernel(function, args[:static], *args[static:], **options)
            except Untranslatable:
                return by_xla(*args)

        return call

    return decorate
