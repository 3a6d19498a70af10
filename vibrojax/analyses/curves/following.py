"""Continuation of special points in two parameters, both ways, with their points of codimension two."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.continuation.arclength import (
    CLOSED,
    ENDED,
    STALLED,
    STOPPED,
    continue_branches,
)
from vibrojax.analyses.continuation.problem import Flags, Index, Points, Unknowns, towards
from vibrojax.analyses.continuation.segments import ENDINGS, STEP_AFTER_CORNER
from vibrojax.analyses.continuation.special_points import GRAZED_MARGIN, cross_impact, reindex_returns, turn_corner
from vibrojax.analyses.curves.codim2 import cosine, event_names, locate
from vibrojax.analyses.curves.extended import EVENTS, CurveProblem

FIRST_STEP, LONGEST_STEP = 0.02, 0.1
"""First and longest scaled step length of a curve; a parameter's range has the length 8."""

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


HALVED = 0.03
"""Scaled amplitude up to which a doubled orbit counts as the one from which it branches; its folds end there."""


class Mark(NamedTuple):
    """A point of codimension two on a curve: its name and the point."""

    name: str
    point: Points


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


class _Segment(NamedTuple):
    """A part of a curve in one direction (0 backwards, 1 forwards), with its first point."""

    curve: int
    direction: int
    begin: Points
    step: float
    number: int


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
    pending = [
        _Segment(int(begin.family[0]), direction, begin.along(sign * begin.tangent), FIRST_STEP, 0)
        for begin in begins
        for direction, sign in ((0, -1.0), (1, 1.0))
    ]
    for begin in begins:
        curves[int(begin.family[0])].begin = begin
    ends: dict[tuple[int, int], list[Points]] = {}
    notes: dict[tuple[int, int], str] = {}
    while pending:
        report(2 * len(curves) - len(pending))
        following: list[_Segment] = []
        for size in sorted({segment.begin.u.shape[1] for segment in pending}):
            group = [segment for segment in pending if segment.begin.u.shape[1] == size]
            following += _continue(problem, group, curves, ends, notes)
        pending = following
    for curve in (curves[number] for number in sorted({int(begin.family[0]) for begin in begins})):
        backwards, forwards = (ends.get((curve.number, way), []) for way in (0, 1))
        if not backwards and not forwards:
            continue
        reverse = [part.of(slice(None, None, -1)) for part in backwards[::-1]]
        closed = notes[curve.number, 1] == ENDINGS[CLOSED]
        curve.parts = (
            forwards if closed else [*reverse, *(part.of(slice(k == 0, None)) for k, part in enumerate(forwards))]
        )
        ways = (1,) if closed else (0, 1)
        curve.notes = list(dict.fromkeys(notes[curve.number, way] for way in ways))
        curve.marks = _distinct(curve.marks)


def _distinct(marks: list[Mark]) -> list[Mark]:
    """Return the marks of a curve without repetitions; located marks come before those at stalled ends."""
    kept: list[Mark] = []
    for mark in marks:
        same = [x for x in kept if x.name == mark.name and x.point.u.shape == mark.point.u.shape]
        if all(np.abs(x.point.u - mark.point.u)[0, -2:].max() > SAME_MARK for x in same):
            kept.append(mark)
    return kept


def _continue(
    problem: CurveProblem,
    segments: list[_Segment],
    curves: list[Curve],
    ends: dict[tuple[int, int], list[Points]],
    notes: dict[tuple[int, int], str],
) -> list[_Segment]:
    """Continue segments with equal numbers of unknowns; return those that follow behind corners."""
    begin = Points.join([segment.begin for segment in segments])
    step = np.array([segment.step for segment in segments])
    home = np.stack([begin.u, begin.tangent], axis=1)
    home[[segment.number > 0 for segment in segments]] = np.nan

    place, close = begin.u[:, -2:].copy(), np.zeros(len(segments), int)

    def stop(lanes: Index, now: Points) -> Flags:
        if not len(now.u):
            return np.zeros(0, bool)
        close[lanes] += 1
        away = np.abs(now.u[:, -2:] - place[lanes]).max(axis=1) > CLOSE
        place[lanes[away]], close[lanes[away]] = now.u[away, -2:], 0
        return (beyond_bounds(problem, now) != "") | (close[lanes] >= MOST_CLOSE)

    branches = continue_branches(problem, begin, step, stop, home=home, longest=LONGEST_STEP)
    located = locate(problem, branches)
    bounds = branches.bounds.tolist()
    stalled: list[tuple[_Segment, Points]] = []
    for k, segment in enumerate(segments):
        first, end, status = bounds[k], bounds[k + 1], int(branches.status[k])
        points, marks = branches.points.of(slice(first, end)), [x for x in located if first <= x[0] < end]
        points, marks, note = _cut(problem, points, [(place - first, name, x) for place, name, x in marks], status)
        key = (segment.curve, segment.direction)
        ends.setdefault(key, []).append(points)
        notes[key] = note
        curves[segment.curve].marks += [Mark(name, x) for _, name, x in marks]
        if status == STALLED and segment.number + 1 < MAX_SEGMENTS:
            stalled.append((segment, points))
    return _behind_corners(problem, stalled, curves, notes) if stalled else []


