"""The bit on the rock as a hybrid system, by the compression e = x3 - x4 (eqs. 6.1 to 6.3).

The rock's modes are 0 elastic (0 < k3 e < D), 1 yielding (N = D, x4 grows with x3) and -1 off the rock (N = 0). In
mode 2 the bit is at rest, unloaded (e = x3' = 0 within roundings), and needs no steps. The motion of e and x3' does not
depend on the depth of the hole.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax.numpy as jnp

from vibrojax.models.physics import rock as rocks
from vibrojax.models.scenes.capabilities import HasRock
from vibrojax.models.scenes.declared import Guard, Mode, State, Values
from vibrojax.models.scenes.scene import ROUNDINGS

REST = 2

STATES = (
    State("compression", "m", "compression of the rock", shown=False),
    State("v3", "m s-1", "normal velocity of the bit", is_velocity=True),
    State("growth", "m", "growth of the hole", shown=False),
)
MODE = Mode("rock", "0 elastic, 1 yielding, -1 off the rock, 2 at rest", REST)


class RockConstants(NamedTuple):
    """The constants of the bit on the rock, each (lanes,).

    - `m1` of the bit [kg], `inverse_m1` [1/kg]; `k3` [N/m], `threshold` D [N] and damping `c3` [N s/m] of the rock.
    - `yield_compression` D/k3 [m]; `mobility` [m/s/N]: velocity of the bit per force.
    - `g` [m/s²]: the bit's weight is the scale of forces that leave it at rest.
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
    """Return the constants for `m1`, `k3`, `threshold` and `zeta` in `p`, and gravity `g` [m/s²]."""
    m1, k3, threshold = p["m1"], p["k3"], p["threshold"]
    return RockConstants(
        m1=m1,
        inverse_m1=1 / m1,
        k3=k3,
        threshold=threshold,
        c3=rocks.damping(m1, k3, p["zeta"]),
        yield_compression=rocks.yield_compression(k3, threshold),
        mobility=1 / jnp.sqrt(k3 * m1),
        g=g,
    )


@runtime_checkable
class WithRock(Protocol):
    """Constants of a scene that include the rock's."""

    @property
    def rock(self) -> RockConstants: ...


R = TypeVar("R", bound=WithRock)


class OnRock(HasRock[R]):
    """A scene whose bit is on the rock: it has the states and the mode above, and these guards and this reset."""

    def threshold(self, c: R) -> Any:
        return c.rock.threshold

    def stiffness(self, c: R) -> Any:
        return c.rock.k3

    def rock_period(self, c: R) -> Any:
        return _period(c.rock)

    def rock_rates(self, c: R, mode: Values, state: Values, applied: Any) -> Values:
        """Return (e', x3'', x4') in the mode under the force `applied` [N] (eq. 6.1); arrays and series."""
        which, compression, v3 = self._rock_motion(mode, state)
        yielding, moves = _is(which, 1), jnp.where(which == REST, 0.0, 1.0)
        resistance = rocks.resistance(compression, c.rock.k3, c.rock.threshold, rocks.part(which))
        bit = (applied - resistance - v3 * c.rock.c3) * (moves * c.rock.inverse_m1)
        return (v3 * (1.0 - yielding), bit, v3 * yielding)

    def rock_guards(self) -> tuple[Guard, ...]:
        """Return the guards `yield`, which begins and ends yielding, and `rock`: the bit leaves or returns to it."""

        def yields(c: R, mode: Values, state: Values) -> Any:
            which, compression, v3 = self._rock_motion(mode, state)
            elsewhere = _is_off(which) + _is(which, REST)
            ends = v3 * (_is(which, 1) * _period(c.rock))
            return (c.rock.yield_compression - compression) * _is(which, 0) + ends + elsewhere

        def touches(c: R, mode: Values, state: Values) -> Any:
            which, compression, _ = self._rock_motion(mode, state)
            return compression * (_is(which, 0) - _is_off(which)) + (_is(which, 1) + _is(which, REST))

        return Guard("yield", yields, self.rock_resolution), Guard("rock", touches, self.rock_resolution)

    def rock_resolution(self, c: R, mode: Values) -> Any:
        """Return the values of the two guards that count as zero [m]."""
        length = c.rock.yield_compression + c.rock.mobility * _period(c.rock)
        return ROUNDINGS * jnp.finfo(c.rock.m1.dtype).eps * length

    def reset_rock(self, c: R, mode: Values, state: Values, hits: Mapping[str, Any]) -> tuple[Any, Any, Any]:
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
    """Return the mode at a state: the rock yields if it is compressed to its limit and the bit is still driven in."""
    yields = (compression >= c.yield_compression) & (v3 > 0)
    return jnp.where(compression < 0, -1.0, jnp.where(yields, 1.0, 0.0))


def at_rest(c: RockConstants, rock: Any, compression: Any, v3: Any, loaded: Any) -> tuple[Any, Any, Any]:
    """Return mode, compression and velocity, at rest if the motion has decayed, and woken if `loaded`.

    A motion has decayed to a few roundings of the velocity that the bit's weight would give to it.
    """
    small = ROUNDINGS * jnp.finfo(v3.dtype).eps * c.mobility * c.m1 * c.g
    still = (rock == 0) & (jnp.abs(v3) <= small) & (jnp.abs(compression) <= small * _period(c)) & ~loaded
    rock = jnp.where(still, REST, jnp.where((rock == REST) & loaded, 0.0, rock))
    return rock, jnp.where(still, 0.0, compression), jnp.where(still, 0.0, v3)


def rock_rate(c: RockConstants, rock: Any, only_prescribed: Any) -> Any:
    """Return the fastest rate of change of the bit on the rock [1/s].

    If `only_prescribed` forces act on an overdamped bit, it relaxes and touches no guard twice in a step. The series'
    tolerance then limits the steps, as long as they damp the faster of the two exponentials. That limit is 5 over its
    rate at order 10; half of the rate at a stride of 2 gives 4.
    """
    own, half = jnp.sqrt(c.k3 * c.inverse_m1), 0.5 * c.c3 * c.inverse_m1
    relaxes = half > own
    faster = half + jnp.sqrt(jnp.where(relaxes, half * half - own * own, 1.0))
    return jnp.where(relaxes & (rock == 0) & only_prescribed, 0.5 * faster, own + 2.0 * half)


def _period(c: RockConstants) -> Any:
    """Return the time [s] that converts a velocity of the bit to a compression."""
    return jnp.sqrt(c.m1 / c.k3)


def _is(rock: Any, mode: int) -> Any:
    return jnp.where(rock == mode, 1.0, 0.0)


def _is_off(rock: Any) -> Any:
    return jnp.where(rock < 0, 1.0, 0.0)
