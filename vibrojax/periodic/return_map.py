"""The Poincaré return map and its derivative, from one section crossing to the next, through all events on the way.

For a scene driven by pulses the map is stroboscopic: from the beginning of one pulse to the beginning of the next.

Event times are located, so the map is that of the exact motion within the tolerance of the step-size control.
Forward-mode derivatives include the implicit derivative of each event time, hence the saltation matrices of all events
(Leine and Nijmeijer, *Dynamics and Bifurcations of Non-Smooth Mechanical Systems*, 2004, chapter 7).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.compile.xla import precision, workers
from vibrojax.lanes.compiler import lane_function
from vibrojax.lazy import jax, jnp
from vibrojax.measures.section import lowest, rising
from vibrojax.periodic.margin import Margin
from vibrojax.periodic.tangent_loop import Loop
from vibrojax.physics.arrays import Array, Flags, Lanes, Real
from vibrojax.scenes import Driven, HasImpacts, Scene
from vibrojax.scenes.declared import Section, Values
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Goal, Lane, Step, Stepper, Varied, lane_at
from vibrojax.threads import in_parallel

MOST_STEPS, MOST_FORCED_STEPS = 4000.0, 40_000.0
"""Default limit of steps between two section crossings; the usual drill takes about fifty. Forced motions reach their
section at a given time, with as many steps as the fastest part of the system needs."""


Index = Int[np.ndarray, " segments"]
PerOrbit = Float[np.ndarray, " orbits"]

R = TypeVar("R")


class ReturnEvents(NamedTuple):
    """Events and state ranges of a motion between two section crossings; each (lanes,) unless stated otherwise.

    - `returned`: True if the section was reached; `impacts`: number of impacts; `steps`: number of steps.
    - `mode_changes` (modes, 3, lanes): numbers of changes of each mode to the values -1, 0 and 1.
    - `modes` (modes, 3, lanes): 1 for the value of each mode at the beginning, else 0.
    - `margin` (rows, lanes): see `Margin.total`; of a return map `Margin.ends`, which `over_period` combines.
    - `least`, `greatest` (states, lanes): smallest and greatest values of the return map's states.
    """

    returned: Flags
    impacts: Lanes
    steps: Lanes
    mode_changes: Array
    modes: Array
    margin: Array
    least: Array
    greatest: Array


class Mapped(NamedTuple):
    """Images under the return map, with their derivatives.

    `state` (states, lanes) and `time` [s] of the next section crossing; `jacobian` (states, states and parameters,
    lanes): derivatives with respect to the initial state and the parameters; `seen`: events on the way.
    """

    state: Array
    time: Lanes
    jacobian: Array
    seen: ReturnEvents


class _Flight(NamedTuple):
    """Lanes between two section crossings."""

    lane: Lane
    time: Lanes
    armed: Flags
    margins: Array
    seen: ReturnEvents


def varying(flight: _Flight) -> Any:
    """Return the parts of lanes on their way that have derivatives."""
    return flight.lane, flight.time, flight.margins, flight.seen.margin


@lane_function(static=3)
def mapped(
    scene: Scene[Any],
    stepper: Stepper,
    along: tuple[str, ...],
    p: dict[str, Lanes],
    state: Array,
    accuracy: Accuracy,
    most_steps: Real,
) -> Mapped:
    """Return the images of states at the section under the return map, and their derivatives.

    **Arguments:**

    - `along`: names of parameters with respect to which the map is differentiated in addition to the states.
    - `p`: all parameters by name, each (lanes,). `state` (states, lanes): values of `scene.return_states`.
    - `most_steps`: step limit, above which a lane counts as not returning to the section.
    """
    loop = ReturnLoop(scene, stepper, accuracy, most_steps)
    flight, moved = loop.differentiated(along, p, state)
    seen = flight.seen._replace(margin=Margin.ends(flight.margins))
    return Mapped(map_state(scene, flight.lane), flight.time, map_state(scene, moved.lane), seen)


def at_section(scene: Scene[Any], state: Array) -> Values:
    """Return all states at the section, where states that the return map (states, lanes) lacks are 0."""
    rows = dict(zip(scene.return_states, state, strict=True))
    zero = jnp.zeros_like(state[0])
    return tuple(rows.get(name, zero) for name in scene.state_names)


class ReturnLoop(NamedTuple):
    """The loop of steps from one section crossing to the next; `margin(c)` is the grazing margin that it measures."""

    scene: Scene[Any]
    stepper: Stepper
    accuracy: Accuracy
    most_steps: Real = MOST_STEPS
    margin: Callable[[Any], Margin] | None = None

    def begin(self, c: Any, state: Array) -> _Flight:
        """Return lanes at the section in a state (states, lanes). `c`: the scene's constants, scaled for the motion."""
        scene = self.scene
        lane = lane_at(scene, c, scene.onto_section(c, at_section(scene, state)))
        zero = jnp.zeros_like(state[0])
        none = jnp.zeros_like(zero, bool)
        own = jax.lax.stop_gradient(map_state(scene, lane))
        none_yet = tuple(jnp.full_like(mode, jnp.nan) for mode in lane.mode)
        modes = jnp.broadcast_to(_mode_changes(none_yet, lane.mode), (max(len(scene.modes), 1), 3, *zero.shape))
        modes = modes.astype(zero.dtype)
        margin = self._margin(c)
        margins = margin.begin(zero, lane.mode)
        seen = ReturnEvents(none, zero, zero, jnp.zeros_like(modes), modes, margin.total(margins), own, own)
        return _Flight(lane, zero, none, margins, seen)

    def continues(self, flight: _Flight) -> Flags:
        return jnp.any(self._moving(flight))

    def advance(self, c: Any, flight: _Flight) -> _Flight:
        scene, section, margin = self.scene, self.scene.section, self._margin(c)
        moving = self._moving(flight)
        lane, step = self.stepper.step(scene, c, flight.lane, self.accuracy, Goal(jnp.inf, moving), marked=True)
        armed, returns = passed(scene, section, c, flight.armed, step)
        seen = flight.seen
        margins = jnp.where(moving[None], margin.after(flight.margins, flight.armed, lane, step), flight.margins)
        own = jax.lax.stop_gradient(map_state(scene, lane))
        seen = ReturnEvents(
            returned=seen.returned | (returns & moving),
            impacts=seen.impacts + _impacts(scene, c, step),
            steps=seen.steps + moving.astype(seen.steps.dtype),
            mode_changes=seen.mode_changes + _mode_changes(step.mode, lane.mode),
            modes=seen.modes,
            margin=margin.total(margins),
            least=jnp.minimum(seen.least, own),
            greatest=jnp.maximum(seen.greatest, own),
        )
        return _Flight(lane, flight.time + step.dt, jnp.where(moving, armed, flight.armed), margins, seen)

    def differentiated(self, along: tuple[str, ...], p: dict[str, Lanes], state: Array) -> tuple[_Flight, Any]:
        """Return the lanes at the next section crossing, and derivatives with respect to states and parameters `along`.

        Derivatives have a leading axis (states and parameters); those of discrete values are None.
        """
        unknowns = jnp.stack([*state, *(p[name] for name in along)])
        rows, number = state.shape[0], len(unknowns)
        directions = jnp.broadcast_to(jnp.eye(number, dtype=state.dtype)[:, :, None], (number, *unknowns.shape))

        def begin(unknowns: Array) -> tuple[Any, _Flight]:
            return self.begin_at(p | dict(zip(along, unknowns[rows:], strict=True)), unknowns[:rows])

        ended: tuple[_Flight, Any] = self.as_loop(begin).with_tangents(directions).run(unknowns)
        return ended

    def begin_at(self, p: dict[str, Lanes], state: Array, like: Array | None = None) -> tuple[Any, _Flight]:
        """Return (the scene's constants, lanes at the section), for all parameters by name and the state.

        `like`: the state from which scales follow. Give it if derivatives with respect to the scales count, as for the
        margin.
        """
        scene = self.scene
        like = jax.lax.stop_gradient(state) if like is None else like
        c = scene.scaled(scene.constants(p), at_section(scene, like))
        return c, self.begin(c, state)

    def as_loop(self, begin: Callable[[Any], tuple[Any, _Flight]]) -> Loop:
        """Return the loop as a function of the argument of `begin`, which returns the result of `begin_at`."""
        return Loop(begin, self.advance, self.continues, varying)

    def _margin(self, c: Any) -> Margin:
        return self.margin(c) if self.margin else Margin(self.scene, self.scene.section, c, False)

    def _moving(self, flight: _Flight) -> Flags:
        most = self.most_steps if self.scene.autonomous else MOST_FORCED_STEPS
        return ~flight.seen.returned & (flight.seen.steps < most) & jnp.isfinite(flight.lane.state[0])


