"""Equations of a system as those of a scene: field, guards, resets, and initial states."""

import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from vibrojax.lazy import jnp, lax
from vibrojax.physics.arrays import Array
from vibrojax.scenes.declared import Guard, Start, Values
from vibrojax.scenes.scene import ROUNDINGS, Scene
from vibrojax.systems.events import Event, Friction, Impact, Switch, below_law
from vibrojax.systems.flow import Flow, Motion, SystemConstants, onto_zero
from vibrojax.systems.numbers import Plain, Rounded, slope_along
from vibrojax.systems.transitions import (
    LIFT_ROUNDINGS,
    Places,
    after_events,
    decided,
    first_branches,
    free_modes,
    is_stop,
    onto_surfaces,
)

APPROACH = "approach"
"""Name of the hidden state with the speed of the last impact."""

NEAR_SECTION, DRIFT = 0.1, 1e-6
"""Distance from a section, and error of that distance, up to which the error is kept, relative to a typical value."""

ONTO_SECTION = 3
"""Newton iterations that move a state next to the section onto it."""

TIME = "t"
"""Name of the hidden state with the time within a period of the forcing [s]."""

TURNED = "turned"
"""Name of the guard that sets this time back by a period."""

SECTION = "section_value"
"""Name of the hidden state with the value of the function that defines the section."""


def _moved(y: Mapping[str, Any], rates: Mapping[str, Any], time: Any) -> dict[str, Any]:
    """Return the states after a short time, to first order."""
    return {name: x + rates[name] * time if name in rates else x for name, x in y.items()}


