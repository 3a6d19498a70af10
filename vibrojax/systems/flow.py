"""The field of a system between events: frictions, sides of switches, sliding, and rest on a stop.

A motion that slides on the surface of a switch, sticks under friction or rests on a stop is held by a constraint. Each
constraint acts along one direction of the state space with an unknown multiplier: half the difference of the fields of
both sides, the velocity on which a friction acts, or that which a stop reverses. The multipliers of all constraints
that hold at once follow from one linear system, so that constraints may influence one another.
"""

import itertools
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array
from vibrojax.scenes.declared import Values
from vibrojax.systems.constraints import Constraint, Rates, solved
from vibrojax.systems.events import Event, Friction, Impact, Switch
from vibrojax.systems.kinks import Function, Kink
from vibrojax.systems.numbers import slope_along, slopes_along

States = Mapping[str, Any]
"""The states by name: arrays, Taylor series, dual numbers or rounding errors."""


class SystemConstants(NamedTuple):
    """Constants of a system, each (lanes,).

    - `p`: the parameters by name; `period` [s]: that of the forcing, or None.
    - `typical`: typical magnitudes of the states by name.
    - `rates`: fastest rate of change [1/s] for each combination of the sides of the switches.
    - `lifts`: for each event and kink, the distance by which its surface moves away after a tangential departure.
    - `slow`: for each event, the rate of its function that counts as zero after an impact.
    - `holds`: for each event, the magnitude of the function that is positive while the motion can stay on its surface.
    """

    p: Mapping[str, Any]
    period: Any
    typical: Mapping[str, Any]
    rates: tuple[Any, ...]
    lifts: tuple[Any, ...]
    slow: tuple[Any, ...]
    holds: tuple[Any, ...]


class Motion(NamedTuple):
    """The field at a state in a mode.

    - `rates`: derivatives of the states, with all frictions, and sliding or at rest where the mode says so.
    - `margins`: for each event, a function that is positive while the motion can stay on the event's surface.
    - `pulls`: for each event, a function with the sign of the side to which the field leads.
    - `surfaces`: values of the functions of events and of the kinks after them.
    """

    rates: Rates
    margins: tuple[Any, ...]
    pulls: tuple[Any, ...]
    surfaces: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Dependences:
    """Dependences between the functions of a system, as random states reveal them.

    - `still`: for each impact whose gap is a position, up to its sign and a constant, that sign (by index).
    - `speeds`: the states that are the rate of change of another state, by the name of that state.
    - `switching`: the states on which the function of each switch depends, by the name of the switch.
    - `coupled`: pairs of indices of events; the constraint of the second changes what the first keeps at zero.
    - `parallel`: for each event, those whose constraints act along the same direction; only one of them can hold.
    - `jumping`: the events on whose other side a jump may put the state.
    - `mixing`: pairs of switches whose sides do not act on the field independently of each other.
    - `linear`: True if the field is linear in the states on each side, and friction coefficients are constant.
    """

    still: Mapping[int, float]
    speeds: Mapping[str, str]
    switching: Mapping[str, Sequence[str]]
    coupled: frozenset[tuple[int, int]]
    parallel: Mapping[int, Sequence[int]]
    jumping: frozenset[int]
    mixing: tuple[tuple[int, int], ...]
    linear: bool


