"""The one-sided contact as a hybrid system, by the compression and its rate (eq. 5.18).

Apart (0) until the compression is positive and the force too; touching (1) until the force is zero.
"""

import jax.numpy as jnp

from vibrojax.physics.elementary import maximum


def with_derived(p):
    """The parameters with the contact's relaxation time c0/k0 [s]."""
    return p | {"relaxation": p["c0"] / p["k0"]}


def surface(p, touching, compression, rate):
    """The force in metres while they touch; apart, the distance to the state in which they do."""
    force = compression + p["relaxation"] * rate
    # Apart until both hold, so that a striker let go above delta (c0 > 0) is not caught again.
    return touching * force + (1.0 - touching) * maximum(-compression, -force)


def energy(p, compression):
    """Energy [J] of the contact's spring, touching or about to be."""
    inside = jnp.maximum(compression, 0)
    return p["k0"] * inside * inside / 2


def begins(p, touching, compression, rate, hit, noise):
    """Where a contact begins from outside, which is an impact; a compression of `noise` [m] counts as none.

    Let go while still compressed (c0 > 0), it may be caught again there: no new impact.
    """
    return hit & (touching == 0) & (p["relaxation"] * rate >= 0) & (compression <= noise)


def landed(p, touching, compression, rate, hit, noise):
    """The mode, and the compression put on the surface, after it is reached where `hit`."""
    from_outside = begins(p, touching, compression, rate, hit, noise)
    compression = jnp.where(hit & (touching != 0), -p["relaxation"] * rate, compression)
    compression = jnp.where(from_outside, 0.0, compression)
    return jnp.where(hit, 1.0 - touching, touching), compression


def stiff_rate(p, flight):
    """The fastest rate of change in contact [1/s], from that in flight."""
    return jnp.sqrt(p["k0"] * p["inverse_m2"] + flight * flight) + p["c0"] * p["inverse_m2"]


def force_resolution(p):
    """Force [N] that is a few roundings of the striker's position at the contact: k0 times those."""
    reach = jnp.abs(p["delta"]) + jnp.sqrt(p["m2"] / p["k0"]) * p["v"]
    return 64 * jnp.finfo(p["k0"].dtype).eps * p["k0"] * reach
