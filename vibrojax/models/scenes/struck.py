"""The drill whose striker hits the bit through a one-sided contact: what every scene with impacts shares."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import jax.numpy as jnp

from vibrojax.models.physics.contact import contact_time
from vibrojax.models.scenes import one_sided
from vibrojax.models.scenes.capabilities import HasContact
from vibrojax.models.scenes.declared import Guard, Mode, Start, Values
from vibrojax.models.scenes.drill import Drill, WithDrill, length_noise, two_masses_start
from vibrojax.models.scenes.one_sided import ContactConstants


@runtime_checkable
class WithContact(WithDrill, Protocol):
    """The constants of a scene with the drill and the contact."""

    @property
    def contact(self) -> ContactConstants:
        """Those of the contact."""
        ...


S = TypeVar("S", bound=WithContact)


@dataclass(frozen=True)
class Struck(Drill[S], HasContact[S]):
    """The drill with its contact; `touching` is the second mode."""

    modes: ClassVar[tuple[Mode, ...]] = (*Drill.modes, Mode("touching", "1 where striker and bit touch", 0.0))
    starts: ClassVar[tuple[str, ...]] = (*Drill.starts, "touching")

    @abstractmethod
    def compression(self, c: S, mode: Values, state: Values) -> tuple[Any, Any]:
        """Compression of the contact [m] and its rate [m/s]; arrays and series."""

    @abstractmethod
    def compressed(self, c: S, state: Values, before: Any, after: Any) -> Any:
        """x2 [m] where the contact is compressed by `after` instead of `before`."""

    def start(self, c: S, name: Start, shape: tuple[int, ...]) -> Values:
        x1, v1, x2, v2 = two_masses_start(c.drill, name, shape)
        if name == "touching":  # the drive's start without its kick (R13)
            x2 = jnp.minimum(x2, c.contact.delta)
        rest = jnp.zeros_like(x1)
        return (x1, v1, x2, v2, *(rest for _ in self.states[4:]))

    def touching_at(self, c: S, mode: Values, state: Values) -> Any:
        """The mode `touching` at a state; of `mode` only the rest is asked for."""
        pushed = c.drill.k2 * (state[0] - state[2]) - c.drill.c2 * state[3]
        return one_sided.touching_at(c.contact, *self.compression(c, mode, state), pushed)

    def contact_guard(self) -> Guard:
        """Where the contact begins or ends."""

        def touches(c: S, mode: Values, state: Values) -> Any:
            return one_sided.guard(c.contact, mode[1], *self.compression(c, mode, state))

        return Guard("contact", touches, lambda c, mode: length_noise(c.drill))

    def reset_contact(self, c: S, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Any, Any]:
        """The mode `touching`, and x2, after the contact's guard."""
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
