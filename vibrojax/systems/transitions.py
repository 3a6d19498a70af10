"""Modes and states of a system after its events, and the modes in which a motion begins.

After a jump, the state may lie on the other side of any surface. So the modes of all events whose functions have
changed are determined by the same function as at the start of a motion.
"""

from collections.abc import Mapping
from functools import reduce
from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.scenes.declared import Values
from vibrojax.systems.events import Event, Friction, Impact, Switch
from vibrojax.systems.flow import Flow, States, SystemConstants
from vibrojax.systems.numbers import slopes_along

LEAST_PUSH = 1e-10
"""Least second derivative of a gap that holds a motion on its stop, as a fraction of a typical one."""

LIFT_ROUNDINGS = 1e4
"""Offset, in rounding errors of a typical value, by which a surface moves away from a motion that leaves it along a
tangent. Without it, rounding errors would bring the motion back at once."""

NEAR_ROUNDINGS = 64.0
"""Distance, in rounding errors of a typical value, up to which a state after a jump lies on a surface."""


class Places(NamedTuple):
    """Position of a state relative to each event, by the event's index, as masks of lanes.

    - `open`: the mode of the event is to be determined. - `near`: the state is on the event's surface.
    - `touches`: for stops, the state is within the distance in which a long rest drifts.
    - `again`: for frictions and switches, the state is on the surface, where another of them may have begun or ended to
      hold it at the same instant.
    """

    open: dict[int, Any]
    near: dict[int, Any]
    touches: dict[int, Any]
    again: dict[int, Any]


def decided(
    flow: Flow, c: SystemConstants, mode: Values, t: Any, y: States, places: Places
) -> tuple[list[Any], dict[int, Any], dict[int, Any]]:
    """Return the modes in which a motion continues from a state: at its start, and after every jump.

    `mode`: modes of a motion that is on no surface. The margins and pulls of events that led to the modes follow.
    """
    on = {index: places.open[index] & near for index, near in places.near.items()}
    modes, margins, pulls = _held(flow, c, mode, t, y, on)
    again = {}
    for index, mask in places.again.items():
        changed = reduce(jnp.logical_or, [modes[other] != mode[other] for other in flow.beside(index)])
        again[index] = (mask | on[index]) & (modes[index] != 0) & changed
        for other in flow.structure.parallel[index]:
            again[index] = again[index] & (modes[other] != int(isinstance(flow.events[other], Impact)))
    if again:
        modes, _, _ = _held(flow, c, tuple(modes), t, y, again)
    if flow.of(Impact):
        motion = flow.at(c, tuple(modes), t, y)
        for index, event in flow.of(Impact):
            if event.direction is not None:
                continue
            margins[index] = motion.margins[index]
            rate = flow.closing(c, tuple(modes), index, t, y)
            pushed = (margins[index] > least_push(c, index)) & (event.velocity is not None)
            # A motion at rest drifts by the tolerance of its steps until the section.
            rests = places.touches[index] & (jnp.abs(rate) <= c.slow[index]) & pushed
            own = jnp.where(rests, 1.0, jnp.where(places.near[index] & (rate >= -c.slow[index]), -1.0, 0.0))
            modes[index] = jnp.where(places.open[index], own, mode[index])
    return modes, margins, pulls


def _held(
    flow: Flow, c: SystemConstants, mode: Values, t: Any, y: States, on: Mapping[int, Any]
) -> tuple[list[Any], dict[int, Any], dict[int, Any]]:
    """Return the modes with those of frictions and switches on whose surfaces (masks `on`) a state lies.

    The margins and pulls that led to them follow.
    """
    modes, held = list(mode), [(i, event) for i, event in enumerate(flow.events) if not isinstance(event, Impact)]
    margins, pulls = dict[int, Any](), dict[int, Any]()
    for index, _ in held:
        holds = on.get(index, jnp.zeros_like(mode[0], bool))
        for other in flow.structure.parallel[index]:  # the first of them may hold
            if other < index and not isinstance(flow.events[other], Impact):
                holds = holds & (modes[other] != 0)
        modes[index] = jnp.where(holds, 0.0, mode[index])
    if held:
        motion = flow.at(c, tuple(modes), t, y)
    for index, event in held:
        margins[index], pulls[index] = motion.margins[index], motion.pulls[index]
        stays = margins[index] >= 0 if isinstance(event, Friction) else margins[index] > 0
        leaves = on.get(index, False) & (modes[index] == 0) & ~stays
        modes[index] = jnp.where(leaves, jnp.where(pulls[index] < 0, -2.0, 2.0), modes[index])
    return modes, margins, pulls


