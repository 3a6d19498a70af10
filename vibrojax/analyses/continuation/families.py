"""Continuation of complete families of periodic orbits.

Every branch is continued in both directions, past its special points. Period-doubled branches are continued as well.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vibrojax.analyses.continuation.arclength import (
    ENDED,
    SHORTEST_STEP,
    STALLED,
    STOPPED,
    BranchPoints,
    InitialPoints,
    continue_branches,
)
from vibrojax.analyses.continuation.brackets import BranchBrackets
from vibrojax.analyses.continuation.branch_segments import (
    ENDINGS,
    REJOIN_DISTANCE,
    Segment,
    SegmentMark,
    drop_duplicates,
)
from vibrojax.analyses.continuation.indicators import KINDS
from vibrojax.analyses.continuation.problem import Evaluation, Flags, Index, Problem, unit_tangent
from vibrojax.analyses.continuation.special_points import SpecialPoints, classify_event_changes, locate_special_points
from vibrojax.analyses.continuation.switching import branch_distance, doubled_branch, reindex_returns, turn_corner
from vibrojax.measures.ledger import MOST_CYCLES

FIRST_STEP, STEP_AFTER_CORNER = 0.02, 1e-3
"""First scaled step lengths: of a branch, and beyond a corner."""

MAX_SEGMENTS = 24
"""Largest number of segments of a branch in one direction. Segments end at corners and where the motion touches the
section."""

MAX_BRANCHES = 32
"""Largest number of branches of a family."""

SAME_POINT = 1e-6
"""Scaled distance within which special points of the same kind count as equal."""

BEFORE_CORNER = 100 * SHORTEST_STEP
"""Scaled distance before a corner at which a point certainly has the events of the side before the corner."""


class FamilyContinuation:
    """Continuation of the families of one problem.

    `cycles`: largest number of section crossings per period of doubled branches.
    """

    def __init__(self, problem: Problem, cycles: int = MOST_CYCLES) -> None:
        self._problem, self._cycles = problem, cycles
        self._branches: dict[int, int] = {}

    def __call__(self, family: Index, u: Sequence[np.ndarray]) -> list[Segment]:
        """Return all segments of the families to which orbits belong; `u`: unknowns of one orbit per `family`."""
        self._branches = dict.fromkeys(family.tolist(), 1)
        pending: list[Segment] = []
        for number, orbit in zip(family.tolist(), u, strict=True):
            up = np.zeros_like(orbit[None])
            up[:, -1] = 1.0
            tangent = unit_tangent(self._problem.evaluate(np.array([number]), orbit[None]).matrix, up)[0]
            for sign in (1, -1):
                home = (orbit, sign * tangent)
                pending.append(Segment(number, 0, sign, orbit, sign * tangent, FIRST_STEP, home=home))
        done: list[Segment] = []
        while pending:
            following: list[Segment] = []
            for size in sorted({len(segment.u) for segment in pending}):
                group = [segment for segment in pending if len(segment.u) == size]
                following += self._continue(group)
                done += group
            pending = following
        return drop_duplicates(done, self._problem.rows)

    def _continue(self, segments: list[Segment]) -> list[Segment]:
        """Continue segments with equal numbers of section crossings to their ends; return the segments that follow."""
        family = np.array([segment.family for segment in segments])
        size = len(segments[0].u)
        none = np.full(size, np.nan)
        homes = [s.home if s.home is not None and len(s.home[0]) == size else (none, none) for s in segments]
        initial = InitialPoints(
            family=family,
            u=np.array([segment.u for segment in segments]),
            tangent=np.array([segment.tangent for segment in segments]),
            step=np.array([segment.step for segment in segments]),
            home=np.array([home for home, _ in homes]),
            home_tangent=np.array([tangent for _, tangent in homes]),
        )
        departure = np.array([none if segment.departure is None else segment.departure for segment in segments])

        def rejoins(lanes: Index, now: Evaluation) -> Flags:
            if size % 2 == 0:  # doubled orbits have an even number of states and one parameter
                return np.zeros(len(lanes), bool)
            with np.errstate(invalid="ignore"):
                return branch_distance(now.u, departure[lanes]) <= 0

        points = continue_branches(self._problem, initial, stop=rejoins)
        bounds = np.searchsorted(points.lane, np.arange(len(segments) + 1))
        special = locate_special_points(self._problem, family, points)
        for k, segment in enumerate(segments):
            last = bounds[k + 1] - (points.status[k] == STOPPED)
            segment.points = points.evaluation.of(slice(bounds[k], last))
            if last < bounds[k + 1]:
                beyond = float(np.abs(points.evaluation.u[last] - segment.points.u[-1]).max())
                segment.reach = max(segment.reach, beyond)
            if special is not None:
                self._add_marks(segment, special, int(bounds[k]), int(last))
        return self._end(segments, points, bounds) + self._doubled_branches(segments)

    def _add_marks(self, segment: Segment, special: SpecialPoints, first: int, last: int) -> None:
        """Add the special points between the branch points `first` and `last` - 1 to the segment."""
        brackets = special.brackets
        for k in np.flatnonzero((brackets.place >= first) & (brackets.place < last - 1)):
            kind, orbit, note = KINDS[special.kind[k]], brackets.near.of([k]), ""
            beyond = brackets.far.of([k])
            if kind == "grazing" and orbit.impacts[0] == beyond.impacts[0]:
                changed = (orbit.mode_changes[0] != beyond.mode_changes[0]).any(axis=1)
                modes = zip(self._problem.scene.modes, changed, strict=True)
                names = ", ".join(mode.name for mode, differs in modes if differs)
                note = f"no impact: another order of events of {names}"
            segment.marks.append(SegmentMark(kind, orbit, int(brackets.place[k]) - first, note))
        u = segment.orbits.u
        segment.marks.sort(key=lambda mark: (mark.place, np.abs(mark.orbit.u[0] - u[mark.place]).max()))

    def _end(self, segments: list[Segment], points: BranchPoints, bounds: np.ndarray) -> list[Segment]:
        """Mark the ends of segments; return the segments that follow stalled segments."""
        stalled: list[Segment] = []
        tangents: list[np.ndarray] = []
        for k, segment in enumerate(segments):
            status = int(points.status[k])
            if status == STALLED and segment.number < MAX_SEGMENTS:
                stalled.append(segment)
                tangents.append(points.tangent[bounds[k + 1] - 1])
                continue
            note = ENDINGS.get(status, "")
            if status == ENDED:
                family = np.array([segment.family])
                value = self._problem.value(family, segment.orbits.u[-1:])
                note = f"the {'last' if value == self._problem.last[family] else 'first'} value is reached"
            segment.mark("end", note)
        return self._pass_stalls(stalled, np.array(tangents)) if stalled else []

    def _pass_stalls(self, segments: list[Segment], tangent: np.ndarray) -> list[Segment]:
        """Return the segments beyond corners and points where the motion is tangent to the section.

        These points are marked. Segments that cannot be continued get a mark at their end.
        """
        family = np.array([segment.family for segment in segments])
        end = Evaluation.join([segment.orbits.of([-1]) for segment in segments])
        before = Evaluation.join([last_before(segment.orbits) for segment in segments])
        corner = turn_corner(self._problem, family, end, tangent, before)
        place = np.array([len(segment.orbits.u) - 1 for segment in segments])
        passed = BranchBrackets(family, place, before, tangent, corner.evaluation, tangent)
        following: list[Segment] = []
        for k, segment in enumerate(segments):
            lane, orbit = np.arange(len(segments)) == k, end.of([k])
            kinds: list[str] = []
            if (before.signature[k] != corner.evaluation.signature[k]).any():
                kinds = [KINDS[kind[0]] for kind, _ in classify_event_changes(self._problem, passed.of(lane))]
            onward = replace(
                segment,
                step=STEP_AFTER_CORNER,
                number=segment.number + 1,
                departure=None,
                parent=segment,
                reach=REJOIN_DISTANCE,
                points=None,
                marks=[],
            )
            if corner.turned[k]:
                _add_end_marks(segment, kinds, orbit, "")
                onward.u, onward.tangent = corner.evaluation.u[k], corner.tangent[k]
                onward.departure = segment.departure
                following.append(onward)
                continue
            reindexed = reindex_returns(self._problem, segment.family, orbit, tangent[[k]])
            if reindexed is not None:
                now, ahead = reindexed
                _add_end_marks(segment, ["section"], orbit, f"{now.times.shape[1]} returns from here")
                onward.u, onward.tangent = now.u[0], ahead[0]
                following.append(onward)
            elif kinds:
                uncounted = "the motion goes on, its returns are not counted any more"
                _add_end_marks(segment, kinds, orbit, uncounted if kinds[0] == "section" else "the family ends here")
            elif _is_at_departure(orbit, segment.departure):
                segment.mark("end", ENDINGS[STOPPED])
            else:
                segment.mark("end", f"{ENDINGS[STALLED]}; grazing margin {orbit.margin[0]:.1e}")
        return following

    def _doubled_branches(self, segments: list[Segment]) -> list[Segment]:
        """Return the first segments of the doubled branches that begin at period doublings."""
        doubled = []
        for segment in segments:
            for mark in segment.marks:
                if mark.kind != "period-doubling" or 2 * mark.orbit.times.shape[1] > self._cycles:
                    continue
                branch = self._branches[segment.family]
                if branch >= MAX_BRANCHES:
                    continue
                u, tangent = doubled_branch(self._problem, mark.orbit)
                self._branches[segment.family] += 1
                start = (u[0], tangent[0], FIRST_STEP)
                doubled.append(Segment(segment.family, branch, 1, *start, departure=tangent[0], parent=segment))
        return doubled


def _is_at_departure(orbit: Evaluation, departure: np.ndarray | None) -> bool:
    """Return whether a doubled branch has come back to the branch on which it began."""
    return departure is not None and bool(abs(branch_distance(orbit.u, departure[None])[0]) < SAME_POINT)


def last_before(orbits: Evaluation, distance: float = BEFORE_CORNER) -> Evaluation:
    """Return the last orbit farther than the scaled `distance` from the end, or the first orbit if there is none."""
    away = np.flatnonzero(np.abs(orbits.u - orbits.u[-1]).max(axis=1) > distance)
    return orbits.of([away[-1] if len(away) else 0])


def _add_end_marks(segment: Segment, kinds: Sequence[str], end: Evaluation, note: str) -> None:
    """Add special points at a segment's end; an existing special point of the same kind there gets the note instead."""
    for kind in kinds:
        near = [m for m in segment.marks if m.kind == kind and np.abs(m.orbit.u - end.u).max() < SAME_POINT]
        segment.marks = [m for m in segment.marks if not any(m is other for other in near[1:])]
        if near:
            segment.marks = [m._replace(note=note) if m is near[0] else m for m in segment.marks]
        else:
            segment.mark(kind, note)
