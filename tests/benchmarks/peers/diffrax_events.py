"""diffrax with its own events: a solve from switch to switch in an outer loop over modes, vmapped."""

import time
from dataclasses import dataclass
from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from peers._machine import ARMED_BELOW, C0, C2, K0, K1, M1, MU, STICK_LIMIT, V_CR, striker
from peers._peer import CORES, Peer, Points, Ran
from vibrojax.compile.xla import precision
from vibrojax.threads import in_parallel

LATER = 1e-7  # s after its start from which on a segment may end, since it begins on a surface
MOST_SEGMENTS = 5_000
HOLDS, LETS_GO = 1e-9, 2e-9
"""Relative excess over the stick limit up to which a stopping bit sticks, and from which a sticking bit slips."""


@dataclass(frozen=True)
class Tolerance:
    """The solver, its tolerance (relative to v), and the longest step in units of the mode's time scale."""

    solver: str
    tolerance: float
    longest: float

    def __str__(self):
        return f"{self.solver}, tolerance {self.tolerance:g}, longest step {self.longest:g}"


class DiffraxEvents(Peer):
    name = "diffrax with its events"
    about = "diffeqsolve with Event and a root finder, in a loop over modes; vmapped, a block of lanes on each core"
    lanes = 64

    def __init__(self):
        self._compiled = set()

    def ladders(self, quick):
        if quick:
            return [[Tolerance("Tsit5", 1e-5, 1.0)]]
        tsit5 = [Tolerance("Tsit5", one, 1.0) for one in (3e-4, 3e-5, 3e-7)]
        return [tsit5, [Tolerance("Dopri8", 1e-6, 0.5)]]

    def run(self, points, setting, settle, observe, judged):
        compiling = 0.0
        blocks = np.array_split(np.arange(len(points)), CORES)
        if (setting.solver, len(points)) not in self._compiled:
            began = time.perf_counter()
            _solved(points[blocks[0]], setting, 0.0, 1e-3)
            compiling = time.perf_counter() - began
            self._compiled.add((setting.solver, len(points)))

        def solve(worker, block):
            return _solved(points[block], setting, settle, observe)

        began = time.perf_counter()
        found = dict(in_parallel(solve, blocks, [None] * CORES))
        seconds = time.perf_counter() - began
        return Ran(*np.concatenate([found[index] for index in range(CORES)], axis=1), seconds, compiling)


def _solved(points: Points, setting: Tolerance, settle: float, observe: float) -> np.ndarray:
    """Return period and impact velocity (2, lanes)."""
    with precision("float64"):
        numbers = (jnp.asarray(x) for x in (setting.tolerance, setting.longest, settle, observe))
        return np.asarray(_run(setting.solver, *map(jnp.asarray, points.columns), *numbers))


@partial(jax.jit, static_argnums=0)
def _run(solver, beta, gamma, v, delta, tolerance, longest, settle, observe):
    def one(beta, gamma, v, delta):
        return _lane(getattr(diffrax, solver)(), beta, gamma, v, delta, tolerance, longest, settle, observe)

    return jnp.stack(jax.vmap(one)(beta, gamma, v, delta))


