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

    `is_velocity` includes the state in the error of a step. That error is measured on the velocities, relative to
    [vibrojax.scenes.scene.Scene.speed_scale][], so choose units in which velocities have similar magnitudes.
    `shown`: False to leave the state out of trajectories. `offset`: constant that trajectories add to the state.

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
    """A discrete state: `name`, `meaning` of its values, and `calmest`, the value at which steps are longest.

    **Example:**

    >>> [(mode.name, mode.calmest) for mode in vj.SCENES["vibro-impact"]().modes]
    [('slip', 1.0), ('touching', 0.0)]
    """

    name: str
    meaning: str
    calmest: float


class Marker(NamedTuple):
    """An event function, the state `velocity`: steps end on its zeros in either direction, where it is set to zero.

    `velocity` need not be a velocity: any state of similar magnitude will do, such as the phase of a forcing. No guard
    may have the same zeros.

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
    - `function`: function `function(constants, mode, state)`, positive while the mode lasts and zero at its end. It
      accepts arrays and Taylor series.
    - `resolution`: function `resolution(constants, mode)`, the magnitude up to which values count as zero: a small
      multiple of the rounding error of a typical value.
    - `slope_resolution`: function `slope_resolution(constants, mode, h)`, the magnitude up to which the first-order
      change over a step `h` [s] counts as zero if the step starts on the guard; None: 16 times `resolution`.
    - `is_switch`: True for a jump of the field, such as that of dry friction, which a smoothing stepper spreads over a
      width, so that the guard is never reached.

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
    """An oscillating state `position`, the state `velocity` that is its rate of change, and the variable `amplitude`.

    `amplitude` is the variable's name for half the peak-to-peak range of the position. Steps end on the turning points
    if a marker has this velocity. `velocity` may be None if no state is the rate of change, but only in the first of
    the `swings`, and only if the section has `at`.

    **Example:**

    >>> vj.SCENES["vibro-impact"]().section.swings[1]
    Swing(position='x2', velocity='v2', amplitude='striker_amplitude')
    """

    position: str
    velocity: str | None
    amplitude: str


@dataclass(frozen=True)
class Section:
    """The Poincaré section: the zeros of the state `at`, or else of the velocity of the first of the `swings`.

    The state needs a marker and crosses zero upwards if `rising`, else downwards. Between two crossings it must have
    passed the level `rearm(constants)` in the other direction, so that a velocity that fluctuates about zero is counted
    once. Periodicity is checked on the positions of all `swings` and on the velocities of all but the first. Positions
    are scaled by the amplitude, velocities by the amplitude times 2 pi over the time between crossings.

    A periodically forced motion becomes autonomous with one additional state, the forcing's phase. A guard must reduce
    this phase by one full period, at a phase other than zero. A section `at` the phase is stroboscopic.

    `typical(constants)` returns typical magnitudes of the positions by name. With it, repeats and equilibria are
    detected as for a `vj.System`.

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
        """Return the scales of the compared states: the amplitudes, for velocities the amplitudes times 2 pi/`period`.

        `amplitudes`: amplitudes of the swings, in order.
        """
        scale = {swing.position: half for swing, half in zip(self.swings, amplitudes, strict=True)}
        for swing, half in zip(self.swings, amplitudes, strict=True):
            if swing.velocity is not None and swing.velocity not in scale:
                scale[swing.velocity] = half * 2 * math.pi / period
        return [scale[name] for name in self.compared]
