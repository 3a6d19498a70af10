"""What only some scenes have: measures, pictures and checks ask for these by type.

A scene has a capability by inheriting from it and writing its few abstract methods.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from vibrojax.models.physics import rock
from vibrojax.models.physics.friction import FrictionLaw
from vibrojax.models.scenes.declared import Values
from vibrojax.models.scenes.scene import C, Scene


class Bit(NamedTuple):
    """What friction acts on: its `mass` [kg], its `weight` [N], and the `drive_speed` [m/s] of the rock under it."""

    mass: Any
    weight: Any
    drive_speed: Any


class HasFriction(Scene[C]):
    """A bit that slides on the rock with dry friction.

    Its mode `slip` is sgn u of the sliding speed u = x1' + v, and 0 where the bit sticks; `bit_velocity` names x1'.

    **Example:**

    >>> scene = vj.SCENES["vibro-impact"]()
    >>> isinstance(scene, vj.HasFriction)
    True
    >>> constants = scene.constants({name: one.default for name, one in scene.parameters().items()})
    >>> f"{float(scene.bit(constants).weight):.1f} N, {scene.spring_rate(constants):.0f} rad/s"
    '2452.5 N, 25 rad/s'
    """

    friction: FrictionLaw
    bit_velocity: ClassVar[str] = "v1"

    @abstractmethod
    def bit(self, c: C) -> Bit:
        """The bit."""

    @abstractmethod
    def pull(self, c: C, state: Values) -> Any:
        """Force of the springs on the bit [N]; takes arrays and series. Friction is what they do not give to it."""

    @abstractmethod
    def flight_rate(self, c: C) -> Any:
        """A bound on the fastest rate of change [1/s] without impact, by which lanes that are too stiff are found."""

    @abstractmethod
    def spring_rate(self, c: C) -> Any:
        """Rate [rad/s] of the bit on its main spring, which steps must resolve."""

    def typical_speed(self, c: C) -> Any:
        """A speed [m/s] against which a drive that is much slower passes for standing still."""
        return self.speed_scale(c)


class HasContact(Scene[C]):
    """A striker that hits the bit, or a stop: the mode `touching` is 1 while it does, the guard `contact` begins and
    ends it. Impacts are measured, and labels count them.

    **Example:**

    >>> scene = vj.SCENES["vibro-impact"]()
    >>> isinstance(scene, vj.HasContact)
    True
    >>> constants = scene.constants({name: one.default for name, one in scene.parameters().items()})
    >>> f"{scene.striker_mass(constants):.0f} kg, {1e3 * scene.contact_time(constants):.2f} ms"
    '100 kg, 4.44 ms'
    """

    @abstractmethod
    def contact_force(self, c: C, mode: Values, state: Values) -> Any:
        """J [N], zero where they do not touch; takes arrays and series."""

    @abstractmethod
    def impact_rate(self, c: C, mode: Values, state: Values) -> Any:
        """Rate at which the contact is compressed [m/s]; where an impact begins, the impact velocity."""

    @abstractmethod
    def impact_begins(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        """Where an impact begins: booleans, from the mode before and the state after an event, and what was hit."""

    @abstractmethod
    def striker_mass(self, c: C) -> Any:
        """Mass that hits [kg]."""

    @abstractmethod
    def contact_time(self, c: C) -> Any:
        """Duration of an impact [s], the bit held (eq. 5.7)."""

    @abstractmethod
    def contact_rate(self, c: C) -> Any:
        """What the contact's spring and damper add to the fastest rate of change [1/s]."""


class HasRock(Scene[C]):
    """A bit that is driven into the rock.

    Its states `compression` = x3 - x4, `v3` = x3' and `growth` of x4 since it was last set back to zero, and its mode
    `rock` (0 elastic, 1 yielding, -1 off the rock, 2 at rest), are those of [vibrojax.models.scenes.bit_on_rock][].

    **Example:**

    >>> scene = vj.SCENES["penetration"]()
    >>> isinstance(scene, vj.HasRock)
    True
    >>> constants = scene.constants({name: one.default for name, one in scene.parameters().items()})
    >>> f"{scene.threshold(constants) / 1e3:.0f} kN, {scene.stiffness(constants) / 1e6:.0f} MN/m"
    '150 kN, 300 MN/m'
    """

    @abstractmethod
    def threshold(self, c: C) -> Any:
        """Force D [N] at which the rock yields."""

    @abstractmethod
    def stiffness(self, c: C) -> Any:
        """Stiffness k3 of the rock [N/m]."""

    @abstractmethod
    def rock_period(self, c: C) -> Any:
        """Time scale of the bit on the rock [s], sqrt(m1/k3)."""

    def rock_force(self, c: C, mode: Values, state: Values) -> Any:
        """Resistance N of the rock [N]; takes arrays and series."""
        which, compression = mode[self.mode_place("rock")], state[self.place("compression")]
        return rock.resistance(compression, self.stiffness(c), self.threshold(c), rock.part(which))


class Driven(Scene[C]):
    """A scene under a given force; where that comes in pulses, means are over whole ones.

    A return is then the beginning of a pulse; `pulse_states` are what the return map takes from one to the next.

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
        """Whether the force comes in pulses."""

    @abstractmethod
    def applied_force(self, c: C, mode: Values, state: Values) -> Any:
        """I [N]; takes arrays and series."""

    @property
    def return_states(self) -> tuple[str, ...]:
        return self.pulse_states if self.has_pulses else ()

    @abstractmethod
    def pulse_begins(self, c: C, mode: Values, hits: Mapping[str, Any]) -> Any:
        """Where a pulse begins: booleans, from the mode before an event and what was hit."""
