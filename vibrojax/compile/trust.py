"""Choice of the compiler: kernels of foreign code run only if the tests or a comparison with XLA vouch for them.

Foreign code (code from outside the package) may use any function of jax. A fault in its translation would silently give
wrong numbers. So before a kernel runs in which foreign code has an instruction that the tests do not cover
(`translation.py`), the comparison of its `Subject` compares that code with XLA. If the results differ, XLA runs all
code of the same owner, such as a scene. The disk cache stores the outcome under the hashes of the compared kernels and
of each kernel that it allows, so that each owner is compared once.

The tests compare the package's own code with XLA for the versions in `TESTED_VERSIONS`. With newer versions, the
package's own code is compared at run time as well.
"""

import threading
import warnings
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, wraps
from hashlib import sha256
from importlib.metadata import version
from inspect import signature
from typing import Any, NamedTuple, TypeVar

import llvmlite

from vibrojax.compile import cache as store
from vibrojax.compile.assembly import Untranslatable
from vibrojax.compile.identity import is_foreign
from vibrojax.compile.native import Kernel, kernel_for
from vibrojax.compile.xla import float_type, jitted

TESTED_VERSIONS = {"jax": ("0.10.2", "0.12.0.1"), "llvmlite": ("0.50.0",)}
"""Versions with which all tests have passed, oldest first."""

AGREES = b"agrees"
"""Verdict on kernels that agree with XLA."""


class KernelRefused(UserWarning):
    """Warning that a kernel differs from XLA and that XLA therefore runs all lanes of the same owner."""


class Subject(NamedTuple):
    """The code from which a kernel is compiled.

    - `owner`: object to which the code belongs. If one kernel is rejected, all kernels of its owner are.
    - `label`: name of the owner in messages.
    - `code`: objects that the kernel calls, to be searched for foreign code.
    - `variant`: variant of the code. There is one comparison per owner, variant and precision.
    - `covers`: further variants that the comparison covers.
    - `compare`: function that makes the comparison, or raises `Untranslatable`. The comparison's `key` is the hash of
      the kernels that it compares with XLA. Its method `difference()` returns the first `Difference`, or None.
    """

    owner: Hashable
    label: str
    code: Hashable
    variant: Hashable
    compare: Callable[[], Any]
    covers: tuple[Hashable, ...] = ()


Policy = Callable[[tuple[Hashable, ...], tuple[Any, ...], bool], Subject | None]
"""`policy(static, arguments, derives)` returns the subject of a call, or None if its kernel is always trusted.
`derives` is True if the function computes derivatives."""

_refused: dict[Hashable, str] = {}
"""Rejected owners, with the reason."""

_trusted: set[Hashable] = set()
"""Keys of trusted kernels; owner, variant and precision of code that agrees with XLA."""

_DERIVATIVES = ContextVar("derivatives", default=False)


@contextmanager
def comparing_derivatives() -> Iterator[None]:
    """Compare derivatives, too, where foreign code is first used: the work in this context needs them later."""
    before = _DERIVATIVES.set(True)
    try:
        yield
    finally:
        _DERIVATIVES.reset(before)


_locks: defaultdict[Hashable, threading.Lock] = defaultdict(threading.Lock)
_lock = threading.Lock()


def trusted_kernel(
    function: Callable[..., Any],
    static: tuple[Hashable, ...],
    *arguments: Any,
    policy: Policy,
    registers: int = 1,
    derives: bool = False,
) -> Kernel:
    """Return the kernel of `function(*static, *arguments)`, after a comparison with XLA if foreign code needs one.

    **Arguments:**

    - `static`, `arguments`: static and traced arguments of the function.
    - `registers`: see `vibrojax.compile.native.Kernel`.
    - `derives`, `policy`: see `Policy`.

    **Raises:** `Untranslatable` if no kernel can be made, or if kernels of the same owner differ from XLA.
    """
    subject = policy(static, arguments, derives or _DERIVATIVES.get())
    if subject is None or not (is_foreign(subject.code) or newer_than_tested()):
        return kernel_for(function, static, *arguments, registers=registers)
    if subject.owner in _refused:
        raise Untranslatable(_refused[subject.owner])
    kernel = kernel_for(function, static, *arguments, registers=registers)
    if kernel.key not in _trusted and (kernel.description.compared or newer_than_tested()):
        with _lock:
            lock = _locks[subject.owner]
        with lock:
            _verify(kernel.key, subject)
    return kernel


def _verify(key: str, subject: Subject) -> None:
    """Mark the kernel with this key as trusted, or raise `Untranslatable`.

    The first time an owner is rejected, also warn.
    """
    owner = subject.owner
    if owner in _refused:
        raise Untranslatable(_refused[owner])
    precision = float_type().name
    compared = owner, subject.variant, precision
    if compared not in _trusted and store.read(_verdict_name(key)) != AGREES:
        try:
            verdict = _verdict(subject)
        except Untranslatable as error:  # raised by code that the comparison needs and this kernel does not
            _refused[owner] = str(error)
            raise
        if verdict != AGREES:
            _refused[owner] = verdict.decode()
            warnings.warn(_refused[owner], KernelRefused, stacklevel=2)
            raise Untranslatable(_refused[owner])
        _trusted.update((owner, variant, precision) for variant in (subject.variant, *subject.covers))
    if compared in _trusted:
        store.write(_verdict_name(key), AGREES)
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
    return sha256("\n".join(("agreement 3", key, version("jax"), version("jaxlib"))).encode()).hexdigest()


@cache
def newer_than_tested() -> bool:
    """Return whether jax or llvmlite is newer than every tested version."""
    return any(
        _version_numbers(installed) > max(map(_version_numbers, TESTED_VERSIONS[package]))
        for package, installed in (("jax", version("jax")), ("llvmlite", llvmlite.__version__))
    )


def _version_numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("+")[0].split(".") if part.isdecimal())


R = TypeVar("R")


def lane_function(
    static: int, *, policy: Policy, derives: bool = False
) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Return a decorator that compiles a function of lanes, whose first `static` arguments are static and hashable.

    The other arguments and the results are pytrees of scalars and of arrays whose last axis is the lane axis. The
    function is compiled on its first call with each combination of argument types. `policy` decides which calls require
    a comparison with XLA first; `derives`: whether the function computes derivatives.
    """

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        by_xla = jitted(tuple(signature(function).parameters)[:static])(function)

        @wraps(function)
        def call(*args: Any) -> R:
            try:
                return trusted_kernel(function, args[:static], *args[static:], derives=derives, policy=policy)(
                    *args[static:]
                )
            except Untranslatable:
                return by_xla(*args)

        return call

    return decorate
