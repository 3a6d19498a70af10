"""Branches of a family that meet: ends move to the points at which branches join, and branches found twice are dropped.

A branch may close, join the one that it left, connect two period doublings, or cross another one at a branch point.
"""

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from vibrojax.periodic.arclength import CLOSED, STOPPED
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import Points, Problem
from vibrojax.periodic.segments import ENDINGS, Segment

SAME_CROSSING = 1e-4
"""Largest difference of the scaled parameter, the logarithm of the period, the amplitude and the multipliers between
two descriptions of one branch point."""

FREE_PHASE_REACH = 0.05
"""Scaled distance in the parameter and the period within which a branch without a section joins another one."""

JOINS = ENDINGS[STOPPED]

Branch = tuple[int, int]
"""Numbers of a family and of one of its branches."""


def invariants(problem: Problem, orbit: Points) -> np.ndarray:
    """Return numbers that tell one orbit of a family from others, whatever its phase."""
    values = np.sort_complex(multipliers(orbit.product)[0])
    # Mirror images have equal multipliers. Where another branch crosses, states are less accurate than the parameter.
    centre = orbit.u[0, : -len(problem.along)].reshape(-1, problem.rows).mean(axis=0) / 10 if problem.closes else []
    return np.concatenate([orbit.u[0, -1:], np.log(orbit.period), orbit.swing, values.real, values.imag, centre])


def is_among(mine: np.ndarray, others: Iterable[np.ndarray]) -> bool:
    """Return whether `invariants` are those of one of the other orbits."""
    return any(np.abs(mine - other).max() < SAME_CROSSING for other in others)


def end_where_joined(segments: list[Segment], problem: Problem) -> None:
    """Move the ends of doubled branches to the period doublings, or else grazes, at which they join another branch.

    The last step of a doubled branch passes the doubling by a distance that depends on rounding errors.
    """
    for segment in segments:
        if all(mark.note != JOINS for mark in segment.marks):
            continue
        last, marks = segment.points.of([-1]), [m for s in segments if s.family == segment.family for m in s.marks]
        for kind, name in (("period-doubling", "end"), ("grazing", "grazing")):
            own = [m.orbit.u[0] for m in marks if m.kind == kind and 2 * m.orbit.u.shape[1] - 1 == last.u.shape[1]]
            shifted = (x for u in own for x in _shifts(np.concatenate([u[:-1], u]), problem.rows))
            nearest = min(shifted, key=lambda u: float(np.abs(u - last.u).max()), default=last.u[0] + np.inf)
            if np.abs(nearest - last.u).max() <= segment.reach:
                end = problem.evaluate(last.family, nearest[None])._replace(tangent=last.tangent)
                segment.points = Points.join([segment.points, end])
                segment.marks = [mark for mark in segment.marks if mark.note != JOINS]
                for own_part in (s for s in segments if _branch(s) == _branch(segment) and s is not segment):
                    own_part.drop(name, end, but=JOINS)
                segment.mark(name, JOINS)
                break


def drop_duplicates(segments: list[Segment], problem: Problem) -> list[Segment]:
    """Remove branches that were continued twice, and those that begin on them, and renumber the others.

    A closed branch was continued in both directions. A branch that connects two period doublings was continued from
    both of them. A branch may lead to a branch point at which another one was begun.
    """
    ways = [(_branch(s), s.direction) for s in segments if any(m.note == ENDINGS[CLOSED] for m in s.marks)]
    closed = dict(sorted(ways))  # if both ways are closed, the second one counts
    again = _from_other_ends(segments, problem.rows)

    def is_crossed(segment: Segment) -> bool:
        """Return whether an earlier branch, which is not the one that it left, leads through its first point."""
        if segment.crossing is None or segment.parent is None:
            return False
        others = [s for s in segments if s.family == segment.family and s.branch < segment.branch]
        others = [s for s in others if s.branch != segment.parent.branch and not is_dropped(s)]
        points = (m.orbit for s in others for m in s.marks if m.kind == "branch-point")
        return is_among(segment.crossing, (invariants(problem, orbit) for orbit in points))

    def is_dropped(segment: Segment) -> bool:
        branch = _branch(segment)
        if branch in again or segment.direction != closed.get(branch, segment.direction) or is_crossed(segment):
            return True
        return segment.parent is not None and is_dropped(segment.parent)

    kept = [segment for segment in segments if not is_dropped(segment)]
    numbers: dict[Branch, int] = {}
    for segment in kept:
        in_family = sum(family == segment.family for family, _ in numbers)
        segment.branch = numbers.setdefault(_branch(segment), in_family)
    return kept


def _from_other_ends(segments: list[Segment], rows: int) -> set[Branch]:
    """Return the doubled branches that retrace another branch in the opposite direction."""
    begins = {_branch(s): s.begin.u[0] for s in segments if s.doubled and s.number == 0}
    ends = {_branch(s): (m.orbit.u[0], s.reach) for s in segments for m in s.marks if m.note == JOINS}

    def meet(first: Branch, second: Branch) -> bool:
        """Return whether `first` begins at the end of `second`, up to a cyclic shift of the section crossings."""
        begin, (end, reach) = begins[first], ends[second]
        if len(begin) != len(end):
            return False
        if (len(begin) - 1) % rows:  # without a section: the phase is free, the parameter and the period decide
            return bool(np.abs(begin[-2:] - end[-2:]).max() <= max(reach, FREE_PHASE_REACH))
        return any(np.abs(states - end).max() <= reach for states in _shifts(begin, rows))

    again: set[Branch] = set()
    for first, second in combinations(sorted(ends), 2):
        if first[0] == second[0] and first not in again and meet(first, second) and meet(second, first):
            again.add(second)
    return again


def _branch(segment: Segment) -> Branch:
    return segment.family, segment.branch


def _shifts(u: np.ndarray, rows: int) -> list[np.ndarray]:
    """Return the unknowns with all cyclic shifts of the section crossings."""
    return [np.append(np.roll(u[:-1], shift), u[-1]) for shift in range(0, len(u) - 1, rows)]
