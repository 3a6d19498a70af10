"""Kernels of code that is not the package's own run only where they agree with XLA.

A scene, law, gauge or stepper of the user's may use any function of jax, and a fault in its translation would give
wrong numbers in silence. So before a kernel of such a scene runs, whatever asked for it, the scene's first steps are
compared with XLA ([vibrojax.sweep.engine.agreement][]); if they differ, XLA runs everything of the scene. The verdict
is kept in the cache, under the text of what was compared and of each kernel that may run, so that a scene is compared
once. The package's own scenes and laws are compared in the tests, with the versions below, and here only with newer
ones.
"""

import threading
import types
import warnings
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache, lru_cache, partial
from hashlib import sha256
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import llvmlite
import numpy as np
from jaxlib import version as jaxlib

from vibrojax.compile.kernels import Untranslatable, made
from vibrojax.compile.kernels import cache as store
from vibrojax.errors import InputError
from vibrojax.measures import recorder_for
from vibrojax.models.scenes import Scene
from vibrojax.stepping import Located, Stepper
from vibrojax.sweep.engine.agreement import FIRST, Comparison
from vibrojax.sweep.engine.programs import Given, Kind

TESTED = {"jax": ("0.10.2", "0.12.0.1"), "llvmlite": ("0.50.0",)}
"""Versions with which all tests have passed, oldest first."""

SPREAD = 0.02
"""Relative distance of a parameter between one default lane and the next."""

AGREES = b"agrees"


class KernelRefused(UserWarning):
    """A kernel and XLA differ, so that XLA runs the lanes of a scene."""


class Subject(NamedTuple):
    """What one comparison is of: a scene under a stepper, in one precision, with or without derivatives."""

    scene: Scene[Any]
    stepper: Stepper
    derives: bool
    precision: str


_verdicts: dict[Subject, bytes] = {}
"""The comparisons of this process: `AGREES`, or the line that says how they differ."""

_refused: dict[Scene[Any], str] = {}
"""Scenes that XLA runs, and why."""

_checked: set[str] = set()
"""Keys of kernels that may run."""

_locks: defaultdict[Scene[Any], threading.Lock] = defaultdict(threading.Lock)
_lock = threading.Lock()


def run(
    function: Callable[..., Any],
    static: tuple[Hashable, ...],
    *arguments: Any,
    registers: int = 1,
    derives: bool = False,
) -> Any:
    """Return `function(*static, *arguments)` by a kernel that may be trusted.

    **Arguments:** `registers`: as of `vibrojax.compile.kernels.Kernel`; `derives`: whether the function takes
    derivatives.

    **Raises:** `Untranslatable` if no kernel can be made, or if kernels of this scene differ from XLA.
    """
    kind = _kind(static)
    if kind is None or not (is_foreign(kind) or newer_than_tested()):
        return made(function, static, *arguments, registers=registers)(*arguments)
    if kind.scene in _refused:
        raise Untranslatable(_refused[kind.scene])
    kernel = made(function, static, *arguments, registers=registers)
    if kernel.key not in _checked:
        with _lock:
            lock = _locks[kind.scene]
        with lock:
            _check(kernel.key, kind, derives, arguments)
    return kernel(*arguments)


def _check(key: str, kind: Kind, derives: bool, arguments: tuple[Any, ...]) -> None:
    """Let the kernel with this key run, or raise `Untranslatable`; the first time of a scene, warn."""
    if kind.scene in _refused:
        raise Untranslatable(_refused[kind.scene])
    kept = _name(key)
    if store.read(kept) != AGREES:
        subject = Subject(kind.scene, kind.stepper, derives, jnp.result_type(float).name)
        if subject not in _verdicts:
            try:
                _verdicts[subject] = _verdict(kind, derives, arguments)
            except Untranslatable as error:  # a part of the scene that this kernel does not need
                _refused[kind.scene] = str(error)
                raise
        verdict = _verdicts[subject]
        if verdict != AGREES:
            _refused[kind.scene] = verdict.decode()
            warnings.warn(_refused[kind.scene], KernelRefused, stacklevel=2)
            raise Untranslatable(_refused[kind.scene])
        store.write(kept, verdict)
    _checked.add(key)


