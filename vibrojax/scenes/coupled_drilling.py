"""The coupled drilling scene: the bit's normal motion is fed back into the contact (the source's recommendation 1)."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.scenes._drill_on_rock import DrillOnRock


@dataclass(frozen=True)
class CoupledDrilling(DrillOnRock):
    """Contact compression x2 - delta - (x3 - x4): the drive is fed down with the hole, so the gap does not open."""

    name = "coupled-drilling"

    def indentation(self, p, rock, state):
        return state[4], state[5] * jnp.where(rock == 1, 0.0, 1.0)  # while it yields, x3' = x4'


SCENE = CoupledDrilling
