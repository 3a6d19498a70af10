"""Checks of the functions of a system at random states."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np

from vibrojax.errors import CANNOT_EXPAND, NOT_KNOWN_YET, InputError, asked, shown, suggestion
from vibrojax.lazy import jax
from vibrojax.physics.arrays import check_untraced
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.systems.declared_parameters import UNIT_EXAMPLES, is_unit, parameter_of
from vibrojax.systems.events import KINDS_OF_POINTS, Event, Friction, Impact, Switch, below_law, required_arguments
from vibrojax.systems.kinks import tried
from vibrojax.systems.numbers import Dual, Plain, equal

LANES = 3
"""Number of lanes with which the functions are tried."""

RESERVED = (
    *("t", "approach", "section_value", "start", "direction", "point", "return", "time", "rock", "friction", "regime"),
    "period",
)
"""Names that datasets and sweep files use for other things."""

ARGUMENTS = ("scene", "duration", "method", "solver", "step", "smoothing", "error", "sampling", "progress")
"""Arguments of `vj.simulate`, which would take the value of a parameter of the same name."""

RENAMED = ("periodic", "impact-free", "single-impact", "multi-impact", "subharmonic", "irregular", "equilibrium")
"""Regimes that may have names of the system's own."""

REPEATED, ROUNDED = 1e-9, 1e-13
"""Differences that a function may have after a period, relative to its changes in time and to its value."""

SHARES = np.random.default_rng(3).uniform(0.0, 1.0, (20, LANES))
"""Times at which functions are compared with other times: some fall into pulses that last a tenth of a period."""

SIZES = (1.0, -1.0, 30.0, -30.0, 1e-3, 1e-6, 1e-9, 0.0)
"""Factors of the random states at which a time is sought: far from its range, a smooth contact is exactly zero."""

MOST_HELD = 16
"""Greatest number of combinations of discrete states with which functions are tried."""

Corner = tuple[float, ...]
"""A combination of the sides of the switches, each 1 or -1."""


