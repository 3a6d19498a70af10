"""The vibro-impact scene, whose striker hits the bit (source, eq. 5.18), the base of every drill with impacts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp

from vibrojax.models.physics.contact import contact_time
from vibrojax.models.physics.parameters import BIT_AND_STRIKER, CONTACT, Parameter
from vibrojax.models.scenes import one_sided
from vibrojax.models.scenes.capabilities import HasContact
from vibrojax.models.scenes.declared import Guard, Mode, Start, Values
from vibrojax.models.scenes.one_sided import ContactConstants, contact_constants
from vibrojax.models.scenes.rotary import DrillConstants, Rotary, drill_constants, length_noise


class VibroImpactConstants(NamedTuple):
    """Constants of the two masses and of the contact between them."""

    drill: DrillConstants
    contact: ContactConstants


@dataclass(frozen=True)
class VibroImpact(Rotary, HasContact[Any]):
    """Bit and striker with stick-slip friction; the striker hits the bit through a one-sided contact.

    m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u, J); m2 x2'' = -c2 x2' - k2 (x2 - x1) - J (eq. 5.18)
    """

    name = "vibro-impact"
    modes: ClassVar[tuple[Mode, ...]] = (*Rotary.modes, Mode("touching", "1 where striker and bit touch", 0.0))
    starts: ClassVar[tuple[str, ...]] = (*Rotary.starts, "touching")
    measures: ClassVar[tuple[Any, ...]] = ("swings", "shares", "impacts", "harmonics")
    own_parameters: ClassVar[dict[str, Parameter]] = BIT_AND_STRIKER | CONTACT

    def constants(self, p: Mapping[str, Any]) -> Any:
        return VibroImpactConstants(drill_constants(p, self.friction), contact_constants(p))

    def compression(self, c: Any, mode: Values, state: Values) -> tuple[Any, Any]:
        """Return the compression of the contact [m] and the compression rate [m/s]; Taylor series are accepted."""
        return state[2] - c.contact.delta, state[3]

    def compressed(self, c: Any, state: Values, before: Any, after: Any) -> Any:
        """Return the position x2 [m] at which the contact's compression is `after` instead of `before` [m]."""
        return c.contact.delta + after

    def start(self, c: Any, name: Start, shape: tuple[int, ...]) -> Values:
        x1, v1, x2, *others = super().start(c, name, shape)
        if name == "touching":  # as `drive`, but without the kick of a preloaded contact (R13)
            x2 = jnp.minimum(x2, c.contact.delta)
        return (x1, v1, x2, *others)

    def mode_at(self, c: Any, state: Values, *others: Any) -> Values:
        pushed = c.drill.k2 * (state[0] - state[2]) - c.drill.c2 * state[3]
        compression = self.compression(c, (None, None, *others), state)
        return super().mode_at(c, state, one_sided.touching_at(c.contact, *compression, pushed), *others)

    def guards(self) -> tuple[Guard, ...]:
        def touches(c: Any, mode: Values, state: Values) -> Any:
            return one_sided.guard(c.contact, mode[1], *self.compression(c, mode, state))

        return (*super().guards(), Guard("contact", touches, lambda c, mode: length_noise(c.drill)))

    def other_reset(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        hit, (before, rate) = hits["contact"], self.compression(c, mode, state)
        touching, after = one_sided.reset(c.contact, mode[1], before, rate, hit, length_noise(c.drill))
        x2 = jnp.where(hit, self.compressed(c, state, before, after), state[2])
        return (mode[0], touching, *mode[2:]), (state[0], state[1], x2, *state[3:])

    def impact(self, c: Any, mode: Values, state: Values) -> Any:
        return self.contact_force(c, mode, state)

    def impact_noise(self, c: Any, mode: Values) -> Any:
        return mode[1] * one_sided.force_resolution(c.contact, c.drill.m2, c.drill.slip.v)

    def stored(self, c: Any, state: Values) -> Any:
        return one_sided.energy(c.contact, state[2] - c.contact.delta)

    def rate(self, c: Any, mode: Values) -> Any:
        flight = self.flight_rate(c)
        return jnp.where(mode[1] != 0, one_sided.stiff_rate(c.contact, c.drill.inverse_m2, flight), flight)

    def contact_force(self, c: Any, mode: Values, state: Values) -> Any:
        return one_sided.force(c.contact, mode[1], *self.compression(c, mode, state))

    def impact_rate(self, c: Any, mode: Values, state: Values) -> Any:
        return self.compression(c, mode, state)[1]

    def impact_begins(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        compression = self.compression(c, mode, state)
        return one_sided.begins(c.contact, mode[1], *compression, hits["contact"], length_noise(c.drill))

    def striker_mass(self, c: Any) -> Any:
        return c.drill.m2

    def contact_time(self, c: Any) -> Any:
        return contact_time(c.drill.m2, c.contact.k0, c.contact.c0)

    def contact_rate(self, c: Any) -> Any:
        return one_sided.own_rate(c.contact, c.drill.m2)


SCENES = (VibroImpact,)