def map_state(scene: Scene[Any], lane: Lane) -> Array:
    """Return the states of the return map, (states, ...), of a lane or of its derivatives."""
    return jnp.stack([lane.state[scene.place(name)] for name in scene.return_states])


def _mode_changes(before: tuple[Array, ...], after: tuple[Array, ...]) -> Array:
    """Return indicators (modes, 3, lanes), 0 or 1, of the changes of each mode to the values -1, 0 and 1."""
    if not before:
        return jnp.zeros((1, 3, 1))
    rows = [[(old != new) & (new == value) for value in (-1, 0, 1)] for old, new in zip(before, after, strict=True)]
    return jnp.stack([jnp.stack(row) for row in rows]).astype(before[0].dtype)


def passed(scene: Scene[Any], section: Section | None, c: Any, armed: Flags, step: Step) -> tuple[Flags, Flags]:
    """Return two masks: the lanes that are armed after the step, and those whose step ends with a section crossing.

    As in the observation, a zero of the section's velocity is a section crossing only if the lane is armed.
    """
    if section is None:
        assert isinstance(scene, Driven)
        return armed, scene.pulse_begins(c, step.mode, step.hits)
    velocity = rising(section, step.polynomials[scene.place(section.velocity)])
    armed = armed | (lowest(velocity, step.tau) < rising(section, [section.rearm(c)])[0])
    marker = scene.marker_of(section.velocity)
    falls = step.falling[marker] if section.rising else ~step.falling[marker]
    return armed, step.hits[marker] & ~falls & armed


