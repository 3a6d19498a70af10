"""The flow over a given time, through all events on the way, and its derivative.

Segments of an orbit begin and end at any instants, so that orbits need no section: with the period and a phase
condition among the equations, they are followed wherever they lead.
"""

from typing import Any, NamedTuple

from vibrojax.lanes.compiler import lane_function
from vibrojax.lazy import jax, jnp
from vibrojax.periodic.return_map import _mode_changes
from vibrojax.periodic.tangent_loop import Loop
from vibrojax.physics.arrays import Array, Flags, Lanes, Real
from vibrojax.scenes import Scene
from vibrojax.stepping import Accuracy, Goal, Lane, Stepper, lane_at


class Flowed(NamedTuple):
    """Ends of segments of motions, with their derivatives.

    - `state` (states, lanes): state at the end; `jacobian` (states, states and duration and parameters, lanes).
    - `rate` (states, lanes): rate of change at the beginning.
    - `reached`: True if the end was reached; `steps`: number of steps; `mode_changes` (modes, 3, lanes).
    - `least`, `greatest` (states, lanes): smallest and greatest values of the states.
    """

    state: Array
    jacobian: Array
    rate: Array
    reached: Flags
    steps: Lanes
    mode_changes: Array
    least: Array
    greatest: Array


class _Flow(NamedTuple):
    """Lanes between the ends of a segment."""

    lane: Lane
    remaining: Lanes
    steps: Lanes
    mode_changes: Array
    least: Array
    greatest: Array


def moving_names(scene: Scene[Any]) -> list[str]:
    """Return the names of the states that do not drift and do not follow from others."""
    return [name for name in scene.state_names if name not in (*scene.drifting, *scene.redundant)]


@lane_function(static=3)
def flowed(
    scene: Scene[Any],
    stepper: Stepper,
    along: tuple[str, ...],
    p: dict[str, Lanes],
    state: Array,
    duration: Lanes,
    accuracy: Accuracy,
    most_steps: Real,
) -> Flowed:
    """Return the states after the time `duration` [s], and their derivatives.

    **Arguments:** `p`: all parameters by name, each (lanes,); `along`: those with respect to which the flow is
    differentiated in addition to the states and the duration; `state` (states, lanes): the moving states.
    """
    names = moving_names(scene)
    rows, number = len(names), len(names) + len(along)
    unknowns = jnp.stack([*state, *(p[name] for name in along)])

    def own(lane: Lane) -> Array:
        return jnp.stack([lane.state[scene.place(name)] for name in names])

    def begin(x: Array) -> tuple[Any, _Flow]:
        known = dict(zip(names, x[:rows], strict=True))
        zero = jnp.zeros_like(x[0])
        whole = tuple(known.get(name, zero) for name in scene.state_names)
        q = p | dict(zip(along, x[rows:], strict=True))
        c = scene.scaled(scene.constants(q), jax.lax.stop_gradient(whole))
        lane = lane_at(scene, c, whole)
        here = jax.lax.stop_gradient(own(lane))
        changes = jnp.zeros((max(len(scene.modes), 1), 3, *zero.shape), zero.dtype)
        return c, _Flow(lane, duration, jnp.zeros_like(zero), changes, here, here)

    def moving(flow: _Flow) -> Flags:
        return (flow.remaining > 0) & (flow.steps < most_steps) & jnp.isfinite(flow.lane.state[0])

    def advance(c: Any, flow: _Flow) -> _Flow:
        on = moving(flow)
        lane, step = stepper.step(scene, c, flow.lane, accuracy, Goal(duration, on), marked=False)
        here = jax.lax.stop_gradient(own(lane))
        return _Flow(
            lane,
            jax.lax.stop_gradient(lane.clock.until(duration)),
            flow.steps + on.astype(flow.steps.dtype),
            flow.mode_changes + _mode_changes(step.mode, lane.mode),
            jnp.minimum(flow.least, here),
            jnp.maximum(flow.greatest, here),
        )

    directions = jnp.broadcast_to(jnp.eye(number, dtype=state.dtype)[:, :, None], (number, *unknowns.shape))
    loop = Loop(begin, advance, lambda flow: jnp.any(moving(flow)), lambda flow: flow.lane)
    flow, moved = loop.with_tangents(directions).run(unknowns)
    c, first = begin(unknowns)

    def rate(lane: Lane) -> Array:
        rates = scene.field(c, lane.mode, lane.state)
        return jnp.stack([jnp.broadcast_to(rates[scene.place(name)], state[0].shape) for name in names])

    slopes = jnp.stack([moved.lane.state[scene.place(name)] for name in names])
    return Flowed(
        own(flow.lane),
        jnp.concatenate([slopes[:, :rows], rate(flow.lane)[:, None], slopes[:, rows:]], axis=1),
        rate(first.lane),
        flow.remaining <= 0,
        flow.steps,
        flow.mode_changes,
        flow.least,
        flow.greatest,
    )
