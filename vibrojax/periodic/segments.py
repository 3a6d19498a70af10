"""Segments of branches and curves, and the continuation of segments to their ends and beyond.

A segment has no corners and a constant number of section crossings per period. Segments with equal numbers of unknowns
are continued together.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vibrojax.periodic.arclength import (
    CLOSED,
    LONGEST_STEP,
    STALLED,
    STOPPED,
    TOO_LONG,
    TOO_UNSTABLE,
    VANISHED,
    Stop,
    continue_branches,
)
from vibrojax.periodic.brackets import Brackets
from vibrojax.periodic.location import Locator
from vibrojax.periodic.problem import MAX_MULTIPLIER, Points, Problem

REJOIN_DISTANCE = 1e-3
"""Smallest value of `Segment.reach`: scaled distance within which a branch counts as joined to another branch."""

ENDINGS = {
    CLOSED: "back where it began",
    TOO_LONG: "more points than are followed",
    STALLED: "no orbit is found any further",
    STOPPED: "joins the branch that it left",
    VANISHED: "the amplitude shrinks to zero",
    TOO_UNSTABLE: f"a multiplier over {MAX_MULTIPLIER:g} is not followed",
}
"""Notes on the ends of branches, by status."""

SAME_POINT = 1e-6
"""Scaled distance within which special points of the same kind count as equal."""

FIRST_STEP = 0.02
"""First scaled step length of a branch or curve."""

STEP_AFTER_CORNER = 1e-3
"""First scaled step length of a segment beyond a corner."""


class Mark(NamedTuple):
    """One orbit of a branch or curve; `kind` and `note` are empty unless it is a special point.

    `place`: index of the segment's point at or before a special point; `branch`: number of the branch; `event`: name of
    the system's event that begins or vanishes, if that is neither an impact nor a stick.
    """

    orbit: Points
    kind: str = ""
    note: str = ""
    place: int = 0
    branch: int = 0
    event: str = ""


@dataclass(eq=False)
class Segment:
    """A part of a branch or curve without corners and with a constant number of section crossings per period.

    - `family`, `branch`: numbers of family and branch, or number of the curve and 0.
    - `direction`: 1 or -1, along or against the order in which the branch is listed.
    - `begin`, `step`: first point with its tangent, and first step length.
    - `number`: number of the segment in its direction.
    - `home`: first point of the branch, at which it may close; None if it cannot.
    - `parent`: the segment that this segment continues, or on which its doubled branch begins.
    - `doubled`: True for doubled branches, until an impact at the section interrupts them.
    - `origin`: unknowns at the period doubling at which a branch ends that an impact at the section has interrupted.
    - `reach`: largest scaled distance between the segment's end and the branch that it joins.
    - `crossing`: numbers that identify the branch point at which the segment begins; None elsewhere.
    - `status`, `points`, `special`: results, that is the final status of the continuation, the accepted points, and
      the special points between them. `marks`: the special points with their kinds.
    """

    family: int
    branch: int
    direction: int
    begin: Points
    step: float = FIRST_STEP
    number: int = 0
    home: Points | None = None
    parent: "Segment | None" = None
    doubled: bool = False
    origin: np.ndarray | None = None
    reach: float = REJOIN_DISTANCE
    crossing: np.ndarray | None = None
    status: int = field(init=False)
    points: Points = field(init=False)
    special: Brackets = field(init=False)
    marks: list[Mark] = field(init=False, default_factory=list)
    note: str = ""

    def onward(self, beyond: Points, doubled: bool = False) -> "Segment":
        """Return the segment that begins at the point `beyond`, behind the end of this segment."""
        begin = self.family, self.branch, self.direction, beyond, STEP_AFTER_CORNER, self.number + 1
        return Segment(*begin, self.home, self, doubled, self.origin)

    def drop(self, kind: str, at: Points, but: str) -> None:
        """Remove special points of a kind at an orbit, except those with the note `but`."""

        def same(m: Mark) -> bool:
            return m.kind == kind and m.orbit.u.shape == at.u.shape and np.abs(m.orbit.u - at.u).max() < SAME_POINT

        self.marks = [m for m in self.marks if m.note == but or not same(m)]

    def mark(self, kind: str, note: str, event: str = "") -> None:
        """Add a special point at the segment's end; an existing one of the same kind there gets the note instead."""
        end = self.points.of([-1])
        same = [m for m in self.marks if m.kind == kind and np.abs(m.orbit.u - end.u).max() < SAME_POINT]
        if not same:
            self.marks.append(Mark(end, kind, note, len(self.points.u) - 1, event=event))
            return
        kept = [m for m in self.marks if not any(m is other for other in same[1:])]
        self.marks = [m._replace(note=note) if m is same[0] else m for m in kept]


class Tracing(ABC):
    """Continuation of the segments of one problem; `longest`: largest scaled step length."""

    longest = LONGEST_STEP

    def __init__(self, problem: Problem, locator: Locator) -> None:
        self._problem, self._locator = problem, locator

    @abstractmethod
    def stop(self, segments: list[Segment]) -> Stop:
        """Return the condition at which segments end, in addition to those of all continuations."""

    @abstractmethod
    def finish(self, segments: list[Segment]) -> list[Segment]:
        """Enter marks and notes of continued segments; return the segments that follow."""

    def trace(self, segments: list[Segment], report: Callable[[int], None] = lambda remaining: None) -> list[Segment]:
        """Continue segments and all that follow; return them, in the order of continuation.

        `report` is called with the number of segments that remain.
        """
        done: list[Segment] = []
        while segments:
            report(len(segments))
            following: list[Segment] = []
            for size in sorted({segment.begin.u.shape[1] for segment in segments}):
                group = [segment for segment in segments if segment.begin.u.shape[1] == size]
                self._continue(group)
                following += self.finish(group)
                done += group
            segments = following
        return done

    def _continue(self, segments: list[Segment]) -> None:
        """Continue segments with equal numbers of unknowns to their ends."""
        begin = Points.join([segment.begin for segment in segments])
        home = np.full((len(segments), 2, begin.u.shape[1]), np.nan)
        for k, segment in enumerate(segments):
            if segment.home is not None and segment.home.u.shape == segment.begin.u.shape:
                home[k] = segment.home.u[0], segment.home.tangent[0]
        step = np.array([segment.step for segment in segments])
        branches = continue_branches(self._problem, begin, step, self.stop(segments), home, self.longest)
        special, bounds = self._locator(branches), branches.bounds.tolist()
        for k, segment in enumerate(segments):
            first, end = bounds[k], bounds[k + 1]
            own = special.of((special.place >= first) & (special.place < end))
            segment.status, segment.points = int(branches.status[k]), branches.points.of(slice(first, end))
            segment.special = own._replace(place=own.place - first)