class Probe:
    """The checked declaration of a system; see [vibrojax.systems.system.System][] for the arguments."""

    def __init__(
        self,
        name: Any,
        states: Any,
        parameters: Any,
        field: Callable[..., Mapping[str, Any]],
        period: Any,
        section: Any,
        events: Any,
        regimes: Any,
        modes: Any,
    ):
        if not isinstance(name, str) or not name:
            raise InputError(f"system: the name is {shown(name)}; give a string such as 'impact-oscillator'")
        self._name = name
        for what, value, kind, example in (
            ("states", states, Mapping, "{'x': 'm', 'v': 'm s-1'}"),
            ("parameters", parameters, Mapping, "{'k': 1.0}"),
            ("events", events, list | tuple, "[vj.Impact(...)]"),
            ("regimes", regimes or {}, Mapping, "{'periodic': 'rocking'}"),
            ("modes", modes or {}, Mapping, "{'heating': 1}"),
        ):
            if not isinstance(value, kind):
                raise self._refuse(f"{what} is {type(value).__name__}; write {what}={example}")
        self._states, self._field, self._events = dict(states), field, tuple(events)
        self._discrete = dict(modes or {})
        self._check_names(states, parameters)
        laws = [event for event in self._events if isinstance(event, Friction)]
        self.parameters = {key: parameter_of(key, x, self._refuse) for key, x in parameters.items()}
        for event in laws:
            self.parameters |= {key: x for key, x in event.parameters.items() if key not in self.parameters}
        self.takes_sides = self._takes_sides()
        self._sides = {event.name: 1.0 for event in self._events if isinstance(event, Switch)}
        for key, value in self._discrete.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise self._refuse(f"modes: {key} begins as {shown(value)}; give a finite number")
            self._sides[key] = float(value)
        self._check_events()
        rng = np.random.default_rng(5)
        self._p = {key: Plain.of(np.full(LANES, x.default or 0.0)) for key, x in self.parameters.items()}
        # Other values than the defaults show the structure: a forcing whose amplitude is zero by default is a forcing.
        defaults = self._p
        self._others = {
            key: Plain.of(x * rng.uniform(0.9, 1.1, LANES) + np.where(x == 0, rng.uniform(0.1, 0.3, LANES), 0.0))
            for key, x in defaults.items()
        }
        self._y = {key: Plain.of(rng.uniform(0.2, 0.9, LANES)) for key in states}
        self._t = Plain.of(rng.uniform(0.1, 0.2, LANES))
        self._check_functions()
        if period is not None:
            if isinstance(period, str):
                raise self._refuse(f"period is {shown(period)}; write a number, or a function: lambda p: {period}")
            T = self._number("period", self._call("period", period, defaults) if callable(period) else period)
            if not bool((np.isfinite(T) & (T > 0)).all()):
                raise self._refuse(f"period is {float(T[0]):g}; it must be above zero")
        self._p = self._others
        self._check_section(period, section)
        for key, own in dict(regimes or {}).items():
            if key not in RENAMED:
                raise self._refuse(f"regimes: {shown(key)} is not a regime; choose from {', '.join(RENAMED)}")
            if not isinstance(own, str) or not own or " " in own:
                raise self._refuse(f"regimes: {shown(own)} names {shown(key)}; a name is one word, such as 'rocking'")

    def _refuse(self, reason: str) -> InputError:
        return InputError(f"system {self._name}: {reason}")

    def _check_names(self, states: Mapping[str, str], parameters: Mapping[str, Any]) -> None:
        if not states or not parameters:
            lacking = "state, such as states={'x': 'm'}" if not states else "parameter, such as parameters={'k': 1.0}"
            raise self._refuse(f"it needs at least one {lacking}")
        for event in self._events:
            if not isinstance(event, Impact | Switch | Friction):
                raise self._refuse(f"events: {shown(event)} is not a vj.Impact, vj.Switch or vj.Friction")
            if event.name in KINDS_OF_POINTS:
                raise self._refuse(f"event {event.name}: that is a kind of special points; choose another name")
        for key, unit in states.items():
            if not is_unit(unit):
                raise self._refuse(f"states: {key} has the unit {shown(unit)}; {UNIT_EXAMPLES}")
        groups = {"state": [*states, *self._discrete], "parameter": [*parameters]}
        groups["event"] = [event.name for event in self._events]
        names = [(key, kind) for kind, group in groups.items() for key in group]
        for key, kind in names:
            if kind == "parameter" and key in ARGUMENTS:
                raise self._refuse(f'parameter "{key}" has the name of an argument of vj.simulate; choose another name')
            if not isinstance(key, str) or not key.isidentifier() or key in RESERVED:
                raise self._refuse(
                    f"{shown(key)} cannot be a name; write an identifier, not one of {', '.join(RESERVED)}"
                )
            if len(kinds := [kind for name, kind in names if name == key]) > 1:
                both = " and ".join(f"{'an' if kind == 'event' else 'a'} {kind}" for kind in kinds)
                each = f"two {kinds[0]}s" if len({*kinds}) == 1 else both
                raise self._refuse(f"{shown(key)} is the name of {each}; each needs a name of its own")

    def _takes_sides(self) -> bool:
        try:
            arguments = required_arguments(self._field)
        except (TypeError, ValueError):
            arguments = 3
        switches = [*self._discrete, *(event.name for event in self._events if isinstance(event, Switch))]
        if arguments not in (3, 4):
            raise self._refuse(
                f"field takes {arguments} arguments; write field(t, y, p), or field(t, y, p, s) with switches"
            )
        if switches and arguments == 3:
            kind = "discrete state" if switches[0] in self._discrete else "switch"
            raise self._refuse(f"field(t, y, p) cannot see the {kind} {switches[0]}; write field(t, y, p, s)")
        return arguments == 4

    def _check_events(self) -> None:
        for event in self._events:
            if isinstance(event, Impact) and (event.velocity is None) == (event.reset is None):
                raise self._refuse(f"event {event.name}: give either velocity= and restitution=, or reset=")
            directed = isinstance(event, Impact) and event.direction is not None
            if directed and (event.direction not in (-1, 1) or event.reset is None):
                raise self._refuse(f"event {event.name}: direction= is -1 or 1, together with reset=")
            if event.acts_on is not None and event.acts_on not in self._states:
                raise self._refuse(
                    f"event {event.name}: {shown(event.acts_on)} is not a state; choose from {', '.join(self._states)}"
                )
            if isinstance(event, Friction):
                what, law = f"event {event.name}: law", event.law
                if isinstance(law, int | float) and not law >= 0:
                    raise self._refuse(f"{what} is {law:g}; a coefficient is at least 0")
                if not (isinstance(law, FrictionLaw | int | float) or callable(law)):
                    hint = suggestion(law, FRICTION_LAWS) if isinstance(law, str) else ""
                    raise self._refuse(f"{what} is {shown(law)}; {hint or 'give a number, a function of p or a law'}")
                if callable(law) and required_arguments(law) != 1:
                    raise self._refuse(f"{what} takes other arguments; write law(p), or a vj.FrictionLaw: mu(speed, p)")
            functions = {what: function for what, function in (self._surface(event), _normal(event)) if what}
            for what, function in functions.items():
                if not callable(function):
                    raise self._refuse(f"{what} is {shown(function)}; write a function: lambda t, y, p: {function}")

    # Where the functions are tried

    @cached_property
    def everywhere(self) -> dict[Corner, list[dict[str, Any]]]:
        """For each combination of the sides of the switches, the sides and the discrete states that resets give."""
        held = [{key: float(x) for key, x in self._discrete.items()}]
        names = [event.name for event in self._events if isinstance(event, Switch)]
        corners = [*itertools.product((-1.0, 1.0), repeat=len(names))]
        for before in held:
            for event in self._events if self._discrete else ():
                for corner in corners if isinstance(event, Impact) and event.reset is not None else ():
                    jump = self._at(dict(zip(names, corner, strict=True)) | before, self._jump, event, self._t)
                    new = before | {key: jump[key] for key in self._discrete if key in jump}
                    known = any(all(bool(equal(new[key], old[key])) for key in new) for old in held)
                    held += [] if known or len(held) == MOST_HELD else [new]
        return {corner: [dict(zip(names, corner, strict=True)) | x for x in held] for corner in corners}

    def _at(self, sides: dict[str, Any], function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the value of a function with switches and discrete states at `sides`."""
        before, self._sides = self._sides, sides
        try:
            return function(*arguments)
        finally:
            self._sides = before

    def _in_all(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Return the values of a function on all sides of switches, in all discrete states and formulas of kinks."""
        known = [sides for some in self.everywhere.values() for sides in some]
        run = lambda calls: [calls.during(self._at, sides, function, *arguments) for sides in known]  # noqa: E731
        first, *others = tried()
        return run(first) + [value for calls in others if first.kinds for value in run(calls)]

    def _jump(self, event: Any, t: Any, y: Any = None) -> Any:
        """Return the new values that a reset gives."""
        sided = [self._sides] if required_arguments(event.reset) == 4 else []
        return self._call(f"event {event.name}: reset", event.reset, t, y or self._y, self._p, *sided)

    # What the functions give

    def _call(self, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
        with np.errstate(all="ignore"):
            known = [*self._states, *self.parameters, *self._sides]
            written = {1: "p", 3: "t, y, p", 4: "t, y, p, s"}.get(len(arguments), "")
            return asked(f"system {self._name}: {what}", function, *arguments, known=known, written=written)

    def _number(self, what: str, value: Any) -> Any:
        """Return a number per lane as an array; anything else is refused."""
        check_untraced(lambda problem: self._refuse(f"{what} {problem}"), value)
        try:
            array = np.asarray(value)
            if array.dtype.kind not in "biufc":
                raise TypeError
        except (TypeError, ValueError):
            raise self._refuse(f"{what} gave {type(value).__name__}; it must give one number per lane") from None
        if array.dtype.kind not in "fiu":
            raise self._refuse(f"{what} gave values of type {array.dtype}; they must be real numbers")
        if array.shape not in ((), (LANES,)):
            raise self._refuse(
                f"{what} gave an array of shape {array.shape} for {LANES} lanes; it must give one number per lane"
            )
        return Plain.of(np.broadcast_to(array, (LANES,)))

    def rates(self, t: Any, y: Mapping[str, Any], number: bool = True) -> dict[str, Any]:
        """Return the field at a time and state, with all switches on the positive side."""
        sides = (self._sides,) if self.takes_sides else ()
        rates = self._call("field", self._field, t, y, self._p, *sides)
        if not isinstance(rates, Mapping):
            raise self._refuse(f"field gave {type(rates).__name__}; it must give a dict with the rate of each state")
        if set(rates) != set(self._states):
            lacking, more = [x for x in self._states if x not in rates], [x for x in rates if x not in self._states]
            wrong = f"no rate of {lacking[0]}" if lacking else f"a rate of {shown(more[0])}, which is not a state"
            raise self._refuse(f"field gave {wrong}")
        return {key: self._number(f"field, {key},", rates[key]) if number else rates[key] for key in self._states}

    def _surface(self, event: Event) -> tuple[str, Any]:
        return f"event {event.name}: {event.noun}", event.surface

    def _check_functions(self) -> None:
        for key, rate in self.rates(self._t, self._y).items():
            self._check_finite(f"field, {key},", rate)
        for event in self._events:
            what, function = self._surface(event)
            self._check_finite(what, self._number(what, self._call(what, function, self._t, self._y, self._p)))
            self._check_effect(event)
            if isinstance(event, Friction):
                what = f"event {event.name}: normal"
                self._number(what, self._call(what, event.force, self._t, self._y, self._p, self._sides))
                what = f"event {event.name}: law"
                law = self._number(what, self._call(what, event.coefficient, 0.0 * self._t, self._p))
                what = f"event {event.name}: static"
                static = law if event.static is None else self._number(what, self._call(what, event.at_rest, self._p))
                if bool(below_law(static, law).any()):
                    raise self._refuse(f"{what} is {float(static[0]):g}, below {float(law[0]):g}, the law at rest")
                what = f"event {event.name}: mass"
                mass = self._number(what, self._call(what, event.inertia, self._p))
                if not bool((mass > 0).all()):
                    raise self._refuse(f"{what} is {float(mass[0]):g}; it must be above zero")
            if isinstance(event, Impact) and event.reset is not None:
                what, new = f"event {event.name}: reset", self._jump(event, self._t)
                if not isinstance(new, Mapping) or not set(new) <= {*self._states, *self._discrete}:
                    kind = "an array" if hasattr(new, "shape") else type(new).__name__
                    given = f"values of {', '.join(map(str, new))}" if isinstance(new, Mapping) else kind
                    known = ", ".join([*self._states, *self._discrete])
                    raise self._refuse(f"{what} gave {given}; it must give a dict of new values of the states {known}")
                for key, value in new.items():
                    self._number(f"{what}, {key},", value)
            elif isinstance(event, Impact):
                what = f"event {event.name}: restitution"
                r = self._number(what, self._call(what, event.bounce, self._p))
                if not bool(((r >= 0) & (r <= 1)).all()):
                    raise self._refuse(f"{what} is {float(r[0]):g}; it must lie between 0 and 1")
        self._check_series()

    def _check_finite(self, what: str, value: Any) -> None:
        if not bool(np.isfinite(value).all()):
            lane = int(np.argmax(~np.isfinite(value)))
            place = ", ".join(f"{name} = {float(y[lane]):.2g}" for name, y in self._y.items())
            raise self._refuse(f"{what} is {float(value[lane])} at {place}; it must be finite there")

    def check_rate(self, rate: Any) -> None:
        """Refuse a function of the fastest rate of change that does not give a rate above zero."""
        if not callable(rate):
            raise self._refuse(f"rate is {shown(rate)}; write a function: lambda p: {rate}")
        value = self._number("rate", self._call("rate", rate, self._p))
        if not bool((value > 0).all()):
            raise self._refuse(f"rate is {float(value[0]):g}; it must be above zero")
        jax.eval_shape(lambda p: self._call("rate", rate, p), jax.tree.map(np.asarray, self._p))

    def _check_effect(self, event: Event) -> None:
        """Refuse an event whose function does not depend on what the event changes, or a friction that drives."""
        if isinstance(event, Friction):
            names, what = {event.acts_on}, f"relative does not depend on {event.acts_on}, the velocity on which it acts"
        elif isinstance(event, Impact) and event.velocity is not None:
            names = {key for key, speed in self.velocities().items() if speed == event.velocity}
            what = f"gap does not depend on a state whose rate is {event.velocity}, the velocity that jumps"
        else:
            return
        moved = {key: y + 0.1 for key, y in self._y.items() if key in names}
        before, after = (event.surface(self._t, y, self._p) for y in (self._y, self._y | moved))
        if equal(before, after):
            raise self._refuse(f"event {event.name}: {what}")
        if isinstance(event, Friction) and not bool((np.asarray(after) >= np.asarray(before)).all()):
            fault = f"relative falls where {event.acts_on} rises, so that friction would drive it; change the sign"
            raise self._refuse(f"event {event.name}: {fault}")

    def _check_series(self) -> None:
        self._check_expands("field", lambda t, y, p: self.rates(t, y, number=False))
        for event in self._events:
            self._check_expands(*self._surface(event))
            if isinstance(event, Friction):
                what, force = f"event {event.name}: normal", event.force
                self._check_expands(what, lambda t, y, p, force=force: force(t, y, p, self._sides))
        try:
            jax.eval_shape(self._call_all, *jax.tree.map(np.asarray, (self._t, self._y, self._p)))
        except InputError as error:
            if NOT_KNOWN_YET in str(error):
                raise

    def _call_all(self, t: Any, y: Mapping[str, Any], p: dict[str, Any]) -> None:
        """Call the functions of the system with values that a compiled program does not know yet."""
        before, self._p = self._p, p
        try:
            self.rates(t, y, number=False)
            for event in self._events:
                what, function = self._surface(event)
                self._call(what, function, t, y, p)
                if isinstance(event, Friction):
                    self._call(f"event {event.name}: mass", event.inertia, p)
                    for part, own in (("law", event.law), ("static", event.static)):
                        if callable(own) and not isinstance(own, FrictionLaw):
                            self._call(f"event {event.name}: {part}", own, p)
                elif isinstance(event, Impact) and event.reset is None:
                    self._call(f"event {event.name}: restitution", event.bounce, p)
                elif isinstance(event, Impact):
                    self._jump(event, t, y)
        finally:
            self._p = before

    def _check_expands(self, what: str, function: Callable[..., Any]) -> None:
        """Try a function on the number types of a step, which `jnp` and `np` functions do not accept."""
        try:
            function(Dual(self._t, 1.0, 1), {key: Dual(x, 1.0, 1) for key, x in self._y.items()}, self._p)
        except InputError as error:
            text = str(error)
            if "TypeError" in text or "AttributeError" in text:
                raise self._refuse(f"{what} {CANNOT_EXPAND}") from None
            raise
        except TypeError:
            raise self._refuse(f"{what} {CANNOT_EXPAND}") from None

    def _check_section(self, period: Any, section: Any) -> None:
        if period is not None and section is not None:
            need = "period= for a forced system, or section= (a state) for one without forcing"
            raise self._refuse(f"period= and section= are both given; give only one: {need}")
        if period is None and section is None:
            return
        if callable(section):
            value = self._number("section", self._call("section", section, self._t, self._y, self._p))
            if not equal(value, section(self._t + 0.37, self._y, self._p)) or equal(value, value[0]):
                raise self._refuse("section must depend on states, and not on t; write section(t, y, p)")
            self._check_expands("section", section)
        elif section is not None:
            name, known = section[0] if isinstance(section, tuple) else section, ", ".join(self._states)
            for part in section if isinstance(section, tuple) else ():
                check_untraced(lambda problem: self._refuse(f"section {problem}"), part)
            if name not in [*self._states] or (isinstance(section, tuple) and not _is_level(section)):
                raise self._refuse(
                    f"section: {shown(section)} is not a state, a pair of a state and a number, or a function; "
                    f"states are {known}"
                )
        if section is not None:
            if self.depends_on_time():
                raise self._refuse("it depends on t; give period= (of the forcing) instead of section=")
            return
        T = self._number("period", period(self._p) if callable(period) else period)
        now, before = (self._at_times([Plain.of(share - back) * T for share in SHARES]) for back in (0.0, 1.0))
        # A forcing may be much smaller than the other terms, as for states far from one.
        if not bool((np.abs(now - before) <= REPEATED * np.ptp(now, axis=0) + ROUNDED * np.abs(now)).all()):
            raise self._refuse("it does not repeat after the period; check period=")

    def depends_on_time(self) -> bool:
        """Return whether the field or an event depends on the time."""
        for size in SIZES:
            probe = copy(self)
            probe._y = {key: Plain.of(size * y) for key, y in self._y.items()}
            first, *others = probe._at_times([self._t, *(Plain.of(1e6**share) for share in SHARES)])
            if not all(np.array_equal(first, other, equal_nan=True) for other in others):
                return True
        return False

    def _at_times(self, times: Sequence[Any]) -> Any:
        """Return the field and the events on all sides (times, values, lanes)."""

        def values(t: Any) -> list[Any]:
            values = [*self.rates(t, self._y).values(), *(event.surface(t, self._y, self._p) for event in self._events)]
            for event in self._events:
                if isinstance(event, Friction):
                    values.append(event.force(t, self._y, self._p, self._sides))
                elif isinstance(event, Impact) and event.reset is not None:
                    values += self._jump(event, t).values()
            return [np.broadcast_to(np.asarray(value, float), (LANES,)) for value in values]

        return np.array([np.concatenate(self._in_all(values, t)) for t in times])

    def velocities(self) -> dict[str, str]:
        """Return the velocity of each state whose rate of change is a state itself, by name."""
        rates = self.rates(self._t, self._y)
        return {
            key: other
            for key, rate in rates.items()
            for other, value in self._y.items()
            if other != key and bool((rate == value).all())
        }


def _normal(event: Event) -> tuple[str, Any]:
    """Return the name and the function of a friction's normal force; no name for other events."""
    return (f"event {event.name}: normal", event.normal) if isinstance(event, Friction) else ("", None)


def _is_level(section: tuple[Any, ...]) -> bool:
    """Return whether a section is a pair of a state and a finite number."""
    return len(section) == 2 and isinstance(section[1], int | float) and math.isfinite(section[1])
