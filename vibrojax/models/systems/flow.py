"""The field of a system between events: frictions, sides of switches, sliding, and rest on a stop."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from vibrojax.models.arrays import Array
from vibrojax.models.physics import elementary
from vibrojax.models.scenes.declared import Values
from vibrojax.models.systems.events import Event, Friction, Impact, Switch
from vibrojax.models.systems.numbers import array_of, slope_along, slopes_along

Rates = dict[str, Any]
"""Time derivatives of the states by name."""

States = Mapping[str, Any]
"""The states by name: arrays, Taylor series, dual numbers or rounding errors."""


class SystemConstants(NamedTuple):
    """Constants of a system, each (lanes,).

    - `p`: the parameters by name; `period` [s]: that of the forcing, or None.
    - `typical`: typical magnitudes of the states by name.
    - `rates`: fastest rate of change [1/s] for each combination of the sides of the switches.
    - `lifts`: for each event, the distance by which its surface moves away after a tangential departure.
    - `slow`: for each event, the rate of its function that counts as zero after an impact.
    """

    p: Mapping[str, Any]
    period: Any
    typical: Mapping[str, Any]
    rates: tuple[Any, ...]
    lifts: tuple[Any, ...]
    slow: tuple[Any, ...]


class Motion(NamedTuple):
    """The field at a state in a mode.

    - `rates`: derivatives of the states, with all frictions, and sliding or at rest where the mode says so.
    - `margins`: for each event, a function that is positive while the motion can stay on the event's surface.
    - `pulls`: for each event, a function with the sign of the side to which the field leads.
    """

    rates: Rates
    margins: tuple[Any, ...]
    pulls: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Flow:
    """The functions of a system. All methods take constants, time and states by name, in any number type.

    - `names`: the states; `function`: the user's field, which takes sides if `takes_sides`; `events`: the events.
    - `still`: for each impact whose gap is a position, up to its sign and a constant, that sign (by index).
    - `speeds`: the states that are the rate of change of another state, by the name of that state.
    - `switching`: the states on which the function of each switch depends, by the name of the switch.
    - `rate`: the user's function for the fastest rate of change [1/s], or None.
    """

    names: tuple[str, ...]
    function: Callable[..., Mapping[str, Any]]
    takes_sides: bool
    events: tuple[Event, ...]
    still: Mapping[int, float]
    speeds: Mapping[str, str]
    switching: Mapping[str, Sequence[str]]
    rate: Callable[[Mapping[str, Any]], Any] | None = None

    def of(self, kind: type) -> list[tuple[int, Any]]:
        """Return the events of a kind, with their indices."""
        return [(index, event) for index, event in enumerate(self.events) if isinstance(event, kind)]

    def combinations(self) -> list[tuple[float, ...]]:
        """Return all combinations of the sides of the switches."""
        return list(itertools.product((-1.0, 1.0), repeat=len(self.of(Switch))))

    def field(self, c: SystemConstants, t: Any, y: States, sides: Sequence[Any]) -> Rates:
        """Return the user's field with the switches at `sides`; a number becomes one value per lane."""
        named = {event.name: side for (_, event), side in zip(self.of(Switch), sides, strict=True)}
        rates = self.function(t, y, c.p, named) if self.takes_sides else self.function(t, y, c.p)
        zero = 0.0 * next(iter(y.values()))
        return {name: zero + rates[name] if _is_array(rates[name]) else rates[name] for name in y}

    def plain(self, c: SystemConstants, mode: Values, t: Any, y: States) -> Rates:
        """Return the field without events, from which rates of gaps follow."""
        return self.field(c, t, y, [jnp.sign(mode[index]) for index, _ in self.of(Switch)])

    def slope(self, c: SystemConstants, event: Event, t: Any, y: States, rates: Rates, t_rate: float = 1.0) -> Any:
        """Return the rate of change of an event's function if states change at `rates` and the time at `t_rate`."""
        return slope_along(lambda t, y: event.surface(t, y, c.p), t, y, [rates[name] for name in y], t_rate)

    def closing(self, c: SystemConstants, event: Event, mode: Values, t: Any, y: States) -> Any:
        """Return the rate of change of an event's function in the plain field."""
        return self.slope(c, event, t, y, self.plain(c, mode, t, y))

    def gain(self, c: SystemConstants, index: int, mode: Values, t: Any, y: States) -> Any:
        """Return the change of an impact's closing rate per change of the velocity on which it acts."""
        if index in self.still:
            return self.still[index]
        event: Any = self.events[index]
        unit = [float(name == event.velocity) for name in y]
        return slope_along(lambda t, y: self.closing(c, event, mode, t, y), t, y, unit, 0.0)

    def onto_stop(self, c: SystemConstants, event: Impact, t: Any, y: States) -> Rates:
        """Return the position that closes the gap exactly, by name; empty if no state is the position."""
        for position, speed in self.speeds.items():
            if speed == event.velocity:
                unit = {name: float(name == position) for name in y}
                slope = self.slope(c, event, t, y, unit, 0.0)
                return {position: y[position] - event.surface(t, y, c.p) / slope}
        return {}

    def onto_surface(self, c: SystemConstants, event: Friction | Switch, t: Any, y: States) -> Rates:
        """Return the nearest states on the surface of an event, by name; a friction moves its velocity alone."""
        names = [event.acts_on] if isinstance(event, Friction) else self.switching[event.name]
        value = event.surface(t, y, c.p)
        slopes = {key: self.slope(c, event, t, y, {name: float(name == key) for name in y}, 0.0) for key in names}
        sizes = {key: c.typical[key] if len(names) > 1 else 1.0 for key in names}
        weights = {key: slope * sizes[key] * sizes[key] for key, slope in slopes.items()}
        total = sum(weights[key] * slope for key, slope in slopes.items())
        share = jnp.where(total == 0, 0.0, value / jnp.where(total == 0, 1.0, total))
        return {key: y[key] - weights[key] * share for key in names}

    def at(self, c: SystemConstants, mode: Values, t: Any, y: States) -> Motion:
        """Return the motion in a mode, at a state or at the series of a step."""
        switches = self.of(Switch)
        judged: dict[int, tuple[Any, Any]] = {}
        weights = {index: jnp.sign(mode[index]) for index, _ in switches}
        corners = {sides: self.field(c, t, y, sides) for sides in self.combinations()}

        def blended(fixed: Mapping[int, float]) -> Rates:
            """Return the field, with frictions, at the present shares of the sides or at the `fixed` sides."""
            present = {event.name: fixed.get(index, weights[index]) for index, event in switches}
            total: Rates = {}
            for sides, rates in corners.items():
                shares = [
                    (1.0 + side * weights[index]) * 0.5 if index not in fixed else float(fixed[index] == side)
                    for (index, _), side in zip(switches, sides, strict=True)
                ]
                if all(not isinstance(share, float) or share for share in shares):
                    weight = _product([share for share in shares if not isinstance(share, float)])
                    part = rates if weight is None else {name: weight * rate for name, rate in rates.items()}
                    total = {name: total[name] + part[name] for name in part} if total else part
            return self._with_friction(c, mode, t, y, total, present, judged)

        for index, event in switches:
            low, high = (self.slope(c, event, t, y, blended({index: side})) for side in (-1.0, 1.0))
            slides = 1.0 - weights[index] * weights[index]
            gap = low - high
            gap = gap + jnp.where((slides == 0) | (array_of(gap) == 0), 1.0 - array_of(gap), 0.0)
            judged[index] = (-elementary.maximum(high, -low), high + low)
            # Filippov's share: with this combination of the two fields, the motion stays on the surface.
            weights[index] = weights[index] + slides * ((low + high) / gap)
        rates = blended({})
        for index, event in self.of(Impact):
            rates = self._resting(c, index, event, mode, t, y, rates, judged)
        margins, pulls = zip(*(judged[index] for index in range(len(self.events))), strict=True) if judged else ((), ())
        return Motion(rates, tuple(margins), tuple(pulls))

    def _with_friction(
        self,
        c: SystemConstants,
        mode: Values,
        t: Any,
        y: States,
        rates: Rates,
        sides: Mapping[str, Any],
        judged: dict[int, tuple[Any, Any]],
    ) -> Rates:
        """Return the rates with all frictions; `judged` receives margin and pull of each friction."""
        frictions = self.of(Friction)
        slips = {index: jnp.sign(mode[index]) for index, _ in frictions}
        limits = {index: event.limits(t, y, c.p, sides, slips[index]) for index, event in frictions}
        drags = {index: slips[index] * limits[index][0] for index, _ in frictions}
        total = dict(rates)
        for index, event in frictions:
            # The field with all other frictions; the body sticks where the rest of the field cannot move it.
            free = dict(rates)
            for other, friction in frictions:
                if other != index:
                    free[friction.acts_on] = free[friction.acts_on] - drags[other]
            unit = {name: float(name == event.acts_on) for name in y}
            gain = self.slope(c, event, t, y, unit, 0.0)
            pull = self.slope(c, event, t, y, free)
            judged[index] = (limits[index][1] * abs(gain) - elementary.absolute(pull), pull)
            held = (1.0 - slips[index] * slips[index]) * (pull / gain)
            total[event.acts_on] = total[event.acts_on] - drags[index] - held
        return total

    def _resting(
        self,
        c: SystemConstants,
        index: int,
        event: Impact,
        mode: Values,
        t: Any,
        y: States,
        rates: Rates,
        judged: dict[int, tuple[Any, Any]],
    ) -> Rates:
        """Return the rates where the motion may rest on a stop, with the second derivative of the gap zero."""
        if event.velocity is None:
            zero = 0.0 * next(iter(rates.values()))
            judged[index] = (zero + 1.0, zero)
            return rates
        resting = jnp.where(mode[index] == 1, 1.0, 0.0)
        if index in self.still:
            acceleration = rates[event.velocity]
            judged[index] = ((-self.still[index]) * acceleration, self.still[index] * acceleration)
            return rates | {event.velocity: (1.0 - resting) * acceleration}
        directions = [rates[name] for name in y]
        second = slope_along(lambda t, y: self.closing(c, event, mode, t, y), t, y, directions)
        judged[index] = (-second, second)
        correction = resting * (second / self.gain(c, index, mode, t, y))
        return rates | {event.velocity: rates[event.velocity] - correction}

    def jacobian(self, c: SystemConstants, t: Any, y: States, sides: Sequence[Any]) -> list[list[Any]]:
        """Return the derivatives of the field (rows) with respect to the states (columns)."""

        def rates(t: Any, y: States) -> list[Any]:
            return list(self.field(c, t, y, sides).values())

        columns = [slopes_along(rates, t, y, [float(key == name) for key in y], 0.0) for name in y]
        return [[column[row] for column in columns] for row in range(len(y))]

    def fastest(self, c: SystemConstants, t: Any, y: States) -> tuple[Any, ...]:
        """Return the fastest rate of change [1/s] at a state, for each combination of the sides of the switches."""
        like = 0.0 * next(iter(y.values()))
        if self.rate is not None:
            return tuple(self.rate(c.p) + like for _ in self.combinations())
        return tuple(self._fastest(c, t, y, sides) + like for sides in self.combinations())

    def _fastest(self, c: SystemConstants, t: Any, y: States, sides: Sequence[float]) -> Any:
        n = range(len(y))
        jacobian = [[jnp.abs(x) for x in row] for row in self.jacobian(c, t, y, sides)]
        square = [[sum(jacobian[i][k] * jacobian[k][j] for k in n) for j in n] for i in n]
        # The fourth root of the trace of the fourth power of |J| bounds the spectral radius, whatever the units.
        radius = jnp.sqrt(jnp.sqrt(sum(square[i][k] * square[k][i] for i in n for k in n)))
        if c.period is not None:
            return jnp.maximum(radius, 2 * jnp.pi / c.period)
        # Without a linear part, as in free fall: the second derivative of each state relative to the state.
        first = [jnp.abs(rate) for rate in self.field(c, t, y, sides).values()]
        bends = [sum(jacobian[i][k] * first[k] for k in n) / jnp.abs(x) for i, x in enumerate(y.values())]
        fall = jnp.sqrt(sum(jnp.where(jnp.isfinite(bend), bend, 0.0) for bend in bends))
        return jnp.where(radius > 0, radius, jnp.where(fall > 0, fall, 1.0))


def _product(factors: Sequence[Any]) -> Any:
    """Return the product of the factors, or None if there are none."""
    product = None
    for factor in factors:
        product = factor if product is None else product * factor
    return product


def _is_array(x: Any) -> bool:
    """Return whether a number is an array or a Python number, not a series, dual number or rounding error."""
    return isinstance(x, int | float | Array) or not hasattr(x, "value")
