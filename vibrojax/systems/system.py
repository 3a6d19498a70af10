"""Systems written as plain functions: states, parameters, a vector field and events.

The step bounds, resolutions, scales and the Poincaré section that a scene needs are derived from these functions.
"""

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from vibrojax.errors import InputError
from vibrojax.lazy import jax, jnp
from vibrojax.physics.parameters import Parameter
from vibrojax.scenes.capabilities import HasImpacts
from vibrojax.scenes.declared import Marker, Mode, Section, State, Swing, Values
from vibrojax.systems.equations import APPROACH, SECTION, TIME, TURNED
from vibrojax.systems.events import Event, Impact, Switch
from vibrojax.systems.flow import Flow, SystemConstants
from vibrojax.systems.kinks import Kink
from vibrojax.systems.numbers import Plain, slope_along
from vibrojax.systems.scales import SystemScales
from vibrojax.systems.structure import Structure
from vibrojax.systems.transitions import free_modes

CYCLES_SETTLING, CYCLES_OBSERVED = 100, 40
"""Default durations of settling and observation, in periods of the forcing or of the slowest oscillation about
the zero state."""

TURNING_SHARE = 1e-3
"""Least imaginary part of an eigenvalue that counts as an oscillation, as a fraction of the eigenvalue. Rounding errors
split a multiple real eigenvalue into complex ones."""

DEFINED: "WeakValueDictionary[str, System]" = WeakValueDictionary()
"""The systems of this process by name, for the pages of their datasets. A later system replaces an earlier one."""


