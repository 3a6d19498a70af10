"""Segments of branches, removal of branches that were continued twice, and the table of their points."""

from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from vibrojax.analyses.continuation.arclength import CLOSED, MAX_MULTIPLIER, STALLED, STOPPED, TOO_LONG, TOO_UNSTABLE
from vibrojax.analyses.continuation.problem import Points, Problem
from vibrojax.io.variables import orbit_name
from vibrojax.periodic.margin import Measuring, begun, joined
from vibrojax.periodic.newton import multipliers
from vibrojax.sweep.input.definition import Sweep

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


SAME_POINT = 1e-6
"""Scaled distance within which special points of the same kind count as equal."""

POINT_SPACING = 0.02
"""Scaled distance within which points that are not special are omitted."""

STEP_AFTER_CORNER = 1e-3
"""First scaled step length of a segment beyond a corner."""

STEPS_PER_RETURN = 60.0
"""Approximate number of steps between two section crossings; lanes with similar numbers of steps are batched."""

ORBIT_FEATURES = frozenset({"period", "cycles", "impacts", "returns", "settling_time", "trend", "steps"})
"""Features that follow from the orbit itself, or that have no meaning for an orbit."""

Table = dict[str, np.ndarray]


class FamilyPoint(NamedTuple):
    """One orbit of a family; `kind` and `note` are empty unless the orbit is a special point.

    `place`: index of the segment's point at or before a special point; `branch`: number of the branch.
    """

    orbit: Points
    kind: str = ""
    note: str = ""
    place: int = 0
    branch: int = 0


@dataclass
class Segment:
    """A part of a branch without corners and with a constant number of section crossings per period.

    - `family`, `branch`: numbers of family and branch; `number`: number of the segment in its direction.
    - `direction`: 1 or -1, along or against the order in which the branch is listed.
    - `u`, `tangent`, `step`: initial unknowns, tangent and step length.
    - `departure`: tangent at the period doubling, for doubled branches only.
    - `home`: first unknowns and tangent of the branch.
    - `origin`: unknowns at the period doubling at which a branch ends that an impact at the section has interrupted.
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
    origin: np.ndarray | None = None
    reach: float = REJOIN_DISTANCE
    points: Points = field(init=False)
    marks: list[FamilyPoint] = field(init=False, default_factory=list)

    def onward(self, beyond: Points, departure: np.ndarray | None = None) -> "Segment":
        """Return the segment that begins at the point `beyond`, behind the end of this segment."""
        start = beyond.u[0], beyond.tangent[0], STEP_AFTER_CORNER, self.number + 1
        return Segment(self.family, self.branch, self.direction, *start, departure, self.home, self, self.origin)

    def mark(self, kind: str, note: str) -> None:
        """Add a special point at the segment's end; an existing one of the same kind there gets the note instead."""
        end = self.points.of([-1])
        same = [m for m in self.marks if m.kind == kind and np.abs(m.orbit.u - end.u).max() < SAME_POINT]
        if not same:
            self.marks.append(FamilyPoint(end, kind, note, len(self.points.u) - 1))
            return
        kept = [m for m in self.marks if not any(m is other for other in same[1:])]
        self.marks = [m._replace(note=note) if m is same[0] else m for m in kept]


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


def in_order(segments: list[Segment]) -> tuple[list[FamilyPoint], list[FamilyPoint]]:
    """Return the points of all branches, and the special points in the same order.

    Each branch is ordered from one end to the other.
    """
    points: list[FamilyPoint] = []
    special: list[FamilyPoint] = []
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


def _thin_out(segment: Segment) -> tuple[list[FamilyPoint], list[FamilyPoint]]:
    """Return the points of a segment at a distance of about `POINT_SPACING` and at special points; and the latter."""
    points: list[FamilyPoint] = []
    marks = [mark._replace(branch=segment.branch) for mark in segment.marks]
    pending, last = list(marks), len(segment.points.u) - 1
    for k in range(last + 1):
        orbit = segment.points.of([k])
        if k in (0, last) or _distance(points[-1].orbit, orbit) >= POINT_SPACING:
            points.append(FamilyPoint(orbit, branch=segment.branch))
        while pending and pending[0].place <= k:
            mark = pending.pop(0)
            if _distance(points[-1].orbit, mark.orbit) > 0:
                points.append(mark)
    return points, marks


def _distance(first: Points, second: Points) -> float:
    """Return the scaled distance; infinite between orbits with different numbers of section crossings."""
    return float(np.abs(first.u - second.u).max()) if first.u.shape == second.u.shape else np.inf


def columns(problem: Problem, points: list[FamilyPoint]) -> Table:
    """Return the values of points by variable name, each (points,) or (points, states)."""
    rows = problem.rows
    values = multipliers(np.array([point.orbit.product[0] for point in points]).reshape(-1, rows, rows))
    family = np.array([point.orbit.family[0] for point in points], int)
    cycles = np.array([point.orbit.times.shape[1] for point in points], int)
    states = np.array([point.orbit.u[0, :rows] for point in points]).reshape(-1, rows) * problem.scales[family]
    return {
        "family": family,
        problem.along: np.array([point.orbit.u[0, -1] for point in points], float) * problem.unit[family],
        "branch": np.array([point.branch for point in points], int),
        "stable": np.where(np.isfinite(values).all(axis=1), np.abs(values[:, 0]) < 1, -1),
        "period": np.array([point.orbit.times.sum() for point in points], float) / np.maximum(cycles, 1),
        "cycles": cycles,
        "impacts": np.array([point.orbit.impacts[0] for point in points], float),
        "grazing_margin": np.array([point.orbit.margin[0] for point in points], float),
        **dict(zip(map(orbit_name, problem.scene.return_states), states.T, strict=True)),
        "multiplier_abs": np.abs(values),
        "multiplier_arg": np.abs(np.angle(values)),
    }


def measured(sweep: Sweep, problem: Problem, points: list[FamilyPoint], table: Table) -> Table:
    """Return the measured features of the points by name, each (points,); NaN where the measurement failed.

    **Arguments:** `sweep`: sweep with one point for each family, with all parameters except the continuation parameter.
    """
    fixed = {name: x[table["family"]] for name, x in (sweep.points or {}).items()}
    run = replace(sweep.run, orbits=False, keep_returns=0)
    lanes = replace(sweep, points=fixed | {problem.along: table[problem.along]}, run=run)
    parts = []
    for cycles in sorted(set(table["cycles"].tolist())):
        subset = np.array([k for k, p in enumerate(points) if table["cycles"][k] == cycles and p.kind != "hopf"], int)
        u = np.concatenate([points[k].orbit.u for k in subset])
        times = np.concatenate([points[k].orbit.times for k in subset])
        steps = np.full(len(subset), STEPS_PER_RETURN * cycles)
        parts.append(begun(subset, problem.states(table["family"][subset], u), times, steps))
    orbits = joined(parts)
    features, whole = Measuring(lanes)(0, lanes.lanes, orbits)
    measures: Table = {}
    for name, x in features.items():
        if x.ndim == 1 and x.dtype.kind == "f" and name not in ORBIT_FEATURES:
            measures[name] = np.full(len(points), np.nan)
            measures[name][orbits.lanes] = np.where(whole, x, np.nan)
    swings = {swing.amplitude for swing in problem.scene.section.swings} if problem.scene.section else set()
    for name in swings & set(measures):
        measures[name][[point.kind == "hopf" for point in points]] = 0.0
    return measures
