"""Dry friction of a bit on the rock as a hybrid system (source, eq. 5.11).

The variables are the sliding velocity u and the net spring force `pull`. The mode `slip` is sgn u while the bit slides.
It is 0 while sticking, until the magnitude of the net spring force exceeds the stick limit.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array
from vibrojax.physics.elementary import absolute
from vibrojax.physics.friction import FrictionLaw
from vibrojax.scenes.declared import Guard, Values
from vibrojax.scenes.scene import ROUNDINGS, SLOPE_ROUNDINGS


class SlipConstants(NamedTuple):
    """The constants of friction, each (lanes,).

    - `v` [m/s]: drive speed; `weight` [N]: weight of the bit; `inverse_mass` [1/kg]: inverse mass of the bit.
    - `stick_limit` [N]: stick limit without impact; `stick_gain` [1]: increase of the stick limit per impact force.
    - `impedance` [N s/m]: sqrt(k1 m1), which converts a speed to a force; `speed_scale` [m/s]: a typical speed.
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
    """Return the constants of friction from `m1`, `k1`, `g`, `v` and the law's parameters in `p`."""
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
        # The drive speed plus the speed that the release of the stick limit gives to the bit on its spring.
        speed_scale=p["v"] + (limit + 1e-6 * weight) / impedance,
        law=own,
    )


def friction(law: FrictionLaw, c: SlipConstants, slip: Any, u: Any, impact: Any) -> Any:
    """Return the friction force F [N] on a bit that slides at `u` [m/s] (source, eqs. 5.9 and 5.12).

    `impact`: impact force [N] or None. The friction due to the impact force opposes the sliding (reading R2 of the
    source). Arrays and Taylor series are accepted.
    """
    speed = slip * u
    force = law.on_weight(speed, c.law) * c.weight
    if impact is not None:
        force = force + law.on_impact(speed, c.law) * impact
    return slip * force


def stick_limit(c: SlipConstants, impact: Any) -> Any:
    """Return the greatest net spring force [N] under which the bit sticks, f_st + mu J (source, eq. 5.11).

    The equation is read as in readings R1 and R2 of the source.
    """
    return c.stick_limit if impact is None else c.stick_limit + c.stick_gain * impact


def speed_noise(c: SlipConstants) -> Any:
    """Return the speed [m/s] that counts as zero: a small multiple of the rounding error of a typical speed."""
    return ROUNDINGS * jnp.finfo(c.v.dtype).eps * c.speed_scale


def stick_noise(c: SlipConstants, impact_noise: Any = 0.0) -> Any:
    """Return the excess [N] of the net spring force over the stick limit that counts as zero.

    `impact_noise`: impact force [N] that counts as zero.
    """
    return c.impedance * speed_noise(c) + c.stick_gain * impact_noise


def friction_guard(
    constants: Callable[[Any], SlipConstants],
    motion: Callable[[Any, Values, Values], tuple[Any, Any, Any]],
    noise: Callable[[Any, Values], Any],
) -> Guard:
    """Return the guard `friction`, which is positive while the bit keeps its sliding direction or keeps sticking.

    While sliding, its value is |u|. While sticking, it is the stick limit minus |pull|, divided by sqrt(k1 m1).

    **Arguments:** functions of a scene whose first mode is `slip`. `constants(c)`: the constants of friction;
    `motion(c, mode, state)`: sliding velocity u, net spring force and impact force (or None); `noise(c, mode)` [N]: the
    result of [vibrojax.scenes.stick_slip.stick_noise][].
    """

    def value(c: Any, mode: Values, state: Values) -> Any:
        own, slip, (u, pull, impact) = constants(c), mode[0], motion(c, mode, state)
        margin = stick_limit(own, impact) - absolute(pull)
        return slip * u + ((1.0 - slip * slip) / own.impedance) * margin

    def resolution(c: Any, mode: Values) -> Any:
        return jnp.where(mode[0] == 0, noise(c, mode) / constants(c).impedance, speed_noise(constants(c)))

    def slope_resolution(c: Any, mode: Values, h: Any) -> Any:
        # While sliding, this is the change caused by an excess force of `noise`. Sticking and sliding must use the same
        # tolerance; otherwise a bit on the stick limit would alternate between the two modes.
        own, excess = constants(c), noise(c, mode)
        return jnp.where(mode[0] == 0, SLOPE_ROUNDINGS * excess / own.impedance, excess * h * own.inverse_mass)

    return Guard("friction", value, resolution, slope_resolution, is_switch=True)


def slip_at_rest(c: SlipConstants, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """Return the mode at u = 0: 0 if the bit sticks, else the sign of the net spring force, the sliding direction.

    If the force exceeds the stick limit by less than `noise`, the bit sticks. If the force then grows, the bit starts
    to slide at once. If the force falls, a slip would have ended as soon as it began.
    """
    limit = stick_limit(c, impact)
    # Without a stick limit the bit never sticks, not even when the net spring force passes through zero.
    sticks = (jnp.abs(pull) <= limit + noise) & (limit > 0)
    return jnp.where(sticks, 0.0, _starting_direction(pull, pull_rate))


def slip_at(c: SlipConstants, u: Any, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """Return the mode sgn u; at u = 0, the direction in which the bit starts to slide, or 0 if it sticks."""
    return jnp.where(u == 0, slip_at_rest(c, pull, pull_rate, impact, noise), jnp.sign(u))


def slip_after(c: SlipConstants, slip: Any, pull: Any, pull_rate: Any, impact: Any, noise: Any) -> Any:
    """Return the mode after the friction guard is reached, where u = 0; `slip` is the mode before."""
    starts = _starting_direction(pull, pull_rate)
    return jnp.where(slip == 0, starts, slip_at_rest(c, pull, pull_rate, impact, noise))


def _starting_direction(pull: Any, pull_rate: Any) -> Any:
    """Return the sign of the net spring force on a sticking bit, or of its time derivative if the force is zero."""
    return jnp.sign(jnp.where(pull == 0, pull_rate, pull))


def validity(law: FrictionLaw, c: SlipConstants, slip: Any, v1: list[Array]) -> Any:
    """Return the fraction of a step over which the Taylor series of a law with `flat_below` is valid, else None.

    Over this fraction the sliding speed changes by at most half the sum of itself and the law's `flat_below`. `v1`: the
    coefficients of x1' in tau = time/h.
    """
    if law.flat_below is None:
        return None
    change = (jnp.abs(v1[0] + c.v) + law.flat_below(c.law)) / 2
    terms = [jnp.abs(coefficient) for coefficient in v1[1:]]
    share = change / len(terms)
    reach = jnp.min(jnp.stack([(share / term) ** (1 / k) for k, term in enumerate(terms, start=1)]), axis=0)
    return jnp.where(slip == 0, 1.0, reach)


def smoothed_slip(u: Any, width: Any) -> Any:
    """Return sgn u spread over `width` [m/s], u/sqrt(u² + width²), with which the bit never sticks."""
    return u / jnp.sqrt(u * u + width * width)


def smoothed_mode(u: Any, width: Any) -> Any:
    """Return the slip mode for the measures of a smoothed motion: sgn u, or 0 if |u| is at most `width` [m/s]."""
    return jnp.where(jnp.abs(u) <= width, 0.0, jnp.sign(u))
