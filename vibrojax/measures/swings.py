"""How far bit and striker swing, and whether the swing steadily grows or decays."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.gauge import Gauge, Moment, Return, Whole
from vibrojax.models.arrays import Array, Lanes
from vibrojax.models.scenes.declared import Swing
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane

EIGHTHS = 8


class Swung(NamedTuple):
    """The least and greatest value of each swing's position, and the first one's greatest amplitude in each eighth of
    the observation, (8, lanes)."""

    ranges: tuple[tuple[Lanes, Lanes], ...]
    greatest: Array


@dataclass(frozen=True)
class Swings(Gauge[Scene[Any]]):
    """The amplitudes that the section names [m]; trend: 1 where the first one steadily grows, -1 decays, 0 neither."""

    def begin(self, scene: Scene[Any], c: Any, lane: Lane) -> Swung:
        places = _positions(scene, lane)
        none = jnp.full((EIGHTHS, *places[0].shape), jnp.nan, places[0].dtype)
        return Swung(tuple((x, x) for x in places), none)

    def step(self, scene: Scene[Any], c: Any, carry: Swung, moment: Moment) -> Swung:
        places = _positions(scene, moment.lane)
        return carry._replace(ranges=tuple(widened(one, x) for one, x in zip(carry.ranges, places, strict=True)))

    def section(self, scene: Scene[Any], c: Any, carry: Swung, at: Return) -> Swung:
        eighth = jnp.clip(jnp.floor(at.share * EIGHTHS), 0, EIGHTHS - 1)
        index = jnp.arange(EIGHTHS, dtype=eighth.dtype).reshape(-1, *[1] * at.here.ndim)
        mine = at.here[None] & (at.number[None] > 0) & (eighth[None] == index)
        greatest = jnp.where(mine, jnp.fmax(carry.greatest, at.amplitudes[0][None]), carry.greatest)
        return carry._replace(greatest=greatest)

    def read(self, scene: Scene[Any], c: Any, carry: Swung, whole: Whole) -> dict[str, Lanes]:
        swings = zip(_swings(scene), carry.ranges, strict=True)
        amplitudes = {swing.amplitude: (highest - lowest) / 2 for swing, (lowest, highest) in swings}
        return amplitudes | {"trend": _trend(carry.greatest)}


def widened(extremes: tuple[Lanes, Lanes], x: Lanes) -> tuple[jax.Array, jax.Array]:
    """The least and greatest value, `x` taken in."""
    lowest, highest = extremes
    return jnp.minimum(lowest, x), jnp.maximum(highest, x)


def _swings(scene: Scene[Any]) -> tuple[Swing, ...]:
    assert scene.section is not None
    return scene.section.swings


def _positions(scene: Scene[Any], lane: Lane) -> list[Lanes]:
    return [lane.state[scene.place(swing.position)] for swing in _swings(scene)]


def _trend(greatest: Array) -> jax.Array:
    """1 where the eighths strictly rise, -1 where they strictly fall, by over 1 % from first to last; else 0."""
    change = jnp.diff(greatest, axis=0)  # NaN, and so neither, where an eighth has no return
    first, last = greatest[0], greatest[-1]
    grows = jnp.all(change > 0, axis=0) & (last > 1.01 * first)
    decays = jnp.all(change < 0, axis=0) & (last < 0.99 * first)
    return jnp.where(grows, 1.0, jnp.where(decays, -1.0, 0.0))
