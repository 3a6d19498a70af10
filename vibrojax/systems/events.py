"""Events of a system: impacts on a stop, surfaces on which the equations switch, and dry friction.

Functions of an event take the time t [s], the states `y` and the parameters `p` by name, like the field of the system.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from inspect import Parameter as Parameters
from inspect import signature
from typing import Any, ClassVar

from vibrojax.lazy import jnp
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.physics.parameters import Parameter
from vibrojax.systems.kinks import positive_part

OfMotion = Callable[[Any, Mapping[str, Any], Mapping[str, Any]], Any]
"""A function of time, states and parameters."""

KINDS_OF_POINTS = ("fold", "torus", "grazing", "stick", "section", "hopf", "end")
"""Kinds of special points of families, which events cannot have as names: points bear the names of some events."""


@dataclass(frozen=True)
class Impact:
    """A rigid stop that reverses a velocity when a gap closes.

    - `gap`: function `gap(t, y, p)`, positive while the bodies are apart.
    - `velocity`: name of the state that jumps.
    - `restitution`: coefficient of restitution r, a number or a function of `p`; the default is 1. An impact multiplies
      the rate of change of the gap by -r (Newton's law), also for a stop that moves.
    - `reset`: a function `reset(t, y, p)`, in place of `velocity` and `restitution`, that returns new values of states
      and discrete states by name; in `reset(t, y, p, s)`, `s` holds the sides of switches and the discrete states. A
      stop with a `reset` cannot hold a body at rest: a lane whose bounces accumulate fails.
    - `direction`: for a stop with a `reset`, the direction in which the gap crosses zero at the event: -1 (falling) or
      1 (rising). With a `direction`, the gap may have both signs, and nothing happens when the gap crosses zero in the
      opposite direction.

    If the field pushes the body against the stop, a bounce slower than 2.4e-7 of a typical speed ends in rest on the
    stop. The body stays at rest until the field points away from the stop.

    **Example:**

    >>> vj.Impact("stop", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=0.8).velocity
    'v'
    """

    name: str
    gap: Any
    velocity: str | None = None
    restitution: float | Callable[[Mapping[str, Any]], Any] = 1.0
    reset: Callable[..., Mapping[str, Any]] | None = None
    direction: int | None = None
    noun: ClassVar[str] = "gap"

    @property
    def surface(self) -> OfMotion:
        """The function that is zero on the surface of the event."""
        return self.gap

    @property
    def acts_on(self) -> str | None:
        """Name of the state that the event changes; None if the event has a `reset`."""
        return self.velocity

    def happens(self, mode: Any) -> Any:
        """Return a mask of the lanes in which a zero of the gap is the event; `mode`: the mode before."""
        return mode != 1 if self.direction is None else mode * self.direction < 0

    def bounce(self, p: Mapping[str, Any]) -> Any:
        """Return the coefficient of restitution."""
        return self.restitution(p) if callable(self.restitution) else self.restitution


@dataclass(frozen=True)
class Switch:
    """A surface in state space on which the vector field changes.

    - `function`: a function `function(t, y, p)` that is positive on one side of the surface and negative on the other.
    - `impact`: True for a soft contact, which begins where the function becomes positive. The beginning of a soft
      contact counts as an impact, with the rate of change of `function` as impact velocity.

    The function `field` of the system takes a fourth argument `s`; `s[name]` is the side of the switch, 1 or -1. If the
    fields on both sides point towards the surface, the motion slides along the surface by Filippov's convex combination
    of the two fields. Sliding ends when one of the two fields points away from the surface (Filippov, *Differential
    Equations with Discontinuous Righthand Sides*, 1988).

    **Example:**

    >>> vj.Switch("side", lambda t, y, p: y["x"] - p["x0"]).name
    'side'
    """

    name: str
    function: OfMotion
    impact: bool = False
    noun: ClassVar[str] = "function"
    acts_on: ClassVar[None] = None

    @property
    def surface(self) -> OfMotion:
        """The function that is zero on the surface of the event."""
        return self.function


@dataclass(frozen=True)
class Friction:
    """Dry friction: the force -sgn(u) mu(|u|) N on a sliding body, and at most mu(0) N on a sticking body.

    - `relative`: function `relative(t, y, p)` that returns the sliding velocity u [m/s], which must rise with the
      velocity `acts_on`.
    - `normal`: function `normal(t, y, p)` that returns the normal force N [N]; in `normal(t, y, p, s)`, `s` holds the
      sides of switches.
    - `law`: a constant coefficient of friction (a number or a function of `p`), a friction law, or the name of a law in
      `vj.FRICTION_LAWS`. The parameters of a law become parameters of the system.
    - `acts_on`: name of the velocity that the friction force changes; `mass`: mass of the body [kg], a number or a
      function of `p`.
    - `static`: coefficient of friction of a body that sticks, a number or a function of `p`. The default is the
      coefficient of the law at rest, and `static` must not be less.
    - `lift_off`: True if a negative normal force counts as zero. If `lift_off` is False, a lane fails when the normal
      force becomes negative, because friction would then drive the body.

    **Example:**

    >>> belt = vj.Friction(
    ...     "belt", relative=lambda t, y, p: y["v"] - p["v0"], normal=lambda t, y, p: p["N"], law=0.3, acts_on="v"
    ... )
    >>> belt.coefficient(1.0, {})
    0.3
    """

    name: str
    relative: OfMotion
    normal: Callable[..., Any]
    law: FrictionLaw | str | float | Callable[[Mapping[str, Any]], Any]
    acts_on: str
    mass: Callable[[Mapping[str, Any]], Any] | float = 1.0
    static: float | Callable[[Mapping[str, Any]], Any] | None = None
    lift_off: bool = False
    noun: ClassVar[str] = "relative"

    def __post_init__(self) -> None:
        if isinstance(self.law, str) and self.law in FRICTION_LAWS:
            object.__setattr__(self, "law", FRICTION_LAWS[self.law])

    @property
    def surface(self) -> OfMotion:
        """The function that is zero on the surface of the event."""
        return self.relative

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Parameters of the friction law."""
        return self.law.parameters if isinstance(self.law, FrictionLaw) else {}

    def inertia(self, p: Mapping[str, Any]) -> Any:
        """Return the mass [kg]."""
        return self.mass(p) if callable(self.mass) else self.mass

    def coefficient(self, speed: Any, p: Mapping[str, Any]) -> Any:
        """Return the friction coefficient at a sliding speed (at least 0) [1]."""
        if isinstance(self.law, FrictionLaw):
            return self.law.on_weight(speed, {name: p[name] for name in self.law.parameters})
        return self.law(p) if callable(self.law) else self.law

    def at_rest(self, p: Mapping[str, Any]) -> Any:
        """Return the friction coefficient of a body that sticks [1]."""
        static = self.static(p) if callable(self.static) else self.static
        return self.coefficient(jnp.zeros(()), p) if static is None else static

    @cached_property
    def takes_sides(self) -> bool:
        """True if the normal force depends on the sides of switches."""
        return required_arguments(self.normal) == 4

    def force(self, t: Any, y: Mapping[str, Any], p: Mapping[str, Any], s: Mapping[str, Any]) -> Any:
        """Return the normal force [N]; `s`: the sides of the switches by name."""
        return self.normal(t, y, p, s) if self.takes_sides else self.normal(t, y, p)

    def limits(
        self, t: Any, y: Mapping[str, Any], p: Mapping[str, Any], s: Mapping[str, Any], slip: Any
    ) -> tuple[Any, Any]:
        """Return the deceleration mu N/m of a body that slides, and the greatest one of a body that sticks [m/s²].

        `slip`: sgn u or 0; `s`: the sides of the switches by name.
        """
        load = positive_part(self.force(t, y, p, s)) * (1.0 / jnp.asarray(self.inertia(p)))
        return self.coefficient(slip * self.relative(t, y, p), p) * load, self.at_rest(p) * load


def below_law(static: Any, law: Any) -> Any:
    """Return a mask of static coefficients that are below the law at rest by more than rounding errors."""
    return (law > 0) & (static < (1 - 1e-9) * law)


def required_arguments(function: Callable[..., Any]) -> int:
    """Return the number of arguments that are sides `s`, or have no default: loops bind their variables by defaults."""
    parameters = signature(function).parameters.values()
    positional = (Parameters.POSITIONAL_ONLY, Parameters.POSITIONAL_OR_KEYWORD)
    return sum(x.kind in positional and (x.default is Parameters.empty or x.name == "s") for x in parameters)


Event = Impact | Switch | Friction
