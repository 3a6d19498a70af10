"""Continuation of special points in two parameters, both ways, with their points of codimension two."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.arclength import CLOSED, ENDED, STALLED, STOPPED, Stop
from vibrojax.periodic.brackets import interpolate, predict_zero
from vibrojax.periodic.codim2 import CODIM2_NAMES, CodimensionTwo, cosine, event_names
from vibrojax.periodic.curve_equations import EVENTS, CurveProblem
from vibrojax.periodic.grazes import GRAZED_MARGIN
from vibrojax.periodic.location import cross_impact, reindex_returns, turn_corner
from vibrojax.periodic.problem import Flags, Index, Points, Unknowns, towards
from vibrojax.periodic.segments import ENDINGS, Mark, Segment, Tracing

LONGEST_STEP = 0.1
"""Longest scaled step length of a curve; a parameter's range has the length 8."""

MAX_SEGMENTS = 6
"""Largest number of segments of a curve in one direction; they meet at corners, where another event begins."""

MOST_CLOSE, CLOSE = 100, 5e-3
"""Number of successive points within the scaled distance `CLOSE` of one another, in both parameters, at which a segment
ends: it does not advance."""

NEAR_START = 1e-3
"""Largest scaled distance between a special point of the family and the beginning of its curve."""


SAME_MARK = 1e-4
"""Scaled distance of both parameters within which marks of one name on one curve are one. A curve that stalls at an
event ends within such a distance."""


STEEPEST_CONDITION = 1e5
"""Largest slope of a curve's condition. Next to a graze it grows as the inverse of the margin, and rounding errors with
it, so that they would decide the steps."""

HALVED = 0.03
"""Scaled amplitude up to which a doubled orbit counts as the one from which it branches; its folds end there."""


@dataclass
class Curve:
    """A curve: `parts` of its points in order, marks, notes on its two ends, and the `special` point of the family.

    `special` is -1 if the curve begins at a point of codimension two, of which `origin` tells; `begin`: first point.
    """

    number: int
    parts: list[Points] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    special: int = -1
    origin: str = ""
    begin: Points | None = None


def follow_curves(problem: CurveProblem, unknowns: list[np.ndarray], report: Callable[[int], None]) -> list[Curve]:
    """Return the curves through special points, whose `unknowns` are listed in the order of the problem's curves.

    `report` is called with the number of ends of curves that have been reached, of two for each curve.
    """
    curves = [Curve(number) for number in range(len(unknowns))]
    begins: list[Points] = []
    for size in sorted({len(u) for u in unknowns}):
        number = np.array([k for k, u in enumerate(unknowns) if len(u) == size])
        u = np.array([unknowns[k] for k in number])
        begin, converged = problem.correct(number, u, towards(u, 1.0), u[:, -1])
        near = np.abs(begin.u - u).max(axis=1) < NEAR_START
        for k, curve in enumerate(number.tolist()):
            if converged[k] and near[k]:
                begins.append(begin.of([k]))
            else:
                curves[curve].notes.append("the special point satisfies no equations that can be continued")
    continue_both_ways(problem, begins, curves, report)
    return curves


def continue_both_ways(
    problem: CurveProblem, begins: list[Points], curves: list[Curve], report: Callable[[int], None]
) -> None:
    """Continue curves from one point of each, with a tangent; `curves`: the curves of the problem, in order."""
    segments = []
    for begin in begins:
        for sign in (-1, 1):
            first = begin.along(sign * begin.tangent)
            segments.append(Segment(int(begin.family[0]), 0, sign, first, home=first))
    done = _CurveTracing(problem, curves).trace(segments, lambda remaining: report(2 * len(curves) - remaining))
    for begin in begins:
        curve = curves[int(begin.family[0])]
        backwards, forwards = ([s for s in done if (s.family, s.direction) == (curve.number, way)] for way in (-1, 1))
        closed = forwards[-1].note == ENDINGS[CLOSED]
        back = [segment.points.of(slice(None, None, -1)) for segment in backwards[::-1]]
        reverse = [points._replace(tangent=-points.tangent) for points in back]
        first, *onward = [segment.points for segment in forwards]
        if not closed:  # both ways have the first point
            first = Points.join([reverse.pop(), first.of(slice(1, None))])
        curve.begin, curve.parts = begin, [first, *onward] if closed else [*reverse, first, *onward]
        curve.notes = list(dict.fromkeys(way[-1].note for way in ([forwards] if closed else [backwards, forwards])))
        curve.marks = sorted(_distinct(curve.marks), key=lambda mark: _place(curve.parts, mark))


def _place(parts: list[Points], mark: Mark) -> tuple[int, int]:
    """Return the numbers of the part of a curve and of its point that are nearest to a mark."""
    distances = [
        (float(distance), part, place)
        for part, points in enumerate(parts)
        if points.u.shape[1] == mark.orbit.u.shape[1]
        for place, distance in enumerate(np.abs(points.u - mark.orbit.u).max(axis=1))
    ]
    return min(distances, default=(0.0, len(parts), 0))[1:]


