"""Trust in kernels: kernels of foreign code run only if they agree with XLA.

Code from outside the package may use any function of jax, and a fault in its translation would give wrong numbers in
silence. So before a kernel of such code runs, the caller's comparison of that code with XLA is made. If they differ,
XLA runs everything of the same owner. The cache keeps the verdict under the text of the compared kernels and of each
kernel that may run, so that an owner is compared once. The tests compare the package's own code with the versions in
`TESTED_VERSIONS`; newer ones are compared here.
"""

import threading
import types
import warnings
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import llvmlite
from jaxlib import version as jaxlib

from vibrojax.compile.agreement import Difference
from vibrojax.compile.kernels import Untranslatable, kernel_for
from vibrojax.compile.kernels import cache as store

TESTED_VERSIONS = {"jax": ("0.10.2", "0.12.0.1"), "llvmlite": ("0.50.0",)}
"""Versions with which all tests have passed, oldest first."""

AGREES = b"agrees"

OWN_PACKAGES = ("vibrojax", "builtins", "functools", "typing", "numpy", "jax", "jaxlib")
"""Packages whose objects are not foreign, unless they contain foreign ones."""


class KernelRefused(UserWarning):
    """A kernel and XLA differ, so that XLA runs all lanes of the same owner."""


class KernelComparison(Protocol):
    """Kernels that are compared with XLA. Its construction raises `Untranslatable` if they cannot be made."""

    @property
    def key(self) -> str:
        """Digest of the compared kernels."""

    def difference(self) -> Difference | None:
        """Return the first difference, or None."""


class Subject(NamedTuple):
    """The code that a kernel comes from.

    - `owner`: a refusal holds for all kernels of the same owner; `label` names it in messages.
    - `code`: the objects that the kernel calls, searched for foreign ones.
    - `variant`: there is one comparison per owner, variant and precision.
    - `compare`: makes the comparison.
    """

    owner: Hashable
    label: str
    code: Hashable
    variant: Hashable
    compare: Callable[[], KernelComparison]


Policy = Callable[[tuple[Hashable, ...], tuple[Any, ...], bool], Subject | None]
"""`policy(static, arguments, derives)` returns the subject of a call, or None if its kernel is always trusted.
`derives` says that the function takes derivatives."""

_verdicts: dict[Hashable, bytes] = {}
"""Verdicts of this process by owner, variant and precision: `AGREES`, or the line that describes the difference."""

_refused: dict[Hashable, str] = {}
"""Reason of refusal by owner."""

_trusted: set[str] = set()
"""Keys of kernels that may run."""

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

    **Arguments:** `registers` as in `vibrojax.compile.kernels.Kernel`; `derives` and `policy` as in `Policy`.

    **Raises:** `Untranslatable` if no kernel can be made, or if kernels of this owner differ from XLA.
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
    """Trust the kernel with this key, or raise `Untranslatable`; warn at the first refusal of an owner."""
    _raise_if_refused(subject)
    name = _verdict_name(key)
    if store.read(name) != AGREES:
        compared = (subject.owner, subject.variant, jnp.result_type(float).name)
        if compared not in _verdicts:
            try:
                _verdicts[compared] = _verdict(subject)
            except Untranslatable as error:  # a part of the code that this kernel does not need
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
    """Return the verdict on a subject, from the cache if possible."""
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
    """Return the key under which the cache keeps the verdict on kernels."""
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

    A `vj.FrictionLaw` is an object of the package that holds functions of its user, so fields and closures count.
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
    """Yield the parts of an object that may be code: items, fields, and what a function encloses or wraps."""
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
