"""Penetration under a given force, over whole pulses: growth of the hole, mean force, how far the bit jumps off."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.measures import ledger
from vibrojax.measures.kept_returns import state_name
from vibrojax.measures.ledger import Ledger
from vibrojax.measures.recorder import Features, Records
from vibrojax.models.arrays import Array, Flags, Lanes
from vibrojax.models.scenes.capabilities import Driven, HasRock
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import integral, value
from vibrojax.stepping.series import known


class Pulses(NamedTuple):
    """What is carried: lanes that are `waiting` where a pulse begins, the `number` of them so far, the sums over them,
    the `deepest` gap [m], and the states at the `last` one (states, lanes)."""

    waiting: Flags
    number: Lanes
    ledger: Ledger
    deepest: Lanes
    last: Array


@dataclass(frozen=True)
class PulseRecorder(Records):
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m].

    Means are over whole pulses, NaN where there is none; over the whole observation under a swept sine. Before the
    observation there is nothing to know. The states where the last pulse begins are kept, to tell where a lane is.
    """

    def settling(self, scene: Scene[Any], lane: Lane) -> tuple[()]:
        return ()

    def settle(self, scene: Scene[Any], c: Any, carry: tuple[()], lane: Lane, step: Step) -> tuple[()]:
        return carry

    def settle_returns(self, carry: tuple[()]) -> tuple[()]:
        return carry

    def settled(self, begun: tuple[()], observed: Pulses) -> tuple[()]:
        return begun

    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: tuple[()]) -> Pulses:
        compression = lane.state[scene.place("compression")]
        # At t = 0 a pulse begins that no event tells of.
        first = (lane.clock.high == 0) & _driven(scene).has_pulses
        sums = ledger.begin(("time", "growth", "force", "yields"), compression)
        last = jnp.full((len(scene.return_states), *compression.shape), jnp.nan, compression.dtype)
        return Pulses(first, jnp.zeros_like(compression), sums, jnp.minimum(compression, 0), last)

    def step(self, scene: Scene[Any], c: Any, carry: Pulses, lane: Lane, step: Step) -> Pulses:
        states = tuple(known(one) for one in step.polynomials)
        force = _driven(scene).applied_force(c, step.mode, states)
        force = [force.array(k, step.dt) for k in range(len(step.polynomials[0]))]
        growth = step.polynomials[scene.place("growth")]
        yields = step.hits["yield"] & (step.mode[scene.mode_place("rock")] == 0)
        increments = {
            "time": step.dt,
            "growth": value(growth, step.tau) - growth[0],
            "force": step.h * integral(force, step.tau),
            "yields": yields.astype(step.dt.dtype),
        }
        return carry._replace(
            waiting=carry.waiting | _driven(scene).pulse_begins(c, step.mode, step.hits),
            ledger=ledger.add(carry.ledger, increments),
            deepest=jnp.minimum(carry.deepest, lane.state[scene.place("compression")]),
        )

    def waiting(self, carry: Pulses) -> Flags:
        return carry.waiting

    def take_returns(self, scene: Scene[Any], c: Any, carry: Pulses, lane: Lane, share: Lanes) -> Pulses:
        here, number = carry.waiting, carry.number
        totals, _ = ledger.section(carry.ledger, here, number)
        last = carry.last
        if scene.return_states:
            states = jnp.stack([lane.state[scene.place(name)] for name in scene.return_states])
            last = jnp.where(here[None], states, last)
        return Pulses(jnp.zeros_like(here), jnp.where(here, number + 1, number), totals, carry.deepest, last)

    def read(self, scene: Scene[Any], c: Any, carry: Pulses) -> Features:
        number = carry.number
        whole, pulses = ledger.whole(carry.ledger, number, jnp.zeros_like(number))
        # A half-open pulse at either end would bias the means; only a force without pulses is taken as it comes.
        alone = jnp.zeros_like(number, bool) if _driven(scene).has_pulses else number == 0
        sums = {name: jnp.where(alone, carry.ledger.sums[name], whole[name]) for name in whole}
        mean_force = sums["force"] / sums["time"]
        return {
            **{state_name(name): carry.last[index] for index, name in enumerate(scene.return_states)},
            "rate_of_penetration": sums["growth"] / sums["time"],
            "slip_per_impact": sums["growth"] / pulses,
            "mean_force": mean_force,
            "relief": mean_force / _driven(scene).threshold(c),
            "deepest_gap": carry.deepest,
            "pulses": pulses,
            "yields": sums["yields"],
        }


def _driven(scene: Scene[Any]) -> Any:
    """The scene as one that is driven and has rock, which this recorder is for."""
    assert isinstance(scene, Driven) and isinstance(scene, HasRock)
    return scene