def _distinct(marks: list[Mark]) -> list[Mark]:
    """Return the marks of a curve without repetitions; located marks come before those at stalled ends."""
    kept: list[Mark] = []
    for mark in marks:
        if not _is_marked(kept, mark.orbit, mark.kind):
            kept.append(mark)
    return kept


def _is_marked(marks: list[Mark], point: Points, kind: str = "") -> bool:
    """Return whether there is a mark at the parameters of a point, of any kind or of one."""
    same = [x.orbit.u for x in marks if kind in ("", x.kind) and x.orbit.u.shape == point.u.shape]
    return any(np.abs(u - point.u)[0, -2:].max() <= SAME_MARK for u in same)


class _CurveTracing(Tracing):
    """Continuation of the curves of one problem, which gets marks and notes."""

    longest = LONGEST_STEP
    _problem: CurveProblem

    def __init__(self, problem: CurveProblem, curves: list[Curve]) -> None:
        super().__init__(problem, CodimensionTwo(problem))
        self._curves = curves

    def stop(self, segments: list[Segment]) -> Stop:
        """Return the condition that a curve leaves its range, or does not advance."""
        place = np.concatenate([segment.begin.u[:, -2:] for segment in segments])
        close = np.zeros(len(segments), int)

        def stop(lanes: Index, now: Points) -> Flags:
            if not len(now.u):
                return np.zeros(0, bool)
            close[lanes] += 1
            away = np.abs(now.u[:, -2:] - place[lanes]).max(axis=1) > CLOSE
            place[lanes[away]], close[lanes[away]] = now.u[away, -2:], 0
            return (beyond_bounds(self._problem, now) != "") | (close[lanes] >= MOST_CLOSE) | self._at_graze(now)

        return stop

    def _at_graze(self, now: Points) -> Flags:
        """Return a mask of the points next to a graze at which the curve's condition is too steep to be followed."""
        steep = np.linalg.norm(now.matrix[:, -1], axis=1) > STEEPEST_CONDITION
        return steep & (now.margin < GRAZED_MARGIN) & ~np.isin(self._problem.kinds[now.family], EVENTS)

    def finish(self, segments: list[Segment]) -> list[Segment]:
        """Cut segments at their ends, and mark their points; return the segments behind the corners."""
        stalled = []
        for segment in segments:
            segment.home = None
            if segment.status == STOPPED and self._at_graze(segment.points.of([-1]))[0]:
                segment.status, segment.points = STALLED, _up_to_graze(segment.points)
            _cut(self._problem, segment)
            self._curves[segment.family].marks += segment.marks
            if segment.status == STALLED and segment.number + 1 < MAX_SEGMENTS:
                stalled.append(segment)
        return self._behind_corners(stalled) if stalled else []

    def _behind_corners(self, stalled: list[Segment]) -> list[Segment]:
        """Return the segments behind the corners at which segments have stalled, and mark the corners."""
        problem = self._problem
        turned, corners = turn_corner(problem, [segment.points for segment in stalled])
        following = []
        for k, segment in enumerate(stalled):
            corner, last, marks = corners.of([k]), segment.points.of([-1]), self._curves[segment.family].marks
            # At a rigid stop no mode changes: only the margin shows that the curve ends at a graze.
            if corner.changes_events[0] or (last.margin[0] < GRAZED_MARGIN and not _is_marked(marks, last)):
                names = event_names(problem, corner)
                marks += [Mark(last, name) for name in names]
                segment.note = f"ends at the point {names[0]}" if names else segment.note
            with np.errstate(all="ignore"):
                beyond = corner.far if turned[k] else cross_impact(problem, last) or reindex_returns(problem, last)
            if beyond is not None:
                following.append(segment.onward(beyond))
        return following


def beyond_bounds(problem: CurveProblem, now: Points) -> np.ndarray:
    """Return for each point why a curve ends there, as a text: a bound of the first parameter, or a pair that meets."""
    curve, value = now.family, problem.values(now.family, now.u)[:, 0]
    reason = np.where(value > problem.last[curve, 0], f"the last value of {problem.along[0]} is reached", "")
    reason = np.where(value < problem.first[curve, 0], f"the first value of {problem.along[0]} is reached", reason)
    states = now.u[:, :-2]
    if states.shape[1] % (2 * problem.rows) == 0 and len(states):
        first, second = np.split(states, 2, axis=1)
        halved = np.abs(first - second).max(axis=1) < HALVED
        reason = np.where(halved & (reason == ""), "the orbit becomes one of half its cycles", reason)
    torus = problem.kinds[curve] == "torus"
    if torus.any():
        meets = np.zeros(len(torus), bool)
        meets[torus] = np.abs(cosine(now.of(torus))) > 1
        reason = np.where(meets & (reason == ""), "the pair of multipliers meets on the real axis", reason)
    return reason