def least_push(c: SystemConstants, index: int) -> Any:
    """Return the least second derivative of a gap that holds a motion on its stop.

    With none, a motion that the field hardly pushes would leave and reach the stop again and again.
    """
    typical = c.lifts[index] / (LIFT_ROUNDINGS * jnp.finfo(c.lifts[index].dtype).eps)
    return LEAST_PUSH * typical * c.rates[0] * c.rates[0]


def free_modes(flow: Flow, c: SystemConstants, t: Any, y: States, zero: Any) -> Values:
    """Return the modes of a motion on no surface: 0 for stops, else the side; `zero`: zeros (lanes,)."""
    modes = [zero if is_stop(event) else zero + 1.0 for event in flow.events]
    modes += [zero if kink.whole else zero + 2.0 for kink in flow.kinks]
    for _ in range(3 if flow.kinks else 1):  # some kinks depend on the formulas that others use, and on sides
        modes[len(flow.events) :] = [kink + zero for kink in first_branches(flow, c, tuple(modes), t, y)]
        for index, event in enumerate(flow.events):
            if not is_stop(event):
                side = 2.0 if isinstance(event, Impact) else 1.0
                modes[index] = jnp.where(flow.surface(c, tuple(modes), index, t, y) + zero < 0, -side, side)
    return tuple(modes)


def is_stop(event: Event) -> bool:
    """Return whether an event is an impact whose gap must not be negative."""
    return isinstance(event, Impact) and event.direction is None


def first_branches(flow: Flow, c: SystemConstants, mode: Values, t: Any, y: States) -> list[Any]:
    """Return the modes of the kinks at a state, if functions use the formulas of `mode` otherwise."""
    values, branches = flow.kink_values(c, mode, t, y), []
    for index, kink in enumerate(flow.kinks):
        if not kink.whole:
            branches.append(jnp.where(values[index] < 0, -2.0, 2.0))
            continue
        x = values[index] + mode[len(flow.events) + index] + 0.5
        still = [0.0 * x for x in y.values()]
        rising = slopes_along(lambda t, y: flow.kink_values(c, mode, t, y), t, y, still)[index] >= 0
        nearest, noise = jnp.round(x), NEAR_ROUNDINGS * jnp.finfo(x.dtype).eps * (1.0 + jnp.abs(x))
        at_end = jnp.abs(x - nearest) <= noise
        branches.append(jnp.where(at_end, jnp.where(rising, nearest, nearest - 1.0), jnp.floor(x)))
    return branches


def onto_surfaces(
    flow: Flow, c: SystemConstants, mode: Values, t: Any, y: dict[str, Any], moved: Mapping[int, Any] | None = None
) -> dict[str, Any]:
    """Return the states of a motion that slides, sticks or rests in `mode`, exactly on its surfaces.

    A motion next to a surface that holds it is on the surface at once. Without this, a deviation from the surface
    would last, and the derivative of a return would have a false multiplier of 1. `moved`: masks of the lanes that an
    event moves, by index of the event; None: all lanes and events.
    """
    for index, event in enumerate(flow.events):
        if moved is not None and index not in moved:
            continue
        held = mode[index] == (1 if isinstance(event, Impact) else 0)
        held = held if moved is None else held & moved[index]
        if not isinstance(event, Impact):
            y = _where(held, flow.onto_surface(c, mode, index, t, y), y)
        elif event.velocity is not None:
            y = _where(held, flow.onto_stop(c, mode, index, t, y), y)
            jump = flow.closing(c, mode, index, t, y) / flow.gain(c, mode, index, t, y)
            y = y | {event.velocity: y[event.velocity] - jnp.where(held, jump, 0.0)}
    return y


