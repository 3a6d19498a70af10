"""The penetration scene: the bit on the rock under a given force, rectangular or half-sine pulses or a swept sine."""

from dataclasses import dataclass
from math import pi

import jax.numpy as jnp

from vibrojax.physics.elementary import sin
from vibrojax.physics.parameters import BIT_AND_STRIKER
from vibrojax.physics.pulses import PULSES, SWEEP
from vibrojax.physics.rock import ROCK
from vibrojax.scenes import _rock
from vibrojax.scenes._scene import Scene

PULSE_SHAPES = ("rectangular", "half-sine", "sweep")


@dataclass(frozen=True)
class Penetration(Scene):
    """m1 x3'' + c3 x3' = -N + I(t), N = clip(k3 (x3 - x4), 0, D) (eqs. 6.1 to 6.3).

    States: compression x3 - x4, x3', the growth of x4 since the last pulse began, and the time since then (for a swept
    sine: since t = 0). What has been drilled before is thus no part of the state, and cannot blur it.
    """

    pulse_shape: str = "rectangular"

    name = "penetration"
    states = ("compression", "v3", "growth", "since")
    velocities = (1,)
    modes = ("rock", "pushing")
    surfaces_named = ("yield", "contact", "pulse")
    markers_named = ("bit_turn",)
    bit_turn = 3  # where hits holds it
    measures = ("penetration",)
    starts = ()
    autonomous = False

    @property
    def has_pulses(self) -> bool:
        """Whether the force comes in pulses."""
        return self.pulse_shape != "sweep"

    def parameters(self):
        mass = {"m1": BIT_AND_STRIKER["m1"]}
        return mass | ROCK | (PULSES if self.has_pulses else SWEEP)

    def constants(self, p):
        p = _rock.with_derived(p)
        bias = 0.0 if self.has_pulses else jnp.abs(p["bias"])
        return p | {
            "turns": 1 / p["frequency"] if self.has_pulses else jnp.full_like(p["m1"], jnp.inf),
            "speed_scale": (jnp.abs(p["force"]) + bias) * p["mobility"],
        }

    def refused(self, p):
        if self.has_pulses:
            return "pulse-width-not-below-1/frequency", p["pulse_width"] * p["frequency"] >= 1
        return None

    def start(self, p, name, shape):
        zero = jnp.zeros(shape, p["m1"].dtype)
        return (zero, zero, zero, zero)

    def mode_at(self, p, state):
        return (jnp.zeros_like(state[0]), jnp.ones_like(state[0]))

    def applied_force(self, p, mode, state):
        """I [N]; takes arrays and series."""
        since = state[3]
        if self.pulse_shape == "rectangular":
            return mode[1] * p["force"] + 0.0 * since
        if self.pulse_shape == "half-sine":
            return (mode[1] * p["force"]) * sin(since * (pi / p["pulse_width"]))
        return p["force"] * sin((since * p["sweep_rate"] * 0.5 + p["sweep_start"]) * since * (2 * pi)) + p["bias"]

    def field(self, p, mode, state):
        rock, bit = _rock.rates(p, mode[0], state[0], state[1], self.applied_force(p, mode, state))
        return (*rock[:1], bit, rock[1], 0.0 * state[3] + 1.0)

    def surfaces(self, p, mode, state):
        return (*_rock.surfaces(p, mode[0], state[0], state[1]), self._pulse_surface(p, mode[1], state[3]))

    def _pulse_surface(self, p, pushing, since):
        """Time left to the end of the pulse, or to the next."""
        if not self.has_pulses:
            return 0.0 * since + 1.0
        return (pushing * p["pulse_width"] + (1.0 - pushing) * p["turns"]) - since

    def markers(self, p, state):
        return (state[1],)

    def land(self, p, mode, state, hits):
        yields, touches, pulse, turns = hits
        rock, compression, v3 = _rock.land(p, mode[0], state[0], state[1], yields, touches)
        v3 = jnp.where(turns, 0.0, v3)
        begins = self.pulse_begins(p, mode, hits)
        pushing = jnp.where(pulse, 1.0 - mode[1], mode[1])
        growth = jnp.where(begins, 0.0, state[2])
        if self.has_pulses:
            rock, compression, v3 = _rock.rest(p, rock, compression, v3, pushing != 0)
        since = jnp.where(begins, 0.0, jnp.where(pulse, p.get("pulse_width", 0.0), state[3]))
        return (rock, pushing), (compression, v3, growth, since)

    def pulse_begins(self, p, mode, hits):
        """Where a pulse begins."""
        return hits[2] & (mode[1] == 0)

    def resolutions(self, p, mode):
        eps = 64 * jnp.finfo(p["m1"].dtype).eps
        longest = jnp.where(jnp.isfinite(p["turns"]), p["turns"], 1.0)
        return (*_rock.resolutions(p), eps * longest, eps * p["speed_scale"])

    def rate(self, p, mode):
        rates = _rock.rate(p, mode[0], True)
        if self.has_pulses:
            rates = jnp.where(mode[0] == _rock.REST, p["frequency"], rates)
        if self.pulse_shape == "half-sine":
            rates = jnp.maximum(rates, pi / p["pulse_width"])
        return rates

    def smoothed_field(self, p, mode, state, width):
        return self.field(p, mode, state)  # nothing in it is smoothed

    def smoothed_mode(self, p, mode, state, width):
        return mode

    def smoothed_surfaces(self, p, mode, state):
        return self.surfaces(p, mode, state)


SCENE = Penetration