def _cut(problem: CurveProblem, segment: Segment) -> None:
    """Cut the points of a segment at its end; enter its marks, and a note on the end."""
    points, special, status = segment.points, segment.special, segment.status
    names = (CODIM2_NAMES[kind] for kind in special.kind)
    marks = [Mark(special.near.of([k]), name, "", int(special.place[k])) for k, name in enumerate(names)]

    def end_at(first: Mark) -> tuple[Points, list[Mark]]:
        kept = [mark for mark in marks if mark.place <= first.place]
        return Points.join([points.of(slice(0, first.place + 1)), first.orbit]), kept

    note = ENDINGS.get(status, "")
    if status == ENDED:
        value = problem.values(points.family[-1:], points.u[-1:])[0, 1]
        which = "last" if value == problem.last[points.family[-1], 1] else "first"
        note = f"the {which} value of {problem.along[1]} is reached"
    elif status == STALLED:
        note = f"no further point is found; grazing margin {points.margin[-1]:.1e}"
    elif status == STOPPED:
        note = str(beyond_bounds(problem, points.of([-1]))[0])
        if not note:
            note = f"{MOST_CLOSE} points within a scaled distance of {CLOSE:g}: it does not advance"
        elif "value of" in note:
            points = Points.join([points.of(slice(0, len(points.u) - 1)), _at_bound(problem, points)])
        else:
            meeting = [mark for mark in marks if mark.kind in ("1:1 resonance", "1:2 resonance")]
            if meeting:
                points, marks = end_at(min(meeting, key=lambda mark: mark.place))
            else:  # the curve begins where the pair meets
                points = points.of(slice(0, max(len(points.u) - 1, 1)))
    # Beyond a second graze of its own event, the curve is not one of the motion's.
    again = [mark for mark in marks if mark.kind in ("double grazing", "stick and stick")]
    passes = points.mode_changes[:, -1, 0] > 0
    if again and passes.any() and problem.kinds[segment.family] in EVENTS:
        first = min(again, key=lambda mark: mark.place)
        points, marks = end_at(first)
        note = f"ends at the point {first.kind}"
    segment.points, segment.marks, segment.note = points, marks, note


def _up_to_graze(points: Points) -> Points:
    """Return the points of a segment with the point at which its grazing margin vanishes, by extrapolation."""
    last, way = points.of([-1]), np.diff(points.u[-3:], axis=0)
    lengths = np.linalg.norm(way, axis=1)
    places, margins = np.full((2, 1, 3), np.nan)
    places[0, : len(lengths) + 1] = -np.cumsum(np.append(0.0, lengths[::-1]))
    margins[0, : len(lengths) + 1] = points.margin[-3:][::-1]
    [ahead], _ = predict_zero(places, margins)
    if not 0 < ahead < LONGEST_STEP:
        return points
    bend = (points.tangent[-1] - points.tangent[-2]) / lengths[-1]
    u = last.u + ahead * last.tangent + ahead**2 / 2 * bend
    return Points.join([points, last._replace(u=u, margin=np.zeros(1))])


def _at_bound(problem: CurveProblem, points: Points) -> Points:
    """Return the point at which the curve passes a bound of the first parameter, on its last step."""
    last = points.of([-1])
    curve, value = last.family, problem.values(last.family, last.u)[0, 0]
    bound = problem.last[curve, 0] if value > problem.last[curve, 0] else problem.first[curve, 0]
    passed = crossings(problem, points.of(slice(-2, None)), 0, float(bound[0]))
    return Points.join(passed).of([0]) if passed else points.of([-2])


def crossings(problem: CurveProblem, points: Points, which: int, value: float) -> list[Points]:
    """Return the points at which a curve passes a value of the parameter `which` (0 or 1)."""
    if not len(points.u):
        return []
    level, column = value / problem.unit[points.family[0], which], which - 2
    ahead = points.u[:, column] - level
    ends = np.arange(2, len(ahead) + 1) == len(ahead)
    places = np.flatnonzero((ahead[:-1] * ahead[1:] < 0) | (ahead[:-1] == 0) | ends & (ahead[1:] == 0))
    if not len(places):
        return []
    near, far = points.u[places], points.u[places + 1]
    share = (level - near[:, column]) / (far - near)[:, column]
    row = np.zeros_like(near)
    row[:, column] = np.sign(far - near)[:, column]
    guess = between(points, places, share)
    guess[:, column] = level
    located, converged = problem.correct(points.family[places], guess, row, row[:, column] * level)
    return [located.of([k]) for k in np.flatnonzero(converged).tolist()]


def between(points: Points, places: Index, share: Float[np.ndarray, " lanes"]) -> Unknowns:
    """Return the unknowns between neighbouring points of a curve, by cubic interpolation."""
    near, far = points.u[places], points.u[places + 1]
    first, last = points.tangent[places], points.tangent[places + 1]
    # Tangents point along the direction in which a part was continued.
    way = np.sign(np.einsum("ij,ij->i", first, far - near)) * np.linalg.norm(far - near, axis=1)
    return interpolate(near, far, way[:, None] * first, way[:, None] * last, share)
