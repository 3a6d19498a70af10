"""Brackets around the zeros of test functions along branches, and the iteration that shrinks them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.analyses.continuation.problem import Evaluation, Flags, Index, PerLane, Problem, Unknowns, unit_tangent

LOCATED_WITHIN = 1e-10
"""Scaled distance between the ends of a bracket at which its zero counts as located."""

STEEP_WITHIN, STEEP_VALUE = 1e-13, 1e-5
"""Smaller distance for continuous test functions that exceed `STEEP_VALUE` at `LOCATED_WITHIN`. Near grazing,
multipliers vary as the square root of the distance."""

ACCEPTED_WITHIN = 1e-6
"""Largest accepted scaled distance if no closer orbits are found in the bracket."""

SHRINK_MAX_STEPS, PREDICTED_STEPS = 60, 16
"""Largest number of shrinking steps, and number of first steps that use predicted zeros; later steps bisect."""

OUTSIDE = 1e-2
"""Largest distance of an accepted predicted zero outside its bracket, relative to the bracket's length."""

RETRIES = np.array([0.5, 0.1, 0.9, 0.01, 0.99])
"""Relative positions in the bracket that are tried one after another; near corners some planes contain no orbit."""

TWO_POINT_UNCERTAINTY = 0.1
"""Uncertainty of a zero predicted from only two points, relative to the distance of the zero."""

History = Float[np.ndarray, "lanes 3"]


class ZeroPrediction(NamedTuple):
    """Predicted zeros and their uncertainty; NaN with fewer than two points."""

    place: Float[np.ndarray, " lanes"]
    uncertainty: Float[np.ndarray, " lanes"]


def predict_zero(place: History, value: History) -> ZeroPrediction:
    """Predict the zeros of quantities from their last three values, newest first; missing values are NaN.

    Inverse interpolation is applied to the quantity or to its signed square, whichever is closer to a straight line.
    Near grazing some quantities vary as the square root of the distance.
    """
    with np.errstate(all="ignore"):
        plain, bend = _interpolate(place, value)
        square, square_bend = _interpolate(place, value * np.abs(value))
        better = square_bend < bend
    return ZeroPrediction(*(np.where(better, *pair) for pair in zip(square, plain, strict=True)))


def _interpolate(place: History, value: History) -> tuple[ZeroPrediction, Float[np.ndarray, " lanes"]]:
    """Return the zero by Neville's inverse interpolation, and the distance between the zeros of the two secants."""
    (s1, s2, s3), (y1, y2, y3) = place.T, value.T
    last, before = s1 - y1 * (s2 - s1) / (y2 - y1), s2 - y2 * (s3 - s2) / (y3 - y2)
    best = last + (last - before) * y1 / (y3 - y1)
    three = np.isfinite(best)
    uncertainty = np.where(three, np.abs(best - last), TWO_POINT_UNCERTAINTY * np.abs(last - s1))
    return ZeroPrediction(np.where(three, best, last), uncertainty), np.abs(last - before)


def push_history(history: np.ndarray, lanes: Int[np.ndarray, " some"], value: Float[np.ndarray, " some"]) -> None:
    """Insert the newest values of `lanes` at the front of their history, in place."""
    history[lanes, 1:] = history[lanes, :-1]
    history[lanes, 0] = value


class BranchBrackets(NamedTuple):
    """Parts of branches between two evaluated points, `near` and `far`, with the tangents at these points.

    `family`: family index of each bracket; `place`: index of the branch point at or before `near`.
    """

    family: Index
    place: Int[np.ndarray, " brackets"]
    near: Evaluation
    near_tangent: Unknowns
    far: Evaluation
    far_tangent: Unknowns

    def of(self, subset: Flags | Index) -> "BranchBrackets":
        """Return a subset of the brackets, by index or mask."""
        fields: list[Any] = [x.of(subset) if isinstance(x, Evaluation) else x[subset] for x in self]
        return BranchBrackets(*fields)

    def reversed(self) -> "BranchBrackets":
        """Return the brackets with exchanged ends."""
        return BranchBrackets(self.family, self.place, self.far, self.far_tangent, self.near, self.near_tangent)


TestFunction = Callable[[Index, Evaluation, Unknowns], PerLane]
"""`test(indices, evaluation, tangent)`: test values of the brackets with these indices, at one point of each."""


