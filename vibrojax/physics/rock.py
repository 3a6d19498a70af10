"""The visco-elasto-plastic rock under the bit (source, eqs. 6.1 to 6.3), and the rocks of Table 4.5 of the source.

The bottom of the hole acts as a ratchet: x4 only grows, with x3 while the rock yields.
"""

from dataclasses import dataclass
from typing import Any

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Value
from vibrojax.physics.parameters import not_negative, positive, table

ROCK = table(
    positive("k3", 300e6, "N m-1", "stiffness of the rock", "k₃", (20e6, 500e6)),
    not_negative("threshold", 150e3, "N", "force at which the rock yields", "D", (30e3, 300e3)),
    not_negative("zeta", 1.1, "1", "damping ratio of the bit on the rock", "ζ", (0.1, 2.0)),
)


@dataclass(frozen=True)
class Rock:
    """A rock of Table 4.5 of the source.

    `threshold`: yield force D [N]; `k3`: stiffness [N/m]; `ucs`: uniaxial compressive strength [Pa]; `modulus`:
    Young's modulus E [Pa]; `density` [kg/m³].
    """

    threshold: float
    k3: float
    ucs: float
    modulus: float
    density: float


ROCKS = {
    "sandstone": Rock(61.9e3, 100.68e6, 84.9e6, 4.7e9, 2382.0),
    "limestone": Rock(140.3e3, 175.32e6, 192.4e6, 8.2e9, 2480.0),
    "granite": Rock(204.5e3, 224.24e6, 280.5e6, 10.5e9, 2687.0),
}


def damping(m1: Value, k3: Value, zeta: Value) -> Any:
    """Return the damping c3 = 2 zeta sqrt(m1 k3) [N s/m] (source, eq. 6.1) for m1 [kg], k3 [N/m] and zeta [1].

    The arguments have any shapes that broadcast.
    """
    return 2 * zeta * jnp.sqrt(m1 * k3)


def resistance(compression: Value, k3: Value, threshold: Value, rock: Value) -> Any:
    """Return the resistance N [N] of the rock in the mode `rock` (source, eq. 6.2): 0 is elastic, 1 is yielding.

    It is k3 (x3 - x4) while elastic, D while yielding, and 0 in any other mode. `compression`: x3 - x4 [m]; Taylor
    series are accepted.
    """
    elastic, yielding = jnp.where(rock == 0, 1.0, 0.0), jnp.where(rock == 1, 1.0, 0.0)
    return compression * (elastic * k3) + yielding * threshold
