"""Equations of a system as those of a scene: field, guards, resets, and the bounds and scales that follow from them."""

import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.models.arrays import Array
from vibrojax.models.scenes.declared import Guard, Start, Values
from vibrojax.models.scenes.scene import ROUNDINGS, SLOPE_ROUNDINGS, Scene
from vibrojax.models.systems.events import Event, Impact, Switch
from vibrojax.models.systems.flow import Flow, Motion, SystemConstants
from vibrojax.models.systems.numbers import Rounded
from vibrojax.models.systems.transitions import (
    APPROACH,
    LIFT_ROUNDINGS,
    after_events,
    free_modes,
    initial_modes,
    move_onto_surfaces,
)

AT_STOP = 1e-5
"""Largest gap at which a state is at an impact, relative to a typical gap."""

AT_REST = 16.0
"""Speed of a bounce up to which the motion comes to rest on the stop, in square roots of the machine epsilon times the
typical rate of the gap in a motion from rest. In a much faster motion, half of its own typical rate counts.
The height of a bounce is of second order in its speed: below, it is lost in rounding."""

BEYOND_RETURN = 1.5
"""Longest step in units of the time until a surface's parabola returns to zero: beyond it, the function is negative."""

TIME = "t"
"""Name of the hidden state with the time within a period of the forcing [s]."""

_ROUNDINGS: "WeakKeyDictionary[SystemEquations, tuple[Values, Any]]" = WeakKeyDictionary()
"""Arguments and result of the last call of `SystemEquations._rounded` for each system."""


