"""How far bit and striker swing, and whether the swing steadily grows or decays."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge

EIGHTHS = 8


@dataclass(frozen=True)
class Swings(Gauge):
    """bit_amplitude, striker_amplitude [m]; trend: 1 steadily growing, -1 decaying, 0 neither (contract: regime 0)."""

    def begin(self, scene, p, lane):
        x1, _, x2, _ = lane.state[:4]
        return {
            "bit": (x1, x1),
            "striker": (x2, x2),
            "greatest": jnp.full((EIGHTHS, *x1.shape), jnp.nan, x1.dtype),
        }

    def step(self, scene, p, carry, moment):
        x1, _, x2, _ = moment.lane.state[:4]
        return carry | {"bit": _widened(carry["bit"], x1), "striker": _widened(carry["striker"], x2)}

    def section(self, scene, p, carry, at):
        eighth = jnp.clip(jnp.floor(at.share * EIGHTHS), 0, EIGHTHS - 1)
        index = jnp.arange(EIGHTHS, dtype=eighth.dtype).reshape(-1, *[1] * at.here.ndim)
        mine = at.here[None] & (at.number[None] > 0) & (eighth[None] == index)
        greatest = jnp.where(mine, jnp.fmax(carry["greatest"], at.bit_amplitude[None]), carry["greatest"])
        return carry | {"greatest": greatest}

    def read(self, scene, p, carry, whole):
        return {
            "bit_amplitude": (carry["bit"][1] - carry["bit"][0]) / 2,
            "striker_amplitude": (carry["striker"][1] - carry["striker"][0]) / 2,
            "trend": _trend(carry["greatest"]),
        }


def _widened(extremes, x):
    return jnp.minimum(extremes[0], x), jnp.maximum(extremes[1], x)


def _trend(greatest):
    """1 where the eighths strictly rise, -1 where they strictly fall, by over 1 % from first to last; else 0."""
    change = jnp.diff(greatest, axis=0)  # NaN, and so neither, where an eighth has no return
    first, last = greatest[0], greatest[-1]
    grows = jnp.all(change > 0, axis=0) & (last > 1.01 * first)
    decays = jnp.all(change < 0, axis=0) & (last < 0.99 * first)
    return jnp.where(grows, 1.0, jnp.where(decays, -1.0, 0.0))
