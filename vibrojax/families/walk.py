"""Pseudo-arclength continuation of many families at once (Keller; Doedel, *Lecture Notes on Numerical Analysis of
Nonlinear Equations*, 2007).

From a point u0 with tangent t0 the next lies on the plane t0 (u - u0) = h, where Newton's method finds it from
u0 + h t0. The step h of each lane follows from how far its tangent turns and how often Newton's method is asked. All
lanes that are underway are asked together, each for its own next iterate, so that none waits for another.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from vibrojax.families.indicators import spectral_radius
from vibrojax.families.problem import At, Flags, Index, PerLane, Problem, Unknowns, joined_at, solved, tangent

CONVERGED = 1e-10
"""Residual of the equations at which a point counts as found; Newton's next step would be that squared."""

MOST_ITERATIONS = 6

SHORTEST, LONGEST = 1e-9, 0.2
"""Steps, over the scales."""

TURN, SHARP_TURN = 0.2, 0.5
"""Angles [rad] between tangents: aimed at, and beyond which the step is taken again by halves."""

CORNER = 2e-2
"""Step up to which the tangent may turn by more where events begin or vanish on the way: a family has corners there."""

BLUNT = 1.0
"""By how much [rad]; around sharper corners another way is taken."""

RUNNING, ENDED, STALLED, STOPPED, CLOSED, TOO_LONG, UNSTABLE = range(7)
"""How a lane's way goes on: underway; at a bound of the parameter; no further point found; where the caller asked; back
where its branch began; more points than are allowed; a multiplier over what is followed."""

MOST_POINTS = 2000

MOST_UNSTABLE = 1e3
"""Greatest multiplier that is followed: beyond, special points lie closer together than they are told apart."""


class Begin(NamedTuple):
    """Where lanes begin, all of one number of cycles: their family, a solution, the tangent, and a first step; and the
    solution and the tangent to which they may come back, NaN where they cannot."""

    family: Index
    u: Unknowns
    tangent: Unknowns
    step: PerLane
    home: Unknowns
    away: Unknowns


class Trail(NamedTuple):
    """The points of lanes: `lane` (points,), by lane and in order, `at` and `tangent` there; `status` (lanes,), and
    the last `step` (lanes,)."""

    lane: Int[np.ndarray, " points"]
    at: At
    tangent: Unknowns
    status: Int[np.ndarray, " lanes"]
    step: PerLane


Stop = Callable[[Index, At, Unknowns], Flags]
"""`stop(lanes, at, tangent)`: which lanes end at a point that was found."""


def walk(problem: Problem, begin: Begin, longest: float = LONGEST, stop: Stop | None = None) -> Trail:
    """Follow lanes until the parameter leaves its bounds, or no further.

    **Arguments:** `longest`: step, over the scales; `stop`: see `Stop`.
    """
    walker = _Walker(problem, begin, longest, stop)
    with np.errstate(all="ignore"):
        while len(walker.active):
            walker.tick()
    return walker.trail()


