"""What every stepper takes and gives: a lane's moment, and the step that leads to the next."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from vibrojax.stepping._keep import keep


class Clock(NamedTuple):
    """Time [s] as a sum of two floats, so that a million additions lose nothing, in float32 too."""

    high: Any
    low: Any

    def advanced(self, dt) -> "Clock":
        """This clock `dt` later (Knuth's two-sum)."""
        small = dt + self.low
        high = self.high + small
        part = high - self.high
        return Clock(high, (self.high - (high - part)) + (small - part))

    def until(self, end):
        """Time left to `end`."""
        return (end - self.high) - self.low


class Lane(NamedTuple):
    """One lane's moment: clock, continuous state, discrete mode, and the cap on its next trial step [s].

    Every leaf has shape (lanes,).
    """

    clock: Clock
    state: tuple
    mode: tuple
    trial: Any


class Step(NamedTuple):
    """A step taken (or, where `dt` is 0, not): what measures need to know of it.

    `polynomials[i][k]` is the coefficient of tau^k of state i, tau = time/h from 0 to `tau`; `before` and `mode` hold
    where it starts, `after` the state it lands on; `hits` says which surface or marker it landed on, and `falling`
    for each marker whether it came down through zero.
    """

    before: tuple
    mode: tuple
    polynomials: tuple
    h: Any
    tau: Any
    dt: Any
    after: tuple
    hits: tuple
    falling: tuple


def lane_at(scene, p, state) -> Lane:
    """The lane that starts at t = 0 from `state`."""
    zero = jnp.zeros_like(state[0])
    return Lane(Clock(zero, zero), state, scene.mode_at(p, state), jnp.full_like(zero, jnp.inf))


def trial_step(lane: Lane, nominal, longest, end, moving):
    """Length [s] of the next trial step: the mode's own, what a rejected trial left, or what is left of the run."""
    h = jnp.minimum(jnp.minimum(nominal, longest), jnp.minimum(lane.trial, lane.clock.until(end)))
    # Where a step ends says nothing of the motion, so no derivative goes through it.
    return lax.stop_gradient(jnp.where(moving, h, 0.0))


def taken(scene, p, lane: Lane, polynomials, h, landing) -> tuple[Lane, Step]:
    """The lane after its trial step `h` has ended in `landing`, and the step as measures see it."""
    accepted = landing.accepted
    dt = jnp.where(accepted, landing.tau * h, 0.0)
    reached = tuple(jnp.where(accepted, new, old) for new, old in zip(landing.state, lane.state, strict=True))
    mode, state = keep(scene.land(p, lane.mode, reached, landing.hits))
    trial = jnp.where(accepted, jnp.inf, landing.tau * h)
    step = Step(
        before=lane.state,
        mode=lane.mode,
        polynomials=polynomials,
        h=h,
        tau=jnp.where(accepted, landing.tau, 0.0),
        dt=dt,
        after=state,
        hits=landing.hits,
        falling=landing.falling,
    )
    return Lane(lane.clock.advanced(dt), state, mode, trial), step
