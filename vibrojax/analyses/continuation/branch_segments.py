"""Segments of branches, and removal of branches that were continued twice."""

from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from vibrojax.analyses.continuation.arclength import CLOSED, MAX_MULTIPLIER, STALLED, STOPPED, TOO_LONG, TOO_UNSTABLE
from vibrojax.analyses.continuation.problem import Evaluation

REJOIN_DISTANCE = 1e-3
"""Smallest value of `Segment.reach`: scaled distance within which a branch counts as joined to another branch."""

ENDINGS = {
    CLOSED: "back where it began",
    TOO_LONG: "more points than are followed",
    STALLED: "no orbit is found any further",
    STOPPED: "joins the branch that it left",
    TOO_UNSTABLE: f"a multiplier over {MAX_MULTIPLIER:g} is not followed",
}
"""Notes on the ends of branches, by status."""


class SegmentMark(NamedTuple):
    """A special point of a segment: kind, orbit, index `place` of the segment's point before it, and note."""

    kind: str
    orbit: Evaluation
    place: int
    note: str = ""


@dataclass
class Segment:
    """A part of a branch without corners and with a constant number of section crossings per period.

    - `family`, `branch`: numbers of family and branch; `number`: number of the segment in its direction.
    - `direction`: 1 or -1, along or against the order in which the branch is listed.
    - `u`, `tangent`, `step`: initial unknowns, tangent and step length.
    - `departure`: tangent at the period doubling, for doubled branches only.
    - `home`: first unknowns and tangent of the branch.
    - `parent`: the segment that this segment continues, or on which its doubled branch begins.
    - `reach`: largest scaled distance between the segment's end and the branch that it joins.
    - `points`, `marks`: results, that is the accepted points and the special points.
    """

    family: int
    branch: int
    direction: int
    u: np.ndarray
    tangent: np.ndarray
    step: float
    number: int = 0
    departure: np.ndarray | None = None
    home: tuple[np.ndarray, np.ndarray] | None = None
    parent: "Segment | None" = None
    reach: float = REJOIN_DISTANCE
    points: Evaluation | None = None
    marks: list[SegmentMark] = field(default_factory=list)

    @property
    def orbits(self) -> Evaluation:
        """Points of the segment, available after its continuation."""
        assert self.points is not None
        return self.points

    def mark(self, kind: str, note: str) -> None:
        """Add a special point at the segment's end."""
        self.marks.append(SegmentMark(kind, self.orbits.of([-1]), len(self.orbits.u) - 1, note))


def drop_duplicates(segments: list[Segment], rows: int) -> list[Segment]:
    """Remove branches that were continued twice, and renumber the others.

    A closed branch was continued in both directions. A branch that connects two period doublings was continued from
    both of them.
    """
    closed = {s.family for s in segments if s.branch == 0 and any(m.note == ENDINGS[CLOSED] for m in s.marks)}
    again = _from_other_ends(segments, rows)

    def is_dropped(segment: Segment | None) -> bool:
        while segment is not None:
            if segment.branch == 0 and segment.direction < 0 and segment.family in closed:
                return True
            if (segment.family, segment.branch) in again:
                return True
            segment = segment.parent
        return False

    kept = [segment for segment in segments if not is_dropped(segment)]
    numbers: dict[tuple[int, int], int] = {}
    for segment in kept:
        in_family = sum(family == segment.family for family, _ in numbers)
        segment.branch = numbers.setdefault((segment.family, segment.branch), in_family)
    return kept


def _from_other_ends(segments: list[Segment], rows: int) -> set[tuple[int, int]]:
    """Return the doubled branches, as (family, branch), that retrace another branch in the opposite direction."""
    begins = {(s.family, s.branch): s.u for s in segments if s.departure is not None and s.number == 0}
    ends = {
        (segment.family, segment.branch): (mark.orbit.u[0], segment.reach)
        for segment in segments
        for mark in segment.marks
        if mark.note == ENDINGS[STOPPED]
    }

    def meet(first: tuple[int, int], second: tuple[int, int]) -> bool:
        """Return whether `first` begins at the end of `second`, up to a cyclic shift of the section crossings."""
        begin, (end, reach) = begins[first], ends[second]
        if len(begin) != len(end):
            return False
        shifts = range(0, len(begin) - 1, rows)
        shifted = (np.append(np.roll(begin[:-1], shift), begin[-1]) for shift in shifts)
        return any(np.abs(states - end).max() <= reach for states in shifted)

    again: set[tuple[int, int]] = set()
    for first, second in combinations(sorted(ends), 2):
        if first[0] == second[0] and first not in again and meet(first, second) and meet(second, first):
            again.add(second)
    return again
