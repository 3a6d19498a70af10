"""Dry friction of a bit on the rock as a hybrid system, by its sliding speed u and the pull of its springs (eq. 5.11).

The mode is sgn u while the bit slides, and 0 while it sticks: until the pull is greater than the stick limit.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.models.arrays import Array
from vibrojax.models.physics.elementary import absolute
from vibrojax.models.physics.friction import FrictionLaw
from vibrojax.models.scenes.scene import ROUNDINGS, SLOPE_ROUNDINGS


class SlipConstants(NamedTuple):
    """The constants of friction, each (lanes,).

    - `v`: drive speed [m/s]; `weight` of the bit [N]; `inverse_mass` of it [1/kg].
    - `stick_limit` [N]: of the pull without impact; `stick_gain` [1]: what the impact force adds to it.
    - `impedance` [N s/m]: of the bit on its spring; `speed_scale` [m/s]: a typical speed.
    - `law`: the friction law's own parameters, by name.
    """

    v: Any
    weight: Any
    inverse_mass: Any
    stick_limit: Any
    stick_gain: Any
    impedance: Any
    speed_scale: Any
    law: Mapping[str, Any]


def slip_constants(p: Mapping[str, Any], law: FrictionLaw) -> SlipConstants:
    """What friction needs, from `m1`, `k1`, `g`, `v` and the law's parameters among `p`."""
    own = {name: p[name] for name in law.parameters}
    weight = p["m1"] * p["g"]
    stick_limit, impedance = law.on_weight(0.0, own) * weight, jnp.sqrt(p["k1"] * p["m1"])
    return SlipConstants(
        v=p["v"],
        weight=weight,
        inverse_mass=1 / p["m1"],
        stick_limit=stick_limit,
        stick_gain=law.on_impact(0.0, own) + 0 * weight,
        impedance=impedance,
        # The drive's, and what friction's fall gives to the bit on its spring.
        speed_scale=p["v"] + (stick_limit + 1e-6 * weight) / impedance,
        law=own,
    )


def friction(law: FrictionLaw, c: SlipConstants, slip: Any, u: Any, impact: Any) -> Any:
    """Friction force F [N] on the bit that slides at `u` [m/s] under the impact force `impact` [N] or None.

    Eqs. 5.9 and 5.12, with friction under impact against the sliding (R2); arrays and series.
    """
    speed = slip * u
    force = law.on_weight(speed, c.law) * c.weight
    if impact is not None:
        force = force + law.on_impact(speed, c.law) * impact
    return slip * force


def stick_limit(c: SlipConstants, impact: Any) -> Any:
    """Greatest pull [N] that leaves the bit at rest on the rock, f_st + mu J (eq. 5.11, R1, R2)."""
    return c.stick_limit if impact is None else c.stick_limit + c.stick_gain * impact


def guard(c: SlipConstants, slip: Any, u: Any, pull: Any, impact: Any) -> Any:
    """Positive while the bit goes on sliding one way, or sticking [m/s].

    |u|, or the force that the pull is short of the stick limit, over sqrt(k1 m1).
    """
    left = stick_limit(c, impact) - absolute(pull)
    return slip * u + ((1.0 - slip * slip) / c.impedance) * left


def speed_noise(c: SlipConstants) -> Any:
    """Speed [m/s] that counts as zero: a few roundings of a typical one."""
    return ROUNDINGS * jnp.finfo(c.v.dtype).eps * c.speed_scale


def stick_noise(c: SlipConstants, impact_noise: Any = 0.0) -> Any:
    """Pull [N] beyond the stick limit that counts as none; `impact_noise` is that of the impact force [N]."""
    return c.impedance * speed_noise(c) + c.stick_gain * impact_noise


def resolution(c: SlipConstants, slip: Any, noise: Any) -> Any:
    """Values of the guard that count as zero; `noise` is [vibrojax.models.scenes.stick_slip.stick_noise][]."""
    return jnp.where(slip == 0, noise / c.impedance, speed_noise(c))


def slope_resolution(c: SlipConstants, slip: Any, noise: Any, h: Any) -> Any:
    """Its change over a step `h` that counts as zero: of a slip, what no more than `noise` beyond the limit drives.

    That sticks and slips agree on what is zero keeps a bit that is on the limit from going to and fro between them.
    """
    return jnp.where(slip == 0, SLOPE_ROUNDINGS * noise / c.impedance, noise * h * c.inverse_mass)


def slip_at_rest(c: SlipConstants, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """Where u = 0: 0 if the bit sticks, else the sign of the pull, into which it starts to slide.

    A pull beyond the stick limit by less than `noise` sticks: if it grows the bit lets go at once, and if it falls the
    slip would have ended as it began.
    """
    limit = stick_limit(c, impact)
    # Where nothing holds the bit it never sticks, not even as the pull passes through zero.
    sticks = (jnp.abs(pull) <= limit + noise) & (limit > 0)
    return jnp.where(sticks, 0.0, _starts_towards(pull, pull_rate))


def slip_at(c: SlipConstants, u: Any, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """sgn u, or where u = 0 the way in which the bit starts, or 0 if it sticks."""
    return jnp.where(u == 0, slip_at_rest(c, pull, pull_rate, impact, noise), jnp.sign(u))


def slip_after(c: SlipConstants, slip: Any, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """The mode after the guard is reached, where u = 0."""
    starts = _starts_towards(pull, pull_rate)
    return jnp.where(slip == 0, starts, slip_at_rest(c, pull, pull_rate, impact, noise))


def _starts_towards(pull: Any, pull_rate: Any) -> Any:
    """Sign of the pull on a bit at rest on the rock, or of its rate where it is zero."""
    return jnp.sign(jnp.where(pull == 0, pull_rate, pull))


def validity(law: FrictionLaw, c: SlipConstants, slip: Any, v1: list[Array]) -> Any:
    """Part of a step in which a slip's speed changes by no more than half of itself and of what friction is flat below.

    `v1` holds the coefficients of x1' in tau. None for a law that is nowhere flat: its series tell what follows.
    """
    if law.flat_below is None:
        return None
    change = (jnp.abs(v1[0] + c.v) + law.flat_below(c.law)) / 2
    terms = [jnp.abs(one) for one in v1[1:]]
    share = change / len(terms)
    reach = jnp.min(jnp.stack([(share / term) ** (1 / k) for k, term in enumerate(terms, start=1)]), axis=0)
    return jnp.where(slip == 0, 1.0, reach)


def smoothed_slip(u: Any, width: Any) -> Any:
    """sgn u spread over `width` [m/s], u/sqrt(u² + width²): it never sticks."""
    return u / jnp.sqrt(u * u + width * width)


def smoothed_mode(u: Any, width: Any) -> Any:
    """The slip mode to measure by where friction is smoothed: sgn u, or 0 below `width` [m/s]."""
    return jnp.where(jnp.abs(u) <= width, 0.0, jnp.sign(u))
