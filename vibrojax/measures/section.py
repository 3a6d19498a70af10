"""Returns to a scene's section, passed on the way and landed on under observation.

A return counts where the section's velocity passes zero, having been beyond the re-arming level since the last one.
Before the observation steps do not end on the section: a return on the way is read off the step's polynomials.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import Range, Returns, Seen, returned
from vibrojax.measures.swings import widened
from vibrojax.models.arrays import Array, Flags, Lanes, keep
from vibrojax.models.scenes.declared import Section, Swing
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import Coefficients, first_guess, slope, value


class Passed(NamedTuple):
    """The return that was last passed on the way: whether it is `waiting` to be taken in, and what it was.

    - `state`: the states that are compared, (states, lanes); `time` [s]; `since` [s]: the time since the one before.
    - `amplitudes`: half the swings since then [m].
    """

    waiting: Flags
    state: Array
    time: Lanes
    since: Lanes
    amplitudes: tuple[Lanes, ...]


class Settling(NamedTuple):
    """What is carried while lanes settle."""

    seen: Seen
    passed: Passed


def begin(section: Section, scene: Scene[Any], lane: Lane) -> Settling:
    """What is known of returns at t = 0, while it settles."""
    places = [lane.state[scene.place(swing.position)] for swing in section.swings]
    first, kept = places[0], len(_kept(scene))
    nothing = jnp.full((MOST_CYCLES, *first.shape), jnp.nan, first.dtype)
    zero = jnp.zeros_like(first)
    seen = Seen(
        armed=jnp.zeros_like(first, bool),
        since=zero,
        ranges=tuple((x, x) for x in places),
        states=jnp.stack([nothing] * kept, axis=1),
        times=nothing,
        settled=jnp.zeros_like(nothing),
        frequency=zero,
    )
    waiting = jnp.zeros_like(first, bool)
    return Settling(seen, Passed(waiting, jnp.stack([zero] * kept), zero, zero, tuple(zero for _ in places)))


def on_orbit(begun: Settling, states: Array, times: Array, period: Lanes) -> Settling:
    """What is known of returns at the section of a periodic orbit, from `begun`: that the last ones were on it too.

    `states` (8, states, lanes) and `times` (8, lanes) [s] of the last returns, the newest first: the one it stands at;
    `period` [s]: between returns.
    """
    seen = begun.seen._replace(states=states, times=times, frequency=2 * jnp.pi / period)
    return begun._replace(seen=seen)


def pass_by(section: Section, scene: Scene[Any], c: Any, carry: Settling, lane: Lane, step: Step) -> Settling:
    """Take in a step of the settling: extremes since the last return, and a return on the way.

    Turns are where velocities pass zero on the step's polynomials.
    """
    seen, passed = carry
    positions = [scene.place(swing.position) for swing in section.swings]
    own = scene.place(section.velocity)
    velocity, after = rising(section, step.polynomials[own]), rising(section, [lane.state[own]])[0]
    turns, at = _turn(velocity, after, step)
    for _ in range(2):
        at = _polished(velocity, at, step)
    there = keep(jnp.stack([value(step.polynomials[place], at) for place in _kept(scene)]))
    ends = [lane.state[place] for place in positions]
    turned = [
        jnp.where(turns, there[0], end)
        if swing.velocity == section.velocity
        else _turned(step, place, end, scene, swing, lane)
        for swing, place, end in zip(section.swings, positions, ends, strict=True)
    ]
    ranges = tuple(widened(one, x) for one, x in zip(seen.ranges, turned, strict=True))
    level = rising(section, [section.rearm(c)])[0]
    armed = keep(seen.armed | (lowest(velocity, step.tau) < level))
    returns = keep(turns & (velocity[0] < 0) & armed)
    since = seen.since + step.dt
    left = step.dt - at * step.h
    new = (there, lane.clock.high - left, since - left, _halves(ranges))
    last = jax.tree.map(lambda now, before: jnp.where(returns, now, before), new, tuple(passed[1:]))
    begun = [there[section.compared.index(swing.position)] for swing in section.swings]
    begun_anew = [
        _begun_at(returns, start, widened(swung, end)) for swung, start, end in zip(ranges, begun, ends, strict=True)
    ]
    known = seen._replace(
        armed=jnp.where(returns, after < 0, armed),
        since=jnp.where(returns, left, since),
        ranges=tuple(begun_anew),
    )
    return Settling(known, Passed(passed.waiting | returns, *last))


def _kept(scene: Scene[Any]) -> list[int]:
    """Places of the states that are kept of returns: those that the orbits of what drives the scene are told by."""
    return [scene.place(name) for name in scene.driving_part().return_states]


def rising(section: Section, values: Coefficients) -> Coefficients:
    """Values of the section's velocity with the sign by which it rises through zero at a return."""
    return values if section.rising else [-one for one in values]


def _turn(velocity: Coefficients, after: Array, step: Step) -> tuple[Array, Array]:
    """Where a velocity passes zero on the step, and the tau of it by a parabola."""
    sign = jnp.where(velocity[0] < 0, -1.0, 1.0)
    guess = first_guess(jnp.abs(velocity[0]), sign * velocity[1] * step.tau, sign * after)
    return sign * after < 0, keep(guess * step.tau)


