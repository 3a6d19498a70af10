"""The one-sided contact as a hybrid system in terms of compression and compression rate (source, eq. 5.18).

The mode `touching` is 0 (apart) until compression and force are positive, then 1 until the force is zero.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.models.physics.contact import raw_force
from vibrojax.models.physics.elementary import maximum
from vibrojax.models.scenes.scene import ROUNDINGS


class ContactConstants(NamedTuple):
    """Constants of the contact, each (lanes,).

    Stiffness `k0` [N/m], damping `c0` [N s/m], gap `delta` [m], and relaxation time `relaxation` = c0/k0 [s].
    """

    k0: Any
    c0: Any
    delta: Any
    relaxation: Any


def contact_constants(p: Mapping[str, Any]) -> ContactConstants:
    """Return the constants of the contact from `k0`, `c0` and `delta` in `p`."""
    return ContactConstants(p["k0"], p["c0"], p["delta"], p["c0"] / p["k0"])


def force(c: ContactConstants, touching: Any, compression: Any, rate: Any) -> Any:
    """Return the contact force J [N] in the mode `touching`; arrays and Taylor series are accepted."""
    return touching * raw_force(compression, rate, c.k0, c.c0)


def guard(c: ContactConstants, touching: Any, compression: Any, rate: Any) -> Any:
    """Return the guard [m]: J/k0 while touching; while apart, the distance from the state in which contact begins."""
    length = compression + c.relaxation * rate
    # Contact begins when compression and force are both positive. A striker released while still compressed (c0 > 0)
    # is therefore not caught again at once.
    return touching * length + (1.0 - touching) * maximum(-compression, -length)


def touching_at(c: ContactConstants, compression: Any, rate: Any, pushed: Any) -> Any:
    """Return the mode at a state; `pushed` [N] is the force that closes a contact at zero compression and zero rate."""
    closes = (rate > 0) | ((rate == 0) & (pushed > 0))
    inside = (compression > 0) & (raw_force(compression, rate, c.k0, c.c0) > 0)
    return jnp.where(inside | ((compression == 0) & closes), 1.0, 0.0)


def energy(c: ContactConstants, compression: Any) -> Any:
    """Return the energy [J] stored in the contact's spring at this compression, in either mode."""
    inside = jnp.maximum(compression, 0)
    return c.k0 * inside * inside / 2


def begins(c: ContactConstants, touching: Any, compression: Any, rate: Any, hit: Any, noise: Any) -> Any:
    """Return a mask of the contacts that begin from outside, that is, of the impacts.

    `noise`: compression [m] that counts as zero. A contact that is released while still compressed (c0 > 0) may close
    again while compressed; that is not a new impact.
    """
    return hit & (touching == 0) & (c.relaxation * rate >= 0) & (compression <= noise)


def reset(c: ContactConstants, touching: Any, compression: Any, rate: Any, hit: Any, noise: Any) -> tuple[Any, Any]:
    """Return the mode after an event, and the compression.

    Where the guard is reached (`hit`), the mode switches and the compression is set to its exact value on the guard.
    """
    from_outside = begins(c, touching, compression, rate, hit, noise)
    compression = jnp.where(hit & (touching != 0), -c.relaxation * rate, compression)
    compression = jnp.where(from_outside, 0.0, compression)
    return jnp.where(hit, 1.0 - touching, touching), compression


def stiff_rate(c: ContactConstants, inverse_mass: Any, flight: Any) -> Any:
    """Return the fastest rate of change in contact [1/s]; `flight`: the fastest rate without contact [1/s]."""
    return jnp.sqrt(c.k0 * inverse_mass + flight * flight) + c.c0 * inverse_mass


def own_rate(c: ContactConstants, mass: Any) -> Any:
    """Return the rate of change [1/s] of a `mass` [kg] on the contact's spring and damper alone."""
    return jnp.sqrt(c.k0 / mass) + c.c0 / mass


def force_resolution(c: ContactConstants, mass: Any, speed: Any) -> Any:
    """Return the contact force [N] that counts as zero.

    It corresponds to a small multiple of the rounding error of the position, for a `mass` [kg] that meets the contact
    at `speed` [m/s].
    """
    reach = jnp.abs(c.delta) + jnp.sqrt(mass / c.k0) * speed
    return ROUNDINGS * jnp.finfo(c.k0.dtype).eps * c.k0 * reach
