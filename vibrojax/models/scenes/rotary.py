"""The rotary scene: bit and striker on their springs, stick-slip friction, no impact."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from vibrojax.models.physics.parameters import BIT_AND_STRIKER, Parameter
from vibrojax.models.scenes.declared import Guard, Start, Values
from vibrojax.models.scenes.drill import Drill, DrillConstants, drill_constants, two_masses_start


class RotaryConstants(NamedTuple):
    """The constants of the scene: those of the two masses."""

    drill: DrillConstants


@dataclass(frozen=True)
class Rotary(Drill[RotaryConstants]):
    """Bit and striker on their springs, stick-slip friction, no impact.

    m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u); m2 x2'' = -c2 x2' - k2 (x2 - x1)
    """

    name = "rotary"
    measures = ("swings", "shares", "harmonics")

    def parameters(self) -> Mapping[str, Parameter]:
        return BIT_AND_STRIKER | dict(self.friction.parameters)

    def constants(self, p: Mapping[str, Any]) -> RotaryConstants:
        return RotaryConstants(drill_constants(p, self.friction))

    def start(self, c: RotaryConstants, name: Start, shape: tuple[int, ...]) -> Values:
        return two_masses_start(c.drill, name, shape)

    def rate(self, c: RotaryConstants, mode: Values) -> Any:
        return self.flight_rate(c)

    def impact(self, c: RotaryConstants, mode: Values, state: Values) -> None:
        return None

    def impact_noise(self, c: RotaryConstants, mode: Values) -> float:
        return 0.0

    def stored(self, c: RotaryConstants, state: Values) -> float:
        return 0.0

    def other_modes_at(self, c: RotaryConstants, state: Values) -> Values:
        return ()

    def other_rates(self, c: RotaryConstants, mode: Values, state: Values, impact: Any) -> Values:
        return ()

    def other_guards(self) -> tuple[Guard, ...]:
        return ()

    def other_reset(
        self, c: RotaryConstants, mode: Values, state: Values, hits: Mapping[str, Any]
    ) -> tuple[Values, Values]:
        return mode, state


SCENES = (Rotary,)
