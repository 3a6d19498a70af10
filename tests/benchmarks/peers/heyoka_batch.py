"""heyoka: Taylor series with event detection, many lanes in one vector, with the loop over the steps in Python."""

import importlib.util
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from peers._machine import ARMED_BELOW, C0, C2, K0, K1, M1, MU, STICK_LIMIT, V_CR, striker
from peers._peer import CORES, Peer, Points, Ran

HOLDS, LETS_GO = 1e-9, 2e-9
"""Relative excess over the stick limit up to which a stopping bit sticks, and from which a sticking bit slips."""

MOST_STEPS = 100_000

SLIP, TOUCHING, V, GAP, M2, K2 = range(6)
"""Numbers of the parameters: direction of the slip (0: stick), 1 in contact, and those of the lane."""

EVENTS = 3
CONTACT, FRICTION, SECTION = range(EVENTS)
"""Numbers of the events."""


@dataclass(frozen=True)
class Batch:
    """Tolerance, from which heyoka chooses the order, and number of lanes in a vector."""

    tolerance: float
    width: int

    def __str__(self):
        return f"tolerance {self.tolerance:g}, batch {self.width}"


class Heyoka(Peer):
    name = "heyoka, batches with events"
    about = f"{CORES} processes; lanes that have ended make room for others; loop over the steps in Python"
    lanes = 1024

    def __init__(self):
        self._pool = None
        self._known = set()

    def missing(self):
        return None if importlib.util.find_spec("heyoka") else "heyoka is not installed"

    def ladders(self, quick):
        if quick:
            return [[Batch(1e-6, 64)]]
        return [[Batch(tolerance, width) for tolerance in (1e-3, 1e-5, 1e-7, 1e-9)] for width in (16, 64)]

    def run(self, points, setting, settle, observe, judged):
        if self._pool is None:
            # Forked processes would share locks with the threads of this one.
            self._pool = ProcessPoolExecutor(CORES, multiprocessing.get_context("spawn"))
        parts = [points[np.arange(core, len(points), CORES)] for core in range(CORES)]
        few = [points[np.arange(2)]] * CORES

        def all_of(some, *durations):
            began = time.perf_counter()
            found = list(self._pool.map(lanes, some, *zip(*[(setting, *durations)] * CORES, strict=True)))
            return found, time.perf_counter() - began

        compiling = 0.0
        if setting not in self._known:
            compiling = all_of(few, 0.01, 0.01)[1]
            self._known.add(setting)
        found, seconds = all_of(parts, settle, observe)
        features = np.empty((len(points), 2))
        for core, part in enumerate(found):
            features[core::CORES] = part
        return Ran(*features.T, seconds, compiling)

    def close(self):
        if self._pool:
            self._pool.shutdown()


_integrators = {}


def _integrator(setting: Batch):
    """Return heyoka's integrator of one setting, which this process compiles once."""
    if setting in _integrators:
        return _integrators[setting]
    import heyoka as hy

    x1, v1, x2, v2 = hy.make_vars("x1", "v1", "x2", "v2")
    slip, on, v, gap, m2, k2 = (hy.par[number] for number in range(6))
    moving = slip * slip
    press = on * (K0 * (x2 - gap) + C0 * v2)
    pull = k2 * (x2 - x1) - K1 * x1
    r = (v1 + v) / V_CR
    friction = slip * (STICK_LIMIT + MU * press) - STICK_LIMIT * (r - r * r * r / 3)
    held = (1 + LETS_GO) * (STICK_LIMIT + MU * press)
    contact = (1 - on) * (x2 - gap) - on * (K0 * (x2 - gap) + C0 * v2) / K0
    leaves = (1 - moving) * (pull * pull - held * held) / STICK_LIMIT**2 - slip * (v1 + v)
    rising = hy.event_direction.positive
    _integrators[setting] = hy.taylor_adaptive_batch(
        [(x1, v1), (v1, moving * (pull - friction) / M1), (x2, v2), (v2, (-C2 * v2 - k2 * (x2 - x1) - press) / m2)],
        np.zeros((4, setting.width)),
        pars=np.ones((6, setting.width)),
        tol=setting.tolerance,
        t_events=[hy.t_event_batch(event, direction=rising) for event in (contact, leaves, v1)],
    )
    return _integrators[setting]


