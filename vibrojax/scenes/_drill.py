"""Bit and striker on their springs, sliding with dry friction: what every scene with a drill shares (section 1)."""

import jax.numpy as jnp

from vibrojax.physics.elementary import absolute
from vibrojax.physics.modes import striker

STARTING_SHARE = 0.05


def with_derived(p, law):
    """The parameters with what follows from them: m2, k2, weight m1 g [N] and the stick limit's two parts."""
    m2, k2 = striker(p)
    weight = p["m1"] * p["g"]
    stick_limit, impedance = law.on_weight(0.0, p) * weight, jnp.sqrt(p["k1"] * p["m1"])
    return p | {
        "m2": m2,
        "k2": k2,
        "weight": weight,
        "stick_limit": stick_limit,
        "stick_gain": law.on_impact(0.0, p) + 0 * weight,
        "inverse_m1": 1 / p["m1"],
        "inverse_m2": 1 / m2,
        "impedance": impedance,
        "slowness": jnp.sqrt(p["m1"] / p["k1"]),
        # The drive's, and what friction's fall gives to the bit on its spring.
        "speed_scale": p["v"] + (stick_limit + 1e-6 * weight) / impedance,
    }


def scaled(p, state, contact_energy=0.0):
    """The constants for a motion from `state`, whose contact holds `contact_energy` [J].

    Where next to nothing drives the drill or holds it, only what it starts with says how fast it moves. The share is
    small, so that a transient does not decide how exact all that follows is.
    """
    x1, v1, x2, v2 = state
    springs = p["k1"] * x1 * x1 + p["k2"] * (x1 - x2) ** 2
    energy = (springs + p["m1"] * v1 * v1 + p["m2"] * v2 * v2) / 2 + contact_energy
    fastest = jnp.sqrt(2 * energy * jnp.maximum(p["inverse_m1"], p["inverse_m2"]))
    return p | {"speed_scale": jnp.maximum(p["speed_scale"], STARTING_SHARE * fastest)}


def pull(p, x1, x2):
    """Spring force on the bit [N], -k1 x1 - k2 (x1 - x2)."""
    return p["k2"] * (x2 - x1) - p["k1"] * x1


def friction(law, p, slip, v1, impact):
    """Friction force F [N] on the sliding bit (eqs. 5.9, 5.12, R2); `slip` is sgn u."""
    speed = slip * (v1 + p["v"])
    force = law.on_weight(speed, p) * p["weight"]
    if impact is not None:
        force = force + law.on_impact(speed, p) * impact
    return slip * force


def accelerations(law, p, slip, state, impact):
    """x1'' and x2'' [m/s²] of the sliding bit and of the striker (section 1, R2); `impact` is J [N] or None."""
    x1, v1, x2, v2 = state
    bit = (pull(p, x1, x2) - friction(law, p, slip, v1, impact)) * p["inverse_m1"]
    force = p["k2"] * (x1 - x2) - p["c2"] * v2
    if impact is not None:
        force = force - impact
    return bit, force * p["inverse_m2"]


def stick_limit(p, impact):
    """Greatest spring force [N] that leaves the bit at rest on the rock, f_st + mu J (eq. 5.11, R1, R2)."""
    return p["stick_limit"] if impact is None else p["stick_limit"] + p["stick_gain"] * impact


def friction_surface(p, slip, state, impact):
    """Positive while the bit goes on sliding one way, or sticking: |u|, or the force in hand over sqrt(k1 m1) [m/s]."""
    x1, v1, x2, _ = state
    in_hand = stick_limit(p, impact) - absolute(pull(p, x1, x2))
    return slip * (v1 + p["v"]) + ((1.0 - slip * slip) / p["impedance"]) * in_hand


def slip_at_rest(p, state, impact, noise):
    """Where u = 0: 0 if the bit sticks, else the sign of the spring force, into which it starts to slide.

    `noise` is [vibrojax.scenes._drill.stick_noise][]. A spring force beyond the stick limit by less than that sticks:
    if it grows the bit lets go at once, and if it falls the slip would have ended as it began.
    """
    limit = stick_limit(p, impact)
    # Where nothing holds the bit it never sticks, not even as the spring force passes through zero.
    sticks = (jnp.abs(pull(p, state[0], state[2])) <= limit + noise) & (limit > 0)
    return jnp.where(sticks, 0.0, _starts_towards(p, state))