def _impacts(scene: Scene[Any], c: Any, step: Step) -> Lanes:
    """Return 1 for each lane in which an impact begins at the end of the step, else 0."""
    if not isinstance(scene, HasImpacts):
        return jnp.zeros_like(step.dt)
    return scene.impact_begins(c, step.mode, step.after, step.hits).astype(step.dt.dtype)


MAX_SEGMENTS_PER_CALL = 512

MIN_SEGMENTS_PER_THREAD = 64
"""Smallest number of segments per thread; with fewer, another thread costs more than it saves."""

STEPS = Accuracy(tolerance=1e-11, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps. Over the default map, multipliers deviate by up to 1.2e-8 from those at tolerance 1e-14, and
periods by up to 3e-13 s."""


class Segments:
    """A map of the segments of motions and its derivative, in float64: the return map, or the flow over given times.

    `along`, `most`: see `mapped`; `program`: `mapped`, or [vibrojax.periodic.flow_map.flowed][].
    """

    def __init__(
        self,
        scene: Scene[Any],
        along: tuple[str, ...] = (),
        steps: Accuracy = STEPS,
        most: float = MOST_STEPS,
        program: Callable[..., Any] = mapped,
    ) -> None:
        self._given = scene, Varied(), along
        self._program, self._bounds = program, bounds_of(steps, most)

    def __call__(
        self,
        parameters: Mapping[str, Float[np.ndarray, " segments"]],
        states: Float[np.ndarray, "states segments"],
        *durations: Float[np.ndarray, " segments"],
    ) -> Any:
        """Return the end of each segment, at the next section crossing or after the time of the flow.

        The last axis of all arrays is the segment.
        """
        segments = dict(parameters), states, *durations
        return over_segments(lambda *own: self._program(*self._given, *own, *self._bounds), *segments)


def bounds_of(steps: Accuracy, most: float) -> tuple[Accuracy, np.float64]:
    """Return the accuracy of steps and the limit of their number, in float64."""
    return Accuracy(*map(np.float64, steps)), np.float64(most)


def over_segments(program: Callable[..., R], *segments: Any) -> R:
    """Return `program(*segments)` in float64, in calls of some segments, which are the last axis of all arrays."""
    number = jax.tree.leaves(segments)[0].shape[-1]
    return in_calls(lambda part: program(*jax.tree.map(lambda x: x[..., part], segments)), number, workers())


def in_calls(work: Callable[[Index], R], number: int, workers: Sequence[object]) -> R:
    """Return `work(part)` in float64 for `number` segments, joined along the last axis; `part`: indices of segments."""
    by_threads = min(len(workers), number // MIN_SEGMENTS_PER_THREAD)
    calls = max(-(-number // MAX_SEGMENTS_PER_CALL), by_threads, 1)
    items = np.array_split(np.arange(number), calls)

    def call(_: object, part: Index) -> R:
        with precision("float64"):
            return work(part)

    if len(items) == 1:
        return call(workers[0], items[0])
    parts: list[Any] = [None] * len(items)
    for index, result in in_parallel(call, items, workers):
        parts[index] = result
    joined: R = jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *parts)
    return joined


@lane_function(static=1)
def _across_impacts(scene: Scene[Any], p: dict[str, Lanes], state: Array) -> list[tuple[Lanes, Array]]:
    values = at_section(scene, state)
    c = scene.scaled(scene.constants(p), values)
    places = [scene.place(name) for name in scene.return_states]
    return [(gap, jnp.stack([other[k] for k in places])) for gap, other in scene.across_impacts(c, values)]


def across_impacts(
    scene: Scene[Any], parameters: Mapping[str, PerOrbit], states: Float[np.ndarray, "orbits states"]
) -> list[tuple[PerOrbit, Float[np.ndarray, "orbits states"]]]:
    """Return the gap of each rigid impact, and the states at the section on the other side of the impact.

    See [vibrojax.scenes.Scene.across_impacts][].
    """
    own = driving_values(scene, parameters)
    with precision("float64"):
        known = scene.stops or scene.may_jump
        sides = _across_impacts(scene.driving_part(), own, np.ascontiguousarray(states.T)) if known else []
    return [(np.asarray(gap), np.asarray(other).T) for gap, other in sides]


def beyond_impacts(
    scene: Scene[Any], parameters: Mapping[str, PerOrbit], guess: Float[np.ndarray, "orbits cycles states"]
) -> tuple[np.ndarray, Bool[np.ndarray, " orbits"]]:
    """Return guesses in which states that penetrate a stop are replaced by those across the impact, and their mask."""
    count, cycles, rows = guess.shape
    states = guess.reshape(-1, rows)
    own = {name: np.repeat(x, cycles) for name, x in parameters.items()}
    for gap, other in across_impacts(scene, own, states) if count else []:
        beyond = (gap < 0) & np.isfinite(other).all(axis=1)
        states = np.where(beyond[:, None], other, states)
    new = states.reshape(count, cycles, rows)
    return new, (new != guess).any(axis=(1, 2))


def driving_values(scene: Scene[Any], parameters: Mapping[str, PerOrbit]) -> dict[str, PerOrbit]:
    """Return the parameters of the part of a scene to which the return map belongs."""
    return {name: parameters[name] for name in scene.driving_part().parameters()}
