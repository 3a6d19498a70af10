"""Repeats among the returns to the section: after how many returns a motion repeats, and since when."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.models.arrays import Array, Flags, Lanes, keep

REPEATS_WITHIN = 1e-3
"""Greatest difference between returns that repeat, relative to their scales."""

SETTLED_WITHIN = 0.01
"""The same while lanes settle, for the settling time."""

Range = tuple[Lanes, Lanes]
"""The least and the greatest value."""


class Seen(NamedTuple):
    """The last returns, the newest first.

    - `armed`: mask of the lanes whose next zero counts; `since` [s]: the time since the last return.
    - `ranges`: of each swing's position since then.
    - `states` (8, states, lanes) and `times` (8, lanes) [s] of the last returns, NaN without one. The states that are
      compared come first, then the return map's other states.
    - `settled` (8, lanes) [s]: for each length of a repeat, the time of the last return that differs from its repeat.
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
    """The carry under observation, in which returns are counted and landed on.

    - `waiting`: mask of the lanes at the section; `number`: of returns so far.
    - `phase` [rad]: of the returns' frequency, since the first return.
    - `worst` (8, states, lanes): the greatest differences between returns, for each length of a repeat.
    """

    seen: Seen
    waiting: Flags
    phase: Lanes
    number: Lanes
    worst: Array


def scales(amplitudes: tuple[Lanes, ...], period: Lanes) -> list[Lanes]:
    """Return the scales of the compared states: half the swings, and for velocities those times 2 pi/`period`."""
    first, *others = amplitudes
    return [first, *(scale for half in others for scale in (half, half * 2 * jnp.pi / period))]


def returned(
    seen: Seen, here: Flags, state: Array, time: Lanes, since: Lanes, amplitudes: tuple[Lanes, ...]
) -> tuple[Seen, Array]:
    """Return the last returns after one more in `state` at `time`, where `here`, and its differences from those before.

    `amplitudes` are half the swings in the time `since` the return before.
    """
    scale = keep(jnp.stack(scales(amplitudes, since)))
    compared = len(scale)
    differs = keep(jnp.abs(state[None, :compared] - seen.states[:, :compared]))
    # A missing return is NaN, which compares false.
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
    """Return the returns per second, 0 before there are two.

    They are counted over the shortest repeat, else over all kept returns.
    """
    rate = jnp.zeros_like(now)
    for p in range(1, MOST_CYCLES + 1):
        rate = jnp.where(jnp.isfinite(times[p - 1]), p / (now - times[p - 1]), rate)
    for p in range(MOST_CYCLES, 0, -1):
        rate = jnp.where(repeats[p - 1], p / (now - times[p - 1]), rate)
    return rate


def cycles(carry: Returns, amplitudes: tuple[Lanes, ...], period: Lanes) -> jax.Array:
    """Return the number of returns p after which the motion repeats, 1 to 8; 0 if none fits or under 3 p + 1 returns.

    `amplitudes` and `period` describe the whole observation.
    """
    scale = jnp.stack(scales(amplitudes, period))
    repeating = jnp.zeros_like(carry.number)
    for p in range(MOST_CYCLES, 0, -1):
        repeats = jnp.all(carry.worst[p - 1] < REPEATS_WITHIN * scale, axis=0) & (carry.number >= 3 * p + 1)
        repeating = jnp.where(repeats, float(p), repeating)
    return repeating


def settling_time(carry: Returns, cycles: Lanes) -> jax.Array:
    """Return the time [s] of the last return that differs by over 0.01 from that `cycles` later; NaN if that is 0."""
    time = jnp.full_like(cycles, jnp.nan)
    for p in range(1, MOST_CYCLES + 1):
        time = jnp.where(cycles == p, carry.seen.settled[p - 1], time)
    return time
