"""Pseudo-arclength continuation of many families at once (Keller; Doedel, *Lecture Notes on Numerical Analysis of
Nonlinear Equations*, 2007).

From a point with tangent t the next lies on the plane t u = t g, where Newton's method finds it from the guess g, which
goes on as the cubic through the last two points and their tangents. The step of each lane follows from how far its
tangent turns and how often Newton's method is asked. Where steps fail because the order of events changes ahead, the
margin foretells how far away that is, so that they end before it or right behind. All lanes that are underway are asked
together, each for its own next iterate, so that none waits for another.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from vibrojax.analyses.continuation.indicators import spectral_radius
from vibrojax.analyses.continuation.problem import (
    At,
    Flags,
    Index,
    PerLane,
    Problem,
    Unknowns,
    joined_at,
    solved,
    tangent,
)
from vibrojax.analyses.continuation.vanishing import entered, foretold

CONVERGED = 1e-10
"""Residual of the equations at which a point counts as found; Newton's next step would be that squared."""

CLEAR = 1e-6
"""Steps that are so long that no order of points depends on what is left over of the equations."""

MOST_ITERATIONS = 6

SHORTEST, LONGEST = 1e-9, 0.2
"""Steps, over the scales."""

TURN, SHARP_TURN = 0.2, 0.5
"""Angles [rad] between tangents: aimed at, and beyond which the step is taken again by halves."""

CORNER = 2e-2
"""Step up to which the tangent may turn by more where events begin or vanish on the way: a family has corners there."""

CROSSING = 1e-4
"""The same for sharper corners."""

BLUNT, SHARP = 1.0, 1.4
"""By how much [rad] for each; around sharper corners another way is taken."""

