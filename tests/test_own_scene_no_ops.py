"""Tests that no-ops in a user's scene (loops, booleans, unsigned integers) change nothing."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import lax

import vibrojax as vj
from vibrojax.scenes.vibro_impact import VibroImpact


def no_ops(x):
    """Return 0 from an empty loop, a comparison of booleans, and one of unsigned integers beyond the signed range."""
    looped = lax.fori_loop(0, 0, lambda turn, total: total + 1e-3, 0.0 * x)
    compared = jnp.where((x > -1.0) < (x > 1.0), 1e-3 + 0.0 * x, 0.0 * x)
    large = (0.0 * x + 4e9).astype(jnp.uint32) > jnp.uint32(10)
    return looped + compared + jnp.where(large, 0.0 * x, 1e-3 + 0.0 * x)


@dataclass(frozen=True)
class Changed(VibroImpact):
    """A scene that adds a computed 0 to its gap."""

    changed: bool = True

    def constants(self, p):
        gap = p["delta"]
        return super().constants(p | {"delta": gap + (no_ops(gap) if self.changed else 0.0 * gap)})


def test_no_ops_change_nothing():
    """The impact velocity is equal bit for bit."""
    axes, run = {"gamma": [0.7], "beta": [0.4]}, {"settle": 3.0, "observe": 3.0}
    changed, usual = (
        vj.run_sweep({"scene": Changed(changed=flag), "grid": axes, "run": run}, progress=False).impact_velocity.values
        for flag in (True, False)
    )
    assert np.all(np.isfinite(usual))
    np.testing.assert_array_equal(changed, usual)