class SystemEquations(Scene[SystemConstants]):
    """The equations of a system; a subclass declares the names and units.

    - `events`: the events; `_flow`: the functions.
    - `_own`: names of the states; `_integrated`: the states whose rate of change is a state itself.
    - `_period`: period of the forcing [s], a number or a function of `p`; `_section_state`: the state whose zeros are
      the section. One of them is None.
    """

    events: tuple[Event, ...]
    _flow: Flow
    _own: tuple[str, ...]
    _integrated: frozenset[str]
    _period: float | Callable[[Mapping[str, Any]], Any] | None
    _section_state: str | None

    def _known(self, state: Values) -> tuple[Any, dict[str, Any]]:
        """Return the time and the states by name."""
        return self._known_values(dict(zip(self.state_names, state, strict=True)))

    def _known_values(self, values: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Return the time and the states of the user's functions from all states by name."""
        values = dict(values)
        if self._section_state is not None:
            offset = self.states[self.place(self._section_state)].offset
            if offset:
                values[self._section_state] = values[self._section_state] + offset
        return (0.0 if self.autonomous else values[TIME]), {name: values[name] for name in self._own}

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
        return tuple(rates[name] if name in rates else hidden[name] for name in self.state_names)

    # Guards and resets

    def guards(self) -> tuple[Guard, ...]:
        zero = lambda c, mode: jnp.zeros_like(c.rates[0])  # noqa: E731
        guards = [
            Guard(event.name, self._guard_function(index), zero, is_switch=not isinstance(event, Impact))
            for index, event in enumerate(self.events)
        ]
        if not self.autonomous:
            place = self.place(TIME)
            # The section is at t = 0, so the time is set back half a period later.
            remaining = lambda c, mode, state: 0.5 * c.period - state[place]  # noqa: E731
            guards.append(Guard("turned", remaining, zero))
        return tuple(guards)

    def _guard_function(self, index: int) -> Callable[[Any, Values, Values], Any]:
        event = self.events[index]

        def value(c: SystemConstants, mode: Values, state: Values) -> Any:
            t, y = self._known(state)
            margin = self._motion(c, mode, state).margins[index]
            return self._guard_value(c, index, mode[index], event.surface(t, y, c.p), margin)

        return value

    def _guard_value(self, c: SystemConstants, index: int, where: Any, surface: Any, margin: Any) -> Any:
        """Return a guard's value from the event's function and margin; `where`: the mode of the event."""
        if isinstance(self.events[index], Impact):
            rests, lifted, side = jnp.where(where == 1, 1.0, 0.0), where == -1, jnp.ones_like(where)
        else:
            rests, lifted, side = jnp.where(where == 0, 1.0, 0.0), jnp.abs(where) == 2, jnp.sign(where)
        return (side * (1.0 - rests)) * surface + jnp.where(lifted, c.lifts[index], 0.0) + rests * margin

    def _rounded(self, c: SystemConstants, mode: Values, state: Values) -> tuple[list[Any], list[Any]]:
        """Return bounds on the rounding errors of the states and of the guards, in machine epsilons."""
        arguments = (c, *mode, *state)
        known = _ROUNDINGS.get(self)
        if known is not None and len(known[0]) == len(arguments) and all(map(operator.is_, known[0], arguments)):
            return known[1]  # a step asks for the same bounds three times
        speed, names = self.rate(c, mode), self.state_names
        # A state that passes through zero has the errors of its values nearby.
        near = [jnp.abs(x) + jnp.abs(rate) / speed for x, rate in zip(state, self.field(c, mode, state), strict=True)]
        motion = self._motion(c, mode, tuple(Rounded(x, size) for x, size in zip(state, near, strict=True)))
        sizes = [size + _size(motion.rates.get(name, 0.0)) / speed for name, size in zip(names, near, strict=True)]
        if not self.autonomous:
            sizes[names.index(TIME)] = jnp.zeros_like(state[0]) + c.period
        t, y = self._known(tuple(Rounded(x, size) for x, size in zip(state, sizes, strict=True)))
        guards = [
            _size(self._guard_value(c, index, mode[index], event.surface(t, y, c.p), motion.margins[index]))
            for index, event in enumerate(self.events)
        ]
        bounds = sizes, guards + ([] if self.autonomous else [jnp.zeros_like(state[0]) + c.period])
        _ROUNDINGS[self] = arguments, bounds
        return bounds

    def resolutions(self, c: SystemConstants, mode: Values, state: Values, marked: bool = True) -> Values:
        sizes, guards = self._rounded(c, mode, state)
        noise = ROUNDINGS * jnp.finfo(sizes[0].dtype).eps
        markers = [sizes[self.place(marker.velocity)] for marker in self.markers if marked]
        return tuple(noise * size for size in (*guards, *markers))

    def slope_resolutions(self, c: SystemConstants, mode: Values, state: Values, h: Any, marked: bool = True) -> Values:
        return tuple(SLOPE_ROUNDINGS * small for small in self.resolutions(c, mode, state, marked))

    def error_terms(
        self, c: SystemConstants, mode: Values, state: Values, polynomials: tuple[list[Array], ...]
    ) -> tuple[list[list[Array]], Any]:
        sizes, _ = self._rounded(c, mode, state)
        speed, one = self.rate(c, mode), jnp.ones_like(state[0])
        tiny = jnp.finfo(one.dtype).tiny
        rates = self.field(c, mode, state)
        terms, none = [], jnp.zeros((), one.dtype)
        for index, name in enumerate(self._own):
            inverse = 1.0 / (sizes[index] + tiny)
            higher = [none, none] if name in self._integrated else [x * inverse for x in polynomials[index][1:]]
            # The rate of change comes first: a motion is at rest if it is slow, not if the step is short.
            terms.append([rates[index] * (inverse / speed), *higher])
        return terms, one

    def validity(
        self, c: SystemConstants, mode: Values, polynomials: tuple[list[Array], ...], functions: list[list[Array]]
    ) -> Any:
        """Return the fraction of a step after which a surface may have been reached and left again.

        After a slow bounce, a motion returns to the surface much faster than the field changes. The step then ends soon
        after the zero of the parabola through value, rate and curvature of the surface's function.
        """
        shares = []
        for value, rate, curvature, *_ in functions[: len(self.events)]:
            falls = curvature < 0
            below = jnp.where(falls, curvature, -1.0)
            root = (-rate - jnp.sqrt(jnp.maximum(rate * rate - 4 * below * value, 0.0))) / (2 * below)
            shares.append(jnp.where(falls & (root > jnp.finfo(root.dtype).eps), BEYOND_RETURN * root, 1.0))
        return functools.reduce(jnp.minimum, shares) if shares else None

    def reset(self, c: SystemConstants, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        values = dict(zip(self.state_names, state, strict=True))
        modes = after_events(self._flow, self._known_values, c, mode, values, hits) if self.events else mode
        if not self.autonomous:
            values[TIME] = jnp.where(hits["turned"], -0.5 * c.period, values[TIME])
        return modes, tuple(values[name] for name in self.state_names)

    def states_across_impacts(self, p: Mapping[str, Any], state: Mapping[str, Any]) -> list[Any]:
        """Return the states on the other side of an impact, if `state` is at one, with the names of `state`.

        The other side is after the impact if the bodies approach, and before it if they separate. `p`: parameters
        (1,); `state`: the values of the return map's states.
        """
        with jax.enable_x64(True):
            values = tuple(jnp.full((1,), state.get(name, 0.0)) for name in self.state_names)
            c = self.scaled(self.constants({name: jnp.asarray(x) for name, x in p.items()}), values)
            (t, y), mode = self._known(values), free_modes(self._flow, c, *self._known(values), 0.0 * values[0])
            across = []
            for index, event in self._flow.of(Impact):
                near = jnp.abs(event.gap(t, y, c.p)) <= AT_STOP / LIFT_ROUNDINGS / jnp.finfo(float).eps * c.lifts[index]
                r, rate = event.bounce(c.p), self._flow.closing(c, event, mode, t, y)
                new = jnp.where(rate < 0, -r * rate, -rate / r)
                if event.velocity is None or not bool((near & jnp.isfinite(new)).all()):
                    continue
                jump = (new - rate) / self._flow.gain(c, index, mode, t, y)
                moved = dict(zip(self.state_names, values, strict=True))
                moved[event.velocity] = moved[event.velocity] + jump
                across.append(np.array([float(jnp.ravel(moved[name])[0]) for name in state]))
        return across

    def mode_at(self, c: SystemConstants, state: Values) -> Values:
        zero = jnp.zeros_like(state[0])
        if not self.events:
            return (zero,)
        t, y = self._known(state)
        free = free_modes(self._flow, c, t, y, zero)
        return initial_modes(self._flow, c, t, y, free, self.resolutions(c, free, state, False))

    def on_surfaces(self, c: SystemConstants, mode: Values, state: Values) -> Values:
        values = dict(zip(self.state_names, state, strict=True))
        if self.events:
            move_onto_surfaces(self._flow, self._known_values, c, mode, values)
        return tuple(values[name] for name in self.state_names)

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

    # Scales

    def constants(self, p: Mapping[str, Any]) -> SystemConstants:
        like = sum(0.0 * jnp.asarray(x) for x in p.values())
        values = {name: jnp.asarray(x) for name, x in p.items()}
        period = self._period(values) if callable(self._period) else self._period
        period = None if period is None else period + like
        zero = {name: like for name in self._own}
        none = (like,) * len(self.events)
        c = SystemConstants(values, period, zero, (), none, none)
        return c._replace(rates=self._flow.fastest(c, like, zero))

    def scaled(self, c: SystemConstants, state: Values) -> SystemConstants:
        """Return the constants with rates and scales of a motion that begins at `state`."""
        t, y = self._known(state)
        like = 0.0 * state[0]
        # A lane and its orbit begin in different states, and must come to rest after the same bounce.
        _, _, from_rest = self._magnitudes(c, like, {name: like for name in y})
        c = c._replace(rates=self._flow.fastest(c, t, y))
        typical, surfaces, closing = self._magnitudes(c, t + like, {name: x + like for name, x in y.items()})
        eps = jnp.finfo(like.dtype).eps
        return c._replace(
            typical=typical,
            lifts=tuple(LIFT_ROUNDINGS * eps * size for size in surfaces),
            slow=tuple(
                AT_REST * eps**0.5 * jnp.maximum(usual, 0.5 * own)
                for usual, own in zip(from_rest, closing, strict=True)
            ),
        )

    def _magnitudes(self, c: SystemConstants, t: Any, y: dict[str, Any]) -> tuple[dict[str, Any], list[Any], list[Any]]:
        """Return magnitudes of states, surfaces of events, and closing rates of stops in a motion from `y`."""
        like = 0.0 * t
        speed, typical = jnp.stack(c.rates).min(axis=0), {name: jnp.abs(x) for name, x in y.items()}
        mode = tuple(like + (0.0 if isinstance(event, Impact) else 1.0) for event in self.events)
        time = 0.0 if c.period is None else c.period
        for _ in range(2):
            known = {name: Rounded(y[name], size) for name, size in typical.items()}
            sizes = self._flow.at(c, mode, Rounded(t, time + like), known).rates
            typical = {name: jnp.maximum(size, _size(sizes[name]) / speed) for name, size in typical.items()}
        known = {name: Rounded(y[name], size) for name, size in typical.items()}
        clock = Rounded(t, time + like)
        surfaces = [_size(event.surface(clock, known, c.p)) + like for event in self.events]
        closing = [
            _size(self._flow.closing(c, event, mode, clock, known)) + like if isinstance(event, Impact) else like
            for event in self.events
        ]
        return typical, surfaces, closing

    def rate(self, c: SystemConstants, mode: Values) -> Any:
        where = [mode[index] for index, event in enumerate(self.events) if isinstance(event, Switch)]
        if not where or len(c.rates) == 1:
            return c.rates[0]
        rate = 0.0 * c.rates[0]
        for signs, own in zip(self._flow.combinations(), c.rates, strict=True):
            # On a surface (mode 0) the field is a combination of both sides.
            fits = jnp.stack([side * sign >= 0 for side, sign in zip(where, signs, strict=True)]).all(axis=0)
            rate = jnp.maximum(rate, jnp.where(fits, own, 0.0))
        return rate

    def speed_scale(self, c: SystemConstants) -> Any:
        """Return the typical magnitude of the section's state."""
        return c.typical[self._section_state] if self._section_state is not None else c.period

    def start(self, c: SystemConstants, name: Start, shape: tuple[int, ...]) -> Values:
        """Return the initial state, NaN for a start beyond a stop or a restitution outside 0 to 1."""
        given = (0.0,) * len(self._own) if name is None or isinstance(name, str) else name
        dtype = c.rates[0].dtype
        offsets = [state.offset for state in self.states]
        values = [jnp.full(shape, value, dtype) - offset for value, offset in zip(given, offsets, strict=False)]
        state = (*values, *(jnp.zeros(shape, dtype) for _ in self.states[len(values) :]))
        fails = [(gap < 0) | (r < 0) | (r > 1) for _, gap, r in self._stops(c.p, state)]
        return (functools.reduce(lambda x, fails: jnp.where(fails, jnp.nan, x), fails, state[0]), *state[1:])

    def _stops(self, p: Mapping[str, Any], state: Values) -> list[tuple[str, Any, Any]]:
        """Return name, gap and restitution of each stop."""
        t, y = self._known(state)
        stops = [event for event in self.events if isinstance(event, Impact)]
        return [(stop.name, stop.gap(t, y, p), stop.bounce(p) + 0.0 * state[0]) for stop in stops]

    def start_faults(self, p: Mapping[str, Any], state: Values) -> list[tuple[str, str, Any]]:
        """Return stops that are passed at the start, restitutions outside 0 to 1, and rates that are not finite."""
        offsets, p = [known.offset for known in self.states], {name: jnp.asarray(x) for name, x in p.items()}
        state = tuple(jnp.asarray(x) - offset for x, offset in zip(state, offsets, strict=False))
        state = (*state, *(0.0 * state[0] for _ in offsets[len(state) :]))
        faults: list[tuple[str, str, Any]] = []
        for name, gap, r in self._stops(p, state):
            text = f"the gap of {name} is {_first(gap):.6g}; it must not be negative"
            faults.append(("beyond-a-stop", text, gap < 0))
            text = f"the restitution of {name} is {_first(r):.6g}; it must lie between 0 and 1"
            faults.append(("restitution-not-0-to-1", text, (r < 0) | (r > 1)))
        t, y = self._known(state)
        sides = {event.name: jnp.sign(event.surface(t, y, p)) for event in self.events if isinstance(event, Switch)}
        for name, rate in self._flow.function(t, y, p, *([sides] if self._flow.takes_sides else [])).items():
            text = f"the field, {name}, is {_first(rate):g} at the start; it must be finite"
            faults.append(("not-finite", text, ~jnp.isfinite(rate)))
        return faults


def _first(x: Any) -> float:
    return float(jnp.ravel(jnp.asarray(x))[0])


def _size(x: Any) -> Any:
    return x.size if isinstance(x, Rounded) else jnp.abs(x)
