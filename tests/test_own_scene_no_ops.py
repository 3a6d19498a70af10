"""A scene that a user writes may compute with loops, booleans and unsigned integers: no-ops change nothing."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import vibrojax as vj
from vibrojax.models.scenes.vibro_impact import VibroImpact

NO_OPS = {
    "an empty loop": lambda x: lax.fori_loop(0, 0, lambda turn, total: total + 1e-3, 0.0 * x),
    "booleans": lambda x: jnp.where((x > -1.0) < (x > 1.0), 1e-3 + 0.0 * x, 0.0 * x),
    "unsigned integers": lambda x: jnp.where(
        (0.0 * x + 4e9).astype(jnp.uint32) > jnp.uint32(10), 0.0 * x, 1e-3 + 0.0 * x
    ),
}


@dataclass(frozen=True)
class Changed(VibroImpact):
    """A scene whose gap is what it is, plus a sum that is 0."""

    by: str = ""

    def constants(self, p):
        gap = p["delta"]
        added = NO_OPS[self.by](gap) if self.by else 0.0 * gap
        return super().constants(p | {"delta": gap + added})


def impact_velocity(by):
    sweep = {"scene": Changed(by=by), "grid": {"gamma": [0.7], "beta": [0.4]}, "run": {"settle": 3.0, "observe": 3.0}}
    return vj.run_sweep(sweep, progress=False).impact_velocity.values


@pytest.fixture(scope="module")
def usual():
    return impact_velocity("")


@pytest.mark.parametrize("by", NO_OPS)
def test_a_no_op(by, usual):
    """The impact velocity stays, bit for bit."""
    assert np.all(np.isfinite(usual))
    np.testing.assert_array_equal(impact_velocity(by), usual)
