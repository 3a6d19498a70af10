"""Features that only some scenes have: measures, pictures and checks ask for them by type.

A scene has a capability by inheriting from it and defining its abstract methods.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from vibrojax.models.physics import rock
from vibrojax.models.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.models.scenes.declared import Values
from vibrojax.models.scenes.scene import C, Scene


class Bit(NamedTuple):
    """The body under friction: its `mass` [kg], its `weight` [N], and the `drive_speed` [m/s] of the rock under it."""

    mass: Any
    weight: Any
    drive_speed: Any


class HasFriction(Scene[C]):
    """A bit that slides on the rock with dry friction.

    Its mode `slip` is sgn u of the sliding speed u = x1' + v, and 0 in stick; `bit_velocity` is the name of x1'.

    **Example:**

    >>> scene = vj.SCENES["vibro-impact"]()
    >>> isinstance(scene, vj.HasFriction)
    True
    >>> constants = scene.constants({name: parameter.default for name, parameter in scene.parameters().items()})
    >>> f"{float(scene.bit(constants).weight):.1f} N, {scene.spring_rate(constants):.0f} rad/s"
    '2452.5 N, 25 rad/s'
    """

    friction: FrictionLaw
    bit_velocity: ClassVar[str] = "v1"
    choices: ClassVar[dict[str, Mapping[str, object]]] = {"friction": FRICTION_LAWS}

    @abstractmethod
    def bit(self, c: C) -> Bit:
        """Return the bit."""

    @abstractmethod
    def pull(self, c: C, state: Values) -> Any:
        """Return the force of the springs on the bit [N], for arrays and series; friction takes the rest of m1 x1''."""

    @abstractmethod
    def flight_rate(self, c: C) -> Any:
        """Return a bound on the fastest rate of change [1/s] without impact; it shows which lanes are too stiff."""

    @abstractmethod
    def spring_rate(self, c: C) -> Any:
        """Return the rate [rad/s] of the bit on its main spring, which steps must resolve."""

    def typical_speed(self, c: C) -> Any:
        """Return the speed [m/s] compared to which a much slower drive counts as standing still."""
        return self.speed_scale(c)


class HasContact(Scene[C]):
    """A striker that hits the bit or a stop; impacts are measured, and labels count them.

    The mode `touching` is 1 in contact; the guard `contact` begins and ends it.

    **Example:**

    >>> scene = vj.SCENES["vibro-impact"]()
    >>> isinstance(scene, vj.HasContact)
    True
    >>> constants = scene.constants({name: parameter.default for name, parameter in scene.parameters().items()})
    >>> f"{scene.striker_mass(constants):.0f} kg, {1e3 * scene.contact_time(constants):.2f} ms"
    '100 kg, 4.44 ms'
    """

    @abstractmethod
    def contact_force(self, c: C, mode: Values, state: Values) -> Any:
        """Return J [N], zero out of contact; accepts arrays and series."""

    @abstractmethod
    def impact_rate(self, c: C, mode: Values, state: Values) -> Any:
        """Return the rate of compression of the contact [m/s]; at the beginning of an impact, its velocity."""

    @abstractmethod
    def impact_begins(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        """Return a mask of the impacts that begin, from the mode before and the state after an event."""

    @abstractmethod
    def striker_mass(self, c: C) -> Any:
        """Return the mass that hits [kg]."""

    @abstractmethod
    def contact_time(self, c: C) -> Any:
        """Return the duration of an impact on a fixed bit [s] (eq. 5.7)."""

    @abstractmethod
    def contact_rate(self, c: C) -> Any:
        """Return the share of the contact's spring and damper in the fastest rate of change [1/s]."""


class HasRock(Scene[C]):
    """A bit that is driven into the rock.

    Its states are `compression` = x3 - x4, `v3` = x3' and the `growth` of x4 since its last reset to zero. Its mode
    `rock` is 0 elastic, 1 yielding, -1 off the rock or 2 at rest; see [vibrojax.models.scenes.bit_on_rock][].

    **Example:**

    >>> scene = vj.SCENES["penetration"]()
    >>> isinstance(scene, vj.HasRock)
    True
    >>> constants = scene.constants({name: parameter.default for name, parameter in scene.parameters().items()})
    >>> f"{scene.threshold(constants) / 1e3:.0f} kN, {scene.stiffness(constants) / 1e6:.0f} MN/m"
    '150 kN, 300 MN/m'
    """

    choices: ClassVar[dict[str, Mapping[str, object]]] = {"rock": rock.ROCKS}

    @abstractmethod
    def threshold(self, c: C) -> Any:
        """Return the force D [N] at which the rock yields."""

    @abstractmethod
    def stiffness(self, c: C) -> Any:
        """Return the stiffness k3 of the rock [N/m]."""

    @abstractmethod
    def rock_period(self, c: C) -> Any:
        """Return the time scale of the bit on the rock [s], sqrt(m1/k3)."""

    def rock_force(self, c: C, mode: Values, state: Values) -> Any:
        """Return the resistance N of the rock [N]; accepts arrays and series."""
        which, compression = mode[self.mode_place("rock")], state[self.place("compression")]
        return rock.resistance(compression, self.stiffness(c), self.threshold(c), rock.part(which))


class Driven(Scene[C]):
    """A scene under a prescribed force; if it comes in pulses, means are over whole pulses.

    A return is then the beginning of a pulse; `pulse_states` are the states of the return map.

    **Example:**

    >>> [name for name, kind in vj.SCENES.items() if issubclass(kind, vj.Driven)]
    ['penetration']
    >>> vj.SCENES["penetration"](pulse_shape="half-sine").has_pulses
    True
    """

    pulse_states: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def has_pulses(self) -> bool:
        """True if the force comes in pulses."""

    @abstractmethod
    def applied_force(self, c: C, mode: Values, state: Values) -> Any:
        """Return I [N]; accepts arrays and series."""

    @property
    def return_states(self) -> tuple[str, ...]:
        return self.pulse_states if self.has_pulses else ()

    @abstractmethod
    def pulse_begins(self, c: C, mode: Values, hits: Mapping[str, Any]) -> Any:
        """Return a mask of the pulses that begin, from the mode before an event."""
