"""The classical machines of chapter 5's review: a mass that hits a stop, thrown back by a coefficient of restitution.

    x'' + w_n² x + 2 h x' = (F/m) sin(w t + theta) + g,   x <= gap;   at x = gap: x'(+) = −R x'(−)

A mass that would chatter without end comes to rest at the stop, until the force pulls it off.

With F = 0 and h = 0 it is the free vibro-impact oscillator (Fig. 5.7), with w_n = 0 the ball thrown by a force
(eq. 5.3), with both Tsaplin's driven hammer (eqs. 5.1, 5.2). A scene of its own in
eighty lines, made of what every scene is made of.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from vibrojax.physics.elementary import sin
from vibrojax.physics.parameters import not_negative, positive, table
from vibrojax.scenes import Scene
from vibrojax.simulation import record
from vibrojax.stepping import Located

PARAMETERS = table(
    not_negative("natural", 10.0, "rad s-1", "natural frequency", "w_n"),
    not_negative("damping", 0.0, "s-1", "h", "h"),
    not_negative("drive", 0.0, "m s-2", "amplitude of the force per mass", "F/m"),
    positive("frequency", 10.0, "rad s-1", "frequency of the force", "w"),
    not_negative("pull", 0.0, "m s-2", "constant force per mass", "g"),
    not_negative("restitution", 1.0, "1", "coefficient of restitution", "R"),
    not_negative("gap", 0.0, "m", "place of the stop", "gap"),
)


REST = 1e-6
"""Share of a typical speed below which a mass that is pushed at the stop rests there."""


@dataclass(frozen=True)
class Struck(Scene):
    """States: x, x' and the time t."""

    name = "struck"
    states = ("x", "v", "t")
    velocities = (1,)
    modes = ("resting",)
    surfaces_named = ("stop",)
    markers_named = ("turn",)
    measures = ()
    starts = ()
    autonomous = False

    def parameters(self):
        return PARAMETERS

    def constants(self, p):
        speed = p["natural"] * 0.01 + p["drive"] / p["frequency"] + p["pull"] / p["frequency"]
        return p | {"speed_scale": speed}

    def start(self, p, name, shape):
        return tuple(jnp.full(shape, value) for value in name)

    def mode_at(self, p, state):
        return (0.0 * state[0],)

    def field(self, p, mode, state):
        (resting,) = mode
        _, v, t = state
        return (v, (1.0 - resting) * (self._push(p, state) - 2 * p["damping"] * v), 0.0 * t + 1.0)

    def _push(self, p, state):
        """Force per mass without the damping [m/s²]."""
        x, _, t = state
        return p["drive"] * sin(t * p["frequency"]) + p["pull"] - p["natural"] ** 2 * x

    def surfaces(self, p, mode, state):
        (resting,) = mode
        return ((1.0 - resting) * (p["gap"] - state[0]) + (resting / p["frequency"] ** 2) * self._push(p, state),)

    def markers(self, p, state):
        return (state[1],)

    def land(self, p, mode, state, hits):
        stop, _ = hits
        (resting,) = mode
        x, v, t = state
        v = jnp.where(stop, -p["restitution"] * v, v)
        slow = stop & (resting == 0) & (-v < REST * p["speed_scale"]) & (self._push(p, state) > 0)
        v = jnp.where(slow, 0.0, v)
        return (jnp.where(stop, jnp.where(slow, 1.0, 0.0), resting),), (jnp.where(stop, p["gap"], x), v, t)

    def resolutions(self, p, mode):
        return (1e-12 * p["speed_scale"] / p["frequency"], 1e-12 * p["speed_scale"])

    def rate(self, p, mode):
        return p["natural"] + p["frequency"] + p["damping"]

    def smoothed_field(self, p, mode, state, width):
        return self.field(p, mode, state)

    def smoothed_mode(self, p, mode, state, width):
        return mode

    def smoothed_surfaces(self, p, mode, state):
        return self.surfaces(p, mode, state)


@dataclass(frozen=True)
class Blows:
    """Times [s] of the impacts, and the velocities [m/s] just before and after them; `path` is (times, positions)."""

    times: np.ndarray
    before: np.ndarray
    after: np.ndarray
    path: tuple[np.ndarray, np.ndarray]


def blows(start: tuple[float, float], duration: float, **parameters) -> Blows:
    """The impacts of a struck mass from `start` = (x, x') over `duration` [s]."""
    scene = Struck()
    p = {name: jnp.full(1, float(parameters.get(name, one.default))) for name, one in PARAMETERS.items()}
    p = dict(scene.constants(p))
    settings = {"tolerance": 1e-10, "stride": 1.0, "step": np.inf}
    state = scene.start(p, (*start, 0.0), (1,))
    taken = record(scene, Located(), p, state, settings, jnp.asarray(duration))
    tau = (taken.dt / taken.h)[:, None] ** np.arange(taken.polynomials.shape[2])
    ends = np.einsum("sok,sk->so", taken.polynomials, tau)
    hit = taken.hits[:, 0] & (taken.mode[:, 0] == 0)
    path = (taken.start, taken.polynomials[:, 0, 0])
    return Blows((taken.start + taken.dt)[hit], ends[hit, 1], taken.after[hit, 1], path)
