"""The one-sided contact as a hybrid system, by the compression and its rate (eq. 5.18).

The mode is 0 (apart) until compression and force are positive, then 1 (touching) until the force is zero.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.models.physics.contact import raw_force
from vibrojax.models.physics.elementary import maximum
from vibrojax.models.scenes.scene import ROUNDINGS


class ContactConstants(NamedTuple):
    """Stiffness `k0` [N/m], damping `c0` [N s/m], gap `delta` [m] and `relaxation` time c0/k0 [s], each (lanes,)."""

    k0: Any
    c0: Any
    delta: Any
    relaxation: Any


def contact_constants(p: Mapping[str, Any]) -> ContactConstants:
    """Return the constants of the contact for `k0`, `c0` and `delta` in `p`."""
    return ContactConstants(p["k0"], p["c0"], p["delta"], p["c0"] / p["k0"])


def force(c: ContactConstants, touching: Any, compression: Any, rate: Any) -> Any:
    """Return J [N] in the mode; arrays and series."""
    return touching * raw_force(compression, rate, c.k0, c.c0)


def guard(c: ContactConstants, touching: Any, compression: Any, rate: Any) -> Any:
    """Return the force as a length while touching; apart, the distance to the state in which they touch."""
    length = compression + c.relaxation * rate
    # Apart until both are positive, so that a striker released above delta (c0 > 0) is not caught again.
    return touching * length + (1.0 - touching) * maximum(-compression, -length)


def touching_at(c: ContactConstants, compression: Any, rate: Any, pushed: Any) -> Any:
    """Return the mode at a state; `pushed` [N] is the force that closes a contact at rest on its edge."""
    closes = (rate > 0) | ((rate == 0) & (pushed > 0))
    inside = (compression > 0) & (raw_force(compression, rate, c.k0, c.c0) > 0)
    return jnp.where(inside | ((compression == 0) & closes), 1.0, 0.0)


def energy(c: ContactConstants, compression: Any) -> Any:
    """Return the energy [J] of the contact's spring, touching or about to touch."""
    inside = jnp.maximum(compression, 0)
    return c.k0 * inside * inside / 2


def begins(c: ContactConstants, touching: Any, compression: Any, rate: Any, hit: Any, noise: Any) -> Any:
    """Return a mask of the contacts that begin from outside, the impacts; `noise` [m] counts as no compression.

    A contact released while still compressed (c0 > 0) may close again there: that is not a new impact.
    """
    return hit & (touching == 0) & (c.relaxation * rate >= 0) & (compression <= noise)


def reset(c: ContactConstants, touching: Any, compression: Any, rate: Any, hit: Any, noise: Any) -> tuple[Any, Any]:
    """Return the mode after the guard is reached (`hit`), and the compression set to its value on the guard."""
    from_outside = begins(c, touching, compression, rate, hit, noise)
    compression = jnp.where(hit & (touching != 0), -c.relaxation * rate, compression)
    compression = jnp.where(from_outside, 0.0, compression)
    return jnp.where(hit, 1.0 - touching, touching), compression


def stiff_rate(c: ContactConstants, inverse_mass: Any, flight: Any) -> Any:
    """Return the fastest rate of change in contact [1/s], from the rate in flight."""
    return jnp.sqrt(c.k0 * inverse_mass + flight * flight) + c.c0 * inverse_mass


def own_rate(c: ContactConstants, mass: Any) -> Any:
    """Return the rate [1/s] of a `mass` [kg] on the contact's spring and damper alone."""
    return jnp.sqrt(c.k0 / mass) + c.c0 / mass


def force_resolution(c: ContactConstants, mass: Any, speed: Any) -> Any:
    """Return the force [N] of a few roundings of the position of a `mass` that meets the contact at `speed` [m/s]."""
    reach = jnp.abs(c.delta) + jnp.sqrt(mass / c.k0) * speed
    return ROUNDINGS * jnp.finfo(c.k0.dtype).eps * c.k0 * reach
