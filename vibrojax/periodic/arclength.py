"""Pseudo-arclength continuation of many branches at once.

Each lane is one branch. From a point with tangent t, the next point is sought on the plane t u = t g (Keller; Doedel,
*Lecture Notes on Numerical Analysis of Nonlinear Equations*, 2007). The predictor g is a cubic extrapolation of the
last two points and their tangents, and Newton's method corrects it. The step length follows from the angle between
successive tangents and from the number of corrector iterations.

Steps may fail because the order of events changes ahead. The zero of the grazing margin is then predicted, so that
steps end just before this zero or just behind it. The current iterates of all active lanes are evaluated in one batch,
so that no lane waits for another.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.periodic.brackets import EVENT_CHANGE, Brackets, predict_zero, push_history
from vibrojax.periodic.hopf import LEAST_SWING, SMALLEST_SWING, surrounds_equilibrium
from vibrojax.periodic.newton import spectral_radius
from vibrojax.periodic.problem import (
    CORRECTOR_RESIDUAL,
    OTHER_ORBIT,
    Flags,
    Index,
    PerLane,
    Points,
    Problem,
    Unknowns,
    solve_bordered,
    towards,
)

POLISHED_STEP = 1e-6
"""Step length above which accepted points are improved by one more Newton step. After shorter steps, the Newton step
could change the order of the points."""

TANGENT_WITHIN = 1e-3
"""Size of the next Newton step, relative to the step along the branch, above which the corrector goes on."""

WALK_MAX_ITERATIONS = 6
"""Largest number of corrector iterations; then the step is shortened."""

SHORTEST_STEP, LONGEST_STEP = 1e-9, 0.2
"""Bounds of the scaled step length."""

TURN, SHARP_TURN = 0.2, 0.5
"""Angles [rad] between successive tangents: the target angle, and the largest accepted angle."""

ASIDE = 0.25
"""Angle [rad] between a step and the tangents at both of its ends from which on these are on different parts of a
branch, unless the tangents differ by half as much: the chord of an arc forms half the angle of its tangents."""

CORNER, CROSSING = 2e-2, 1e-4
"""Step lengths up to which larger angles are accepted where events begin or vanish: branches have corners there."""

CORNER_TURN, CROSSING_TURN = 1.0, 1.4
"""Largest angles [rad] accepted for steps up to `CORNER` and up to `CROSSING`. Sharper corners are handled in
[vibrojax.periodic.location][]."""

CORNER_GROWTH, STEP_GROWTH = 5.0, 2.0
"""Largest growth factors of the step length: for steps up to `CORNER`, and for longer steps."""

FACING, FACED = 0.01, 10.0
"""Distance at which the margin behind a change of events is compared, and distance within which it must not vanish
ahead, relative to the step across the change. Parts of a branch that meet at a small angle are closer to each other
than to the corner."""

AT_CORNER = 1e-10
"""Margin up to which a point is the corner itself, from which the other part of the branch is found."""

LOOP = 1.9
"""Length of a closed loop, at least, relative to the distance of its far side."""

RUNNING, ENDED, STALLED, STOPPED, CLOSED, TOO_LONG, TOO_UNSTABLE, VANISHED = range(8)
"""Status of a lane: running; at a bound of the parameter; no further point found; stopped by the caller; back at the
branch's first point; too many points; a multiplier beyond the limit; no amplitude left."""

BRANCH_MAX_POINTS = 2000

NEAR_GRAZE = 1e-3
"""Grazing margin below which branches are continued whatever their multipliers."""


class Branches(NamedTuple):
    """Points of all lanes, sorted by lane and along each branch, and the final `status` (lanes,) of each lane."""

    lane: Int[np.ndarray, " points"]
    points: Points
    status: Int[np.ndarray, " lanes"]

    @property
    def bounds(self) -> Int[np.ndarray, " bounds"]:
        """Index of each lane's first point, and after the last lane the number of all points."""
        return np.searchsorted(self.lane, np.arange(len(self.status) + 1))

    def brackets(self, place: Index) -> Brackets:
        """Return the parts of branches between the points with indices `place` and the points that follow them."""
        place = place[self.lane[place] == self.lane[place + 1]]
        kind, ends = np.full(len(place), EVENT_CHANGE), np.zeros(len(place), bool)
        return Brackets(kind, place, self.points.of(place), self.points.of(place + 1), ends)


