"""Comparison of kernels with XLA on the first steps of a scene.

A kernel integrates some lanes over their first time steps. XLA computes each of these steps from the same state as the
kernel, so that rounding errors do not accumulate. The comparison covers:

- the constants, the guards, and the jumps at all events, whether the events occur or not: one event in each lane, all
  events in turn
- the state and the mode after the step
- the values that recorders and gauges accumulate and the features that they return

Functions of a scene that are called only for tables and plots of a trajectory, such as the force of a pulse, are
compared only where these values depend on them.
"""

from collections.abc import Hashable, Mapping
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from vibrojax.compile.agreement import Difference, first_difference, take_lanes
from vibrojax.compile.assembly import LANES
from vibrojax.compile.native import QUICK_LEVEL, Kernel
from vibrojax.compile.trust import Subject, newer_than_tested
from vibrojax.errors import InputError
from vibrojax.lanes.programs import LaneArguments, ProgramKey, constants_of, state_of
from vibrojax.lazy import jax, jnp
from vibrojax.measures import recorder_for
from vibrojax.scenes import Scene
from vibrojax.stepping import Accuracy, AccuracyRequest, Goal, Lane, Located, Stepper, lane_at

COMPARED_LANES = 8
"""Number of compared lanes. Compared lanes times compared steps fill the lane axis of a trace."""

COMPARED_STEPS = LANES // COMPARED_LANES
"""Number of compared steps of each lane: two to three periods of the motion of a drill."""

NOISE = 1e-11
"""Size of a state that is not zero, relative to its largest value, up to which it is a rounding error."""


class LaneProgress(NamedTuple):
    """Lanes between two steps, with the recorder's values while they settle and while they are observed."""

    lane: Lane
    settling: Any
    observed: Any


class Beginning(NamedTuple):
    """Constants of lanes, and the lanes at t = 0."""

    constants: Any
    way: LaneProgress


class ComparedStep(NamedTuple):
    """Quantities of one step. Causes come before effects, so that the first difference causes the others.

    - `guards`: value of each guard function before the step.
    - `jump`: mode and state that the event with the lane's number would give, had it occurred before the step.
    - `derivative`: directional derivative of the state after the step with respect to state and parameters before it.
    - `way`: the lanes after the step.
    - `features`: what the recorder returns after the step, by name.
    """

    guards: dict[str, Any]
    jump: Any
    derivative: Any
    way: LaneProgress
    features: dict[str, Any]


def begin(kind: ProgramKey, given: LaneArguments) -> Beginning:
    """Return lanes at t = 0, without recorder values if the scene cannot be measured."""
    scene, recorder, c = kind.scene, kind.recorder, constants_of(kind, given)
    lane = lane_at(scene, c, state_of(kind, scene.constants(given.parameters), given))
    if recorder is None:
        return Beginning(c, LaneProgress(lane, (), ()))
    settling = recorder.settling(scene, lane)
    return Beginning(c, LaneProgress(lane, settling, recorder.begin(scene, c, lane, settling)))


def step(
    kind: ProgramKey, derives: bool, given: LaneArguments, c: Any, way: LaneProgress, accuracy: Accuracy, event: Any
) -> ComparedStep:
    """Compute one step of lanes with the constants `c`, and its derivative if `derives`.

    `event`: the number of a guard in each lane, as floats.
    """
    scene, recorder, before = kind.scene, kind.recorder, way.lane

    def advance(state: tuple[Any, ...], parameters: Mapping[str, Any]) -> Any:
        own = constants_of(kind, given._replace(parameters=dict(parameters))) if derives else c
        goal = Goal(jnp.inf, jnp.ones_like(state[0], bool))
        lane, taken = kind.stepper.step(scene, own, before._replace(state=state), accuracy, goal, marked=True)
        return lane.state, (lane, taken)

    inputs, derivative = (before.state, given.parameters), None
    if derives:
        _, derivative, (lane, taken) = jax.jvp(advance, inputs, inputs, has_aux=True)
    else:
        _, (lane, taken) = advance(*inputs)
    hits = {name: jnp.zeros_like(event, bool) for name in scene.event_names}
    hits |= {name: event == number for number, name in enumerate(scene.guard_names)}
    jump = scene.after_event(c, before.mode, before.state, hits)
    after, features = LaneProgress(lane, (), ()), {}
    if recorder is not None:
        settling = recorder.settle_returns(recorder.settle(scene, c, way.settling, lane, taken))
        observed = recorder.step(scene, c, way.observed, lane, taken)
        observed = recorder.take_returns(scene, c, observed, lane, jnp.full_like(lane.state[0], 0.5))
        after, features = LaneProgress(lane, settling, observed), recorder.read(scene, c, observed)
    guards = dict(zip(scene.guard_names, scene.guard_values(c, before.mode, before.state), strict=True))
    return ComparedStep(guards, jump, derivative, after, features)


