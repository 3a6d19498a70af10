"""The rotary scene: bit and striker on their springs with dry friction, the base of every scene with a sliding bit.

m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u, J),   m2 x2'' = -c2 x2' - k2 (x2 - x1) - J,   u = x1' + v
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from vibrojax.errors import InputError, shown
from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.physics.modes import striker
from vibrojax.physics.parameters import BIT_AND_STRIKER, Parameter
from vibrojax.scenes import stick_slip
from vibrojax.scenes.capabilities import Bit, HasFriction
from vibrojax.scenes.declared import Guard, Marker, Mode, Section, Start, State, Swing, Values
from vibrojax.scenes.scene import ARMED_BELOW
from vibrojax.scenes.stick_slip import SlipConstants, slip_constants

STARTING_SHARE = 0.05
"""Fraction of the greatest speed allowed by the initial energy that counts as a typical speed of the motion."""


class DrillConstants(NamedTuple):
    """Constants of the two masses, each (lanes,).

    - `m1`, `m2` [kg], `k1`, `k2` [N/m], `c2` [N s/m]: masses, stiffnesses, damping; `inverse_m1`, `inverse_m2` [1/kg].
    - `period` [s]: time scale sqrt(m1/k1) that converts a speed of the bit to a length.
    - `slip`: the constants of friction.
    """

    m1: Any
    m2: Any
    k1: Any
    k2: Any
    c2: Any
    inverse_m1: Any
    inverse_m2: Any
    period: Any
    slip: SlipConstants


def drill_constants(p: Mapping[str, Any], law: FrictionLaw) -> DrillConstants:
    """Return the constants from the values `p` of the bit and striker parameters and of the law's parameters.

    The bit and striker parameters are [vibrojax.physics.parameters.BIT_AND_STRIKER][].
    """
    m2, k2 = striker(p)
    return DrillConstants(
        m1=p["m1"],
        m2=m2,
        k1=p["k1"],
        k2=k2,
        c2=p["c2"],
        inverse_m1=1 / p["m1"],
        inverse_m2=1 / m2,
        period=jnp.sqrt(p["m1"] / p["k1"]),
        slip=slip_constants(p, law),
    )


def accelerations(
    law: FrictionLaw, c: DrillConstants, slip: Any, state: Values, pull: Any, impact: Any
) -> tuple[Any, Any]:
    """Return the accelerations x1'' of the sliding bit and x2'' of the striker [m/s²].

    `pull`: net spring force on the bit [N]; `impact`: contact force J [N], or None without a contact.
    """
    x1, v1, x2, v2 = state
    force = stick_slip.friction(law, c.slip, slip, v1 + c.slip.v, impact)
    bit = (pull - force) * c.inverse_m1
    on_striker = c.k2 * (x1 - x2) - c.c2 * v2
    if impact is not None:
        on_striker = on_striker - impact
    return bit, on_striker * c.inverse_m2


def length_noise(c: DrillConstants) -> Any:
    """Return the distance [m] that counts as zero: a small multiple of the rounding error of a typical distance."""
    return stick_slip.speed_noise(c.slip) * c.period


def _rearm(c: Any) -> Any:
    return -ARMED_BELOW * c.drill.slip.v


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
        return RotaryConstants(drill_constants(p, self.friction))

    def rate(self, c: Any, mode: Values) -> Any:
        return self.flight_rate(c)

    def start(self, c: Any, name: Start, shape: tuple[int, ...]) -> Values:
        """Return the initial state for `drive`, `stuck` (reading R5 of the source), or a vector (x1, x1', x2, x2').

        All further states are zero.
        """
        v = c.drill.slip.v
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
        speed = jnp.maximum(drill.slip.speed_scale, STARTING_SHARE * fastest)
        return c._replace(drill=drill._replace(slip=drill.slip._replace(speed_scale=speed)))

    def mode_at(self, c: Any, state: Values, *others: Any) -> Values:
        """Return the mode at `state`; a subclass passes the modes after `slip`."""
        impact, noise = self.impact(c, (None, *others), state), self._stick_noise(c, (None, *others))
        u, pulls = state[1] + c.drill.slip.v, (self.pull(c, state), self.pull_rate(c, state))
        return (stick_slip.slip_at(c.drill.slip, u, *pulls, impact, noise), *others)

    def field(self, c: Any, mode: Values, state: Values) -> Values:
        slip = mode[0]
        v1, bit, *others = self._sliding_rates(c, mode, state, slip)
        return (v1, (slip * slip) * bit, *others)

    def smoothed_field(self, c: Any, mode: Values, state: Values, width: Any) -> Values:
        return self._sliding_rates(c, mode, state, stick_slip.smoothed_slip(state[1] + c.drill.slip.v, width))

    def _sliding_rates(self, c: Any, mode: Values, state: Values, slip: Any) -> Values:
        impact = self.impact(c, mode, state)
        bit, striker = accelerations(self.friction, c.drill, slip, state[:4], self.pull(c, state), impact)
        return (state[1], bit, state[3], striker, *self.other_rates(c, mode, state, impact))

    def smoothed_mode(self, c: Any, mode: Values, state: Values, width: Any) -> Values:
        return (stick_slip.smoothed_mode(state[1] + c.drill.slip.v, width), *mode[1:])

    def guards(self) -> tuple[Guard, ...]:
        def motion(c: Any, mode: Values, state: Values) -> tuple[Any, Any, Any]:
            return state[1] + c.drill.slip.v, self.pull(c, state), self.impact(c, mode, state)

        return (stick_slip.friction_guard(lambda c: c.drill.slip, motion, self._stick_noise),)

    def reset(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        mode, state = self.other_reset(c, mode, state, hits)
        impact, noise = self.impact(c, mode, state), self._stick_noise(c, mode)
        state = (state[0], jnp.where(hits["friction"], -c.drill.slip.v, state[1]), *state[2:])
        pulls = self.pull(c, state), self.pull_rate(c, state)
        after = stick_slip.slip_after(c.drill.slip, mode[0], *pulls, impact, noise)
        return (jnp.where(hits["friction"], after, mode[0]), *mode[1:]), state

    def _stick_noise(self, c: Any, mode: Values) -> Any:
        return stick_slip.stick_noise(c.drill.slip, self.impact_noise(c, mode))

    def bit(self, c: Any) -> Bit:
        return Bit(c.drill.m1, c.drill.slip.weight, c.drill.slip.v)

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
        return c.drill.slip.v + c.drill.slip.stick_limit / c.drill.slip.impedance

    def speed_scale(self, c: Any) -> Any:
        return c.drill.slip.speed_scale

    def validity(self, c: Any, mode: Values, polynomials: tuple[list[Array], ...], functions: list[list[Array]]) -> Any:
        return stick_slip.validity(self.friction, c.drill.slip, mode[0], polynomials[1])


SCENES = (Rotary,)
