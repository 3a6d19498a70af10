"""Lanes that are stiffer or slower than steps or numbers reach: refused, instead of a regime that means nothing."""

import numpy as np

from vibrojax.physics.modes import striker
from vibrojax.sweep._sweep import Sweep

TOO_STIFF, TOO_SLOW = "too-stiff", "too-slow"
MOST_STEPS = 1e7
"""Of the mode's own time scale, that a run may have: several times those after which a lane is given up."""


def too_stiff(sweep: Sweep, p: dict) -> np.ndarray:
    """Which lanes of parameters `p`, each (lanes,), are faster than can be resolved; booleans (lanes,).

    The springs and the damper bound the fastest rate in flight, sqrt((k1 + k2)/m1 + k2/m2) + c2/m2, and with k0 and c0
    in contact. 1/rate is the time that a step takes: what the bit on its main spring does meanwhile must not vanish in
    the roundings of the run's precision, and the steps of the flight must come to an end.
    """
    if "gamma" not in p or sweep.run.method != "located":
        return np.zeros(sweep.lanes, bool)
    m2, k2 = (np.asarray(x) for x in striker(p))
    with np.errstate(all="ignore"):
        flight = np.sqrt((p["k1"] + k2) / p["m1"] + k2 / m2) + p["c2"] / m2
        contact = np.sqrt(p["k0"] / m2) + p["c0"] / m2 if "k0" in p else 0.0
        slow = np.sqrt(p["k1"] / p["m1"])
        resolved = 512 * np.finfo(sweep.run.precision).eps * (flight + contact) < slow
        steps = flight * (sweep.run.settle + sweep.run.observe)
    return np.isfinite(flight + contact) & ~(resolved & (steps < MOST_STEPS))


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
