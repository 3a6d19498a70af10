"""Structure of a system that random states reveal: kinks of its functions, and what each event depends on."""

import itertools
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from vibrojax.lazy import lax
from vibrojax.systems.events import Event, Friction, Impact, Switch, required_arguments
from vibrojax.systems.flow import Dependences
from vibrojax.systems.kinks import Function, Kink
from vibrojax.systems.numbers import Dual, Plain, array_of, slope_along
from vibrojax.systems.probe import EQUAL, Probe, equal

MOVED = 0.1
"""Change of a state that shows whether a function depends on it; random states are of order one."""


class Structure(Probe):
    """The checked declaration of a system, with the structure of its events.

    - `function`, `surface_functions`, `limits`: the field, the functions of the events, and those of frictions by
      index; `kinks`: the kinks of all of them.
    """

    def __init__(self, *declaration: Any) -> None:
        super().__init__(*declaration)
        self.kinks: list[Kink] = []
        sided = [self._sides] if self.takes_sides else []
        field, still = self._with_discrete(self._field, self.takes_sides), dict.fromkeys(self._discrete, 0.0)
        self.function = self._with_kinks("field", lambda *arguments: {**field(*arguments), **still}, sided)
        self.surface_functions = tuple(self._with_kinks(*self._surface(event), []) for event in self._events)
        ones = Plain.of(np.ones(len(self._t)))
        self.limits = {
            index: self._with_kinks(f"event {event.name}: normal", self._limits_of(event), [self._sides, ones])
            for index, event in enumerate(self._events)
            if isinstance(event, Friction)
        }
        self.resets = {
            index: self._with_discrete(event.reset, required_arguments(event.reset) == 4)
            for index, event in enumerate(self._events)
            if isinstance(event, Impact) and event.reset is not None
        }

    def _with_discrete(self, function: Callable[..., Any], takes_sides: bool) -> Callable[..., Any]:
        """Return a function of all states, with the discrete ones among the sides that it takes."""

        def call(t: Any, y: Mapping[str, Any], p: Mapping[str, Any], sides: Mapping[str, Any] | None = None) -> Any:
            return function(t, y, p, *([self._all_sides(sides or {}, y)] if takes_sides else []))

        return call

    def _all_sides(self, sides: Mapping[str, Any], y: Mapping[str, Any]) -> dict[str, Any]:
        """Return the sides of switches, and the discrete states without their derivatives."""
        return {**sides, **{name: lax.stop_gradient(array_of(y[name])) for name in self._discrete if name in y}}

    def _limits_of(self, event: Friction) -> Callable[..., Any]:
        """Return the function of a friction's limits, with the arguments in the order of `Function.run`."""
        return lambda t, y, p, sides, slip: event.limits(t, y, p, self._all_sides(sides, y), slip)

    def _with_kinks(self, place: str, function: Callable[..., Any], more: list[Any]) -> Function:
        rng = np.random.default_rng(11)
        t = Dual(self._t, Plain.of(rng.uniform(0.5, 1.5, len(self._t))), 1)
        y = {key: Dual(x, Plain.of(rng.uniform(0.5, 1.5, len(x))), 1) for key, x in self._y.items()}
        plain, numbers = Function(function, {}), {}
        kinks = plain.found(t, y, self._p, *more)
        others = [self._sides | {name: -side} for name, side in self._sides.items()] if kinks and more else []
        turned = [plain.found(t, y, self._p, sides, *more[1:]) for sides in others]
        for number, (kind, _) in kinks.items():
            if kind == "floor" and not self._same_floor(plain, number, t, y, more):
                raise self._refuse(f"{place} takes the floor of a value that depends on states; write a vj.Impact")
            friction = next((event for event in self._events if place == f"event {event.name}: normal"), None)
            ends = kind == "positive" and isinstance(friction, Friction) and not friction.lift_off
            numbers[number] = len(self.kinks)
            sided = any(not equal(kinks[number][1], other[number][1]) for other in turned if number in other)
            self.kinks.append(Kink(f"kink_{len(self.kinks) + 1}", place, kind == "floor", ends, sided))
        return Function(function, numbers)

    def _same_floor(self, function: Function, number: int, t: Dual, y: Mapping[str, Any], more: list[Any]) -> bool:
        """Return whether the argument of a `floor` depends on the time alone."""
        moved = {key: Dual(x.value + MOVED, x.slope, 1) for key, x in y.items()}
        values = [function.found(t, states, self._p, *more)[number][1] for states in (y, moved)]
        return equal(*values)

    def events_at(self, section: Callable[..., Any]) -> dict[int, float]:
        """Return the switches and frictions whose surface is a section, by index, with the sign of their functions.

        The sign is that above the section, on which the function `section(t, y, p)` is zero.
        """
        above, kinks = section(self._t, self._y, self._p), {}
        for index, event in enumerate(self._events):
            if not isinstance(event, Impact) and _proportional(value := self._value(event), above):
                kinks[index] = float(np.sign(np.ravel(value / above)[0]))
        return kinks

    def depends_on_time(self) -> bool:
        """Return whether the field or an event depends on the time."""
        return not self._same(self._t, self._t + 0.37)

    def _value(self, event: Event) -> Any:
        return event.surface(self._t, self._y, self._p)

    def surfaces(self) -> set[str]:
        """Return the states whose zeros are those of an event."""
        values = [abs(self._value(event)) for event in self._events]
        return {key for key, y in self._y.items() for value in values if equal(value, abs(y))}

    def dependences(self) -> Dependences:
        """Return how the functions depend on one another; refuse events that share a surface."""
        speeds, events = self.velocities(), dict(enumerate(self._events))
        depends = {i: self._depends(partial(self._kept, event)) for i, event in events.items()}
        self._check_surfaces()
        moves = {i: self._moves(event) for i, event in events.items()}
        held = [i for i, event in events.items() if not isinstance(event, Impact) or event.velocity is not None]
        floors = any(kink.whole for kink in self.kinks)
        return Dependences(
            still=self._still_stops(speeds),
            speeds=speeds,
            switching={
                event.name: sorted(depends[i], key=list(self._y).index)
                for i, event in events.items()
                if isinstance(event, Switch)
            },
            parallel={i: [j for j in held if j != i and self._are_parallel(events[i], events[j])] for i in held},
            coupled=frozenset((i, j) for i in held for j in held if i != j and depends[i] & moves[j]),
            jumping=frozenset(
                i
                for i, event in events.items()
                if floors or any(depends[i] & self._jumped(other) for other in events.values() if other is not event)
            ),
            mixing=self._mixing(),
            linear=self._linear(),
        )

    def _depends(self, function: Callable[[Mapping[str, Any]], Any]) -> set[str]:
        """Return the states on which a function of the states depends."""
        before = function(self._y)
        return {name for name, x in self._y.items() if not equal(before, function(self._y | {name: x + MOVED}))}

    def _kept(self, event: Event, y: Mapping[str, Any]) -> Any:
        """Return what the constraint of an event keeps at zero: its function, of a stop with its rate."""
        value = event.surface(self._t, y, self._p)
        if not isinstance(event, Impact):
            return value
        rates = self.rates(self._t, y)
        rate = slope_along(lambda t, y: event.surface(t, y, self._p), self._t, y, [rates[name] for name in y])
        return np.concatenate([np.ravel(value + 0.0 * self._t), np.ravel(rate + 0.0 * self._t)])

    def _moves(self, event: Event) -> set[str]:
        """Return the states that the constraint of an event changes."""
        moved = {name for name, x in self._direction(event).items() if not equal(x, 0.0)}
        if isinstance(event, Switch):
            moved |= {other.acts_on for other in self._events if isinstance(other, Friction) and other.takes_sides}
        return moved

    def _are_parallel(self, first: Event, second: Event) -> bool:
        """Return whether the constraints of two events act along the same direction at all random states."""
        a, b = self._direction(first), self._direction(second)
        products = [(a[i] * b[j], a[j] * b[i]) for i, j in itertools.combinations(self._y, 2)]
        return all(equal(*pair) for pair in products) and any(not equal(a[name] * b[name], 0.0) for name in self._y)

    def _direction(self, event: Event) -> dict[str, Any]:
        """Return the direction along which the constraint of an event acts, by name of the states."""
        if isinstance(event, Switch):
            high, low = (self._rates_at({event.name: side}) for side in (1.0, -1.0))
            return {name: high[name] - low[name] for name in self._y}
        return {name: float(name == event.acts_on) + 0.0 * x for name, x in self._y.items()}

    def _jumped(self, event: Event) -> set[str]:
        """Return the states that the jump of an event changes."""
        if not isinstance(event, Impact):
            return set()
        if event.velocity is not None:
            return {event.velocity}
        assert event.reset is not None
        sided = [self._sides] if required_arguments(event.reset) == 4 else []
        return set(event.reset(self._t, self._y, self._p, *sided))

    def _rates_at(self, sides: Mapping[str, float], y: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the field with some switches at `sides` and the others on the positive side."""
        before, self._sides = self._sides, self._sides | dict(sides)
        try:
            return self.rates(self._t, self._y if y is None else y)
        finally:
            self._sides = before

    def _mixing(self) -> tuple[tuple[int, int], ...]:
        """Return the pairs of switches, by index, whose sides do not act on the field independently."""
        switches = [(i, event.name) for i, event in enumerate(self._events) if isinstance(event, Switch)]
        pairs = []
        for (i, first), (j, second) in itertools.combinations(switches, 2):
            corners = {(a, b): self._rates_at({first: a, second: b}) for a in (1.0, -1.0) for b in (1.0, -1.0)}
            if not all(
                equal(
                    corners[1.0, 1.0][key] + corners[-1.0, -1.0][key], corners[1.0, -1.0][key] + corners[-1.0, 1.0][key]
                )
                for key in self._y
            ):
                pairs.append((i, j))
        return tuple(pairs)

    def _linear(self) -> bool:
        """Return whether the field is linear in the states on each side and friction coefficients are constant."""
        for event in self._events:
            if isinstance(event, Friction):
                for speed in (0.0, 0.3):  # a steep law is flat at most speeds
                    coefficient = event.coefficient(Dual(Plain.of(speed), 1.0, 1), self._p)
                    if isinstance(coefficient, Dual) and bool(np.any(np.asarray(coefficient.slope) != 0)):
                        return False
        moved = {key: x + MOVED * (2 + k) for k, (key, x) in enumerate(self._y.items())}
        middle = {key: 0.5 * (x + moved[key]) for key, x in self._y.items()}
        names = list(self._sides)
        for side in (1.0, -1.0) if names else (1.0,):
            first, second, half = (self._rates_at(dict.fromkeys(names, side), y) for y in (self._y, moved, middle))
            if not all(equal(0.5 * (first[key] + second[key]), half[key]) for key in self._y):
                return False
        return True

    def _check_surfaces(self) -> None:
        """Refuse two switches or frictions with one surface: neither decides alone on which side the motion is."""
        held = [event for event in self._events if not isinstance(event, Impact)]
        for first, second in itertools.combinations(held, 2):
            if _proportional(self._value(first), self._value(second)):
                advice = {
                    (Switch, Switch): "use one of them, whose sides are those of the other, up to the sign",
                    (Friction, Friction): "write one friction with the sum of both forces",
                }.get((type(first), type(second)), "write the difference of the directions into the friction's law")
                raise self._refuse(f"{first.name} and {second.name} have the same surface; {advice}")

    def _still_stops(self, speeds: Mapping[str, str]) -> dict[int, float]:
        """Return, for each impact whose gap is a constant plus or minus the position of its velocity, that sign."""
        signs: dict[int, float] = {}
        positions = {speed: key for key, speed in speeds.items()}
        for index, event in enumerate(self._events):
            if not isinstance(event, Impact) or event.velocity not in positions:
                continue
            position, gap = positions[event.velocity], event.gap

            def slope(unit: str | None, gap: Any = gap) -> Any:
                directions = [float(key == unit) for key in self._y]
                return slope_along(lambda t, y: gap(t, y, self._p), self._t, self._y, directions, float(unit is None))

            moves = [slope(key) for key in self._y if key != position] + [slope(None)]
            sign = float(np.ravel(slope(position))[0])
            linear = bool(equal(slope(position), sign)) and abs(abs(sign) - 1.0) < EQUAL
            if linear and all(bool(equal(x, 0.0)) for x in moves):
                signs[index] = math.copysign(1.0, sign)
        return signs


def _proportional(a: Any, b: Any) -> bool:
    """Return whether two functions have the same ratio at all random states."""
    with np.errstate(all="ignore"):
        ratio = np.atleast_1d(np.asarray(a) / np.asarray(b))
    return bool(np.isfinite(ratio).all()) and len(ratio) > 1 and equal(ratio, ratio[0])
