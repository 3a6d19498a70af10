"""Declarations of a scene: states and modes, markers and guards, and the section at which returns are counted."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

Values = tuple[Any, ...]
"""One value per state, or per discrete state: arrays of one shape (lanes), or Taylor series."""

Start = str | tuple[Any, ...] | None
"""A start: a name, a vector of `start_states` (numbers, or arrays of lanes), or None for a scene with only one."""


class State(NamedTuple):
    """A continuous state: name, unit and meaning; `is_velocity`; and `shown`, False to leave it out of trajectories.

    A step's error is measured on the velocities, relative to [vibrojax.models.scenes.scene.Scene.speed_scale][]. Choose
    units in which the velocities have similar magnitudes.

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


class Mode(NamedTuple):
    """A discrete state: its name, the meaning of its values, and the value in which steps are longest.

    **Example:**

    >>> [(mode.name, mode.calmest) for mode in vj.SCENES["vibro-impact"]().modes]
    [('slip', 1.0), ('touching', 0.0)]
    """

    name: str
    meaning: str
    calmest: float


class Marker(NamedTuple):
    """Zeros of the state `velocity` in either direction: steps end on them, and the state is exactly zero there.

    The state may be any with a magnitude like that of velocities, such as the phase of a forcing. No guard may have
    the same zeros.

    **Example:**

    >>> vj.SCENES["vibro-impact"]().markers[0]
    Marker(name='bit_turn', velocity='v1')
    """

    name: str
    velocity: str


@dataclass(frozen=True)
class Guard:
    """A condition that ends a mode.

    - `name`: the guard's key in `hits`.
    - `function`: `function(constants, mode, state)`, positive while the mode lasts and zero at its end; it accepts
      arrays and Taylor series.
    - `resolution`: `resolution(constants, mode)`, values that count as zero: a few roundings of a typical value.
    - `slope_resolution`: `slope_resolution(constants, mode, h)`, first-order changes over a step `h` [s] that count as
      zero if the step starts on the guard; None: 16 times the resolution.
    - `is_switch`: True if a smoothed motion spreads the switch over a width and so never reaches the guard.

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
    """A state `position`, its rate of change, the state `velocity`, and `amplitude`, the variable for half its swing.

    Steps end on the turns if a marker has this velocity. The first swing of a section `at` another state may have the
    velocity None: no state is its rate of change.

    **Example:**

    >>> vj.SCENES["vibro-impact"]().section.swings[1]
    Swing(position='x2', velocity='v2', amplitude='striker_amplitude')
    """

    position: str
    velocity: str | None
    amplitude: str


@dataclass(frozen=True)
class Section:
    """The Poincaré section at which returns are counted: zeros of the first swing's velocity, or of the state `at`.

    The state needs a marker and passes zero upwards if `rising`, else downwards. Since the last return it must have
    passed the level `rearm(constants)` in the other direction, so that a velocity that trembles about zero counts once.
    Repeats are searched in the positions of all swings and in the velocities of all but the first. Positions are scaled
    by half the swings, velocities by those times 2 pi over the time between returns.

    A periodically forced motion is autonomous with one more state, the forcing's phase. A guard sets that phase back by
    a whole turn, away from zero. A section `at` the phase is stroboscopic.

    **Example:**

    >>> section = vj.Section((vj.Swing("x", "v", "amplitude"),), rearm=lambda c: -0.1, at="phase")
    >>> section.velocity, section.compared
    ('phase', ('x',))
    """

    swings: tuple[Swing, ...]
    rearm: Callable[[Any], Any]
    rising: bool = True
    at: str | None = None

    @property
    def velocity(self) -> str:
        """The state whose zero defines the section."""
        state = self.at or self.swings[0].velocity
        assert state is not None, "a section without `at` needs a first swing with a velocity"
        return state

    @property
    def compared(self) -> tuple[str, ...]:
        """Names of the states in which repeats are searched."""
        first, *others = self.swings
        pairs = (name for other in others for name in (other.position, other.velocity))
        return (first.position, *(name for name in pairs if name is not None))
