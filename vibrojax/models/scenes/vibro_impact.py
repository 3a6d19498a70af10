"""The base of all scenes whose striker hits the bit (source, eq. 5.18), and the vibro-impact scene."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax.numpy as jnp

from vibrojax.models.physics.contact import contact_time
from vibrojax.models.physics.parameters import BIT_AND_STRIKER, CONTACT, Parameter
from vibrojax.models.scenes import one_sided
from vibrojax.models.scenes.capabilities import HasContact
from vibrojax.models.scenes.declared import Guard, Mode, Start, Values
from vibrojax.models.scenes.drill import Drill, DrillConstants, WithDrill, drill_constants, length_noise
from vibrojax.models.scenes.one_sided import ContactConstants, contact_constants


@runtime_checkable
class WithContact(WithDrill, Protocol):
    """Constants of a scene that include the constants of the drill and of the contact."""

    @property
    def contact(self) -> ContactConstants: ...


S = TypeVar("S", bound=WithContact)


@dataclass(frozen=True)
class Struck(Drill[S], HasContact[S]):
    """The drill with a one-sided contact, the base of every drill scene with impacts; `touching` is the second mode."""

    modes: ClassVar[tuple[Mode, ...]] = (*Drill.modes, Mode("touching", "1 where striker and bit touch", 0.0))
    starts: ClassVar[tuple[str, ...]] = (*Drill.starts, "touching")

    @abstractmethod
    def compression(self, c: S, mode: Values, state: Values) -> tuple[Any, Any]:
        """Return the compression of the contact [m] and the compression rate [m/s]; Taylor series are accepted."""

    @abstractmethod
    def compressed(self, c: S, state: Values, before: Any, after: Any) -> Any:
        """Return the position x2 [m] at which the contact's compression is `after` instead of `before` [m]."""

    def start(self, c: S, name: Start, shape: tuple[int, ...]) -> Values:
        x1, v1, x2, *others = super().start(c, name, shape)
        if name == "touching":  # as `drive`, but without the kick of a preloaded contact (R13)
            x2 = jnp.minimum(x2, c.contact.delta)
        return (x1, v1, x2, *others)

    def touching_at(self, c: S, mode: Values, state: Values) -> Any:
        """Return the mode `touching` at a state; only the entries of `mode` after `touching` are used."""
        pushed = c.drill.k2 * (state[0] - state[2]) - c.drill.c2 * state[3]
        return one_sided.touching_at(c.contact, *self.compression(c, mode, state), pushed)

    def contact_guard(self) -> Guard:
        """Return the guard whose zeros begin and end the contact."""

        def touches(c: S, mode: Values, state: Values) -> Any:
            return one_sided.guard(c.contact, mode[1], *self.compression(c, mode, state))

        return Guard("contact", touches, lambda c, mode: length_noise(c.drill))

    def reset_contact(self, c: S, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return the mode `touching` and the position x2 after an event; both change where the contact guard is hit."""
        hit, (before, rate) = hits["contact"], self.compression(c, mode, state)
        touching, after = one_sided.reset(c.contact, mode[1], before, rate, hit, length_noise(c.drill))
        return touching, jnp.where(hit, self.compressed(c, state, before, after), state[2])

    def impact(self, c: S, mode: Values, state: Values) -> Any:
        return self.contact_force(c, mode, state)

    def impact_noise(self, c: S, mode: Values) -> Any:
        return mode[1] * one_sided.force_resolution(c.contact, c.drill.m2, c.drill.slip.v)

    def stored(self, c: S, state: Values) -> Any:
        return one_sided.energy(c.contact, state[2] - c.contact.delta)

    def rate(self, c: S, mode: Values) -> Any:
        flight = self.flight_rate(c)
        return jnp.where(mode[1] != 0, one_sided.stiff_rate(c.contact, c.drill.inverse_m2, flight), flight)

    def contact_force(self, c: S, mode: Values, state: Values) -> Any:
        return one_sided.force(c.contact, mode[1], *self.compression(c, mode, state))

    def impact_rate(self, c: S, mode: Values, state: Values) -> Any:
        return self.compression(c, mode, state)[1]

    def impact_begins(self, c: S, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        compression = self.compression(c, mode, state)
        return one_sided.begins(c.contact, mode[1], *compression, hits["contact"], length_noise(c.drill))

    def striker_mass(self, c: S) -> Any:
        return c.drill.m2

    def contact_time(self, c: S) -> Any:
        return contact_time(c.drill.m2, c.contact.k0, c.contact.c0)

    def contact_rate(self, c: S) -> Any:
        return one_sided.own_rate(c.contact, c.drill.m2)


class VibroImpactConstants(NamedTuple):
    """Constants of the two masses and of the contact between them."""

    drill: DrillConstants
    contact: ContactConstants


@dataclass(frozen=True)
class VibroImpact(Struck[VibroImpactConstants]):
    """Bit and striker with stick-slip friction; the striker hits the bit through a one-sided contact.

    m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u, J); m2 x2'' = -c2 x2' - k2 (x2 - x1) - J (eq. 5.18)
    """

    name = "vibro-impact"
    measures = ("swings", "shares", "impacts", "harmonics")

    def parameters(self) -> Mapping[str, Parameter]:
        return BIT_AND_STRIKER | CONTACT | dict(self.friction.parameters)

    def constants(self, p: Mapping[str, Any]) -> VibroImpactConstants:
        return VibroImpactConstants(drill_constants(p, self.friction), contact_constants(p))

    def compression(self, c: VibroImpactConstants, mode: Values, state: Values) -> tuple[Any, Any]:
        return state[2] - c.contact.delta, state[3]

    def compressed(self, c: VibroImpactConstants, state: Values, before: Any, after: Any) -> Any:
        return c.contact.delta + after

    def other_modes_at(self, c: VibroImpactConstants, state: Values) -> Values:
        return (self.touching_at(c, (None, None), state),)

    def other_guards(self) -> tuple[Guard, ...]:
        return (self.contact_guard(),)

    def other_reset(
        self, c: VibroImpactConstants, mode: Values, state: Values, hits: Mapping[str, Any]
    ) -> tuple[Values, Values]:
        touching, x2 = self.reset_contact(c, mode, state, hits)
        return (mode[0], touching), (state[0], state[1], x2, *state[3:])


SCENES = (VibroImpact,)
