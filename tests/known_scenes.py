"""Scenes other than drills, written with the public interface, whose motion is known from the literature."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

import vibrojax as vj
from vibrojax.physics.parameters import positive, table
from vibrojax.scenes import stick_slip as slips
from vibrojax.scenes.capabilities import Bit


class LorenzConstants(NamedTuple):
    sigma: Any
    r: Any
    b: Any


@dataclass(frozen=True)
class Lorenz(vj.Scene[LorenzConstants]):
    """The system of Lorenz, J. Atmospheric Sciences 20 (1963) 130. The section is where w = z - (r - 1) rises to 0."""

    name = "lorenz"
    states = (
        vj.State("x", "1", "convection"),
        vj.State("y", "1", "difference of temperature"),
        vj.State("w", "1", "distortion of the profile, from the fixed points'", is_velocity=True),
    )
    modes = (vj.Mode("on", "always 1", 1.0),)
    markers = (vj.Marker("turn", "w"),)
    section = vj.Section((vj.Swing("x", "w", "bit_amplitude"),), rearm=lambda c: -0.1 * c.r)
    start_states = ("x", "y", "w")
    measures = ("swings",)

    def parameters(self):
        return table(
            positive("sigma", 10.0, "1", "Prandtl number", "s"),
            positive("r", 28.0, "1", "Rayleigh number over its critical value", "r"),
            positive("b", 8 / 3, "1", "shape of the cells", "b"),
        )

    def constants(self, p):
        return LorenzConstants(p["sigma"], p["r"], p["b"])

    def start(self, c, name, shape):
        initial = (1.0, 1.0, 0.0) if name is None else name
        return tuple(jnp.full(shape, x, c.r.dtype) for x in initial)

    def mode_at(self, c, state):
        return (jnp.ones_like(state[0]),)

    def field(self, c, mode, state):
        x, y, w = state
        z = w + (c.r - 1.0)
        return (c.sigma * (y - x), x * (c.r - z) - y, x * y - c.b * z)

    def guards(self):
        return ()

    def reset(self, c, mode, state, hits):
        return mode, state

    def rate(self, c, mode):
        return c.sigma + c.r

    def speed_scale(self, c):
        return 1.0 * c.r


class OscillatorConstants(NamedTuple):
    damping: Any
    force: Any
    frequency: Any
    wall: Any
    restitution: Any


@dataclass(frozen=True)
class ImpactOscillator(vj.Scene[OscillatorConstants]):
    """x'' + 2 zeta x' + x = force cos(frequency t) up to the wall, with restitution there.

    The phase is that of a rotor (c, s) = (cos, sin), which returns to its circle quickly. The section is where s rises
    through zero, at t = 0, 2 pi/frequency, ...
    """

    name = "impact-oscillator"
    states = (
        vj.State("c", "1", "cosine of the phase"),
        vj.State("s", "1", "sine of the phase", is_velocity=True),
        vj.State("x", "m", "position"),
        vj.State("v", "m s-1", "velocity", is_velocity=True),
    )
    modes = (vj.Mode("on", "always 1", 1.0),)
    markers = (vj.Marker("phase", "s"), vj.Marker("turn", "v"))
    section = vj.Section(
        (vj.Swing("c", "s", "bit_amplitude"), vj.Swing("x", "v", "striker_amplitude")),
        rearm=lambda c: -0.5 + 0 * c.wall,
    )
    start_states = ("c", "s", "x", "v")
    measures = ("swings",)

    def parameters(self):
        return table(
            positive("damping", 0.05, "1", "damping ratio", "z"),
            positive("force", 1.0, "N", "force", "F"),
            positive("frequency", 2.0, "rad s-1", "frequency", "w"),
            positive("wall", 0.1, "m", "place of the wall", "d"),
            positive("restitution", 0.8, "1", "restitution", "e"),
        )

    def constants(self, p):
        return OscillatorConstants(p["damping"], p["force"], p["frequency"], p["wall"], p["restitution"])

    def start(self, c, name, shape):
        initial = (1.0, 0.0, 0.0, 0.0) if name is None else name
        return tuple(jnp.full(shape, x, c.wall.dtype) for x in initial)

    def mode_at(self, c, state):
        return (jnp.ones_like(state[0]),)

    def field(self, c, mode, state):
        rotor, s, x, v = state
        back = 3.0 * (1.0 - rotor * rotor - s * s)
        return (
            back * rotor - c.frequency * s,
            back * s + c.frequency * rotor,
            v,
            c.force * rotor - x - 2.0 * c.damping * v,
        )

    def guards(self):
        return (vj.Guard("wall", lambda c, mode, state: c.wall - state[2], lambda c, mode: 1e-14 * c.wall),)

    def reset(self, c, mode, state, hits):
        rotor, s, x, v = state
        hit = hits["wall"]
        return mode, (rotor, s, jnp.where(hit, c.wall, x), jnp.where(hit, -c.restitution * v, v))

    def rate(self, c, mode):
        return c.frequency + 7.0

    def speed_scale(self, c):
        return c.force


class BeltConstants(NamedTuple):
    damping: Any
    slip: slips.SlipConstants


EXPONENTIAL = vj.FrictionLaw(
    name="exponential",
    reference="Stender and Hoffmann, Nonlinear Dynamics (2021), 10.1007/s11071-021-06786-5",
    parameters=table(
        positive("mu_d", 0.5, "1", "dynamic friction coefficient", "m"),
        positive("mu_sd", 2.0, "1", "static over dynamic", "r"),
        positive("v0", 0.5, "m s-1", "speed of the decay", "u"),
    ),
    mu=lambda speed, p: p["mu_d"] * (1.0 + (p["mu_sd"] - 1.0) * vj.elementary.exp(speed * (-1 / p["v0"]))),
)


@dataclass(frozen=True)
class BeltOscillator(vj.HasFriction[BeltConstants]):
    """x'' + 2 xi x' + x = -sgn(u) mu(|u|), u = x' + v: a unit mass of unit weight on a belt that moves the other way.

    The smoothed switch is tanh(u/width). bSTAB's successor uses a width of 1/200.
    """

    friction: vj.FrictionLaw = EXPONENTIAL

    name = "belt-oscillator"
    states = (
        vj.State("x1", "m", "position"),
        vj.State("v1", "m s-1", "velocity", is_velocity=True),
    )
    modes = (vj.Mode("slip", "sgn u, 0 where it sticks", 1.0),)
    markers = (vj.Marker("turn", "v1"),)
    section = vj.Section((vj.Swing("x1", "v1", "bit_amplitude"),), rearm=lambda c: -0.001 * c.slip.v)
    start_states = ("x1", "v1")
    measures = ("swings", "shares")

    def parameters(self):
        own = table(
            positive("m1", 1.0, "kg", "mass", "m"),
            positive("k1", 1.0, "N m-1", "stiffness", "k"),
            positive("g", 1.0, "m s-2", "weight over mass", "g"),
            positive("v", 1.5, "m s-1", "speed of the belt", "v"),
            positive("xi", 0.05, "1", "damping ratio", "x"),
        )
        return own | dict(self.friction.parameters)

    def constants(self, p):
        return BeltConstants(2 * p["xi"], slips.slip_constants(p, self.friction))

    def start(self, c, name, shape):
        initial = (0.0, 0.0) if name is None else name
        return tuple(jnp.full(shape, x, c.slip.v.dtype) for x in initial)

    def pull(self, c, state):
        return -state[0] - c.damping * state[1]

    def mode_at(self, c, state):
        v1 = state[1]
        return (slips.slip_at(c.slip, v1 + c.slip.v, self.pull(c, state), -v1, None, slips.stick_noise(c.slip)),)

    def field(self, c, mode, state):
        (slip,) = mode
        force = slips.friction(self.friction, c.slip, slip, state[1] + c.slip.v, None)
        return (state[1], (slip * slip) * (self.pull(c, state) - force))

    def smoothed_field(self, c, mode, state, width):
        u = state[1] + c.slip.v
        force = vj.elementary.tanh(u / width) * self.friction.on_weight(vj.elementary.absolute(u), c.slip.law)
        return (state[1], self.pull(c, state) - force)

    def smoothed_mode(self, c, mode, state, width):
        return (slips.smoothed_mode(state[1] + c.slip.v, width),)

    def guards(self):
        def motion(c, mode, state):
            return state[1] + c.slip.v, self.pull(c, state), None

        return (slips.friction_guard(lambda c: c.slip, motion, lambda c, mode: slips.stick_noise(c.slip)),)

    def reset(self, c, mode, state, hits):
        hit = hits["friction"]
        state = (state[0], jnp.where(hit, -c.slip.v, state[1]))
        slip = slips.slip_after(c.slip, mode[0], self.pull(c, state), -state[1], None, slips.stick_noise(c.slip))
        return (jnp.where(hit, slip, mode[0]),), state

    def rate(self, c, mode):
        return 2.0 + 0 * c.slip.v

    def speed_scale(self, c):
        return c.slip.speed_scale

    def bit(self, c):
        return Bit(1.0 + 0 * c.slip.v, c.slip.weight, c.slip.v)

    def flight_rate(self, c):
        return 1.0 + c.damping

    def spring_rate(self, c):
        return 1.0 + 0 * c.slip.v
