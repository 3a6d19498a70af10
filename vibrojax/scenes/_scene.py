"""What a scene is: the equations, switching surfaces and mode changes of one machine."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from vibrojax.physics.parameters import Parameter

Values = tuple[Any, ...]
Constants = Mapping[str, Any]


class Scene(ABC):
    """A hybrid dynamical system, from which steppers, measures and pictures follow.

    A scene is one file in this folder that binds the class to the name `SCENE`. Every function below takes arrays
    of one shape (lanes); `field` and `surfaces` also take Taylor series, so they are written with +, -, *, / and
    [vibrojax.physics.elementary][].

    - `name`: what sweep files call it.
    - `states`: names of the continuous states.
    - `velocities`: which of them are velocities, by index.
    - `modes`: names of the discrete states (floats: 0, 1, -1).
    - `surfaces_named`: names of the switching surfaces, in the order of `surfaces`.
    - `markers_named`: names of the markers, in the order of `markers`.
    - `starts`: names of the states it may start from.
    - `measures`: names of what is measured of it (see [vibrojax.measure][]).
    - `autonomous`: whether nothing acts on it that changes with time, so that a state at rest stays.
    """

    name: str
    states: tuple[str, ...]
    velocities: tuple[int, ...]
    modes: tuple[str, ...]
    surfaces_named: tuple[str, ...]
    markers_named: tuple[str, ...]
    starts: tuple[str, ...]
    measures: tuple[str, ...]
    autonomous: bool = True

    @abstractmethod
    def parameters(self) -> Mapping[str, Parameter]:
        """The parameters that the scene has, by name."""

    @abstractmethod
    def constants(self, p: Constants) -> Constants:
        """The parameters `p` with what follows from them.

        Among it `speed_scale`, a typical velocity [m/s], against which a step's error is weighed.
        """

    @abstractmethod
    def start(self, p: Constants, name, shape) -> Values:
        """State at t = 0 for a named start or a vector."""

    def refused(self, p: Constants):
        """Why each lane cannot be run as it is asked for: a text and a mask (lanes,), or None where all can be."""
        return None

    def scaled(self, p: Constants, state: Values) -> Constants:
        """The constants for a motion from `state`, where that is much faster than what `p` alone lets expect."""
        return p

    @abstractmethod
    def mode_at(self, p: Constants, state: Values) -> Values:
        """The mode in which the motion goes on from `state`."""

    @abstractmethod
    def field(self, p: Constants, mode: Values, state: Values) -> Values:
        """Time derivatives of the states within a mode."""

    @abstractmethod
    def smoothed_field(self, p: Constants, mode: Values, state: Values, width) -> Values:
        """Time derivatives of the states with the friction switch spread over `width` [m/s]."""

    @abstractmethod
    def smoothed_mode(self, p: Constants, mode: Values, state: Values, width) -> Values:
        """The mode of a smoothed motion, which counts as stick where it slides slower than `width` [m/s]."""

    @abstractmethod
    def smoothed_surfaces(self, p: Constants, mode: Values, state: Values) -> Values:
        """`surfaces` of a smoothed motion: a switch that is spread out is never reached."""

    @abstractmethod
    def surfaces(self, p: Constants, mode: Values, state: Values) -> Values:
        """Switching functions: positive while the mode lasts, zero where it ends."""

    @abstractmethod
    def markers(self, p: Constants, state: Values) -> Values:
        """Functions whose zeros are landed on to measure there; they change no mode."""

    @abstractmethod
    def land(self, p: Constants, mode: Values, state: Values, hits: Values) -> tuple[Values, Values]:
        """Mode and state after the surfaces and markers that are `hits` (booleans) have been reached."""

    @abstractmethod
    def resolutions(self, p: Constants, mode: Values) -> Values:
        """Values of the surfaces and markers that count as zero: a few roundings of a typical value."""

    def slope_resolutions(self, p: Constants, mode: Values, h) -> Values:
        """First-order changes of the surfaces and markers over a step `h` [s] that count as zero at its start."""
        return tuple(16 * small for small in self.resolutions(p, mode))

    def in_sight(self, p: Constants, mode: Values, polynomials: Values):
        """Part of a step over which the field goes on as its series say, where these cannot tell; None: they can."""
        return None

    @abstractmethod
    def rate(self, p: Constants, mode: Values):
        """The fastest rate of change in the mode [1/s]; the step follows from it."""