class Comparison:
    """Comparison of the first steps of the first lanes in `given`, computed by a kernel and by XLA.

    `derives`: whether the derivative of each step is compared too. **Raises:** `Untranslatable` if no kernel can be
    made.
    """

    def __init__(self, kind: ProgramKey, given: LaneArguments, derives: bool) -> None:
        dtype = np.dtype(jnp.result_type(float))
        accuracy = kind.stepper.accuracy(AccuracyRequest(precision=dtype.name), kind.scene)
        lanes = np.resize(np.arange(min(COMPARED_LANES, len(given.start))), COMPARED_LANES)
        self._given, self._accuracy = take_lanes(given, lanes), Accuracy(*(np.asarray(x, dtype) for x in accuracy))
        self._begin, self._step = partial(begin, kind), partial(step, kind, derives)
        # The comparison is of the translation. LLVM is compared too where its version is new.
        level = None if newer_than_tested() else QUICK_LEVEL
        self._begin_kernel = Kernel(self._begin, self._given, level=level)
        self._start: Beginning = self._begin_kernel(self._given)
        # Lane by lane and step by step, the events come in turn.
        events = max(len(kind.scene.guard_names), 1)
        self._events = np.add.outer(np.arange(COMPARED_STEPS), np.arange(COMPARED_LANES)).astype(dtype) % events
        arguments = self._given, *self._start, self._accuracy, self._events[0]
        self._step_kernel = Kernel(self._step, *arguments, level=level)

    @property
    def key(self) -> str:
        """Hash of the kernels that are compared with XLA."""
        return self._begin_kernel.key + self._step_kernel.key

    def difference(self) -> Difference | None:
        """Return the first quantity in which kernel and XLA differ, or None if they agree."""
        c, ways = self._start.constants, [self._start.way]
        for events in self._events[:-1]:
            ways.append(self._step_kernel(self._given, c, ways[-1], self._accuracy, events).way)
        every = jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *ways)
        state = np.abs(np.stack(every.lane.state))
        # Rounding errors decide what a motion does whose velocity, say, has decayed to rounding errors.
        known = ((state == 0) | (state > NOISE * state.max(axis=1, keepdims=True))).all(axis=0)
        lanes = np.resize(np.flatnonzero(known | ~known.any()), LANES)
        every, events = take_lanes((every, self._events.ravel()), lanes)
        given, c = take_lanes((self._given, c), lanes % COMPARED_LANES)
        difference = first_difference(self._begin, self._begin_kernel, self._given)
        return difference or first_difference(self._step, self._step_kernel, given, c, every, self._accuracy, events)


def scene_subject(static: tuple[Hashable, ...], arguments: tuple[Any, ...], derives: bool) -> Subject | None:
    """Return the scene of a call as subject of a comparison, or None if no static argument has a scene."""
    kind = next((x for x in static if isinstance(x, ProgramKey)), None)
    if kind is None:
        scene = next((x for x in static if isinstance(x, Scene)), None)
        if scene is None:
            return None
        stepper = next((x for x in static if isinstance(x, Stepper)), Located())
        kind = ProgramKey(scene, stepper, recorder_of(scene))
    return Subject(
        owner=kind.scene,
        label=f'scene "{kind.scene.name}"',
        code=kind,
        variant=(kind.stepper, derives),
        covers=((kind.stepper, False),) if derives else (),
        compare=lambda: Comparison(kind, lanes_of(kind, arguments), derives),
    )


@lru_cache
def recorder_of(scene: Scene[Any]) -> Any:
    """Return the recorder of a scene, or None if the scene has nothing to measure or its declarations are invalid."""
    try:
        return recorder_for(scene)
    except InputError:
        return None


def lanes_of(kind: ProgramKey, arguments: tuple[Any, ...]) -> LaneArguments:
    """Return lanes on which to compare a call: those among its arguments, if they have states or the scene has events.

    Otherwise, the lanes have the parameters among the arguments, or else values near the defaults, and the
    scene's initial conditions in turn; without events, states of different sizes.
    """
    given = next((x for x in arguments if isinstance(x, LaneArguments)), None)
    scene, dtype, lanes = kind.scene, jnp.result_type(float), np.arange(COMPARED_LANES)
    rests = bool(scene.start_states) and not scene.guard_names
    if given is not None and (given.states or given.carried or not rests):
        return given
    parameters = scene.parameters()
    among = (x for x in arguments if isinstance(x, Mapping) and set(parameters) <= set(x))
    known: Mapping[str, Any] | None = given.parameters if given is not None else next(among, None)
    if known is None:
        # No two lanes are equal.
        values: dict[str, Any] = {name: x.default * (1 + 0.02 * lanes) for name, x in parameters.items()}
    else:
        values = {name: np.resize(np.asarray(known[name]), COMPARED_LANES) for name in parameters}
    values = {name: x.astype(dtype) for name, x in values.items()}
    if not rests:
        return LaneArguments(values, (lanes % max(len(scene.starts), 1)).astype(np.int32))
    # At its named initial condition, a system may be at rest, where rounding errors decide what it does.
    numbers = 1 + np.arange(len(scene.start_states))
    states = tuple((0.1 * k * (-1.0) ** (k * lanes)).astype(dtype) for k in numbers)
    return LaneArguments(values, np.full(COMPARED_LANES, len(scene.starts), np.int32), states)
