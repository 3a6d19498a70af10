"""Systems written as plain functions: states, parameters, a vector field and events.

The step bounds, resolutions, scales and the Poincaré section that a scene needs are derived from these functions.
"""

import functools
import math
import operator
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.errors import InputError
from vibrojax.models.arrays import Array
from vibrojax.models.physics.parameters import Parameter
from vibrojax.models.scenes.capabilities import HasImpacts
from vibrojax.models.scenes.declared import Guard, Marker, Mode, Section, Start, State, Swing, Values
from vibrojax.models.scenes.scene import ROUNDINGS, SLOPE_ROUNDINGS, Scene
from vibrojax.models.systems.events import Event, Impact, Switch
from vibrojax.models.systems.flow import Flow, Motion, SystemConstants
from vibrojax.models.systems.numbers import Rounded
from vibrojax.models.systems.probe import Probe
from vibrojax.models.systems.transitions import APPROACH, LIFT_ROUNDINGS, after_events, free_modes, initial_modes

AT_REST = 16.0
"""Speed of a bounce up to which the motion comes to rest on the stop, in square roots of the machine epsilon times the
typical rate of the gap. The height of a bounce is of second order in its speed: below, it is lost in rounding."""

BEYOND_RETURN = 1.5
"""Longest step in units of the time until a surface's parabola returns to zero: beyond it, the function is negative."""

CYCLES_SETTLING, CYCLES_OBSERVED = 100, 40
"""Default durations of settling and observation, in periods of the forcing or of the slowest oscillation about
the zero state."""

TIME = "t"
"""Name of the hidden state with the time within a period of the forcing [s]."""

DEFINED: "WeakValueDictionary[str, System]" = WeakValueDictionary()
"""The systems of this process by name, for the pages of their datasets. A later system replaces an earlier one."""

_ROUNDINGS: "WeakKeyDictionary[System, tuple[Values, Any]]" = WeakKeyDictionary()
"""Arguments and result of the last call of `System._rounded` for each system."""