def _verdict(kind: Kind, derives: bool, arguments: tuple[Any, ...]) -> bytes:
    """Compare kernels of a scene with XLA, on the lanes of a call if it has any, unless the cache has the verdict."""
    comparison = Comparison(kind, _given(kind, arguments), derives)
    kept = _name(comparison.key)
    verdict = store.read(kept)
    if verdict is None:
        differs = comparison.difference()
        line = differs and (
            f'scene "{kind.scene.name}": its kernel and XLA differ by {differs.relative:.1e} in {differs.quantity}; '
            "XLA runs its lanes, which takes longer"
        )
        verdict = line.encode() if line else AGREES
        store.write(kept, verdict)
    return verdict


def _name(key: str) -> str:
    """Return under which key the cache keeps the verdict on kernels."""
    return sha256("\n".join(("agreement 1", key, jax.__version__, jaxlib.__version__)).encode()).hexdigest()


def _kind(static: Iterable[Any]) -> Kind | None:
    """Return what is compared for a program with these static arguments; None if they have no scene."""
    flat = [x for item in static for x in (item if isinstance(item, Kind) else (item,))]
    kind = next((item for item in static if isinstance(item, Kind)), None)
    scene = next((x for x in flat if isinstance(x, Scene)), None)
    if kind is not None or scene is None:
        return kind
    stepper = next((x for x in flat if isinstance(x, Stepper)), Located())
    return Kind(scene, stepper, _recorder(scene), scene.starts)


@lru_cache
def _recorder(scene: Scene[Any]) -> Any:
    """Return the recorder of a scene; None if nothing can be measured of it."""
    try:
        return recorder_for(scene)
    except InputError:
        return None


def _given(kind: Kind, arguments: tuple[Any, ...]) -> Given:
    """Return the lanes of a call: its own, or their parameters with the scene's starts, or the defaults and near."""
    own = next((x for x in arguments if isinstance(x, Given)), None)
    if own is not None:
        return own
    dtype, lanes = jnp.result_type(float), np.arange(FIRST)
    parameters = kind.scene.parameters()
    known = next((x for x in arguments if isinstance(x, Mapping) and set(parameters) <= set(x)), None)
    if known is None:
        values = {name: one.default * (1 + SPREAD * lanes) for name, one in parameters.items()}
    else:
        values = {name: np.resize(np.asarray(known[name]), FIRST) for name in parameters}
    starts = lanes % max(len(kind.starts), 1)
    return Given({name: x.astype(dtype) for name, x in values.items()}, starts.astype(np.int32))


@cache
def newer_than_tested() -> bool:
    """Return whether jax or llvmlite is newer than every version that was tested."""
    return any(
        _numbers(installed) > max(map(_numbers, TESTED[package]))
        for package, installed in (("jax", jax.__version__), ("llvmlite", llvmlite.__version__))
    )


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("+")[0].split(".") if part.isdecimal())


LIBRARIES = ("vibrojax", "builtins", "functools", "typing", "numpy", "jax", "jaxlib")
"""Packages whose objects are not foreign, unless they hold what is."""


@cache
def is_foreign(kind: Kind) -> bool:
    """Return whether a scene, its laws, its gauges or its stepper hold code from outside the package.

    A `vj.FrictionLaw` is an object of the package that holds the functions of its user, so fields and closures count.
    """
    seen: set[int] = set()

    def foreign(x: Any) -> bool:
        if id(x) in seen:
            return False
        seen.add(id(x))
        module = getattr(x if isinstance(x, types.FunctionType | type) else type(x), "__module__", None) or ""
        return module.split(".")[0] not in LIBRARIES or any(map(foreign, _inside(x)))

    return foreign(kind)


def _inside(x: Any) -> Iterator[Any]:
    """Yield what an object holds that may be code: items, fields, and what a function encloses or wraps."""
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
            with suppress(ValueError):  # it is empty
                yield cell.cell_contents
    elif not isinstance(x, type | types.ModuleType):
        yield from getattr(x, "__dict__", {}).values()
