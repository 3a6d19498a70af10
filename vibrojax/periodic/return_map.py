"""The Poincaré return map and its derivative, from one section crossing to the next, through all events on the way.

For a scene driven by pulses the map is stroboscopic: from the beginning of one pulse to the beginning of the next.

Event times are located, so the map is that of the exact motion within the tolerance of the step-size control.
Forward-mode derivatives include the implicit derivative of each event time, hence the saltation matrices of all events
(Leine and Nijmeijer, *Dynamics and Bifurcations of Non-Smooth Mechanical Systems*, 2004, chapter 7).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.section import lowest, rising
from vibrojax.models.arrays import Array, Flags, Lanes, Real
from vibrojax.models.scenes import Driven, HasContact, Scene
from vibrojax.models.scenes.declared import Section, Values
from vibrojax.periodic.margin import Margin
from vibrojax.stepping import Accuracy, Goal, Lane, Step, Stepper, lane_at
from vibrojax.sweep.engine.compiler import lane_function

MOST_STEPS = 4000
"""Default limit of steps between two section crossings; the usual drill takes about fifty."""


class ReturnEvents(NamedTuple):
    """Events and state ranges of a motion between two section crossings; each (lanes,) unless stated otherwise.

    - `returned`: True if the section was reached; `impacts`: number of impacts; `steps`: number of steps.
    - `mode_changes` (modes, 3, lanes): numbers of changes of each mode to the values -1, 0 and 1.
    - `margin`: grazing margin, see [vibrojax.periodic.margin][].
    - `least`, `greatest` (states, lanes): smallest and greatest values of the return map's states.
    """

    returned: Flags
    impacts: Lanes
    steps: Lanes
    mode_changes: Array
    margin: Lanes
    least: Array
    greatest: Array


class Mapped(NamedTuple):
    """Images under the return map, with their derivatives.

    - `state` (states, lanes): state at the next section crossing; `time` (lanes,): time until that crossing [s].
    - `jacobian` (states, states and parameters, lanes): derivatives of the image with respect to the initial state and
      the parameters.
    - `seen`: events on the way.
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
    seen: ReturnEvents


@lane_function(static=3, derives=True)
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

    - `along`: names of the parameters with respect to which the map is differentiated.
    - `p`: all parameters by name, each (lanes,).
    - `state` (states, lanes): values of `scene.return_states`.
    - `most_steps`: step limit; a lane that exceeds the limit counts as not returning to the section.
    """
    rows = state.shape[0]

    def image(unknowns: Array) -> tuple[tuple[Array, Lanes], ReturnEvents]:
        varied = dict(zip(along, unknowns[rows:], strict=True))
        begin = jax.lax.stop_gradient(at_section(scene, state))
        c = scene.scaled(scene.constants(p | varied), begin)
        return one_return(scene, stepper, c, unknowns[:rows], accuracy, most_steps)

    def derivative(tangent: Array) -> Any:
        (there, time), (moved, _), seen = jax.jvp(image, (unknowns,), (tangent,), has_aux=True)
        return there, time, moved, seen

    unknowns = jnp.stack([*state, *(p[name] for name in along)])
    basis = jnp.broadcast_to(jnp.eye(len(unknowns), dtype=state.dtype)[:, :, None], (len(unknowns), *unknowns.shape))
    there, time, moved, seen = jax.vmap(derivative, out_axes=(None, None, 1, None))(basis)
    return Mapped(there, time, moved, seen)


def at_section(scene: Scene[Any], state: Array) -> Values:
    """Return all states of the scene at the section, each (lanes,), from the return map's states (states, lanes).

    States that do not belong to the return map are zero.
    """
    rows = dict(zip(scene.return_states, state, strict=True))
    zero = jnp.zeros_like(state[0])
    return tuple(rows.get(name, zero) for name in scene.state_names)


def one_return(
    scene: Scene[Any], stepper: Stepper, c: Any, state: Array, accuracy: Accuracy, most_steps: Real = MOST_STEPS
) -> tuple[tuple[Array, Lanes], ReturnEvents]:
    """Return ((image under the return map, time [s] until the image), events on the way).

    The function is pure, hence differentiable.

    **Arguments:** `c`: the scene's constants, scaled for the motion; `state` (states, lanes): state at the section.
    """
    section = scene.section
    margin = Margin(scene, section, c)
    lane = lane_at(scene, c, at_section(scene, state))
    zero = jnp.zeros_like(state[0])
    none = jnp.zeros_like(zero, bool)
    own = jax.lax.stop_gradient(_map_state(scene, lane))
    changes = jnp.zeros((max(len(scene.modes), 1), 3, *zero.shape), zero.dtype)
    begin = _Flight(lane, zero, none, ReturnEvents(none, zero, zero, changes, jnp.full_like(zero, jnp.inf), own, own))

    def is_moving(flight: _Flight) -> Flags:
        return ~flight.seen.returned & (flight.seen.steps < most_steps) & jnp.isfinite(flight.lane.state[0])

    def advance(flight: _Flight) -> _Flight:
        moving = is_moving(flight)
        lane, step = stepper.step(scene, c, flight.lane, accuracy, Goal(jnp.inf, moving), marked=True)
        armed, returns = passed(scene, section, c, flight.armed, step)
        seen = flight.seen
        own = jax.lax.stop_gradient(_map_state(scene, lane))
        seen = ReturnEvents(
            returned=seen.returned | (returns & moving),
            impacts=seen.impacts + _impacts(scene, c, step),
            steps=seen.steps + moving.astype(seen.steps.dtype),
            mode_changes=seen.mode_changes + _mode_changes(step.mode, lane.mode),
            margin=jnp.where(moving, margin.after(seen.margin, flight.armed, lane, step), seen.margin),
            least=jnp.minimum(seen.least, own),
            greatest=jnp.maximum(seen.greatest, own),
        )
        return _Flight(lane, flight.time + step.dt, jnp.where(moving, armed, flight.armed), seen)

    flight = jax.lax.while_loop(lambda flight: jnp.any(is_moving(flight)), advance, begin)
    return (_map_state(scene, flight.lane), flight.time), flight.seen


def _map_state(scene: Scene[Any], lane: Lane) -> Array:
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
    if not isinstance(scene, HasContact):
        return jnp.zeros_like(step.dt)
    return scene.impact_begins(c, step.mode, step.after, step.hits).astype(step.dt.dtype)
