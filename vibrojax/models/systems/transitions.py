"""Modes and states of a system after its events, and the modes in which a motion begins."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp

from vibrojax.models.scenes.declared import Values
from vibrojax.models.systems.events import Friction, Impact, Switch
from vibrojax.models.systems.flow import Flow, States, SystemConstants

LEAST_PUSH = 1e-10
"""Least second derivative of a gap that holds a motion on its stop, as a fraction of a typical one."""

LIFT_ROUNDINGS = 1e4
"""Offset, in rounding errors of a typical value, by which a surface moves away from a motion that leaves it along a
tangent. Without it, rounding errors would bring the motion back at once."""

APPROACH = "approach"
"""Name of the hidden state with the speed of the last impact."""

Known = Callable[[Mapping[str, Any]], tuple[Any, dict[str, Any]]]
"""Function that returns the time and the user's states from all states by name."""


def after_events(
    flow: Flow, known: Known, c: SystemConstants, mode: Values, values: dict[str, Any], hits: Mapping[str, Any]
) -> Values:
    """Return the modes after events, and update the states in `values`; `hits`: masks of the events by name."""
    for _, event in (*flow.of(Friction), *flow.of(Switch)):
        # A departure along a tangent moves the surface away; the motion returns exactly to the surface.
        for name, value in flow.onto_surface(c, event, *known(values)).items():
            values[name] = jnp.where(hits[event.name], value, values[name])
    motion, modes = flow.at(c, mode, *known(values)), list(mode)
    for index, event in enumerate(flow.events):
        if isinstance(event, Impact):
            continue
        where, margin = mode[index], motion.margins[index]
        leaves = 2.0 * jnp.sign(motion.pulls[index])
        if isinstance(event, Friction):
            # The margin is that of the field without this friction, for a body that slides as for one that sticks.
            after = jnp.where(margin >= 0, 0.0, leaves)
        else:
            after = jnp.where(margin > 0, 0.0, -jnp.sign(where))
            if event.impact:
                t, y = known(values)
                begins = hits[event.name] & (where < 0)
                values[APPROACH] = jnp.where(begins, flow.closing(c, event, mode, t, y), values[APPROACH])
        modes[index] = jnp.where(hits[event.name], jnp.where(where == 0, leaves, after), where)
    for index, event in flow.of(Impact):
        modes[index] = _after_impact(flow, known, c, mode, index, event, values, hits[event.name])
    return tuple(modes)


def _after_impact(
    flow: Flow,
    known: Known,
    c: SystemConstants,
    mode: Values,
    index: int,
    event: Impact,
    values: dict[str, Any],
    hit: Any,
) -> Any:
    """Return the mode after a stop is hit or left, and update the states in `values`."""
    resting = mode[index] == 1
    struck = hit & ~resting
    t, y = known(values)
    rate = flow.closing(c, event, mode, t, y)
    values[APPROACH] = jnp.where(struck, -rate, values[APPROACH])
    if event.velocity is None:
        assert event.reset is not None
        for name, new in event.reset(t, y, c.p).items():
            values[name] = jnp.where(struck, new, values[name])
        return mode[index]
    for name, position in flow.onto_stop(c, event, t, y).items():
        # Steps end on the stop within their tolerance, and a long rest drifts by as much.
        values[name] = jnp.where(hit, position, values[name])
    slow = jnp.abs(event.bounce(c.p) * rate) <= c.slow[index]
    jump = jnp.where(slow, -rate, -(1.0 + event.bounce(c.p)) * rate) / flow.gain(c, index, mode, t, y)
    # A long rest also drifts in its velocity: a departure that approaches the stop would take very short steps.
    released = -rate / flow.gain(c, index, mode, t, y)
    changes = jnp.where(struck & (rate < 0), jump, jnp.where(hit & resting, released, 0.0))
    values[event.velocity] = values[event.velocity] + changes
    pushed = flow.at(c, mode, *known(values)).margins[index] > _least_push(c, index)
    after = jnp.where(slow, jnp.where(pushed, 1.0, -1.0), 0.0)
    return jnp.where(hit, jnp.where(resting, -1.0, after), mode[index])


def _least_push(c: SystemConstants, index: int) -> Any:
    """Return the least second derivative of a gap that holds a motion on its stop.

    With none, a motion that the field hardly pushes would leave and reach the stop again and again.
    """
    typical = c.lifts[index] / (LIFT_ROUNDINGS * jnp.finfo(c.lifts[index].dtype).eps)
    return LEAST_PUSH * typical * c.rates[0] * c.rates[0]


def move_onto_surfaces(flow: Flow, known: Known, c: SystemConstants, mode: Values, values: dict[str, Any]) -> None:
    """Move a motion that slides, sticks or rests in `mode` exactly onto its surfaces, by updating `values`.

    A motion next to a surface that holds it is on the surface at once. Without this, a deviation from the surface
    would last, and the derivative of a return would have a false multiplier of 1.
    """
    for index, event in enumerate(flow.events):
        if not isinstance(event, Impact):
            for name, value in flow.onto_surface(c, event, *known(values)).items():
                values[name] = jnp.where(mode[index] == 0, value, values[name])
        elif event.velocity is not None:
            rests = mode[index] == 1
            for name, value in flow.onto_stop(c, event, *known(values)).items():
                values[name] = jnp.where(rests, value, values[name])
            t, y = known(values)
            jump = flow.closing(c, event, mode, t, y) / flow.gain(c, index, mode, t, y)
            values[event.velocity] = values[event.velocity] - jnp.where(rests, jump, 0.0)


def free_modes(flow: Flow, c: SystemConstants, t: Any, y: States, zero: Any) -> Values:
    """Return the modes of a motion on no surface: 0 for stops, else the side; `zero`: zeros (lanes,)."""
    return tuple(
        zero if isinstance(event, Impact) else jnp.where(event.surface(t, y, c.p) + zero < 0, -1.0, 1.0)
        for event in flow.events
    )


def initial_modes(flow: Flow, c: SystemConstants, t: Any, y: States, free: Values, small: Values) -> Values:
    """Return the modes in which a motion begins; `small`: magnitudes up to which the events' functions are zero."""
    modes = list(free)
    for index, event in enumerate(flow.events):
        near = jnp.abs(event.surface(t, y, c.p) + 0.0 * free[index]) <= small[index]
        there = list(free)
        there[index] = jnp.where(near, 1.0 if isinstance(event, Impact) else 0.0, free[index])
        motion = flow.at(c, tuple(there), t, y)
        margin, pull = motion.margins[index], motion.pulls[index]
        if isinstance(event, Impact):
            rate = flow.closing(c, event, free, t, y)
            pushed = (margin > _least_push(c, index)) & (event.velocity is not None)
            # A motion at rest drifts by the tolerance of its steps until the section.
            touches = jnp.abs(event.surface(t, y, c.p) + 0.0 * free[index]) <= jnp.maximum(small[index], c.lifts[index])
            rests = touches & (jnp.abs(rate) <= c.slow[index]) & pushed
            modes[index] = jnp.where(rests, 1.0, jnp.where(near & (rate >= -c.slow[index]), -1.0, 0.0))
        else:
            stays = margin >= 0 if isinstance(event, Friction) else margin > 0
            leaves = jnp.where(pull < 0, -2.0, 2.0)
            modes[index] = jnp.where(near, jnp.where(stays, 0.0, leaves), free[index])
    return tuple(modes)
