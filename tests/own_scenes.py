"""Custom scenes with closed-form answers: a switching flow, a bouncing ball and an impact oscillator.

They use the public interface alone. The last two are forced. The phase of the force is a state that jumps back by one
turn where it reaches half a turn, and the section is where it passes zero.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import vibrojax as vj

positive, not_negative, table = vj.parameters.positive, vj.parameters.not_negative, vj.parameters.table
sqrt, sin, maximum = vj.elementary.sqrt, vj.elementary.sin, vj.elementary.maximum

ROUNDINGS = 64 * np.finfo(float).eps


# A flow that switches


class SwitchedConstants(NamedTuple):
    al: Any
    be: Any
    ga: Any


@dataclass(frozen=True)
class Switched(vj.Scene[SwitchedConstants]):
    """A flow in polar form: left r' = (1 - r) r, th' = 1; right r' = al (be - r) r, th' = ga + be - r.

    The field jumps on the axis x = 0 and turns about the origin. The section is y = 0 on the right.
    """

    name = "switched"
    states = (vj.State("x", "1", "across", is_velocity=True), vj.State("y", "1", "upwards", is_velocity=True))
    modes = (vj.Mode("side", "sgn x", -1.0),)
    markers = (vj.Marker("level", "y"),)
    section = vj.Section((vj.Swing("x", None, "amplitude"),), rearm=lambda c: -0.1 * jnp.ones_like(c.be), at="y")

    def parameters(self):
        return table(
            positive("al", 1.0, "1", "pace on the right", "al"),
            positive("be", 2.0, "1", "radius of the orbit on the right", "be"),
            positive("ga", 1.5, "1", "what the right turns faster", "ga"),
        )

    def constants(self, p):
        return SwitchedConstants(p["al"], p["be"], p["ga"])

    def start(self, c, name, shape):
        return (jnp.full(shape, 1.5, c.be.dtype), jnp.zeros(shape, c.be.dtype))

    def mode_at(self, c, state):
        x, y = state
        return (jnp.where(jnp.where(x == 0, -y, x) < 0, -1.0, 1.0),)

    def field(self, c, mode, state):
        x, y = state
        right = (1.0 + mode[0]) / 2
        r = sqrt(x * x + y * y)
        growth = (1.0 - r) * (1.0 - right) + (c.be - r) * (c.al * right)
        turning = (1.0 - right) + (c.ga + c.be - r) * right
        return (growth * x - turning * y, growth * y + turning * x)

    def guards(self):
        def side(c, mode, state):
            return mode[0] * state[0]

        def resolution(c, mode):
            return ROUNDINGS * c.be

        return (vj.Guard("side", side, resolution),)

    def reset(self, c, mode, state, hits):
        hit = hits["side"]
        return (jnp.where(hit, -mode[0], mode[0]),), (jnp.where(hit, 0.0, state[0]), state[1])

    def rate(self, c, mode):
        return jnp.where(mode[0] < 0, 1.0, c.ga + c.be + c.al * c.be)

    def speed_scale(self, c):
        return c.be


# A mass shaken against a stop


class ShakenConstants(NamedTuple):
    gravity: Any
    stiffness: Any
    damping: Any
    a: Any
    w: Any
    stop: Any
    k0: Any
    c0: Any


@dataclass(frozen=True)
class Shaken(vj.HasContact[ShakenConstants]):
    """x'' = gravity - stiffness x - damping x' + a cos(w t) - J per mass, with J of a soft stop at x = `stop`.

    Without gravity it is the impact oscillator. Without stiffness it is a ball that bounces on a table. Then x is the
    depth below the table's surface, which moves as (a/w²) sin(w t - pi/2).
    """

    name = "shaken"
    states = (
        vj.State("x", "m", "position of the mass"),
        vj.State("v", "m s-1", "velocity of the mass", is_velocity=True),
        vj.State("phase", "rad", "phase of the force"),
    )
    modes = (vj.Mode("touching", "1 where the mass touches the stop", 0.0),)
    markers = (vj.Marker("strobe", "phase"), vj.Marker("turn", "v"))
    section = vj.Section((vj.Swing("x", "v", "amplitude"),), rearm=lambda c: -0.1 * jnp.ones_like(c.w), at="phase")
    starts = ("rest",)
    start_states = ("x", "v")

    def parameters(self):
        return table(
            not_negative("gravity", 0.0, "m s-2", "gravity", "g"),
            not_negative("stiffness", 1.0, "s-2", "stiffness per mass", "k"),
            not_negative("damping", 0.1, "s-1", "damping per mass", "c"),
            not_negative("a", 1.0, "m s-2", "amplitude of the force per mass", "a"),
            positive("w", 1.0, "rad s-1", "frequency of the force", "w"),
            not_negative("stop", 1.0, "m", "where the stop is", "d"),
            positive("k0", 1e6, "s-2", "stiffness of the stop per mass", "k0"),
            not_negative("xi", 0.1, "1", "damping ratio of the stop", "xi"),
        )

    def constants(self, p):
        own = [p[name] for name in ShakenConstants._fields[:-1]]
        return ShakenConstants(*own, 2 * p["xi"] * jnp.sqrt(p["k0"]))

    def start(self, c, name, shape):
        x, v = (0.0, 0.0) if isinstance(name, str) else name
        full = [jnp.full(shape, value, c.w.dtype) for value in (x, v, 0.0)]
        return tuple(full)

    def mode_at(self, c, state):
        compression, length = self._contact(c, state)
        return (jnp.where((compression > 0) & (length > 0), 1.0, 0.0),)

    def field(self, c, mode, state):
        x, v, phase = state
        force = c.gravity - c.stiffness * x - c.damping * v + c.a * vj.elementary.cos(phase)
        return (v, force - self.contact_force(c, mode, state), 0.0 * phase + c.w)

    def guards(self):
        def touches(c, mode, state):
            compression, length = self._contact(c, state)
            # After release while still compressed (xi > 0), only a force brings the mass back into contact.
            return mode[0] * length + (1.0 - mode[0]) * maximum(-compression, -length)

        def left(c, mode, state):
            return np.pi - state[2]

        return (
            vj.Guard("contact", touches, lambda c, mode: self._noise(c)),
            vj.Guard("turned", left, lambda c, mode: ROUNDINGS * jnp.ones_like(c.w)),
        )

    def reset(self, c, mode, state, hits):
        x, v, phase = state
        hit, relaxation = hits["contact"], c.c0 / c.k0
        x = jnp.where(self.impact_begins(c, mode, state, hits), c.stop, x)
        x = jnp.where(hit & (mode[0] == 1), c.stop - relaxation * v, x)
        return (jnp.where(hit, 1.0 - mode[0], mode[0]),), (x, v, jnp.where(hits["turned"], -np.pi, phase))

    def rate(self, c, mode):
        flight = jnp.sqrt(c.stiffness) + c.damping + c.w
        return jnp.where(mode[0] == 1, jnp.sqrt(c.k0 + flight * flight) + c.c0, flight)

    def speed_scale(self, c):
        return (c.a + c.gravity) / c.w

    def contact_force(self, c, mode, state):
        return mode[0] * (c.k0 * (state[0] - c.stop) + c.c0 * state[1])

    def impact_rate(self, c, mode, state):
        return state[1]

    def impact_begins(self, c, mode, state, hits):
        return hits["contact"] & (mode[0] == 0) & (state[1] >= 0) & (state[0] - c.stop <= self._noise(c))

    def striker_mass(self, c):
        return jnp.ones_like(c.w)

    def contact_time(self, c):
        return np.pi / jnp.sqrt(c.k0)

    def contact_rate(self, c):
        return jnp.sqrt(c.k0) + c.c0

    def _contact(self, c, state):
        """Return the compression of the stop, and its sum with the damper force as a length [m]."""
        compression = state[0] - c.stop
        return compression, compression + c.c0 / c.k0 * state[1]

    def _noise(self, c):
        return ROUNDINGS * (c.stop + (c.a + c.gravity) / (c.w * c.w))


class RigidConstants(NamedTuple):
    stiffness: Any
    damping: Any
    a: Any
    w: Any
    stop: Any
    r: Any


@dataclass(frozen=True)
class RigidlyStopped(vj.Scene[RigidConstants]):
    """The impact oscillator with a rigid stop, by a reset alone, so that no mode shows its impacts."""

    name = "rigidly-stopped"
    states, markers, section, modes = Shaken.states, Shaken.markers, Shaken.section, ()
    starts, start_states = Shaken.starts, Shaken.start_states

    def parameters(self):
        shared = {
            name: parameter for name, parameter in Shaken().parameters().items() if name not in ("gravity", "k0", "xi")
        }
        return shared | table(not_negative("r", 0.8, "1", "coefficient of restitution", "r"))

    def constants(self, p):
        return RigidConstants(*(p[name] for name in RigidConstants._fields))

    def start(self, c, name, shape):
        return Shaken().start(c, name, shape)

    def mode_at(self, c, state):
        return ()

    def field(self, c, mode, state):
        x, v, phase = state
        return (v, c.a * vj.elementary.cos(phase) - c.stiffness * x - c.damping * v, 0.0 * phase + c.w)

    def guards(self):
        return (
            vj.Guard("stop", lambda c, mode, state: c.stop - state[0], lambda c, mode: ROUNDINGS * (c.stop + c.a)),
            vj.Guard("turned", lambda c, mode, state: np.pi - state[2], lambda c, mode: ROUNDINGS * jnp.ones_like(c.w)),
        )

    def reset(self, c, mode, state, hits):
        x, v, phase = state
        x, v = jnp.where(hits["stop"], c.stop, x), jnp.where(hits["stop"], -c.r * v, v)
        return mode, (x, v, jnp.where(hits["turned"], -np.pi, phase))

    def rate(self, c, mode):
        return jnp.sqrt(c.stiffness) + c.damping + c.w

    def speed_scale(self, c):
        return c.a / c.w


# Closed forms for a rigid stop


def restitution(xi: float) -> float:
    """Return R of a free mass that meets a spring and damper and is released at zero force."""
    return float(np.exp(-2 * xi * np.arccos(xi) / np.sqrt(1 - xi**2)))


class Rigid(NamedTuple):
    """An orbit of one impact, with the force's `phase` [rad] and the mass's `speed` [m/s] there.

    `multipliers` are sorted by falling modulus. `section` is the state (x, v) at the section.
    """

    phase: float
    speed: float
    multipliers: np.ndarray
    section: np.ndarray


def _multipliers(trace: float, determinant: float) -> np.ndarray:
    multipliers = np.roots([1.0, -trace, determinant])
    return multipliers[np.argsort(-np.abs(multipliers), kind="stable")]


def ball_orbit(ratio: float, R: float, w: float, gravity: float) -> Rigid:
    """Return the orbit of a ball that meets the table once per period at its upper (stable) phase. `ratio` is a/g.

    The ball flies for a period T, so that it leaves and meets the table at speed gT/2, where the table's velocity is
    gT/2 (1 - R)/(1 + R). The determinant is R², the trace 1 + R² - (1 + R)² (a/g) sin: Guckenheimer and Holmes,
    *Nonlinear Oscillations*, 1983, section 2.4, here without the approximation of high bounces.
    """
    above = np.arccos(np.pi * (1 - R) / (1 + R) / ratio)  # phase of the table's sine
    T, height = 2 * np.pi / w, ratio * gravity / w**2
    speed = gravity * T / (1 + R)
    remaining = T - (above + np.pi / 2) / w  # from the impact to the next section
    flown, rises = (
        height * np.sin(above) + gravity * (T / 2) * remaining - gravity * remaining**2 / 2,
        gravity * (T / 2 - remaining),
    )
    values = _multipliers(1 + R**2 - (1 + R) ** 2 * ratio * np.sin(above), R**2)
    return Rigid(above + np.pi / 2, speed, values, np.array([-height - flown, -rises]))


def ball_appears(R: float) -> float:
    """Return a/g at which this orbit appears, in a fold."""
    return np.pi * (1 - R) / (1 + R)


def ball_doubles(R: float) -> float:
    """Return a/g at which its period doubles."""
    return float(np.hypot(ball_appears(R), 2 * (1 + R**2) / (1 + R) ** 2))


def oscillator_grazes(w: float, stiffness: float, damping: float, stop: float) -> float:
    """Return the amplitude `a` at which the steady motion without impact touches the stop, soft or rigid."""
    return float(stop * np.hypot(stiffness - w**2, damping * w))


def oscillator_orbits(
    a: float, R: float, w: float, stiffness: float, damping: float, stop: float, n: int = 1
) -> list[Rigid]:
    """Return the orbits of one impact in `n` periods, by impact speed, including those that cross the stop.

    With E the flow of the homogeneous equation over the time between impacts, the state relative to the forced motion,
    u = (stop - p, -q), obeys (E - 1) u = V (R E + 1) e2, and (p, q/w) lies on the circle of the forced motion: Shaw and
    Holmes, Journal of Sound and Vibration 90 (1983), 129.
    """
    E, forced = _flow(2 * np.pi * n / w, stiffness, damping), a / complex(stiffness - w**2, damping * w)
    u = np.linalg.solve(E - np.eye(2), (R * E + np.eye(2)) @ [0.0, 1.0])
    square = [u[0] ** 2 + (u[1] / w) ** 2, -2 * stop * u[0], stop**2 - abs(forced) ** 2]
    orbits = []
    for V in sorted(root.real for root in np.roots(square) if root.imag == 0 and root.real > 0):
        p, q = stop - V * u[0], -V * u[1]
        phase = (np.angle(complex(p, -q / w)) - np.angle(forced)) % (2 * np.pi)
        push = a * np.cos(phase) - stiffness * stop
        before, after = push - damping * V, push + damping * R * V
        saltation = np.array([[-R, 0.0], [(after + R * before) / V, -R]])
        M = E @ saltation
        since = _flow((2 * np.pi * n - phase) / w, stiffness, damping) @ (np.array([stop, -R * V]) - [p, q])
        section = since + [forced.real, -w * forced.imag]
        orbits.append(Rigid(phase, V, _multipliers(np.trace(M), np.linalg.det(M)), section))
    return orbits


def oscillator_doubles(
    between: tuple[float, float], R: float, w: float, stiffness: float, damping: float, stop: float, n: int = 1
) -> float:
    """Return the amplitude `a`, within `between`, at which the fastest orbit doubles: 1 + trace + determinant = 0."""

    def product(a: float) -> float:
        return float(np.prod(1 + oscillator_orbits(a, R, w, stiffness, damping, stop, n)[-1].multipliers).real)

    return float(brentq(product, *between, xtol=1e-15))


def _flow(t: float, stiffness: float, damping: float) -> np.ndarray:
    """Return the flow of x'' = -stiffness x - damping x' over t, below critical damping."""
    half = damping / 2
    wd = np.sqrt(stiffness - half**2)
    cos, sin_over = np.cos(wd * t), np.sin(wd * t) / wd
    return np.exp(-half * t) * np.array(
        [[cos + half * sin_over, sin_over], [-stiffness * sin_over, cos - half * sin_over]]
    )
