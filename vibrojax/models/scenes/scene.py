"""The base class of all scenes: a hybrid dynamical system, from which steppers, measures and pictures follow.

Within a mode the motion follows a vector field. The mode ends where a guard's function passes zero; a reset then gives
the next mode and state. Markers are zeros of states, mostly velocities, on which steps end to be measured there.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

import jax.numpy as jnp

from vibrojax.models.arrays import Array
from vibrojax.models.physics.parameters import Parameter
from vibrojax.models.scenes.declared import Guard, Marker, Mode, Section, Start, State, Values

ROUNDINGS = 64
"""Number of roundings of a typical value up to which a value counts as zero."""

SLOPE_ROUNDINGS = 16
"""Multiple of that up to which a first-order change over a step counts as zero."""

ARMED_BELOW = 0.05
"""Part of the drive speed by which the bit must fall behind the drive before it can overtake it again."""

C = TypeVar("C")
"""The constants of a scene: a NamedTuple of arrays (lanes)."""


class Scene(ABC, Generic[C]):
    """A hybrid dynamical system.

    A scene is a frozen dataclass whose fields are the options chosen once for all lanes, such as a friction law. Pass
    an object of it to `simulate` or a sweep instead of a name. A scene of the package is a class in a file of this
    folder that lists its classes in `SCENES`. A scene defines the attributes and abstract methods below; further
    features that only some scenes have are in [vibrojax.models.scenes.capabilities][].

    All functions are pure and take arrays of one shape (lanes). `field` and the guards' functions also take Taylor
    series, so they use +, -, *, / and [vibrojax.models.physics.elementary][].

    - `name`: its name in sweep files.
    - `states`: the continuous states; `modes`: the discrete ones, floats such as 0, 1, -1.
    - `markers`: states, mostly velocities, on whose zeros steps end.
    - `section`: the section at which returns are counted; None for a scene measured over the pulses that drive it.
    - `starts`: names of the states it may start from, the default first; `start_states`: the states that a start given
      as a vector contains, all others being zero; none if there is only one start.
    - `measures`: names or objects of the gauges that measure it, see [vibrojax.measures][].
    - `choices`: for each option given by name, a registry of the values by name. An option that is a field of the
      dataclass takes the registry's value as it is (`friction`, `pulse_shape`). Any other option is short for several
      parameters: those that the value has as attributes (`rock` for `threshold` and `k3`). A subclass extends its
      base's: `choices = Base.choices | {"shape": {"flat": FLAT}}`. Code that reads input finds the options here.
    - `autonomous`: True if nothing that acts on it changes with time, so that a state at rest stays at rest.
    - `drifting`: states that keep growing and on which nothing depends: they are not part of the return map.

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
    autonomous: ClassVar[bool] = True
    drifting: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def parameters(self) -> Mapping[str, Parameter]:
        """Return the scene's parameters, by name."""

    @abstractmethod
    def constants(self, p: Mapping[str, Any]) -> C:
        """Return the constants of the equations for the parameters `p`, by name."""

    @abstractmethod
    def start(self, c: C, name: Start, shape: tuple[int, ...]) -> Values:
        """Return the state at t = 0 for a named start or a vector, arrays of `shape`."""

    @abstractmethod
    def mode_at(self, c: C, state: Values) -> Values:
        """Return the mode in which the motion continues from `state`."""

    @abstractmethod
    def field(self, c: C, mode: Values, state: Values) -> Values:
        """Return the time derivatives of the states within a mode."""

    @abstractmethod
    def guards(self) -> tuple[Guard, ...]:
        """Return the guards, always the same ones in the same order."""

    @abstractmethod
    def reset(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        """Return mode and state after an event; `hits` has a mask per guard, at most one of them True in a lane."""

    @abstractmethod
    def rate(self, c: C, mode: Values) -> Any:
        """Return the fastest rate of change in the mode [1/s], from which the step length follows."""

    @abstractmethod
    def speed_scale(self, c: C) -> Any:
        """Return a typical velocity [m/s], relative to which a step's error is measured."""

    # Most scenes keep these defaults.

    def refused(self, p: Mapping[str, Any]) -> tuple[str, Any] | None:
        """Return why lanes cannot run, a text and a mask (lanes,); None if all can."""
        return None

    def scaled(self, c: C, state: Values) -> C:
        """Return the constants for a motion from `state`, which may be much faster than they alone suggest."""
        return c

    def validity(self, c: C, mode: Values, polynomials: tuple[list[Array], ...]) -> Any:
        """Return the part of a step over which the field's Taylor series hold; None if the series themselves show it.

        `polynomials` are the states' coefficients in time divided by the step's length.
        """
        return None

    def velocity_resolution(self, c: C) -> Any:
        """Return the velocity [m/s] up to which a velocity counts as zero."""
        scale = self.speed_scale(c)
        return ROUNDINGS * jnp.finfo(scale.dtype).eps * scale

    def smoothed_field(self, c: C, mode: Values, state: Values, width: Any) -> Values:
        """Return the time derivatives with switches of a velocity spread over `width` [m/s]."""
        return self.field(c, mode, state)

    def smoothed_mode(self, c: C, mode: Values, state: Values, width: Any) -> Values:
        """Return the mode to measure a smoothed motion by: it sticks while it slides slower than `width` [m/s]."""
        return mode

    def driving_part(self) -> "Scene[Any]":
        """Return the scene without the parts that are driven and act on nothing; its orbits are the orbits of both."""
        return self

    # Steppers and measures use these, which follow from the declarations.

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(state.name for state in self.states)

    @property
    def mode_names(self) -> tuple[str, ...]:
        """Names of the discrete states."""
        return tuple(mode.name for mode in self.modes)

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
        """Names of all events that may end a step."""
        return (*self.guard_names, *self.marker_names)

    @property
    def velocities(self) -> tuple[int, ...]:
        """Places of the velocities among the states."""
        return tuple(place for place, state in enumerate(self.states) if state.is_velocity)

    @property
    def return_states(self) -> tuple[str, ...]:
        """Names of the return map's states, those in which repeats are searched first; none without a section.

        The section's velocity, which is zero there, and drifting states are left out.
        """
        if self.section is None:
            return ()
        compared = self.section.compared
        known = {*compared, self.section.velocity, *self.drifting}
        return (*compared, *(name for name in self.state_names if name not in known))

    def place(self, name: str) -> int:
        """Return the place of a state, by its name."""
        return self.state_names.index(name)

    def mode_place(self, name: str) -> int:
        """Return the place of a discrete state, by its name."""
        return self.mode_names.index(name)

    def marker_of(self, velocity: str) -> str:
        """Return the name of the marker at the zeros of a velocity."""
        return next(marker.name for marker in self.markers if marker.velocity == velocity)

    def guard_values(self, c: C, mode: Values, state: Values, smoothed: bool = False) -> Values:
        """Return the guards' functions; if `smoothed`, a switch that is spread out is never reached."""
        return tuple(
            0.0 * state[0] + 1.0 if smoothed and guard.is_switch else guard.function(c, mode, state)
            for guard in self.guards()
        )

    def marker_values(self, state: Values) -> Values:
        """Return the markers' velocities."""
        return tuple(state[self.place(marker.velocity)] for marker in self.markers)

    def resolutions(self, c: C, mode: Values, marked: bool = True) -> Values:
        """Return the values of the guards, and if `marked` of the markers, that count as zero."""
        speed = self.velocity_resolution(c)
        return (*(guard.resolution(c, mode) for guard in self.guards()), *(speed for _ in self.markers if marked))

    def slope_resolutions(self, c: C, mode: Values, h: Any, marked: bool = True) -> Values:
        """Return their first-order changes over a step `h` [s] that count as zero if the step starts from zero."""
        slopes = [
            SLOPE_ROUNDINGS * guard.resolution(c, mode)
            if guard.slope_resolution is None
            else guard.slope_resolution(c, mode, h)
            for guard in self.guards()
        ]
        speed = SLOPE_ROUNDINGS * self.velocity_resolution(c)
        return (*slopes, *(speed for _ in self.markers if marked))

    def after_event(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        """Return mode and state after the guard or marker that is hit."""
        turned = list(state)
        for marker in self.markers:
            place = self.place(marker.velocity)
            turned[place] = jnp.where(hits[marker.name], 0.0, turned[place])
        return self.reset(c, mode, tuple(turned), hits)
