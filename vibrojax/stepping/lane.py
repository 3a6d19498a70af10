"""A lane at one instant, and the step to the next."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.models.arrays import Array, Flags, Lanes
from vibrojax.models.scenes.scene import Scene


class Clock(NamedTuple):
    """Time [s] as a sum of two floats, so that a million additions lose nothing, in float32 too."""

    high: Lanes
    low: Lanes

    def advanced(self, dt: Lanes) -> "Clock":
        """Return this clock `dt` later (Knuth's two-sum)."""
        small = dt + self.low
        high = self.high + small
        part = high - self.high
        return Clock(high, (self.high - (high - part)) + (small - part))

    def until(self, end: Array | float) -> Array:
        """Return the time left to `end`."""
        return (end - self.high) - self.low


class Lane(NamedTuple):
    """A lane at one instant: clock, continuous state, discrete mode, and the limit on its next trial step [s].

    Every leaf has shape (lanes,).
    """

    clock: Clock
    state: tuple[Array, ...]
    mode: tuple[Array, ...]
    trial: Lanes


class Step(NamedTuple):
    """A step as measures see it; `dt` is 0 if it was not taken.

    - `before`, `mode`: state and mode at its start; `after`: the state in which the next step begins.
    - `polynomials`: `polynomials[i][k]` is the coefficient of tau^k of state i, tau = time/h from 0 to `tau`.
    - `hits`: by name, a mask of the guard or marker that it ended on; `falling`: of downward zeros, for each marker.
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
    """Return the lane that starts at t = 0 from `state`, a tuple of (lanes,)."""
    zero: jax.Array = jnp.zeros_like(state[0])
    return Lane(Clock(zero, zero), state, scene.mode_at(constants, state), jnp.full_like(zero, jnp.inf))
