"""Continuation of complete families of periodic orbits.

Every branch is continued in both directions, past its special points. Period-doubled branches are continued as well.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.arclength import ENDED, STALLED, STOPPED, VANISHED, Stop
from vibrojax.periodic.brackets import LOCATED_WITHIN, Brackets
from vibrojax.periodic.branch_points import DOUBLING, SAME_HALVES, FamilyLocator, branch_point_ahead, second_tangent
from vibrojax.periodic.grazes import GRAZED_MARGIN, graze_beside
from vibrojax.periodic.hopf import hopf_point
from vibrojax.periodic.joined_branches import drop_duplicates, end_where_joined, invariants, is_among
from vibrojax.periodic.location import (
    classify_event_changes,
    cross_impact,
    multipliers_jump,
    reindex_returns,
    turn_corner,
)
from vibrojax.periodic.newton import spectral_radius
from vibrojax.periodic.problem import Flags, Index, Points, Problem, towards
from vibrojax.periodic.segments import ENDINGS, REJOIN_DISTANCE, SAME_POINT, Mark, Segment, Tracing
from vibrojax.scenes import Scene

POINT_SPACING = 0.02
"""Scaled distance within which points that are not special are omitted."""

MAX_SEGMENTS = 24
"""Largest number of segments of a branch in one direction. Segments end at corners and where the motion touches the
section."""

MAX_BRANCHES = 32
"""Largest number of branches of a family."""

NEAR_HOPF = 1e-6
"""Scaled distance of the parameter from a Hopf point within which rounding errors decide whether it turns."""

STEEP_GRAZE = 1e3
"""Modulus of a multiplier from which on a graze counts as reached from the side of the impacts."""

ENDS_AT_SHORTER = "the branch ends at the orbit of half its period"
"""Note on a period doubling that a branch reaches from the side of the doubled orbit."""

ENDS_HERE, NOT_FOUND = "the family ends here", "no orbit is found behind it"
"""Notes on ends at a change of events: where the map may jump, and where it is continuous, so that orbits go on."""

EXCHANGED = "no impact: two events exchange their order, and multipliers jump"
NO_GRAZE = "the order of events changes, none grazes: two happen at one instant, or one at that of the section"
"""Notes where no event begins or vanishes: within a branch, and at its end."""


class FamilyContinuation(Tracing):
    """Continuation of the families of one problem.

    `cycles`: largest number of section crossings per period of doubled branches.
    """

    locator: type[FamilyLocator] = FamilyLocator

    def __init__(self, problem: Problem, cycles: int) -> None:
        super().__init__(problem, self.locator(problem))
        self._cycles = cycles
        self._branches: dict[int, int] = {}
        self._crossings: dict[int, list[np.ndarray]] = {}

    def __call__(self, family: Index, u: Sequence[np.ndarray]) -> list[Segment]:
        """Return all segments of the families to which orbits belong; `u`: unknowns of one orbit per `family`."""
        self._branches = dict.fromkeys(family.tolist(), 1)
        segments: list[Segment] = []
        for number, orbit in zip(family.tolist(), u, strict=True):
            first = self._problem.evaluate(np.array([number]), orbit[None])
            first = first.along(towards(first.u, 1.0))
            for sign in (1, -1):
                begin = first._replace(tangent=sign * first.tangent)
                segments.append(Segment(number, 0, sign, begin, home=begin))
        segments = self.trace(segments)
        for branch in {(segment.family, segment.branch) for segment in segments}:
            own = [segment for segment in segments if (segment.family, segment.branch) == branch]
            _refine_grazes(self._problem, own)
        if self._problem.at_section:
            end_where_joined(segments, self._problem)
        return drop_duplicates(segments, self._problem)

    def stop(self, segments: list[Segment]) -> Stop:
        """Return the condition that a doubled branch is back at one that it left: the halves of its orbits exchange."""
        doubled = np.array([segment.doubled for segment in segments])
        halves = self._problem.halves(Points.join([segment.begin for segment in segments]))
        farthest = np.linalg.norm(halves, axis=1)

        def rejoins(lanes: Index, now: Points) -> Flags:
            own = self._problem.halves(now)
            distance, turned = np.linalg.norm(own, axis=1), np.einsum("ij,ij->i", own, halves[lanes]) < 0
            farthest[lanes] = np.fmax(farthest[lanes], distance)
            halves[lanes] = own
            # On the original branch, rounding errors decide the sign.
            near = distance <= np.minimum(SAME_POINT, REJOIN_DISTANCE * farthest[lanes])
            return np.asarray(doubled[lanes] & (turned | near))

        return rejoins

    def finish(self, segments: list[Segment]) -> list[Segment]:
        """Enter special points and ends of segments; return the segments beyond stalls, and doubled branches."""
        stalled: list[Segment] = []
        following: list[Segment] = []
        for segment in segments:
            jumps = segment.special.ends
            if jumps.any():
                self._end_at_jump(segment, int(segment.special.place[jumps].min()))
                continue
            ahead = branch_point_ahead(self._problem, segment.points) if segment.origin is None else None
            if ahead is not None:
                following += self._pass_branch_point(segment, *ahead)
                continue
            hopf = self.hopf(segment) if segment.status == VANISHED else None
            status, special, reached = segment.status, segment.special, segment.points
            note = ENDINGS.get(status, "")
            if status == STOPPED:
                note, segment.points = self.stop_note(segment), reached.of(slice(0, -1))
                beyond = float(np.abs(reached.u[-1] - segment.points.u[-1]).max())
                segment.reach = max(segment.reach, beyond)
            inside = special.place < len(segment.points.u) - 1
            if not segment.doubled and segment.origin is not None and len(segment.origin) == reached.u.shape[1]:
                rejoined = inside & (np.abs(special.near.u - segment.origin).max(axis=1) < REJOIN_DISTANCE)
                if rejoined.any():
                    last = int(special.place[rejoined].min()) + 1
                    status, note, segment.points = STOPPED, ENDINGS[STOPPED], segment.points.of(slice(0, last))
                    inside &= special.place < last - 1
            repeats = inside & (special.kind == DOUBLING) & self._repeats(special.near)
            if not segment.doubled and repeats.any():
                self._end_at_shorter(segment, special.of(inside), special.of(repeats))
                continue
            self._add_marks(segment, special.of(inside & ~repeats))
            if status == STALLED and segment.number < MAX_SEGMENTS:
                stalled.append(segment)
                continue
            if hopf is not None:
                _end_at_hopf(segment, hopf, "the amplitude is zero")
                continue
            if status == ENDED:
                value = self._problem.values(segment.points.family[-1:], segment.points.u[-1:])[0, 0]
                low, high = (bound[segment.family, 0] for bound in (self._problem.first, self._problem.last))
                is_last = bool(abs(value - high) < abs(value - low))
                usual = f"the {'last' if is_last else 'first'} value is reached"
                note = self._problem.refused.get((segment.family, is_last), usual)
            segment.mark("end", note)
        following += self._pass_stalls(stalled) if stalled else []
        return following + self._doubled_branches(segments) + self._crossing_branches(segments)

    def _repeats(self, orbits: Points) -> Flags:
        """Return a mask of the orbits that go round twice."""
        own, half = (np.linalg.norm(x, axis=1) for x in (orbits.u, self._problem.halves(orbits)))
        size = own if self._problem.at_section else np.minimum(own, orbits.swing)  # small next to a Hopf point
        return np.asarray(half < SAME_HALVES * size)

    def _pass_branch_point(self, segment: Segment, before: Points, crossing: Points) -> list[Segment]:
        """End a segment at a branch point where its steps became short; return the segment behind it."""
        place = len(before.u) - 1
        special = segment.special.of(segment.special.place < place)
        here = Brackets(np.array([DOUBLING]), np.array([place]), crossing, crossing, np.zeros(1, bool))
        if self._repeats(crossing)[0]:
            self._end_at_shorter(segment, Brackets.join([special, here]), here)
            return []
        segment.points = Points.join([before, crossing])
        self._add_marks(segment, special)
        segment.mark("branch-point", "")
        onward = segment.onward(crossing)
        onward.crossing = invariants(self._problem, crossing)
        return [onward]

    def _end_at_jump(self, segment: Segment, place: int) -> None:
        """End a segment at a change of events behind which its orbits do not go on, after the point `place`."""
        special = segment.special
        jump = special.of(special.ends & (special.place == place))
        segment.points = Points.join([segment.points.of(slice(0, place + 1)), jump.near.of([0])])
        self._add_marks(segment, special.of(~special.ends & (special.place < place)))
        for kind in jump.kind:
            event, _ = change_of(self._problem.scene, SPECIAL_KINDS[kind], jump.near.of([0]), jump.far.of([0]))
            segment.mark(SPECIAL_KINDS[kind], ENDS_HERE, event)

    def _end_at_shorter(self, segment: Segment, special: Brackets, doubles: Brackets) -> None:
        """End a segment where the orbit of half its period doubles: behind it, only the halves are exchanged."""
        first = int(doubles.place.argmin())
        place = int(doubles.place[first])
        segment.points = segment.points.of(slice(0, place + 1))
        self._add_marks(segment, special.of(special.place < place))
        orbit = self._problem.halved(doubles.near.of([first]))
        segment.marks.append(Mark(orbit, "period-doubling", ENDS_AT_SHORTER, place))

    def hopf(self, segment: Segment) -> Points | None:
        """Return the Hopf point to which the end of a segment leads, or None."""
        return hopf_point(self._problem, segment.points)

    def stop_note(self, segment: Segment) -> str:
        """Return why a segment ends at its last point, at which the condition of `stop` holds."""
        return ENDINGS[STOPPED]

    def _add_marks(self, segment: Segment, special: Brackets) -> None:
        """Add special points to a segment, without the branch point at which it begins: the parameter may turn."""
        here = np.abs(special.near.u[:, -1] - segment.begin.u[0, -1]) < SAME_POINT
        special = special.of(~((segment.crossing is not None) & here & (special.place == 0)))
        for k, place in enumerate(special.place.tolist()):
            kind, orbit, beyond = SPECIAL_KINDS[special.kind[k]], special.near.of([k]), special.far.of([k])
            event, note = change_of(self._problem.scene, kind, orbit, beyond)
            # Next to a change, rounding errors may decide on a third order of events.
            known = [m.orbit.u - orbit.u for m in segment.marks if (m.kind, m.event) == (kind, event)]
            if any(np.abs(off).max() < 10 * LOCATED_WITHIN for off in known):
                continue
            segment.marks.append(Mark(orbit, kind, note, place, event=event))
        u = segment.points.u
        segment.marks.sort(key=lambda mark: (mark.place, np.abs(mark.orbit.u[0] - u[mark.place]).max()))

    def _pass_stalls(self, segments: list[Segment]) -> list[Segment]:
        """Return the segments beyond corners and points where the motion is tangent to the section.

        These points are marked. Segments that cannot be continued get a mark at their end.
        """
        problem, following = self._problem, []
        turned, corners = turn_corner(problem, [segment.points for segment in segments])
        exchanged = multipliers_jump(corners.near, corners.far) if problem.at_section else np.zeros(len(segments), bool)
        changed = corners.changes_events
        for k, segment in enumerate(segments):
            end, doubled = segment.points.of([-1]), segment.doubled
            kinds: list[str] = []
            hopf = self.hopf(segment) if problem.at_section and not changed[k] else None
            if hopf is not None:
                value = problem.values(end.family, end.u)[0, 0]
                _end_at_hopf(
                    segment, hopf, f"the amplitude is zero; from {value:.9g} on, it is too small for the section"
                )
                continue
            # At a rigid stop no mode changes: only the margin shows that an event begins.
            touches = end.margin[0] < GRAZED_MARGIN
            if touches or changed[k]:
                flags = classify_event_changes(problem, corners.of([k])).kind
                kinds = [SPECIAL_KINDS[flag] for flag in flags]
                if kinds == ["grazing"] and problem.at_section and not (touches or turned[k]):
                    kinds = []
            elif turned[k]:
                kinds = ["grazing"]
            crossed = cross_impact(problem, end) if problem.at_section else None
            if crossed is not None:
                if crossed.tangent[0, -1] * end.tangent[0, -1] < 0:
                    segment.mark("fold", "")
                segment.mark("section", "an impact passes the time of the section")
                following.append(segment.onward(crossed))
                continue
            beyond, note = corners.far.of([k]) if turned[k] else None, ""
            if beyond is None and problem.at_section:
                beyond = reindex_returns(problem, end)
            if beyond is None and not kinds:
                joined = doubled and np.linalg.norm(problem.halves(end)) < SAME_POINT
                stalled = f"no {problem.noun} is found any further"
                stalled += f"; grazing margin {end.margin[0]:.1e}" * problem.at_section
                stalled = NO_GRAZE if changed[k] or exchanged[k] else stalled
                segment.mark("end", ENDINGS[STOPPED] if joined else stalled)
                continue
            if beyond is None:
                uncounted = "the motion goes on, its returns are not counted any more"
                ends = ENDS_HERE if problem.scene.may_jump else NOT_FOUND
                note = uncounted if kinds[0] == "section" else ends
            elif not turned[k]:
                kinds, doubled, note = ["section"], False, f"{beyond.times.shape[1]} returns from here"
            for kind in kinds:
                event, change = change_of(problem.scene, kind, corners.near.of([k]), corners.far.of([k]))
                segment.mark(kind, note or (change if exchanged[k] or not problem.at_section else ""), event)
            if beyond is not None:
                following.append(segment.onward(beyond, doubled))
        return following

    def _doubled_branches(self, segments: list[Segment]) -> list[Segment]:
        """Return the first segments of the doubled branches that begin at period doublings."""
        doubled = []
        for segment in segments:
            for mark in segment.marks:
                again = mark.note == ENDS_AT_SHORTER  # that branch is the one which ends here
                if mark.kind != "period-doubling" or again or 2 * mark.orbit.times.shape[1] > self._cycles:
                    continue
                branch = self._branches[segment.family]
                if branch >= MAX_BRANCHES:
                    continue
                u, tangent = self._problem.doubled(mark.orbit)
                begin = self._problem.evaluate(mark.orbit.family, u)._replace(tangent=tangent)
                self._branches[segment.family] += 1
                more: dict[str, Any] = {"parent": segment, "doubled": True, "origin": u[0]}
                doubled.append(Segment(segment.family, branch, 1, begin, **more))
        return doubled

    def _crossing_branches(self, segments: list[Segment]) -> list[Segment]:
        """Return the first segments, in both directions, of the branches that cross at branch points."""
        crossing = []
        for segment in segments:
            for mark in segment.marks:
                if mark.kind != "branch-point" or self._branches[segment.family] >= MAX_BRANCHES:
                    continue
                known, here = self._crossings.setdefault(segment.family, []), invariants(self._problem, mark.orbit)
                tangent = None if is_among(here, known) else second_tangent(self._problem, mark.orbit)
                if tangent is None:
                    continue
                known.append(here)
                branch = self._branches[segment.family]
                self._branches[segment.family] += 1
                for sign in (1, -1):
                    begin = mark.orbit._replace(tangent=sign * tangent)
                    more: dict[str, Any] = {"parent": segment, "crossing": here}
                    if self._problem.closes:
                        more["home"] = begin
                    crossing.append(Segment(segment.family, branch, sign, begin, **more))
        return crossing


def _refine_grazes(problem: Problem, segments: list[Segment]) -> None:
    """Move grazes of one branch that were reached from the side with more events onto the end of the other side.

    Other changes of events up to the limit are the same graze: shortly before it, its events are too close together to
    be distinguished. If a mass grazes against friction, the last event that can be distinguished may be a stick.
    """
    for segment in segments:
        for mark in [mark for mark in segment.marks if mark.kind in ("grazing", "stick") and not mark.event]:
            if spectral_radius(mark.orbit.product)[0] < STEEP_GRAZE or all(m is not mark for m in segment.marks):
                continue
            graze = graze_beside(problem, mark.orbit)
            if graze is None:
                continue
            reach = SAME_POINT + abs(graze.u - mark.orbit.u)[0, -1]
            for each in segments:
                each.marks = [m for m in each.marks if m is mark or not _is_graze(m, graze.u, reach)]
            place = next(k for k, m in enumerate(segment.marks) if m is mark)
            kind = "grazing" if graze.impacts[0] != mark.orbit.impacts[0] else mark.kind
            orbit = mark.orbit._replace(u=graze.u, margin=np.zeros(1))
            segment.marks[place] = mark._replace(kind=kind, orbit=orbit)


def _is_graze(mark: Mark, graze: np.ndarray, reach: float) -> bool:
    """Return whether a special point is a graze with these unknowns, up to `reach` in the parameter."""
    if mark.kind not in ("grazing", "stick") or mark.orbit.u.shape != graze.shape:
        return False
    off = np.abs(mark.orbit.u - graze)[0]
    return bool(off[-1] <= reach and off.max() < POINT_SPACING)


def _end_at_hopf(segment: Segment, hopf: Points, note: str) -> None:
    """Add the Hopf point to which the end of a segment leads; next to it, rounding errors decide about folds."""
    away = [m for m in segment.marks if m.kind != "fold" or np.abs(m.orbit.u[0, -1] - hopf.u[0, -1]) >= NEAR_HOPF]
    segment.marks = [*away, Mark(hopf, "hopf", note, len(segment.points.u) - 1)]


def change_of(scene: Scene[Any], kind: str, near: Points, far: Points) -> tuple[str, str]:
    """Return the name of the system's event that changes at a special point, or "", and a note about it.

    Impacts and sticks of friction have kinds of their own; other events are named, such as a switch at which nothing
    sticks.
    """
    if kind not in ("grazing", "stick") or (kind == "grazing" and near.impacts[0] != far.impacts[0]):
        return "", ""
    changed = (near.mode_changes[0] != far.mode_changes[0]).any(axis=1)
    names = [mode.name for mode, differs in zip(scene.modes, changed, strict=False) if differs]
    event = next((name for name in names if name in scene.named_events), "")
    if kind != "grazing" or event:
        return event, ""
    return "", f"no impact: another order of events of {', '.join(names)}" if names else EXCHANGED


def in_order(segments: list[Segment]) -> tuple[list[Mark], list[Mark]]:
    """Return the points of all branches, and the special points in the same order.

    Each branch is ordered from one end to the other.
    """
    points: list[Mark] = []
    special: list[Mark] = []
    before: tuple[int, int] | None = None
    for segment in sorted(segments, key=lambda s: (s.family, s.branch, s.direction * (s.number + 1))):
        along, marks = _thin_out(segment)
        if segment.direction < 0:
            along, marks = along[::-1], marks[::-1]
        # The two segments that meet at the first point of the branch both contain it.
        if before == (segment.family, segment.branch) and _distance(points[-1].orbit, along[0].orbit) < 1e-12:
            along = along[1:]
        before = segment.family, segment.branch
        points += along
        special += marks
    return points, special


def _thin_out(segment: Segment) -> tuple[list[Mark], list[Mark]]:
    """Return the points of a segment at a distance of about `POINT_SPACING` and at special points; and the latter.

    Between two special points, however near, there is one of the computed points, which shows the stability there.
    """
    points: list[Mark] = []
    marks = [mark._replace(branch=segment.branch) for mark in segment.marks]
    first, last = 0, len(segment.points.u) - 1
    for mark in (*marks, None):
        end, before = last if mark is None else mark.place, len(points)
        computed = [Mark(segment.points.of([k]), branch=segment.branch) for k in range(first, end + 1)]
        for k, point in enumerate(computed, first):
            if k in (0, last) or _distance(points[-1].orbit, point.orbit) >= POINT_SPACING:
                points.append(point)
        first += len(computed)
        if mark is None:
            break
        if len(points) == before:
            off = [min(_distance(x.orbit, point.orbit) for x in (points[-1], mark)) for point in computed]
            points += [computed[int(np.argmax(off))]] if max(off, default=0.0) > 0 else []
        if _distance(points[-1].orbit, mark.orbit) > 0:
            points.append(mark)
    return points, marks


def _distance(first: Points, second: Points) -> float:
    """Return the scaled distance; infinite between orbits with different numbers of section crossings."""
    return float(np.abs(first.u - second.u).max()) if first.u.shape == second.u.shape else np.inf