def _where(mask: Any, new: Mapping[str, Any], old: dict[str, Any]) -> dict[str, Any]:
    """Return the old values, with new ones where the mask is true."""
    return old | {name: jnp.where(mask, x, old[name]) for name, x in new.items()}


def after_events(
    flow: Flow, c: SystemConstants, mode: Values, t: Any, y: dict[str, Any], approach: Any, hits: Mapping[str, Any]
) -> tuple[Values, dict[str, Any], Any]:
    """Return modes and states after events, and the speed of the last impact.

    **Arguments:** `mode`, `y`, `approach`: modes, states and speed of the last impact before; `hits`: masks of events
    and kinks by name. In each lane at most one of the masks is True.
    """
    before, hit = y, [hits[event.name] for event in flow.events]
    for index, event in enumerate(flow.events):
        if not isinstance(event, Impact):
            # A departure along a tangent moves the surface away; the motion returns exactly to the surface.
            y = _where(hit[index], flow.onto_surface(c, mode, index, t, y), y)
            if isinstance(event, Switch) and event.impact:
                rate = flow.closing(c, mode, index, t, y)
                approach = jnp.where(hit[index] & (mode[index] < 0), rate, approach)
    struck, slow = {}, {}
    for index, event in flow.of(Impact):
        resting = mode[index] == 1
        struck[index] = hit[index] & event.happens(mode[index])
        rate = flow.closing(c, mode, index, t, y)
        # An event in the direction 1 happens where its function rises.
        approach = jnp.where(struck[index], rate if event.direction == 1 else -rate, approach)
        if event.velocity is None:
            y = _where(struck[index], flow.resets[index](t, y, c.p, flow.sides_of(mode)), y)
            continue
        # Steps end on the stop within their tolerance, and a long rest drifts by as much.
        y = _where(hit[index], flow.onto_stop(c, mode, index, t, y), y)
        bounce, gain = event.bounce(c.p), flow.gain(c, mode, index, t, y)
        slow[index] = jnp.abs(bounce * rate) <= c.slow[index]
        jump = jnp.where(slow[index], -rate, -(1.0 + bounce) * rate) / gain
        # A long rest also drifts in its velocity: a departure that approaches the stop would take very short steps.
        change = jnp.where(struck[index] & (rate < 0), jump, jnp.where(hit[index] & resting, -rate / gain, 0.0))
        y = y | {event.velocity: y[event.velocity] + change}
    new, jumps = list(mode), list(struck.values())
    for index, kink in enumerate(flow.kinks):
        place = len(flow.events) + index
        other = mode[place] + jnp.sign(flow.kink_values(c, mode, t, y)[index]) if kink.whole else -mode[place]
        new[place] = jnp.where(hits[kink.name], other, mode[place])
        jumps += [hits[kink.name]] if kink.whole else []
    jumped = reduce(jnp.logical_or, jumps) if jumps else jnp.zeros_like(hits[next(iter(hits))])
    if flow.kinks and struck:
        branches = first_branches(flow, c, tuple(new), t, y)
        new[len(flow.events) :] = [
            jnp.where(reduce(jnp.logical_or, struck.values()), branch, old)
            for branch, old in zip(branches, new[len(flow.events) :], strict=True)
        ]
    if not flow.events:
        return tuple(new), y, approach
    modes, opened = _modes_after(flow, c, mode, new, t, before, y, hit, jumped, slow)
    sided = [index for index, kink in enumerate(flow.kinks, len(flow.events)) if kink.sided]
    if sided:  # the event may have changed the side of a switch, or the direction of slip
        turned = reduce(jnp.logical_or, [hit[index] for index, _ in flow.of(Switch)], jumped)
        chosen = first_branches(flow, c, modes, t, y)
        for place in sided:
            new[place] = jnp.where(turned, chosen[place - len(flow.events)], new[place])
        modes, opened = _modes_after(flow, c, mode, new, t, before, y, hit, jumped, slow)
    return modes, onto_surfaces(flow, c, modes, t, y, opened), approach


