"""Comparison of kernels with XLA on the first steps of a scene.

A kernel integrates some lanes over their first time steps. XLA computes each of these steps from the same state as the
kernel, so that rounding errors do not accumulate. The comparison covers:

- the constants, the guards, and the jumps at all events, whether the events occur or not
- the state and the mode after the step
- the values that recorders and gauges accumulate and the features that they return

Functions of a scene that are called only for tables and plots of a trajectory, such as the force of a pulse, are
compared only where these values depend on them.
"""

from collections.abc import Hashable, Mapping
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.compile import Subject
from vibrojax.compile.agreement import Difference, first_difference, take_lanes
from vibrojax.compile.kernels import LANES, Kernel
from vibrojax.errors import InputError
from vibrojax.measures import recorder_for
from vibrojax.models.scenes import Scene
from vibrojax.stepping import Accuracy, AccuracyRequest, Goal, Lane, Located, Stepper, lane_at
from vibrojax.sweep.engine.programs import Given, Kind, constants_of, state_of

COMPARED_LANES = 8
"""Number of compared lanes. Compared lanes times compared steps fill the lane axis of a trace."""

COMPARED_STEPS = LANES // COMPARED_LANES
"""Number of compared steps of each lane: two to three periods of the motion of a drill."""


class LaneProgress(NamedTuple):
    """Lanes between two steps, with the recorder's values while they settle and while they are observed."""

    lane: Lane
    settling: Any
    observed: Any


class ComparedStep(NamedTuple):
    """Quantities of one step. Causes come before effects, so that the first difference causes the others.

    - `guards`: value of each guard function before the step.
    - `jumps`: mode and state that each event would give, had it occurred before the step.
    - `derivative`: directional derivative of the state after the step with respect to state and parameters before it.
    - `way`: the lanes after the step.
    """

    constants: Any
    guards: dict[str, Any]
    jumps: dict[str, Any]
    derivative: Any
    way: LaneProgress
    features: Any


def begin(kind: Kind, given: Given) -> LaneProgress:
    """Return lanes at t = 0, without recorder values if the scene cannot be measured."""
    scene, recorder, c = kind.scene, kind.recorder, constants_of(kind, given)
    lane = lane_at(scene, c, state_of(kind, scene.constants(given.parameters), given))
    if recorder is None:
        return LaneProgress(lane, (), ())
    settling = recorder.settling(scene, lane)
    return LaneProgress(lane, settling, recorder.begin(scene, c, lane, settling))


def step(kind: Kind, derives: bool, given: Given, way: LaneProgress, accuracy: Accuracy) -> ComparedStep:
    """Compute one step of lanes, and its derivative if `derives`."""
    scene, recorder, before = kind.scene, kind.recorder, way.lane

    def advance(state: tuple[Any, ...], parameters: Mapping[str, Any]) -> Any:
        c = constants_of(kind, given._replace(parameters=dict(parameters)))
        goal = Goal(jnp.inf, jnp.ones_like(state[0], bool))
        lane, taken = kind.stepper.step(scene, c, before._replace(state=state), accuracy, goal, marked=True)
        return lane.state, (c, lane, taken)

    inputs, derivative = (before.state, given.parameters), None
    if derives:
        _, derivative, (c, lane, taken) = jax.jvp(advance, inputs, inputs, has_aux=True)
    else:
        _, (c, lane, taken) = advance(*inputs)
    none = jnp.zeros_like(before.state[0], bool)
    hits = {event: {name: none | (name == event) for name in scene.event_names} for event in scene.guard_names}
    jumps = {event: scene.after_event(c, before.mode, before.state, hits[event]) for event in scene.guard_names}
    after, features = LaneProgress(lane, (), ()), None
    if recorder is not None:
        settling = recorder.settle_returns(recorder.settle(scene, c, way.settling, lane, taken))
        observed = recorder.step(scene, c, way.observed, lane, taken)
        observed = recorder.take_returns(scene, c, observed, lane, jnp.full_like(lane.state[0], 0.5))
        after, features = LaneProgress(lane, settling, observed), recorder.read(scene, c, way.observed)
    guards = dict(zip(scene.guard_names, scene.guard_values(c, before.mode, before.state), strict=True))
    return ComparedStep(c, guards, jumps, derivative, after, features)


