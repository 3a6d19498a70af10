"""The vibro-impact scene, whose striker hits the bit (source, eq. 5.18), the base of every drill with impacts.

The contact is one-sided: the mode `touching` is 0 (apart) until compression and force are positive, then 1 until the
force is zero.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from vibrojax.lazy import jnp
from vibrojax.physics.contact import contact_time, raw_force
from vibrojax.physics.elementary import maximum
from vibrojax.physics.parameters import BIT_AND_STRIKER, CONTACT, Parameter
from vibrojax.scenes.capabilities import HasContact
from vibrojax.scenes.declared import Guard, Mode, Start, Values
from vibrojax.scenes.rotary import DrillConstants, Rotary, length_noise
from vibrojax.scenes.scene import ROUNDINGS


class ContactConstants(NamedTuple):
    """Constants of the contact, each (lanes,).

    Stiffness `k0` [N/m], damping `c0` [N s/m], gap `delta` [m], and relaxation time `relaxation` = c0/k0 [s].
    """

    k0: Any
    c0: Any
    delta: Any
    relaxation: Any


class VibroImpactConstants(NamedTuple):
    """Constants of the two masses and of the contact between them."""

    drill: DrillConstants
    contact: ContactConstants


@dataclass(frozen=True)
class VibroImpact(Rotary, HasContact[Any]):
    """Bit and striker with stick-slip friction; the striker hits the bit through a one-sided contact.

    m1 x1'' = -k1 x1 - k2 (x1 - x2) - F(u, J); m2 x2'' = -c2 x2' - k2 (x2 - x1) - J (eq. 5.18)
    """

    name = "vibro-impact"
    modes: ClassVar[tuple[Mode, ...]] = (*Rotary.modes, Mode("touching", "1 where striker and bit touch", 0.0))
    starts: ClassVar[tuple[str, ...]] = (*Rotary.starts, "touching")
    measures: ClassVar[tuple[Any, ...]] = ("swings", "shares", "impacts", "harmonics")
    own_parameters: ClassVar[dict[str, Parameter]] = BIT_AND_STRIKER | CONTACT

    def constants(self, p: Mapping[str, Any]) -> Any:
        [drill] = super().constants(p)
        return VibroImpactConstants(drill, ContactConstants(p["k0"], p["c0"], p["delta"], p["c0"] / p["k0"]))

    def compression(self, c: Any, mode: Values, state: Values) -> tuple[Any, Any]:
        """Return the compression of the contact [m] and the compression rate [m/s]; Taylor series are accepted."""
        return state[2] - c.contact.delta, state[3]

    def compressed(self, c: Any, state: Values, before: Any, after: Any) -> Any:
        """Return the position x2 [m] at which the contact's compression is `after` instead of `before` [m]."""
        return c.contact.delta + after

    def start(self, c: Any, name: Start, shape: tuple[int, ...]) -> Values:
        x1, v1, x2, *others = super().start(c, name, shape)
        if name == "touching":  # as `drive`, but without the kick of a preloaded contact (R13)
            xp = np if isinstance(x2, np.ndarray) else jnp  # as in `rotary`
            x2 = xp.minimum(x2, c.contact.delta)
        return (x1, v1, x2, *others)

    def mode_at(self, c: Any, state: Values, *others: Any) -> Values:
        pushed = c.drill.k2 * (state[0] - state[2]) - c.drill.c2 * state[3]
        compression, rate = self.compression(c, (None, None, *others), state)
        # At zero compression and zero rate, the force that pushes the striker closes the contact.
        closes = (rate > 0) | ((rate == 0) & (pushed > 0))
        inside = (compression > 0) & (raw_force(compression, rate, c.contact.k0, c.contact.c0) > 0)
        touching = jnp.where(inside | ((compression == 0) & closes), 1.0, 0.0)
        return super().mode_at(c, state, touching, *others)

    def guards(self) -> tuple[Guard, ...]:
        def touches(c: Any, mode: Values, state: Values) -> Any:
            """Return J/k0 while touching; while apart, the distance from the state in which contact begins [m]."""
            compression, rate = self.compression(c, mode, state)
            length = compression + c.contact.relaxation * rate
            # Contact begins when compression and force are both positive. A striker released while still compressed
            # (c0 > 0) is therefore not caught again at once.
            return mode[1] * length + (1.0 - mode[1]) * maximum(-compression, -length)

        return (*super().guards(), Guard("contact", touches, lambda c, mode: length_noise(c.drill)))

    def other_reset(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Values, Values]:
        hit, (before, rate) = hits["contact"], self.compression(c, mode, state)
        # The compression is set to its exact value on the guard.
        after = jnp.where(hit & (mode[1] != 0), -c.contact.relaxation * rate, before)
        after = jnp.where(self._begins(c, mode, before, rate, hit), 0.0, after)
        x2 = jnp.where(hit, self.compressed(c, state, before, after), state[2])
        return (mode[0], jnp.where(hit, 1.0 - mode[1], mode[1]), *mode[2:]), (state[0], state[1], x2, *state[3:])

    def _begins(self, c: Any, mode: Values, compression: Any, rate: Any, hit: Any) -> Any:
        # A contact that is released while still compressed (c0 > 0) may close again while compressed; that is not a new
        # impact.
        outside = compression <= length_noise(c.drill)
        return hit & (mode[1] == 0) & (c.contact.relaxation * rate >= 0) & outside

    def impact(self, c: Any, mode: Values, state: Values) -> Any:
        return self.contact_force(c, mode, state)

    def impact_noise(self, c: Any, mode: Values) -> Any:
        # A small multiple of the rounding error of the position, for a striker that meets the bit at the drive speed.
        reach = jnp.abs(c.contact.delta) + jnp.sqrt(c.drill.m2 / c.contact.k0) * c.drill.v
        return mode[1] * (ROUNDINGS * jnp.finfo(c.contact.k0.dtype).eps * c.contact.k0 * reach)

    def stored(self, c: Any, state: Values) -> Any:
        inside = jnp.maximum(state[2] - c.contact.delta, 0)
        return c.contact.k0 * inside * inside / 2

    def rate(self, c: Any, mode: Values) -> Any:
        flight, inverse = self.flight_rate(c), c.drill.inverse_m2
        stiff = jnp.sqrt(c.contact.k0 * inverse + flight * flight) + c.contact.c0 * inverse
        return jnp.where(mode[1] != 0, stiff, flight)

    def contact_force(self, c: Any, mode: Values, state: Values) -> Any:
        return mode[1] * raw_force(*self.compression(c, mode, state), c.contact.k0, c.contact.c0)

    def impact_rate(self, c: Any, mode: Values, state: Values) -> Any:
        return self.compression(c, mode, state)[1]

    def impact_begins(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> Any:
        return self._begins(c, mode, *self.compression(c, mode, state), hits["contact"])

    def striker_mass(self, c: Any) -> Any:
        return c.drill.m2

    def contact_time(self, c: Any) -> Any:
        return contact_time(c.drill.m2, c.contact.k0, c.contact.c0)

    def contact_rate(self, c: Any) -> Any:
        return jnp.sqrt(c.contact.k0 / c.drill.m2) + c.contact.c0 / c.drill.m2


SCENES = (VibroImpact,)
