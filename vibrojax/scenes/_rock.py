"""The bit on the rock as a hybrid system, by the compression e = x3 - x4: what every scene with rock shares.

Modes of the rock: 0 elastic (0 < k3 e < D), 1 yielding (N = D, x4 grows with x3), -1 off the rock (N = 0), 2 at rest,
unloaded (e = x3' = 0 but for rounding), which asks for no steps. By e and x3' alone the motion does not depend on how
deep the hole is.
"""

import jax.numpy as jnp

from vibrojax.physics.rock import damping

REST = 2


def with_derived(p):
    """The parameters with what follows from them: c3, the compression at which the rock yields, and the mobility."""
    return p | {
        "c3": damping(p["m1"], p["k3"], p["zeta"]),
        "yield_compression": p["threshold"] / p["k3"],
        "inverse_m1": 1 / p["m1"],
        # What a force does to the velocity of the bit on the rock, [m/s/N].
        "mobility": 1 / jnp.sqrt(p["k3"] * p["m1"]),
    }


def resistance(p, rock, compression):
    """N [N] in the mode; takes arrays and series."""
    elastic, yielding = _is_elastic(rock), _is_yielding(rock)
    return compression * (elastic * p["k3"]) + yielding * p["threshold"]


def _is_elastic(rock):
    return jnp.where(rock == 0, 1.0, 0.0)


def _is_yielding(rock):
    return jnp.where(rock == 1, 1.0, 0.0)


def rates(p, rock, compression, v3, applied):
    """((e', x4'), x3'') in the mode under the force `applied` [N] (eq. 6.1); takes arrays and series."""
    yielding, moves = _is_yielding(rock), jnp.where(rock == REST, 0.0, 1.0)
    bit = (applied - resistance(p, rock, compression) - v3 * p["c3"]) * (moves * p["inverse_m1"])
    return (v3 * (1.0 - yielding), v3 * yielding), bit


def surfaces(p, rock, compression, v3):
    """Positive while the rock keeps from yielding or goes on, and while the bit stays on the rock or off it."""
    elastic, yielding, off = _is_elastic(rock), _is_yielding(rock), jnp.where(rock < 0, 1.0, 0.0)
    rest = jnp.where(rock == REST, 1.0, 0.0)
    yields = (p["yield_compression"] - compression) * elastic + v3 * (yielding * _per_speed(p)) + (off + rest)
    touches = compression * (elastic - off) + (yielding + rest)
    return yields, touches


def _per_speed(p):
    """Seconds that turn a velocity of the bit into a compression."""
    return jnp.sqrt(p["m1"] / p["k3"])


def land(p, rock, compression, v3, yields, touches):
    """Mode, compression and velocity after the rock begins or ends to yield, or the bit leaves it or comes back."""
    begins, ends = yields & (rock == 0), yields & (rock == 1)
    compression = jnp.where(begins, p["yield_compression"], jnp.where(touches, 0.0, compression))
    v3 = jnp.where(ends, 0.0, v3)
    rock = jnp.where(begins, 1.0, jnp.where(ends, 0.0, rock))
    rock = jnp.where(touches, -1.0 - rock, rock)
    return rock, compression, v3


def rest(p, rock, compression, v3, loaded):
    """The mode, compression and velocity where the motion has died out, or is woken where `loaded`."""
    small = 64 * jnp.finfo(v3.dtype).eps * p["mobility"] * p["m1"] * 9.81
    still = (rock == 0) & (jnp.abs(v3) <= small) & (jnp.abs(compression) <= small * _per_speed(p)) & ~loaded
    rock = jnp.where(still, REST, jnp.where((rock == REST) & loaded, 0.0, rock))
    return rock, jnp.where(still, 0.0, compression), jnp.where(still, 0.0, v3)


def resolutions(p):
    """Values of the two surfaces that count as zero [m]."""
    small = 64 * jnp.finfo(p["m1"].dtype).eps * (p["yield_compression"] + p["mobility"] * _per_speed(p))
    return small, small


def rate(p, rock, apart):
    """The fastest rate of change of the bit on the rock [1/s]; `apart`, where only given forces act on it.

    There, where it does not swing, it relaxes: nothing is touched on the way and left again, so that steps may be as
    long as the series' tolerance lets them, up to where they would no longer damp the faster of the two exponentials
    (order 10: 5 over its rate; half of the rate at a stride of 2 is 4).
    """
    own, half = jnp.sqrt(p["k3"] * p["inverse_m1"]), 0.5 * p["c3"] * p["inverse_m1"]
    relaxes = half > own
    faster = half + jnp.sqrt(jnp.where(relaxes, half * half - own * own, 1.0))
    return jnp.where(relaxes & (rock == 0) & apart, 0.5 * faster, own + 2.0 * half)