class _Walker:
    """Lanes underway: their last points, and the iterates towards the next."""

    def __init__(self, problem: Problem, begin: Begin, longest: float, stop: Stop | None) -> None:
        lanes = len(begin.family)
        self._problem, self._longest, self._stop = problem, longest, stop
        self._family = begin.family
        self._last = problem.at(begin.family, begin.u)
        self._tangent = begin.tangent.copy()
        self._step = np.minimum(begin.step, longest)
        self._status = np.full(lanes, RUNNING)
        self._count = np.ones(lanes, int)
        self._length = np.zeros(lanes)
        self._home, self._away = begin.home, begin.away
        self._iterate = begin.u.copy()
        self._guess = begin.u.copy()
        self._bound = np.full(lanes, np.nan)
        self._iterations = np.zeros(lanes, int)
        self._before = np.full(lanes, np.inf)
        self._shortened = np.zeros(lanes, bool)
        self._found = [(np.arange(lanes), self._last.of(np.arange(lanes)), begin.tangent.copy())]
        self.active = np.arange(lanes)
        with np.errstate(all="ignore"):
            self._predict(self.active)

    def _predict(self, lanes: Index) -> None:
        """The first iterates, on the plane ahead; on the bound where that is nearer."""
        problem, family = self._problem, self._family[lanes]
        u, t, h = self._last.u[lanes], self._tangent[lanes], self._step[lanes]
        ahead = np.where(t[:, -1] > 0, problem.last[family], problem.first[family]) / problem.unit[family]
        room = (ahead - u[:, -1]) / t[:, -1]
        short = (t[:, -1] != 0) & (room < 1.0001 * h)
        self._bound[lanes] = np.where(short, ahead, np.nan)
        self._guess[lanes] = self._iterate[lanes] = u + np.where(short, np.maximum(room, 0), h)[:, None] * t
        self._iterations[lanes] = 0
        self._before[lanes] = np.inf

    def _rows(self, lanes: Index) -> tuple[Unknowns, PerLane]:
        """The plane on which each lane's next point lies, row u = value."""
        bounded = ~np.isnan(self._bound[lanes])
        along = np.zeros_like(self._tangent[lanes])
        along[:, -1] = 1.0
        t = self._tangent[lanes]
        value = np.einsum("ij,ij->i", t, self._last.u[lanes]) + self._step[lanes]
        return np.where(bounded[:, None], along, t), np.where(bounded, self._bound[lanes], value)

    def tick(self) -> None:
        """One iterate of every lane."""
        lanes = self.active
        now = self._problem.at(self._family[lanes], self._iterate[lanes])
        residual = now.residual
        row, value = self._rows(lanes)
        done = residual <= CONVERGED
        done &= np.abs(np.einsum("ij,ij->i", row, now.u) - value) <= CONVERGED
        accepted = np.zeros(len(lanes), bool)
        some = np.flatnonzero(done)
        if len(some):
            accepted[some] = self._accept(lanes[some], now.of(some))
        short = np.einsum("ij,ij->i", row, now.u) - value
        on = ~done & (self._iterations[lanes] < MOST_ITERATIONS) & (residual < self._before[lanes])
        some = np.flatnonzero(on)
        if len(some):
            change = solved(now.matrix[some], row[some], -np.column_stack([now.off[some], short[some]]))
            iterate = now.u[some] + change
            # Further from the guess than the step is long it is another branch, if any.
            limit = np.maximum(0.5 * self._step[lanes[some]], 1e-6)
            sound = np.abs(iterate - self._guess[lanes[some]]).max(axis=1) <= limit
            on[some[~sound]] = False
            self._iterate[lanes[some]] = iterate
        self._before[lanes[on]] = residual[on]
        self._iterations[lanes[on]] += 1
        self._shorten(lanes[~on & ~accepted])
        self.active = self.active[self._status[self.active] == RUNNING]

    def _shorten(self, lanes: Index) -> None:
        """Take the step again, a shorter one."""
        taken = np.linalg.norm(self._guess[lanes] - self._last.u[lanes], axis=1)
        self._step[lanes] = taken / 3
        self._shortened[lanes] = True
        self._status[lanes[taken / 3 < SHORTEST]] = STALLED
        self._predict(lanes)

    def _accept(self, lanes: Index, now: At) -> Flags:
        """Go on from what was found, where it is a next point of the same curve."""
        problem, family = self._problem, self._family[lanes]
        last = self._last.of(lanes)
        ahead = tangent(now.matrix, self._tangent[lanes])
        cosine = np.einsum("ij,ij->i", ahead, self._tangent[lanes])
        turn = np.arccos(np.clip(cosine, -1, 1))
        taken = np.linalg.norm(now.u - last.u, axis=1)
        changed = (now.signature != last.signature).any(axis=1)
        sound = np.isfinite(ahead).all(axis=1)
        sound &= (turn <= SHARP_TURN) | (taken < 10 * SHORTEST) | (changed & (taken <= CORNER) & (turn <= BLUNT))
        value = problem.value(family, now.u)
        beyond = (value > problem.last[family]) | (value < problem.first[family])
        beyond &= np.isnan(self._bound[lanes])
        sound &= ~beyond
        kept = lanes[sound]
        at, ahead = now.of(sound), ahead[sound]
        self._last.put(kept, at)
        self._tangent[kept] = ahead
        self._found.append((kept, at, ahead))
        self._count[kept] += 1
        self._length[kept] += taken[sound]
        easy = np.clip(TURN / np.maximum(turn[sound], 1e-12), 0.5, 2.0)
        easy = np.where(self._iterations[kept] >= 4, np.minimum(easy, 0.7), easy)
        # What shortened this step lies within twice its length.
        easy = np.where(self._shortened[kept], np.minimum(easy, 1.0), easy)
        self._shortened[kept] = False
        self._step[kept] = np.minimum(np.maximum(taken[sound] * easy, 10 * SHORTEST), self._longest)
        self._end(kept, at, ahead)
        self._predict(kept)
        return sound

    def _end(self, lanes: Index, at: At, ahead: Unknowns) -> None:
        """Which lanes go no further."""
        home = np.linalg.norm(at.u - self._home[lanes], axis=1) < self._longest
        home &= np.einsum("ij,ij->i", ahead, self._away[lanes]) > 0.9
        home &= self._length[lanes] > 5 * self._longest
        self._status[lanes[home]] = CLOSED
        self._status[lanes[self._count[lanes] >= MOST_POINTS]] = TOO_LONG
        self._status[lanes[spectral_radius(at.product) > MOST_UNSTABLE]] = UNSTABLE
        if self._stop is not None:
            self._status[lanes[self._stop(lanes, at, ahead)]] = STOPPED
        self._status[lanes[~np.isnan(self._bound[lanes])]] = ENDED

    def trail(self) -> Trail:
        """All points that were found."""
        lane = np.concatenate([lanes for lanes, _, _ in self._found])
        order = np.argsort(lane, kind="stable")
        at = joined_at([at for _, at, _ in self._found]).of(order)
        ahead = np.concatenate([one for *_, one in self._found])[order]
        return Trail(lane[order], at, ahead, self._status, self._step)
