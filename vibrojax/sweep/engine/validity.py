"""Rejection of lanes that are too stiff or too slow for the steps or the precision to give a meaningful regime."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from vibrojax.compile.xla import precision
from vibrojax.models.scenes import HasContact, HasFriction
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.input.definition import Sweep

TOO_STIFF, TOO_SLOW = "too-stiff", "too-slow"

FLIGHT_MAX_STEPS = 1e7
"""Limit on the length of a run in units of the shortest time scale of the flight. It is several times the number of
steps after which a lane is abandoned."""

_ROUNDINGS = 512
"""Smallest relative change that is resolved, in units of machine epsilon."""

LanesFloat = Float[np.ndarray, "*lanes"]
LanesBool = Bool[np.ndarray, "*lanes"]
Parameters = Mapping[str, Any]


def too_stiff(sweep: Sweep, p: Parameters) -> LanesBool:
    """Return a mask of the lanes that are `unresolved` or whose flight takes too many steps.

    `p`: parameters by name, each (lanes,).
    """
    scene = sweep.system
    if not isinstance(scene, HasFriction) or not sweep.run.stepper.rests:
        return np.zeros(_shape(p), bool)
    rates = _rates(scene, p)
    with np.errstate(all="ignore"):
        steps = rates.flight * (sweep.run.settle + sweep.run.observe)
        known = np.isfinite(rates.flight + rates.contact)
    return known & (unresolved(scene, p, sweep.run.precision) | ~(steps < FLIGHT_MAX_STEPS))


def too_slow(sweep: Sweep, p: Parameters) -> LanesBool:
    """Return a mask of the lanes whose drive is so slow that it cannot be distinguished from rest.

    The threshold is a multiple of the rounding error of a typical speed, to which friction and main spring contribute.
    `p`: parameters by name, each (lanes,).
    """
    scene = sweep.system
    if not isinstance(scene, HasFriction) or not sweep.run.stepper.rests:
        return np.zeros(_shape(p), bool)
    with np.errstate(all="ignore"):
        return (p["v"] > 0) & (p["v"] < _ROUNDINGS * np.finfo(sweep.run.precision).eps * _rates(scene, p).speed)


def unresolved(scene: HasFriction[Any], p: Parameters, numbers: str) -> LanesBool:
    """Return a mask of the lanes in which a step changes nothing in the precision `numbers` ("float64" or "float32").

    During a step of length 1/rate, the bit's motion on its main spring is less than the rounding error.
    """
    rates = _rates(scene, p)
    with np.errstate(all="ignore"):
        return np.asarray(~(_ROUNDINGS * np.finfo(numbers).eps * (rates.flight + rates.contact) < rates.spring))


def flight_rates(scene: HasFriction[Any], p: Parameters) -> LanesFloat:
    """Return a bound on the fastest rate in flight [1/s], which determines the step size. `p`: parameters of lanes."""
    return _rates(scene, p).flight


class _Rates(NamedTuple):
    """Bounds on the fastest rates [1/s], and a typical speed.

    - `flight`: rate in flight.
    - `contact`: additional rate in contact.
    - `spring`: rate of the bit on its main spring.
    - `speed`: typical speed [m/s].
    """

    flight: Any
    contact: Any
    spring: Any
    speed: Any


def _shape(p: Parameters) -> tuple[int, ...]:
    return np.broadcast_shapes(*(np.shape(x) for x in p.values()))


def _rates(scene: HasFriction[Any], p: Parameters) -> _Rates:
    with precision("float64"):
        lanes = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in p.values()))
        rates = _compiled_rates(scene, dict(zip(p, lanes, strict=True)))
        return _Rates(*(np.asarray(x).reshape(_shape(p)) for x in rates))


@lane_function(static=1)
def _compiled_rates(scene: HasFriction[Any], p: Parameters) -> _Rates:
    c = scene.constants(p)
    flight = scene.flight_rate(c)
    contact = scene.contact_rate(c) if isinstance(scene, HasContact) else jnp.zeros_like(flight)
    return _Rates(*jnp.broadcast_arrays(flight, contact, scene.spring_rate(c), scene.typical_speed(c)))
