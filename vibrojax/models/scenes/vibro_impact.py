"""The vibro-impact scene: the drill whose striker hits the bit through a one-sided contact (eq. 5.18)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from vibrojax.models.physics.parameters import BIT_AND_STRIKER, CONTACT, Parameter
from vibrojax.models.scenes.declared import Guard, Values
from vibrojax.models.scenes.drill import DrillConstants, drill_constants
from vibrojax.models.scenes.one_sided import ContactConstants, contact_constants
from vibrojax.models.scenes.struck import Struck


class VibroImpactConstants(NamedTuple):
    """The constants of the scene: those of the two masses, and of the contact between them."""

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

    def other_rates(self, c: VibroImpactConstants, mode: Values, state: Values, impact: Any) -> Values:
        return ()

    def other_guards(self) -> tuple[Guard, ...]:
        return (self.contact_guard(),)

    def other_reset(
        self, c: VibroImpactConstants, mode: Values, state: Values, hits: Mapping[str, Any]
    ) -> tuple[Values, Values]:
        touching, x2 = self.reset_contact(c, mode, state, hits)
        return (mode[0], touching), (state[0], state[1], x2, *state[3:])


SCENES = (VibroImpact,)
