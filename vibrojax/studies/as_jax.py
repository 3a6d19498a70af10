"""Features of orbits as functions of JAX arrays, with gradients by the implicit function theorem: `as_jax`."""

import _thread
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from threading import Event, Lock, Thread, Timer
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from vibrojax.errors import InputError, Place, shown
from vibrojax.lanes.inputs import Features
from vibrojax.maps.read import Point
from vibrojax.periodic.derivatives import MARGIN, STABILITY, OrbitFeatures, differentiated, orbit_variables
from vibrojax.periodic.lane_stages import run_lanes
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.physics.arrays import Array, check_untraced
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import read_settings
from vibrojax.settings.toml import plain
from vibrojax.settings.values import choice, quantity
from vibrojax.studies.sensitivity import read_names, read_orbit_point, sweep_at

MAX_CACHED = 1024
"""Largest number of results that are kept for points that are evaluated again."""

CORRECTOR_REACH = 0.05
"""Largest distance, in half swings, between an orbit and its linear prediction. Otherwise the step is halved."""

CAUTIOUS_FRACTION, LEAST_FRACTION = 1 / 64, 1e-7
"""Steps of the continuation, as fractions of the way from the first orbit: the step below which the branch probably
ends, and the least, which is the distance of the last orbit from the end."""

SEARCHED = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Relative changes of the parameters at which the first orbit is searched, if there is none at the first point."""

_EVALUATING = Lock()
"""Held while a branch is evaluated, whose first orbit and known results several threads of jax would change."""

Points = Float[np.ndarray, "lanes by"]


class Evaluated(NamedTuple):
    """Features of orbits, and their derivatives, which are NaN where unknown.

    - `valid`: mask of the points that have a stable orbit of their own.
    - `reached`: parameters of the orbit; the point's own if the branch reaches it.
    """

    values: Float[np.ndarray, "*lanes of"]
    derivatives: Float[np.ndarray, "*lanes of by"]
    valid: Bool[np.ndarray, "*lanes"]
    reached: Float[np.ndarray, "*lanes by"]


class Branch:
    """Orbits of one scene with the same numbers of section crossings and impacts, as functions of the parameters `by`.

    The first orbit is the one on which the motion from `start` settles at the point `at`, by default the first point
    that is evaluated. It is continued to each other point on the straight line, whatever was evaluated before: see
    [vibrojax.periodic.orbits.Orbits.carry_to][].
    """

    def __init__(
        self, point: Point, of: Sequence[str], by: Sequence[str], at: Float[np.ndarray, " by"] | None = None
    ) -> None:
        self.point, self.by, self.at = point, tuple(by), at
        self.of = tuple(dict.fromkeys((*of, STABILITY, MARGIN)))
        self._first: tuple[Orbits, OrbitFeatures] | None = None
        self._begun = False
        self._cached: dict[bytes, Evaluated] = {}

    def evaluate(self, x: Points) -> Evaluated:
        """Return the features at the points `x`; without an orbit there, of the last orbit on the way from the first.

        The features of a point are the same bit for bit, whatever the other points are.
        """
        if not len(x):
            return self.unknown(0)
        with _EVALUATING, np.errstate(all="ignore"):
            keys = [row.tobytes() for row in x]
            rows = zip(keys, x, strict=True)
            new = {key: row for key, row in rows if key not in self._cached and np.isfinite(row).all()}
            if new:
                fresh = zip(*self._evaluate(np.stack([*new.values()])), strict=True)
                self._cached |= {key: Evaluated(*row) for key, row in zip(new, fresh, strict=True)}
            [none] = zip(*self.unknown(1), strict=True)
            found = [self._cached.get(key, none) for key in keys]
            self._cached = dict([*self._cached.items()][-MAX_CACHED:])
            return Evaluated(*map(np.stack, zip(*found, strict=True)))

    def reason(self, x: Float[np.ndarray, " by"]) -> str:
        """Return why the features at the point `x` are not valid, or "none"."""
        values, derivatives, valid, reached = (part[0] for part in self.evaluate(x[None]))
        if valid:
            return "none"
        if not np.isfinite(x).all():
            return f"undefined: {self.described(x)}"
        if refusal := self._refusals(x[None])[0]:
            return f"refused: {refusal}"
        if self._first is None:
            start = "" if self.point.start is None else f" from {shown(self.point.start)}"
            where = "" if self.at is None else f" at {self.described(self.at)} or near it"
            return f"no-orbit: no motion{start} settles on a stable periodic orbit{where}"
        table = dict(zip(self.of, values, strict=True))
        if (reached != x).any():
            return (
                f"beyond-branch: from {self.described(self._reached(self._first[0])[0])}, the orbit continues to "
                f"{self.described(reached)}, with margin = {table[STABILITY]:.3g}, {MARGIN} = {table[MARGIN]:.3g}"
            )
        if table[STABILITY] >= 0:
            return f"unstable: a multiplier of the orbit has the modulus {np.exp(table[STABILITY]):.6g}"
        names = [name for name, row in zip(self.of, derivatives, strict=True) if not np.isfinite(row).all()]
        return f"undefined: the orbit has no derivative of {', '.join(names)}"

    def described(self, x: Float[np.ndarray, " by"]) -> str:
        """Return the parameters of a point as text."""
        return ", ".join(f"{name} = {value:g}" for name, value in zip(self.by, x, strict=True))

    def unknown(self, size: int) -> Evaluated:
        """Return the features of points without an orbit."""
        shape = (size, len(self.of), len(self.by))
        values, slopes, reached = (np.full(x, np.nan) for x in (shape[:2], shape, shape[::2]))
        return Evaluated(values, slopes, np.zeros(size, bool), reached)

    def _evaluate(self, x: Points) -> Evaluated:
        if not self._begun:
            self.at = x[0].copy() if self.at is None else self.at
            self._first = self._begin(self.at)
            self._begun = True
        if self._first is None:
            return self.unknown(len(x))
        (first, slopes), each = self._first, np.zeros(len(x), int)

        def accept(orbits: Orbits) -> Bool[np.ndarray, " lanes"]:
            admitted = np.array([not refusal for refusal in self._refusals(self._reached(orbits))], bool)
            return (orbits.impacts == first.impacts) & ~orbits.neutral & admitted

        orbits, _ = first.of(each).carry_to(
            self._parameters(x),
            within=CORRECTOR_REACH,
            least=LEAST_FRACTION,
            cautious=CAUTIOUS_FRACTION,
            by=self.by,
            slopes=OrbitFeatures(*(part[each] for part in slopes)),
            accept=accept,
        )
        values, derivatives, *_ = orbits.derivatives(self.of, self.by)
        reached = self._reached(orbits)
        valid = (reached == x).all(axis=1) & (values[:, self.of.index(STABILITY)] < 0)
        return Evaluated(values, derivatives, valid & np.isfinite(derivatives).all(axis=(1, 2)), reached)

    def _parameters(self, x: Points) -> dict[str, np.ndarray]:
        fixed = {name: np.full(len(x), value) for name, value in self.point.parameters.items()}
        return fixed | {name: x[:, k] for k, name in enumerate(self.by)}

    @np.errstate(all="ignore")
    def _refusals(self, x: Points) -> list[str]:
        """Return for each point why no motion is computed there; empty if it is."""
        table = self.point.system.parameters()
        reason, mask = self.point.system.refused(self._parameters(x)) or ("", False)
        refused = np.broadcast_to(np.asarray(mask, bool), len(x)).tolist()
        return [
            next(
                (f"{name} {why}" for name, y in zip(self.by, row, strict=True) if (why := table[name].problem(y))),
                reason.replace("-", " ") if unfit else "",
            )
            for row, unfit in zip(x.tolist(), refused, strict=True)
        ]

    def _reached(self, orbits: Orbits) -> Points:
        return np.stack([orbits.parameters[name] for name in self.by], axis=1)

    def _begin(self, x: Float[np.ndarray, " by"]) -> tuple[Orbits, OrbitFeatures] | None:
        """Return the first orbit with its slopes: at `x`, or else the nearest of the stable orbits around it."""
        scene = self.point.system

        def compile_derivatives() -> None:  # while the first orbit is sought, which does not need them
            states, none = np.zeros((0, len(scene.driving_part().return_states))), np.zeros(0)
            every = dict.fromkeys(scene.parameters(), none)
            with suppress(Exception):  # it is raised again where a result is needed
                differentiated(scene, self.of, self.by, every, states[:, None], states, none)

        Thread(target=compile_derivatives).start()
        defaults = np.array([self.point.parameters[name] for name in self.by])
        scale = np.where(defaults == 0, 1.0, np.abs(defaults))
        corners = np.concatenate([np.eye(len(x)), -np.eye(len(x)), np.ones((1, len(x))), -np.ones((1, len(x)))])
        around = [x + share * corners * scale for share in SEARCHED]
        for points in (x[None], np.concatenate([*around, defaults[None]])):
            rows = points[[not refusal for refusal in self._refusals(points)]]
            if not len(rows):
                continue
            lanes, distance = settled_at(self.point, self.by, rows), np.abs((rows - x) / scale).max(axis=1)
            known = {
                lane: batch.of([k])
                for batch in orbits_of(scene, lanes, self._parameters(rows))
                for k, lane in enumerate(batch.lane.tolist())
                if lanes["stable"][lane] == 1
            }
            for lane in sorted(known, key=lambda lane: (distance[lane], lane)):
                orbit = Orbits.find(scene, known[lane].parameters, known[lane].states).refined()
                slopes = orbit.derivatives((), self.by)
                if np.isfinite(slopes.state_derivatives).all():
                    return orbit, slopes
        return None


def settled_at(point: Point, by: Sequence[str], rows: Points) -> Features:
    """Return the variables of lanes, with orbits, from the start of `point`, with the parameters `by` in `rows`."""
    run = read_settings(Place("run"), {"orbits": True}, point.system)
    sweep = sweep_at(point, {name: rows[:, k] for k, name in enumerate(by)}, run)
    return run_lanes(sweep.inputs(), sweep.plan).variables


VALID, LOGARITHM = "valid", "margin"
"""Names of the outputs in addition to the features: whether the point has an orbit, and the stability margin."""

INTERRUPT_SECONDS = 0.02
"""Time after which a deferred Ctrl-C interrupts the main thread: long enough for jax to return from its callbacks."""

_INTERRUPTED = Event()


class OrbitFunction:
    """Function from an array of parameters to features of a periodic orbit, made by [vibrojax.as_jax][].

    `f(x)` returns the dict that [vibrojax.as_jax][] describes, and `f.reason(x)` returns the reason why f is not valid
    at x.
    """

    def __init__(self, branch: Branch, of: Sequence[str], outside: str) -> None:
        self._made_of = branch, tuple(of), outside  # what is pickled
        self._branch, self._features = branch, _features(branch, outside)
        names = dict(zip(of, of, strict=True)) | {LOGARITHM: STABILITY, MARGIN: MARGIN}
        self._outputs = {name: branch.of.index(feature) for name, feature in names.items()}

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
        values = {name: results[index] for name, index in self._outputs.items()}
        return values | {VALID: jax.lax.stop_gradient(results[-1]) > 0.5}

    def reason(self, x: Any) -> str:
        """Return the reason why the function is not valid at `x` (parameters,), or "none" if it is valid.

        The text of a reason begins with one of these words:

        - "undefined": `x` is not finite, or the orbit lacks a feature or a derivative.
        - "refused": `simulate` rejects `x`.
        - "no-orbit": the first orbit was not found.
        - "beyond-branch": the branch of the first orbit ends between the first point and `x`.
        - "unstable": the orbit at `x` is unstable.
        """
        check_untraced(Place("as_jax", "reason").error, x)
        return self._branch.reason(np.array(self._checked(np.asarray(x)), float))

    def _checked(self, x: Any) -> Any:
        names = self._branch.by
        if x.shape != (len(names),):
            expected = f"({len(names)},), one number for each of {', '.join(names)}"
            raise InputError(f"as_jax: the array has the shape {x.shape}; give {expected}")
        if jnp.iscomplexobj(x):
            raise InputError(f"as_jax: the array has the type {x.dtype}; give real numbers")
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

    The first call of the returned function finds the orbit on which the motion settles at the *first point*: `at`, or
    the point of the call. Every further call continues the first orbit along the straight line from the first point to
    the point of the call, so results do not depend on other calls. The gradients equal the derivatives that
    [vibrojax.sensitivity][] returns. `jax.grad`, `jax.jit` and `jax.vmap` work; `jax.jacfwd` and `jax.jacrev` need the
    features without the boolean `valid`: `jax.jacfwd(lambda x: [f(x)[name] for name in ("period", "margin")])(x)`.
    Second derivatives are not available.

    The returned function is valid at points that `simulate` accepts and at which the orbit exists, is stable, and keeps
    its numbers of section crossings and impacts. At a point that is not valid, the function returns the values of the
    last valid orbit on the straight line from the first point. An orbit that becomes unstable is continued, and its
    `margin` is then positive, so that stability can be a smooth constraint.

    Orbits are computed in float64 for any type of the argument. Results have the type of the argument, at least
    float32.

    **Arguments:**

    - `scene`, `start`, `fixed` (SI): as in `simulate`.
    - `of`: features of orbits, as in `sensitivity`; `by`: parameters, in the order in which an array holds their
      values.
    - `at`: parameter values at which the motion from `start` settles on the first orbit.
    - `outside`: result where the function is not valid, "nearest" (values and gradients of the last valid orbit) or
      "nan".

    **Returns:** a function of an array (parameters,), which returns a dict of scalars: the requested features,
    `margin`, `grazing_margin`, and the boolean `valid`. `margin` is the natural logarithm of the largest modulus of the
    multipliers, and is negative if the orbit is stable. `grazing_margin` is the distance of the orbit from a change in
    the order of events. Features and their gradients are NaN if the motion from `start` is not periodic at or near the
    first point, or if the orbit lacks the feature, as an orbit without impacts lacks the impact velocity.

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
    choice(place.at("outside"), outside, ("nearest", "nan"))
    point = read_orbit_point(place, scene, fixed, start)
    names = read_names(place.at("of"), of, orbit_variables(point.system))
    table = point.system.parameters()
    parameters = read_names(place.at("by"), by, table)
    for name in parameters:
        if name in fixed:
            raise place.at(name).error("is in `by` as well; give it in one of the two")
    first = None
    if at is not None:
        units = {f"at[{k}]": table[name].unit for k, name in enumerate(parameters)}
        place, values = place.at("at"), plain(place.at("at"), at, lambda: units)
        if not isinstance(values, list) or len(values) != len(parameters):
            expected = f"give a list of one number for each of {', '.join(parameters)}"
            raise place.error(f"{shown(values)} does not fit; {expected}")
        rows = enumerate(zip(values, parameters, strict=True))
        first = np.array([quantity(place.item(k), x, table[name]) for k, (x, name) in rows])
    return OrbitFunction(Branch(point, names, parameters, first), names, outside)


def _features(branch: Branch, outside: str) -> Callable[[jax.Array], jax.Array]:
    """Return the function from parameters to features (and, as the last number, 1 if valid), with its derivatives."""
    count, size = len(branch.of) + 1, len(branch.by)

    def compute(dtype: np.dtype, words: Any) -> tuple[np.ndarray, ...]:
        """Return features (..., features) and derivatives (..., features, by) at the points (..., by)."""
        x = np.ascontiguousarray(words).view(dtype)
        points = np.ascontiguousarray(x.reshape(-1, size), float)
        # jax reports each exception of a callback as an error of XLA. Until the program has left its callbacks, which
        # return unknown features meanwhile, each interrupt is deferred once more.
        features = branch.unknown(len(points))
        try:
            features = features if _INTERRUPTED.is_set() else branch.evaluate(points)
        except KeyboardInterrupt:
            _INTERRUPTED.set()
            Timer(INTERRUPT_SECONDS, _interrupt).start()
        values = np.concatenate([features.values, features.valid[:, None]], axis=1)
        slopes = np.concatenate([features.derivatives, np.zeros((len(values), 1, size))], axis=1)
        if outside == "nan":
            values[~features.valid, :-1] = np.nan
            slopes[~features.valid, :-1] = np.nan
        both = values[..., None], slopes
        return tuple(part.astype(dtype).view(np.uint32).reshape(*x.shape[:-1], -1) for part in both)

    # The same functions for all calls, which jax then compiles once.
    callbacks = {dtype: partial(compute, dtype) for dtype in map(np.dtype, (np.float32, np.float64))}

    @jax.custom_jvp
    @jax.jit  # outside of jit, jax cannot call back for arrays on several devices
    def both(x: jax.Array) -> Any:
        # A loop calls back from another thread. If x64 is enabled in this thread only, jax rounds doubles there; it
        # leaves words of 32 bits unchanged.
        dtype = np.dtype(x.dtype)
        words, shapes = dtype.itemsize // 4, ((count,), (count, size))
        given = jax.lax.bitcast_convert_type(x, jnp.uint32).reshape(-1)
        flat = [jax.ShapeDtypeStruct((int(np.prod(shape)) * words,), np.uint32) for shape in shapes]
        parts = jax.pure_callback(callbacks[dtype], flat, given, vmap_method="broadcast_all")
        halves = (words,) * (words > 1)
        arrays = (part.reshape(*shape, *halves) for part, shape in zip(parts, shapes, strict=True))
        return tuple(jax.lax.bitcast_convert_type(array, dtype) for array in arrays)

    @both.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        raise InputError("as_jax: second derivatives are not available; use finite differences of the gradient")

    @jax.custom_jvp
    def features(x: jax.Array) -> jax.Array:
        return jnp.asarray(both(x)[0])

    @features.defjvp
    def _(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
        values, slopes = both(*primals)
        # An unknown slope is NaN, and yet 0 times it is 0 in both modes: a feature that is not used, whose cotangent is
        # 0, does not affect gradients. The product in this order, which is its own transpose, overflows before it meets
        # the 0 in place of the slope, unless it is 0 itself.
        known = jnp.isfinite(slopes)
        huge = jnp.where(known, 1.0, jnp.finfo(slopes.dtype).max)
        return values, (tangents[0][None] * huge * huge * jnp.where(known, slopes, 0.0) * huge * huge).sum(axis=-1)

    return features


def _interrupt() -> None:
    _INTERRUPTED.clear()
    _thread.interrupt_main()
