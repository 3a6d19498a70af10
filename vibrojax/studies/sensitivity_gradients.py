"""Features of orbits as functions of JAX arrays, with gradients by the implicit function theorem: `as_jax`."""

import _thread
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax.errors import InputError, Place, shown
from vibrojax.periodic.derivatives import MARGIN, STABILITY, orbit_variables
from vibrojax.physics.arrays import Array, check_untraced
from vibrojax.physics.parameters import Parameter
from vibrojax.scenes import Scene
from vibrojax.settings.toml import plain
from vibrojax.settings.values import quantity
from vibrojax.studies.sensitivity_branch import Branch
from vibrojax.studies.sensitivity_maps import read_names, read_orbit_point

OUTSIDE = ("nearest", "nan")

VALID, LOGARITHM = "valid", "margin"
"""Names of the outputs in addition to the features: whether the point has an orbit, and the stability margin."""

R = TypeVar("R")

POLL_SECONDS = 1e-3
"""Interval at which the main thread's stack is inspected after Ctrl-C."""

_JAX = str(Path(jax.__file__).parent)
_PENDING = threading.Event()


class OrbitFunction:
    """Function of an array of parameters that gives features of a periodic orbit, made by [vibrojax.as_jax][].

    `f(x)` returns a dict of scalars: the features, `margin`, `grazing_margin` and `valid`. It works within `jax.grad`,
    `jax.jit` and `jax.vmap`, and can be pickled. `f.reason(x)` returns why `f` is not valid at `x`.
    """

    def __init__(self, branch: Branch, of: Sequence[str], outside: str) -> None:
        self._made_of = branch, tuple(of), outside
        self._outputs = {name: branch.of.index(name) for name in of}
        self._outputs |= {LOGARITHM: branch.of.index(STABILITY), MARGIN: branch.of.index(MARGIN)}
        self._branch, self._features = branch, _features(branch, outside)

    def __reduce__(self) -> tuple[Any, ...]:
        return OrbitFunction, self._made_of

    def __call__(self, x: Any) -> dict[str, jax.Array]:
        """Return the features at `x` (parameters,) as a dict of scalars."""
        x = self._checked(jnp.asarray(x))
        dtype = jnp.result_type(float, x.dtype)
        x = x.astype(dtype if dtype.itemsize >= jnp.dtype(jnp.float32).itemsize else jnp.float32)
        features = self._features
        if jax.sharding.AxisType.Explicit in jax.typeof(x).sharding.mesh.axis_types:
            if jax.sharding.get_abstract_mesh().empty:
                raise InputError("as_jax: the array's mesh has explicit axes; call it inside of jax.set_mesh(mesh)")
            features = jax.sharding.auto_axes(features, out_sharding=jax.sharding.PartitionSpec())
        results = features(x)
        await_interrupt()
        values = {name: results[index] for name, index in self._outputs.items()}
        return values | {VALID: jax.lax.stop_gradient(results[-1]) > 0.5}

    def reason(self, x: Any) -> str:
        """Return why the function is not valid at `x` (parameters,), or "none" where it is valid.

        The first word is "undefined" (not a number, or the orbit lacks a feature or a derivative), "no-orbit" (there is
        no first orbit), "beyond-branch" (the orbit ends on the way from the first one) or "unstable".
        """
        check_untraced(Place("as_jax", "reason").error, x)
        return self._branch.reason(np.array(self._checked(np.asarray(x)), float))

    def _checked(self, x: Any) -> Any:
        names = self._branch.by
        if x.shape != (len(names),):
            expected = f"({len(names)},), one number for each of {', '.join(names)}"
            raise InputError(f"as_jax: the array has the shape {x.shape}; give {expected}")
        return x

    def __repr__(self) -> str:
        branch, start = self._branch, self._branch.point.start
        begin = "the first point" if branch.at is None else branch.described(branch.at)
        since = "" if start is None else f" start {shown(start)} at"
        outputs = ", ".join([*self._outputs, VALID])
        return f"<as_jax {shown(branch.point.scene)}: [{', '.join(branch.by)}] -> {outputs}; orbit from{since} {begin}>"


