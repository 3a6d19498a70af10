"""Declarations of a scene: states, modes, markers, guards, and the Poincaré section."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

Values = tuple[Any, ...]
"""One value per continuous state, or one per discrete state: arrays of one shape (lanes), or Taylor series."""

Start = str | tuple[Any, ...] | None
"""An initial condition: a name, or a vector with the values of `start_states` (scalars, or one value per lane). None
is for a scene with a single initial condition."""


class State(NamedTuple):
    """A continuous state: name, unit and meaning.

    `is_velocity`: True to include the state in the error of a step. The error of a step is measured on velocities,
    relative to [vibrojax.scenes.scene.Scene.speed_scale][], so choose units in which velocities have similar
    magnitudes. `shown`: False to leave the state out of trajectories. `offset`: constant that trajectories add to the
    state.

    **Example:**

    >>> vj.State("v1", "m s-1", "velocity of the bit", is_velocity=True).unit
    'm s-1'
    >>> [state.name for state in vj.SCENES["rotary"]().states]
    ['x1', 'v1', 'x2', 'v2']
    """

    name: str
    unit: str
    long_name: str
    is_velocity: bool = False
    shown: bool = True
    offset: float = 0.0


class Mode(NamedTuple):
    """A discrete state: its name, the `meaning` of its values, and the value `calmest`, at which the motion is slowest.

    **Example:**

    >>> [(mode.name, mode.calmest) for mode in vj.SCENES["vibro-impact"]().modes]
    [('slip', 1.0), ('touching', 0.0)]
    """

    name: str
    meaning: str
    calmest: float


class Marker(NamedTuple):
    """A state, mostly a velocity, that serves as an event function: a step ends where the state crosses zero.

    Where a step ends at a zero of a marker, the state is set to exactly zero. The field `velocity` holds the name of
    the state. A marker that is not a velocity, such as the phase of a forcing, must have values of the magnitude of
    `speed_scale`. No guard may have the same zeros as a marker.

    **Example:**

    >>> vj.SCENES["vibro-impact"]().markers[0]
    Marker(name='bit_turn', velocity='v1')
    """

    name: str
    velocity: str


@dataclass(frozen=True)
class Guard:
    """A condition that ends a mode of the scene, such as sticking.

    - `name`: name of the guard, and its key in `hits`.
    - `function`: a function of arrays or Taylor series, `function(constants, mode, state)`, which is positive while the
      mode lasts and zero at the end of the mode.
    - `resolution`: function `resolution(constants, mode)`, which returns the magnitude up to which a value of the guard
      counts as zero.
    - `slope_resolution`: function `slope_resolution(constants, mode, h)`; if the first-order change of the guard over a
      step `h` [s] is smaller than the returned value, the change counts as zero. By default, this value is 16 times
      `resolution`.
    - `is_switch`: True if the vector field jumps at the guard, as it does where dry friction changes its sign. A
      smoothing stepper spreads the jump of the field over a width of velocities.

    **Example:**

    >>> wall = vj.Guard("wall", lambda c, mode, y: 1.0 - y[0], resolution=lambda c, mode: 1e-14)
    >>> wall.function(None, (), (0.25, 0.0))  # distance to x = 1
    0.75
    >>> [guard.name for guard in vj.SCENES["vibro-impact"]().guards()]
    ['friction', 'contact']
    """

    name: str
    function: Callable[[Any, Values, Values], Any]
    resolution: Callable[[Any, Values], Any]
    slope_resolution: Callable[[Any, Values, Any], Any] | None = None
    is_switch: bool = False


class Swing(NamedTuple):
    """Names of an oscillating state, of its rate of change, and of the dataset variable for its amplitude.

    The amplitude is half the peak-to-peak range of the state `position`. If the `velocity` of a swing is also a marker,
    steps end at the turning points of the position. If the section has the field `at`, the first swing may have the
    velocity None.

    **Example:**

    >>> vj.SCENES["vibro-impact"]().section.swings[1]
    Swing(position='x2', velocity='v2', amplitude='striker_amplitude')
    """

    position: str
    velocity: str | None
    amplitude: str


@dataclass(frozen=True)
class Section:
    """The Poincaré section, which is defined by zeros of a state.

    The field `swings` lists the oscillating states. The field `at` names the state whose zeros define the section; the
    default is the `velocity` of the first swing. The scene needs a marker for this state. At the section, the state
    crosses zero upwards if `rising` is True, else downwards. Between two crossings of the section, the state must pass
    the level `rearm(constants)` in the opposite direction, so that fluctuations about zero do not count. Periodicity is
    checked on the positions of all `swings`, and on the velocities of all swings but the first. For this check, a
    position is divided by its amplitude a, and a velocity by 2 pi a/T, where T is the time between crossings.

    To make a periodically forced system autonomous, add the phase of the forcing as a state. Add an event that reduces
    the phase by one full period, at a phase other than zero.

    If `typical(constants)` returns typical magnitudes of the positions by name, periodic motions are detected as in a
    `vj.System`.

    **Example:**

    >>> section = vj.Section((vj.Swing("x", "v", "amplitude"),), rearm=lambda c: -0.1, at="phase")
    >>> section.velocity, section.compared
    ('phase', ('x',))
    """

    swings: tuple[Swing, ...]
    rearm: Callable[[Any], Any]
    rising: bool = True
    at: str | None = None
    typical: Callable[[Any], Mapping[str, Any]] | None = None

    @property
    def velocity(self) -> str:
        """Name of the state whose zeros define the section."""
        state = self.at or self.swings[0].velocity
        assert state is not None, "a section without `at` needs a first swing with a velocity"
        return state

    @property
    def compared(self) -> tuple[str, ...]:
        """Names of the states on which periodicity is checked."""
        first, *others = self.swings
        positions = {swing.position for swing in self.swings}
        # A velocity that is a position as well is compared by its own amplitude.
        pairs = ((other.position, None if other.velocity in positions else other.velocity) for other in others)
        names = (first.position, *(name for pair in pairs for name in pair))
        return tuple(name for name in names if name is not None and name != self.velocity)

    def scales(self, amplitudes: Sequence[Any], period: Any) -> list[Any]:
        """Return the scales of the compared states.

        The scale of a position is its amplitude, and the scale of a velocity is the amplitude times 2 pi/`period`.

        `amplitudes`: amplitudes of the swings, in order.
        """
        scale = {swing.position: half for swing, half in zip(self.swings, amplitudes, strict=True)}
        for swing, half in zip(self.swings, amplitudes, strict=True):
            if swing.velocity is not None and swing.velocity not in scale:
                scale[swing.velocity] = half * 2 * math.pi / period
        return [scale[name] for name in self.compared]
