"""Brackets around the zeros of test functions along branches, and the iteration that shrinks them."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.periodic.problem import Flags, Index, PerLane, Points, Problem, Unknowns

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

EVENT_CHANGE = -1
"""Provisional kind of a bracket with different events at its ends; the located point determines the final kind."""

History = Float[np.ndarray, "lanes 3"]


def predict_zero(place: History, value: History) -> tuple[PerLane, PerLane]:
    """Predict the zeros of quantities from their last three values, newest first; missing values are NaN.

    Inverse interpolation is applied to the quantity or to its signed square, whichever is closer to a straight line.
    Near grazing some quantities vary as the square root of the distance.

    **Returns:** the zeros and their uncertainty; NaN with fewer than two points.
    """
    with np.errstate(all="ignore"):
        zero, uncertainty, bend = _interpolate(place, value)
        of_square, square_uncertainty, square_bend = _interpolate(place, value * np.abs(value))
        better = square_bend < bend
    return np.where(better, of_square, zero), np.where(better, square_uncertainty, uncertainty)


def _interpolate(place: History, value: History) -> tuple[PerLane, PerLane, PerLane]:
    """Return the zero by Neville's inverse interpolation, its uncertainty, and the distance of the secants' zeros."""
    (s1, s2, s3), (y1, y2, y3) = place.T, value.T
    last, before = s1 - y1 * (s2 - s1) / (y2 - y1), s2 - y2 * (s3 - s2) / (y3 - y2)
    best = last + (last - before) * y1 / (y3 - y1)
    three = np.isfinite(best)
    uncertainty = np.where(three, np.abs(best - last), TWO_POINT_UNCERTAINTY * np.abs(last - s1))
    return np.where(three, best, last), uncertainty, np.abs(last - before)


def push_history(history: np.ndarray, lanes: Int[np.ndarray, " some"], value: Float[np.ndarray, " some"]) -> None:
    """Insert the newest values of `lanes` at the front of their history, in place."""
    history[lanes, 1:] = history[lanes, :-1]
    history[lanes, 0] = value


def interpolate(near: Unknowns, far: Unknowns, near_slope: Unknowns, far_slope: Unknowns, share: PerLane) -> Unknowns:
    """Interpolate by cubic polynomials between two points; slopes are with respect to the `share` of the way."""
    s = share[:, None]
    near_bend, far_bend = near_slope - far + near, far_slope - far + near
    return near + s * (far - near) + s * (1 - s) * ((1 - s) * near_bend - s * far_bend)


class Brackets(NamedTuple):
    """Parts of branches between two points, `near` and `far`.

    `kind`: flag of the special point between them, or `EVENT_CHANGE`; `place`: index of the branch point at or before
    `near`; `ends`: mask of changes of events at which the branch ends, because the map jumps.
    """

    kind: Int[np.ndarray, " brackets"]
    place: Int[np.ndarray, " brackets"]
    near: Points
    far: Points
    ends: Flags

    def of(self, subset: Any) -> "Brackets":
        near, far = self.near.of(subset), self.far.of(subset)
        return Brackets(self.kind[subset], self.place[subset], near, far, self.ends[subset])

    def as_kind(self, kind: int) -> "Brackets":
        return self._replace(kind=np.full(len(self.place), kind))

    @staticmethod
    def join(parts: "Sequence[Brackets]") -> "Brackets":
        kind, place, near, far, ends = zip(*parts, strict=True)
        joined = (np.concatenate(x) for x in (kind, place, ends))
        return Brackets(next(joined), next(joined), Points.join(near), Points.join(far), next(joined))

    @property
    def changes_events(self) -> Flags:
        """Mask of the brackets with different events at their ends."""
        return (self.near.signature != self.far.signature).any(axis=1)


TestFunction = Callable[[Index, Points], PerLane]
"""`test(indices, points)`: test values of the brackets with these indices, at one point of each."""


def shrink_brackets(problem: Problem, brackets: Brackets, test: TestFunction) -> tuple[Brackets, Flags]:
    """Shrink brackets around zeros of a test function; return the brackets and a mask of the located zeros.

    Each new orbit is computed next to the predicted zero, at a distance equal to the uncertainty of the prediction, so
    that both ends of the bracket move. Without a prediction the bracket is bisected. If the number of events per period
    (such as impacts) differs between the ends, the test function may jump in the bracket. The sign of the test function
    then separates the two sides, and zeros are predicted from the points of one side only.

    Brackets of the kind `EVENT_CHANGE` may contain orbits on one side only, because the map has a square-root
    singularity. Then the end with fewer events moves to the last orbit with these events, and the other end does not
    move.
    """
    shrinking = _Shrinking(problem, brackets.of(np.arange(len(brackets.place))), test)
    for step in range(SHRINK_MAX_STEPS):
        shrinking.advance(step < PREDICTED_STEPS)
        if not len(shrinking.active):
            break
    return shrinking.brackets, shrinking.length() < ACCEPTED_WITHIN


class _Shrinking:
    """Brackets during shrinking: positions of the near and the far end along the tangent at the initial near end.

    `_ends` are the positions of the bracket, `_evaluated` those of its evaluated ends. A one-sided bracket may be
    shorter than their distance.
    """

    def __init__(self, problem: Problem, brackets: Brackets, test: TestFunction) -> None:
        self._problem, self.brackets, self._test = problem, brackets, test
        near, far, events = brackets.near, brackets.far, brackets.kind == EVENT_CHANGE
        self.active = lanes = np.arange(len(brackets.place))
        self._row = near.tangent.copy()
        self._base = np.einsum("ij,ij->i", self._row, near.u)
        self._ends = np.array([np.zeros(len(lanes)), np.einsum("ij,ij->i", self._row, far.u) - self._base])
        self._evaluated = self._ends.copy()
        at_near, at_far = test(lanes, near), test(lanes, far)
        self._finest = np.full(len(lanes), LOCATED_WITHIN / 3)
        self._sign, self._exact = np.sign(at_near), (at_near == 0) | (at_far == 0)
        more = far.signature - near.signature
        self._jumps = events | (more != 0).any(axis=1)
        self._fewer = np.where(events, np.sign(more.sum(axis=1)), 0)
        self._failures = np.zeros(len(lanes), int)
        self._one_sided = np.zeros(len(lanes), bool)
        # Histories of the test value: on the near side, on the far side, and on both sides.
        self._places, self._values = np.full((2, 3, len(lanes), 3), np.nan)
        for side, value in ((1, at_far), (0, at_near)):
            self._record(side, lanes, self._ends[side], value)

    def length(self) -> PerLane:
        """Return the scaled distance between the ends of each bracket."""
        between = np.abs(self.brackets.far.u - self.brackets.near.u).max(axis=1)
        return np.where(self._one_sided, self._ends[1] - self._ends[0], between)

    def advance(self, predict: bool) -> None:
        """Compute one more orbit in each active bracket."""
        # At a kink the solutions at the two ends stay apart, however close their planes are.
        width = self._ends[1] - self._ends[0]
        wide = (self.length() > LOCATED_WITHIN) & (width > LOCATED_WITHIN / 10)
        steep = ~wide & ~self._jumps & (width > STEEP_WITHIN)
        steep &= np.nanmin(np.abs(self._values[2, :, :2]), axis=1) > STEEP_VALUE
        self._finest[steep] = STEEP_WITHIN / 3
        self.active = self.active[((wide | steep) & ~self._exact)[self.active]]
        lanes = self.active
        if not len(lanes):
            return
        low, high = self._ends[:, lanes]
        place = self._predict(lanes) if predict else (low + high) / 2
        retry = RETRIES[np.minimum(self._failures[lanes], len(RETRIES) - 1)]
        place = np.where((self._failures[lanes] > 0) & ~self._one_sided[lanes], low + retry * (high - low), place)
        guess, family = self._guess(lanes, place), self.brackets.near.family[lanes]
        now, converged = self._problem.correct(family, guess, self._row[lanes], self._base[lanes] + place)
        value = self._test(lanes, now)
        self._exact[lanes[converged & (value == 0)]] = True
        on_near_side = np.sign(value) == self._sign[lanes]
        for side, mask in ((0, converged & on_near_side), (1, converged & ~on_near_side)):
            moved = lanes[mask]
            self._ends[side, moved] = self._evaluated[side, moved] = place[mask]
            (self.brackets.near, self.brackets.far)[side].put(moved, now.of(mask))
            self._record(side, moved, place[mask], value[mask])
        self._failures[lanes[converged]] = 0
        # If no orbit was found, a one-sided bracket shrinks from the side without orbits. Others try another position.
        failed, place = lanes[~converged], place[~converged]
        fewer, known = self._fewer[failed], self._one_sided[failed]
        for side, empty in ((1, known & (fewer > 0)), (0, known & (fewer < 0))):
            self._ends[side, failed[empty]] = place[empty]
        self._one_sided[failed] |= fewer != 0
        self._failures[failed] = np.where(self._one_sided[failed], 0, self._failures[failed] + 1)
        self.active = lanes[self._failures[lanes] < len(RETRIES)]

    def _record(self, side: int, lanes: Index, place: PerLane, value: PerLane) -> None:
        for history in (side, 2):
            push_history(self._places[history], lanes, place)
            push_history(self._values[history], lanes, value)

    def _predict(self, lanes: Index) -> PerLane:
        """Return the positions at which the next orbits are computed."""
        (low, high), jumps = self._ends[:, lanes], self._jumps[lanes]
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
        low, high = self._evaluated[:, lanes]
        ends = self.brackets.near.of(lanes), self.brackets.far.of(lanes)
        (near, far), row = (end.u for end in ends), self._row[lanes]
        near_slope, far_slope = (end.tangent / np.einsum("ij,ij->i", end.tangent, row)[:, None] for end in ends)
        from_near = np.where(self._one_sided[lanes], self._fewer[lanes] > 0, place - low < high - place)
        linear = np.where(
            from_near[:, None], near + (place - low)[:, None] * near_slope, far + (place - high)[:, None] * far_slope
        )
        whole, share = (high - low)[:, None], (place - low) / (high - low)
        cubic = interpolate(near, far, whole * near_slope, whole * far_slope, share)
        return np.where(self._jumps[lanes][:, None], linear, cubic)
