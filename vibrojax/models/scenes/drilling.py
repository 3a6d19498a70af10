"""The drilling scenes: the striker drives the bit into the rock, without feedback (as in the source) or with it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp

from vibrojax.models.physics.parameters import BIT_AND_STRIKER, CONTACT, Parameter
from vibrojax.models.physics.rock import ROCK, ROCKS
from vibrojax.models.scenes import bit_on_rock
from vibrojax.models.scenes.bit_on_rock import OnRock, RockConstants, rock_constants
from vibrojax.models.scenes.declared import Guard, Values
from vibrojax.models.scenes.drill import Drill, DrillConstants, drill_constants, length_noise
from vibrojax.models.scenes.one_sided import ContactConstants, contact_constants
from vibrojax.models.scenes.scene import Scene
from vibrojax.models.scenes.vibro_impact import Struck, VibroImpact


class DrillingConstants(NamedTuple):
    """Constants of the two masses, of the contact, and of the bit on the rock."""

    drill: DrillConstants
    contact: ContactConstants
    rock: RockConstants


def _sandstone() -> dict[str, Parameter]:
    """Return the rock parameters with sandstone defaults, because most impacts of this drill never break granite."""
    defaults = {"k3": ROCKS["sandstone"].k3, "threshold": ROCKS["sandstone"].threshold, "zeta": 1.5}
    return {name: replace(parameter, default=defaults[name]) for name, parameter in ROCK.items()}


@dataclass(frozen=True)
class Drilling(Struck[DrillingConstants], OnRock[DrillingConstants]):
    """The vibro-impact drill whose impacts drive the bit into the rock, without feedback, as in the source.

    The bit's normal motion is m1 x3'' + c3 x3' = -N + J (source, eqs. 5.18, 6.1 to 6.3). The rock does not act on the
    drill: the contact is the same as in the vibro-impact scene.
    States: x1, x1', x2, x2', the rock's compression x3 - x4, x3', and the growth of x4 since the last impact began.
    The total depth of the hole is not a state, so rounding errors of a large depth cannot affect the motion.
    """

    name = "drilling"
    states = (*Drill.states, *bit_on_rock.STATES)
    modes = (*Struck.modes, bit_on_rock.MODE)
    measures = ("swings", "shares", "impacts", "harmonics", "drilling")
    choices = Struck.choices | OnRock.choices
    drifting: ClassVar[tuple[str, ...]] = ("growth",)

    def driving_part(self) -> Scene[Any]:
        return VibroImpact(self.friction)

    def parameters(self) -> Mapping[str, Parameter]:
        return BIT_AND_STRIKER | CONTACT | _sandstone() | dict(self.friction.parameters)

    def constants(self, p: Mapping[str, Any]) -> DrillingConstants:
        return DrillingConstants(drill_constants(p, self.friction), contact_constants(p), rock_constants(p, p["g"]))

    def compression(self, c: DrillingConstants, mode: Values, state: Values) -> tuple[Any, Any]:
        return state[2] - c.contact.delta, state[3]

    def compressed(self, c: DrillingConstants, state: Values, before: Any, after: Any) -> Any:
        return state[2] + (after - before)

    def rock_resolution(self, c: DrillingConstants, mode: Values) -> Any:
        return super().rock_resolution(c, mode) + length_noise(c.drill)

    def other_modes_at(self, c: DrillingConstants, state: Values) -> Values:
        rock = bit_on_rock.rock_at(c.rock, state[4], state[5])
        return (self.touching_at(c, (None, None, rock), state), rock)

    def other_rates(self, c: DrillingConstants, mode: Values, state: Values, impact: Any) -> Values:
        return self.rock_rates(c, mode, state, impact)

    def other_guards(self) -> tuple[Guard, ...]:
        return (self.contact_guard(), *self.rock_guards())

    def other_reset(
        self, c: DrillingConstants, mode: Values, state: Values, hits: Mapping[str, Any]
    ) -> tuple[Values, Values]:
        begins = self.impact_begins(c, mode, state, hits)
        touching, x2 = self.reset_contact(c, mode, state, hits)
        rock, compression, v3 = self.reset_rock(c, mode, state, hits)
        growth = jnp.where(begins, 0.0, state[6])
        rock, compression, v3 = bit_on_rock.at_rest(c.rock, rock, compression, v3, touching != 0)
        return (mode[0], touching, rock), (state[0], state[1], x2, state[3], compression, v3, growth)

    def rate(self, c: DrillingConstants, mode: Values) -> Any:
        drill, rock = super().rate(c, mode), bit_on_rock.rock_rate(c.rock, mode[2], mode[1] == 0)
        return jnp.where(mode[2] == bit_on_rock.REST, drill, jnp.maximum(drill, rock))


@dataclass(frozen=True)
class CoupledDrilling(Drilling):
    """The drilling scene with feedback of the bit's normal motion to the contact (recommendation 1 of the source).

    The contact's compression is x2 - delta - (x3 - x4). The drive follows the hole, so the depth does not open the gap.
    """

    name = "coupled-drilling"

    def driving_part(self) -> Scene[Any]:
        return self

    def compression(self, c: DrillingConstants, mode: Values, state: Values) -> tuple[Any, Any]:
        depth, rate = state[4], state[5] * jnp.where(mode[2] == 1, 0.0, 1.0)  # while the rock yields, x3' = x4'
        return state[2] - c.contact.delta - depth, state[3] - rate


SCENES = (Drilling, CoupledDrilling)
