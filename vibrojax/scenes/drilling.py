"""The drilling scene: the blows of the vibro-impact drill drive the rock, one way, as in the source."""

from dataclasses import dataclass

from vibrojax.scenes._drill_on_rock import DrillOnRock


@dataclass(frozen=True)
class Drilling(DrillOnRock):
    """The rock does not act back: the contact is that of the vibro-impact scene."""

    name = "drilling"

    def indentation(self, p, rock, state):
        return 0.0, 0.0


SCENE = Drilling
