"""Growth of the hole, force and relief: by the blows of a drill, over its returns, or by a force, over its pulses."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.measures import ledger
from vibrojax.measures.gauge import Gauge, Moment, Sums, Whole
from vibrojax.measures.kept_returns import state_name
from vibrojax.measures.ledger import Ledger
from vibrojax.measures.recorder import Features, Records
from vibrojax.models.arrays import Array, Flags, Lanes
from vibrojax.models.scenes.capabilities import Driven, HasContact, HasRock
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import highest, integral, value
from vibrojax.stepping.series import known


class Deepest(NamedTuple):
    """The least compression of the rock so far [m], at most 0."""

    gap: Lanes


@dataclass(frozen=True)
class Hole(Gauge[HasRock[Any]]):
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m].

    It measures a scene with rock and contact: P is the mean contact force. It reads the sums of
    [vibrojax.measures.impacts][], so that gauge must come with it.
    """

    summed = ("growth",)
    needs = (HasRock, HasContact)

    def increments(self, scene: HasRock[Any], c: Any, moment: Moment) -> Sums:
        return {"growth": _growth(scene, moment.step)}

    def begin(self, scene: HasRock[Any], c: Any, lane: Lane) -> Deepest:
        return Deepest(jnp.minimum(lane.state[scene.place("compression")], 0))

    def step(self, scene: HasRock[Any], c: Any, carry: Deepest, moment: Moment) -> Deepest:
        compression = moment.step.polynomials[scene.place("compression")]
        lowest = -highest([-coefficient for coefficient in compression], moment.step.tau)
        return Deepest(jnp.minimum(carry.gap, lowest))

    def read(self, scene: HasRock[Any], c: Any, carry: Deepest, whole: Whole) -> Sums:
        return _rates(scene, c, whole.sums, whole.time, whole.sums["impacts"], carry.gap)


class Pulses(NamedTuple):
    """The pulse recorder's carry.

    Lanes `waiting` at the beginning of a pulse, the `number` of pulses so far, the sums over them, the `deepest` gap
    [m], and the states at the `last` beginning (states, lanes).
    """

    waiting: Flags
    number: Lanes
    ledger: Ledger
    deepest: Lanes
    last: Array


@dataclass(frozen=True)
class PulseRecorder(Records):
    """rate_of_penetration [m/s], slip_per_impact [m], mean_force [N], relief [1], deepest_gap [m].

    Means are over whole pulses, NaN without any, and over the whole observation under a swept sine. Nothing is recorded
    before the observation. The states at the last pulse's beginning are kept as the lane's place.
    """

    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: tuple[()]) -> Pulses:
        compression = lane.state[scene.place("compression")]
        # A pulse begins at t = 0 without an event.
        first = (lane.clock.high == 0) & _driven(scene).has_pulses
        sums = ledger.begin(("time", "growth", "force", "yields"), compression)
        last = jnp.full((len(scene.return_states), *compression.shape), jnp.nan, compression.dtype)
        return Pulses(first, jnp.zeros_like(compression), sums, jnp.minimum(compression, 0), last)

    def step(self, scene: Scene[Any], c: Any, carry: Pulses, lane: Lane, step: Step) -> Pulses:
        states = tuple(known(polynomial) for polynomial in step.polynomials)
        force = _driven(scene).applied_force(c, step.mode, states).arrays(len(step.polynomials[0]) - 1, step.dt)
        yields = step.hits["yield"] & (step.mode[scene.mode_place("rock")] == 0)
        increments = {
            "time": step.dt,
            "growth": _growth(scene, step),
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
        # Half a pulse at either end would bias the means; without pulses the whole observation counts.
        alone = jnp.zeros_like(number, bool) if _driven(scene).has_pulses else number == 0
        sums = {name: jnp.where(alone, carry.ledger.sums[name], whole[name]) for name in whole}
        return {
            **{state_name(name): carry.last[index] for index, name in enumerate(scene.return_states)},
            **_rates(_driven(scene), c, sums, sums["time"], pulses, carry.deepest),
            "pulses": pulses,
            "yields": sums["yields"],
        }


def _driven(scene: Scene[Any]) -> Any:
    """Return the scene, which is driven and has rock."""
    assert isinstance(scene, Driven) and isinstance(scene, HasRock)
    return scene


def _growth(scene: Scene[Any], step: Step) -> Lanes:
    """Return the growth of the hole over the step [m]."""
    growth = step.polynomials[scene.place("growth")]
    return value(growth, step.tau) - growth[0]


def _rates(scene: HasRock[Any], c: Any, sums: Mapping[str, Lanes], time: Lanes, blows: Lanes, gap: Lanes) -> Features:
    """Return the features of the hole for sums over `time` [s] with a number of `blows`."""
    mean_force = sums["force"] / time
    return {
        "rate_of_penetration": sums["growth"] / time,
        "slip_per_impact": sums["growth"] / blows,
        "mean_force": mean_force,
        "relief": mean_force / scene.threshold(c),
        "deepest_gap": gap,
    }
