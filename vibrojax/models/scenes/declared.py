"""What a scene declares: its states and modes, guards and markers, and the section where returns are counted."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

Values = tuple[Any, ...]
"""One value for each state, or for each discrete state: arrays of one shape (lanes), or Taylor series."""

Start = str | tuple[Any, ...] | None
"""A start: one of the scene's names, a vector of the states it gives (numbers, or arrays of lanes), or None for a scene
with only one."""


class State(NamedTuple):
    """A continuous state: its name, unit and meaning, whether it is a velocity, and whether trajectories show it.

    Errors are weighed on the velocities, against [vibrojax.models.scenes.scene.Scene.speed_scale][]: units in which
    velocities are alike in size serve best.

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
    """A discrete state: its name, what its values mean, and the value in which steps are longest.

    **Example:**

    >>> [(mode.name, mode.calmest) for mode in vj.SCENES["vibro-impact"]().modes]
    [('slip', 1.0), ('touching', 0.0)]
    """

    name: str
    meaning: str
    calmest: float


class Marker(NamedTuple):
    """Zeros of the state `velocity`, either way: steps end on them, and there it is exactly zero.

    It may be any state that is alike in size to velocities, such as the phase of what forces a motion; no guard may
    have the same zeros.

    **Example:**

    >>> vj.SCENES["vibro-impact"]().markers[0]
    Marker(name='bit_turn', velocity='v1')
    """

    name: str
    velocity: str


@dataclass(frozen=True)
class Guard:
    """What ends a mode.

    - `name`: of the guard, by which `hits` tells that it was reached.
    - `function`: `function(constants, mode, state)`, positive while the mode lasts and zero where it ends; it takes
      arrays and Taylor series.
    - `resolution`: `resolution(constants, mode)`, values of it that count as zero: a few roundings of a typical one.
    - `slope_resolution`: `slope_resolution(constants, mode, h)`, first-order changes over a step `h` [s] that count as
      zero where it starts on the guard; None: 16 times the resolution.
    - `is_switch`: whether a smoothed motion spreads it out, and so never reaches it.

    **Example:**

    >>> wall = vj.Guard("wall", lambda c, mode, y: 1.0 - y[0], resolution=lambda c, mode: 1e-14)
    >>> wall.function(None, (), (0.25, 0.0))  # so far from x = 1
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
    """A state `position`, its rate of change, the state `velocity`, and the `amplitude`: what half its swing is called.

    The turns are landed on where the velocity is a marker's. The first swing of a section `at` another state may do
    without a velocity, None: no state is its rate.

    **Example:**

    >>> vj.SCENES["vibro-impact"]().section.swings[1]
    Swing(position='x2', velocity='v2', amplitude='striker_amplitude')
    """

    position: str
    velocity: str | None
    amplitude: str


@dataclass(frozen=True)
class Section:
    """Where returns are counted: the velocity of the first swing passes zero, rising, or falling; or the state `at`.

    That state is a marker's. It must have passed the level `rearm(constants)` the other way since the last return, so
    that a velocity that trembles about zero counts once. Repeats are looked for in the positions of all swings and the
    velocities of all but the first, scaled by half the swings and by those times 2 pi over the time between returns.

    A motion under a force that repeats is the motion of an autonomous scene with one more state, the force's phase,
    which a guard sets back by a whole turn, away from zero: `at` that phase the section is stroboscopic.

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
        """The state whose zero the section is."""
        state = self.at or self.swings[0].velocity
        assert state is not None, "a section without `at` is where the velocity of its first swing passes zero"
        return state

    @property
    def compared(self) -> tuple[str, ...]:
        """Names of the states in which repeats are looked for."""
        first, *others = self.swings
        pairs = (name for other in others for name in (other.position, other.velocity))
        return (first.position, *(name for name in pairs if name is not None))
