"""Section crossings: interpolated within steps while settling; during the observation, steps end on them.

A zero crossing of the section's velocity counts only if the velocity has been beyond the re-arming level since the last
section crossing. While settling, steps do not end on the section: crossings are found on the polynomials of the steps.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

from vibrojax.lazy import jax, jnp
from vibrojax.measures import since_start
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.motion import positions, section_of, widened
from vibrojax.measures.repeats import Range, Returns, Seen, returned
from vibrojax.physics.arrays import Array, Flags, Lanes, keep
from vibrojax.scenes.declared import Section, Swing
from vibrojax.scenes.scene import Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import Coefficients, first_guess, slope, value

PASSING_ITERATIONS = 2
"""Number of Newton iterations for a section crossing within a step, starting from the root of a parabola."""


class Passed(NamedTuple):
    """The last section crossing within a step while settling.

    - `waiting`: mask of the lanes whose crossing is not recorded yet.
    - `state`: states at the crossing, (states, lanes); `time` [s]: its time.
    - `scales`: scales of the compared states since the previous crossing, see `Section.scales`.
    """

    waiting: Flags
    state: Array
    time: Lanes
    scales: tuple[Lanes, ...]


class Settling(NamedTuple):
    """The carry while lanes settle."""

    seen: Seen
    passed: Passed


def begin(scene: Scene[Any], lane: Lane) -> Settling:
    """Return the carry at t = 0, without section crossings."""
    places = positions(scene, lane)
    first, kept = places[0], len(_kept(scene))
    nothing = jnp.full((MOST_CYCLES, *first.shape), jnp.nan, first.dtype)
    zero, never = jnp.zeros_like(first), jnp.zeros_like(first, bool)
    ranges, states = tuple((x, x) for x in places), jnp.stack([nothing] * kept, axis=1)
    seen = Seen(never, zero, ranges, states, times=nothing, settled=jnp.zeros_like(nothing), frequency=zero)
    seen = seen._replace(since_start=since_start.begin(scene, lane))
    return Settling(seen, Passed(never, jnp.stack([zero] * kept), zero, (zero,) * len(section_of(scene).compared)))


def on_orbit(begun: Settling, states: Array, times: Array, period: Lanes) -> Settling:
    """Return the carry of a lane that starts at a section crossing of a periodic orbit.

    It is `begun` with previous crossings on the same orbit. The last crossings, newest first, are at `states` (8,
    states, lanes) and `times` (8, lanes) [s]; the newest is the lane's present state. `period` [s]: time between
    crossings.
    """
    return begun._replace(seen=begun.seen._replace(states=states, times=times, frequency=2 * jnp.pi / period))


def pass_by(scene: Scene[Any], c: Any, carry: Settling, lane: Lane, step: Step) -> Settling:
    """Return the carry updated with a step while settling: extremes, and a section crossing within the step.

    Turning points are the zeros of velocities on the step's polynomials.
    """
    section, (seen, passed) = section_of(scene), carry
    own = scene.place(section.velocity)
    velocity, after = rising(section, step.polynomials[own]), rising(section, [lane.state[own]])[0]
    turns, tau = _turn(velocity, after, step)
    if scene.section_on_guard:  # the step ends exactly on the section
        at_end = step.hits[scene.marker_of(section.velocity)]
        turns, tau = turns | at_end, jnp.where(at_end, step.tau, tau)
    for _ in range(PASSING_ITERATIONS):
        better = tau - value(velocity, tau) / slope(velocity, tau)
        tau = keep(jnp.where((better > 0) & (better < step.tau), better, tau))
    there = keep(jnp.stack([value(step.polynomials[place], tau) for place in _kept(scene)]))
    ends = positions(scene, lane)
    turned = [
        jnp.where(turns, there[0], end)
        if swing.velocity == section.velocity
        else _turned(step, scene, swing, end, lane)
        for swing, end in zip(section.swings, ends, strict=True)
    ]
    ranges = tuple(widened(swung, x) for swung, x in zip(seen.ranges, turned, strict=True))
    level = rising(section, [section.rearm(c)])[0]
    armed = keep(seen.armed | (lowest(velocity, step.tau) < level))
    returns = keep(turns & (velocity[0] < 0) & armed)
    since = seen.since + step.dt
    remaining = step.dt - tau * step.h
    whole = since_start.extended(scene, seen.since_start, lane)
    halves = since_start.repeat_halves(scene, c, amplitudes(ranges), whole)
    scales = tuple(section.scales(halves, since - remaining))
    new = (there, lane.clock.high - remaining, scales)
    last = jax.tree.map(lambda now, before: jnp.where(returns, now, before), new, tuple(passed[1:]))
    rows = {name: there[row] for row, name in enumerate(section.compared)}
    starts = [rows.get(swing.position, jnp.zeros_like(tau)) for swing in section.swings]
    widest = [widened(swung, end) for swung, end in zip(ranges, ends, strict=True)]
    known = seen._replace(
        armed=jnp.where(returns, after < 0, armed),
        since=jnp.where(returns, remaining, since),
        ranges=_restarted(returns, starts, widest),
        since_start=whole,
    )
    return Settling(known, Passed(passed.waiting | returns, *last))


def _kept(scene: Scene[Any]) -> list[int]:
    """Return the indices of the states that are stored at section crossings: the driving part's return map states."""
    return [scene.place(name) for name in scene.driving_part().return_states]


def rising(section: Section, values: Coefficients) -> Coefficients:
    """Return `values` of the section's velocity, with the sign reversed if section crossings are downward zeros."""
    return values if section.rising else [-x for x in values]


