"""Periodicity: the period of a motion in return intervals, since when it repeats, and the last crossings themselves."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from vibrojax.lazy import jax, jnp
from vibrojax.measures.gauge import Gauge, Return, Whole
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.physics.arrays import Array, Flags, Lanes, keep
from vibrojax.scenes.capabilities import HasImpacts
from vibrojax.scenes.declared import Section
from vibrojax.scenes.scene import Scene
from vibrojax.stepping import Lane

REPEATS_WITHIN = 1e-3
"""Greatest difference between the states at two section crossings one period apart, relative to the states' scales."""

SETTLED_WITHIN = 0.01
"""The corresponding difference while lanes settle, used for the settling time."""

Range = tuple[Lanes, Lanes]
"""The least and the greatest value."""


class Seen(NamedTuple):
    """The last section crossings, the newest first.

    - `armed`: mask of the lanes whose next zero counts as a section crossing.
    - `since` [s]: time since the last crossing; `ranges`: least and greatest value of each oscillating
      position since then.
    - `states` (8, states, lanes), `times` (8, lanes) [s]: states and times of the last crossings, NaN where there are
      none. The states on which periodicity is checked come first, then the other states of the return map.
    - `settled` (8, lanes) [s]: for p = 1 to 8, the time of the last crossing that differs from the crossing p later.
    - `frequency` [rad/s]: angular frequency of the crossings, 0 before the second crossing.
    - `since_start`: ranges since t = 0, empty if scales do not depend on them, see [vibrojax.measures.since_start][].
    """

    armed: Flags
    since: Lanes
    ranges: tuple[Range, ...]
    states: Array
    times: Array
    settled: Array
    frequency: Lanes
    since_start: tuple[Range, ...] = ()


class Returns(NamedTuple):
    """The carry during the observation, in which section crossings are counted and steps end on them.

    - `waiting`: mask of the lanes at the section; `number`: number of section crossings so far.
    - `phase` [rad]: phase of the crossings' frequency, 0 at the first crossing.
    - `worst` (8, states, lanes): for p = 1 to 8, the greatest difference between crossings that are p apart.
    """

    seen: Seen
    waiting: Flags
    phase: Lanes
    number: Lanes
    worst: Array


def returned(seen: Seen, here: Flags, state: Array, time: Lanes, scales: tuple[Lanes, ...]) -> tuple[Seen, Array]:
    """Return the last section crossings including a new one, and the differences of the new one from those before.

    The new crossing of the lanes `here` is in `state` at `time`. `scales`: scales of the compared
    states since the previous crossing.
    """
    scale = keep(jnp.stack(scales))
    compared = len(scale)
    differs = keep(jnp.abs(state[None, :compared] - seen.states[:, :compared]))
    # A missing crossing is NaN; comparisons with NaN are False.
    unsettled = here[None] & jnp.any(differs > SETTLED_WITHIN * scale[None], axis=1)
    repeats = jnp.all(differs <= SETTLED_WITHIN * scale[None], axis=1)
    times = keep(jnp.concatenate([time[None], seen.times[:-1]]))
    states = jnp.concatenate([state[None], seen.states[:-1]])
    rate = 2 * jnp.pi * _rate(seen.times, repeats, time)
    known = seen._replace(
        frequency=jnp.where(here, rate, seen.frequency),
        states=jnp.where(here[None, None], states, seen.states),
        times=jnp.where(here[None], times, seen.times),
        settled=jnp.where(unsettled, seen.times, seen.settled),
    )
    return known, differs


def _rate(times: Array, repeats: Array, now: Lanes) -> Lanes:
    """Return the number of section crossings per second, 0 before the second crossing.

    The crossings are counted over the shortest period found, or over all stored crossings if there is none.
    """
    rate = jnp.zeros_like(now)
    for p in range(1, MOST_CYCLES + 1):
        rate = jnp.where(jnp.isfinite(times[p - 1]), p / (now - times[p - 1]), rate)
    for p in range(MOST_CYCLES, 0, -1):
        rate = jnp.where(repeats[p - 1], p / (now - times[p - 1]), rate)
    return rate


