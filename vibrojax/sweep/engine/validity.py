"""Lanes that are stiffer or slower than steps or numbers reach: refused, instead of a regime that means nothing."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from vibrojax.compile.devices import precision
from vibrojax.models.scenes import HasContact, HasFriction
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.input.definition import Sweep

TOO_STIFF, TOO_SLOW = "too-stiff", "too-slow"
MOST_STEPS = 1e7
"""Of the mode's own time scale, that a run may have: several times those after which a lane is given up."""

Lanes = Float[np.ndarray, "*lanes"]
Refused = Bool[np.ndarray, "*lanes"]
Numbers = Mapping[str, Any]


def too_stiff(sweep: Sweep, p: Numbers) -> Refused:
    """Which lanes of parameters `p`, each (lanes,), are faster than can be resolved; booleans (lanes,).

    Those of [vibrojax.sweep.engine.validity.unresolved][], and those whose steps of the flight do not come to an end.
    """
    scene = sweep.system
    if not isinstance(scene, HasFriction) or not sweep.run.stepper.rests:
        return np.zeros(np.broadcast_shapes(*(np.shape(x) for x in p.values())), bool)
    flight, contact, *_ = _paces(scene, p)
    with np.errstate(all="ignore"):
        steps = flight * (sweep.run.settle + sweep.run.observe)
        known = np.isfinite(flight + contact)
    return known & (unresolved(scene, p, sweep.run.precision) | ~(steps < MOST_STEPS))


def unresolved(scene: HasFriction[Any], p: Numbers, numbers: str) -> Refused:
    """Where 1/rate, the time that a step takes, is so short that what the bit on its main spring does meanwhile
    vanishes in the roundings of the `numbers`, "float64" or "float32": nothing would move; booleans (lanes,)."""
    paces = _paces(scene, p)
    with np.errstate(all="ignore"):
        return np.asarray(~(512 * np.finfo(numbers).eps * (paces.flight + paces.contact) < paces.spring))


def flight_rates(scene: HasFriction[Any], p: Numbers) -> Lanes:
    """A bound on the fastest rate [1/s] of lanes of parameters `p` in flight, from which their steps follow."""
    return _paces(scene, p).flight


class _Paces(NamedTuple):
    """Bounds on the fastest rates [1/s], by springs and damper in flight and what the contact adds to it; the rate of
    the bit on its main spring; and a typical speed [m/s]."""

    flight: Any
    contact: Any
    spring: Any
    speed: Any


def _paces(scene: HasFriction[Any], p: Numbers) -> _Paces:
    with precision("float64"):
        lanes = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in p.values()))
        found = _compiled_paces(scene, dict(zip(p, lanes, strict=True)))
        shape = np.broadcast_shapes(*(np.shape(x) for x in p.values()))
        return _Paces(*(np.asarray(x).reshape(shape) for x in found))


@lane_function(static=1)
def _compiled_paces(scene: HasFriction[Any], p: Numbers) -> _Paces:
    c = scene.constants(p)
    flight = scene.flight_rate(c)
    contact = scene.contact_rate(c) if isinstance(scene, HasContact) else jnp.zeros_like(flight)
    return _Paces(*jnp.broadcast_arrays(flight, contact, scene.spring_rate(c), scene.typical_speed(c)))


def too_slow(sweep: Sweep, p: Numbers) -> Refused:
    """Which lanes of parameters `p`, each (lanes,), creep so slowly that they pass for being at rest; booleans.

    What counts as at rest are a few roundings of a typical speed, which friction on the main spring gives too.
    """
    scene = sweep.system
    if not isinstance(scene, HasFriction) or not sweep.run.stepper.rests:
        return np.zeros(np.broadcast_shapes(*(np.shape(x) for x in p.values())), bool)
    with np.errstate(all="ignore"):
        return (p["v"] > 0) & (p["v"] < 512 * np.finfo(sweep.run.precision).eps * _paces(scene, p).speed)
