"""How the blows of the drill drive the hole."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.measures.gauge import Gauge, Moment, Sums, Whole
from vibrojax.models.arrays import Lanes
from vibrojax.models.scenes.capabilities import HasContact, HasRock
from vibrojax.stepping import Lane
from vibrojax.stepping.polynomial import highest, value


class Deepest(NamedTuple):
    """The least compression of the rock so far [m], at most 0."""

    gap: Lanes


@dataclass(frozen=True)
class Hole(Gauge[HasRock[Any]]):
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m].

    For a scene with rock and contact: P is the mean contact force, so this gauge goes with
    [vibrojax.measures.impacts][], whose sums it reads.
    """

    summed = ("growth",)
    needs = (HasRock, HasContact)

    def increments(self, scene: HasRock[Any], c: Any, moment: Moment) -> Sums:
        growth = moment.step.polynomials[scene.place("growth")]
        return {"growth": value(growth, moment.step.tau) - growth[0]}

    def begin(self, scene: HasRock[Any], c: Any, lane: Lane) -> Deepest:
        return Deepest(jnp.minimum(lane.state[scene.place("compression")], 0))

    def step(self, scene: HasRock[Any], c: Any, carry: Deepest, moment: Moment) -> Deepest:
        step = moment.step
        compression = step.polynomials[scene.place("compression")]
        lowest = -highest([-one for one in compression], step.tau)
        return Deepest(jnp.minimum(carry.gap, lowest))

    def read(self, scene: HasRock[Any], c: Any, carry: Deepest, whole: Whole) -> Sums:
        mean_force = whole.sums["force"] / whole.time
        return {
            "rate_of_penetration": whole.sums["growth"] / whole.time,
            "slip_per_impact": whole.sums["growth"] / whole.sums["impacts"],
            "mean_force": mean_force,
            "relief": mean_force / scene.threshold(c),
            "deepest_gap": carry.gap,
        }