class System(Scene[SystemConstants]):
    """A hybrid dynamical system written as plain functions; it can be used wherever a scene can.

    The functions take the time `t` [s], the states `y` and the parameters `p` by name, and use + - * / ** and
    `vj.elementary`.

    **Arguments:**

    - `name`: name of the system in datasets.
    - `states`: unit of each state by name.
    - `parameters`: default of each parameter by name, or entries of `vj.parameters` with units and ranges.
    - `field`: function `field(t, y, p)`, or `field(t, y, p, s)` with the sides `s` of the switches by name, that
      returns the time derivative of each state by name.
    - `period`: period of the forcing [s], a number or a function of `p`. The section is then at the times 0, T, ...
    - `section`: for a system without forcing, the name of a state, or a pair of a name and a number: the section is
      where the state rises through zero, or through the number.
    - `events`: any of `vj.Impact`, `vj.Switch` and `vj.Friction`.
    - `rate`: function of `p` that returns the fastest rate of change [1/s]; left out, it is the spectral radius of the
      field's Jacobian at the initial state.
    - `regimes`: names of the system's own for regimes, such as `{"periodic": "rocking"}`.

    A start that is not given is zero in all states. Trajectories have the states' names.

    **Raises:** `InputError` if a function gives something that cannot be used.

    **Example:** an impact oscillator (Shaw and Holmes, Journal of Sound and Vibration 90 (1983), 129)

    >>> system = vj.System(
    ...     "impact-oscillator",
    ...     states={"x": "m", "v": "m s-1"},
    ...     parameters={"a": 0.5, "omega": 2.0, "d": 0.5},
    ...     field=lambda t, y, p: {"x": y["v"], "v": p["a"] * vj.elementary.cos(p["omega"] * t) - y["x"]},
    ...     period=lambda p: 6.283185307179586 / p["omega"],
    ...     events=[vj.Impact("stop", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=0.8)],
    ... )
    >>> system.event_names
    ('stop', 'turned', 'strobe', 'v_zero')
    """

    def __new__(cls, *args: Any, **options: Any) -> "System":
        events = options.get("events") or ()
        impacts = isinstance(events, Sequence) and any(isinstance(event, Impact) for event in events)
        return object.__new__(ImpactSystem if impacts and cls is System else cls)

    # What users give is checked by `Probe`, in one line each.
    def __init__(
        self,
        name: str,
        *,
        states: Any,
        parameters: Any,
        field: Callable[..., Mapping[str, Any]],
        period: float | Callable[[Mapping[str, Any]], Any] | None = None,
        section: Any = None,
        events: Any = (),
        rate: Callable[[Mapping[str, Any]], Any] | None = None,
        regimes: Any = None,
    ) -> None:
        with jax.enable_x64(True):
            probe = Probe(name, states, parameters, field, period, section, events, regimes)
            self.name = name  # type: ignore[misc]
            speeds = probe.velocities()
            self.events, self._period, self._own = tuple(events), period, tuple(states)
            self._flow = Flow(self._own, field, probe.takes_sides, self.events, probe.still_stops(), speeds, rate)
            self._parameters, self._renamed = probe.parameters, dict(regimes or {})
            self._section_state, level = section if isinstance(section, tuple) else (section, 0.0)
            # The error of these positions follows from that of their velocities.
            self._integrated = frozenset(speeds) if set(speeds) < set(states) else frozenset()
            self.autonomous = period is None  # type: ignore[misc]
            self._declare(states, speeds, probe.surfaces(), level)
            self.usual_times = self._times()  # type: ignore[misc]
        DEFINED[name] = self

    def _declare(self, units: Mapping[str, str], speeds: Mapping[str, str], surfaces: set[str], level: float) -> None:
        """Set the declarations of a scene; `speeds`: the rate of change of each state that has one among the states."""
        hidden = {TIME: "s"} if not self.autonomous else {}
        hidden |= {APPROACH: "1"} if isinstance(self, HasImpacts) else {}
        section_state = self._section_state or TIME
        shown = [
            State(name, unit, name, True, offset=level if name == section_state else 0.0)
            for name, unit in units.items()
        ]
        turning = [speed for speed in dict.fromkeys(speeds.values()) if speed not in (section_state, *surfaces)]
        swings = (
            Swing(name, speeds[name] if speeds.get(name) in turning else None, f"{name}_amplitude") for name in units
        )
        self.states = (*shown, *(State(name, unit, name, shown=False) for name, unit in hidden.items()))  # type: ignore[misc]
        self.modes = tuple(map(_mode, self.events)) or (Mode("flow", "0", 0.0),)  # type: ignore[misc]
        self.markers = (Marker("strobe", section_state), *(Marker(f"{speed}_zero", speed) for speed in turning))  # type: ignore[misc]
        self.section = Section(tuple(swings), self._rearm, at=section_state)  # type: ignore[misc]
        self.starts, self.start_states, self.measures = ("zero",), self._own, ("rest",)  # type: ignore[misc]
        struck = [units[event.velocity] for event in self.events if isinstance(event, Impact) and event.velocity]
        if struck and isinstance(self, ImpactSystem):
            self.impact_unit = struck[0]
        self.drifting = (APPROACH,) if isinstance(self, HasImpacts) else ()  # type: ignore[misc]

    def __reduce__(self) -> Any:
        # The functions of a system cannot be pickled if they are lambdas. Other processes import the system instead.
        module = sys.modules.get(getattr(self._flow.function, "__module__", ""), None)
        for key, value in vars(module).items() if module is not None else ():
            if value is self and module is not None and module.__name__ != "__main__":
                return _system_of, (module.__name__, key)
        raise InputError(
            f"system {self.name}: other processes cannot import it; define it at the top level of a file you import"
        )

    def _times(self) -> tuple[float, float]:
        defaults = {name: parameter.default for name, parameter in self._parameters.items()}
        if self._period is None:
            cycle = 2 * math.pi / self._slow_rate(defaults)
        else:
            cycle = float(self._period(defaults) if callable(self._period) else self._period)
        cycle = float(f"{cycle:.2g}") if math.isfinite(cycle) and cycle > 0 else 1.0
        return CYCLES_SETTLING * cycle, CYCLES_OBSERVED * cycle

    def _slow_rate(self, p: dict[str, float]) -> float:
        """Return the slowest oscillation about the zero state [rad/s], else the slowest rate of change there [1/s]."""

        def jacobians(p: dict[str, Any]) -> list[list[list[Any]]]:
            c = self.constants(p)
            zero = {name: 0.0 * c.rates[0] for name in self._own}
            return [self._flow.jacobian(c, 0.0 * c.rates[0], zero, sides) for sides in self._flow.combinations()]

        values = np.linalg.eigvals(np.array(jax.jit(jacobians)(p), float)).ravel()
        turning, moving = np.abs(values.imag), np.abs(values)
        chosen = turning[turning > 0] if (turning > 0).any() else moving[moving > 0]
        rate = float(max(self.constants(p).rates)) if not chosen.size else chosen.min()
        return float(rate) if np.isfinite(rate) else 1.0

    def _rearm(self, c: SystemConstants) -> Any:
        if self._section_state is not None:
            return jnp.zeros_like(c.typical[self._section_state])
        return -0.1 * c.period

    @property
    def regime_names(self) -> Mapping[str, str]:
        usual = super().regime_names
        return self._renamed | {name: self._renamed.get(own, own) for name, own in usual.items()}

    def parameters(self) -> Mapping[str, Parameter]:
        return self._parameters

    # Equations

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
        guards = [
            Guard(event.name, self._guard_function(index), lambda c, mode: jnp.zeros_like(c.rates[0]))
            for index, event in enumerate(self.events)
        ]
        if not self.autonomous:
            place = self.place(TIME)
            # The section is at t = 0, so the time is set back half a period later.
            remaining = lambda c, mode, state: 0.5 * c.period - state[place]  # noqa: E731
            guards.append(Guard("turned", remaining, lambda c, mode: jnp.zeros_like(c.rates[0])))
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

    def mode_at(self, c: SystemConstants, state: Values) -> Values:
        zero = jnp.zeros_like(state[0])
        if not self.events:
            return (zero,)
        t, y = self._known(state)
        free = free_modes(self._flow, c, t, y, zero)
        return initial_modes(self._flow, c, t, y, free, self.resolutions(c, free, state, False))

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
        rates = self._flow.fastest(c, t, y)
        c = c._replace(rates=rates)
        speed, typical = jnp.stack(rates).min(axis=0), {name: jnp.abs(x) + like for name, x in y.items()}
        mode = tuple(like + (0.0 if isinstance(event, Impact) else 1.0) for event in self.events)
        time = 0.0 if c.period is None else c.period
        for _ in range(2):
            known = {name: Rounded(y[name], size) for name, size in typical.items()}
            sizes = self._flow.at(c, mode, Rounded(t + like, time + like), known).rates
            typical = {name: jnp.maximum(size, _size(sizes[name]) / speed) for name, size in typical.items()}
        known = {name: Rounded(y[name], size) for name, size in typical.items()}
        clock = Rounded(t + like, time + like)
        eps = jnp.finfo(like.dtype).eps
        surfaces = [_size(event.surface(clock, known, c.p)) + like for event in self.events]
        closing = [
            _size(self._flow.closing(c, event, mode, clock, known)) + like if isinstance(event, Impact) else like
            for event in self.events
        ]
        return c._replace(
            typical=typical,
            lifts=tuple(LIFT_ROUNDINGS * eps * size for size in surfaces),
            slow=tuple(AT_REST * eps**0.5 * size for size in closing),
        )

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
        t, y = self._known(state)
        for index, event in enumerate(self.events):
            if isinstance(event, Impact):
                r = event.bounce(c.p) + 0.0 * state[0]
                fails = (event.gap(t, y, c.p) < -c.lifts[index]) | (r < 0) | (r > 1)
                state = (jnp.where(fails, jnp.nan, state[0]), *state[1:])
        return state


class ImpactSystem(System, HasImpacts[SystemConstants]):
    """A system with stops; its impacts are counted and their velocities measured."""

    def impact_rate(self, c: SystemConstants, mode: Values, state: Values) -> Any:
        return state[self.place(APPROACH)]

    def impact_begins(self, c: SystemConstants, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        masks = [hits[e.name] & (mode[i] != 1) for i, e in enumerate(self.events) if isinstance(e, Impact)]
        return jnp.stack(masks).any(axis=0)


def _mode(event: Event) -> Mode:
    if isinstance(event, Impact):
        return Mode(event.name, "1 at rest on the stop, -1 after leaving it along a tangent, else 0", 0.0)
    return Mode(event.name, "sign of the side, 0 on the surface; twice the sign after leaving it along a tangent", 1.0)


def _system_of(module: str, name: str) -> Any:
    return getattr(import_module(module), name)


def _size(x: Any) -> Any:
    return x.size if isinstance(x, Rounded) else jnp.abs(x)
