"""The last returns to the section, kept one by one: for bifurcation diagrams, and to tell where a lane is going."""

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
    """The last returns: an array (keep, features, lanes) in whose rows they stand in turn."""

    rows: Array


@dataclass(frozen=True)
class KeptReturns(Gauge[Scene[Any]]):
    """The last `keep` returns of the observation: time, time since the one before, the return map's states, and the
    impacts since the one before with their mean velocity."""

    keep: int

    def begin(self, scene: Scene[Any], c: Any, lane: Lane) -> Ring:
        shape = (self.keep, len(_names(scene)), *lane.state[0].shape)
        return Ring(jnp.full(shape, jnp.nan, lane.state[0].dtype))

    def section(self, scene: Scene[Any], c: Any, carry: Ring, at: Return) -> Ring:
        new = [at.lane.clock.high, at.interval, *(at.lane.state[place] for place in _states(scene).values())]
        if isinstance(scene, HasContact):
            whole = at.number > 0
            new.append(jnp.where(whole, at.sums["impacts"], jnp.nan))
            new.append(jnp.where(whole, at.sums["velocity"] / at.sums["impacts"], jnp.nan))
        row = jnp.where(at.here, at.number % self.keep, self.keep).astype(jnp.int32)
        put = jax.vmap(lambda rows, row, new: rows.at[row].set(new, mode="drop"), in_axes=-1, out_axes=-1)
        return Ring(put(jnp.asarray(carry.rows), row, jnp.stack(new)))

    def read(self, scene: Scene[Any], c: Any, carry: Ring, whole: Whole) -> dict[str, Array]:
        # Oldest first: where the ring is full, it starts at the row after the newest.
        time = carry.rows[:, 0]
        order = jnp.argsort(jnp.where(jnp.isnan(time), -jnp.inf, time), axis=0)
        return {
            name: jnp.take_along_axis(carry.rows[:, index], order, axis=0) for index, name in enumerate(_names(scene))
        }


def state_name(name: str) -> str:
    """What a state at the returns is called among the features."""
    return f"return_{name}"


def _states(scene: Scene[Any]) -> dict[str, int]:
    """Places of the return map's states, by the features' names."""
    return {state_name(name): scene.place(name) for name in scene.return_states}


def _names(scene: Scene[Any]) -> tuple[str, ...]:
    return (TIME, INTERVAL, *_states(scene), *(IMPACTS if isinstance(scene, HasContact) else ()))
