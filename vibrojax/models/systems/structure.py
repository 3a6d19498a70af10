"""Structure of a system that random states reveal: which states its events depend on, and how."""

import math
from typing import Any

import jax.numpy as jnp

from vibrojax.models.systems.events import Impact, Switch
from vibrojax.models.systems.numbers import slope_along
from vibrojax.models.systems.probe import EQUAL, Probe, equal


class Structure(Probe):
    """The checked declaration of a system, with the structure of its events."""

    def surfaces(self) -> set[str]:
        """Return the states whose zeros are those of an event."""
        values = [self._surface(event)[1](self._t, self._y, self._p) for event in self._events]
        return {key for key, y in self._y.items() for value in values if equal(abs(value), abs(y))}

    def switching(self) -> dict[str, list[str]]:
        """Return the states on which the function of each switch depends, by the name of the switch."""

        def changes(event: Switch, name: str) -> bool:
            before, after = (
                event.function(self._t, y, self._p) for y in (self._y, self._y | {name: self._y[name] + 0.1})
            )
            return not equal(before, after)

        switches = [event for event in self._events if isinstance(event, Switch)]
        return {event.name: [name for name in self._y if changes(event, name)] for event in switches}

    def still_stops(self) -> dict[int, float]:
        """Return, for each impact whose gap is a constant plus or minus the position of its velocity, that sign."""
        signs: dict[int, float] = {}
        positions = {speed: key for key, speed in self.velocities().items()}
        for index, event in enumerate(self._events):
            if not isinstance(event, Impact) or event.velocity not in positions:
                continue
            position, gap = positions[event.velocity], event.gap

            def slope(unit: str | None, gap: Any = gap) -> Any:
                directions = [float(key == unit) for key in self._y]
                return slope_along(lambda t, y: gap(t, y, self._p), self._t, self._y, directions, float(unit is None))

            moves = [slope(key) for key in self._y if key != position] + [slope(None)]
            sign = float(jnp.ravel(jnp.asarray(slope(position)))[0])
            linear = bool(equal(slope(position), sign)) and abs(abs(sign) - 1.0) < EQUAL
            if linear and all(bool(equal(x, 0.0)) for x in moves):
                signs[index] = math.copysign(1.0, sign)
        return signs
