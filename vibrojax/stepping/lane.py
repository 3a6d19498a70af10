"""A lane (one trajectory of the batch) at one instant, and one step of a lane."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.models.arrays import Array, Flags, Lanes
from vibrojax.models.scenes.scene import Scene


class Clock(NamedTuple):
    """Time [s] as a sum of two floats, so that a million additions lose no digits even in float32."""

    high: Lanes
    low: Lanes

    def advanced(self, dt: Lanes) -> "Clock":
        """Return the clock advanced by `dt` [s] (Knuth's two-sum)."""
        small = dt + self.low
        high = self.high + small
        part = high - self.high
        return Clock(high, (self.high - (high - part)) + (small - part))

    def until(self, end: Array | float) -> Array:
        """Return the remaining time until `end` [s]."""
        return (end - self.high) - self.low


class Lane(NamedTuple):
    """A lane at one instant: clock, continuous state and discrete mode.

    `trial` [s] limits the length of the next trial step. Every leaf has shape (lanes,).
    """

    clock: Clock
    state: tuple[Array, ...]
    mode: tuple[Array, ...]
    trial: Lanes


class Step(NamedTuple):
    """A step, the input of measures.

    - `before`, `mode`: state and mode at the start of the step; `after`: state at the start of the next step.
    - `polynomials`: `polynomials[i][k]` is the coefficient of tau^k of state i; tau = time/h runs from 0 to `tau`.
    - `h` [s]: unit of tau; `dt` [s]: duration of the step, 0 if no step was taken.
    - `hits`: for each guard and marker, by name, a mask of the lanes whose step ended on it.
    - `falling`: for each marker, a mask of the lanes in which its zero is a downward crossing.
    """

    before: tuple[Array, ...]
    mode: tuple[Array, ...]
    polynomials: tuple[list[Array], ...]
    h: Lanes
    tau: Lanes
    dt: Lanes
    after: tuple[Array, ...]
    hits: Mapping[str, Flags]
    falling: Mapping[str, Flags]


def lane_at(scene: Scene[Any], constants: Any, state: tuple[Array, ...]) -> Lane:
    """Return the lane at t = 0 with the initial `state`, a tuple of arrays (lanes,)."""
    zero: jax.Array = jnp.zeros_like(state[0])
    return Lane(Clock(zero, zero), state, scene.mode_at(constants, state), jnp.full_like(zero, jnp.inf))
