"""The return map: from one return to the section to the next, with its derivative, through all events on the way.

Of a scene that is driven by pulses it is from the beginning of one to that of the next: stroboscopic.

Steps are located, so the map is that of the exact motion but for their tolerance. A derivative in forward mode goes
with the time of every event (the root's implicit derivative), so that what events do to a neighbour, the saltation, is
in it (Leine and Nijmeijer, *Dynamics and Bifurcations of Non-Smooth Mechanical Systems*, 2004, chapter 7).
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
"""Of one return; one of the usual drill takes some fifty."""


class Seen(NamedTuple):
    """What is seen on the way, each (lanes,) but the ranges.

    - `returned`: whether the section was reached; `impacts` on the way; `steps` taken.
    - `entered` (modes, 3, lanes): how often each mode changed to -1, to 0 and to 1.
    - `margin`: how far the order of events is from changing, see [vibrojax.periodic.margin][].
    - `least`, `greatest` (states, lanes): of the return map's states.
    """

    returned: Flags
    impacts: Lanes
    steps: Lanes
    entered: Array
    margin: Lanes
    least: Array
    greatest: Array


class Mapped(NamedTuple):
    """Where lanes return: `state` (states, lanes), after the `time` [s]; its derivative `jacobian` (states, states and
    parameters, lanes), by the state returned to and then by that begun with, or the parameter; and what was seen."""

    state: Array
    time: Lanes
    jacobian: Array
    seen: Seen


class _Way(NamedTuple):
    """Lanes on their way to the next return."""

    lane: Lane
    time: Lanes
    armed: Flags
    seen: Seen


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
    """The next return of lanes that stand at the section, and its derivative.

    **Arguments:** `along`: names of the parameters that it is taken by too; `p`: parameters by name (lanes,); `state`
    (states, lanes): of `scene.return_states`; `most_steps`: after which a lane is taken not to return.
    """
    rows = state.shape[0]

    def go(given: Array) -> tuple[tuple[Array, Lanes], Seen]:
        varied = dict(zip(along, given[rows:], strict=True))
        begin = jax.lax.stop_gradient(at_section(scene, state))
        c = scene.scaled(scene.constants(p | varied), begin)
        return one_return(scene, stepper, c, given[:rows], accuracy, most_steps)

    def push(tangent: Array) -> Any:
        (there, time), (moved, _), seen = jax.jvp(go, (given,), (tangent,), has_aux=True)
        return there, time, moved, seen

    given = jnp.stack([*state, *(p[name] for name in along)])
    ways = jnp.broadcast_to(jnp.eye(len(given), dtype=state.dtype)[:, :, None], (len(given), *given.shape))
    there, time, moved, seen = jax.vmap(push, out_axes=(None, None, 1, None))(ways)
    return Mapped(there, time, moved, seen)


def at_section(scene: Scene[Any], state: Array) -> Values:
    """All states of the scene at the section, each (lanes,), from those of the return map (states, lanes)."""
    rows = dict(zip(scene.return_states, state, strict=True))
    zero = jnp.zeros_like(state[0])
    return tuple(rows.get(name, zero) for name in scene.state_names)


def one_return(
    scene: Scene[Any], stepper: Stepper, c: Any, state: Array, accuracy: Accuracy, most_steps: Real = MOST_STEPS
) -> tuple[tuple[Array, Lanes], Seen]:
    """((state at the next return, time [s] to it), what was seen on the way); pure, so that derivatives go through.

    **Arguments:** `c`: the scene's constants, scaled for the motion; `state` (states, lanes).
    """
    section = scene.section
    margin = Margin(scene, section, c)
    lane = lane_at(scene, c, at_section(scene, state))
    zero = jnp.zeros_like(state[0])
    none = jnp.zeros_like(zero, bool)
    own = jax.lax.stop_gradient(_own(scene, lane))
    entered = jnp.zeros((max(len(scene.modes), 1), 3, *zero.shape), zero.dtype)
    begun = _Way(lane, zero, none, Seen(none, zero, zero, entered, jnp.full_like(zero, jnp.inf), own, own))

    def one(way: _Way) -> _Way:
        moving = _active(way, most_steps)
        lane, step = stepper.step(scene, c, way.lane, accuracy, Goal(jnp.inf, moving), marked=True)
        armed, returns = passed(scene, section, c, way.armed, step)
        seen = way.seen
        own = jax.lax.stop_gradient(_own(scene, lane))
        seen = Seen(
            returned=seen.returned | (returns & moving),
            impacts=seen.impacts + _impacts(scene, c, step),
            steps=seen.steps + moving.astype(seen.steps.dtype),
            entered=seen.entered + _entered(step.mode, lane.mode),
            margin=jnp.where(moving, margin.after(seen.margin, way.armed, lane, step), seen.margin),
            least=jnp.minimum(seen.least, own),
            greatest=jnp.maximum(seen.greatest, own),
        )
        return _Way(lane, way.time + step.dt, jnp.where(moving, armed, way.armed), seen)

    way = jax.lax.while_loop(lambda way: jnp.any(_active(way, most_steps)), one, begun)
    return (_own(scene, way.lane), way.time), way.seen


def _active(way: _Way, most_steps: Real) -> Flags:
    return ~way.seen.returned & (way.seen.steps < most_steps) & jnp.isfinite(way.lane.state[0])


def _own(scene: Scene[Any], lane: Lane) -> Array:
    """The return map's states of a lane, (states, lanes)."""
    return jnp.stack([lane.state[scene.place(name)] for name in scene.return_states])


def _entered(before: tuple[Array, ...], after: tuple[Array, ...]) -> Array:
    """Which modes have changed, to -1, to 0 or to 1, (modes, 3, lanes)."""
    if not before:
        return jnp.zeros((1, 3, 1))
    rows = [[(old != new) & (new == value) for value in (-1, 0, 1)] for old, new in zip(before, after, strict=True)]
    return jnp.stack([jnp.stack(row) for row in rows]).astype(before[0].dtype)


def passed(scene: Scene[Any], section: Section | None, c: Any, armed: Flags, step: Step) -> tuple[Flags, Flags]:
    """(whether the next zero counts, whether the step ends on the section), as where lanes are observed."""
    if section is None:
        assert isinstance(scene, Driven)
        return armed, scene.pulse_begins(c, step.mode, step.hits)
    velocity = rising(section, step.polynomials[scene.place(section.velocity)])
    armed = armed | (lowest(velocity, step.tau) < rising(section, [section.rearm(c)])[0])
    marker = scene.marker_of(section.velocity)
    falls = step.falling[marker] if section.rising else ~step.falling[marker]
    return armed, step.hits[marker] & ~falls & armed


def _impacts(scene: Scene[Any], c: Any, step: Step) -> Lanes:
    """1 where an impact begins at the end of the step."""
    if not isinstance(scene, HasContact):
        return jnp.zeros_like(step.dt)
    return scene.impact_begins(c, step.mode, step.after, step.hits).astype(step.dt.dtype)