FASTER, FAST = 5.0, 2.0
"""By how much steps grow at most: short ones, up to CORNER, and others."""

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
        self._shortened, self._blocked = np.zeros((2, lanes), bool)
        self._level = np.zeros(lanes)
        # The last points with the same events, the very last first: how far along, and the margins there.
        self._along, self._margins = np.full((2, lanes, 3), np.nan)
        self._along[:, 0], self._margins[:, 0] = 0.0, self._last.margin
        self._prior_u, self._prior_tangent = np.full((2, *begin.u.shape), np.nan)
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
        guess = self._onward(lanes, np.where(short, np.maximum(room, 0), h))
        guess[short, -1] = ahead[short]
        self._guess[lanes] = self._iterate[lanes] = guess
        self._level[lanes] = np.where(short, ahead, np.einsum("ij,ij->i", t, guess))
        self._iterations[lanes] = 0
        self._before[lanes] = np.inf

    def _onward(self, lanes: Index, h: PerLane) -> Unknowns:
        """So far on from the last points, by the cubic where the step before was not much shorter, else straight on."""
        u, t, before = self._last.u[lanes], self._tangent[lanes], self._prior_u[lanes]
        d, h = np.linalg.norm(u - before, axis=1)[:, None], h[:, None]
        apart, turn = (before - u + d * t) / d**2, (self._prior_tangent[lanes] - t) / d
        bend = (3 * apart + turn) * h**2 + (turn + 2 * apart) / d * h**3
        sound = (h <= 1.1 * FAST * d) & (np.linalg.norm(bend, axis=1, keepdims=True) < 0.3 * h)
        return u + h * t + np.where(sound, bend, 0)

    def _rows(self, lanes: Index) -> tuple[Unknowns, PerLane]:
        """The plane on which each lane's next point lies, row u = value."""
        along = np.zeros_like(self._tangent[lanes])
        along[:, -1] = 1.0
        bounded = ~np.isnan(self._bound[lanes])
        return np.where(bounded[:, None], along, self._tangent[lanes]), self._level[lanes]

    def tick(self) -> None:
        """One iterate of every lane."""
        lanes = self.active
        now = self._problem.at(self._family[lanes], self._iterate[lanes])
        residual = now.residual
        row, value = self._rows(lanes)
        short = np.einsum("ij,ij->i", row, now.u) - value
        done = (residual <= CONVERGED) & (np.abs(short) <= CONVERGED)
        on = ~done & (self._iterations[lanes] < MOST_ITERATIONS) & (residual < self._before[lanes])
        change = np.zeros_like(now.u)
        some = np.flatnonzero(done | on)
        change[some] = solved(now.matrix[some], row[some], -np.column_stack([now.off[some], short[some]]))
        accepted = np.zeros(len(lanes), bool)
        some = np.flatnonzero(done)
        if len(some):
            # The map need not be asked again; but guesses must not go on from what was left over by those before.
            # (They stay where points lie as near to each other as that: their margins are of where they are.)
            better, clear = now.of(some), self._step[lanes[some]] > CLEAR
            better.u[clear, :-1] += np.nan_to_num(change[some, :-1])[clear]
            accepted[some] = self._accept(lanes[some], better)
        some = np.flatnonzero(on)
        if len(some):
            iterate = now.u[some] + change[some]
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
        self._blocked[lanes] |= taken <= CROSSING
        self._shortened[lanes] = True
        to_corner = self._to_corner(lanes, taken)
        self._step[lanes] = np.where(np.isnan(to_corner), taken / 3, np.minimum(to_corner, 0.7 * taken))
        self._status[lanes[taken / 3 < SHORTEST]] = STALLED
        self._predict(lanes)

    def _to_corner(self, lanes: Index, within: PerLane) -> PerLane:
        """The steps towards where the margin vanishes `within` so far ahead: over it where it is known well enough and
        was not found to be closed, else up to it but for what is in doubt; NaN where nothing is foretold."""
        at, doubt = foretold(self._along[lanes], self._margins[lanes])
        ahead = at - self._along[lanes, 0]
        sound = (ahead > 0) & (ahead < within) & (doubt < ahead / 4)
        over = ~self._blocked[lanes] & (doubt < CROSSING / 8)
        before = np.where(
            over, np.maximum(ahead - CROSSING / 4, ahead / 2), ahead - np.maximum(2 * doubt, SHORTEST / 2)
        )
        step = np.where(over & (ahead < CROSSING / 2), ahead + CROSSING / 4, before)
        return np.where(sound, np.maximum(step, 1.01 * SHORTEST), np.nan)

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
        sound &= (
            (turn <= SHARP_TURN)
            | (taken < 10 * SHORTEST)
            | changed & ((taken <= CORNER) & (turn <= BLUNT) | (taken <= CROSSING) & (turn <= SHARP))
        )
        value = problem.value(family, now.u)
        beyond = (value > problem.last[family]) | (value < problem.first[family])
        beyond &= np.isnan(self._bound[lanes])
        sound &= ~beyond
        kept = lanes[sound]
        at, ahead = now.of(sound), ahead[sound]
        self._found.append((kept, at, ahead))
        self._count[kept] += 1
        self._length[kept] += taken[sound]
        self._remember(kept, at, changed[sound])
        self._last.put(kept, at)
        self._tangent[kept] = ahead
        grown = np.where(taken[sound] < CORNER, FASTER, FAST)
        easy = np.clip(TURN / np.maximum(turn[sound], 1e-12), 0.5, grown)
        easy = np.where(self._iterations[kept] >= 4, np.minimum(easy, 0.7), easy)
        # What shortened this step lies within twice its length.
        easy = np.where(self._shortened[kept], np.minimum(easy, 1.0), easy)
        step = np.minimum(np.maximum(taken[sound] * easy, 10 * SHORTEST), self._longest)
        to_corner = np.where(self._shortened[kept], self._to_corner(kept, 3 * step), np.nan)
        self._step[kept] = np.where(np.isnan(to_corner), step, to_corner)
        self._shortened[kept] = ~np.isnan(to_corner)
        self._end(kept, at, ahead)
        self._predict(kept)
        return sound

    def _remember(self, lanes: Index, now: At, changed: Flags) -> None:
        """Put points that were found before those that are known, and forget these where other events were met."""
        self._prior_u[lanes] = np.where(changed[:, None], np.nan, self._last.u[lanes])
        self._prior_tangent[lanes] = self._tangent[lanes]
        for known, new in ((self._along, self._length[lanes]), (self._margins, now.margin)):
            known[lanes[changed]] = np.nan
            entered(known, lanes, new)
        self._shortened[lanes[changed]] = self._blocked[lanes[changed]] = False

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
