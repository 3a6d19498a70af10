"""Impacts of the striker on the bit, and the force between them."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge
from vibrojax.stepping import keep
from vibrojax.stepping.polynomial import highest, integral
from vibrojax.stepping.series import known


@dataclass(frozen=True)
class Impacts(Gauge):
    """impacts, impact_velocity(_min, _max), bit_velocity_at_impact, impact_phase, impact_energy, impact forces."""

    summed = ("impacts", "velocity", "velocity_squared", "bit_velocity", "lag", "force")

    def increments(self, scene, p, moment):
        step = moment.step
        begins = keep(scene.impact_begins(p, step.mode, step.after, step.hits))
        velocity = scene.impact_rate(p, step.mode, step.after)
        return {
            "impacts": begins.astype(step.dt.dtype),
            "velocity": jnp.where(begins, velocity, 0),
            "velocity_squared": jnp.where(begins, velocity * velocity, 0),
            "bit_velocity": jnp.where(begins, step.after[1] + p["v"], 0),
            "lag": jnp.where(begins, moment.since, 0),
            "force": step.h * integral(_force(scene, p, step), step.tau),
        }

    def begin(self, scene, p, lane):
        like = jnp.zeros_like(lane.state[0])
        none = (jnp.full_like(like, jnp.inf), jnp.full_like(like, -jnp.inf))
        return {"since": none, "whole": none, "peak": scene.contact_force(p, lane.mode, lane.state)}

    def step(self, scene, p, carry, moment):
        step = moment.step
        begins = keep(scene.impact_begins(p, step.mode, step.after, step.hits))
        velocity = scene.impact_rate(p, step.mode, step.after)
        slowest, fastest = carry["since"]
        since = (
            jnp.where(begins, jnp.minimum(slowest, velocity), slowest),
            jnp.where(begins, jnp.maximum(fastest, velocity), fastest),
        )
        return carry | {"since": since, "peak": jnp.maximum(carry["peak"], highest(_force(scene, p, step), step.tau))}

    def section(self, scene, p, carry, at):
        slowest, fastest = carry["since"]
        counts = at.here & (at.number > 0)
        whole = (
            jnp.where(counts, jnp.minimum(carry["whole"][0], slowest), carry["whole"][0]),
            jnp.where(counts, jnp.maximum(carry["whole"][1], fastest), carry["whole"][1]),
        )
        since = (jnp.where(at.here, jnp.inf, slowest), jnp.where(at.here, -jnp.inf, fastest))
        return carry | {"whole": whole, "since": since}

    def read(self, scene, p, carry, whole):
        sums, count = whole.sums, whole.sums["impacts"]
        per_return = count / whole.returns
        slowest, fastest = carry["whole"]
        period = whole.time / whole.returns
        return {
            "impacts": jnp.where(whole.cycles > 0, jnp.round(per_return * whole.cycles), per_return),
            "impact_velocity": sums["velocity"] / count,
            "impact_velocity_min": jnp.where(count > 0, slowest, jnp.nan),
            "impact_velocity_max": jnp.where(count > 0, fastest, jnp.nan),
            "bit_velocity_at_impact": sums["bit_velocity"] / count,
            "impact_phase": 2 * jnp.pi * sums["lag"] / count / period,
            "impact_energy": p["m2"] / 2 * sums["velocity_squared"] / count,
            "peak_impact_force": carry["peak"],
            "mean_impact_force": sums["force"] / whole.time,
        }


def _force(scene, p, step):
    """Coefficients in tau of the contact force J [N] over the step."""
    force = scene.contact_force(p, step.mode, tuple(known(one) for one in step.polynomials))
    return keep([force[k] for k in range(len(step.polynomials[0]))])
