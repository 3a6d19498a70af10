"""SciPy: solve_ivp from event to event, with lanes spread over processes."""

import importlib.util
import math
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from peers._machine import ARMED_BELOW, C0, C2, K0, K1, M1, MU, STICK_LIMIT, V_CR, striker
from peers._peer import CORES, Peer, Ran, Returns

SIZES = np.array([1e-2, 1.0, 1e-2, 1.0])  # m, m/s: scales of the absolute tolerances

SMALL = 1e-300
LATER = 1e-7  # s after its start from which on a slip may end
HOLDS, LETS_GO = 1e-9, 2e-9
"""Relative excess over the stick limit up to which a stopping bit sticks, and from which a sticking bit slips.

The gap prevents alternation without progress in time."""

MOST_SEGMENTS = 5_000


@dataclass(frozen=True)
class Solver:
    """A method of solve_ivp, its tolerance, and its longest step in units of the mode's time scale.

    Without a longest step, pairs of events within a step are missed.
    """

    method: str
    tolerance: float
    longest: float

    def __str__(self):
        return f"{self.method}, tolerance {self.tolerance:g}, longest step {self.longest:g}"


class Scipy(Peer):
    name = "SciPy, solve_ivp with events"
    about = f"{CORES} processes"
    lanes = 32

    def __init__(self):
        self._pool = None

    def missing(self):
        return None if importlib.util.find_spec("scipy") else "SciPy is not installed"

    def ladders(self, quick):
        if quick:
            return [[Solver("DOP853", 1e-4, 0.7)]]
        rows = {
            "DOP853": ((1e-4, 0.7), (1e-4, 0.5)),
            "LSODA": ((3e-6, 0.7), (1e-8, 0.5)),
            "RK45": ((1e-4, 0.7), (1e-5, 0.5), (3e-7, 0.5)),
        }
        return [[Solver(method, *one) for one in of_method] for method, of_method in rows.items()]

    def run(self, points, setting, settle, observe, judged):
        if self._pool is None:
            # Forked processes would share locks with the threads of this one.
            self._pool = ProcessPoolExecutor(CORES, multiprocessing.get_context("spawn"))
            list(self._pool.map(_ready, range(CORES)))
        lanes = [(*lane, setting, settle, observe) for lane in zip(*points.columns, strict=True)]
        began = time.perf_counter()
        found = list(self._pool.map(lane, lanes))
        seconds = time.perf_counter() - began
        return Ran(*np.array(found).T, seconds)

    def close(self):
        if self._pool:
            self._pool.shutdown()


def _ready(_) -> None:
    import scipy.integrate  # noqa: F401


def lane(given) -> tuple[float, float]:
    """Return period [s] and impact velocity [m/s] of one lane."""
    beta, gamma, v, delta, setting, settle, observe = (x if isinstance(x, Solver) else float(x) for x in given)
    m2, k2 = striker(beta, gamma)
    t, y, end = 0.0, [0.0, -v, 0.0, 0.0], settle + observe
    slip, touching, armed, returns = 0, y[2] > delta, False, Returns()
    for _ in range(MOST_SEGMENTS):
        if t >= end:
            return returns.read()
        stop = settle if t < settle else end
        found = _segment(setting, t, stop, y, slip, touching, (m2, k2, v, delta))
        t, y = found.t[-1], found.y[:, -1].tolist()
        if t > settle:
            overtakes = found.t_events[0]
            for at in overtakes:
                armed = armed or found.y[1, found.t <= at].min() < -ARMED_BELOW * v
                if armed:
                    returns.section(at)
                    armed = False
            since = found.t >= overtakes[-1] if len(overtakes) else slice(None)
            armed = armed or found.y[1, since].min() < -ARMED_BELOW * v
        if found.status == 0:
            continue
        if len(found.t_events[1]):
            touching = not touching
            if touching:
                y[2] = delta
                returns.impact(y[3])
        else:
            pull = k2 * (y[2] - y[0]) - K1 * y[0]
            towards = 1 if pull > 0 else -1
            if slip:
                y[1] = -v
                limit = STICK_LIMIT + (MU * (K0 * (y[2] - delta) + C0 * y[3]) if touching else 0.0)
                slip = 0 if abs(pull) <= limit * (1 + HOLDS) else towards
            else:
                slip = towards
    return np.nan, np.nan


def _segment(setting, begin, end, y, slip, touching, p):
    """Return the motion in one mode from `begin` to `end` [s], or to the first switch.

    The events are section, contact and friction.
    """
    from scipy.integrate import solve_ivp

    m2, k2, v, delta = p
    on = 1.0 if touching else 0.0

    def rates(t, y):
        x1, v1, x2, v2 = y.tolist()
        press = on * (K0 * (x2 - delta) + C0 * v2)
        a2 = (-C2 * v2 - k2 * (x2 - x1) - press) / m2
        if not slip:
            return v1, 0.0, v2, a2
        r = (v1 + v) / V_CR
        friction = slip * (STICK_LIMIT + MU * press) - STICK_LIMIT * (r - r * r * r / 3)
        return v1, (-K1 * x1 - k2 * (x1 - x2) - friction) / M1, v2, a2

    def overtakes(t, y):
        return y[1]

    def contact(t, y):
        return -K0 * (y[2] - delta) - C0 * y[3] if touching else y[2] - delta

    def friction(t, y):
        if slip:
            # The segment begins on the surface, and may be shorter than the first step.
            return -slip * (y[1] + v) if t > begin + LATER else -SMALL
        held = STICK_LIMIT + MU * on * (K0 * (y[2] - delta) + C0 * y[3])
        return abs(k2 * (y[2] - y[0]) - K1 * y[0]) - held * (1 + LETS_GO)

    events = (overtakes, contact, friction)
    for event in events:
        event.direction = 1
        event.terminal = event is not overtakes
    longest = setting.longest / math.sqrt((K1 + k2) / M1 + (k2 + on * K0) / m2)
    tolerances = {"rtol": setting.tolerance, "atol": setting.tolerance * SIZES}
    return solve_ivp(rates, (begin, end), y, setting.method, events=events, max_step=longest, **tolerances)