def cycles(section: Section, carry: Returns, amplitudes: tuple[Lanes, ...], period: Lanes) -> "jax.Array":
    """Return the number p of return intervals per period, 1 to 8, or 0 if no period is found.

    A period of p intervals is recognised after 3 p + 1 section crossings. `amplitudes` and `period`: amplitudes, with
    their lower bounds, and mean return interval in the whole observation.
    """
    scale = jnp.stack(section.scales(amplitudes, period))
    repeating = jnp.zeros_like(carry.number)
    for p in range(MOST_CYCLES, 0, -1):
        repeats = jnp.all(carry.worst[p - 1] < REPEATS_WITHIN * scale, axis=0) & (carry.number >= 3 * p + 1)
        repeating = jnp.where(repeats, float(p), repeating)
    return repeating


def settling_time(carry: Returns, cycles: Lanes) -> "jax.Array":
    """Return the time [s] of the last section crossing that differs from the crossing one period later.

    The period is `cycles` return intervals; where `cycles` is 0, the result is NaN. Two crossings differ if a state
    differs by more than 0.01 of its scale.
    """
    time = jnp.full_like(cycles, jnp.nan)
    for p in range(1, MOST_CYCLES + 1):
        time = jnp.where(cycles == p, carry.seen.settled[p - 1], time)
    return time


TIME, INTERVAL, GROWTH = "return_time", "return_interval", "return_growth"
ROCK_STATES = ("compression", "v3")
IMPACTS = ("return_impacts", "return_impact_velocity")


@dataclass(frozen=True)
class KeptReturns(Gauge[Scene[Any]]):
    """The last `keep` section crossings of the observation: time, interval, states and impacts.

    The carry is a ring buffer of the crossings, an array (keep, features, lanes).

    The interval is the time since the previous crossing. The states are the states of the return map. The number of
    impacts since the previous crossing and their mean velocity are stored if the scene has a contact, and the growth of
    the hole since then if `grows`.
    """

    keep: int
    grows: bool = False

    checked = True

    def begin(self, scene: Scene[Any], c: Any, lane: Lane) -> Array:
        shape = (self.keep, len(self._names(scene)), *lane.state[0].shape)
        return jnp.full(shape, jnp.nan, lane.state[0].dtype)

    def section(self, scene: Scene[Any], c: Any, carry: Array, crossing: Return) -> Array:
        states = [crossing.lane.state[scene.place(name)] for name in scene.return_states]
        new = [crossing.lane.clock.high, crossing.interval, *states]
        if isinstance(scene, HasImpacts):
            whole = crossing.number > 0
            new.append(jnp.where(whole, crossing.sums["impacts"], jnp.nan))
            new.append(jnp.where(whole, crossing.sums["velocity"] / crossing.sums["impacts"], jnp.nan))
        if self.grows:
            new.append(jnp.where(crossing.number > 0, crossing.sums["growth"], jnp.nan))
        return put_row(carry, crossing.here, crossing.number, new)

    def read(self, scene: Scene[Any], c: Any, carry: Array, whole: Whole) -> dict[str, Array]:
        return in_order(carry, self._names(scene))

    def _names(self, scene: Scene[Any]) -> tuple[str, ...]:
        impacts = IMPACTS if isinstance(scene, HasImpacts) else ()
        growth = (GROWTH,) if self.grows else ()
        return (TIME, INTERVAL, *(state_name(name) for name in scene.return_states), *impacts, *growth)


def put_row(rows: Array, here: Flags, number: Lanes, new: Sequence[Lanes]) -> "jax.Array":
    """Return the ring buffer `rows` with the values `new` of the crossing `number` of the lanes `here`."""
    keep = len(rows)
    row = jnp.where(here, number % keep, keep).astype(jnp.int32)
    put = jax.vmap(lambda rows, row, new: rows.at[row].set(new, mode="drop"), in_axes=-1, out_axes=-1)
    return put(jnp.asarray(rows), row, jnp.stack(list(new)))


def in_order(rows: Array, names: Sequence[str]) -> dict[str, Array]:
    """Return the columns of a ring buffer by name, the oldest crossing first. The first column is the time."""
    time = rows[:, 0]  # in a full ring buffer, the oldest row follows the newest
    order = jnp.argsort(jnp.where(jnp.isnan(time), -jnp.inf, time), axis=0)
    return {name: jnp.take_along_axis(rows[:, index], order, axis=0) for index, name in enumerate(names)}


def state_name(name: str) -> str:
    """Return the name of the feature that stores a state at section crossings."""
    return f"return_{name}"


def rock_scale(name: str) -> str:
    """Return the name of the feature that stores the scale of a state of the bit on the rock."""
    return f"{name}_scale"