def _lane(solver, beta, gamma, v, delta, tolerance, longest, settle, observe):
    m2, k2 = striker(beta, gamma)
    flight = jnp.sqrt((K1 + k2) / M1 + k2 / m2)
    end = settle + observe

    def pull(y):
        return k2 * (y[2] - y[0]) - K1 * y[0]

    def press(y, touching):
        return touching * (K0 * (y[2] - delta) + C0 * y[3])

    def rates(t, y, args):
        slip, touching, _, _ = args
        x1, v1, x2, v2 = y
        J = press(y, touching)
        r = (v1 + v) * (1 / V_CR)
        friction = slip * (STICK_LIMIT + MU * J) - STICK_LIMIT * r * (1 - r * r * (1 / 3))
        bit = jnp.where(slip == 0, 0.0, (pull(y) - friction) * (1 / M1))
        return v1, bit, v2, (-C2 * v2 - k2 * (x2 - x1) - J) / m2

    def surfaces(y, args):
        """Return the surfaces, in m/s; they are positive while the mode lasts and the section is not reached."""
        slip, touching, watched, _ = args
        J = press(y, touching)
        held = (STICK_LIMIT + MU * J) * (1 + LETS_GO) - jnp.abs(pull(y))
        friction = jnp.where(slip == 0, held * (1 / jnp.sqrt(K1 * M1)), slip * (y[1] + v))
        contact = jnp.where(touching > 0, J * (flight / K0), (delta - y[2]) * flight)
        return friction, contact, jnp.where(watched, -y[1], jnp.inf)

    def ahead(t, y, args, **_):
        friction, contact, section = surfaces(y, args)
        # Combine the surfaces into one event: of several, diffrax takes the first in the list, not in time.
        lowest = jnp.minimum(jnp.minimum(friction, contact), section)
        return jnp.where(t > args[3] + LATER, lowest, 1.0)

    # Newton's method fails if the lowest surface changes within the step. `flip` says that the function decreases.
    finder = optimistix.Bisection(rtol=1e-14, atol=1e-11, flip=True)
    event = diffrax.Event(ahead, finder, direction=False)

    def segment(carry):
        t, y, slip, touching, armed, returns, number = carry
        stop = jnp.where(t < settle, settle, end)
        watched = (t >= settle) & armed & (y[1] < 0)
        args = (slip, touching, watched, t)
        scale = jnp.where(touching > 0, jnp.sqrt(K0 / m2), flight)
        sizes = (tolerance * v / scale, tolerance * v, tolerance * v / scale, tolerance * v)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            solver,
            t,
            stop,
            jnp.minimum(0.3 * longest / scale, jnp.maximum(stop - t, 1e-12)),
            y,
            args=args,
            event=event,
            stepsize_controller=diffrax.PIDController(0.0, 1.0, dtmax=longest / scale, norm=_norm(sizes)),
            adjoint=diffrax.ForwardMode(),
            max_steps=100_000,
            throw=False,
        )
        t, y = solution.ts[-1], tuple(column[-1] for column in solution.ys)
        happened = solution.result == diffrax.RESULTS.event_occurred
        friction, contact, section = (jnp.where(happened, jnp.abs(g), jnp.inf) for g in surfaces(y, args))
        at_section = happened & (section <= jnp.minimum(friction, contact))
        at_contact = happened & ~at_section & (contact <= friction)
        at_friction = happened & ~at_section & ~at_contact
        strikes = at_contact & (touching == 0)
        x1, v1, x2, v2 = y
        v1 = jnp.where(at_section, 1e-12 * v, jnp.where(at_friction & (slip != 0), -v, v1))
        y = (x1, v1, jnp.where(strikes, delta, x2), v2)
        towards = jnp.sign(pull(y))
        sticks = jnp.abs(pull(y)) <= (STICK_LIMIT + MU * press(y, touching)) * (1 + HOLDS)
        slid = jnp.where((slip != 0) & sticks, 0.0, towards)
        slip = jnp.where(at_friction, slid, slip)
        touching = jnp.where(at_contact, 1 - touching, touching)
        armed = (armed & ~at_section) | (v1 < -ARMED_BELOW * v)
        return t, y, slip, touching, armed, _taken(returns, at_section, strikes, t, v2), number + 1

    zero = jnp.zeros_like(v)
    touching = jnp.where(delta < 0, 1.0, 0.0)
    begin = (zero, (zero, -v, zero, zero), zero, touching, jnp.asarray(True), (zero,) * 7, jnp.asarray(0))
    last = jax.lax.while_loop(lambda carry: (carry[0] < end) & (carry[6] < MOST_SEGMENTS), segment, begin)
    first, final, number, impacts, total, _, _ = last[5]
    done = last[0] >= end
    return jnp.where(done, (final - first) / (number - 1), jnp.nan), jnp.where(done, total / impacts, jnp.nan)


def _norm(sizes):
    """Return a norm: the largest ratio of error to tolerance."""

    def norm(errors):
        return jnp.max(jnp.stack([jnp.abs(e) / size for e, size in zip(errors, sizes, strict=True)]))

    return norm


def _taken(returns, at_section, strikes, t, velocity):
    """Return the sums over whole returns after an event.

    They are first and last return [s], number of returns, impacts and sum of velocities, and the last two since the
    last return.
    """
    first, last, number, impacts, total, pending, pending_total = returns
    counted = at_section & (number > 0)
    struck = strikes & (number > 0)
    return (
        jnp.where(at_section & (number == 0), t, first),
        jnp.where(at_section, t, last),
        number + jnp.where(at_section, 1.0, 0.0),
        impacts + jnp.where(counted, pending, 0.0),
        total + jnp.where(counted, pending_total, 0.0),
        jnp.where(at_section, 0.0, pending + jnp.where(struck, 1.0, 0.0)),
        jnp.where(at_section, 0.0, pending_total + jnp.where(struck, velocity, 0.0)),
    )