def lanes(points: Points, setting: Batch, settle: float, observe: float) -> np.ndarray:
    """Return period [s] and impact velocity [m/s] (lanes, 2), of NaN for a lane that does not end."""
    solver = _integrator(setting)
    width, end = setting.width, settle + observe
    found, waiting = np.full((len(points), 2), np.nan), iter(range(len(points)))
    lane, clock, steps, armed = np.full(width, -1), np.full(width, end), np.zeros(width, int), np.zeros(width, bool)
    seen = np.zeros((7, width))  # as the attributes of `Returns`, of all lanes at once
    first, last, number, impacts, total, pending, pending_total = seen
    state, par = solver.state, solver.pars

    def load(place: int) -> None:
        lane[place] = next(waiting, -1)
        if lane[place] < 0:
            clock[place] = end  # steps of no length, from a state without events
            state[:, place], par[:, place] = 0.0, (0.0, 0.0, 1.0, 1.0, 1.0, 1.0)
        else:
            beta, gamma, v, gap = (column[lane[place]] for column in points.columns)
            state[:, place] = 0.0, -v, 0.0, 0.0
            par[:, place] = 0.0, float(gap < 0), v, gap, *striker(beta, gamma)
            clock[place] = 0.0
        armed[place], steps[place], seen[:, place] = False, 0, 0.0
        solver.reset_cooldowns(place)

    for place in range(width):
        load(place)
    while (lane >= 0).any():
        stop = np.where(clock < settle, settle, end)
        left = stop - clock
        solver.step(left)
        outcomes, lengths = zip(*solver.step_res, strict=True)
        clock = np.where(np.array(lengths) >= left, stop, clock + lengths)
        steps += 1
        observing = (clock > settle) & (lane >= 0)
        armed |= observing & (state[1] < -ARMED_BELOW * par[V])
        event = -1 - np.array([*map(int, outcomes)])  # other outcomes are beyond the numbers of events

        new = (event == SECTION) & armed
        again = new & (number > 0)
        first[new & ~again] = clock[new & ~again]
        impacts[again] += pending[again]
        total[again] += pending_total[again]
        last[new] = clock[new]
        number[new] += 1
        pending[new] = pending_total[new] = 0.0
        armed[new] = False

        switched = (event == CONTACT) & (lane >= 0)
        par[TOUCHING, switched] = 1 - par[TOUCHING, switched]
        struck = switched & (par[TOUCHING] > 0)
        state[2, struck] = par[GAP, struck]
        counted = struck & (number > 0)
        pending[counted] += 1
        pending_total[counted] += state[3, counted]

        switched = (event == FRICTION) & (lane >= 0)
        if switched.any():
            state[:, switched], par[:, switched] = _switched(state[:, switched], par[:, switched])
        done = (lane >= 0) & ((clock >= end) | (steps > MOST_STEPS) | ~np.isfinite(state).all(axis=0))
        for place in np.flatnonzero(done):
            if clock[place] >= end and number[place] > 1:
                period = (last[place] - first[place]) / (number[place] - 1)
                found[lane[place]] = period, total[place] / impacts[place] if impacts[place] else np.nan
            load(place)
    return found


def _switched(state: np.ndarray, par: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return state and parameters of lanes whose sticking bit has broken free, or whose slipping bit has stopped."""
    state, par = state.copy(), par.copy()
    x1, _, x2, v2 = state
    pull = par[K2] * (x2 - x1) - K1 * x1
    slipped = par[SLIP] != 0
    state[1] = np.where(slipped, -par[V], state[1])
    limit = STICK_LIMIT + MU * par[TOUCHING] * (K0 * (x2 - par[GAP]) + C0 * v2)
    par[SLIP] = np.where(slipped & (np.abs(pull) <= limit * (1 + HOLDS)), 0.0, np.where(pull > 0, 1.0, -1.0))
    return state, par
