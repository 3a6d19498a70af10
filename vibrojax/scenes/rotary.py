"""The rotary scene: bit and striker on their springs with dry friction, the base of every scene with a sliding bit.

m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u, J),   m2 x2'' = -c2 x2' - k2 (x2 - x1) - J,   u = x1' + v

The mode `slip` is sgn u while the bit slides. It is 0 while the bit sticks, until the magnitude of the net spring force
exceeds the stick limit (source, eq. 5.11).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from vibrojax.errors import InputError, shown
from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array
from vibrojax.physics.elementary import absolute
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.physics.modes import striker
from vibrojax.physics.parameters import BIT_AND_STRIKER, Parameter
from vibrojax.scenes.capabilities import Bit, HasFriction
from vibrojax.scenes.declared import Guard, Marker, Mode, Section, Start, State, Swing, Values
from vibrojax.scenes.scene import ARMED_BELOW, ROUNDINGS, SLOPE_ROUNDINGS

STARTING_SHARE = 0.05
"""Fraction of the greatest speed allowed by the initial energy that counts as a typical speed of the motion."""


class DrillConstants(NamedTuple):
    """Constants of the two masses and of friction, each (lanes,).

    - `m1`, `m2` [kg], `k1`, `k2` [N/m], `c2` [N s/m]: masses, stiffnesses, damping; `inverse_m1`, `inverse_m2` [1/kg].
    - `period` [s], `impedance` [N s/m]: sqrt(m1/k1) and sqrt(k1 m1), which convert a speed of the bit to a length and
      to a force.
    - `v` [m/s]: drive speed; `weight` [N]: weight of the bit; `speed_scale` [m/s]: a typical speed.
    - `stick_limit` [N]: greatest net spring force under which the bit sticks, without impact; `stick_gain` [1]:
      increase of this limit per impact force.
    - `law`: the friction law's own parameters, by name.
    """

    m1: Any
    m2: Any
    k1: Any
    k2: Any
    c2: Any
    inverse_m1: Any
    inverse_m2: Any
    period: Any
    v: Any
    weight: Any
    stick_limit: Any
    stick_gain: Any
    impedance: Any
    speed_scale: Any
    law: Mapping[str, Any]


def speed_noise(c: DrillConstants) -> Any:
    """Return the speed [m/s] that counts as zero: a small multiple of the rounding error of a typical speed."""
    return ROUNDINGS * jnp.finfo(c.v.dtype).eps * c.speed_scale


def length_noise(c: DrillConstants) -> Any:
    """Return the distance [m] that counts as zero: a small multiple of the rounding error of a typical distance."""
    return speed_noise(c) * c.period


def _rearm(c: Any) -> Any:
    return -ARMED_BELOW * c.drill.v


class RotaryConstants(NamedTuple):
    """Constants of the two masses."""

    drill: DrillConstants


@dataclass(frozen=True)
class Rotary(HasFriction[Any]):
    """Bit and striker on their springs, with stick-slip friction and without impact.

    m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u); m2 x2'' = -c2 x2' - k2 (x2 - x1)
    """

    # The first states are x1, x1', x2, x2', and the first mode is `slip`. At a section crossing x1' becomes positive:
    # the bit begins to move faster than the drive. A subclass may add a contact of striker and bit, and rock below the
    # bit. It overrides the methods from `impact` to `other_reset`, which by default add no forces, states or modes.

    friction: FrictionLaw = FRICTION_LAWS["stribeck"]

    name = "rotary"
    measures: ClassVar[tuple[Any, ...]] = ("swings", "shares", "harmonics")
    own_parameters: ClassVar[dict[str, Parameter]] = BIT_AND_STRIKER
    states: ClassVar[tuple[State, ...]] = (
        State("x1", "m", "position of the bit relative to the drive"),
        State("v1", "m s-1", "velocity of the bit relative to the drive", is_velocity=True),
        State("x2", "m", "position of the striker relative to the drive"),
        State("v2", "m s-1", "velocity of the striker relative to the drive", is_velocity=True),
    )
    modes: ClassVar[tuple[Mode, ...]] = (Mode("slip", "sgn u, 0 where the bit sticks", 1.0),)
    markers = (Marker("bit_turn", "v1"), Marker("striker_turn", "v2"))
    section = Section((Swing("x1", "v1", "bit_amplitude"), Swing("x2", "v2", "striker_amplitude")), _rearm)
    starts: ClassVar[tuple[str, ...]] = ("drive", "stuck")
    start_states: ClassVar[tuple[str, ...]] = ("x1", "v1", "x2", "v2")

    @property
    def regime_names(self) -> Mapping[str, str]:
        return {}

    def impact(self, c: Any, mode: Values, state: Values) -> Any:
        """Return the contact force J [N], or None without a contact.

        It accepts arrays and Taylor series, and does not use the mode `slip`.
        """
        return None

    def impact_noise(self, c: Any, mode: Values) -> Any:
        """Return the contact force [N] that counts as zero."""
        return 0.0

    def stored(self, c: Any, state: Values) -> Any:
        """Return the initial energy [J] in addition to the energy of the two masses and their springs."""
        return 0.0

    def other_rates(self, c: Any, mode: Values, state: Values, impact: Any) -> Values:
        """Return the time derivatives of the states after x2'."""
        return ()

    def other_reset(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        """Return mode and state after a guard other than `friction` is reached."""
        return mode, state

    def parameters(self) -> Mapping[str, Parameter]:
        for name in self.own_parameters.keys() & self.friction.parameters.keys():
            law = f"law {shown(self.friction.name)} has the parameter {name}"
            raise InputError(f"friction: {law}, which scene {shown(self.name)} has, too; rename that of the law")
        return {**self.own_parameters, **self.friction.parameters}

    def constants(self, p: Mapping[str, Any]) -> Any:
        m2, k2 = striker(p)
        own = {name: p[name] for name in self.friction.parameters}
        weight = p["m1"] * p["g"]
        limit, impedance = self.friction.on_weight(0.0, own) * weight, jnp.sqrt(p["k1"] * p["m1"])
        drill = DrillConstants(
            m1=p["m1"],
            m2=m2,
            k1=p["k1"],
            k2=k2,
            c2=p["c2"],
            inverse_m1=1 / p["m1"],
            inverse_m2=1 / m2,
            period=jnp.sqrt(p["m1"] / p["k1"]),
            v=p["v"],
            weight=weight,
            stick_limit=limit,
            stick_gain=self.friction.on_impact(0.0, own) + 0 * weight,
            impedance=impedance,
            # The drive speed plus the speed that the release of the stick limit gives to the bit on its spring.
            speed_scale=p["v"] + (limit + 1e-6 * weight) / impedance,
            law=own,
        )
        return RotaryConstants(drill)

    def rate(self, c: Any, mode: Values) -> Any:
        return self.flight_rate(c)

    def start(self, c: Any, name: Start, shape: tuple[int, ...]) -> Values:
        """Return the initial state for `drive`, `stuck` (reading R5 of the source), or a vector (x1, x1', x2, x2').

        All further states are zero.
        """
        v = c.drill.v
        xp = np if isinstance(v, np.ndarray) else jnp  # outside of traces, jax would compile a program for zeros
        zero = xp.zeros(shape, v.dtype)
        if name is None or isinstance(name, str):
            masses: Values = (zero, -v + zero if name == "stuck" else zero, zero, zero)
        else:
            masses = tuple(xp.full(shape, value, v.dtype) for value in name)
        return (*masses, *(zero for _ in self.states[4:]))

    def scaled(self, c: Any, state: Values) -> Any:
        """Return the constants with a typical speed that accounts for the initial energy.

        If drive and friction are almost zero, only the initial energy determines the speed of the motion. Only the
        small fraction `STARTING_SHARE` of that speed is used, so that a transient does not set the accuracy of the
        motion after it.
        """
        x1, v1, x2, v2 = state[:4]
        drill = c.drill
        springs = drill.k1 * x1 * x1 + drill.k2 * (x1 - x2) ** 2
        energy = (springs + drill.m1 * v1 * v1 + drill.m2 * v2 * v2) / 2 + self.stored(c, state)
        fastest = jnp.sqrt(2 * energy * jnp.maximum(drill.inverse_m1, drill.inverse_m2))
        speed = jnp.maximum(drill.speed_scale, STARTING_SHARE * fastest)
        return c._replace(drill=drill._replace(speed_scale=speed))

    def mode_at(self, c: Any, state: Values, *others: Any) -> Values:
        """Return the mode at `state`; a subclass passes the modes after `slip`."""
        u = state[1] + c.drill.v
        _, at_rest = self._slip_from_rest(c, (None, *others), state)
        return (jnp.where(u == 0, at_rest, jnp.sign(u)), *others)

    def field(self, c: Any, mode: Values, state: Values) -> Values:
        slip = mode[0]
        v1, bit, *others = self._sliding_rates(c, mode, state, slip)
        return (v1, (slip * slip) * bit, *others)

    def smoothed_field(self, c: Any, mode: Values, state: Values, width: Any) -> Values:
        u = state[1] + c.drill.v
        return self._sliding_rates(c, mode, state, u / jnp.sqrt(u * u + width * width))

    def _sliding_rates(self, c: Any, mode: Values, state: Values, slip: Any) -> Values:
        """Return the time derivatives of a sliding bit (source, eqs. 5.9, 5.12); `slip`: the sign of the velocity u."""
        drill, impact, pull = c.drill, self.impact(c, mode, state), self.pull(c, state)
        x1, v1, x2, v2 = state[:4]
        speed = slip * (v1 + drill.v)
        force = self.friction.on_weight(speed, drill.law) * drill.weight
        if impact is not None:  # friction due to the impact force opposes the sliding (reading R2 of the source)
            force = force + self.friction.on_impact(speed, drill.law) * impact
        bit = (pull - slip * force) * drill.inverse_m1
        on_striker = drill.k2 * (x1 - x2) - drill.c2 * v2
        if impact is not None:
            on_striker = on_striker - impact
        return (v1, bit, v2, on_striker * drill.inverse_m2, *self.other_rates(c, mode, state, impact))

    def smoothed_mode(self, c: Any, mode: Values, state: Values, width: Any) -> Values:
        u = state[1] + c.drill.v
        return (jnp.where(jnp.abs(u) <= width, 0.0, jnp.sign(u)), *mode[1:])

    def guards(self) -> tuple[Guard, ...]:
        def keeps_slip(c: Any, mode: Values, state: Values) -> Any:
            """Return |u| while sliding; while sticking, the stick limit minus |pull|, divided by sqrt(k1 m1)."""
            slip, u, pull = mode[0], state[1] + c.drill.v, self.pull(c, state)
            margin = self._stick_limit(c, mode, state) - absolute(pull)
            return slip * u + ((1.0 - slip * slip) / c.drill.impedance) * margin

        def resolution(c: Any, mode: Values) -> Any:
            return jnp.where(mode[0] == 0, self._stick_noise(c, mode) / c.drill.impedance, speed_noise(c.drill))

        def slope_resolution(c: Any, mode: Values, h: Any) -> Any:
            # While sliding, this is the change caused by an excess force of `_stick_noise`. Sticking and sliding must
            # use the same tolerance; otherwise a bit on the stick limit would alternate between the two modes.
            drill, excess = c.drill, self._stick_noise(c, mode)
            return jnp.where(mode[0] == 0, SLOPE_ROUNDINGS * excess / drill.impedance, excess * h * drill.inverse_m1)

        return (Guard("friction", keeps_slip, resolution, slope_resolution, is_switch=True),)

    def reset(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        mode, state = self.other_reset(c, mode, state, hits)
        state = (state[0], jnp.where(hits["friction"], -c.drill.v, state[1]), *state[2:])
        starts, at_rest = self._slip_from_rest(c, mode, state)
        after = jnp.where(mode[0] == 0, starts, at_rest)
        return (jnp.where(hits["friction"], after, mode[0]), *mode[1:]), state

    def _slip_from_rest(self, c: Any, mode: Values, state: Values) -> tuple[Any, Any]:
        """Return, where u = 0, the direction in which a bit that cannot stick starts to slide, and the mode `slip`.

        The direction is the sign of the net spring force or, if the force is zero, of its time derivative. If the force
        exceeds the stick limit by less than the noise, the bit sticks. If the force then grows, the bit starts to slide
        at once. If the force falls, a slip would have ended as soon as it began.
        """
        limit, noise = self._stick_limit(c, mode, state), self._stick_noise(c, mode)
        pull, pull_rate = self.pull(c, state), self.pull_rate(c, state)
        starts = jnp.sign(jnp.where(pull == 0, pull_rate, pull))
        # Without a stick limit the bit never sticks, not even when the net spring force passes through zero.
        sticks = (jnp.abs(pull) <= limit + noise) & (limit > 0)
        return starts, jnp.where(sticks, 0.0, starts)

    def _stick_limit(self, c: Any, mode: Values, state: Values) -> Any:
        """Return the greatest net spring force [N] under which the bit sticks, f_st + mu J (source, eq. 5.11).

        The equation is read as in readings R1 and R2 of the source.
        """
        impact = self.impact(c, mode, state)
        return c.drill.stick_limit if impact is None else c.drill.stick_limit + c.drill.stick_gain * impact

    def _stick_noise(self, c: Any, mode: Values) -> Any:
        """Return the excess [N] of the net spring force over the stick limit that counts as zero."""
        return c.drill.impedance * speed_noise(c.drill) + c.drill.stick_gain * self.impact_noise(c, mode)

    def bit(self, c: Any) -> Bit:
        return Bit(c.drill.m1, c.drill.weight, c.drill.v)

    def pull(self, c: Any, state: Values) -> Any:
        """Return the net spring force on the bit [N], -k1 x1 - k2 (x1 - x2)."""
        return c.drill.k2 * (state[2] - state[0]) - c.drill.k1 * state[0]

    def pull_rate(self, c: Any, state: Values) -> Any:
        """Return the time derivative of the net spring force on the bit [N/s].

        The sign is the direction in which the bit starts to slide if the net spring force is zero.
        """
        return c.drill.k2 * (state[3] - state[1]) - c.drill.k1 * state[1]

    def flight_rate(self, c: Any) -> Any:
        drill = c.drill
        springs = (drill.k1 + drill.k2) * drill.inverse_m1 + drill.k2 * drill.inverse_m2
        return jnp.sqrt(springs) + drill.c2 * drill.inverse_m2

    def spring_rate(self, c: Any) -> Any:
        return jnp.sqrt(c.drill.k1 / c.drill.m1)

    def typical_speed(self, c: Any) -> Any:
        return c.drill.v + c.drill.stick_limit / c.drill.impedance

    def speed_scale(self, c: Any) -> Any:
        return c.drill.speed_scale

    def validity(self, c: Any, mode: Values, polynomials: tuple[list[Array], ...], functions: list[list[Array]]) -> Any:
        """Return the fraction of a step over which the series are valid for a law with `flat_below`, else None.

        Over this fraction the sliding speed changes by at most half the sum of itself and the law's `flat_below`.
        """
        if self.friction.flat_below is None:
            return None
        v1 = polynomials[1]
        change = (jnp.abs(v1[0] + c.drill.v) + self.friction.flat_below(c.drill.law)) / 2
        terms = [jnp.abs(coefficient) for coefficient in v1[1:]]
        share = change / len(terms)
        reach = jnp.min(jnp.stack([(share / term) ** (1 / k) for k, term in enumerate(terms, start=1)]), axis=0)
        return jnp.where(mode[0] == 0, 1.0, reach)


SCENES = (Rotary,)