def _turn(velocity: Coefficients, after: Array, step: Step) -> tuple[Array, Array]:
    """Return a mask of the lanes whose velocity crosses zero within the step, and a parabola's guess of the zero."""
    sign = jnp.where(velocity[0] < 0, -1.0, 1.0)
    guess = first_guess(jnp.abs(velocity[0]), sign * velocity[1] * step.tau, sign * after)
    return sign * after < 0, keep(guess * step.tau)


def _turned(step: Step, scene: Scene[Any], swing: Swing, end: Lanes, lane: Lane) -> "jax.Array":
    """Return an oscillating position at its turning point within the step, or its value `end` if there is none."""
    if swing.velocity is None:
        return jnp.asarray(end)
    # The position is stationary at the turning point, so a first guess of the time is accurate enough.
    velocity = scene.place(swing.velocity)
    turns, when = _turn(step.polynomials[velocity], lane.state[velocity], step)
    return jnp.where(turns, value(step.polynomials[scene.place(swing.position)], when), end)


def take_in_passed(carry: Settling) -> Settling:
    """Return the carry after recording the section crossings of the waiting lanes."""
    seen, passed = carry
    known, _ = returned(seen, *passed)
    return Settling(known, passed._replace(waiting=jnp.zeros_like(passed.waiting)))


def observe(scene: Scene[Any], carry: Settling) -> Returns:
    """Return the carry at the beginning of the observation, during which section crossings are counted."""
    seen = take_in_passed(carry).seen
    zero = jnp.zeros_like(seen.since)
    worst = jnp.zeros_like(seen.states[:, : len(section_of(scene).compared)])
    return Returns(seen, jnp.zeros_like(seen.armed), zero, zero, worst)


def step(scene: Scene[Any], c: Any, carry: Returns, lane: Lane, step: Step) -> Returns:
    """Return the carry updated with a step: the extremes, and the mask of the lanes that wait at the section."""
    section, seen = section_of(scene), carry.seen
    velocity = rising(section, step.polynomials[scene.place(section.velocity)])
    armed = keep(seen.armed | (lowest(velocity, step.tau) < rising(section, [section.rearm(c)])[0]))
    marker = scene.marker_of(section.velocity)
    falls = step.falling[marker] if section.rising else ~step.falling[marker]
    ranges = tuple(widened(swung, x) for swung, x in zip(seen.ranges, positions(scene, lane), strict=True))
    whole = since_start.extended(scene, seen.since_start, lane)
    return carry._replace(
        seen=seen._replace(armed=armed, since=seen.since + step.dt, ranges=ranges, since_start=whole),
        waiting=carry.waiting | (step.hits[marker] & ~falls & armed),
        phase=carry.phase + seen.frequency * step.dt,
    )


def lowest(velocity: Coefficients, tau: Array) -> "jax.Array":
    """Return the least velocity between 0 and `tau`, from the parabola through the two ends and the middle."""
    start, middle, end = velocity[0], value(velocity, tau / 2), value(velocity, tau)
    bend, fall = start + end - 2 * middle, 3 * start + end - 4 * middle
    # If no step was taken, the velocity is constant: 0/0 is NaN, so there is no minimum in between.
    share = fall / (4 * bend)
    vertex = start - fall * share / 2
    return jnp.minimum(jnp.minimum(start, end), jnp.where((bend > 0) & (share > 0) & (share < 1), vertex, start))


def _restarted(here: Flags, places: Iterable[Lanes], ranges: Iterable[Range]) -> tuple[Range, ...]:
    """Return the least and greatest values, both set to the positions `places` in the lanes `here`."""
    return tuple(
        (jnp.where(here, x, low), jnp.where(here, x, high)) for x, (low, high) in zip(places, ranges, strict=True)
    )


def amplitudes(ranges: Iterable[Range]) -> tuple[Lanes, ...]:
    """Return half the peak-to-peak range of each oscillating position [m]."""
    return tuple((greatest - least) / 2 for least, greatest in ranges)


def take_in(scene: Scene[Any], c: Any, carry: Returns, lane: Lane) -> Returns:
    """Return the carry after recording the section crossings of the waiting lanes, which then continue."""
    seen, here = carry.seen, carry.waiting
    state = jnp.stack([lane.state[place] for place in _kept(scene)])
    halves = since_start.repeat_halves(scene, c, amplitudes(seen.ranges), seen.since_start)
    scales = section_of(scene).scales(halves, seen.since)
    known, differs = returned(seen, here, state, lane.clock.high, tuple(scales))
    back = jnp.arange(MOST_CYCLES, dtype=carry.number.dtype).reshape(-1, *[1] * carry.number.ndim)
    compared = here[None] & (back < carry.number[None])
    turn = 2 * jnp.pi
    # The phase is 0 at the first section crossing of the observation; full revolutions are subtracted.
    phase = jnp.where(carry.number == 0, 0, carry.phase - turn * jnp.round(carry.phase / turn))
    return Returns(
        seen=known._replace(
            armed=seen.armed & ~here,
            since=jnp.where(here, 0, seen.since),
            ranges=_restarted(here, positions(scene, lane), seen.ranges),
        ),
        waiting=jnp.zeros_like(here),
        phase=jnp.where(here, phase, carry.phase),
        number=jnp.where(here, carry.number + 1, carry.number),
        worst=jnp.where(compared[:, None], jnp.maximum(carry.worst, differs), carry.worst),
    )