def as_jax(
    scene: str | Scene[Any],
    *,
    of: str | Sequence[str],
    by: str | Sequence[str],
    start: str | Sequence[float] | None = None,
    at: Sequence[float] | Array | None = None,
    outside: str = "nearest",
    **fixed: Any,
) -> OrbitFunction:
    """Return a function of JAX arrays that gives features of a periodic orbit, and that JAX can differentiate.

        f = vj.as_jax("vibro-impact", of=["impact_energy"], by=["beta", "gamma"], start="stuck", delta=0.005)
        f(jnp.array([0.4, 0.75]))  # {"impact_energy": ..., "margin": ..., "grazing_margin": ..., "valid": ...}
        jax.grad(lambda x: f(x)["impact_energy"])(jnp.array([0.4, 0.75]))

    At its first use, the function finds the first orbit: the one on which the motion from `start` settles at the point
    `at`. From then on it follows this orbit, which is continued to other parameters on the straight line. The result at
    a point therefore does not depend on other calls or on other points of a batch. Without `at`, the first point that
    is evaluated takes its place. The gradients are those of [vibrojax.sensitivity][]: by the implicit function theorem
    at the orbit, through all events. `jax.grad`, `jax.jacfwd`, `jax.jacrev`, `jax.jit` and `jax.vmap` work, so do
    optimizers that use them. A batch of `jax.vmap` is computed at once. Second derivatives are not available.

    The function is valid as long as the orbit exists, has the same numbers of section crossings and impacts, and is
    stable. Beyond a graze, a fold or a border of the regime there is no such orbit: the result then belongs to the last
    orbit on the straight line from the first one. An orbit that has become unstable is continued, with a
    positive `margin`, so that stability can be a smooth constraint; it is not valid either. `f.reason(x)` returns the
    reason as text.

    Orbits are computed in float64, whatever the type of the argument is. Results have the type of the argument, at
    least float32.

    **Arguments:**

    - `scene`, `start`, `fixed` (SI): as in `simulate`.
    - `of`: features of orbits, as in `sensitivity`; `by`: parameters, in the order of the array.
    - `at`: values of the parameters `by` at which the motion from `start` settles on the first orbit.
    - `outside`: "nearest" for the values and gradients of the nearest orbit where the function is not valid, or "nan".

    **Returns:** a function of an array (parameters,), which returns a dict of scalars: the features `of`, `margin`,
    `grazing_margin`, and the boolean `valid`. `margin` is the natural logarithm of the largest modulus of the
    multipliers, negative if stable, and `grazing_margin` the distance from a change in the order of events. Features
    are NaN if no motion from `start` is periodic at the first point or near it, or if the orbit does not have them
    (without impacts, an impact velocity). The function can be pickled, with its first orbit.

    **Raises:** `InputError` for an unknown name or a wrong value.

    **Example:**

    >>> import jax, jax.numpy as jnp
    >>> f = vj.as_jax("vibro-impact", of="period", by=["beta", "gamma"], start="stuck", delta=0.005)
    >>> x = jnp.array([0.4, 0.75])
    >>> f"{f(x)['period']:.4f} s, {bool(f(x)['valid'])}"
    '0.2296 s, True'
    >>> " ".join(f"{slope:.3f}" for slope in jax.grad(lambda x: f(x)["period"])(x))
    '-0.027 -0.056'
    >>> f.reason([0.4, 0.2]).partition(":")[0]
    'beyond-branch'
    """
    place = Place("as_jax")
    if outside not in OUTSIDE:
        raise place.at("outside").error(f"{shown(outside)} is unknown; choose from {', '.join(OUTSIDE)}")
    point = read_orbit_point(place, scene, fixed, start)
    names = read_names(place.at("of"), of, orbit_variables(point.system))
    table = point.system.parameters()
    parameters = read_names(place.at("by"), by, table)
    for name in parameters:
        if name in fixed:
            raise place.at(name).error("is in `by` as well; give it in one of the two")
    first = None if at is None else _read_values(place.at("at"), at, {name: table[name] for name in parameters})
    return OrbitFunction(Branch(point, names, parameters, first), names, outside)


def _read_values(place: Place, value: object, table: Mapping[str, Parameter]) -> Float[np.ndarray, " by"]:
    """Return the validated values of the parameters of `table`."""
    values = plain(place, value)
    if not isinstance(values, list) or len(values) != len(table):
        raise place.error(f"{shown(values)} does not fit; give a list of one number for each of {', '.join(table)}")
    rows = enumerate(zip(values, table.values(), strict=True))
    return np.array([quantity(place.item(k), x, parameter) for k, (x, parameter) in rows])


