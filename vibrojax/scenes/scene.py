"""The base class of all scenes: a hybrid dynamical system as steppers, measures and pictures use it.

Within a mode the motion follows a vector field. The mode ends where a guard's function crosses zero; a reset then
defines the next mode and state. Markers are zeros of states, mostly velocities. Steps end on markers, so that the
motion can be measured there.
"""

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array
from vibrojax.physics.parameters import Parameter
from vibrojax.scenes.declared import Guard, Marker, Mode, Section, Start, State, Values

ROUNDINGS = 64
"""Multiple of a typical value's rounding error (machine epsilon) up to which a value counts as zero."""

SLOPE_ROUNDINGS = 16
"""Ratio of two tolerances: of a first-order change over a step that counts as zero, and of a value that does."""

ARMED_BELOW = 0.05
"""Fraction of the drive speed by which the bit must be slower than the drive before its next overtaking counts."""

C = TypeVar("C")
"""The constants of a scene: a NamedTuple of arrays (lanes)."""


class Scene(ABC, Generic[C]):
    """A hybrid dynamical system.

    A scene is a frozen dataclass. The fields of a scene are options with one value for all lanes, such as a friction
    law. A scene defines the attributes and abstract methods below.

    All methods of a scene are pure functions; all arrays that they take have the shape (lanes,). The method `field` and
    the functions of guards also take Taylor series, so write them with +, -, *, / and [vibrojax.physics.elementary][].

    - `name`: name of the scene in sweep files.
    - `states`: the continuous states; `modes`: the discrete states, with values such as 0.0, 1.0, -1.0.
    - `markers`: states, mostly velocities; a time step ends where one of these states crosses zero.
    - `section`: the Poincaré section; None if quantities are measured over the pulses of a prescribed force.
    - `starts`: names of the initial conditions, the default first.
    - `start_states`: the states that a vector of initial conditions specifies, in order; all other states begin at
      zero.
    - `measures`: the gauges (groups of measured quantities) of the scene, as objects or names.
    - `choices`: for each option that users specify by name, a registry of values by name. For an option that is a field
      of the dataclass, such as `friction`, the chosen value becomes the value of the field. For any other option, such
      as `rock`, the attributes of the chosen object, such as `threshold` and `k3`, become parameters of the scene. A
      subclass extends the registry of its base class: `choices = Base.choices | {"shape": {"flat": FLAT}}`.
    - `choice_meanings`: for each option that sets several parameters, the `long_name` of the option in datasets.
    - `autonomous`: True if the equations do not depend on time.
    - `clocks`: states and guards that depend on time alone, so that no orbit can graze them.
    - `usual_times`: default settling time and default duration of the observation [s].
    - `ends_at_once`: True if a mode may begin with a negative guard, and then ends immediately.
    - `fault_reasons`: flags of the dataset variable `reason` that state why a motion cannot continue; the first is
      "none".
    - `drifting`: states that grow without bound and do not affect other states; the return map leaves these states out.
    - `redundant`: states that the method `on_surfaces` computes from the other states.

    **Example:**

    >>> class OnTheMoon(vj.SCENES["rotary"]):  # a scene of the package with another default
    ...     name = "on-the-moon"
    ...
    ...     def parameters(self):
    ...         gravity = vj.parameters.positive("g", 1.62, "m s-2", "gravity", "g")
    ...         return super().parameters() | vj.parameters.table(gravity)
    >>> motion = vj.simulate(OnTheMoon(), start="stuck", duration=4.0, progress=False)
    >>> round(float(abs(motion.friction_force).max()))  # N, as the bit breaks loose: 0.4 m1 g
    162
    """

    name: ClassVar[str]
    states: ClassVar[tuple[State, ...]]
    modes: ClassVar[tuple[Mode, ...]]
    markers: ClassVar[tuple[Marker, ...]] = ()
    section: ClassVar[Section | None] = None
    starts: ClassVar[tuple[str, ...]] = ()
    start_states: ClassVar[tuple[str, ...]] = ()
    measures: ClassVar[tuple[Any, ...]] = ()
    choices: ClassVar[dict[str, Mapping[str, object]]] = {}
    choice_meanings: ClassVar[Mapping[str, str]] = {}
    autonomous: ClassVar[bool] = True
    clocks: ClassVar[tuple[str, ...]] = ()
    drifting: ClassVar[tuple[str, ...]] = ()
    redundant: ClassVar[tuple[str, ...]] = ()
    ends_at_once: ClassVar[bool] = False
    fault_reasons: ClassVar[tuple[str, ...]] = ()
    usual_times: ClassVar[tuple[float, float]] = (40.0, 8.0)

    @abstractmethod
    def parameters(self) -> Mapping[str, Parameter]:
        """Return the scene's parameters, by name."""

    @abstractmethod
    def constants(self, p: Mapping[str, Any]) -> C:
        """Return the constants of the equations; `p`: values of the parameters by name."""

    @abstractmethod
    def start(self, c: C, name: Start, shape: tuple[int, ...]) -> Values:
        """Return the state at t = 0 for an initial condition (a name or a vector), as arrays of the given shape."""

    @abstractmethod
    def mode_at(self, c: C, state: Values) -> Values:
        """Return the mode in which the motion continues from `state`."""

    def on_surfaces(self, c: C, mode: Values, state: Values) -> Values:
        """Return the initial state, moved onto the surfaces to which `mode` confines the motion.

        By default, the state is returned unchanged.
        """
        return state

    @abstractmethod
    def field(self, c: C, mode: Values, state: Values) -> Values:
        """Return the time derivatives of the states within a mode."""

    @abstractmethod
    def guards(self) -> tuple[Guard, ...]:
        """Return the guards (conditions that end a mode); every call must return the same guards in the same order."""

    @abstractmethod
    def reset(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        """Return mode and state after an event.

        The mapping `hits` has a mask (lanes,) for each guard and marker; in each lane, at most one of these masks is
        True.
        """

    @abstractmethod
    def rate(self, c: C, mode: Values) -> Any:
        """Return the fastest rate of change [1/s] in a mode, which determines the length of steps."""

    @abstractmethod
    def speed_scale(self, c: C) -> Any:
        """Return a typical velocity [m/s], by which the error of a step is divided."""

    # Most scenes keep these defaults.

    def refused(self, p: Mapping[str, Any]) -> tuple[str, Any] | None:
        """Return the reason for which lanes are rejected and a mask of the rejected lanes (lanes,); None if none is."""
        return None

    def start_faults(self, p: Mapping[str, Any], state: Values) -> list[tuple[str, str, Any]]:
        """Return the faults of an initial `state`: reason, message about the first lane, and mask (lanes,) of each."""
        return []

    @property
    def stops(self) -> tuple[str, ...]:
        """Names of the rigid stops, at which a velocity jumps."""
        return ()

    @property
    def may_jump(self) -> bool:
        """True if the return map may jump where an event begins, as at static friction; at stops, it is continuous."""
        return bool(self.switch_places)

    def across_impacts(self, c: C, state: Values) -> list[tuple[Any, Values]]:
        """Return, for each rigid stop, the gap over a typical gap, and the state on the other side of the impact.

        If the bodies approach, this is the state after the next impact; if the bodies separate, it is the state before
        the last impact. The method extrapolates the motion linearly to the impact, so the gap should be small; a gap
        may be negative.
        """
        return []

    def fault(self, mode: Values) -> Any:
        """Return an index into `fault_reasons` for each lane, 0 if the motion can continue; None if it always can."""
        return None

    def scaled(self, c: C, state: Values) -> C:
        """Return the constants adapted to an initial `state` that causes a much faster motion than usual.

        By default the constants are returned unchanged.
        """
        return c

    def validity(self, c: C, mode: Values, polynomials: tuple[list[Array], ...], functions: list[list[Array]]) -> Any:
        """Return the fraction of a step over which the Taylor series are valid.

        None means that the last coefficients of the series show where the series are valid. `polynomials` has the
        coefficients of the states, in time divided by the step's length, and `functions` has the coefficients of the
        guards, followed by those of the markers.
        """
        return None

    def rate_along(self, c: C, mode: Values, state: Values) -> Any:
        """Return the fastest rate of change at a state [1/s], which limits the next step; by default, `rate`."""
        return self.rate(c, mode)

    def defect_scales(self, c: C, mode: Values, state: Values, polynomials: tuple[list[Array], ...]) -> Any:
        """Return the scales of the defects of the first states.

        The defect of a state is the difference between the slope of its Taylor series at the end of a step and the
        field there, times the length of the step. If a defect exceeds its scale times the tolerance, the step is
        repeated with half its length. None means that the last coefficients of the series show where the series are
        valid.
        """
        return None

    def velocity_resolution(self, c: C) -> Any:
        """Return the magnitude [m/s] up to which a velocity counts as zero."""
        scale = self.speed_scale(c)
        return ROUNDINGS * jnp.finfo(scale.dtype).eps * scale

    def smoothed_field(self, c: C, mode: Values, state: Values, width: Any) -> Values:
        """Return the time derivatives, with the jump of friction at zero sliding speed spread over `width` [m/s]."""
        return self.field(c, mode, state)

    def smoothed_mode(self, c: C, mode: Values, state: Values, width: Any) -> Values:
        """Return the mode that gauges receive for a smoothed motion: stick at sliding speeds below `width` [m/s]."""
        return mode

    def driving_part(self) -> "Scene[Any]":
        """Return the scene without the parts that do not act on other parts; its periodic orbits are the same."""
        return self

    # The members below are derived from the declarations; steppers and measures use them.

    @property
    def presets(self) -> dict[str, dict[str, dict[str, float]]]:
        """Parameters that each value of a choice sets, for choices that are not fields of the scene, such as `rock`."""
        own = self.parameters()
        return {
            choice: {name: {key: x for key, x in vars(value).items() if key in own} for name, value in values.items()}
            for choice, values in self.choices.items()
            if not hasattr(self, choice)
        }

    @property
    def regime_names(self) -> Mapping[str, str]:
        """Names that replace the usual names of regimes; in scenes without impacts, impact-free becomes periodic."""
        return {"impact-free": "periodic"}

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(state.name for state in self.states)

    @property
    def guard_names(self) -> tuple[str, ...]:
        """Names of the guards."""
        return tuple(guard.name for guard in self.guards())

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the markers."""
        return tuple(marker.name for marker in self.markers)

    @property
    def event_names(self) -> tuple[str, ...]:
        """Names of all guards and markers on which a step may end."""
        return (*self.guard_names, *self.marker_names)

    @property
    def velocities(self) -> tuple[int, ...]:
        """Indices of the velocities among the states."""
        return tuple(place for place, state in enumerate(self.states) if state.is_velocity)

    @property
    def return_states(self) -> tuple[str, ...]:
        """Names of the return map's states; empty without a section.

        The states on which periodicity is checked come first. The section's velocity, which is zero on the section, and
        drifting states are left out.
        """
        if self.section is None:
            return ()
        compared = self.section.compared
        known = {*compared, self.section.velocity, *self.drifting}
        return (*compared, *(name for name in self.state_names if name not in known))

    def place(self, name: str) -> int:
        """Return the index of the state with this name."""
        return self.state_names.index(name)

    def mode_place(self, name: str) -> int:
        """Return the index of the discrete state with this name."""
        return [mode.name for mode in self.modes].index(name)

    @property
    def switch_places(self) -> dict[str, int]:
        """The index of the discrete state that a switch may hold at 0 (stick, slide), by the name of its guard."""
        names = [mode.name for mode in self.modes]
        switches = [guard.name for guard in self.guards() if guard.is_switch]
        return {name: names.index(name if name in names else "slip") for name in switches}

    def has_no_field(self, c: C, mode: Values, state: Values) -> Any:
        """Return a mask of states that cannot be isolated equilibria; by default, those in which the bit sticks."""
        return functools.reduce(operator.or_, [mode[place] == 0 for place in self.switch_places.values()], False)

    @property
    def named_events(self) -> tuple[str, ...]:
        """Names of the events after which a special point is named if it is due to neither an impact nor a stick."""
        return ()

    def marker_of(self, velocity: str) -> str:
        """Return the name of the marker for the zeros of a velocity."""
        return next(marker.name for marker in self.markers if marker.velocity == velocity)

    def guard_values(self, c: C, mode: Values, state: Values, smoothed: bool = False) -> Values:
        """Return the values of the guards; if `smoothed`, 1 for guards with `is_switch`, so that no step ends there."""
        return tuple(
            0.0 * state[0] + 1.0 if smoothed and guard.is_switch else guard.function(c, mode, state)
            for guard in self.guards()
        )

    def marker_values(self, state: Values) -> Values:
        """Return the values of the markers' velocities."""
        return tuple(state[self.place(marker.velocity)] for marker in self.markers)

    def error_terms(
        self, c: C, mode: Values, state: Values, polynomials: tuple[list[Array], ...]
    ) -> tuple[list[list[Array]], Any]:
        """Return the Taylor coefficients that determine the length of a step, and the scale of their error.

        By default these are the coefficients of the velocities and `speed_scale`. `state`: state at the start of the
        step.
        """
        return [polynomials[index] for index in self.velocities], self.speed_scale(c)

    def small_changes(self, c: C, state: Values) -> Values:
        """Return changes of states whose Taylor series must converge if derivatives are computed; by default, none."""
        return ()

    def changed_field(self, c: C, mode: Values, state: Values, changes: Values) -> Values:
        """Return the rates of the `small_changes`; `state`, `changes`: Taylor series."""
        raise NotImplementedError

    def resolutions(self, c: C, mode: Values, state: Values, marked: bool = True) -> Values:
        """Return, for each guard and (if `marked`) for each marker, the magnitude up to which values count as zero.

        `state`: state at the start of the step.
        """
        speed = self.velocity_resolution(c)
        return (*(guard.resolution(c, mode) for guard in self.guards()), *(speed for _ in self.markers if marked))

    def typical_guard_values(self, c: C, mode: Values, state: Values) -> Values:
        """Return, for each guard, the scale of its values in grazing margins."""
        small = self.resolutions(c, mode, state, marked=False)
        return tuple(x / (ROUNDINGS * jnp.finfo(x.dtype).eps) for x in small)

    def slope_resolutions(self, c: C, mode: Values, state: Values, h: Any, marked: bool = True) -> Values:
        """Return, for each guard and (if `marked`) for each marker, the first-order change that counts as zero.

        The change is that over a step `h` [s] that starts on a zero of the guard or marker.
        """
        slopes = [
            SLOPE_ROUNDINGS * guard.resolution(c, mode)
            if guard.slope_resolution is None
            else guard.slope_resolution(c, mode, h)
            for guard in self.guards()
        ]
        speed = SLOPE_ROUNDINGS * self.velocity_resolution(c)
        return (*slopes, *(speed for _ in self.markers if marked))

    def onto_section(self, c: C, state: Values) -> Values:
        """Return a state of the return map, moved onto the section; by default, it already lies on the section."""
        return state

    def joined(
        self, mode: Values, hits: Mapping[str, Any], falling: Mapping[str, Any]
    ) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Return `hits` and `falling`, completed for markers with the same zeros as a guard; by default, unchanged."""
        return hits, falling

    @property
    def section_on_guard(self) -> bool:
        """True if a guard has the same zeros as the section's velocity."""
        return False

    def events_of(self, mode: Values, after: Values, hits: Mapping[str, Any]) -> dict[str, Any]:
        """Return masks of further events by kind, for trajectories: not friction, impacts and section crossings.

        `mode` is the mode before the event, `after` is the mode after it, and `hits` has the masks of guards and
        markers.
        """
        return {}

    def at_rest(self, mode: Values) -> Mapping[str, Any]:
        """Return masks of the lanes at rest on a rigid stop, by name of the stop's guard; empty without rigid stops."""
        return {}

    def after_event(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        """Return mode and state after an event: the velocity of a marker that is hit becomes 0, then `reset` acts."""
        turned = list(state)
        for marker in self.markers:
            place = self.place(marker.velocity)
            turned[place] = jnp.where(hits[marker.name], 0.0, turned[place])
        return self.reset(c, mode, tuple(turned), hits)
