"""How the blows of the drill drive the hole."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge
from vibrojax.stepping.polynomial import highest, value


@dataclass(frozen=True)
class Drilling(Gauge):
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m].

    P is the mean contact force, so this gauge goes with [vibrojax.measure.impacts][], whose sums it reads.
    """

    summed = ("growth",)

    def increments(self, scene, p, moment):
        growth = moment.step.polynomials[scene.states.index("growth")]
        return {"growth": value(growth, moment.step.tau) - growth[0]}

    def begin(self, scene, p, lane):
        return {"deepest": jnp.minimum(_compression(scene, lane), 0)}

    def step(self, scene, p, carry, moment):
        step = moment.step
        compression = step.polynomials[scene.states.index("compression")]
        lowest = -highest([-c for c in compression], step.tau)
        return {"deepest": jnp.minimum(carry["deepest"], lowest)}

    def read(self, scene, p, carry, whole):
        mean_force = whole.sums["force"] / whole.time
        return {
            "rate_of_penetration": whole.sums["growth"] / whole.time,
            "slip_per_impact": whole.sums["growth"] / whole.sums["impacts"],
            "mean_force": mean_force,
            "relief": mean_force / p["threshold"],
            "deepest_gap": carry["deepest"],
        }


def _compression(scene, lane):
    return lane.state[scene.states.index("compression")]
