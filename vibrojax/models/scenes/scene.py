"""What a scene is: a hybrid dynamical system of the drill, from which steppers, measures and pictures follow.

Within a mode the motion follows a vector field. It ends where a guard's function passes zero; a reset then gives the
mode and the state in which it goes on. Markers are zeros of states, velocities mostly, that are landed on to measure
there.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

import jax.numpy as jnp

from vibrojax.models.arrays import Array
from vibrojax.models.physics.parameters import Parameter
from vibrojax.models.scenes.declared import Guard, Marker, Mode, Section, Start, State, Values

ROUNDINGS = 64
"""Values of so many roundings of a typical one count as zero."""

SLOPE_ROUNDINGS = 16
"""How many times that a first-order change over a step counts as zero."""

ARMED_BELOW = 0.05
"""Part of the drive speed by which the bit must have been slower than the drive before it can overtake it again."""


C = TypeVar("C")
"""The constants of a scene: a NamedTuple of arrays (lanes)."""


class Scene(ABC, Generic[C]):
    """A hybrid dynamical system.

    A scene is a class, a frozen dataclass whose fields are what is chosen once for all lanes (a friction law, say);
    its objects are passed to `simulate` or a sweep where a name stands. One of the package is a file in this folder
    that names its classes in `SCENES`. All that there is to write are the attributes and abstract methods below;
    what some scenes have beyond that are the capabilities of [vibrojax.models.scenes.capabilities][].

    All functions take arrays of one shape (lanes) and are pure; `field` and the guards' functions also take Taylor
    series, so they are written with +, -, *, / and [vibrojax.models.physics.elementary][].

    - `name`: what sweep files call it.
    - `states`: the continuous states; `modes`: the discrete ones, floats such as 0, 1, -1.
    - `markers`: states, velocities mostly, whose zeros are landed on.
    - `section`: where returns are counted; None for a scene that is driven by pulses, and measured over them.
    - `starts`: names of the states it may start from, the usual one first; `start_states`: those that a vector gives
      as a start, all others being zero; none where it always starts the same.
    - `measures`: what is measured of it: names or objects of gauges, see [vibrojax.measures][].
    - `autonomous`: whether nothing acts on it that changes with time, so that a state at rest stays.
    - `drifting`: states that go on growing and on which nothing depends: no part of the return map.

    **Example:**

    >>> class OnTheMoon(vj.SCENES["rotary"]):  # one of the package, with another default
    ...     name = "on-the-moon"
    ...
    ...     def parameters(self):
    ...         gravity = vj.parameters.positive("g", 1.62, "m s-2", "gravity", "g")
    ...         return super().parameters() | vj.parameters.table(gravity)
    >>> motion = vj.simulate(OnTheMoon(), start="stuck", duration=4.0, progress=False)
    >>> round(float(abs(motion.friction_force).max()))  # N, where the bit breaks loose: 0.4 m1 g
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
    autonomous: ClassVar[bool] = True
    drifting: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def parameters(self) -> Mapping[str, Parameter]:
        """The parameters that the scene has, by name."""

    @abstractmethod
    def constants(self, p: Mapping[str, Any]) -> C:
        """What the equations need, from the parameters `p` by name."""

    @abstractmethod
    def start(self, c: C, name: Start, shape: tuple[int, ...]) -> Values:
        """State at t = 0 for a named start or a vector, arrays of `shape`."""

    @abstractmethod
    def mode_at(self, c: C, state: Values) -> Values:
        """The mode in which the motion goes on from `state`."""

    @abstractmethod
    def field(self, c: C, mode: Values, state: Values) -> Values:
        """Time derivatives of the states within a mode."""

    @abstractmethod
    def guards(self) -> tuple[Guard, ...]:
        """The guards; always the same ones, in one order."""

    @abstractmethod
    def reset(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        """Mode and state after the guard that is hit, by name (booleans); at most one is, and in most lanes none."""

    @abstractmethod
    def rate(self, c: C, mode: Values) -> Any:
        """The fastest rate of change in the mode [1/s]; the step follows from it."""

    @abstractmethod
    def speed_scale(self, c: C) -> Any:
        """A typical velocity [m/s], against which a step's error is weighed."""

    # What most scenes leave as it is.

    def refused(self, p: Mapping[str, Any]) -> tuple[str, Any] | None:
        """Why lanes cannot be run as they are asked for: a text and a mask (lanes,), or None where all can be."""
        return None

    def scaled(self, c: C, state: Values) -> C:
        """The constants for a motion from `state`, where that is much faster than what they alone let expect."""
        return c

    def validity(self, c: C, mode: Values, polynomials: tuple[list[Array], ...]) -> Any:
        """Part of a step over which the field is what its Taylor series say, where these cannot tell; None: they can.

        `polynomials` are the states' coefficients in time over the step's length.
        """
        return None

    def velocity_resolution(self, c: C) -> Any:
        """Velocities [m/s] that count as zero."""
        scale = self.speed_scale(c)
        return ROUNDINGS * jnp.finfo(scale.dtype).eps * scale

    def smoothed_field(self, c: C, mode: Values, state: Values, width: Any) -> Values:
        """Time derivatives of the states with switches of a velocity spread over `width` [m/s]."""
        return self.field(c, mode, state)

    def smoothed_mode(self, c: C, mode: Values, state: Values, width: Any) -> Values:
        """The mode by which a smoothed motion is measured: it sticks where it slides slower than `width` [m/s]."""
        return mode

    def driving_part(self) -> "Scene[Any]":
        """The scene without what is only driven and acts on nothing: its orbits are those of this one."""
        return self

    # What steppers and measures ask for, which follows from the above.

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
        """Names of all that a step may end on."""
        return (*self.guard_names, *self.marker_names)

    @property
    def velocities(self) -> tuple[int, ...]:
        """Places of the velocities among the states."""
        return tuple(place for place, state in enumerate(self.states) if state.is_velocity)

    @property
    def return_states(self) -> tuple[str, ...]:
        """Names of the states at the section, which the return map takes to those of the next return; none without one.

        First those in which repeats are looked for; the section's velocity is zero there, and what drifts is none.
        """
        if self.section is None:
            return ()
        compared = self.section.compared
        known = {*compared, self.section.velocity, *self.drifting}
        return (*compared, *(name for name in self.state_names if name not in known))

    def place(self, name: str) -> int:
        """Place of a state, by its name."""
        return self.state_names.index(name)

    def mode_place(self, name: str) -> int:
        """Place of a discrete state, by its name."""
        return self.mode_names.index(name)

    def marker_of(self, velocity: str) -> str:
        """Name of the marker at the zeros of a velocity."""
        return next(marker.name for marker in self.markers if marker.velocity == velocity)

    def guard_values(self, c: C, mode: Values, state: Values, smoothed: bool = False) -> Values:
        """The guards' functions; a switch that is spread out (`smoothed`) is never reached."""
        return tuple(
            0.0 * state[0] + 1.0 if smoothed and guard.is_switch else guard.function(c, mode, state)
            for guard in self.guards()
        )

    def marker_values(self, state: Values) -> Values:
        """The markers' velocities."""
        return tuple(state[self.place(marker.velocity)] for marker in self.markers)

    def resolutions(self, c: C, mode: Values, marked: bool = True) -> Values:
        """Values of the guards, and of the markers if these are `marked`, that count as zero."""
        speed = self.velocity_resolution(c)
        return (*(guard.resolution(c, mode) for guard in self.guards()), *(speed for _ in self.markers if marked))

    def slope_resolutions(self, c: C, mode: Values, h: Any, marked: bool = True) -> Values:
        """First-order changes of them over a step `h` [s] that count as zero where it starts from zero."""
        found = [
            SLOPE_ROUNDINGS * guard.resolution(c, mode)
            if guard.slope_resolution is None
            else guard.slope_resolution(c, mode, h)
            for guard in self.guards()
        ]
        speed = SLOPE_ROUNDINGS * self.velocity_resolution(c)
        return (*found, *(speed for _ in self.markers if marked))

    def after_event(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        """Mode and state after the guard or marker that is hit."""
        turned = list(state)
        for marker in self.markers:
            place = self.place(marker.velocity)
            turned[place] = jnp.where(hits[marker.name], 0.0, turned[place])
        return self.reset(c, mode, tuple(turned), hits)
