"""The visco-elasto-plastic rock under the bit (source, eqs. 6.1 to 6.3), and the rocks of Table 4.5 of the source.

The bottom of the hole acts as a ratchet: it only moves downwards.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Real, Value
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


class Part(NamedTuple):
    """Indicators of the active branch of eq. 6.2 of the source.

    `elastic` is 1 while the rock is elastic, `yielding` is 1 while the rock yields. Both are 0 off the rock.
    """

    elastic: Value
    yielding: Value


def part(rock: Value) -> Part:
    """Return the active branch in the mode `rock`: 0 is elastic, 1 is yielding, any other value is neither."""
    return Part(jnp.where(rock == 0, 1.0, 0.0), jnp.where(rock == 1, 1.0, 0.0))


def resistance(compression: Any, k3: Value, threshold: Value, holds: Part | None = None) -> Any:
    """Return the resistance N = clip(k3 (x3 - x4), 0, D) [N] (source, eq. 6.2) for `compression` x3 - x4 [m].

    If `holds` is given, its branch is used for any compression. Taylor series are then accepted in addition to arrays.
    """
    if holds is None:
        elastic = (compression > 0) & (k3 * compression < threshold)
        holds = Part(jnp.where(elastic, 1.0, 0.0), jnp.where((compression > 0) & ~elastic, 1.0, 0.0))
    return compression * (holds.elastic * k3) + holds.yielding * threshold


def ratchet(x3: Real, x4: Real, k3: Real, threshold: Real) -> Any:
    """Return the depth x4 [m] of the hole after the bit was at `x3`: the running maximum of x3 - D/k3 (eq. 6.3)."""
    return jnp.maximum(x4, x3 - threshold / k3)
