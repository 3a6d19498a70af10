"""The vibro-impact drill whose striker drives the bit into the rock: one way, or with the bit's motion fed back."""

from abc import abstractmethod
from dataclasses import dataclass, replace

import jax.numpy as jnp

from vibrojax.physics.contact import contact_time, raw_force
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.physics.parameters import BIT_AND_STRIKER, CONTACT, Parameter
from vibrojax.physics.rock import ROCK, ROCKS
from vibrojax.scenes import _contact, _drill, _rock
from vibrojax.scenes._scene import Scene


def _sandstone() -> dict[str, Parameter]:
    """The rock's parameters with this scene's defaults: most blows of this drill never break granite."""
    found = {"k3": ROCKS["sandstone"].k3, "threshold": ROCKS["sandstone"].threshold, "zeta": 1.5}
    return {name: replace(parameter, default=found[name]) for name, parameter in ROCK.items()}


@dataclass(frozen=True)
class DrillOnRock(Scene):
    """Bit and striker as in vibro-impact; the bit's normal motion m1 x3'' + c3 x3' = -N + J (eqs. 5.18, 6.1 to 6.3).

    States: x1, x1', x2, x2', the rock's compression x3 - x4, x3', and the growth of x4 since the last impact began.
    What has been drilled before is thus no part of the state, and cannot blur it.
    """

    friction: FrictionLaw = FRICTION_LAWS["stribeck"]

    states = ("x1", "v1", "x2", "v2", "compression", "v3", "growth")
    velocities = (1, 3, 5)
    modes = ("slip", "touching", "rock")
    surfaces_named = ("friction", "contact", "yield", "rock")
    markers_named = ("bit_turn", "striker_turn")
    bit_turn, striker_turn = 4, 5  # where hits holds them
    measures = ("swings", "shares", "impacts", "harmonics", "drilling")
    starts = ("drive", "stuck", "touching")

    @abstractmethod
    def indentation(self, p, rock, state):
        """(compression, rate) of the rock that the contact between striker and bit feels [m, m/s]."""

    def parameters(self):
        return BIT_AND_STRIKER | CONTACT | _sandstone() | dict(self.friction.parameters)

    def constants(self, p):
        return _rock.with_derived(_contact.with_derived(_drill.with_derived(p, self.friction)))

    def start(self, p, name, shape):
        x1, v1, x2, v2 = _drill.start(p, name, shape)
        if isinstance(name, str) and name == "touching":  # R13: the drive's start without its kick
            x2 = jnp.minimum(x2, p["delta"])
        rest = jnp.zeros_like(x1)
        return (x1, v1, x2, v2, rest, rest, rest)

    def scaled(self, p, state):
        return _drill.scaled(p, state[:4], _contact.energy(p, state[2] - p["delta"]))

    def mode_at(self, p, state):
        rock = jnp.zeros_like(state[0])
        compression, rate = self._compression(p, rock, state)
        free = p["k2"] * (state[0] - state[2]) - p["c2"] * state[3]
        closes = (rate > 0) | ((rate == 0) & (free > 0))
        inside = (compression > 0) & (raw_force(compression, rate, p) > 0)
        touching = jnp.where(inside | ((compression == 0) & closes), 1.0, 0.0)
        impact = self.contact_force(p, (None, touching, rock), state)
        slip = _drill.slip_at(p, state[:4], impact, self._stick_noise(p, touching))
        return (slip, touching, rock)

    def _compression(self, p, rock, state):
        """Compression of the contact and its rate."""
        depth, rate = self.indentation(p, rock, state)
        return state[2] - p["delta"] - depth, state[3] - rate

    def contact_force(self, p, mode, state):
        return mode[1] * raw_force(*self._compression(p, mode[2], state), p)

    def contact_time(self, p):
        """Duration of a blow of the striker on the contact [s] (eq. 5.7), the bit held."""
        return contact_time(p["m2"], p["k0"], p["c0"])

    def field(self, p, mode, state):
        slip, _, rock = mode
        impact = self.contact_force(p, mode, state)
        bit, striker = _drill.accelerations(self.friction, p, slip, state[:4], impact)
        (compression, growth), normal = _rock.rates(p, rock, state[4], state[5], impact)
        return (state[1], (slip * slip) * bit, state[3], striker, compression, normal, growth)

    def smoothed_field(self, p, mode, state, width):
        impact = self.contact_force(p, mode, state)
        slip = _drill.smoothed_slip(p, state, width)
        bit, striker = _drill.accelerations(self.friction, p, slip, state[:4], impact)
        (compression, growth), normal = _rock.rates(p, mode[2], state[4], state[5], impact)
        return (state[1], bit, state[3], striker, compression, normal, growth)

    def smoothed_mode(self, p, mode, state, width):
        return (_drill.smoothed_mode(p, state, width), *mode[1:])

    def smoothed_surfaces(self, p, mode, state):
        return (_drill.never(state), *self._normal_surfaces(p, mode, state))

    def surfaces(self, p, mode, state):
        friction = _drill.friction_surface(p, mode[0], state[:4], self.contact_force(p, mode, state))
        return (friction, *self._normal_surfaces(p, mode, state))

    def _normal_surfaces(self, p, mode, state):
        contact = _contact.surface(p, mode[1], *self._compression(p, mode[2], state))
        return (contact, *_rock.surfaces(p, mode[2], state[4], state[5]))

    def markers(self, p, state):
        return (state[1], state[3])

    def land(self, p, mode, state, hits):
        at_friction, at_contact, yields, touches, bit_turns, striker_turns = hits
        slip, touching, rock = mode
        begins = self.impact_begins(p, mode, state, hits)
        before, rate = self._compression(p, rock, state)
        touching, compression = _contact.landed(p, touching, before, rate, at_contact, _drill.length_noise(p))
        x2 = jnp.where(at_contact, state[2] + (compression - before), state[2])
        rock, depth, v3 = _rock.land(p, rock, state[4], state[5], yields, touches)
        growth = jnp.where(begins, 0.0, state[6])
        drill = (state[0], state[1], x2, state[3])
        impact = self.contact_force(p, (slip, touching, rock), (*drill, depth, v3, growth))
        slip, drill = _drill.land_friction(p, slip, drill, at_friction, impact, self._stick_noise(p, touching))
        drill = _drill.land_turns(drill, bit_turns, striker_turns)
        rock, depth, v3 = _rock.rest(p, rock, depth, v3, touching != 0)
        return (slip, touching, rock), (*drill, depth, v3, growth)

    def impact_rate(self, p, mode, state):
        """Rate at which the contact is compressed [m/s]."""
        return self._compression(p, mode[2], state)[1]

    def impact_begins(self, p, mode, state, hits):
        """Where an impact begins: the compression of the contact, apart before, rises through zero."""
        compression, rate = self._compression(p, mode[2], state)
        return _contact.begins(p, mode[1], compression, rate, hits[1], _drill.length_noise(p))

    def resolutions(self, p, mode):
        speed, length = _drill.speed_noise(p), _drill.length_noise(p)
        rock = tuple(small + length for small in _rock.resolutions(p))
        friction = _drill.friction_resolution(p, mode[0], self._stick_noise(p, mode[1]))
        return (friction, length, *rock, speed, speed)

    def slope_resolutions(self, p, mode, h):
        friction = _drill.friction_slope_resolution(p, mode[0], self._stick_noise(p, mode[1]), h)
        return (friction, *super().slope_resolutions(p, mode, h)[1:])

    def _stick_noise(self, p, touching):
        return _drill.stick_noise(p, touching * _contact.force_resolution(p))

    def pull(self, p, state):
        return _drill.pull(p, state[0], state[2])

    def in_sight(self, p, mode, polynomials):
        return _drill.in_sight(self.friction, p, mode[0], polynomials[1])

    def rate(self, p, mode):
        flight = _drill.flight_rate(p)
        contact = _contact.stiff_rate(p, flight)
        drill = jnp.where(mode[1] != 0, contact, flight)
        return jnp.where(mode[2] == _rock.REST, drill, jnp.maximum(drill, _rock.rate(p, mode[2], mode[1] == 0)))
