"""Kinks: points at which `maximum`, `minimum`, `absolute` or `floor` in a function of a system changes its formula.

A Taylor series describes one formula only. So the formula in use is part of the mode: a kink is located like any other
event, and the other formula is used after it. The kinks of a function are numbered in the order of its calls.
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from vibrojax.lazy import jnp
from vibrojax.physics import elementary
from vibrojax.physics.arrays import Array
from vibrojax.scenes.declared import Values
from vibrojax.systems.numbers import Dual, array_of

Differences = dict[int, Any]
"""For each kink, by index: a function that is zero where the formula changes, and positive for the first formula.
That of `floor` is the distance from the middle of its interval, -1/2 and 1/2 at the ends."""


class Kink(NamedTuple):
    """A kink of one of the functions of a system.

    - `name`: its name among the guards; `place`: the function, in words.
    - `whole`: True for `floor`, whose mode is its value; the mode of other kinks is the sign of their difference.
    - `ends`: True for the normal force of a friction that must not be negative: the kink ends the motion.
    - `sided`: True if its difference depends on the sides of switches or on the direction of slip.
    - `sides`: the combinations of the sides of switches on which functions use it.
    """

    name: str
    place: str
    whole: bool
    ends: bool
    sided: bool
    sides: tuple[tuple[float, ...], ...]


class Calls(elementary.Branches):
    """The kinks of one call of a function, with the formulas that are `chosen` by number of the kink's call.

    Kinks that are not chosen are evaluated as usual.
    """

    def __init__(self, chosen: Mapping[int, Any]):
        self.chosen, self.differences = chosen, []  # type: ignore[var-annotated]
        self.kinds: list[str] = []

    def _next(self, kind: str, difference: Any) -> Any:
        number = len(self.differences)
        self.differences.append(difference)
        self.kinds.append(kind)
        return self.chosen.get(number)

    def maximum(self, x: Any, y: Any) -> Any:
        chosen = self._next("maximum", x - y)
        if chosen is None:
            return elementary.greater(x, y)
        first = jnp.where(chosen > 0, 1.0, 0.0)
        return first * x + (1.0 - first) * y

    def absolute(self, x: Any) -> Any:
        chosen = self._next("absolute", x)
        return elementary.magnitude(x) if chosen is None else x * jnp.where(chosen > 0, 1.0, -1.0)

    def floor(self, x: Any) -> Any:
        whole = self.chosen.get(len(self.differences))
        # The distance from the middle of the interval in which the whole number holds.
        self._next("floor", x if whole is None else x - (whole + 0.5))
        return elementary.whole(x) if whole is None else whole

    def positive(self, x: Any) -> Any:
        """Return the positive part of a normal force."""
        chosen = self._next("positive", x)
        if chosen is None:
            return elementary.greater(x, 0.0)
        return x * jnp.where(chosen > 0, 1.0, 0.0)


def positive_part(x: Any) -> Any:
    """Return the positive part of a normal force, whose zero is a kink."""
    active = elementary.BRANCHES.get()
    return active.positive(x) if isinstance(active, Calls) else elementary.maximum(x, 0.0)


@dataclass(frozen=True, eq=False)
class Function:
    """A function of time, states and more, with its kinks.

    `kinks`: their indices in the system by number of call, one for each combination of the sides of switches: where
    sides change the difference of a kink, each combination has its own formula.
    """

    function: Callable[..., Any]
    kinks: Mapping[int, Mapping[tuple[float, ...], int]]

    def at(self, branches: Values, sides: Sequence[Any], t: Any, y: Mapping[str, Any], *more: Any) -> Any:
        """Return the value in the formulas of `branches`, the modes of the system's kinks, with switches at `sides`."""
        return self.run(branches, sides, t, y, *more)[0]

    def run(
        self, branches: Values, sides: Sequence[Any], t: Any, y: Mapping[str, Any], *more: Any
    ) -> tuple[Any, Differences]:
        """Return the value, and the differences of the kinks by number of call."""
        if not self.kinks:
            return self.function(t, y, *more), {}
        plain = not any(hasattr(x, "value") and not isinstance(x, Array) for x in (t, *y.values()))
        if plain:  # arrays know nothing of kinks in abs(x)
            t, y = Dual(t, 0.0, 1), {name: Dual(x, 0.0, 1) for name, x in y.items()}
        calls = Calls({number: _chosen(branches, sides, own) for number, own in self.kinks.items()})
        value = calls.during(self.function, t, y, *more)
        differences = {number: calls.differences[number] for number in self.kinks}
        return (_plain(value), _plain(differences)) if plain else (value, differences)

    def found(self, t: Any, y: Mapping[str, Any], *more: Any) -> list[tuple[str, Any, bool]]:
        """Return kind and values of each kink in the order of calls, and whether it depends on time or states.

        `t`, `y`: dual numbers whose slopes are not zero. The values are those for different formulas of the other
        kinks, because a kink may depend on a state in one of these formulas only.
        """
        tries = tried()
        for calls in tries:
            calls.during(self.function, t, y, *more)
        found = []
        for kind, *values in zip(tries[0].kinds, *(calls.differences for calls in tries), strict=True):
            slopes = [array_of(x.slope) for x in values if isinstance(x, Dual)]
            depends = any(bool(np.any(np.asarray(slope) != 0)) for slope in slopes)
            found.append((kind, np.array([np.asarray(array_of(x)) + 0.0 * t.value for x in values]), depends))
        return found


def tried() -> list[Calls]:
    """Return calls of a function that use different formulas of its kinks; the first one those at the values.

    Random states of order one show only one side of a clearance of several units.
    """
    return [Calls({}), *(_Tried(first) for first in ([True], [False], [True, False], [False, True]))]


class _Tried(Calls):
    """The kinks of one call, whose formulas are the first ones or not in the order of `first`, whatever the values."""

    def __init__(self, first: Sequence[bool]):
        super().__init__({})
        self.first = first

    def _next(self, kind: str, difference: Any) -> Any:
        super()._next(kind, difference)
        return np.float64(1.0 if self.first[len(self.differences) % len(self.first)] else -1.0)


def _chosen(branches: Values, sides: Sequence[Any], own: Mapping[tuple[float, ...], int]) -> Any:
    """Return the mode of a kink, whose index for each combination of sides is `own`, with switches at `sides`."""
    (_, first), *others = own.items()
    chosen = branches[first]
    for corner, index in others:
        if index != first:
            here = [side == own for side, own in zip(sides, corner, strict=True)]
            chosen = jnp.where(reduce(operator.and_, here), branches[index], chosen)
    return chosen


def _plain(value: Any) -> Any:
    """Return a value of a function, or a collection of values, with arrays for dual numbers."""
    if isinstance(value, Mapping):
        return {name: _plain(x) for name, x in value.items()}
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return value.value if isinstance(value, Dual) else value
