"""Continuation of complete families of periodic orbits.

Every branch is continued in both directions, past its special points. Period-doubled branches are continued as well.
"""

from collections.abc import Sequence

import numpy as np

from vibrojax.analyses.continuation.arclength import ENDED, STALLED, STOPPED, continue_branches
from vibrojax.analyses.continuation.brackets import Brackets
from vibrojax.analyses.continuation.hopf import hopf_point
from vibrojax.analyses.continuation.problem import Flags, Index, Points, Problem, towards
from vibrojax.analyses.continuation.segments import (
    ENDINGS,
    REJOIN_DISTANCE,
    SAME_POINT,
    FamilyPoint,
    Segment,
    drop_duplicates,
)
from vibrojax.analyses.continuation.special_points import (
    GRAZED_MARGIN,
    branch_distance,
    classify_event_changes,
    cross_impact,
    doubled_branch,
    locate_special_points,
    reindex_returns,
    turn_corner,
)
from vibrojax.io.kinds import SPECIAL_KINDS

FIRST_STEP = 0.02
"""First scaled step length of a branch."""

MAX_SEGMENTS = 24
"""Largest number of segments of a branch in one direction. Segments end at corners and where the motion touches the
section."""

MAX_BRANCHES = 32
"""Largest number of branches of a family."""


