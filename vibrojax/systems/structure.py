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
from vibrojax.systems.numbers import EQUAL, Degree, Dual, Plain, array_of, equal, slope_along
from vibrojax.systems.probe import LANES, REPEATED, ROUNDED, Corner, Probe

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
        events = self._events
        field, still = self._with_discrete(self._field, self.takes_sides), dict.fromkeys(self._discrete, 0.0)
        self.function = self._with_kinks(
            "field", lambda *arguments: {**field(*arguments), **still}, lambda sides: [[sides] * self.takes_sides]
        )
        self.surface_functions = tuple(self._with_kinks(*self._surface(event), lambda sides: [[]]) for event in events)
        slips = [Plain.of(np.full(LANES, slip)) for slip in (1.0, -1.0)]
        self.limits = {
            index: self._with_kinks(
                f"event {event.name}: normal", self._limits_of(event), lambda sides: [[sides, x] for x in slips], event
            )
            for index, event in enumerate(events)
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

    def _with_kinks(
        self, place: str, function: Callable[..., Any], more: Callable[..., list[Any]], friction: Friction | None = None
    ) -> Function:
        """Return a function with its kinks; `more(sides)`: its further arguments, in each way to call it."""
        rng, plain = np.random.default_rng(11), Function(function, {})
        t = Dual(self._t, Plain.of(rng.uniform(0.5, 1.5, LANES)), 1)
        y = {key: Dual(x, Plain.of(rng.uniform(0.5, 1.5, LANES)), 1) for key, x in self._y.items()}
        moved = {key: Dual(x.value + MOVED, x.slope, 1) for key, x in y.items()}
        found = {
            corner: [plain.found(t, y, self._p, *args) for sides in known for args in more(sides)]
            for corner, known in self.everywhere.items()
        }
        must_push, numbers = friction is not None and not friction.lift_off, dict[int, dict[Corner, int]]()
        for number, (kind, _, _) in enumerate(next(iter(found.values()))[0]):
            ends, whole = kind == "positive" and must_push, kind == "floor"
            # A force that depends on sides and parameters alone may be negative on one of the sides.
            if not (ends and friction is not None and friction.takes_sides) and not any(
                way[number][2] for ways in found.values() for way in ways
            ):
                continue
            groups: list[tuple[Any, list[Corner]]] = []
            for corner, ways in found.items():
                values = np.array([way[number][1] for way in ways])
                calls = (args for sides in self.everywhere[corner] for args in more(sides))
                if whole and not equal(values, [plain.found(t, moved, self._p, *x)[number][1] for x in calls]):
                    raise self._refuse(f"{place} takes the floor of a value that depends on states; write a vj.Impact")
                own = next((corners for same, corners in groups if equal(same, values)), None)
                if own is None:
                    groups.append((values, own := []))
                own.append(corner)
            for values, corners in groups:
                by_slip = values.reshape(len(self.everywhere[corners[0]]), -1, *values.shape[1:])
                sided = len(groups) > 1 or not equal(by_slip, by_slip[:, :1])
                numbers.setdefault(number, {}).update(dict.fromkeys(corners, len(self.kinks)))
                self.kinks.append(Kink(f"kink_{len(self.kinks) + 1}", place, whole, ends, sided, tuple(corners)))
        return Function(function, numbers)

    def events_at(self, section: Callable[..., Any]) -> dict[int, float]:
        """Return the switches and frictions whose surface is a section, by index, with the sign of their functions.

        The sign is that above the section, on which the function `section(t, y, p)` is zero.
        """
        above, kinks = section(self._t, self._y, self._p), {}
        for index, event in enumerate(self._events):
            if not isinstance(event, Impact) and _proportional(value := self._value(event), above):
                kinks[index] = float(np.sign(np.ravel(value / above)[0]))
        return kinks

    def _value(self, event: Event) -> Any:
        return event.surface(self._t, self._y, self._p)

    def surfaces(self) -> set[str]:
        """Return the states whose zeros are those of an event."""
        values = [abs(self._value(event)) for event in self._events]
        return {key for key, y in self._y.items() for value in values if equal(value, abs(y))}

    def dependences(self) -> Dependences:
        """Return how the functions depend on one another; refuse events that share a surface."""
        events = dict(enumerate(self._events))
        first, *others = self._in_all(self.velocities)
        speeds = {key: speed for key, speed in first.items() if all(other.get(key) == speed for other in others)}
        still, *stills = self._in_all(self._still_stops, speeds)
        depends = {i: set().union(*self._in_all(self._depends, partial(self._kept, e))) for i, e in events.items()}
        self._check_surfaces()
        moves = {i: set().union(*self._in_all(self._moves, event)) for i, event in events.items()}
        held = [i for i, event in events.items() if not isinstance(event, Impact) or event.velocity is not None]
        floors = any(kink.whole for kink in self.kinks)
        return Dependences(
            still={i: sign for i, sign in still.items() if all(other.get(i) == sign for other in stills)},
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
            mixing=tuple(sorted(set().union(*self._in_all(self._mixing)))),
            linear=all(self._in_all(self._linear)),
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
        # Directions of switches are differences of two fields, with the rounding errors of the fields.
        return all(equal(*pair, tolerance=1e-9) for pair in products) and any((a[key] * b[key]).any() for key in a)

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
        return set(self._jump(event, self._t))

    def _rates_at(self, sides: Mapping[str, float]) -> dict[str, Any]:
        """Return the field with some switches at `sides`."""
        return self._at(self._sides | dict(sides), self.rates, self._t, self._y)

    def _forced(self, sides: Mapping[str, float]) -> dict[str, Any]:
        """Return the field with some switches at `sides`, and the frictions whose normal forces depend on sides."""
        rubs = [event for event in self._events if isinstance(event, Friction) and event.takes_sides]
        forces = {
            event.name: event.limits(self._t, self._y, self._p, self._sides | dict(sides), 1.0)[0] for event in rubs
        }
        return self._rates_at(sides) | forces

    def _mixing(self) -> set[tuple[int, int]]:
        """Return the pairs of switches, by index, whose sides do not act on the field independently."""
        switches = [(i, event.name) for i, event in enumerate(self._events) if isinstance(event, Switch)]
        pairs = set()
        for (i, first), (j, second) in itertools.combinations(switches, 2):
            corners = {(a, b): self._forced({first: a, second: b}) for a in (1.0, -1.0) for b in (1.0, -1.0)}
            for key in corners[1.0, 1.0]:
                high, low = (corners[a, 1.0][key] - corners[a, -1.0][key] for a in (1.0, -1.0))
                size = max(np.abs(rates[key]).max() for rates in corners.values())
                if not bool((np.abs(high - low) <= REPEATED * np.abs(high) + ROUNDED * size).all()):
                    pairs.add((i, j))
        return pairs

    def _linear(self) -> bool:
        """Return whether the field is linear in the states and friction coefficients are constant."""
        laws = [event.coefficient(Degree(1), self._p) for event in self._events if isinstance(event, Friction)]
        rates = self.rates(self._t, dict.fromkeys(self._y, Degree(1)), number=False)
        return all(Degree.of(x) == 0 for x in laws) and all(Degree.of(x) < 2 for x in rates.values())

    def _check_surfaces(self) -> None:
        """Refuse two switches or frictions with one surface: neither decides alone on which side the motion is."""
        held = [event for event in self._events if not isinstance(event, Impact)]
        for first, second in itertools.combinations(held, 2):
            if _proportional(self._value(first), self._value(second)):
                advice = {
                    (Switch, Switch): "use one of them, whose sides are those of the other, up to the sign",
                    (Friction, Friction): "write one friction with the sum of both forces",
                }.get((type(first), type(second)), "write the difference of the directions into the friction's law")
                if first.acts_on != second.acts_on and isinstance(first, Friction) and isinstance(second, Friction):
                    advice = "for a force and its reaction, use a state with the relative velocity and the reduced mass"
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