@dataclass(frozen=True, eq=False)
class Flow:
    """The functions of a system. All methods take constants, time and states by name, in any number type.

    - `names`: the states, with discrete ones, which change at events only; `function`: the user's field.
    - `events`: the events; `kinks`: kinks of all functions.
    - `surfaces`: functions of the events; `limits`, by index: friction and stick limits; `resets`: jumps.
    - `takes_sides`: True if the field takes the sides of switches.
    - `rate`: the user's function for the fastest rate of change [1/s], or None.
    """

    names: tuple[str, ...]
    function: Function
    takes_sides: bool
    events: tuple[Event, ...]
    surfaces: tuple[Function, ...]
    limits: Mapping[int, Function]
    resets: Mapping[int, Callable[..., Mapping[str, Any]]]
    kinks: tuple[Kink, ...]
    structure: Dependences
    rate: Callable[[Mapping[str, Any]], Any] | None = None

    def of(self, kind: type) -> list[tuple[int, Any]]:
        """Return the events of a kind, with their indices."""
        return [(index, event) for index, event in enumerate(self.events) if isinstance(event, kind)]

    def beside(self, index: int) -> list[int]:
        """Return the frictions and switches whose forces decide whether a friction or a switch can hold a motion."""
        if isinstance(self.events[index], Impact):
            return []
        coupled, parallel = self.structure.coupled, self.structure.parallel[index]
        acting = [other for other in range(len(self.events)) if (index, other) in coupled or other in parallel]
        return [other for other in acting if other != index and not isinstance(self.events[other], Impact)]

    def combinations(self) -> list[tuple[float, ...]]:
        """Return all combinations of the sides of the switches."""
        return list(itertools.product((-1.0, 1.0), repeat=len(self.of(Switch))))

    def branches(self, mode: Values) -> Values:
        """Return the parts of the kinks that are in use, from the modes."""
        return mode[len(self.events) : len(self.events) + len(self.kinks)]

    def field(self, c: SystemConstants, mode: Values, t: Any, y: States, sides: Sequence[Any]) -> Rates:
        """Return the user's field with the switches at `sides`; a number becomes one value per lane."""
        rates = self.function.at(self.branches(mode), sides, t, y, c.p, *self._sided(sides))
        zero = 0.0 * next(iter(y.values()))
        return {name: zero + rates[name] if _is_array(rates[name]) else rates[name] for name in y}

    def sides_of(self, mode: Values) -> dict[str, Any]:
        """Return the sides of the switches by name."""
        return self._named(self._all_signs(mode))

    def _sided(self, sides: Sequence[Any]) -> list[dict[str, Any]]:
        """Return the field's fourth argument, if it takes one."""
        return [self._named(sides)] if self.takes_sides else []

    def _named(self, sides: Sequence[Any]) -> dict[str, Any]:
        return {event.name: side for (_, event), side in zip(self.of(Switch), sides, strict=True)}

    def kink_values(self, c: SystemConstants, mode: Values, t: Any, y: States) -> list[Any]:
        """Return the functions whose zeros are the kinks, in their order."""
        zero, values = 0.0 * next(iter(y.values())), dict[int, Any]()
        for sides in self.combinations():
            calls: list[tuple[Function, list[Any]]] = [(self.function, self._sided(sides))]
            calls += [(function, []) for function in self.surfaces]
            calls += [(limit, [self._named(sides), jnp.sign(mode[index])]) for index, limit in self.limits.items()]
            for function, more in calls:
                own = {number: kinks[sides] for number, kinks in function.kinks.items()}
                if not set(own.values()) <= set(values):
                    _, found = function.run(self.branches(mode), sides, t, y, c.p, *more)
                    # A force may depend on sides and parameters alone.
                    values |= {own[number]: zero + x if _is_array(x) else x for number, x in found.items()}
        return [values[index] for index in range(len(self.kinks))]

    def in_use(self, mode: Values, kink: Kink) -> Any:
        """Return a mask of lanes in which functions use a kink; a motion on a surface is on both sides."""
        signs = list(self._signs(mode, Switch).values())
        corners = [[own * side >= 0 for own, side in zip(signs, sides, strict=True)] for sides in kink.sides]
        return reduce(operator.or_, [reduce(operator.and_, here, mode[0] == mode[0]) for here in corners])

    def surface(self, c: SystemConstants, mode: Values, index: int, t: Any, y: States) -> Any:
        """Return the value of an event's function."""
        return self.surfaces[index].at(self.branches(mode), self._all_signs(mode), t, y, c.p)

    def plain(self, c: SystemConstants, mode: Values, t: Any, y: States) -> Rates:
        """Return the field without events, from which rates of gaps follow."""
        return self.field(c, mode, t, y, self._all_signs(mode))

    def slope(
        self, c: SystemConstants, mode: Values, index: int, t: Any, y: States, rates: Rates, t_rate: float = 1.0
    ) -> Any:
        """Return the rate of change of an event's function if states change at `rates` and the time at `t_rate`."""
        directions = [rates.get(name, 0.0) for name in y]
        return slope_along(lambda t, y: self.surface(c, mode, index, t, y), t, y, directions, t_rate)

    def closing(self, c: SystemConstants, mode: Values, index: int, t: Any, y: States) -> Any:
        """Return the rate of change of an event's function in the plain field."""
        return self.slope(c, mode, index, t, y, self.plain(c, mode, t, y))

    def gain(self, c: SystemConstants, mode: Values, index: int, t: Any, y: States) -> Any:
        """Return the change of an impact's closing rate per change of the velocity on which it acts."""
        event: Any = self.events[index]
        return self._effect(c, mode, index, t, y, {event.velocity: 1.0}, 0.0)

    def onto_stop(self, c: SystemConstants, mode: Values, index: int, t: Any, y: States) -> Rates:
        """Return the position that closes the gap exactly, by name; empty if no state is the position."""
        for position, speed in self.structure.speeds.items():
            if speed == self.events[index].velocity:  # type: ignore[union-attr]
                slope = self.slope(c, mode, index, t, y, {position: 1.0}, 0.0)
                return {position: y[position] - self.surface(c, mode, index, t, y) / slope}
        return {}

    def onto_surface(self, c: SystemConstants, mode: Values, index: int, t: Any, y: States) -> Rates:
        """Return the nearest states on the surface of an event, by name; a friction moves its velocity alone."""
        event = self.events[index]
        names = [event.acts_on] if isinstance(event, Friction) else self.structure.switching[event.name]
        value = self.surface(c, mode, index, t, y)
        slopes = {key: self.slope(c, mode, index, t, y, {key: 1.0}, 0.0) for key in names}
        sizes = {key: c.typical[key] if len(names) > 1 else 1.0 for key in names}
        return onto_zero(value, slopes, {key: slope * sizes[key] * sizes[key] for key, slope in slopes.items()}, y)

    def at(self, c: SystemConstants, mode: Values, t: Any, y: States) -> Motion:
        """Return the motion in a mode, at a state or at the series of a step."""
        corners = {sides: self._corner(c, mode, t, y, sides) for sides in self.combinations()}
        signs = self._signs(mode, Switch) | self._signs(mode, Friction)
        rates, holds = self._mixed(c, mode, t, y, corners, {})
        constraints: dict[int, Constraint] = {}
        sided: dict[int, dict[int, Any]] = {}
        for index, event in (*self.of(Switch), *self.of(Friction), *self.of(Impact)):
            if isinstance(event, Switch):
                (low, least), (high, most) = (self._mixed(c, mode, t, y, corners, {index: x}) for x in (-1.0, 1.0))
                along = {name: 0.5 * (high[name] - low[name]) for name in rates}
                sided[index] = {i: 0.5 * (most[i] - least[i]) for i, e in self.of(Friction) if e.takes_sides}
            else:
                along = {event.acts_on: 1.0}
            if None not in along:  # a reset cannot hold the motion
                drift = self._effect(c, mode, index, t, y, rates)
                gain = self._effect(c, mode, index, t, y, along, 0.0)
                free = signs.get(index)
                held = jnp.where(mode[index] == 1, 1.0, 0.0) if free is None else 1.0 - free * free
                constraints[index] = Constraint(held, along, drift, gain)

        def effect(index: int, other: int) -> Any:
            return self._effect(c, mode, index, t, y, constraints[other].along, 0.0)

        multipliers, drifts = solved(constraints, self.structure.coupled, effect)
        for index, own in constraints.items():
            for name, direction in own.along.items():
                rates[name] = rates[name] + multipliers[index] * direction
            for friction, change in sided.get(index, {}).items():
                holds[friction] = holds[friction] + multipliers[index] * change
        margins, pulls = [], []
        for index, event in enumerate(self.events):
            zero = 0.0 * next(iter(rates.values()))
            margin, pull = zero + 1.0, drifts.get(index, zero)
            if isinstance(event, Switch):
                gain = constraints[index].gain
                margin = -(gain * abs(gain)) - pull * pull
            elif isinstance(event, Friction):
                # The margin is that of the field without this friction, for a body that slides or sticks.
                bears, gain = holds[index], constraints[index].gain
                margin = (bears * abs(bears)) * (gain * gain) - pull * pull
            elif index in constraints:
                margin = -pull
            margins.append(margin)
            pulls.append(pull)
        return Motion(rates, tuple(margins), tuple(pulls), self.values(c, mode, t, y))

    def values(self, c: SystemConstants, mode: Values, t: Any, y: States) -> tuple[Any, ...]:
        """Return the values of the functions of events, and of the kinks after them."""
        values = [self.surface(c, mode, index, t, y) for index in range(len(self.events))]
        return (*values, *(self.kink_values(c, mode, t, y) if self.kinks else ()))

    def _signs(self, mode: Values, kind: type) -> dict[int, Any]:
        """Return the signs of the modes of events of a kind: 0 on the surface."""
        return {index: jnp.sign(mode[index]) for index, _ in self.of(kind)}

    def _all_signs(self, mode: Values) -> list[Any]:
        """Return the sides of all switches, 0 on the surface."""
        return list(self._signs(mode, Switch).values())

    def _limit(self, c: SystemConstants, mode: Values, index: int, t: Any, y: States, sides: Sequence[Any]) -> Any:
        """Return the deceleration of a sliding body by a friction, and the one that a sticking body can bear."""
        slip, named = jnp.sign(mode[index]), self._named(sides)
        return self.limits[index].at(self.branches(mode), sides, t, y, c.p, named, slip)

    def _corner(self, c: SystemConstants, mode: Values, t: Any, y: States, sides: Sequence[Any]) -> dict[Any, Any]:
        """Return the field at sides of the switches by name, and the decelerations that sticking bodies bear by index.

        Only frictions whose normal forces depend on sides are part of them.
        """
        rates: dict[Any, Any] = dict(self.field(c, mode, t, y, sides))
        for index, event in self.of(Friction):
            if event.takes_sides:
                drag, rates[index] = self._limit(c, mode, index, t, y, sides)
                rates[event.acts_on] = rates[event.acts_on] - jnp.sign(mode[index]) * drag
        return rates

    def _mixed(
        self,
        c: SystemConstants,
        mode: Values,
        t: Any,
        y: States,
        corners: Mapping[tuple[float, ...], dict[Any, Any]],
        fixed: Mapping[int, float],
    ) -> tuple[Rates, dict[int, Any]]:
        """Return the field with the frictions of sliding bodies, and the decelerations that bodies that stick can bear.

        The sides of switches are `fixed`, or follow from the mode: on a surface, the mean of both sides counts.
        `corners`: field and decelerations at all combinations of sides.
        """
        switches, own = self.of(Switch), self._signs(mode, Switch)
        total: dict[Any, Any] = {}
        for sides, rates in corners.items():
            shares = [
                (1.0 + side * own[index]) * 0.5 if index not in fixed else float(fixed[index] == side)
                for (index, _), side in zip(switches, sides, strict=True)
            ]
            if all(not isinstance(share, float) or share for share in shares):
                varying = [share for share in shares if not isinstance(share, float)]
                weight = reduce(operator.mul, varying) if varying else None
                part = rates if weight is None else {name: weight * rate for name, rate in rates.items()}
                total = {name: total[name] + part[name] for name in part} if total else dict(part)
        holds = {}
        for index, event in self.of(Friction):
            if event.takes_sides:
                holds[index] = total.pop(index)
            else:
                drag, holds[index] = self._limit(c, mode, index, t, y, self._all_signs(mode))
                total[event.acts_on] = total[event.acts_on] - jnp.sign(mode[index]) * drag
        return total, holds

    def _effect(
        self, c: SystemConstants, mode: Values, index: int, t: Any, y: States, rates: Rates, t_rate: float = 1.0
    ) -> Any:
        """Return the change of what the constraint of an event keeps at zero, if states change at `rates`."""
        event = self.events[index]
        if not isinstance(event, Impact):
            return self.slope(c, mode, index, t, y, rates, t_rate)
        if index in self.structure.still:
            return self.structure.still[index] * rates.get(str(event.velocity), 0.0)
        directions = [rates.get(name, 0.0) for name in y]
        return slope_along(lambda t, y: self.closing(c, mode, index, t, y), t, y, directions, t_rate)

    def fastest(self, c: SystemConstants, mode: Values, t: Any, y: States) -> tuple[Any, ...]:
        """Return the fastest rate of change of the field [1/s], for each combination of the sides of the switches."""
        like = 0.0 * next(iter(y.values()))
        if self.rate is not None:
            return tuple(self.rate(c.p) + like for _ in self.combinations())
        fields = [lambda t, y, sides=sides: self.field(c, mode, t, y, sides) for sides in self.combinations()]
        return tuple(self._fastest(c, field, t, y) + like for field in fields)

    def quickest(self, c: SystemConstants, mode: Values, t: Any, y: States) -> Any:
        """Return the fastest rate of change [1/s] in a mode at a state, with the slopes of friction laws."""
        switches, slips = self.of(Switch), self._signs(mode, Friction)
        result = None
        # On a surface, the sides are both.
        for other in (-1.0, 1.0) if switches else (1.0,):
            sides = [jnp.where(mode[index] == 0, other, jnp.sign(mode[index])) for index, _ in switches]

            def field(t: Any, y: States, sides: Any = sides) -> Rates:
                rates = self.field(c, mode, t, y, sides)
                for index, event in self.of(Friction):
                    drag, _ = self._limit(c, mode, index, t, y, sides)
                    rates[event.acts_on] = rates[event.acts_on] - slips[index] * drag
                return rates

            rate = self._fastest(c, field, t, y)
            result = rate if result is None else jnp.maximum(result, rate)
        return result

    def jacobian(self, field: Callable[[Any, States], Rates], t: Any, y: States) -> list[list[Any]]:
        """Return the derivatives of a field (rows) with respect to the states (columns)."""

        def rates(t: Any, y: States) -> list[Any]:
            return list(field(t, y).values())

        columns = [slopes_along(rates, t, y, [float(key == name) for key in y], 0.0) for name in y]
        return [[column[row] for column in columns] for row in range(len(y))]

    def _fastest(self, c: SystemConstants, field: Callable[[Any, States], Rates], t: Any, y: States) -> Any:
        n = range(len(y))
        jacobian = [[jnp.abs(x) for x in row] for row in self.jacobian(field, t, y)]
        square = [[sum(jacobian[i][k] * jacobian[k][j] for k in n) for j in n] for i in n]
        # The fourth root of the trace of the fourth power of |J| bounds the spectral radius, whatever the units.
        radius = jnp.sqrt(jnp.sqrt(sum(square[i][k] * square[k][i] for i in n for k in n)))
        # There is no derivative where a root is zero.
        radius = jnp.where(jnp.isfinite(radius), radius, 0.0)
        if c.period is not None:
            return jnp.maximum(radius, 2 * jnp.pi / c.period)
        # Without a linear part, as in free fall: the second derivative of each state relative to the state.
        first = [jnp.abs(rate) for rate in field(t, y).values()]
        bends = [sum(jacobian[i][k] * first[k] for k in n) / jnp.abs(x) for i, x in enumerate(y.values())]
        fall = jnp.sqrt(sum(jnp.where(jnp.isfinite(bend), bend, 0.0) for bend in bends))
        return jnp.where(radius > 0, radius, jnp.where(fall > 0, fall, 1.0))


def onto_zero(value: Any, slopes: Mapping[str, Any], weights: Mapping[str, Any], y: States) -> Rates:
    """Return the states, moved in proportion to `weights`, at which a function with this value and slopes is zero."""
    total = sum(weights[key] * slope for key, slope in slopes.items())
    share = jnp.where(total == 0, 0.0, value / jnp.where(total == 0, 1.0, total))
    return {key: y[key] - weight * share for key, weight in weights.items()}


def _is_array(x: Any) -> bool:
    """Return whether a number is an array or a Python number, not a series, dual number or rounding error."""
    return isinstance(x, int | float | Array) or not hasattr(x, "value")