Stop = Callable[[Index, Points], Flags]
"""`stop(lanes, points)`: mask of the lanes that end at their newly accepted point."""


def continue_branches(
    problem: Problem,
    begin: Points,
    step: PerLane,
    stop: Stop,
    home: Float[np.ndarray, "lanes 2 unknowns"] | None = None,
    longest: float = LONGEST_STEP,
) -> Branches:
    """Continue branches until the parameter reaches a bound or another condition for their end holds.

    **Arguments:**

    - `begin`: first points, with tangents. `stop`: additional condition, see `Stop`.
    - `step`, `longest`: first and largest scaled step length.
    - `home`: unknowns and tangents of the points at which closed branches end, NaN if the branch cannot close.
    """
    branches = _ActiveBranches(problem, begin, step, stop, home, longest)
    with np.errstate(all="ignore"):
        branches.predict(branches.active)
        while len(branches.active):
            branches.iterate()
    points = Points.join(branches.accepted)
    lane = np.concatenate(branches.accepted_lanes)
    order = np.argsort(lane, kind="stable")
    return Branches(lane[order], points.of(order), branches.status)


class _ActiveBranches:
    """Branches during continuation: the last point of each, and the corrector's iterate for the next point."""

    def __init__(
        self,
        problem: Problem,
        begin: Points,
        step: PerLane,
        stop: Stop,
        home: Float[np.ndarray, "lanes 2 unknowns"] | None,
        longest: float,
    ) -> None:
        lanes = len(begin.u)
        self._problem, self._longest, self._stop, self._home = problem, longest, stop, home
        self._last = begin.of(np.arange(lanes))
        self._step = np.minimum(step, longest)
        self.status = np.full(lanes, RUNNING)
        self._count = np.ones(lanes, int)
        self._length, self._changed_at, self._farthest = np.zeros((3, lanes))
        self._iterate, self._predictor = begin.u.copy(), begin.u.copy()
        self._bound, self._level = np.full(lanes, np.nan), np.zeros(lanes)
        self._iterations = np.zeros(lanes, int)
        self._before = np.full(lanes, np.inf)
        self._shortened, self._blocked = np.zeros((2, lanes), bool)
        # Arclengths and margins at the points since the last change of events, newest first.
        self._arclengths, self._margins = np.full((2, lanes, 3), np.nan)
        self._arclengths[:, 0], self._margins[:, 0] = 0.0, self._last.margin
        self._prior_u, self._prior_tangent = np.full((2, *begin.u.shape), np.nan)
        self._around_equilibrium: dict[int, bool] = {}
        self.accepted, self.accepted_lanes = [begin], [np.arange(lanes)]
        # A branch that begins at a bound and leads out of the range has no other point.
        _, room = self._to_bound(np.arange(lanes))
        self.status[room <= 0] = ENDED
        self.active = np.flatnonzero(room > 0)

    def predict(self, lanes: Index) -> None:
        """Compute the predictors, on the plane ahead or on the parameter's bound if the bound is nearer."""
        t, h = self._last.tangent[lanes], self._step[lanes]
        ahead, room = self._to_bound(lanes)
        short = room < 1.0001 * h
        self._bound[lanes] = np.where(short, ahead, np.nan)
        predictor = self._extrapolate(lanes, np.where(short, np.maximum(room, 0), h))
        predictor[short, -1] = ahead[short]
        self._predictor[lanes] = self._iterate[lanes] = predictor
        self._level[lanes] = np.where(short, ahead, np.einsum("ij,ij->i", t, predictor))
        self._iterations[lanes] = 0
        self._before[lanes] = np.inf

    def _to_bound(self, lanes: Index) -> tuple[PerLane, PerLane]:
        """Return the scaled bound of the parameter ahead, and the distance to it along the tangent."""
        problem, family, t = self._problem, self._last.family[lanes], self._last.tangent[lanes, -1]
        ahead = np.where(t > 0, problem.last[family, -1], problem.first[family, -1]) / problem.unit[family, -1]
        with np.errstate(all="ignore"):
            return ahead, np.where(t != 0, (ahead - self._last.u[lanes, -1]) / t, np.inf)

    def _extrapolate(self, lanes: Index, h: PerLane) -> Unknowns:
        """Extrapolate by a cubic polynomial, or along the tangent if the cubic polynomial is unreliable.

        It is unreliable if the previous step was much shorter, or if the polynomial deviates strongly from the tangent.
        """
        u, t, before = self._last.u[lanes], self._last.tangent[lanes], self._prior_u[lanes]
        d, h = np.linalg.norm(u - before, axis=1)[:, None], h[:, None]
        apart, turn = (before - u + d * t) / d**2, (self._prior_tangent[lanes] - t) / d
        bend = (3 * apart + turn) * h**2 + (turn + 2 * apart) / d * h**3
        sound = (h <= 1.1 * STEP_GROWTH * d) & (np.linalg.norm(bend, axis=1, keepdims=True) < 0.3 * h)
        return u + h * t + np.where(sound, bend, 0)

    def iterate(self) -> None:
        """Perform one corrector iteration of every active lane."""
        lanes = self.active
        now = self._problem.evaluate(self._last.family[lanes], self._iterate[lanes])
        residual, tangent = now.residual, self._last.tangent[lanes]
        # The next point is on the plane row u = level, which is normal to the tangent or at the parameter's bound.
        row = np.where(np.isnan(self._bound[lanes])[:, None], tangent, towards(tangent, 1.0))
        short = np.einsum("ij,ij->i", row, now.u) - self._level[lanes]
        done = (residual <= CORRECTOR_RESIDUAL) & (np.abs(short) <= CORRECTOR_RESIDUAL)
        on = ~done & (self._iterations[lanes] < WALK_MAX_ITERATIONS) & (residual < self._before[lanes])
        change = np.zeros_like(now.u)
        subset = np.flatnonzero(done | on)
        right = -np.column_stack([now.off[subset], short[subset]])
        change[subset] = solve_bordered(now.matrix[subset], row[subset], right)
        # Near a branch point, tangents may be wrong although residuals are small.
        far = np.abs(change).max(axis=1) > TANGENT_WITHIN * self._step[lanes]
        again = done & far & (self._iterations[lanes] < WALK_MAX_ITERATIONS) & (residual < self._before[lanes] / 2)
        done, on = done & ~again, on | again
        accepted = np.zeros(len(lanes), bool)
        subset = np.flatnonzero(done)
        if len(subset):
            # A last Newton step keeps predictors free of residuals, without another evaluation. It is omitted after
            # very short steps, because the margin belongs to the evaluated point. Near Hopf points of problems without
            # a section, the parameter needs it, too.
            polished = (self._step[lanes[subset]] > POLISHED_STEP) & ~self._problem.touching(now.of(subset))
            better = self._problem.off_stops(now.of(subset), row[subset], self._level[lanes[subset]])
            whole = slice(None, -1 if self._problem.at_section else None)
            better.u[polished, whole] += np.nan_to_num(change[subset, whole])[polished]
            accepted[subset] = self._accept(lanes[subset], better)
        subset = np.flatnonzero(on)
        if len(subset):
            iterate = now.u[subset] + change[subset]
            # An iterate far from the predictor belongs to another branch or to none.
            limit = np.maximum(0.5 * self._step[lanes[subset]], 1e-6)
            sound = np.abs(iterate - self._predictor[lanes[subset]]).max(axis=1) <= limit
            on[subset[~sound]] = False
            self._iterate[lanes[subset]] = iterate
        self._before[lanes[on]] = residual[on]
        self._iterations[lanes[on]] += 1
        self._shorten(lanes[~on & ~accepted])
        self.active = self.active[self.status[self.active] == RUNNING]

    def _shorten(self, lanes: Index) -> None:
        """Retry the step with a shorter length; lanes below the shortest length have stalled."""
        taken = np.linalg.norm(self._predictor[lanes] - self._last.u[lanes], axis=1)
        self._blocked[lanes] |= taken <= CROSSING
        self._shortened[lanes] = True
        to_corner = self._step_to_corner(lanes, taken)
        self._step[lanes] = np.where(np.isnan(to_corner), taken / 3, np.minimum(to_corner, 0.7 * taken))
        self.status[lanes[taken / 3 < SHORTEST_STEP]] = STALLED
        self.predict(lanes)

    def _step_to_corner(self, lanes: Index, within: PerLane) -> PerLane:
        """Return step lengths to the predicted zero of the margin; NaN without a zero within the distance `within`.

        The step ends behind the zero if the zero is known precisely and no step across it has failed, else before it.
        """
        zero, uncertainty = predict_zero(self._arclengths[lanes], self._margins[lanes])
        ahead = zero - self._arclengths[lanes, 0]
        sound = (ahead > 0) & (ahead < within) & (uncertainty < ahead / 4)
        over = ~self._blocked[lanes] & (uncertainty < CROSSING / 8)
        cautious = ahead - np.maximum(2 * uncertainty, SHORTEST_STEP / 2)
        before = np.where(over, np.maximum(ahead - CROSSING / 4, ahead / 2), cautious)
        step = np.where(over & (ahead < CROSSING / 2), ahead + CROSSING / 4, before)
        return np.where(sound, np.maximum(step, 1.01 * SHORTEST_STEP), np.nan)

    def _faces_corner(self, now: Points, taken: PerLane) -> Flags:
        """Return a mask of points, behind a change of events, from which the branch would lead back to the change.

        Two parts of a branch may lie on the same side of a graze. The margin then vanishes ahead, and behind its zero
        the events change again.
        """
        if not len(taken):
            return np.zeros(0, bool)
        ahead = self._problem.evaluate(now.family, now.u + FACING * taken[:, None] * now.tangent)
        leads_back = (ahead.margin < (1 - FACING / FACED) * now.margin) | (ahead.signature != now.signature).any(axis=1)
        return leads_back & (now.margin > AT_CORNER)

    def _skips_part(self, lanes: Index, last: Points, now: Points, taken: PerLane) -> Flags:
        """Return a mask of points behind a change of events that another part of the branch separates from the change.

        A branch that turns back at a graze, and again at a fold, has three orbits in planes between both. Just before
        the predicted graze, there is then another orbit with the events behind it.
        """
        if not len(lanes):
            return np.zeros(0, bool)
        row, far = last.tangent, np.einsum("ij,ij->i", last.tangent, now.u - last.u)
        zero, uncertainty = predict_zero(self._arclengths[lanes], self._margins[lanes])
        place = zero - self._arclengths[lanes, 0] - 2 * np.nan_to_num(uncertainty)
        place = np.where((place > 0) & (place < far), place, 0.0)
        back = (place - far) / np.einsum("ij,ij->i", row, now.tangent)
        guess = np.concatenate([last.u + place[:, None] * row, now.u + back[:, None] * now.tangent])
        level = np.einsum("ij,ij->i", row, last.u) + place
        points, found = self._problem.correct(np.tile(now.family, 2), guess, np.tile(row, (2, 1)), np.tile(level, 2))
        before, behind = (points.of(half) for half in np.split(np.arange(len(guess)), 2))
        other = found.reshape(2, -1).all(axis=0) & (behind.signature == now.signature).all(axis=1)
        other &= (before.signature == last.signature).all(axis=1)
        return other & (np.linalg.norm(behind.u - before.u, axis=1) > OTHER_ORBIT * taken)

    def _shrinks(self, now: Points) -> Flags:
        """Return a mask of points at which the amplitude of orbits around an equilibrium has nearly vanished."""
        small = (now.swing < SMALLEST_SWING) & self._problem.at_section
        for k in np.flatnonzero(small).tolist():
            family = int(now.family[k])
            if family not in self._around_equilibrium:
                self._around_equilibrium[family] = surrounds_equilibrium(self._problem, now.of([k]))
            small[k] = self._around_equilibrium[family]
        return np.asarray(small)

    def _shifted(self, home: np.ndarray) -> list[np.ndarray]:
        """Return first points and tangents, listed from each of their section crossings."""
        rows, number = self._problem.rows, home.shape[-1] - len(self._problem.along)
        if not self._problem.at_section:
            return [home]
        shifts = range(0, number, rows)
        return [np.concatenate([np.roll(home[..., :number], k, axis=-1), home[..., number:]], axis=-1) for k in shifts]

    def _accept(self, lanes: Index, now: Points) -> Flags:
        """Accept converged points that continue the same branch, and choose the next steps.

        Return a mask of the accepted points.
        """
        problem, last = self._problem, self._last.of(lanes)
        now = now.along(last.tangent)
        turn = np.arccos(np.clip(np.einsum("ij,ij->i", now.tangent, last.tangent), -1, 1))
        taken = np.linalg.norm(now.u - last.u, axis=1)
        changed = (now.signature != last.signature).any(axis=1)
        corner = (taken <= CORNER) & (turn <= CORNER_TURN) | (taken <= CROSSING) & (turn <= CROSSING_TURN)
        sound = np.isfinite(now.tangent).all(axis=1)
        sound &= (turn <= SHARP_TURN) | (taken < 10 * SHORTEST_STEP) | changed & corner
        forwards = np.maximum(*(np.einsum("ij,ij->i", now.u - last.u, end.tangent) for end in (last, now)))
        aside = np.arccos(np.clip(forwards / taken, -1, 1))
        sound &= changed | (taken < CROSSING) | (aside <= np.maximum(ASIDE, 2 * turn))
        value = problem.values(now.family, now.u)[:, -1]
        beyond = (value > problem.last[now.family, -1]) | (value < problem.first[now.family, -1])
        sound &= ~(beyond & np.isnan(self._bound[lanes])) & ~((now.swing < LEAST_SWING) & self._shrinks(now))
        sound[sound & changed] &= ~self._faces_corner(now.of(sound & changed), taken[sound & changed])
        crosses = np.flatnonzero(sound & changed)
        sound[crosses] = ~self._skips_part(lanes[crosses], last.of(crosses), now.of(crosses), taken[crosses])
        sound[sound] = ~problem.left_branch(last.of(sound), now.of(sound))
        kept = lanes[sound]
        now, last, taken, turn, changed = now.of(sound), last.of(sound), taken[sound], turn[sound], changed[sound]
        self.accepted.append(now)
        self.accepted_lanes.append(kept)
        self._count[kept] += 1
        self._length[kept] += taken
        # After a change of events, earlier margins and points cannot be used for extrapolation.
        self._prior_u[kept] = np.where(changed[:, None], np.nan, last.u)
        self._prior_tangent[kept] = last.tangent
        self._changed_at[kept[changed]] = self._length[kept[changed]]
        for history, new in ((self._arclengths, self._length[kept]), (self._margins, now.margin)):
            history[kept[changed]] = np.nan
            push_history(history, kept, new)
        self._shortened[kept[changed]] = self._blocked[kept[changed]] = False
        self._last.put(kept, now)
        growth = np.clip(TURN / np.maximum(turn, 1e-12), 0.5, np.where(taken < CORNER, CORNER_GROWTH, STEP_GROWTH))
        growth = np.where(self._iterations[kept] >= 4, np.minimum(growth, 0.7), growth)
        # The change of events that made this step fail is within twice the step length.
        growth = np.where(self._shortened[kept], np.minimum(growth, 1.0), growth)
        step = np.minimum(np.maximum(taken * growth, 10 * SHORTEST_STEP), self._longest * problem.stretch(now))
        to_corner = np.where(self._shortened[kept], self._step_to_corner(kept, 3 * step), np.nan)
        self._step[kept] = np.where(np.isnan(to_corner), step, to_corner)
        self._shortened[kept] = ~np.isnan(to_corner)
        if self._home is not None:
            distance = np.linalg.norm(now.u - self._home[kept, 0], axis=1)
            self._farthest[kept] = np.fmax(self._farthest[kept], distance)
            for home in self._shifted(self._home[kept]):
                distance = np.linalg.norm(now.u - home[:, 0], axis=1)
                closed = (distance < self._longest) & (self._length[kept] > 5 * self._longest)
                # A small loop goes to its far side and back, and passes its first point within a step.
                closed |= (distance < 1.1 * taken) & (self._length[kept] > LOOP * self._farthest[kept])
                closed &= np.einsum("ij,ij->i", now.tangent, home[:, 1]) > 0.9
                self.status[kept[closed]] = CLOSED
        self.status[kept[self._count[kept] >= BRANCH_MAX_POINTS]] = TOO_LONG
        # Near a graze, multipliers grow without limit, but no special points accumulate.
        near_change = (self._length[kept] - self._changed_at[kept] < CORNER) | (now.margin < NEAR_GRAZE)
        self.status[kept[(spectral_radius(now.product) > problem.most_growth) & ~near_change]] = TOO_UNSTABLE
        self.status[kept[self._stop(kept, now)]] = STOPPED
        self.status[kept[~np.isnan(self._bound[kept])]] = ENDED
        self.status[kept[self._shrinks(now)]] = VANISHED
        self.predict(kept)
        return sound