def _modes_after(
    flow: Flow,
    c: SystemConstants,
    mode: Values,
    new: list[Any],
    t: Any,
    before: States,
    y: States,
    hit: list[Any],
    jumped: Any,
    slow: Mapping[int, Any],
) -> tuple[Values, dict[int, Any]]:
    """Return the modes after an event, and masks of the lanes in which a jump determines a mode anew.

    **Arguments:** `mode`, `before`: modes and states before the event; `new`: modes, in which the kinks are already as
    after the event; `y`: states after the event. `hit`: masks of events; `jumped`: mask of jumps; `slow`: masks of
    bounces that end in rest.
    """
    never, after = jnp.zeros_like(hit[0]), tuple(new)
    opened: dict[int, Any] = {}
    near, touches = dict(enumerate(hit)), dict.fromkeys(range(len(hit)), never)
    for index in sorted(flow.structure.jumping):
        event = flow.events[index]
        value = flow.surface(c, after, index, t, y)
        distance, lift = jnp.abs(value), c.lifts[index]
        changed = jnp.abs(value - flow.surface(c, mode, index, t, before)) > NEAR_ROUNDINGS / LIFT_ROUNDINGS * lift
        if isinstance(event, Impact):
            rates = flow.closing(c, after, index, t, y), flow.closing(c, mode, index, t, before)
            changed = changed | (jnp.abs(rates[0] - rates[1]) > c.slow[index])
            touches[index] = distance <= lift
        if not is_stop(event):
            side = 2.0 if isinstance(event, Impact) else 1.0
            new[index] = jnp.where(jumped & changed & ~hit[index], jnp.where(value < 0, -side, side), mode[index])
        opened[index] = jumped & changed & ~hit[index]
        near[index] = hit[index] | (distance <= NEAR_ROUNDINGS / LIFT_ROUNDINGS * lift)
    blocked, again = {}, {}
    for index, event in enumerate(flow.events):
        if not isinstance(event, Impact):
            parallel = flow.structure.parallel[index]
            holds = [mode[other] == int(isinstance(flow.events[other], Impact)) for other in parallel]
            blocked[index] = (mode[index] != 0) & reduce(jnp.logical_or, holds) if holds else never
            near[index] = near[index] & ~blocked[index]
            if beside := flow.beside(index):
                # A motion that has left the surface along a tangent meets it at the offset of the departure.
                distance = jnp.abs(flow.surface(c, after, index, t, y))
                on = (mode[index] != 0) & (distance <= 2.0 * c.lifts[index])
                again[index] = on & reduce(jnp.logical_or, [hit[other] for other in beside])
    to_decide = {index: opened.get(index, never) | hit[index] for index in range(len(hit))}
    places = Places(to_decide, near, touches, again)
    opened |= {index: opened.get(index, never) | mask for index, mask in again.items()}
    modes, margins, pulls = decided(flow, c, tuple(new), t, y, places)
    for index, event in enumerate(flow.events):
        where = mode[index]
        if isinstance(event, Impact) and event.direction is not None:
            value = flow.surface(c, after, index, t, y)
            passes = jnp.abs(value) <= 2.0 * c.lifts[index]
            own = jnp.where(passes, -2.0 * jnp.sign(where), jnp.where(value < 0, -2.0, 2.0))
        elif isinstance(event, Impact):
            if event.velocity is None:
                # The state is on the surface up to the offset of a departure, and must not repeat the event.
                value, rate = flow.surface(c, after, index, t, y), flow.closing(c, after, index, t, y)
                own = jnp.where((jnp.abs(value) <= 2.0 * c.lifts[index]) & (rate > 0), -1.0, 0.0)
            else:
                own = jnp.where(margins[index] > least_push(c, index), 1.0, -1.0)
                own = jnp.where(where == 1, -1.0, jnp.where(slow[index], own, 0.0))
        else:
            crosses = jnp.where(modes[index] == 0, 0.0, -jnp.sign(where)) if isinstance(event, Switch) else modes[index]
            crosses = jnp.where(blocked[index], -jnp.sign(where), crosses) if index in blocked else crosses
            own = jnp.where(where == 0, 2.0 * jnp.sign(pulls[index]), crosses)
        modes[index] = jnp.where(hit[index], own, modes[index])
    return tuple(modes), opened
