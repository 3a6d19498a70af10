"""What is kept of returns to the section, and what repeats among them: after how many, and since when."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.models.arrays import Array, Flags, Lanes, keep

REPEATS_WITHIN = 1e-3
SETTLED_WITHIN = 0.01

Range = tuple[Lanes, Lanes]
"""The least and the greatest value."""


class Seen(NamedTuple):
    """What has been seen of returns, the newest first where there are several.

    - `armed`: whether the next zero counts; `since` [s]: the time since the last return.
    - `ranges`: of each swing's position since then.
    - `states` (8, states, lanes) and `times` (8, lanes) [s] of the last returns, NaN where there was none: first the
      states that are compared, then what else the return map has.
    - `settled` (8, lanes) [s]: for each length of a repeat the time of the last return that differs from its repeat.
    - `frequency` [rad/s]: of the returns; 0 before there are two.
    """

    armed: Flags
    since: Lanes
    ranges: tuple[Range, ...]
    states: Array
    times: Array
    settled: Array
    frequency: Lanes


class Returns(NamedTuple):
    """What is carried under observation: returns are counted, and landed on.

    - `waiting`: lanes that stand at the section; `number`: of returns so far.
    - `phase` [rad]: what has passed of the returns' frequency since the first.
    - `worst` (8, states, lanes): the greatest differences between returns, for each length of a repeat.
    """

    seen: Seen
    waiting: Flags
    phase: Lanes
    number: Lanes
    worst: Array


def scales(amplitudes: tuple[Lanes, ...], period: Lanes) -> list[Lanes]:
    """What the compared states are measured against: half the swings, and of velocities those by 2 pi over `period`."""
    first, *others = amplitudes
    return [first, *(one for half in others for one in (half, half * 2 * jnp.pi / period))]


def returned(
    seen: Seen, here: Flags, state: Array, time: Lanes, since: Lanes, amplitudes: tuple[Lanes, ...]
) -> tuple[Seen, Array]:
    """The returns that are kept after one in `state` at `time`, where `here`; and how it differs from those before.

    `amplitudes` are half the swings in the time `since` the return before.
    """
    scale = keep(jnp.stack(scales(amplitudes, since)))
    compared = len(scale)
    differs = keep(jnp.abs(state[None, :compared] - seen.states[:, :compared]))
    # A return that has not been yet is NaN, which compares false.
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
    """Returns per second, over the fewest returns after which the state repeats, else over all that are kept; 0 before
    there are two."""
    rate = jnp.zeros_like(now)
    for p in range(1, MOST_CYCLES + 1):
        rate = jnp.where(jnp.isfinite(times[p - 1]), p / (now - times[p - 1]), rate)
    for p in range(MOST_CYCLES, 0, -1):
        rate = jnp.where(repeats[p - 1], p / (now - times[p - 1]), rate)
    return rate


def cycles(carry: Returns, amplitudes: tuple[Lanes, ...], period: Lanes) -> jax.Array:
    """Returns after which the motion repeats, 1 to 8; 0 where it does not, or where there are fewer than 3 p + 1.

    `amplitudes` and `period` are those of the whole observation.
    """
    scale = jnp.stack(scales(amplitudes, period))
    repeating = jnp.zeros_like(carry.number)
    for p in range(MOST_CYCLES, 0, -1):
        repeats = jnp.all(carry.worst[p - 1] < REPEATS_WITHIN * scale, axis=0) & (carry.number >= 3 * p + 1)
        repeating = jnp.where(repeats, float(p), repeating)
    return repeating


def settling_time(carry: Returns, cycles: Lanes) -> jax.Array:
    """Time [s] of the last return that differs from that `cycles` returns later by over 0.01; NaN where cycles is 0."""
    time = jnp.full_like(cycles, jnp.nan)
    for p in range(1, MOST_CYCLES + 1):
        time = jnp.where(cycles == p, carry.seen.settled[p - 1], time)
    return time
