"""The rotary scene: bit and striker on their springs, with stick-slip friction and without impact."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from vibrojax.models.physics.parameters import BIT_AND_STRIKER, Parameter
from vibrojax.models.scenes.declared import Values
from vibrojax.models.scenes.drill import Drill, DrillConstants, drill_constants


class RotaryConstants(NamedTuple):
    """Constants of the two masses."""

    drill: DrillConstants


@dataclass(frozen=True)
class Rotary(Drill[RotaryConstants]):
    """Bit and striker on their springs, with stick-slip friction and without impact.

    m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u); m2 x2'' = -c2 x2' - k2 (x2 - x1)
    """

    name = "rotary"
    measures = ("swings", "shares", "harmonics")

    def parameters(self) -> Mapping[str, Parameter]:
        return BIT_AND_STRIKER | dict(self.friction.parameters)

    def constants(self, p: Mapping[str, Any]) -> RotaryConstants:
        return RotaryConstants(drill_constants(p, self.friction))

    def rate(self, c: RotaryConstants, mode: Values) -> Any:
        return self.flight_rate(c)


SCENES = (Rotary,)
