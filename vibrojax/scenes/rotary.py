"""The rotary scene: bit and striker on their springs, stick-slip friction, no impact."""

from dataclasses import dataclass

from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.physics.parameters import BIT_AND_STRIKER
from vibrojax.scenes import _drill
from vibrojax.scenes._scene import Scene


@dataclass(frozen=True)
class Rotary(Scene):
    """m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u); m2 x2'' = -c2 x2' - k2 (x2 - x1) (section 1 with J = 0)."""

    friction: FrictionLaw = FRICTION_LAWS["stribeck"]

    name = "rotary"
    states = ("x1", "v1", "x2", "v2")
    velocities = (1, 3)
    modes = ("slip",)
    surfaces_named = ("friction",)
    markers_named = ("bit_turn", "striker_turn")
    bit_turn, striker_turn = 1, 2  # where hits holds them
    measures = ("swings", "shares", "harmonics")
    starts = ("drive", "stuck")

    def parameters(self):
        return BIT_AND_STRIKER | dict(self.friction.parameters)

    def constants(self, p):
        return _drill.with_derived(p, self.friction)

    def start(self, p, name, shape):
        return _drill.start(p, name, shape)

    def scaled(self, p, state):
        return _drill.scaled(p, state)

    def mode_at(self, p, state):
        return (_drill.slip_at(p, state, None, _drill.stick_noise(p)),)

    def field(self, p, mode, state):
        (slip,) = mode
        bit, striker = _drill.accelerations(self.friction, p, slip, state, None)
        return (state[1], (slip * slip) * bit, state[3], striker)

    def smoothed_field(self, p, mode, state, width):
        slip = _drill.smoothed_slip(p, state, width)
        bit, striker = _drill.accelerations(self.friction, p, slip, state, None)
        return (state[1], bit, state[3], striker)

    def smoothed_mode(self, p, mode, state, width):
        return (_drill.smoothed_mode(p, state, width),)

    def smoothed_surfaces(self, p, mode, state):
        return (_drill.never(state),)

    def surfaces(self, p, mode, state):
        return (_drill.friction_surface(p, mode[0], state, None),)

    def markers(self, p, state):
        return (state[1], state[3])

    def land(self, p, mode, state, hits):
        at_friction, bit_turns, striker_turns = hits
        slip, state = _drill.land_friction(p, mode[0], state, at_friction, None, _drill.stick_noise(p))
        return (slip,), _drill.land_turns(state, bit_turns, striker_turns)

    def resolutions(self, p, mode):
        speed = _drill.speed_noise(p)
        return (_drill.friction_resolution(p, mode[0], _drill.stick_noise(p)), speed, speed)

    def slope_resolutions(self, p, mode, h):
        friction = _drill.friction_slope_resolution(p, mode[0], _drill.stick_noise(p), h)
        return (friction, *super().slope_resolutions(p, mode, h)[1:])

    def pull(self, p, state):
        return _drill.pull(p, state[0], state[2])

    def in_sight(self, p, mode, polynomials):
        return _drill.in_sight(self.friction, p, mode[0], polynomials[1])

    def rate(self, p, mode):
        return _drill.flight_rate(p)


SCENE = Rotary