def speed_noise(p):
    """Speed [m/s] that counts as zero: a few roundings of a typical one."""
    return 64 * jnp.finfo(p["v"].dtype).eps * p["speed_scale"]


def length_noise(p):
    """Distance [m] that counts as zero: a few roundings of a typical one."""
    return speed_noise(p) * p["slowness"]


def stick_noise(p, impact_noise=0.0):
    """Spring force [N] beyond the stick limit that counts as none; `impact_noise` is that of J [N]."""
    return p["impedance"] * speed_noise(p) + p["stick_gain"] * impact_noise


def friction_resolution(p, slip, noise):
    """Values of [vibrojax.scenes._drill.friction_surface][] that count as zero; `noise` is `stick_noise`."""
    return jnp.where(slip == 0, noise / p["impedance"], speed_noise(p))


def friction_slope_resolution(p, slip, noise, h):
    """Its change over a step `h` that counts as zero: of a slip, what no more than `noise` beyond the limit drives.

    That sticks and slips agree on what is zero keeps a bit that is on the limit from going to and fro between them.
    """
    return jnp.where(slip == 0, 16 * noise / p["impedance"], noise * h * p["inverse_m1"])


def _starts_towards(p, state):
    """Sign of the spring force on a bit at rest on the rock, or of its rate where it is zero."""
    x1, v1, x2, v2 = state
    force = pull(p, x1, x2)
    return jnp.sign(jnp.where(force == 0, pull(p, v1, v2), force))


def slip_at(p, state, impact, noise):
    """sgn u, or where u = 0 the way in which the bit starts, or 0 if it sticks."""
    u = state[1] + p["v"]
    return jnp.where(u == 0, slip_at_rest(p, state, impact, noise), jnp.sign(u))


def land_friction(p, slip, state, hit, impact, noise):
    """The slip mode and state after the friction surface is reached where `hit`; u = 0 there, exactly."""
    x1, v1, x2, v2 = state
    v1 = jnp.where(hit, -p["v"], v1)
    state = (x1, v1, x2, v2)
    after = jnp.where(slip == 0, _starts_towards(p, state), slip_at_rest(p, state, impact, noise))
    return jnp.where(hit, after, slip), state


def flight_rate(p):
    """A bound on the fastest rate of change [1/s] of the sliding, free drill: its springs and its damper."""
    springs = (p["k1"] + p["k2"]) * p["inverse_m1"] + p["k2"] * p["inverse_m2"]
    return jnp.sqrt(springs) + p["c2"] * p["inverse_m2"]


def in_sight(law, p, slip, v1):
    """Part of a step in which a slip's speed changes by no more than half of itself and of what friction is flat below.

    `v1` holds the coefficients of x1' in tau. None for a law that is nowhere flat: its series tell what follows.
    """
    if law.flat_below is None:
        return None
    change = (jnp.abs(v1[0] + p["v"]) + law.flat_below(p)) / 2
    terms = [jnp.abs(c) for c in v1[1:]]
    share = change / len(terms)
    reach = jnp.min(jnp.stack([(share / term) ** (1 / k) for k, term in enumerate(terms, start=1)]), axis=0)
    return jnp.where(slip == 0, 1.0, reach)


def start(p, name, shape):
    """State at t = 0 of the starts that need no contact: `drive` (R5), `stuck` (R5), or a vector of four numbers."""
    if isinstance(name, str):
        zero = jnp.zeros(shape, p["v"].dtype)
        return (zero, -p["v"] + zero if name == "stuck" else zero, zero, zero)
    return tuple(jnp.full(shape, value, p["v"].dtype) for value in name)


def smoothed_slip(p, state, width):
    """sgn u spread over `width` [m/s], u/sqrt(u² + width²): it never sticks."""
    u = state[1] + p["v"]
    return u / jnp.sqrt(u * u + width * width)


def land_turns(state, bit_turns, striker_turns):
    """The state with x1' or x2' exactly zero where the bit or the striker turns."""
    x1, v1, x2, v2 = state
    return (x1, jnp.where(bit_turns, 0.0, v1), x2, jnp.where(striker_turns, 0.0, v2))


def smoothed_mode(p, state, width):
    """The slip mode to measure by where friction is smoothed: sgn u, or 0 below `width` [m/s]."""
    u = state[1] + p["v"]
    return jnp.where(jnp.abs(u) <= width, 0.0, jnp.sign(u))


def never(state):
    """A surface that is never reached."""
    return 0.0 * state[0] + 1.0
