"""Dry friction of a bit on the rock as a hybrid system, by its sliding speed u and the pull of its springs (eq. 5.11).

The mode is sgn u while the bit slides. It is 0 in stick, until the pull exceeds the stick limit.
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

    - `v`: drive speed [m/s]; `weight` of the bit [N]; `inverse_mass` of the bit [1/kg].
    - `stick_limit` [N]: limit of the pull without impact; `stick_gain` [1]: its increase per impact force.
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
    """Return the constants of friction for `m1`, `k1`, `g`, `v` and the law's parameters in `p`."""
    own = {name: p[name] for name in law.parameters}
    weight = p["m1"] * p["g"]
    limit, impedance = law.on_weight(0.0, own) * weight, jnp.sqrt(p["k1"] * p["m1"])
    return SlipConstants(
        v=p["v"],
        weight=weight,
        inverse_mass=1 / p["m1"],
        stick_limit=limit,
        stick_gain=law.on_impact(0.0, own) + 0 * weight,
        impedance=impedance,
        # The drive's speed, and the speed that the fall of friction gives to the bit on its spring.
        speed_scale=p["v"] + (limit + 1e-6 * weight) / impedance,
        law=own,
    )


def friction(law: FrictionLaw, c: SlipConstants, slip: Any, u: Any, impact: Any) -> Any:
    """Return the friction force F [N] on a bit sliding at `u` [m/s] under the impact force `impact` [N] or None.

    Eqs. 5.9 and 5.12, with friction under impact against the sliding (R2); arrays and series.
    """
    speed = slip * u
    force = law.on_weight(speed, c.law) * c.weight
    if impact is not None:
        force = force + law.on_impact(speed, c.law) * impact
    return slip * force


def stick_limit(c: SlipConstants, impact: Any) -> Any:
    """Return the greatest pull [N] under which the bit sticks, f_st + mu J (eq. 5.11, R1, R2)."""
    return c.stick_limit if impact is None else c.stick_limit + c.stick_gain * impact


def guard(c: SlipConstants, slip: Any, u: Any, pull: Any, impact: Any) -> Any:
    """Return a value [m/s] that is positive while the bit keeps sliding one way, or sticking.

    It is |u|, or in stick the margin of the pull below the stick limit, over sqrt(k1 m1).
    """
    margin = stick_limit(c, impact) - absolute(pull)
    return slip * u + ((1.0 - slip * slip) / c.impedance) * margin


def speed_noise(c: SlipConstants) -> Any:
    """Return the speed [m/s] that counts as zero: a few roundings of a typical one."""
    return ROUNDINGS * jnp.finfo(c.v.dtype).eps * c.speed_scale


def stick_noise(c: SlipConstants, impact_noise: Any = 0.0) -> Any:
    """Return the excess of the pull [N] over the stick limit that counts as none.

    `impact_noise` is the impact force [N] that counts as none.
    """
    return c.impedance * speed_noise(c) + c.stick_gain * impact_noise


def resolution(c: SlipConstants, slip: Any, noise: Any) -> Any:
    """Return the guard's values that count as zero; `noise` is [vibrojax.models.scenes.stick_slip.stick_noise][]."""
    return jnp.where(slip == 0, noise / c.impedance, speed_noise(c))


def slope_resolution(c: SlipConstants, slip: Any, noise: Any, h: Any) -> Any:
    """Return the guard's change over a step `h` that counts as zero.

    For a slip it is the change that an excess pull of `noise` causes. Stick and slip must agree on zero: otherwise a
    bit on the limit would alternate between them.
    """
    return jnp.where(slip == 0, SLOPE_ROUNDINGS * noise / c.impedance, noise * h * c.inverse_mass)


def slip_at_rest(c: SlipConstants, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """Return the mode at u = 0: 0 if the bit sticks, else the sign of the pull, into which it starts to slide.

    A pull that exceeds the stick limit by less than `noise` sticks. If it grows, the bit slips at once; if it falls,
    the slip would have ended as it began.
    """
    limit = stick_limit(c, impact)
    # Without a stick limit the bit never sticks, not even as the pull passes through zero.
    sticks = (jnp.abs(pull) <= limit + noise) & (limit > 0)
    return jnp.where(sticks, 0.0, _starting_direction(pull, pull_rate))


def slip_at(c: SlipConstants, u: Any, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """Return sgn u; at u = 0 the direction in which the bit starts, or 0 if it sticks."""
    return jnp.where(u == 0, slip_at_rest(c, pull, pull_rate, impact, noise), jnp.sign(u))


def slip_after(c: SlipConstants, slip: Any, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """Return the mode after the guard is reached, at u = 0."""
    starts = _starting_direction(pull, pull_rate)
    return jnp.where(slip == 0, starts, slip_at_rest(c, pull, pull_rate, impact, noise))


def _starting_direction(pull: Any, pull_rate: Any) -> Any:
    """Return the sign of the pull on a bit at rest on the rock, or of its rate if the pull is zero."""
    return jnp.sign(jnp.where(pull == 0, pull_rate, pull))


def validity(law: FrictionLaw, c: SlipConstants, slip: Any, v1: list[Array]) -> Any:
    """Return the part of a step over which a law that is flat near zero follows its series; None for other laws.

    Within it the sliding speed changes by at most half of itself plus the law's `flat_below`. `v1` holds the
    coefficients of x1' in tau.
    """
    if law.flat_below is None:
        return None
    change = (jnp.abs(v1[0] + c.v) + law.flat_below(c.law)) / 2
    terms = [jnp.abs(coefficient) for coefficient in v1[1:]]
    share = change / len(terms)
    reach = jnp.min(jnp.stack([(share / term) ** (1 / k) for k, term in enumerate(terms, start=1)]), axis=0)
    return jnp.where(slip == 0, 1.0, reach)


def smoothed_slip(u: Any, width: Any) -> Any:
    """Return sgn u spread over `width` [m/s], u/sqrt(u² + width²): it never sticks."""
    return u / jnp.sqrt(u * u + width * width)


def smoothed_mode(u: Any, width: Any) -> Any:
    """Return the slip mode by which smoothed friction is measured: sgn u, or 0 below `width` [m/s]."""
    return jnp.where(jnp.abs(u) <= width, 0.0, jnp.sign(u))