def _behind_corners(
    problem: CurveProblem,
    stalled: list[tuple[_Segment, Points]],
    curves: list[Curve],
    notes: dict[tuple[int, int], str],
) -> list[_Segment]:
    """Return the segments behind the corners at which segments have stalled, and mark the corners."""
    turned, corners = turn_corner(problem, [points for _, points in stalled])
    following = []
    for k, (segment, points) in enumerate(stalled):
        corner = corners.of([k])
        key = (segment.curve, segment.direction)
        # At a rigid stop no mode changes: only the margin shows that the curve ends at a graze.
        marks = [mark.point.u for mark in curves[segment.curve].marks if mark.point.u.shape == points.u[-1:].shape]
        marked = any(np.abs(u - points.u[-1:])[0, -2:].max() < SAME_MARK for u in marks)
        if corner.changes_events[0] or (points.margin[-1] < GRAZED_MARGIN and not marked):
            names = event_names(problem, corner)
            curves[segment.curve].marks += [Mark(name, points.of([-1])) for name in names]
            notes[key] = f"ends at the point {names[0]}"
        beyond = corner.far if turned[k] else _other_section(problem, points.of([-1]))
        if beyond is not None:
            step = STEP_AFTER_CORNER
            following.append(_Segment(segment.curve, segment.direction, beyond, step, segment.number + 1))
    return following


def _other_section(problem: CurveProblem, last: Points) -> Points | None:
    """Return the next point where an impact passes the time of the section, or a motion touches the section."""
    with np.errstate(all="ignore"):
        return cross_impact(problem, last) or reindex_returns(problem, last)


def beyond_bounds(problem: CurveProblem, now: Points) -> np.ndarray:
    """Return for each point why a curve ends there, as a text: a bound of the first parameter, or a pair that meets."""
    curve, value = now.family, problem.values(now.family, now.u)[:, 0]
    reason = np.where(value > problem.other_last[curve], f"the last value of {problem.other} is reached", "")
    reason = np.where(value < problem.other_first[curve], f"the first value of {problem.other} is reached", reason)
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


def _cut(
    problem: CurveProblem, points: Points, marks: list[tuple[int, str, Points]], status: int
) -> tuple[Points, list[tuple[int, str, Points]], str]:
    """Return points and marks up to the end of a segment, and a note on the end."""
    if status == ENDED:
        value = problem.values(points.family[-1:], points.u[-1:])[0, 1]
        which = "last" if value == problem.last[points.family[-1]] else "first"
        note = f"the {which} value of {problem.along} is reached"
    else:
        note = ENDINGS.get(status, "")
        if status == STALLED:
            note = f"no further point is found; grazing margin {points.margin[-1]:.1e}"
    if status == STOPPED:
        note = str(beyond_bounds(problem, points.of([-1]))[0])
        if not note:
            return points, marks, f"{MOST_CLOSE} points within a scaled distance of {CLOSE:g}: it does not advance"
        if "value of" in note:
            last = _at_bound(problem, points)
            points = Points.join([points.of(slice(0, len(points.u) - 1)), last])
        else:
            meeting = [(k, x) for k, name, x in marks if name in ("1:1 resonance", "1:2 resonance")]
            if meeting:
                place, point = min(meeting, key=lambda item: item[0])
                points = Points.join([points.of(slice(0, place + 1)), point])
                marks = [mark for mark in marks if mark[0] <= place]
            else:  # the curve begins where the pair meets
                points = points.of(slice(0, max(len(points.u) - 1, 1)))
    # Beyond a second graze of its own event, the curve is not one of the motion's.
    again = [mark for mark in marks if mark[1] in ("double grazing", "stick and stick")]
    passes = points.mode_changes[:, -1, 0] > 0
    if again and passes.any() and problem.kinds[points.family[0]] in EVENTS:
        place, name, point = min(again, key=lambda item: item[0])
        points = Points.join([points.of(slice(0, place + 1)), point])
        marks = [mark for mark in marks if mark[0] <= place]
        note = f"ends at the point {name}"
    return points, marks, note


def _at_bound(problem: CurveProblem, points: Points) -> Points:
    """Return the point at which the curve passes a bound of the first parameter, on its last step."""
    last = points.of([-1])
    curve, value = last.family, problem.values(last.family, last.u)[0, 0]
    bound = problem.other_last[curve] if value > problem.other_last[curve] else problem.other_first[curve]
    passed = crossings(problem, points.of(slice(-2, None)), 0, float(bound[0]))
    return Points.join(passed).of([0]) if passed else points.of([-2])


def crossings(problem: CurveProblem, points: Points, which: int, value: float) -> list[Points]:
    """Return the points at which a curve passes a value of the parameter `which` (0 or 1)."""
    if not len(points.u):
        return []
    unit = (problem.other_unit, problem.unit)[which][points.family[0]]
    level, column = value / unit, which - 2
    ahead = points.u[:, column] - level
    places = np.flatnonzero((ahead[:-1] * ahead[1:] < 0) | (ahead[:-1] == 0))
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
    length, s = np.linalg.norm(far - near, axis=1)[:, None], share[:, None]
    first, last = points.tangent[places], points.tangent[places + 1]
    # Tangents point along the direction in which a part was continued.
    way = np.sign(np.einsum("ij,ij->i", first, far - near))[:, None]
    first_bend, last_bend = way * length * first - far + near, way * length * last - far + near
    return near + s * (far - near) + s * (1 - s) * ((1 - s) * first_bend - s * last_bend)