def _features(branch: Branch, outside: str) -> Callable[[jax.Array], jax.Array]:
    """Return the function from parameters to features (and, as the last number, 1 if valid), with its derivatives."""
    count, size = len(branch.of) + 1, len(branch.by)

    def compute(dtype: np.dtype, words: Any) -> tuple[np.ndarray, ...]:
        """Return features (..., features) and derivatives (..., features, by) at the points (..., by)."""
        x = np.ascontiguousarray(words).view(dtype)
        points = np.ascontiguousarray(x.reshape(-1, size), float)
        features = deferring_interrupts(lambda: branch.evaluate(points), branch.unknown(len(points)))
        values = np.concatenate([features.values, features.valid[:, None]], axis=1)
        has_orbit = np.isfinite(features.reached).all(axis=1)[:, None, None]
        slopes = np.where(has_orbit & ~np.isfinite(features.derivatives), 0.0, features.derivatives)
        slopes = np.concatenate([slopes, np.zeros((len(values), 1, size))], axis=1)
        if outside == "nan":
            values[~features.valid, :-1] = np.nan
            slopes[~features.valid, :-1] = np.nan
        both = values[..., None], slopes
        return tuple(part.astype(dtype).view(np.uint32).reshape(*x.shape[:-1], -1) for part in both)

    @cache
    def callback(dtype: np.dtype) -> Callable[..., Any]:
        return partial(compute, dtype)  # the same function for all calls, which jax then compiles once

    @jax.custom_jvp
    @jax.jit  # outside of jit, jax cannot call back for arrays on several devices
    def both(x: jax.Array) -> Any:
        # A loop calls back from another thread. If x64 is enabled in this thread only, jax rounds doubles there; it
        # leaves words of 32 bits unchanged.
        dtype = np.dtype(x.dtype)
        words = dtype.itemsize // 4
        shapes = tuple(jax.ShapeDtypeStruct((number * words,), np.uint32) for number in (count, count * size))
        parts = jax.pure_callback(
            callback(dtype),
            shapes,
            jax.lax.bitcast_convert_type(x, jnp.uint32).reshape(-1),
            vmap_method="broadcast_all",
        )
        shape = (words,) * (words > 1)
        values, slopes = (
            jax.lax.bitcast_convert_type(part.reshape(*outer, *shape), dtype)
            for part, outer in zip(parts, ((count,), (count, size)), strict=True)
        )
        return values, slopes

    @both.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        raise InputError("as_jax: second derivatives are not available; use finite differences of the gradient")

    @jax.custom_jvp
    def features(x: jax.Array) -> jax.Array:
        return jnp.asarray(both(x)[0])

    @features.defjvp
    def _(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
        values, slopes = both(*primals)
        return values, slopes @ tangents[0]

    return features


def deferring_interrupts(compute: Callable[[], R], nothing: R) -> R:
    """Return `compute()`; upon Ctrl-C, return `nothing` and raise KeyboardInterrupt once the callback is over.

    jax reports each exception of a callback as an error of XLA. Callbacks that the program makes before it ends return
    `nothing` as well.
    """
    if _PENDING.is_set():
        return nothing
    try:
        return compute()
    except KeyboardInterrupt:
        _PENDING.set()
        caller = _caller(sys._getframe())
        instruction = caller.f_lasti if caller else 0
        threading.Thread(target=_interrupt_after, args=(caller, instruction), daemon=True).start()
        return nothing


def await_interrupt() -> None:
    """Return at once, or wait for the KeyboardInterrupt that a callback has deferred."""
    while _PENDING.is_set():
        time.sleep(POLL_SECONDS)


def _caller(frame: FrameType | None) -> FrameType | None:
    """Return the frame that runs the compiled program, outside of the functions of jax that call back, in one file."""
    file = ""
    while frame and file in ("", frame.f_code.co_filename):
        if frame.f_code.co_filename.startswith(_JAX):
            file = frame.f_code.co_filename
        frame = frame.f_back
    return frame


def _interrupt_after(caller: FrameType | None, instruction: int) -> None:
    """Interrupt the main thread when the frame `caller` has gone on from its `instruction`, or has ended."""
    main = threading.main_thread().ident or 0

    def is_busy() -> bool:
        frame = sys._current_frames().get(main)
        while frame and frame is not caller:
            frame = frame.f_back
        return frame is not None and frame.f_lasti == instruction

    while is_busy():
        time.sleep(POLL_SECONDS)
    _PENDING.clear()
    _thread.interrupt_main()
