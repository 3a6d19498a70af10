"""The drilling scenes: the striker drives the bit into the rock, without feedback (as in the source) or with it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.physics.parameters import Parameter
from vibrojax.physics.rock import ROCK, ROCKS
from vibrojax.scenes import bit_on_rock
from vibrojax.scenes.bit_on_rock import OnRock, RockConstants, rock_constants
from vibrojax.scenes.declared import Guard, Values
from vibrojax.scenes.rotary import DrillConstants, length_noise
from vibrojax.scenes.scene import Scene
from vibrojax.scenes.vibro_impact import ContactConstants, VibroImpact

# Most impacts of this drill never break granite, so the default rock is sandstone.
_DEFAULTS = {"k3": ROCKS["sandstone"].k3, "threshold": ROCKS["sandstone"].threshold, "zeta": 1.5}


class DrillingConstants(NamedTuple):
    """Constants of the two masses, of the contact, and of the bit on the rock."""

    drill: DrillConstants
    contact: ContactConstants
    rock: RockConstants


@dataclass(frozen=True)
class Drilling(VibroImpact, OnRock):
    """The vibro-impact drill whose impacts drive the bit into the rock, without feedback, as in Batako's thesis.

    The bit's normal motion is m1 x3'' + c3 x3' = -N + J (source, eqs. 5.18, 6.1 to 6.3). The rock does not act on the
    drill: the contact is the same as in the vibro-impact scene.
    States: x1, x1', x2, x2', the rock's compression x3 - x4, x3', and the growth of x4 since the last impact began.
    The total depth of the hole is not a state, so rounding errors of a large depth cannot affect the motion.
    """

    name = "drilling"
    states = (*VibroImpact.states, *bit_on_rock.STATES)
    modes = (*VibroImpact.modes, bit_on_rock.MODE)
    measures = ("swings", "shares", "impacts", "harmonics", "drilling")
    choices = VibroImpact.choices | OnRock.choices
    drifting: ClassVar[tuple[str, ...]] = ("growth",)
    own_parameters: ClassVar[dict[str, Parameter]] = VibroImpact.own_parameters | {
        name: replace(parameter, default=_DEFAULTS[name]) for name, parameter in ROCK.items()
    }

    def driving_part(self) -> Scene[Any]:
        return VibroImpact(self.friction)

    def constants(self, p: Mapping[str, Any]) -> Any:
        drill, contact = super().constants(p)
        return DrillingConstants(drill, contact, rock_constants(p, p["g"]))

    def compressed(self, c: Any, state: Values, before: Any, after: Any) -> Any:
        return state[2] + (after - before)

    def rock_resolution(self, c: Any, mode: Values) -> Any:
        return super().rock_resolution(c, mode) + length_noise(c.drill)

    def mode_at(self, c: Any, state: Values, *others: Any) -> Values:
        return super().mode_at(c, state, bit_on_rock.rock_at(c.rock, state[4], state[5]), *others)

    def other_rates(self, c: Any, mode: Values, state: Values, impact: Any) -> Values:
        return self.rock_rates(c, mode, state, impact)

    def guards(self) -> tuple[Guard, ...]:
        return (*super().guards(), *self.rock_guards())

    def other_reset(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        begins = self.impact_begins(c, mode, state, hits)
        (slip, touching, _), masses = super().other_reset(c, mode, state, hits)
        rock, compression, v3 = self.reset_rock(c, mode, state, hits)
        growth = jnp.where(begins, 0.0, state[6])
        rock, compression, v3 = bit_on_rock.at_rest(c.rock, rock, compression, v3, touching != 0)
        return (slip, touching, rock), (*masses[:4], compression, v3, growth)

    def rate(self, c: Any, mode: Values) -> Any:
        drill, rock = super().rate(c, mode), bit_on_rock.rock_rate(c.rock, mode[2], mode[1] == 0)
        return jnp.where(mode[2] == bit_on_rock.REST, drill, jnp.maximum(drill, rock))


@dataclass(frozen=True)
class CoupledDrilling(Drilling):
    """The drilling scene in which motion of the bit normal to the rock changes the contact force.

    The contact's compression is x2 - delta - (x3 - x4). The drive follows the hole, so the depth does not open
    the gap. This coupling is recommendation 1 of Batako's thesis.
    """

    name = "coupled-drilling"

    def driving_part(self) -> Scene[Any]:
        return self

    def compression(self, c: Any, mode: Values, state: Values) -> tuple[Any, Any]:
        depth, rate = state[4], state[5] * jnp.where(mode[2] == 1, 0.0, 1.0)  # while the rock yields, x3' = x4'
        return state[2] - c.contact.delta - depth, state[3] - rate


SCENES = (Drilling, CoupledDrilling)
