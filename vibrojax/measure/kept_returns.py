"""The last returns to the section, kept one by one for bifurcation diagrams."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge


@dataclass(frozen=True)
class KeptReturns(Gauge):
    """A ring of the last `keep` returns of the observation: time, section state, impacts, impact velocity."""

    keep: int

    def begin(self, scene, p, lane):
        empty = jnp.full((self.keep, *lane.state[0].shape), jnp.nan, lane.state[0].dtype)
        return {name: empty for name in self._names(scene)}

    def _names(self, scene):
        names = ("return_time", "return_x1", "return_x2", "return_v2")
        return (*names, "return_impacts", "return_impact_velocity") if hasattr(scene, "impact_begins") else names

    def section(self, scene, p, carry, at):
        x1, _, x2, v2 = at.lane.state[:4]
        new = {"return_time": at.lane.clock.high, "return_x1": x1, "return_x2": x2, "return_v2": v2}
        if "impacts" in at.sums:
            whole = at.number > 0
            new["return_impacts"] = jnp.where(whole, at.sums["impacts"], jnp.nan)
            new["return_impact_velocity"] = jnp.where(whole, at.sums["velocity"] / at.sums["impacts"], jnp.nan)
        row = jnp.where(at.here, at.number % self.keep, self.keep).astype(jnp.int32)
        lanes = jnp.arange(row.shape[0])
        return {name: old.at[row, lanes].set(new[name], mode="drop") for name, old in carry.items()}

    def read(self, scene, p, carry, whole):
        # Oldest first: where the ring is full, it starts at the row after the newest.
        order = jnp.argsort(jnp.where(jnp.isnan(carry["return_time"]), -jnp.inf, carry["return_time"]), axis=0)
        return {name: jnp.take_along_axis(kept, order, axis=0) for name, kept in carry.items()}
