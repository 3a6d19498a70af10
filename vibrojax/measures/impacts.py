"""Gauge of the striker's impacts on the bit, and of the contact force."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.measures.gauge import Gauge, Moment, Return, Sums, Whole
from vibrojax.models.arrays import Flags, Lanes, keep
from vibrojax.models.scenes.capabilities import HasContact, HasFriction
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import highest, integral
from vibrojax.stepping.series import known

Pair = tuple[Lanes, Lanes]
"""The slowest and the fastest impact velocity [m/s]."""


class Extremes(NamedTuple):
    """Extreme impact velocities, and the greatest contact force.

    - `since`: velocities since the last section crossing; `whole`: velocities in the complete return intervals.
    - `peak` [N]: greatest contact force.
    """

    since: Pair
    whole: Pair
    peak: Lanes


@dataclass(frozen=True)
class Impacts(Gauge[HasContact[Any]]):
    """impacts, impact_velocity(_min, _max), impact_phase, impact_energy, peak_impact_force, mean_impact_force.

    For a sliding bit, bit_velocity_at_impact in addition.
    """

    summed = ("impacts", "velocity", "velocity_squared", "bit_velocity", "lag", "force")
    needs = (HasContact,)

    def increments(self, scene: HasContact[Any], c: Any, moment: Moment) -> Sums:
        step = moment.step
        begins, velocity = _begins(scene, c, step)
        sliding = jnp.zeros_like(step.after[0])
        if isinstance(scene, HasFriction):  # u = x1' + v [m/s]
            sliding = step.after[scene.place(scene.bit_velocity)] + scene.bit(c).drive_speed
        return {
            "impacts": begins.astype(step.dt.dtype),
            "velocity": jnp.where(begins, velocity, 0),
            "velocity_squared": jnp.where(begins, velocity * velocity, 0),
            "bit_velocity": jnp.where(begins, sliding, 0),
            "lag": jnp.where(begins, moment.since, 0),
            "force": step.h * integral(_force(scene, c, step), step.tau),
        }

    def close(self, sums: Sums, interval: Lanes) -> Sums:
        """Return the sum of the impact lags as fractions of the return interval in which the impacts occur."""
        return {"lag": sums["lag"] / interval}

    def begin(self, scene: HasContact[Any], c: Any, lane: Lane) -> Extremes:
        like = jnp.zeros_like(lane.state[0])
        none = (jnp.full_like(like, jnp.inf), jnp.full_like(like, -jnp.inf))
        return Extremes(none, none, scene.contact_force(c, lane.mode, lane.state))

    def step(self, scene: HasContact[Any], c: Any, carry: Extremes, moment: Moment) -> Extremes:
        step = moment.step
        begins, velocity = _begins(scene, c, step)
        since = _updated(carry.since, begins, velocity, velocity)
        return Extremes(since, carry.whole, jnp.maximum(carry.peak, highest(_force(scene, c, step), step.tau)))

    def section(self, scene: HasContact[Any], c: Any, carry: Extremes, at: Return) -> Extremes:
        slowest, fastest = carry.since
        whole = _updated(carry.whole, at.here & (at.number > 0), slowest, fastest)
        since = (jnp.where(at.here, jnp.inf, slowest), jnp.where(at.here, -jnp.inf, fastest))
        return Extremes(since, whole, carry.peak)

    def read(self, scene: HasContact[Any], c: Any, carry: Extremes, whole: Whole) -> dict[str, Lanes]:
        sums, count = whole.sums, whole.sums["impacts"]
        per_return = count / whole.returns
        slowest, fastest = carry.whole
        sliding = {"bit_velocity_at_impact": sums["bit_velocity"] / count} if isinstance(scene, HasFriction) else {}
        return sliding | {
            "impacts": jnp.where(whole.cycles > 0, jnp.round(per_return * whole.cycles), per_return),
            "impact_velocity": sums["velocity"] / count,
            "impact_velocity_min": jnp.where(count > 0, slowest, jnp.nan),
            "impact_velocity_max": jnp.where(count > 0, fastest, jnp.nan),
            "impact_phase": 2 * jnp.pi * sums["lag"] / count,
            "impact_energy": scene.striker_mass(c) / 2 * sums["velocity_squared"] / count,
            "peak_impact_force": carry.peak,
            "mean_impact_force": sums["force"] / whole.time,
        }


def _begins(scene: HasContact[Any], c: Any, step: Step) -> tuple[Flags, Lanes]:
    """Return a mask of the lanes in which an impact begins at the end of the step, and the impact velocity [m/s]."""
    begins = keep(scene.impact_begins(c, step.mode, step.after, step.hits))
    return begins, scene.impact_rate(c, step.mode, step.after)


def _updated(extremes: Pair, where: Flags, slowest: Lanes, fastest: Lanes) -> Pair:
    low, high = extremes
    return jnp.where(where, jnp.minimum(low, slowest), low), jnp.where(where, jnp.maximum(high, fastest), high)


def _force(scene: HasContact[Any], c: Any, step: Step) -> list[Lanes]:
    """Return the coefficients in tau of the contact force J [N] over the step."""
    force = scene.contact_force(c, step.mode, tuple(known(polynomial) for polynomial in step.polynomials))
    return keep([force[k] for k in range(len(step.polynomials[0]))])
