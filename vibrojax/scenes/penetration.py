"""The penetration scene: the bit on the rock under a prescribed force (pulses or a swept sine), and that force."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any, NamedTuple

import numpy as np

from vibrojax.lazy import jnp
from vibrojax.physics.elementary import sin
from vibrojax.physics.parameters import BIT_AND_STRIKER, Parameter, not_negative, positive, table
from vibrojax.physics.rock import ROCK
from vibrojax.scenes import bit_on_rock
from vibrojax.scenes.bit_on_rock import OnRock, RockConstants, rock_constants
from vibrojax.scenes.capabilities import Driven
from vibrojax.scenes.declared import Guard, Marker, Mode, Start, State, Values
from vibrojax.scenes.scene import ROUNDINGS

PULSE_SHAPES = ("rectangular", "half-sine", "sweep")


PULSES = table(
    not_negative("force", 200e3, "N", "greatest force of a pulse", "A", (50e3, 500e3)),
    positive("frequency", 20.0, "s-1", "pulses per second", "f", (10.0, 40.0)),
    positive("pulse_width", 4e-3, "s", "duration of a pulse", "w", (1e-3, 10e-3)),
)

SWEEP = table(
    not_negative("force", 200e3, "N", "amplitude of the swept sine", "A", (50e3, 500e3)),
    not_negative("sweep_start", 0.0, "s-1", "frequency of the swept sine at t = 0", "f₀", (0.0, 100.0)),
    Parameter("sweep_rate", 10.0, "s-2", "rate of change of the swept sine's frequency", "r"),
    Parameter("bias", 0.0, "N", "constant part of the force", "B", usual=(20e3, 100e3)),
)


class PenetrationConstants(NamedTuple):
    """Constants of the bit on the rock and of the force; constants that the kind of force does not use are 0.

    - `force` [N]: amplitude of the force.
    - `frequency` [1/s], `pulse_width` [s]: pulses per second and duration of a pulse.
    - `sweep_start` [1/s], `sweep_rate` [1/s²], `bias` [N]: initial frequency, rate and constant part of a swept sine.
    - `period` [s]: time between the beginnings of pulses, infinite without pulses.
    - `speed` [m/s]: typical speed of the bit, the greatest force times the bit's mobility.
    """

    rock: RockConstants
    force: Any
    period: Any
    speed: Any
    frequency: Any = 0.0
    pulse_width: Any = 0.0
    sweep_start: Any = 0.0
    sweep_rate: Any = 0.0
    bias: Any = 0.0


@dataclass(frozen=True)
class Penetration(OnRock, Driven[Any]):
    """The bit on the rock, without a drill, under rectangular pulses, half-sine pulses or a swept sine.

    m1 x3'' + c3 x3' = -N + I(t), N = clip(k3 (x3 - x4), 0, D) (source, eqs. 6.1 to 6.3).
    States: compression x3 - x4, x3', the growth of x4 and the time, both since the last pulse began; for a swept sine,
    since t = 0. The total depth of the hole is not a state, so rounding errors of a large depth cannot affect the
    motion.
    """

    pulse_shape: str = "rectangular"

    name = "penetration"
    states = (*bit_on_rock.STATES, State("since", "s", "time since the last pulse began", shown=False))
    modes = (bit_on_rock.MODE, Mode("pushing", "1 during a pulse", 0.0))
    markers = (Marker("bit_turn", "v3"),)
    pulse_states = ("compression", "v3")
    choices = OnRock.choices | {"pulse_shape": {shape: shape for shape in PULSE_SHAPES}}
    autonomous = False

    @property
    def has_pulses(self) -> bool:
        return self.pulse_shape != "sweep"

    @property
    def _force_parameters(self) -> Mapping[str, Parameter]:
        return PULSES if self.has_pulses else SWEEP

    def parameters(self) -> Mapping[str, Parameter]:
        return {"m1": BIT_AND_STRIKER["m1"], **ROCK, **self._force_parameters}

    def constants(self, p: Mapping[str, Any]) -> PenetrationConstants:
        # This scene has no gravity; a usual weight only sets the scale of rounding errors.
        rock = rock_constants(p, BIT_AND_STRIKER["g"].default)
        bias = 0.0 if self.has_pulses else jnp.abs(p["bias"])
        return PenetrationConstants(
            rock=rock,
            period=1 / p["frequency"] if self.has_pulses else jnp.full_like(p["m1"], jnp.inf),
            speed=(jnp.abs(p["force"]) + bias) * rock.mobility,
            **{name: p[name] for name in self._force_parameters},
        )

    def refused(self, p: Mapping[str, Any]) -> tuple[str, Any] | None:
        if self.has_pulses:
            return "pulse-width-not-below-1/frequency", p["pulse_width"] * p["frequency"] >= 1
        return None

    def speed_scale(self, c: Any) -> Any:
        return c.speed

    def start(self, c: Any, name: Start, shape: tuple[int, ...]) -> Values:
        xp = np if isinstance(c.rock.m1, np.ndarray) else jnp  # as in `rotary`
        return (xp.zeros(shape, c.rock.m1.dtype),) * 4

    def mode_at(self, c: Any, state: Values) -> Values:
        return (bit_on_rock.rock_at(c.rock, state[0], state[1]), jnp.ones_like(state[0]))

    def applied_force(self, c: Any, mode: Values, state: Values) -> Any:
        since = state[3]
        if self.pulse_shape == "rectangular":
            return mode[1] * c.force + 0.0 * since
        if self.pulse_shape == "half-sine":
            return (mode[1] * c.force) * sin(since * (pi / c.pulse_width))
        return c.force * sin((since * c.sweep_rate * 0.5 + c.sweep_start) * since * (2 * pi)) + c.bias

    def field(self, c: Any, mode: Values, state: Values) -> Values:
        rates = self.rock_rates(c, mode, state, self.applied_force(c, mode, state))
        return (*rates, 0.0 * state[3] + 1.0)

    def guards(self) -> tuple[Guard, ...]:
        def time_left(c: Any, mode: Values, state: Values) -> Any:
            pushing, since = mode[1], state[3]
            if not self.has_pulses:
                return 0.0 * since + 1.0
            return (pushing * c.pulse_width + (1.0 - pushing) * c.period) - since

        def time_noise(c: Any, mode: Values) -> Any:
            longest = jnp.where(jnp.isfinite(c.period), c.period, 1.0)
            return ROUNDINGS * jnp.finfo(c.rock.m1.dtype).eps * longest

        return (*self.rock_guards(), Guard("pulse", time_left, time_noise))

    def reset(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        rock, compression, v3 = self.reset_rock(c, mode, state, hits)
        begins = self.pulse_begins(c, mode, hits)
        pushing = jnp.where(hits["pulse"], 1.0 - mode[1], mode[1])
        growth = jnp.where(begins, 0.0, state[2])
        # While yielding, the compression is D/k3 whatever its history. With this assignment, the return map does not
        # depend on the compression at the previous pulse.
        compression = jnp.where(begins & (rock == 1), c.rock.yield_compression, compression)
        if self.has_pulses:
            rock, compression, v3 = bit_on_rock.at_rest(c.rock, rock, compression, v3, pushing != 0)
        since = jnp.where(begins, 0.0, jnp.where(hits["pulse"], c.pulse_width, state[3]))
        return (rock, pushing), (compression, v3, growth, since)

    def pulse_begins(self, c: Any, mode: Values, hits: Mapping[str, Any]) -> Any:
        return hits["pulse"] & (mode[1] == 0)

    def rate(self, c: Any, mode: Values) -> Any:
        rates = bit_on_rock.rock_rate(c.rock, mode[0], True)
        if self.has_pulses:
            rates = jnp.where(mode[0] == bit_on_rock.REST, c.frequency, rates)
        if self.pulse_shape == "half-sine":
            rates = jnp.maximum(rates, pi / c.pulse_width)
        return rates


SCENES = (Penetration,)
