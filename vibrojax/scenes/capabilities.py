"""Capabilities that only some scenes have; measures, pictures and checks test for them with `isinstance`.

A scene acquires a capability by inheriting from its class and defining the abstract methods. The functions that return
forces accept arrays and Taylor series.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from vibrojax.physics import rock
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.scenes.declared import Values
from vibrojax.scenes.scene import C, Scene


class Bit(NamedTuple):
    """The body under friction: `mass` [kg], `weight` [N], and `drive_speed` [m/s] relative to the rock."""

    mass: Any
    weight: Any
    drive_speed: Any


class HasFriction(Scene[C]):
    """A scene with a bit that slides on the rock with dry friction.

    The mode `slip` is the sign of the sliding velocity u = x1' + v, and 0 while the bit sticks. The attribute
    `bit_velocity` is the name of the state x1'.

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

    def refused(self, p: Mapping[str, Any]) -> tuple[str, Any] | None:
        law = self.friction
        if FRICTION_LAWS.get(law.name) is law:  # the ranges of their parameters exclude it
            return None
        at_rest = law.on_weight(0.0, {name: p[name] for name in law.parameters})
        return "negative-friction-at-rest", np.asarray(at_rest) < 0 * np.asarray(p["m1"])

    @abstractmethod
    def bit(self, c: C) -> Bit:
        """Return the bit's mass, weight and drive speed."""

    @abstractmethod
    def pull(self, c: C, state: Values) -> Any:
        """Return the net spring force on the bit [N]; friction is this force minus m1 x1''."""

    @abstractmethod
    def flight_rate(self, c: C) -> Any:
        """Return an upper bound on the rate of change [1/s] of the states out of contact; stiff lanes are rejected."""

    @abstractmethod
    def spring_rate(self, c: C) -> Any:
        """Return the angular frequency [rad/s] of the bit on its main spring, which the steps must resolve."""

    def typical_speed(self, c: C) -> Any:
        """Return a typical speed [m/s]; a drive that is much slower counts as standing still."""
        return self.speed_scale(c)


class HasImpacts(Scene[C]):
    """A scene in which impacts are counted and regimes depend on their number.

    **Example:**

    >>> isinstance(vj.SCENES["vibro-impact"](), vj.HasImpacts), isinstance(vj.SCENES["rotary"](), vj.HasImpacts)
    (True, False)

    `impact_unit` is the unit of impact velocities.
    """

    impact_unit: ClassVar[str] = "m s-1"

    @property
    def regime_names(self) -> Mapping[str, str]:
        return {}

    @abstractmethod
    def impact_rate(self, c: C, mode: Values, state: Values) -> Any:
        """Return the velocity of an impact [m/s], computed from the state after the event that begins the impact."""

    @abstractmethod
    def impact_begins(self, c: C, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        """Return a mask of the lanes in which an impact begins at an event.

        `mode` is the mode before the event, `state` is the state after the event, and `hits` has the masks of guards
        and markers.
        """


class HasContact(HasImpacts[C]):
    """A scene with a striker that hits the bit or a stop. The forces and energies of the impacts are measured.

    The mode `touching` is 1 while striker and bit are in contact. A contact begins and ends at zeros of the guard
    `contact`.

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
        """Return the contact force J [N], zero out of contact."""

    @abstractmethod
    def impact_rate(self, c: C, mode: Values, state: Values) -> Any:
        """Return the compression rate of the contact [m/s]; at the beginning of an impact, this is its velocity."""

    @abstractmethod
    def striker_mass(self, c: C) -> Any:
        """Return the striker's mass [kg]."""

    @abstractmethod
    def contact_time(self, c: C) -> Any:
        """Return the duration of an impact on a fixed bit [s] (Batako's thesis, eq. 5.7)."""

    @abstractmethod
    def contact_rate(self, c: C) -> Any:
        """Return the contribution of the contact's spring and damper to the fastest rate of change [1/s]."""


class HasRock(Scene[C]):
    """A scene with a bit that is driven into the rock.

    The states include the velocity `v3` = x3' of the bit, the `compression` x3 - x4 of the rock, and `growth`, the
    growth of the hole's depth x4 since `growth` was last set to zero. The mode `rock` is 0 (elastic), 1 (yielding), -1
    (bit off the rock) or 2 (bit at rest); see [vibrojax.scenes.bit_on_rock][].

    **Example:**

    >>> scene = vj.SCENES["penetration"]()
    >>> isinstance(scene, vj.HasRock)
    True
    >>> constants = scene.constants({name: parameter.default for name, parameter in scene.parameters().items()})
    >>> f"{scene.threshold(constants) / 1e3:.0f} kN, {scene.stiffness(constants) / 1e6:.0f} MN/m"
    '150 kN, 300 MN/m'
    """

    choices: ClassVar[dict[str, Mapping[str, object]]] = {"rock": rock.ROCKS}
    choice_meanings: ClassVar[Mapping[str, str]] = {"rock": "rock of Table 4.5"}

    @abstractmethod
    def threshold(self, c: C) -> Any:
        """Return the yield force D of the rock [N]."""

    @abstractmethod
    def stiffness(self, c: C) -> Any:
        """Return the stiffness k3 of the rock [N/m]."""

    @abstractmethod
    def rock_period(self, c: C) -> Any:
        """Return the time scale of the bit on the rock [s], sqrt(m1/k3)."""

    def rock_force(self, c: C, mode: Values, state: Values) -> Any:
        """Return the resistance N of the rock [N]."""
        which, compression = mode[self.mode_place("rock")], state[self.place("compression")]
        return rock.resistance(compression, self.stiffness(c), self.threshold(c), which)


class Driven(Scene[C]):
    """A scene under a prescribed force: pulses, or a force without pulses such as a swept sine.

    If the force has pulses, the beginning of each pulse replaces the section crossing, means are taken over complete
    pulse periods, and `pulse_states` names the states of the return map.

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
        """True if the force consists of pulses."""

    @abstractmethod
    def applied_force(self, c: C, mode: Values, state: Values) -> Any:
        """Return the prescribed force I [N]."""

    @property
    def return_states(self) -> tuple[str, ...]:
        return self.pulse_states if self.has_pulses else ()

    @abstractmethod
    def pulse_begins(self, c: C, mode: Values, hits: Mapping[str, Any]) -> Any:
        """Return a mask of the lanes in which a pulse begins at an event; `mode` is the mode before the event."""
