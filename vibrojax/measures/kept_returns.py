"""Gauge that stores the last section crossings individually, for bifurcation diagrams and for the drift of a lane."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.gauge import Gauge, Return, Whole
from vibrojax.models.arrays import Array
from vibrojax.models.scenes.capabilities import HasContact
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane

TIME, INTERVAL = "return_time", "return_interval"
IMPACTS = ("return_impacts", "return_impact_velocity")


class Ring(NamedTuple):
    """Ring buffer of the last section crossings, an array (keep, features, lanes)."""

    rows: Array


@dataclass(frozen=True)
class KeptReturns(Gauge[Scene[Any]]):
    """The last `keep` section crossings of the observation: time, interval, states and impacts.

    The interval is the time since the previous crossing. The states are the states of the return map. The number of
    impacts since the previous crossing and their mean velocity are stored if the scene has a contact.
    """

    keep: int

    def begin(self, scene: Scene[Any], c: Any, lane: Lane) -> Ring:
        shape = (self.keep, len(_names(scene)), *lane.state[0].shape)
        return Ring(jnp.full(shape, jnp.nan, lane.state[0].dtype))

    def section(self, scene: Scene[Any], c: Any, carry: Ring, at: Return) -> Ring:
        states = [at.lane.state[scene.place(name)] for name in scene.return_states]
        new = [at.lane.clock.high, at.interval, *states]
        if isinstance(scene, HasContact):
            whole = at.number > 0
            new.append(jnp.where(whole, at.sums["impacts"], jnp.nan))
            new.append(jnp.where(whole, at.sums["velocity"] / at.sums["impacts"], jnp.nan))
        row = jnp.where(at.here, at.number % self.keep, self.keep).astype(jnp.int32)
        put = jax.vmap(lambda rows, row, new: rows.at[row].set(new, mode="drop"), in_axes=-1, out_axes=-1)
        return Ring(put(jnp.asarray(carry.rows), row, jnp.stack(new)))

    def read(self, scene: Scene[Any], c: Any, carry: Ring, whole: Whole) -> dict[str, Array]:
        # Oldest crossing first. In a full ring buffer, the oldest row follows the newest.
        time = carry.rows[:, 0]
        order = jnp.argsort(jnp.where(jnp.isnan(time), -jnp.inf, time), axis=0)
        columns = enumerate(_names(scene))
        return {name: jnp.take_along_axis(carry.rows[:, index], order, axis=0) for index, name in columns}


def state_name(name: str) -> str:
    """Return the name of the feature that stores a state at section crossings."""
    return f"return_{name}"


def _names(scene: Scene[Any]) -> tuple[str, ...]:
    impacts = IMPACTS if isinstance(scene, HasContact) else ()
    return (TIME, INTERVAL, *(state_name(name) for name in scene.return_states), *impacts)
