"""The bit on the rock as a hybrid system in terms of the rock's compression e = x3 - x4 (source, eqs. 6.1 to 6.3).

The mode of the rock is 0 while elastic (0 < k3 e < D) and 1 while yielding (N = D, x4 grows with x3). The mode is -1
while the bit is off the rock (N = 0). In mode 2 the unloaded bit is at rest (e = x3' = 0 within rounding error), so no
steps are needed. The motion of e and x3' does not depend on the depth of the hole.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.physics.rock import damping
from vibrojax.scenes.capabilities import HasRock
from vibrojax.scenes.declared import Guard, Mode, State, Values
from vibrojax.scenes.scene import ROUNDINGS

REST = 2

STATES = (
    State("compression", "m", "compression of the rock", shown=False),
    State("v3", "m s-1", "normal velocity of the bit", is_velocity=True),
    State("growth", "m", "growth of the hole", shown=False),
)
MODE = Mode("rock", "0 elastic, 1 yielding, -1 off the rock, 2 at rest", REST)


class RockConstants(NamedTuple):
    """The constants of the bit on the rock, each (lanes,).

    - `m1` [kg]: mass of the bit; `inverse_m1` [1/kg].
    - `k3` [N/m], `threshold` D [N], `c3` [N s/m]: stiffness, yield force and damping of the rock.
    - `yield_compression` [m]: D/k3; `mobility` [m/s/N]: velocity of the bit per force, 1/sqrt(k3 m1).
    - `g` [m/s²]: gravity; forces much smaller than the bit's weight leave the bit at rest.
    """

    m1: Any
    inverse_m1: Any
    k3: Any
    threshold: Any
    c3: Any
    yield_compression: Any
    mobility: Any
    g: Any


def rock_constants(p: Mapping[str, Any], g: Any) -> RockConstants:
    """Return the constants from `m1`, `k3`, `threshold` and `zeta` in `p`, and from gravity `g` [m/s²]."""
    m1, k3, threshold = p["m1"], p["k3"], p["threshold"]
    return RockConstants(
        m1=m1,
        inverse_m1=1 / m1,
        k3=k3,
        threshold=threshold,
        c3=damping(m1, k3, p["zeta"]),
        yield_compression=threshold / k3,
        mobility=1 / jnp.sqrt(k3 * m1),
        g=g,
    )


class OnRock(HasRock[Any]):
    """Base class of scenes with the bit on the rock: their guards and reset for `STATES` and `MODE` of this module."""

    def threshold(self, c: Any) -> Any:
        return c.rock.threshold

    def stiffness(self, c: Any) -> Any:
        return c.rock.k3

    def rock_period(self, c: Any) -> Any:
        return _period(c.rock)

    def rock_rates(self, c: Any, mode: Values, state: Values, applied: Any) -> Values:
        """Return (e', x3'', x4') in the mode under the force `applied` [N] (source, eq. 6.1).

        It accepts arrays and Taylor series.
        """
        which, _, v3 = self._rock_motion(mode, state)
        yielding, moves = _is(which, 1), jnp.where(which == REST, 0.0, 1.0)
        bit = (applied - self.rock_force(c, mode, state) - v3 * c.rock.c3) * (moves * c.rock.inverse_m1)
        return (v3 * (1.0 - yielding), bit, v3 * yielding)

    def rock_guards(self) -> tuple[Guard, ...]:
        """Return the two guards of the rock.

        `yield`: yielding begins or ends. `rock`: the bit leaves the rock or touches it again.
        """

        def yields(c: Any, mode: Values, state: Values) -> Any:
            which, compression, v3 = self._rock_motion(mode, state)
            elsewhere = jnp.where(which < 0, 1.0, 0.0) + _is(which, REST)
            ends = v3 * (_is(which, 1) * _period(c.rock))
            return (c.rock.yield_compression - compression) * _is(which, 0) + ends + elsewhere

        def touches(c: Any, mode: Values, state: Values) -> Any:
            which, compression, _ = self._rock_motion(mode, state)
            return compression * (_is(which, 0) - jnp.where(which < 0, 1.0, 0.0)) + (_is(which, 1) + _is(which, REST))

        return Guard("yield", yields, self.rock_resolution), Guard("rock", touches, self.rock_resolution)

    def rock_resolution(self, c: Any, mode: Values) -> Any:
        """Return the magnitude [m] up to which values of the two guards count as zero."""
        length = c.rock.yield_compression + c.rock.mobility * _period(c.rock)
        return ROUNDINGS * jnp.finfo(c.rock.m1.dtype).eps * length

    def reset_rock(self, c: Any, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Return the mode of the rock, the compression and the velocity of the bit after an event."""
        which, compression, v3 = self._rock_motion(mode, state)
        yields, touches = hits["yield"], hits["rock"]
        begins, ends = yields & (which == 0), yields & (which == 1)
        compression = jnp.where(begins, c.rock.yield_compression, jnp.where(touches, 0.0, compression))
        v3 = jnp.where(ends, 0.0, v3)
        which = jnp.where(begins, 1.0, jnp.where(ends, 0.0, which))
        return jnp.where(touches, -1.0 - which, which), compression, v3

    def _rock_motion(self, mode: Values, state: Values) -> tuple[Any, Any, Any]:
        """Return the mode of the rock, the compression and the velocity of the bit."""
        return mode[self.mode_place("rock")], state[self.place("compression")], state[self.place("v3")]


