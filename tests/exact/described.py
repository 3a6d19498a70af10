"""Hybrid systems described as data: sums of products of names, and the events that refer to them.

An expression is a tuple of pairs (number, names). `((-1.0, "k x"), (0.5, "a cos"))` is -k x + 0.5 a cos(omega t). Names
are states, parameters, switches (their side, 1 or -1), `cos` and `sin`. The phase of both is omega t."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Expression = tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class Stop:
    """An impact: `velocity` jumps by the restitution (a parameter), or `reset` gives new values of states."""

    name: str
    gap: Expression
    velocity: str | None = None
    restitution: str = ""
    reset: Mapping[str, Expression] = field(default_factory=dict)


@dataclass(frozen=True)
class Surface:
    """A switch: its side is the sign of `function`."""

    name: str
    function: Expression


@dataclass(frozen=True)
class Rub:
    """Dry friction: coefficient `kinetic` and `static` (parameters), normal force, and the mass (a parameter)."""

    name: str
    relative: Expression
    normal: Expression
    kinetic: str
    static: str
    acts_on: str
    mass: str


@dataclass(frozen=True)
class Described:
    """A hybrid system: field and events as expressions, and the range of each parameter.

    Each term of the field has at most one switch as a factor, and no switch or friction acts on the rate of a position.

    - `section`: name of the state whose upward zeros are the returns; None if the forcing has the frequency `omega`.
    - `start`: range of each state at the start; `surfaces`: state and expression of starts exactly on a surface.
    """

    name: str
    states: tuple[str, ...]
    field: Mapping[str, Expression]
    events: Sequence[Stop | Surface | Rub]
    ranges: Mapping[str, tuple[float, float]]
    section: str | None = None
    start: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    surfaces: Sequence[tuple[str, Expression]] = ()

    @property
    def switches(self) -> list[str]:
        return [event.name for event in self.events if isinstance(event, Surface)]


def derivative(expression: Expression, name: str) -> Expression:
    """Return the partial derivative with respect to a state, or to the time if `name` is "t"."""
    waves = {"cos": (-1.0, "omega sin"), "sin": (1.0, "omega cos")} if name == "t" else {name: (1.0, "")}
    terms = []
    for number, text in expression:
        names = text.split()
        for place, factor in enumerate(names):
            if factor in waves:
                sign, new = waves[factor]
                terms.append((sign * number, " ".join([*names[:place], new, *names[place + 1 :]])))
    return tuple(terms)


def times(a: Expression, b: Expression) -> Expression:
    """Return the product of two expressions."""
    return tuple((x * y, f"{s} {u}") for x, s in a for y, u in b)


def rate_of(system: Described, expression: Expression) -> Expression:
    """Return the rate of change of an expression along the field."""
    terms = derivative(expression, "t")
    for state in system.states:
        terms += times(derivative(expression, state), system.field[state])
    return terms


def evaluate(expression: Expression, known: Callable[[str], Any]) -> Any:
    """Return the value of an expression; `known(name)` returns the value of a name, of any number type."""
    return sum(math.prod([known(name) for name in text.split()], start=number) for number, text in expression)


def compiled(system: Described, p: Mapping[str, float], rows: Sequence[Sequence[Expression]]) -> Callable[..., Any]:
    """Return a function of time and states that returns one list of numbers for each row of expressions."""
    places = {name: f"y[{place}]" for place, name in enumerate(system.states)} | {"cos": "c", "sin": "s"}

    def source(expression: Expression) -> str:
        sums: dict[str, float] = {}
        for number, text in expression:
            names = text.split()
            monomial = "*".join(sorted(places[name] for name in names if name in places))
            sums[monomial] = sums.get(monomial, 0.0) + number * math.prod(p[x] for x in names if x not in places)
        return "+".join(f"({number!r})" + ("*" + text if text else "") for text, number in sums.items()) or "0.0"

    body = ", ".join("[" + ", ".join(map(source, row)) + "]" for row in rows)
    code = f"def f(t, y):\n    c, s = cos({p['omega']!r} * t), sin({p['omega']!r} * t)\n    return [{body}]"
    space: dict[str, Any] = {"cos": math.cos, "sin": math.sin}
    exec(code, space)
    return space["f"]