class SystemEquations(Scene[SystemConstants]):
    """The equations of a system; a subclass declares the names and units.

    - `events`: the events; `_flow`: the functions.
    - `_own`: names of the states; `_integrated`: the states whose rate of change is a state itself.
    - `_period`: period of the forcing [s], a number or a function of `p`, or None.
    - `_section_state`: the state that crosses the value `_level` at the section; for a forced system the hidden time.
    - `_section_function`: function of t, y and p that is zero at the section; None: a state decides.
    - `_discrete`: initial values of discrete states; `_at_section`: the events whose surface is the
      section, by index, with the sign of their function above it.
    """

    ends_at_once = True
    fault_reasons = ("none", "negative-normal-force", "slides-on-two-switches")
    events: tuple[Event, ...]
    _flow: Flow
    _own: tuple[str, ...]
    _integrated: frozenset[str]
    _period: float | Callable[[Mapping[str, Any]], Any] | None
    _section_state: str
    _level: float
    _section_function: Callable[..., Any] | None
    _discrete: Mapping[str, float]
    _at_section: Mapping[int, float]

    # The user's functions know the states without the shift of the section. Only these two functions shift.

    def _known(self, state: Values) -> tuple[Any, dict[str, Any]]:
        """Return the time and the states of the user's functions, by name, from all states."""
        values = dict(zip(self.state_names, state, strict=True))
        if self._level:
            values[self._section_state] = values[self._section_state] + self._level
        return (0.0 if self.autonomous else values[TIME]), {name: values[name] for name in self._flow.names}

    def _with_known(self, state: Values, y: Mapping[str, Any], **hidden: Any) -> Values:
        """Return all states: the user's states from `y`, and the `hidden` states by name."""
        if self._level:
            y = {**y, self._section_state: y[self._section_state] - self._level}
        values = dict(zip(self.state_names, state, strict=True)) | {name: y[name] for name in self._flow.names} | hidden
        return tuple(values[name] for name in self.state_names)

    def _motion(self, c: SystemConstants, mode: Values, state: Values) -> Motion:
        """Return the motion, evaluated once per expansion: its Taylor series serve the field and the guards."""
        seen = getattr(state[0], "seen_motion", None)
        if seen is not None and all(map(operator.is_, seen[0], (c, *mode))):
            known: Motion = seen[1]
            return known
        motion = self._flow.at(c, mode, *self._known(state))
        if not isinstance(state[0], Array):
            state[0].seen_motion = ((c, *mode), motion)
        return motion

    def field(self, c: SystemConstants, mode: Values, state: Values) -> Values:
        rates = self._motion(c, mode, state).rates
        zero = 0.0 * state[0]
        hidden = {TIME: zero + 1.0, APPROACH: zero}
        if self._section_function is not None:
            t, y = self._known(state)
            along = [rates.get(name, 0.0) for name in y]
            hidden[SECTION] = slope_along(lambda t, y: self._section_value(c, y), t, y, along)
        return tuple(rates[name] if name in rates else hidden[name] for name in self.state_names)

    def _section_value(self, c: SystemConstants, y: Mapping[str, Any]) -> Any:
        assert self._section_function is not None
        return self._section_function(0.0, y, c.p)

    def _section_state_after(self, c: SystemConstants, state: Values, y: Mapping[str, Any]) -> Any:
        """Return the hidden state with the section's function, where the states have become `y`.

        It would drift by the errors of steps. Next to the section, a correction would cross the section again.
        """
        own, value, typical = state[self.place(SECTION)], self._section_value(c, y), c.typical[SECTION]
        near = (jnp.abs(value) <= NEAR_SECTION * typical) & (jnp.abs(value - own) <= DRIFT * typical)
        return jnp.where(near, own, value)

    def onto_section(self, c: SystemConstants, state: Values) -> Values:
        if self._section_function is None:
            return state
        _, y = self._known(state)
        section = lambda t, y: self._section_value(c, y)  # noqa: E731
        along = {name: [float(key == name) for key in y] for name in self._own}
        for _ in range(ONTO_SECTION):
            slopes = {name: slope_along(section, 0.0, y, rates, 0.0) for name, rates in along.items()}
            weights = {name: slope * c.typical[name] ** 2 for name, slope in slopes.items()}
            y = y | onto_zero(self._section_value(c, y), slopes, weights, y)
        return self._with_known(state, y, **{SECTION: 0.0 * state[0]})

    # Guards and resets

    @property
    def named_events(self) -> tuple[str, ...]:
        return tuple(event.name for event in self.events if isinstance(event, Switch) and not event.impact)

    def guards(self) -> tuple[Guard, ...]:
        zero = lambda c, mode: jnp.zeros_like(c.rates[0])  # noqa: E731
        names = [(event.name, not isinstance(event, Impact)) for event in self.events]
        names += [(kink.name, False) for kink in self._flow.kinks]
        guards = [
            Guard(name, self._guard_function(index), zero, is_switch=switch)
            for index, (name, switch) in enumerate(names)
        ]
        if self._period is not None:
            place = self.place(TIME)
            # The section is at t = 0, so the time is set back half a period later.
            remaining = lambda c, mode, state: 0.5 * c.period - state[place]  # noqa: E731
            guards.append(Guard(TURNED, remaining, zero))
        return tuple(guards)

    def _guard_function(self, index: int) -> Callable[[Any, Values, Values], Any]:
        def value(c: SystemConstants, mode: Values, state: Values) -> Any:
            return self._guard_value(c, index, mode, self._motion(c, mode, state))

        return value

    def _guard_value(self, c: SystemConstants, index: int, mode: Values, motion: Motion) -> Any:
        """Return the value of an event's or a kink's guard."""
        surface, lift, where = motion.surfaces[index], c.lifts[index], mode[index]
        if index >= len(self.events):
            kink = self._flow.kinks[index - len(self.events)]
            value = (0.25 + lift) - surface * surface if kink.whole else jnp.sign(where) * surface + lift
            if not kink.sided:
                return value
            used = jnp.where(self._flow.in_use(mode, kink), 1.0, 0.0)
            return used * value + (1.0 - used)  # nothing happens on sides on which no function uses it
        if is_stop(self.events[index]):
            rests, lifted, side = jnp.where(where == 1, 1.0, 0.0), where == -1, jnp.ones_like(where)
        else:
            rests, lifted, side = jnp.where(where == 0, 1.0, 0.0), jnp.abs(where) == 2, jnp.sign(where)
        return (side * (1.0 - rests)) * surface + jnp.where(lifted, lift, 0.0) + rests * motion.margins[index]

    def reset(self, c: SystemConstants, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        hidden: dict[str, Any] = {}
        (t, y), modes = self._known(state), mode
        if self.events or self._flow.kinks:
            approach = state[self.place(APPROACH)] if APPROACH in self.state_names else 0.0 * state[0]
            modes, y, approach = after_events(self._flow, c, mode, t, y, approach, hits)
            hidden = {APPROACH: approach} if APPROACH in self.state_names else {}
            # A discrete state depends on no state that varies continuously.
            y = y | {name: lax.stop_gradient(y[name]) for name in self._discrete}
        if self._section_function is not None:
            hidden[SECTION] = self._section_state_after(c, state, y)
        if self._period is not None:
            hidden[TIME] = jnp.where(hits[TURNED], -0.5 * c.period, state[self.place(TIME)])
            if any(kink.whole for kink in self._flow.kinks):
                turned = first_branches(self._flow, c, modes, hidden[TIME], y)
                kinks = len(self.events)
                new = [jnp.where(hits[TURNED], x, old) for x, old in zip(turned, modes[kinks:], strict=False)]
                modes = (*modes[:kinks], *new, *modes[kinks + len(new) :])
        return modes, self._ended(modes, self._with_known(state, y, **hidden))

    def _ended(self, mode: Values, state: Values) -> Values:
        """Return the state, not a number where the modes show that the motion cannot go on."""
        fault = self.fault(mode)
        return state if fault is None else tuple(jnp.where(fault > 0, jnp.nan, x) for x in state)

    def fault(self, mode: Values) -> Any:
        flow = self._flow
        kinks = enumerate(flow.kinks, len(self.events))
        forces = [(mode[place] < 0) & flow.in_use(mode, kink) for place, kink in kinks if kink.ends]
        slides = [(mode[i] == 0) & (mode[j] == 0) for i, j in flow.structure.mixing]
        if not forces and not slides:
            return None
        code = 0.0 * mode[0]
        for number, masks in enumerate((forces, slides), start=1):
            for mask in masks:
                code = jnp.where(mask, float(number), code)
        return code

    @property
    def stops(self) -> tuple[str, ...]:
        return tuple(event.name for _, event in self._flow.of(Impact) if event.velocity is not None)

    @property
    def may_jump(self) -> bool:
        return bool(self.switch_places or self._flow.resets)

    def across_impacts(self, c: SystemConstants, state: Values) -> list[tuple[Any, Values]]:
        (t, y), flow = self._known(state), self._flow
        mode = free_modes(flow, c, t, y, 0.0 * state[0])
        sides = []
        for index, event in flow.of(Impact):
            typical = c.lifts[index] / (LIFT_ROUNDINGS * jnp.finfo(c.lifts[index].dtype).eps)
            if event.velocity is None:
                gap, z = self._across_reset(c, mode, index, t, y)
                sides.append((gap / typical, self._with_known(state, z)))
                continue
            gap, rate = flow.surface(c, mode, index, t, y), flow.closing(c, mode, index, t, y)
            ago = gap / rate
            z = _moved(y, flow.plain(c, mode, t, y), -ago)
            rate, r = flow.closing(c, mode, index, t - ago, z), event.bounce(c.p)
            jump = (jnp.where(rate < 0, -r * rate, -rate / r) - rate) / flow.gain(c, mode, index, t - ago, z)
            z = z | {event.velocity: z[event.velocity] + jump}
            z = _moved(z, flow.plain(c, mode, t - ago, z), ago)
            sides.append((gap / typical, self._with_known(state, z)))
        return sides

    def _across_reset(
        self, c: SystemConstants, mode: Values, index: int, t: Any, y: Mapping[str, Any]
    ) -> tuple[Any, dict[str, Any]]:
        """Return the gap of a stop with a reset, and the state after the next reset or before the last one.

        The state before is exact where each new value is a linear function of the same old one. The gap is negative
        where the motion has passed the stop without its reset, or has not yet reached it but has the state behind it.
        """
        flow, event = self._flow, self.events[index]
        sign = -1.0 if isinstance(event, Impact) and event.direction == 1 else 1.0

        def after(t: Any, y: Mapping[str, Any]) -> dict[str, Any]:
            new = flow.resets[index](t, y, c.p, flow.sides_of(mode))
            return {**y, **{name: x for name, x in new.items() if name not in self._discrete}}

        def before(t: Any, y: Mapping[str, Any]) -> dict[str, Any]:
            old = dict(y)
            for name, x in after(t, y).items():
                slope = slope_along(lambda t, y: after(t, y)[name], t, y, [float(key == name) for key in y], 0.0)  # noqa: B023
                old[name] = y[name] + (y[name] - x) / slope
            return old

        def across(jump: Callable[..., dict[str, Any]], z: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
            gap, rate = (f(c, mode, index, t, z) for f in (flow.surface, flow.closing))
            ago = gap / rate
            there = jump(t - ago, _moved(y, flow.plain(c, mode, t, y), -ago))
            there = _moved(there, flow.plain(c, mode, t - ago, there), ago)
            return jnp.where(sign * rate < 0, sign * gap, jnp.inf), there

        (ahead, next_state), (behind, last_state) = across(after, y), across(before, before(t, y))
        is_next = jnp.abs(ahead) <= jnp.abs(behind)
        return jnp.where(is_next, ahead, -behind), {k: jnp.where(is_next, next_state[k], last_state[k]) for k in y}

    def mode_at(self, c: SystemConstants, state: Values) -> Values:
        zero = jnp.zeros_like(state[0])
        if not self.events and not self._flow.kinks:
            return (zero,)
        t, y = self._known(state)
        free = free_modes(self._flow, c, t, y, zero)
        if not self.events:
            return free
        always, places = jnp.ones_like(zero, bool), Places({}, {}, {}, {})
        for index, small in enumerate(self.resolutions(c, free, state, False)[: len(self.events)]):
            distance = jnp.abs(self._flow.surface(c, free, index, t, y) + zero)
            places.open[index], places.near[index] = always, distance <= small
            places.touches[index] = distance <= jnp.maximum(small, c.lifts[index])
            if self._flow.beside(index):
                places.again[index] = places.near[index]
        return tuple(decided(self._flow, c, free, t, y, places)[0])

    def on_surfaces(self, c: SystemConstants, mode: Values, state: Values) -> Values:
        if not self.events and not self._flow.kinks and self._section_function is None:
            return state
        t, y = self._known(state)
        if self.events:
            y = onto_surfaces(self._flow, c, mode, t, y)
        hidden = {} if self._section_function is None else {SECTION: self._section_state_after(c, state, y)}
        return self._ended(mode, self._with_known(state, y, **hidden))

    def events_of(self, mode: Values, after: Values, hits: Mapping[str, Any]) -> dict[str, Any]:
        kinds: dict[str, Any] = {}
        for index, event in enumerate(self.events):
            before, now, hit = mode[index], after[index], hits[event.name]
            if isinstance(event, Impact):
                masks = {"stick": hit & (now == 1), "release": hit & (before == 1)}
            else:
                starts, moves = ("slide", "switch") if isinstance(event, Switch) else ("stick", "slip")
                masks = {starts: hit & (before != 0) & (now == 0), moves: hit & (now != 0)}
            kinds |= {kind: kinds.get(kind, False) | mask for kind, mask in masks.items()}
        return kinds

    def at_rest(self, mode: Values) -> Mapping[str, Any]:
        return {event.name: mode[index] == 1 for index, event in self._flow.of(Impact)}

    def joined(
        self, mode: Values, hits: Mapping[str, Any], falling: Mapping[str, Any]
    ) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        for index, sign in self._at_section.items():
            crossed = hits[self.events[index].name] & (mode[index] != 0)
            hits = {**hits, "strobe": hits["strobe"] | crossed}
            # The section may be crossed before the event, whose surface moves away after a departure from it.
            falling = {**falling, "strobe": jnp.where(crossed, mode[index] * sign > 0, falling["strobe"])}
        return hits, falling

    @property
    def section_on_guard(self) -> bool:
        return bool(self._at_section)

    def start(self, c: SystemConstants, name: Start, shape: tuple[int, ...]) -> Values:
        """Return the initial state, NaN for a stop, a mass or a friction that is among the `start_faults`."""
        given = (0.0,) * len(self._own) if name is None or isinstance(name, str) else name
        y = {key: jnp.full(shape, value, c.rates[0].dtype) for key, value in zip(self._own, given, strict=True)}
        y |= {key: jnp.full(shape, value, c.rates[0].dtype) for key, value in self._discrete.items()}
        zero = jnp.zeros(shape, c.rates[0].dtype)
        state = self._with_known((zero,) * len(self.states), y)
        fails = [beyond | (r < 0) | (r > 1) for _, _, beyond, r in self._stops(c.p, zero, y)]
        fails += [event.inertia(c.p) + zero <= 0 for _, event in self._flow.of(Friction) if callable(event.mass)]
        fails += [slope < 0 for _, slope in self._opposing(c.p, zero, y)]
        for _, event in self._flow.of(Friction):
            sliding, static = event.coefficient(zero, c.p) + zero, event.at_rest(c.p) + zero
            fails += [sliding < 0, static < 0, below_law(static, sliding)]
        fails += [] if c.period is None else [~(c.period > 0) | ~jnp.isfinite(c.period)]
        return (functools.reduce(lambda x, fails: jnp.where(fails, jnp.nan, x), fails, state[0]), *state[1:])

    def has_no_field(self, c: SystemConstants, mode: Values, state: Values) -> Any:
        """Return a mask of the states beyond a rigid stop, and of those in which friction holds a body, or just not."""
        t, y = self._known(state)
        without = [beyond for _, _, beyond, _ in self._stops(c.p, t, y)]
        for index, _ in self._flow.of(Friction):
            relative = self._flow.surface(c, mode, index, t, y)
            without.append((mode[index] == 0) | (jnp.abs(relative) <= c.lifts[index]))
        return functools.reduce(operator.or_, without, False)

    def _stops(self, p: Mapping[str, Any], t: Any, y: Mapping[str, Any]) -> list[tuple[str, Any, Any, Any]]:
        """Return name, gap, a mask of gaps below zero by more than rounding errors, and restitution of each stop."""
        stops, known = [], {name: Rounded(x, abs(x)) for name, x in y.items()}
        for event in (event for _, event in self._flow.of(Impact) if is_stop(event)):
            gap = event.gap(t, y, p)
            beyond = gap < -ROUNDINGS * jnp.finfo(gap.dtype).eps * event.gap(t, known, p).size
            stops.append((event.name, gap, beyond, event.bounce(p) + 0.0 * t))
        return stops

    def _opposing(self, p: Mapping[str, Any], t: Any, y: Mapping[str, Any]) -> list[tuple[Friction, Any]]:
        """Return each friction with the change of its relative velocity per change of the velocity on which it acts."""
        slopes = []
        for _, event in self._flow.of(Friction):
            relative = lambda t, y, event=event: event.surface(t, y, p)  # noqa: E731
            slopes.append((event, slope_along(relative, t, y, [float(name == event.acts_on) for name in y], 0.0)))
        return slopes

    @np.errstate(all="ignore")
    def start_faults(self, p: Mapping[str, Any], state: Values) -> list[tuple[str, str, Any]]:
        """Return stops that are passed at the start, and restitutions, forces, masses and rates that cannot be."""
        p = {name: Plain.of(x) for name, x in p.items()}
        y = {name: Plain.of(x) for name, x in zip(self._own, state, strict=True)}
        t = 0.0 * next(iter(y.values()))
        y |= {name: t + value for name, value in self._discrete.items()}
        faults: list[tuple[str, str, Any]] = []
        if self._period is not None:
            period = (self._period(p) if callable(self._period) else self._period) + t
            text = f"the period of the forcing is {_first(period):.6g} s; it must be above 0 and finite"
            faults.append(("period-not-above-zero", text, ~(period > 0) | ~np.isfinite(period)))
        for name, gap, beyond, r in self._stops(p, t, y):
            text = f"the gap of {name} is {_first(gap):.6g}; it must not be negative"
            faults.append(("beyond-a-stop", text, beyond))
            text = f"the restitution of {name} is {_first(r):.6g}; it must lie between 0 and 1"
            faults.append(("restitution-not-0-to-1", text, (r < 0) | (r > 1)))
        sides = {event.name: np.sign(event.surface(t, y, p)) for event in self.events if isinstance(event, Switch)}
        for _, event in self._flow.of(Friction):
            force = event.force(t, y, p, sides | {name: y[name] for name in self._discrete}) + t
            text = f"the normal force of {event.name} is {_first(force):.6g} at the start; it must not be negative"
            mask = (force < 0) & (not event.lift_off)
            faults.append(("negative-normal-force", text, mask))
            sliding, static = event.coefficient(t, p) + t, event.at_rest(p) + t
            text = f"static of {event.name} is {_first(static):.6g}, below the {_first(sliding):.6g} of its law at rest"
            faults.append(("static-below-sliding", text, below_law(static, sliding)))
            for at, coefficient in (("", sliding), ("static ", static)):
                text = f"the {at}coefficient of {event.name} is {_first(coefficient):.6g}; it must not be negative"
                faults.append(("friction-drives", text, coefficient < 0))
            mass = event.inertia(p) + t
            text = f"the mass of {event.name} is {_first(mass):.6g}; it must be above 0"
            faults.append(("mass-not-above-zero", text, mass <= 0))
        for event, slope in self._opposing(p, t, y):
            text = f"relative of {event.name} falls where {event.acts_on} rises, so that friction would drive it"
            faults.append(("friction-drives", text, slope < 0))
        for name, rate in self._flow.function.function(t, y, p, *([sides] if self._flow.takes_sides else [])).items():
            rate = rate + t
            text = f"the field, {name}, is {_first(rate):g} at the start; it must be finite"
            faults.append(("not-finite", text, ~np.isfinite(rate)))
        return faults


def _first(x: Any) -> float:
    return float(np.ravel(x)[0])