def _turned(step: Step, place: int, end: Lanes, scene: Scene[Any], swing: Swing, lane: Lane) -> jax.Array:
    """A swing's position where it turns on the step, else at its `end`."""
    if swing.velocity is None:
        return jnp.asarray(end)
    # It is flat there: a first guess of when will do.
    turns, when = _turn(step.polynomials[scene.place(swing.velocity)], lane.state[scene.place(swing.velocity)], step)
    return jnp.where(turns, value(step.polynomials[place], when), end)


def _polished(velocity: Coefficients, tau: Array, step: Step) -> Array:
    """A better zero by a Newton iteration, if that stays within the step."""
    better = tau - value(velocity, tau) / slope(velocity, tau)
    return keep(jnp.where((better > 0) & (better < step.tau), better, tau))


def take_in_passed(carry: Settling) -> Settling:
    """Take in the returns that have been passed."""
    seen, passed = carry
    known, _ = returned(seen, passed.waiting, passed.state, passed.time, passed.since, passed.amplitudes)
    return Settling(known, passed._replace(waiting=jnp.zeros_like(passed.waiting)))


def observe(section: Section, carry: Settling) -> Returns:
    """What is known of returns at the beginning of the observation: they are counted from here on, and landed on."""
    zero = jnp.zeros_like(carry.seen.since)
    seen = take_in_passed(carry).seen
    return Returns(
        seen, jnp.zeros_like(seen.armed), zero, zero, jnp.zeros_like(seen.states[:, : len(section.compared)])
    )


def step(section: Section, scene: Scene[Any], c: Any, carry: Returns, lane: Lane, step: Step) -> Returns:
    """Take in a step: extremes since the last return, and whether it ends on the section."""
    seen = carry.seen
    velocity = rising(section, step.polynomials[scene.place(section.velocity)])
    armed = keep(seen.armed | (lowest(velocity, step.tau) < rising(section, [section.rearm(c)])[0]))
    marker = scene.marker_of(section.velocity)
    falls = step.falling[marker] if section.rising else ~step.falling[marker]
    returns = step.hits[marker] & ~falls & armed
    places = [lane.state[scene.place(swing.position)] for swing in section.swings]
    return carry._replace(
        seen=seen._replace(
            armed=armed,
            since=seen.since + step.dt,
            ranges=tuple(widened(one, x) for one, x in zip(seen.ranges, places, strict=True)),
        ),
        waiting=carry.waiting | returns,
        phase=carry.phase + seen.frequency * step.dt,
    )


def lowest(velocity: Coefficients, tau: Array) -> jax.Array:
    """Least value of a velocity from 0 to `tau`, by the parabola through its ends and its middle."""
    start, middle, end = velocity[0], value(velocity, tau / 2), value(velocity, tau)
    bend, fall = start + end - 2 * middle, 3 * start + end - 4 * middle
    # A step not taken is flat: 0/0 is no number, and no turn.
    share = fall / (4 * bend)
    vertex = start - fall * share / 2
    return jnp.minimum(jnp.minimum(start, end), jnp.where((bend > 0) & (share > 0) & (share < 1), vertex, start))


def _begun_at(here: Flags, x: Lanes, extremes: Range) -> Range:
    """The least and greatest value, both `x` where `here`."""
    lowest, highest = extremes
    return jnp.where(here, x, lowest), jnp.where(here, x, highest)


def _halves(ranges: Iterable[Range]) -> tuple[Lanes, ...]:
    return tuple((highest - lowest) / 2 for lowest, highest in ranges)


def amplitudes(carry: Returns) -> tuple[Lanes, ...]:
    """Half the swings since the last return [m]."""
    return _halves(carry.seen.ranges)


def take_in(section: Section, scene: Scene[Any], carry: Returns, lane: Lane) -> Returns:
    """Take in the returns of the lanes that wait at the section, and let them go on."""
    seen, here = carry.seen, carry.waiting
    state = jnp.stack([lane.state[place] for place in _kept(scene)])
    known, differs = returned(seen, here, state, lane.clock.high, seen.since, amplitudes(carry))
    back = jnp.arange(MOST_CYCLES, dtype=carry.number.dtype).reshape(-1, *[1] * carry.number.ndim)
    compared = here[None] & (back < carry.number[None])
    worst = jnp.where(compared[:, None], jnp.maximum(carry.worst, differs), carry.worst)
    turn = 2 * jnp.pi
    # From the first return of the observation on, without the whole turns.
    phase = jnp.where(carry.number == 0, 0, carry.phase - turn * jnp.round(carry.phase / turn))
    places = [lane.state[scene.place(swing.position)] for swing in section.swings]
    return Returns(
        seen=known._replace(
            armed=seen.armed & ~here,
            since=jnp.where(here, 0, seen.since),
            ranges=tuple(_begun_at(here, x, one) for one, x in zip(seen.ranges, places, strict=True)),
        ),
        waiting=jnp.zeros_like(here),
        phase=jnp.where(here, phase, carry.phase),
        number=jnp.where(here, carry.number + 1, carry.number),
        worst=worst,
    )
