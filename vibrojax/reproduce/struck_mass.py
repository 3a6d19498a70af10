"""A mass on a spring that hits a stop: one scene for the classical examples reviewed in chapter 5 of the source.

    x'' + w_n² x = (F/m) sin(w t) + g,   x <= gap;   at x = gap: x'(+) = −R x'(−)

If the impacts would accumulate (chatter), the mass comes to rest at the stop until the force pulls it off.

With F = 0, this is the free vibro-impact oscillator (Fig. 5.7); with w_n = 0, the ball thrown by a force (eq. 5.3);
otherwise, Tsaplin's driven hammer (eqs. 5.1, 5.2).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax.models.physics.elementary import sin
from vibrojax.models.physics.parameters import Parameter, not_negative, positive, table
from vibrojax.models.scenes import Guard, Marker, Mode, Scene, State
from vibrojax.models.scenes.declared import Start, Values
from vibrojax.stepping import Accuracy, Located
from vibrojax.sweep.simulation import record

PARAMETERS = table(
    not_negative("natural", 10.0, "rad s-1", "natural frequency", "w_n"),
    not_negative("drive", 0.0, "m s-2", "amplitude of the force per mass", "F/m"),
    positive("frequency", 10.0, "rad s-1", "frequency of the force", "w"),
    not_negative("pull", 0.0, "m s-2", "constant force per mass", "g"),
    not_negative("restitution", 1.0, "1", "coefficient of restitution", "R"),
    not_negative("gap", 0.0, "m", "place of the stop", "gap"),
)

MAX_REST_SPEED = 1e-6
"""Speed, relative to a typical speed, below which a mass that is pushed against the stop comes to rest there."""


class StruckConstants(NamedTuple):
    """The parameters of the scene, and a typical speed [m/s]."""

    natural: Any
    drive: Any
    frequency: Any
    pull: Any
    restitution: Any
    gap: Any
    speed: Any


@dataclass(frozen=True)
class StruckMassScene(Scene[StruckConstants]):
    """The scene of a mass and a stop; the states are x, x' and the time t."""

    name = "struck"
    states = (
        State("x", "m", "position"),
        State("v", "m s-1", "velocity", is_velocity=True),
        State("t", "s", "time", shown=False),
    )
    modes = (Mode("resting", "1 where the mass rests at the stop", 0.0),)
    markers = (Marker("turn", "v"),)
    autonomous = False

    def parameters(self) -> Mapping[str, Parameter]:
        return PARAMETERS

    def constants(self, p: Mapping[str, Any]) -> StruckConstants:
        speed = p["natural"] * 0.01 + p["drive"] / p["frequency"] + p["pull"] / p["frequency"]
        return StruckConstants(**p, speed=speed)

    def start(self, c: StruckConstants, name: Start, shape: tuple[int, ...]) -> Values:
        assert isinstance(name, tuple)
        return tuple(jnp.full(shape, value) for value in name)

    def mode_at(self, c: StruckConstants, state: Values) -> Values:
        return (0.0 * state[0],)

    def field(self, c: StruckConstants, mode: Values, state: Values) -> Values:
        (resting,) = mode
        _, v, t = state
        return (v, (1.0 - resting) * self._push(c, state), 0.0 * t + 1.0)

    def _push(self, c: StruckConstants, state: Values) -> Any:
        """Return the net force per mass [m/s²], as arrays or Taylor series, depending on the type of the state."""
        x, _, t = state
        return c.drive * sin(t * c.frequency) + c.pull - c.natural**2 * x

    def guards(self) -> tuple[Guard, ...]:
        return (Guard("stop", self._stop, lambda c, mode: 1e-12 * c.speed / c.frequency),)

    def _stop(self, c: StruckConstants, mode: Values, state: Values) -> Any:
        (resting,) = mode
        return (1.0 - resting) * (c.gap - state[0]) + (resting / c.frequency**2) * self._push(c, state)

    def reset(self, c: StruckConstants, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        stop = hits["stop"]
        (resting,) = mode
        x, v, t = state
        v = jnp.where(stop, -c.restitution * v, v)
        slow = stop & (resting == 0) & (-v < MAX_REST_SPEED * c.speed) & (self._push(c, state) > 0)
        v = jnp.where(slow, 0.0, v)
        return (jnp.where(stop, jnp.where(slow, 1.0, 0.0), resting),), (jnp.where(stop, c.gap, x), v, t)

    def velocity_resolution(self, c: StruckConstants) -> Any:
        return 1e-12 * c.speed

    def rate(self, c: StruckConstants, mode: Values) -> Any:
        return c.natural + c.frequency

    def speed_scale(self, c: StruckConstants) -> Any:
        return c.speed


@dataclass(frozen=True)
class Blows:
    """The impacts of a motion: their `times` [s] and the velocities [m/s] just `before` them.

    `path` contains the times [s] and positions [m] at which the steps of the motion begin.
    """

    times: Float[np.ndarray, " impacts"]
    before: Float[np.ndarray, " impacts"]
    path: tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps"]]


def strike(start: tuple[float, float], duration: float, parameters: Mapping[str, Any]) -> Blows:
    """Simulate a mass from the initial state `start` = (x, x') over `duration` [s], and return its impacts."""
    scene = StruckMassScene()
    p = {name: jnp.full(1, float(parameters.get(name, entry.default))) for name, entry in PARAMETERS.items()}
    c = scene.constants(p)
    accuracy = Accuracy(tolerance=1e-10, stride=1.0, step=np.inf)
    taken, _ = record(scene, Located(), c, scene.start(c, (*start, 0.0), (1,)), accuracy, duration)
    begin, dt, h, polynomials = map(np.asarray, (taken.start, taken.dt, taken.h, taken.polynomials))
    tau = (dt / h)[:, None] ** np.arange(polynomials.shape[2])
    ends = np.einsum("sok,sk->so", polynomials, tau)
    hit = np.asarray(taken.hits[:, 0] & (taken.mode[:, 0] == 0))
    return Blows((begin + dt)[hit], ends[hit, 1], (begin, polynomials[:, 0, 0]))