def shrink_brackets(
    problem: Problem, brackets: BranchBrackets, test: TestFunction, events: Flags
) -> tuple[BranchBrackets, Flags]:
    """Shrink brackets around zeros of a test function; return the brackets and a mask of the located zeros.

    Each new orbit is computed next to the predicted zero, at a distance equal to the uncertainty of the prediction, so
    that both ends of the bracket move. Without a prediction the bracket is bisected. If the number of events per period
    (such as impacts) differs between the ends, the test function may jump in the bracket. The sign of the test function
    then separates the two sides, and zeros are predicted from the points of one side only.

    `events`: mask of brackets that are known to contain such a change. There orbits may exist on one side only, because
    the map has a square-root singularity. Then the end with fewer events moves to the last orbit with these events, and
    the other end does not move.
    """
    shrinking = _Shrinking(problem, brackets.of(np.arange(len(brackets.place))), test, events)
    for step in range(SHRINK_MAX_STEPS):
        shrinking.advance(step < PREDICTED_STEPS)
        if not len(shrinking.active):
            break
    return shrinking.brackets, shrinking.length() < ACCEPTED_WITHIN


class _Shrinking:
    """Brackets during shrinking, from `low` to `high`: positions along the tangent at the initial near end.

    `low_end` and `high_end` are the positions of the evaluated ends. A one-sided bracket may be shorter than their
    distance.
    """

    def __init__(self, problem: Problem, brackets: BranchBrackets, test: TestFunction, events: Flags) -> None:
        self._problem, self.brackets, self._test = problem, brackets, test
        lanes = np.arange(len(brackets.place))
        near, far = brackets.near, brackets.far
        self.active = lanes
        self._row = brackets.near_tangent.copy()
        self._base = np.einsum("ij,ij->i", self._row, near.u)
        self._low, self._high = np.zeros(len(lanes)), np.einsum("ij,ij->i", self._row, far.u) - self._base
        self._low_end, self._high_end = self._low.copy(), self._high.copy()
        f_low, f_high = test(lanes, near, brackets.near_tangent), test(lanes, far, brackets.far_tangent)
        self._finest = np.full(len(lanes), LOCATED_WITHIN / 3)
        self._sign, self._exact = np.sign(f_low), (f_low == 0) | (f_high == 0)
        more = far.signature - near.signature
        self._jumps = events | (more != 0).any(axis=1)
        self._fewer = np.where(events, np.sign(more.sum(axis=1)), 0)
        self._failures = np.zeros(len(lanes), int)
        self._one_sided = np.zeros(len(lanes), bool)
        # Histories of the test value: on the near side, on the far side, and on both sides.
        self._places, self._values = np.full((2, 3, len(lanes), 3), np.nan)
        for side, place, f in ((0, self._low, f_low), (1, self._high, f_high), (2, self._high, f_high)):
            self._record(side, lanes, place, f)
        self._record(2, lanes, self._low, f_low)

    def length(self) -> PerLane:
        """Return the scaled distance between the ends of each bracket."""
        between = np.abs(self.brackets.far.u - self.brackets.near.u).max(axis=1)
        return np.where(self._one_sided, self._high - self._low, between)

    def advance(self, predict: bool) -> None:
        """Compute one more orbit in each active bracket."""
        # At a kink the solutions at the two ends stay apart, however close their planes are.
        wide = (self.length() > LOCATED_WITHIN) & (self._high - self._low > LOCATED_WITHIN / 10)
        steep = ~wide & ~self._jumps & (self._high - self._low > STEEP_WITHIN)
        steep &= np.nanmin(np.abs(self._values[2, :, :2]), axis=1) > STEEP_VALUE
        self._finest[steep] = STEEP_WITHIN / 3
        self.active = self.active[((wide | steep) & ~self._exact)[self.active]]
        lanes = self.active
        if not len(lanes):
            return
        low, high = self._low[lanes], self._high[lanes]
        place = self._predict(lanes) if predict else (low + high) / 2
        retry = RETRIES[np.minimum(self._failures[lanes], len(RETRIES) - 1)]
        place = np.where((self._failures[lanes] > 0) & ~self._one_sided[lanes], low + retry * (high - low), place)
        guess, row = self._guess(lanes, place), self._row[lanes]
        now, converged = self._problem.correct(self.brackets.family[lanes], guess, row, self._base[lanes] + place)
        tangent = unit_tangent(now.matrix, row)
        f = self._test(lanes, now, tangent)
        self._exact[lanes[converged & (f == 0)]] = True
        on_near_side = converged & (np.sign(f) == self._sign[lanes])
        for side, mine in ((0, on_near_side), (1, converged & ~on_near_side)):
            self._move_end(side, lanes[mine], place[mine], now.of(mine), tangent[mine], f[mine])
        self._failures[lanes[converged]] = 0
        # If no orbit was found, a one-sided bracket shrinks from the side without orbits. Others try another position.
        failed, place = lanes[~converged], place[~converged]
        fewer, known = self._fewer[failed], self._one_sided[failed]
        ahead, behind = known & (fewer > 0), known & (fewer < 0)
        self._high[failed[ahead]] = place[ahead]
        self._low[failed[behind]] = place[behind]
        self._one_sided[failed] |= fewer != 0
        self._failures[failed] = np.where(self._one_sided[failed], 0, self._failures[failed] + 1)
        self.active = lanes[self._failures[lanes] < len(RETRIES)]

    def _move_end(
        self, side: int, lanes: Index, place: PerLane, now: Evaluation, tangent: Unknowns, f: PerLane
    ) -> None:
        if side == 0:
            self._low[lanes] = self._low_end[lanes] = place
            self.brackets.near.put(lanes, now)
            self.brackets.near_tangent[lanes] = tangent
        else:
            self._high[lanes] = self._high_end[lanes] = place
            self.brackets.far.put(lanes, now)
            self.brackets.far_tangent[lanes] = tangent
        self._record(side, lanes, place, f)
        self._record(2, lanes, place, f)

    def _record(self, side: int, lanes: Index, place: PerLane, value: PerLane) -> None:
        push_history(self._places[side], lanes, place)
        push_history(self._values[side], lanes, value)

    def _predict(self, lanes: Index) -> PerLane:
        """Return the positions at which the next orbits are computed."""
        low, high, jumps = self._low[lanes], self._high[lanes], self._jumps[lanes]
        best, least = (low + high) / 2, np.full(len(lanes), np.inf)
        for side in range(3):
            zero, uncertainty = predict_zero(self._places[side][lanes], self._values[side][lanes])
            outside = np.maximum(np.maximum(low - zero, zero - high), 0)
            uncertainty = np.maximum(np.maximum(uncertainty, 2 * outside), self._finest[lanes])
            with np.errstate(invalid="ignore"):
                sound = (jumps == (side < 2)) & (outside < OUTSIDE * (high - low)) & (uncertainty < least)
            zero = np.clip(zero, low, high)
            to_wide = np.where(zero - low > high - zero, -1.0, 1.0)
            # An orbit on the same side improves the prediction, until its uncertainty is as small as required.
            own = (-1.0, 1.0, to_wide)[side]
            way = np.where((uncertainty <= self._finest[lanes]) | (outside > 0), to_wide, own)
            place = zero + way * uncertainty
            place = np.where((place > low) & (place < high), place, zero + to_wide * uncertainty)
            sound &= (place > low) & (place < high)
            best, least = np.where(sound, place, best), np.where(sound, uncertainty, least)
        return best

    def _guess(self, lanes: Index, place: PerLane) -> Unknowns:
        """Return initial guesses: cubic interpolation between the ends, or linear extrapolation where values jump.

        The extrapolation starts from the nearer end, or from the end with fewer events if the bracket is one-sided.
        """
        row, low, high = self._row[lanes], self._low_end[lanes], self._high_end[lanes]
        near, far = self.brackets.near.u[lanes], self.brackets.far.u[lanes]
        near_slope, far_slope = (
            tangent[lanes] / np.einsum("ij,ij->i", tangent[lanes], row)[:, None]
            for tangent in (self.brackets.near_tangent, self.brackets.far_tangent)
        )
        from_near = np.where(self._one_sided[lanes], self._fewer[lanes] > 0, place - low < high - place)
        linear = np.where(
            from_near[:, None], near + (place - low)[:, None] * near_slope, far + (place - high)[:, None] * far_slope
        )
        whole, part = (high - low)[:, None], ((place - low) / (high - low))[:, None]
        near_bend, far_bend = whole * near_slope - far + near, whole * far_slope - far + near
        cubic = near + part * (far - near)
        cubic += part * (1 - part) * ((1 - part) * near_bend - part * far_bend)
        return np.where(self._jumps[lanes][:, None], linear, cubic)
