"""Agreement of kernels with XLA: the first steps of a scene, computed by both.

A kernel takes some lanes through their first steps. From the state before each of these steps, XLA computes the same
step, instruction by instruction and for all of them at once, which takes a second where a compiled loop takes ten. No
rounding accumulates over steps. Compared are the constants, the guards, the jumps at all events, whether they occur or
not, the state and mode after the step, and what gauges record and read. Functions of a scene that only tables and
pictures of a trajectory call, such as the force of a pulse, take part as far as these use them.

Roundings differ between the two, and a value near a switch or a cancellation amplifies them. So the kernel also takes
each step from states that are off by a few roundings. A difference counts if it is large against what that changes.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.compile.kernels import LANES, Kernel, trace
from vibrojax.stepping import Accuracy, Goal, Lane, Wanted, lane_at
from vibrojax.sweep.engine.programs import Given, Kind, constants_of, state_of

FIRST = 8
"""Lanes that are compared."""

STEPS = LANES // FIRST
"""Steps of each: two to three periods of a drill, and as many as fill the axis of lanes of a trace."""

TOLERANCE = {"float64": 1e-10, "float32": 1e-4}
"""Relative difference that is accepted, against the largest value in all compared lanes."""

ROUNDINGS = 16
"""Roundings by which the inputs of perturbed copies are off."""

COPIES = 16
"""Perturbed copies of each step: at a tie, which rounding decides, one of so many all but surely falls otherwise."""

AMPLIFIED = 100.0
"""How many times the change of perturbed copies a difference may be."""

USUAL = 0.9
"""Part of the lanes whose change under perturbation is taken for usual: a single lane may not change by chance."""


class Way(NamedTuple):
    """Lanes between two steps: the lane, and what is recorded of it while it settles and while it is observed."""

    lane: Lane
    settling: Any
    observed: Any


class Stepped(NamedTuple):
    """One step of lanes: what the scene says of them before it, causes first, and the lanes after it.

    - `constants` of the scene; `guards`: their values; `jumps`: mode and state after each event, if it occurred.
    - `derivative` of the state after the step, along state and parameters before it.
    - `features`: what the recorder reads.
    """

    constants: Any
    guards: dict[str, Any]
    jumps: dict[str, Any]
    derivative: Any
    way: Way
    features: Any


class Difference(NamedTuple):
    """A difference between kernel and XLA: of which quantity, and how large relative to its largest value."""

    quantity: str
    relative: float


def begin(kind: Kind, given: Given) -> Way:
    """Return lanes at t = 0; of a scene that nothing measures, the lanes alone."""
    scene, recorder, c = kind.scene, kind.recorder, constants_of(kind, given)
    lane = lane_at(scene, c, state_of(kind, scene.constants(given.parameters), given))
    settling = recorder.settling(scene, lane) if recorder is not None else ()
    return Way(lane, settling, recorder.begin(scene, c, lane, settling) if recorder is not None else ())


def step(kind: Kind, derives: bool, given: Given, way: Way, accuracy: Accuracy) -> Stepped:
    """Take one step of lanes.

    **Arguments:** `derives`: whether the derivative is computed too.
    """
    scene, recorder, before = kind.scene, kind.recorder, way.lane

    def stepped(state: tuple[Any, ...], parameters: Mapping[str, Any]) -> Any:
        c = constants_of(kind, given._replace(parameters=dict(parameters)))
        goal = Goal(jnp.inf, jnp.ones_like(state[0], bool))
        lane, taken = kind.stepper.step(scene, c, before._replace(state=state), accuracy, goal, marked=True)
        return lane.state, (c, lane, taken)

    inputs, derivative = (before.state, given.parameters), None
    if derives:
        _, derivative, (c, lane, taken) = jax.jvp(stepped, inputs, inputs, has_aux=True)
    else:
        _, (c, lane, taken) = stepped(*inputs)
    none = jnp.zeros_like(before.state[0], bool)
    hits = {event: {name: none | (name == event) for name in scene.event_names} for event in scene.guard_names}
    jumps = {event: scene.after_event(c, before.mode, before.state, hits[event]) for event in scene.guard_names}
    after, features = Way(lane, (), ()), None
    if recorder is not None:
        settling = recorder.settle_returns(recorder.settle(scene, c, way.settling, lane, taken))
        observed = recorder.step(scene, c, way.observed, lane, taken)
        observed = recorder.take_returns(scene, c, observed, lane, jnp.full_like(lane.state[0], 0.5))
        after, features = Way(lane, settling, observed), recorder.read(scene, c, way.observed)
    guards = dict(zip(scene.guard_names, scene.guard_values(c, before.mode, before.state), strict=True))
    return Stepped(c, guards, jumps, derivative, after, features)


class Comparison:
    """The first steps of a scene, by kernel and by XLA.

    **Arguments:** `given`: lanes, of which the first are compared; `derives`: see `step`.

    **Raises:** `Untranslatable` if no kernel can be made.
    """

    def __init__(self, kind: Kind, given: Given, derives: bool) -> None:
        dtype = np.dtype(jnp.result_type(float))
        wanted = kind.stepper.accuracy(Wanted(precision=dtype.name), kind.scene)
        self._given = _lanes(given, np.resize(np.arange(min(FIRST, len(given.start))), FIRST))
        self._accuracy = Accuracy(*(np.asarray(x, dtype) for x in wanted))

        def begun(given: Given) -> Way:
            return begin(kind, given)

        def stepped(given: Given, way: Way, accuracy: Accuracy) -> Stepped:
            return step(kind, derives, given, way, accuracy)

        self._begun, self._stepped = begun, stepped
        self._begin = Kernel(begun, self._given)
        self._start: Way = self._begin(self._given)
        self._step = Kernel(stepped, self._given, self._start, self._accuracy)

    @property
    def key(self) -> str:
        """Digest of the kernels that are compared."""
        return self._begin.key + self._step.key

    def difference(self) -> Difference | None:
        """Return the first quantity in which kernel and XLA differ, or None if they agree."""
        ways = [self._start]
        for _ in range(STEPS - 1):
            ways.append(self._step(self._given, ways[-1], self._accuracy).way)
        every = jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *ways)
        tiled = _lanes(self._given, np.tile(np.arange(FIRST), STEPS))
        in_steps = _compared(self._stepped, self._step, (tiled, every, self._accuracy))
        return in_steps or _compared(self._begun, self._begin, (self._given,))


def _lanes(arguments: Any, lanes: np.ndarray) -> Any:
    """Return lanes by index; what has no axis of lanes stays."""
    return jax.tree.map(lambda x: np.take(x, lanes, axis=-1) if np.ndim(x) else x, arguments)


def _compared(function: Callable[..., Any], kernel: Kernel, arguments: tuple[Any, ...]) -> Difference | None:
    """Return the first difference of a kernel from XLA, for lanes that are repeated until there are `LANES`."""
    lanes = max(np.shape(x)[-1] for x in jax.tree.leaves(arguments) if np.ndim(x))
    arguments = _lanes(arguments, np.resize(np.arange(lanes), LANES))
    by_kernel = jax.tree_util.tree_flatten_with_path(kernel(*arguments))[0]
    random = np.random.default_rng(0)
    changes = [np.zeros(value.shape) for _, value in by_kernel]
    for _ in range(COPIES):
        copy = jax.tree.leaves(kernel(*jax.tree.map(lambda x: _perturbed(x, random), arguments)))
        distances = (_distance(value, other) for (_, value), other in zip(by_kernel, copy, strict=True))
        changes = [np.asarray(np.maximum(*pair)) for pair in zip(changes, distances, strict=True)]
    for (path, value), other, change in zip(by_kernel, _by_xla(function, arguments), changes, strict=True):
        relative = _relative_difference(value, other, change)
        if relative > 0:
            return Difference(jax.tree_util.keystr(path).strip("."), relative)
    return None


def _by_xla(function: Callable[..., Any], arguments: tuple[Any, ...]) -> list[np.ndarray]:
    """Evaluate a function of `LANES` lanes by XLA, one instruction after the other."""
    traced = trace(function, *arguments).jaxpr
    variables = traced.jaxpr.invars
    leaves = [jnp.asarray(x, var.aval.dtype) for x, var in zip(jax.tree.leaves(arguments), variables, strict=True)]
    with jax.debug_nans(False):  # features without a return are NaN
        return [np.asarray(x) for x in jax.core.eval_jaxpr(traced.jaxpr, traced.consts, *leaves)]


def _perturbed(x: Any, random: np.random.Generator) -> Any:
    """Return a number that is off by a few roundings; whole numbers are modes and counts, and stay."""
    x = np.asarray(x)
    if x.dtype.kind != "f" or not x.ndim:
        return x
    with np.errstate(invalid="ignore"):
        off = x * (1 + ROUNDINGS * np.finfo(x.dtype).eps * random.uniform(-1, 1, x.shape))
        return np.where(np.isfinite(x) & (x != np.round(x)), off, x).astype(x.dtype)


def _relative_difference(value: np.ndarray, other: np.ndarray, change: np.ndarray) -> float:
    """Return the largest difference that counts, relative to the largest value in its row; 0 if none counts.

    **Arguments:** `value` by the kernel, `other` by XLA; `change`: what perturbations change the kernel's value by.
    """
    distance = _distance(value, other)
    if value.dtype.kind != "f":
        return float(np.max(np.where(change > 0, 0, distance), initial=0))
    limits, sizes = np.finfo(value.dtype), np.where(np.isfinite(value), np.abs(value), 0)
    least, axis = limits.tiny / limits.eps, -1 if value.ndim else None
    scale = np.max(sizes, axis=axis, keepdims=True, initial=least)
    usual = np.quantile(change, USUAL, axis=axis, keepdims=True, method="higher")
    accepted = np.maximum(TOLERANCE[value.dtype.name] * scale, AMPLIFIED * np.maximum(change, usual))
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.max(np.where(distance > accepted, distance / scale, 0), initial=0))


def _distance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return |x - y|; 0 if both are the same, NaN included, and infinite if only one is finite; 1 of other types."""
    if x.dtype.kind != "f":
        return (x != y).astype(float)
    with np.errstate(invalid="ignore", over="ignore"):
        same = (x == y) | (np.isnan(x) & np.isnan(y))
        return np.where(same, 0, np.where(np.isfinite(x) & np.isfinite(y), np.abs(x - y), np.inf))
