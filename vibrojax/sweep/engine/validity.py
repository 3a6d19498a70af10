"""Rejection of lanes that are too stiff or too slow for the steps or the precision to give a meaningful regime."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from vibrojax.compile.xla import precision
from vibrojax.models.scenes import HasContact, HasFriction
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.input.definition import Sweep

FLIGHT_MAX_STEPS = 1e7
"""Limit on the length of a run in units of the shortest time scale of the flight. It is several times the number of
steps after which a lane is abandoned."""

RESOLVED_ROUNDINGS = 512
"""Smallest relative change that is resolved, in units of machine epsilon."""

LanesBool = Bool[np.ndarray, "*lanes"]
Parameters = Mapping[str, Any]


def too_stiff_or_slow(sweep: Sweep, p: Parameters) -> tuple[LanesBool, LanesBool]:
    """Return two masks of lanes; `p`: parameters by name, each (lanes,).

    The first mask holds the lanes that are `unresolved` or whose flight takes too many steps. The second one holds
    those whose drive is so slow that it cannot be distinguished from rest: it is below a multiple of the rounding error
    of a typical speed, to which friction and main spring contribute.
    """
    scene, run = sweep.system, sweep.run
    if not isinstance(scene, HasFriction) or not run.stepper.rests:
        none = np.zeros(_shape(p), bool)
        return none, none
    rates = fastest_rates(scene, p)
    with np.errstate(all="ignore"):
        known = np.isfinite(rates.flight + rates.contact)
        many = ~(rates.flight * (run.settle + run.observe) < FLIGHT_MAX_STEPS)
        slow = (p["v"] > 0) & (p["v"] < RESOLVED_ROUNDINGS * np.finfo(run.precision).eps * rates.speed)
    return known & (unresolved(scene, p, run.precision) | many), slow


def unresolved(scene: HasFriction[Any], p: Parameters, numbers: str) -> LanesBool:
    """Return a mask of the lanes in which a step changes nothing in the precision `numbers` ("float64" or "float32").

    During a step of length 1/rate, the bit's motion on its main spring is less than the rounding error.
    """
    rates = fastest_rates(scene, p)
    with np.errstate(all="ignore"):
        return np.asarray(~(RESOLVED_ROUNDINGS * np.finfo(numbers).eps * (rates.flight + rates.contact) < rates.spring))


class FastestRates(NamedTuple):
    """Bounds on the fastest rates [1/s], and a typical speed, each (lanes,).

    - `flight`: rate in flight, which determines the step size.
    - `contact`: additional rate in contact.
    - `spring`: rate of the bit on its main spring.
    - `speed`: typical speed [m/s].
    """

    flight: Any
    contact: Any
    spring: Any
    speed: Any


def fastest_rates(scene: HasFriction[Any], p: Parameters) -> FastestRates:
    """Return the fastest rates of lanes."""
    with precision("float64"):
        lanes = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in p.values()))
        rates = _compiled_rates(scene, dict(zip(p, lanes, strict=True)))
        return FastestRates(*(np.asarray(x).reshape(_shape(p)) for x in rates))


def _shape(p: Parameters) -> tuple[int, ...]:
    return np.broadcast_shapes(*(np.shape(x) for x in p.values()))


@lane_function(static=1)
def _compiled_rates(scene: HasFriction[Any], p: Parameters) -> FastestRates:
    c = scene.constants(p)
    flight = scene.flight_rate(c)
    contact = scene.contact_rate(c) if isinstance(scene, HasContact) else jnp.zeros_like(flight)
    return FastestRates(*jnp.broadcast_arrays(flight, contact, scene.spring_rate(c), scene.typical_speed(c)))