def rock_at(c: RockConstants, compression: Any, v3: Any) -> Any:
    """Return the mode of the rock: it yields if compressed to its limit while the bit still moves into it."""
    yields = (compression >= c.yield_compression) & (v3 > 0)
    return jnp.where(compression < 0, -1.0, jnp.where(yields, 1.0, 0.0))


def at_rest(c: RockConstants, rock: Any, compression: Any, v3: Any, loaded: Any) -> tuple[Any, Any, Any]:
    """Return mode, compression and velocity after the checks for rest.

    An unloaded motion that has decayed is set to rest. A bit at rest becomes elastic where it is `loaded`. A motion has
    decayed if its velocity is within rounding error of the velocity scale of the bit's weight.
    """
    small = ROUNDINGS * jnp.finfo(v3.dtype).eps * c.mobility * c.m1 * c.g
    still = (rock == 0) & (jnp.abs(v3) <= small) & (jnp.abs(compression) <= small * _period(c)) & ~loaded
    rock = jnp.where(still, REST, jnp.where((rock == REST) & loaded, 0.0, rock))
    return rock, jnp.where(still, 0.0, compression), jnp.where(still, 0.0, v3)


def rock_rate(c: RockConstants, rock: Any, only_prescribed: Any) -> Any:
    """Return the fastest rate of change of the bit on the rock [1/s].

    An overdamped bit under `only_prescribed` forces relaxes and reaches no guard twice in a step. The tolerance of the
    Taylor series then limits the step, provided that the step damps the faster of the two exponentials. At order 10 the
    step must therefore be below 5 divided by the faster rate. Half the faster rate at a stride of 2 gives a step of 4
    divided by the faster rate.
    """
    own, half = jnp.sqrt(c.k3 * c.inverse_m1), 0.5 * c.c3 * c.inverse_m1
    relaxes = half > own
    faster = half + jnp.sqrt(jnp.where(relaxes, half * half - own * own, 1.0))
    return jnp.where(relaxes & (rock == 0) & only_prescribed, 0.5 * faster, own + 2.0 * half)


def _period(c: RockConstants) -> Any:
    """Return the time scale [s] that converts a velocity of the bit to a compression, sqrt(m1/k3)."""
    return jnp.sqrt(c.m1 / c.k3)


def _is(rock: Any, mode: int) -> Any:
    return jnp.where(rock == mode, 1.0, 0.0)