class FamilyContinuation:
    """Continuation of the families of one problem.

    `cycles`: largest number of section crossings per period of doubled branches.
    """

    def __init__(self, problem: Problem, cycles: int) -> None:
        self._problem, self._cycles = problem, cycles
        self._branches: dict[int, int] = {}

    def __call__(self, family: Index, u: Sequence[np.ndarray]) -> list[Segment]:
        """Return all segments of the families to which orbits belong; `u`: unknowns of one orbit per `family`."""
        self._branches = dict.fromkeys(family.tolist(), 1)
        pending: list[Segment] = []
        for number, orbit in zip(family.tolist(), u, strict=True):
            first = self._problem.evaluate(np.array([number]), orbit[None])
            tangent = first.along(towards(first.u, 1.0)).tangent[0]
            for sign in (1, -1):
                home = (orbit, sign * tangent)
                pending.append(Segment(number, 0, sign, *home, FIRST_STEP, home=home))
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
        size = len(segments[0].u)
        none = np.full(size, np.nan)
        homes = [s.home if s.home is not None and len(s.home[0]) == size else (none, none) for s in segments]
        departure = np.array([none if segment.departure is None else segment.departure for segment in segments])

        def rejoins(lanes: Index, now: Points) -> Flags:
            if size % 2 == 0:  # doubled orbits have an even number of states and one parameter
                return np.zeros(len(lanes), bool)
            with np.errstate(invalid="ignore"):
                return branch_distance(now.u, departure[lanes]) <= 0

        family = np.array([segment.family for segment in segments])
        begin = self._problem.evaluate(family, np.array([segment.u for segment in segments]))
        begin = begin._replace(tangent=np.array([segment.tangent for segment in segments]))
        step = np.array([segment.step for segment in segments])
        branches = continue_branches(self._problem, begin, step, rejoins, home=np.array(homes))
        special = locate_special_points(self._problem, branches)
        bounds = branches.bounds.tolist()
        stalled: list[Segment] = []
        for segment, status, first, end in zip(segments, branches.status.tolist(), bounds, bounds[1:], strict=False):
            last = end - (status == STOPPED)
            segment.points = branches.points.of(slice(first, last))
            if last < end:
                beyond = float(np.abs(branches.points.u[last] - segment.points.u[-1]).max())
                segment.reach = max(segment.reach, beyond)
            inside = (special.place >= first) & (special.place < last - 1)
            if segment.departure is None and segment.origin is not None and len(segment.origin) == size:
                rejoined = inside & (np.abs(special.near.u - segment.origin).max(axis=1) < REJOIN_DISTANCE)
                if rejoined.any():
                    status, last = STOPPED, int(special.place[rejoined].min()) + 1
                    segment.points = branches.points.of(slice(first, last))
                    inside &= special.place < last - 1
            self._add_marks(segment, special.of(inside), first)
            if status == STALLED and segment.number < MAX_SEGMENTS:
                stalled.append(segment)
                continue
            note = ENDINGS.get(status, "")
            if status == ENDED:
                value = self._problem.value(segment.points.family[-1:], segment.points.u[-1:])
                is_last = value == self._problem.last[segment.family]
                note = f"the {'last' if is_last else 'first'} value is reached"
            segment.mark("end", note)
        return (self._pass_stalls(stalled) if stalled else []) + self._doubled_branches(segments)

    def _add_marks(self, segment: Segment, special: Brackets, first: int) -> None:
        """Add special points to the segment whose first point is the branches' point `first`."""
        for k, place in enumerate((special.place - first).tolist()):
            kind, orbit, note, beyond = SPECIAL_KINDS[special.kind[k]], special.near.of([k]), "", special.far.of([k])
            if kind == "grazing" and orbit.impacts[0] == beyond.impacts[0]:
                changed = (orbit.mode_changes[0] != beyond.mode_changes[0]).any(axis=1)
                modes = zip(self._problem.scene.modes, changed, strict=True)
                names = ", ".join(mode.name for mode, differs in modes if differs)
                note = f"no impact: another order of events of {names}"
            segment.marks.append(FamilyPoint(orbit, kind, note, place))
        u = segment.points.u
        segment.marks.sort(key=lambda mark: (mark.place, np.abs(mark.orbit.u[0] - u[mark.place]).max()))

    def _pass_stalls(self, segments: list[Segment]) -> list[Segment]:
        """Return the segments beyond corners and points where the motion is tangent to the section.

        These points are marked. Segments that cannot be continued get a mark at their end.
        """
        turned, corners = turn_corner(self._problem, [segment.points for segment in segments])
        changed = corners.changes_events
        following: list[Segment] = []
        for k, segment in enumerate(segments):
            end, departure = segment.points.of([-1]), segment.departure
            kinds: list[str] = []
            hopf = None if changed[k] else hopf_point(self._problem, segment.points)
            if hopf is not None:
                value = self._problem.value(end.family, end.u)[0]
                note = f"the amplitude is zero; from {value:.9g} on, it is too small for the section"
                segment.marks.append(FamilyPoint(hopf, "hopf", note, len(segment.points.u) - 1))
                continue
            # At a rigid stop no mode changes: only the margin shows that an event begins.
            if changed[k] or end.margin[0] < GRAZED_MARGIN:
                flags = classify_event_changes(self._problem, corners.of([k])).kind
                kinds = [SPECIAL_KINDS[flag] for flag in flags]
            crossed = cross_impact(self._problem, end)
            if crossed is not None:
                segment.mark("section", "an impact passes the time of the section")
                following.append(segment.onward(crossed))
                continue
            beyond, note = (corners.far.of([k]), "") if turned[k] else (reindex_returns(self._problem, end), "")
            if beyond is None and not kinds:
                distance = np.inf if departure is None else abs(branch_distance(end.u, departure[None])[0])
                stalled = f"{ENDINGS[STALLED]}; grazing margin {end.margin[0]:.1e}"
                segment.mark("end", ENDINGS[STOPPED] if distance < SAME_POINT else stalled)
                continue
            if beyond is None:
                uncounted = "the motion goes on, its returns are not counted any more"
                note = uncounted if kinds[0] == "section" else "the family ends here"
            elif not turned[k]:
                kinds, departure, note = ["section"], None, f"{beyond.times.shape[1]} returns from here"
            for kind in kinds:
                segment.mark(kind, note)
            if beyond is not None:
                following.append(segment.onward(beyond, departure))
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
                own = Segment(segment.family, branch, 1, *start, departure=tangent[0], parent=segment, origin=u[0])
                doubled.append(own)
        return doubled
