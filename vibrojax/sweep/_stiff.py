"""Lanes that are stiffer or slower than steps or numbers reach: refused, instead of a regime that means nothing."""

import numpy as np

from vibrojax.physics.modes import striker
from vibrojax.sweep._sweep import Sweep

TOO_STIFF, TOO_SLOW = "too-stiff", "too-slow"
MOST_STEPS = 1e7
"""Of the mode's own time scale, that a run may have: several times those after which a lane is given up."""


def too_stiff(sweep: Sweep, p: dict) -> np.ndarray:
    """Which lanes of parameters `p`, each (lanes,), are faster than can be resolved; booleans (lanes,).

    Those of [vibrojax.sweep._stiff.unresolved][], and those whose steps of the flight do not come to an end.
    """
    if "gamma" not in p or sweep.run.method != "located":
        return np.zeros(sweep.lanes, bool)
    flight, contact = _rates(p)
    with np.errstate(all="ignore"):
        steps = flight * (sweep.run.settle + sweep.run.observe)
    return np.isfinite(flight + contact) & (unresolved(p, sweep.run.precision) | ~(steps < MOST_STEPS))


def unresolved(p: dict, precision: str) -> np.ndarray:
    """Where 1/rate, the time that a step takes, is so short that what the bit on its main spring does meanwhile
    vanishes in the roundings of the `precision`: nothing would move; booleans (lanes,)."""
    flight, contact = _rates(p)
    with np.errstate(all="ignore"):
        slow = np.sqrt(np.asarray(p["k1"]) / np.asarray(p["m1"]))
        return ~(512 * np.finfo(precision).eps * (flight + contact) < slow)


def _rates(p: dict) -> tuple:
    """Bounds on the fastest rates [1/s], by springs and damper in flight, and what k0 and c0 add to it in contact."""
    with np.errstate(all="ignore"):
        m2, k2 = (np.asarray(x) for x in striker(p))
        p = {name: np.asarray(value) for name, value in p.items()}
        flight = np.sqrt((p["k1"] + k2) / p["m1"] + k2 / m2) + p["c2"] / m2
        return flight, np.sqrt(p["k0"] / m2) + p["c0"] / m2 if "k0" in p else 0.0


def too_slow(sweep: Sweep, p: dict) -> np.ndarray:
    """Which lanes of parameters `p`, each (lanes,), creep so slowly that they pass for being at rest; booleans.

    What counts as at rest are a few roundings of a typical speed, which friction on the main spring gives too.
    """
    if "gamma" not in p or sweep.run.method != "located":
        return np.zeros(sweep.lanes, bool)
    with np.errstate(all="ignore"):
        weight = p["m1"] * p["g"]
        limit = np.asarray(sweep.machine.friction.on_weight(0.0, p)) * weight
        typical = p["v"] + limit / np.sqrt(p["k1"] * p["m1"])
        return (p["v"] > 0) & (p["v"] < 512 * np.finfo(sweep.run.precision).eps * typical)
