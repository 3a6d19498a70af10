"""The vibro-impact scene: the drill whose striker hits the bit through a one-sided contact (eq. 5.18)."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.physics.contact import contact_time, raw_force
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.physics.parameters import BIT_AND_STRIKER, CONTACT
from vibrojax.scenes import _contact, _drill
from vibrojax.scenes._scene import Scene


@dataclass(frozen=True)
class VibroImpact(Scene):
    """m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u, J); m2 x2'' = -c2 x2' - k2 (x2 - x1) - J (section 1)."""

    friction: FrictionLaw = FRICTION_LAWS["stribeck"]

    name = "vibro-impact"
    states = ("x1", "v1", "x2", "v2")
    velocities = (1, 3)
    modes = ("slip", "touching")
    surfaces_named = ("friction", "contact")
    markers_named = ("bit_turn", "striker_turn")
    bit_turn, striker_turn = 2, 3  # where hits holds them
    measures = ("swings", "shares", "impacts", "harmonics")
    starts = ("drive", "stuck", "touching")

    def parameters(self):
        return BIT_AND_STRIKER | CONTACT | dict(self.friction.parameters)

    def constants(self, p):
        return _contact.with_derived(_drill.with_derived(p, self.friction))

    def start(self, p, name, shape):
        x1, v1, x2, v2 = _drill.start(p, name, shape)
        if isinstance(name, str) and name == "touching":  # R13: the drive's start without its kick
            x2 = jnp.minimum(x2, p["delta"])
        return (x1, v1, x2, v2)

    def scaled(self, p, state):
        return _drill.scaled(p, state, _contact.energy(p, state[2] - p["delta"]))

    def mode_at(self, p, state):
        x1, _, x2, v2 = state
        free = p["k2"] * (x1 - x2) - p["c2"] * v2
        gap_closes = (v2 > 0) | ((v2 == 0) & (free > 0))
        inside = (x2 > p["delta"]) & (self.impact_force(p, state) > 0)
        touching = jnp.where(inside | ((x2 == p["delta"]) & gap_closes), 1.0, 0.0)
        impact = touching * self.impact_force(p, state)
        return (_drill.slip_at(p, state, impact, self._stick_noise(p, touching)), touching)

    def impact_force(self, p, state):
        """J [N] while the striker touches the bit; takes arrays and series."""
        _, _, x2, v2 = state
        return raw_force(x2 - p["delta"], v2, p)

    def field(self, p, mode, state):
        slip = mode[0]
        impact = self.contact_force(p, mode, state)
        bit, striker = _drill.accelerations(self.friction, p, slip, state, impact)
        return (state[1], (slip * slip) * bit, state[3], striker)

    def smoothed_field(self, p, mode, state, width):
        slip = _drill.smoothed_slip(p, state, width)
        impact = self.contact_force(p, mode, state)
        bit, striker = _drill.accelerations(self.friction, p, slip, state, impact)
        return (state[1], bit, state[3], striker)

    def smoothed_mode(self, p, mode, state, width):
        return (_drill.smoothed_mode(p, state, width), mode[1])

    def smoothed_surfaces(self, p, mode, state):
        return (_drill.never(state), self._contact_surface(p, mode[1], state))

    def surfaces(self, p, mode, state):
        slip, touching = mode
        friction = _drill.friction_surface(p, slip, state, self.contact_force(p, mode, state))
        return (friction, self._contact_surface(p, touching, state))

    def _contact_surface(self, p, touching, state):
        return _contact.surface(p, touching, state[2] - p["delta"], state[3])

    def markers(self, p, state):
        return (state[1], state[3])

    def land(self, p, mode, state, hits):
        at_friction, at_contact, bit_turns, striker_turns = hits
        slip, touching = mode
        x1, v1, x2, v2 = state
        touching, compression = _contact.landed(p, touching, x2 - p["delta"], v2, at_contact, _drill.length_noise(p))
        x2 = jnp.where(at_contact, p["delta"] + compression, x2)
        state = (x1, v1, x2, v2)
        impact = touching * self.impact_force(p, state)
        slip, state = _drill.land_friction(p, slip, state, at_friction, impact, self._stick_noise(p, touching))
        return (slip, touching), _drill.land_turns(state, bit_turns, striker_turns)

    def contact_force(self, p, mode, state):
        return mode[1] * self.impact_force(p, state)

    def contact_time(self, p):
        """Duration of a blow of the striker on the contact [s] (eq. 5.7)."""
        return contact_time(p["m2"], p["k0"], p["c0"])

    def impact_rate(self, p, mode, state):
        """Rate at which the contact is compressed [m/s]."""
        return state[3]

    def impact_begins(self, p, mode, state, hits):
        """Where an impact begins: the striker, apart from the bit, rises through delta (contract: dataset)."""
        rate = self.impact_rate(p, mode, state)
        return _contact.begins(p, mode[1], state[2] - p["delta"], rate, hits[1], _drill.length_noise(p))

    def resolutions(self, p, mode):
        speed = _drill.speed_noise(p)
        friction = _drill.friction_resolution(p, mode[0], self._stick_noise(p, mode[1]))
        return (friction, _drill.length_noise(p), speed, speed)

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
        return jnp.where(mode[1] != 0, contact, flight)


SCENE = VibroImpact
