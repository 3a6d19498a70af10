"""Impacts of the striker on the bit, and the force between them."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.measures.gauge import Gauge, Moment, Return, Sums, Whole
from vibrojax.models.arrays import Lanes, keep
from vibrojax.models.scenes.capabilities import HasContact, HasFriction
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import highest, integral
from vibrojax.stepping.series import known


class Extremes(NamedTuple):
    """Impact velocities [m/s], the slowest and the fastest `since` the last return and in `whole` returns, each a pair;
    and the greatest force [N]."""

    since: tuple[Lanes, Lanes]
    whole: tuple[Lanes, Lanes]
    peak: Lanes


@dataclass(frozen=True)
class Impacts(Gauge[HasContact[Any]]):
    """impacts, impact_velocity(_min, _max), impact_phase, impact_energy, impact forces; and of a bit that slides
    bit_velocity_at_impact."""

    summed = ("impacts", "velocity", "velocity_squared", "bit_velocity", "lag", "force")
    needs = (HasContact,)

    def increments(self, scene: HasContact[Any], c: Any, moment: Moment) -> Sums:
        step = moment.step
        begins = keep(scene.impact_begins(c, step.mode, step.after, step.hits))
        velocity = scene.impact_rate(c, step.mode, step.after)
        return {
            "impacts": begins.astype(step.dt.dtype),
            "velocity": jnp.where(begins, velocity, 0),
            "velocity_squared": jnp.where(begins, velocity * velocity, 0),
            "bit_velocity": jnp.where(begins, _sliding_velocity(scene, c, step.after), 0),
            "lag": jnp.where(begins, moment.since, 0),
            "force": step.h * integral(_force(scene, c, step), step.tau),
        }

    def close(self, sums: Sums, interval: Lanes) -> Sums:
        """Return the lags as shares of the return in which their impacts fall."""
        return {"lag": sums["lag"] / interval}

    def begin(self, scene: HasContact[Any], c: Any, lane: Lane) -> Extremes:
        like = jnp.zeros_like(lane.state[0])
        none = (jnp.full_like(like, jnp.inf), jnp.full_like(like, -jnp.inf))
        return Extremes(none, none, scene.contact_force(c, lane.mode, lane.state))

    def step(self, scene: HasContact[Any], c: Any, carry: Extremes, moment: Moment) -> Extremes:
        step = moment.step
        begins = keep(scene.impact_begins(c, step.mode, step.after, step.hits))
        velocity = scene.impact_rate(c, step.mode, step.after)
        slowest, fastest = carry.since
        since = (
            jnp.where(begins, jnp.minimum(slowest, velocity), slowest),
            jnp.where(begins, jnp.maximum(fastest, velocity), fastest),
        )
        peak = jnp.maximum(carry.peak, highest(_force(scene, c, step), step.tau))
        return Extremes(since, carry.whole, peak)

    def section(self, scene: HasContact[Any], c: Any, carry: Extremes, at: Return) -> Extremes:
        slowest, fastest = carry.since
        counts = at.here & (at.number > 0)
        whole = (
            jnp.where(counts, jnp.minimum(carry.whole[0], slowest), carry.whole[0]),
            jnp.where(counts, jnp.maximum(carry.whole[1], fastest), carry.whole[1]),
        )
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


def _sliding_velocity(scene: HasContact[Any], c: Any, state: tuple[Lanes, ...]) -> Lanes:
    """u = x1' + v [m/s]; 0 where nothing slides."""
    if not isinstance(scene, HasFriction):
        return jnp.zeros_like(state[0])
    return state[scene.place(scene.bit_velocity)] + scene.bit(c).drive_speed


def _force(scene: HasContact[Any], c: Any, step: Step) -> list[Lanes]:
    """Coefficients in tau of the contact force J [N] over the step."""
    force = scene.contact_force(c, step.mode, tuple(known(one) for one in step.polynomials))
    return keep([force[k] for k in range(len(step.polynomials[0]))])