class System(SystemScales):
    """A hybrid dynamical system, written as plain functions. A system can be used wherever a scene can.

    All functions of a system take the time `t` [s], a dict `y` of the states and a dict `p` of the parameters. Write
    functions of a system with + - * / ** and the functions of `vj.elementary`.

    **Arguments:**

    - `name`: name of the system in datasets.
    - `states`: a dict with the unit of each state.
    - `parameters`: a dict with, for each parameter, its default, a pair of default and unit such as `(0.5, "rad s-2")`,
      or an entry of `vj.parameters` with unit and range.
    - `field`: function `field(t, y, p)` that returns the time derivative of each state by name; in `field(t, y, p, s)`,
      `s` holds the side of each switch and the discrete states by name.
    - `period`: period T of the forcing [s], a number or a function of `p`; the section of a forced system is at the
      times 0, T, ...
    - `section`: for a system without forcing, a state name, a pair (state name, level), or a function
      `section(t, y, p)`. A motion crosses the section where the state or function rises through the level, by default
      zero. A system with neither `period` nor `section` can be simulated but not measured.
    - `events`: any of `vj.Impact`, `vj.Switch` and `vj.Friction`.
    - `modes`: a dict with the initial value of each discrete state. The `reset` of an event can change a discrete
      state, which the functions of the system read as `s[name]`.
    - `rate`: function of `p` that returns the fastest rate of change [1/s]; by default, the spectral radius of the
      field's Jacobian at the initial state.
    - `regimes`: the system's own names of regimes, such as `{"periodic": "rocking"}`.

    By default all states begin at zero. In trajectories, the variables have the names of the states.

    **Raises:** `InputError` if an argument is invalid, or if a function returns values of the wrong form.

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
        counted = isinstance(events, Sequence) and any(map(_is_impact, events))
        return object.__new__(ImpactSystem if counted and cls is System else cls)

    # What users give is checked by `Structure`, in one line each.
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
        modes: Any = None,
    ) -> None:
        with jax.enable_x64(True):
            probe = Structure(name, states, parameters, field, period, section, events, regimes, modes)
            if rate is not None:
                probe.check_rate(rate)
            self.name = name  # type: ignore[misc]
            self.events, self._period, self._own = tuple(events), period, tuple(states)
            self._discrete = {name: float(value) for name, value in (modes or {}).items()}
            self._flow = Flow(
                (*self._own, *self._discrete),
                probe.function,
                probe.takes_sides,
                self.events,
                probe.surface_functions,
                probe.limits,
                probe.resets,
                tuple(probe.kinks),
                probe.dependences(),
                rate,
            )
            self._module = getattr(field, "__module__", "")
            self._parameters, self._renamed = probe.parameters, dict(regimes or {})
            self.autonomous = period is None and not probe.depends_on_time()  # type: ignore[misc]
            self.clocks = () if period is None else (TIME, TURNED)  # type: ignore[misc]
            first = TIME if period is not None else self._own[0]
            self._section_function = section if callable(section) else None
            state = SECTION if callable(section) else section or first
            self._section_state, self._level = section if isinstance(section, tuple) else (state, 0.0)
            self.redundant = (SECTION,) if callable(section) else ()  # type: ignore[misc]
            # A single autonomous state cannot return to a section unless it jumps.
            returns = section is not None and (len(self._own) > 1 or isinstance(self, HasImpacts))
            self._measured = period is not None or returns
            function = self._section_function or (lambda t, y, p: y[self._section_state] - self._level)
            self._at_section = probe.events_at(function) if self._measured and period is None else {}
            speeds = self._flow.structure.speeds
            # The error of these positions follows from that of their velocities.
            self._integrated = frozenset(speeds) if set(speeds) < set(states) else frozenset()
            self._declare(states, speeds, probe.surfaces())
            self.usual_times = self._times()  # type: ignore[misc]
        DEFINED[name] = self

    def _declare(self, units: Mapping[str, str], speeds: Mapping[str, str], surfaces: set[str]) -> None:
        """Set the declarations of a scene; `speeds`: the rate of change of each state that has one among the states."""
        hidden = {TIME: "s"} if not self.autonomous else {}
        hidden |= {APPROACH: "1"} if isinstance(self, HasImpacts) else {}
        hidden |= dict.fromkeys(self.redundant, "1")
        section_state = self._section_state
        shown = [
            State(name, unit, name, True, offset=self._level if name == section_state else 0.0)
            for name, unit in units.items()
        ]
        shown += [State(name, "1", name, True) for name in self._discrete]
        turning = [speed for speed in dict.fromkeys(speeds.values()) if speed not in (section_state, *surfaces)]
        swings: tuple[Swing, ...] = tuple(
            Swing(name, speeds[name] if speeds.get(name) in turning else None, f"{name}_amplitude") for name in units
        )
        if self.autonomous and len(self._own) == 1:  # a single state that jumps
            swings = (*swings, Swing(APPROACH, None, f"{APPROACH}_amplitude"))
        self.states = (*shown, *(State(name, unit, name, shown=False) for name, unit in hidden.items()))  # type: ignore[misc]
        modes = (*map(_mode, self.events), *map(_mode_of_kink, self._flow.kinks))
        self.modes = modes or (Mode("flow", "0", 0.0),)  # type: ignore[misc]
        self.markers = (Marker("strobe", section_state), *(Marker(f"{speed}_zero", speed) for speed in turning))  # type: ignore[misc]
        if not self._measured:
            self.markers = self.markers[1:]  # type: ignore[misc]
        section = Section(tuple(swings), self._rearm, at=section_state, typical=lambda c: c.typical)
        self.section = section if self._measured else None  # type: ignore[misc]
        self.starts, self.start_states, self.measures = ("zero",), self._own, ()  # type: ignore[misc]
        if self.fault(tuple(jnp.ones(()) for _ in self.modes)) is not None:
            self.measures = ("faults",)  # type: ignore[misc]
        if isinstance(self, ImpactSystem):
            defaults = {key: Plain.of(parameter.default) for key, parameter in self._parameters.items()}
            self.impact_unit = impact_unit(self.events, units, speeds, defaults)
        # The return map of a single autonomous state has no other state.
        alone = self.autonomous and len(self._own) == 1
        self.drifting = (APPROACH,) if isinstance(self, HasImpacts) and not alone else ()  # type: ignore[misc]

    def __reduce__(self) -> Any:
        # The functions of a system cannot be pickled if they are lambdas. Other processes import the system instead.
        module = sys.modules.get(self._module, None)
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
            c, flow = self.constants(p), self._flow
            t = 0.0 * c.rates[0]
            zero = dict.fromkeys(self._own, t) | {name: t + x for name, x in self._discrete.items()}
            mode = free_modes(flow, c, t, zero, t)
            fields = [lambda t, y, sides=sides: flow.field(c, mode, t, y, sides) for sides in flow.combinations()]
            return [flow.jacobian(field, t, zero) for field in fields]

        matrices = np.array(jax.jit(jacobians)(p), float)
        values = np.linalg.eigvals(matrices[np.isfinite(matrices).all(axis=(1, 2))]).ravel()
        turning, moving = np.abs(values.imag), np.abs(values)
        turns = turning > TURNING_SHARE * moving
        chosen = turning[turns] if turns.any() else moving[moving > 0]
        rate = float(max(self.constants(p).rates)) if not chosen.size else chosen.min()
        return float(rate) if np.isfinite(rate) else 1.0

    def _rearm(self, c: SystemConstants) -> Any:
        if self._period is None:
            return jnp.zeros_like(c.typical[self._section_state])
        return -0.1 * c.period

    @property
    def regime_names(self) -> Mapping[str, str]:
        usual = super().regime_names
        return self._renamed | {name: self._renamed.get(own, own) for name, own in usual.items()}

    def parameters(self) -> Mapping[str, Parameter]:
        return self._parameters


class ImpactSystem(System, HasImpacts[SystemConstants]):
    """A system with stops; its impacts are counted and their velocities measured."""

    def impact_rate(self, c: SystemConstants, mode: Values, state: Values) -> Any:
        return state[self.place(APPROACH)]

    def impact_begins(self, c: SystemConstants, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        masks = [
            hits[event.name] & (event.happens(mode[index]) if isinstance(event, Impact) else (mode[index] < 0))
            for index, event in enumerate(self.events)
            if _is_impact(event)
        ]
        return jnp.stack(masks).any(axis=0)


def impact_unit(
    events: Sequence[Event], units: Mapping[str, str], speeds: Mapping[str, str], p: Mapping[str, Any]
) -> str:
    """Return the unit of impact velocities: of the rate of the first gap or contact that is a sum of states.

    Otherwise it is the unit of the first struck velocity, else of the rate of the first state on which a contact
    depends. `speeds`: the rate of change of each state that has one among the states; `p`: values of the parameters.
    """
    rates = {name: units[speeds[name]] if name in speeds else _per_second(unit) for name, unit in units.items()}
    y = {name: Plain.of(0.3 + 0.2 * number) for number, name in enumerate(units)}
    groups: list[list[str]] = [[], [], []]
    for event in filter(_is_impact, events):
        surface = lambda t, y, event=event: event.surface(t, y, p)  # noqa: E731
        slopes = {
            name: float(slope_along(surface, Plain.of(0.1), y, [float(other == name) for other in y], 0.0))
            for name in y
        }
        known = list(dict.fromkeys(rates[name] for name, slope in slopes.items() if slope != 0))
        groups[0] += known if len(known) == 1 and all(abs(slope) in (0, 1) for slope in slopes.values()) else []
        groups[1] += [units[event.velocity]] if isinstance(event, Impact) and event.velocity else []
        groups[2] += known
    return [*groups[0], *groups[1], *groups[2], ImpactSystem.impact_unit][0]


def _per_second(unit: str) -> str:
    """Return the unit of a rate of change of a quantity with the unit `unit`."""
    powers = {base: int(power or 1) for base, power in re.findall(r"([^\W\d]+)(-?\d+)?", unit)}
    powers["s"] = powers.get("s", 0) - 1
    return " ".join(base if power == 1 else f"{base}{power}" for base, power in powers.items() if power) or "1"


def _is_impact(event: object) -> bool:
    return isinstance(event, Impact) or (isinstance(event, Switch) and event.impact)


def _mode(event: Event) -> Mode:
    if isinstance(event, Impact):
        return Mode(event.name, "1 at rest on the stop, -1 after leaving it along a tangent, else 0", 0.0)
    return Mode(event.name, "sign of the side, 0 on the surface; twice the sign after leaving it along a tangent", 1.0)


def _mode_of_kink(kink: Kink) -> Mode:
    if kink.whole:
        return Mode(kink.name, f"floor in {kink.place}", 0.0)
    return Mode(kink.name, f"formula in use at a kink in {kink.place}: sign of the difference", 2.0)


def _system_of(module: str, name: str) -> Any:
    return getattr(import_module(module), name)