class Comparison:
    """Comparison of the first steps of the first lanes in `given`, computed by a kernel and by XLA.

    `derives`: whether the derivative of each step is compared too. **Raises:** `Untranslatable` if no kernel can be
    made.
    """

    def __init__(self, kind: Kind, given: Given, derives: bool) -> None:
        dtype = np.dtype(jnp.result_type(float))
        accuracy = kind.stepper.accuracy(AccuracyRequest(precision=dtype.name), kind.scene)
        lanes = np.resize(np.arange(min(COMPARED_LANES, len(given.start))), COMPARED_LANES)
        self._given, self._accuracy = take_lanes(given, lanes), Accuracy(*(np.asarray(x, dtype) for x in accuracy))
        self._begin, self._step = partial(begin, kind), partial(step, kind, derives)
        self._begin_kernel = Kernel(self._begin, self._given)
        self._start: LaneProgress = self._begin_kernel(self._given)
        self._step_kernel = Kernel(self._step, self._given, self._start, self._accuracy)

    @property
    def key(self) -> str:
        """Hash of the kernels that are compared with XLA."""
        return self._begin_kernel.key + self._step_kernel.key

    def difference(self) -> Difference | None:
        """Return the first quantity in which kernel and XLA differ, or None if they agree."""
        ways = [self._start]
        for _ in range(COMPARED_STEPS - 1):
            ways.append(self._step_kernel(self._given, ways[-1], self._accuracy).way)
        every = jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *ways)
        repeated = take_lanes(self._given, np.tile(np.arange(COMPARED_LANES), COMPARED_STEPS))
        in_steps = first_difference(self._step, self._step_kernel, repeated, every, self._accuracy)
        return in_steps or first_difference(self._begin, self._begin_kernel, self._given)


def scene_subject(static: tuple[Hashable, ...], arguments: tuple[Any, ...], derives: bool) -> Subject | None:
    """Return the scene of a call as subject of a comparison, or None if no static argument is a scene or a `Kind`."""
    kind = next((x for x in static if isinstance(x, Kind)), None)
    if kind is None:
        scene = next((x for x in static if isinstance(x, Scene)), None)
        if scene is None:
            return None
        stepper = next((x for x in static if isinstance(x, Stepper)), Located())
        kind = Kind(scene, stepper, recorder_of(scene), scene.starts)
    return Subject(
        owner=kind.scene,
        label=f'scene "{kind.scene.name}"',
        code=kind,
        variant=(kind.stepper, derives),
        compare=lambda: Comparison(kind, lanes_of(kind, arguments), derives),
    )


@lru_cache
def recorder_of(scene: Scene[Any]) -> Any:
    """Return the recorder of a scene, or None if the scene has nothing to measure or its declarations are invalid."""
    try:
        return recorder_for(scene)
    except InputError:
        return None


def lanes_of(kind: Kind, arguments: tuple[Any, ...]) -> Given:
    """Return lanes on which to compare a call: those among its arguments.

    If there are none, the lanes have the parameters among the arguments, or else values near the defaults, and the
    scene's initial conditions in turn.
    """
    given = next((x for x in arguments if isinstance(x, Given)), None)
    if given is not None:
        return given
    dtype, lanes = jnp.result_type(float), np.arange(COMPARED_LANES)
    parameters = kind.scene.parameters()
    known = next((x for x in arguments if isinstance(x, Mapping) and set(parameters) <= set(x)), None)
    if known is None:
        # No two lanes are equal.
        values = {name: x.default * (1 + 0.02 * lanes) for name, x in parameters.items()}
    else:
        values = {name: np.resize(np.asarray(known[name]), COMPARED_LANES) for name in parameters}
    starts = lanes % max(len(kind.starts), 1)
    return Given({name: x.astype(dtype) for name, x in values.items()}, starts.astype(np.int32))
