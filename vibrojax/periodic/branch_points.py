"""Branch points: orbits at which another branch crosses the one that is followed.

There the equations have two solution curves, and their matrix has two null vectors. The determinant of the equations
with the tangent as last row changes sign at such a point, and at no fold (Doedel, Keller and Kernevez, *Int. J.
Bifurcation and Chaos* 1, 1991, section 3).
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.arclength import Branches
from vibrojax.periodic.brackets import Brackets, TestFunction, interpolate
from vibrojax.periodic.location import Locator, Test
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import Flags, Index, PerLane, Points, Problem, Unknowns, solve_bordered

BRANCH_POINT, FOLD = SPECIAL_KINDS.index("branch-point"), SPECIAL_KINDS.index("fold")

NO_CHANGE = 1e-6
"""Component of the tangent along the parameter up to which rounding errors decide its sign."""

CLEAR, BRANCH_STEPS = 1e-3, 20
"""Distance from a branch point at which orbits still are easily found, and limit of the orbits for its location."""

POLISHING_STEPS = 3
"""Newton steps that remove the error of interpolation."""

CRITICAL_MULTIPLIER = 1e-2
"""Largest distance of a multiplier from 1 at a branch point."""

CROSSED_RESIDUAL = 1e-7
"""Largest residual at a branch point. Where two branches only pass each other, it is larger."""

SAME_HALVES = 1e-3
"""Difference between the halves of an orbit, relative to its unknowns, up to which they are equal."""


class FamilyLocator(Locator):
    """Location of special points of families: branch points besides those of any continuation."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._crossed = np.zeros(0, int)

    def tests(self, family: Index) -> Iterable[tuple[int, Flags, Test]]:
        return [x for x in super().tests(family) if SPECIAL_KINDS[x[0]] not in self.problem.impossible]

    def __call__(self, branches: Branches) -> Brackets:
        brackets = branches.brackets(np.arange(len(branches.lane) - 1))
        with np.errstate(all="ignore"):
            crossing = np.flatnonzero(crosses(brackets) & ~brackets.changes_events)
            points = [point for k in crossing if (point := branch_point(self.problem, brackets.of([k]))) is not None]
        self._crossed = np.array([int(point.place[0]) for point in points], int)
        return Brackets.join([super().__call__(branches), *points])

    def accepted(self, brackets: Brackets, shrunk: Brackets, test: TestFunction, lanes: Index) -> Brackets:
        """Return the special points among shrunk brackets; where two branches cross, there is no fold."""
        along = np.maximum(*(np.abs(x.tangent[lanes, -1]) for x in (brackets.near, brackets.far)))
        crossed = np.isin(brackets.place[lanes], self._crossed)
        hidden = (shrunk.kind[lanes] == FOLD) & (crossed | (along < NO_CHANGE))
        return super().accepted(brackets, shrunk, test, lanes[~hidden])


def augmented(points: Points, reference: Points) -> PerLane:
    """Return the determinant of the equations with the tangent as last row, relative to that of reference points.

    It changes sign where two branches cross.
    """

    def of(x: Points) -> tuple[Any, Any]:
        return np.linalg.slogdet(np.concatenate([x.matrix, x.tangent[:, None]], axis=1))

    (sign, size), (_, base) = of(points), of(reference)
    return np.asarray(sign * np.exp(np.clip(size - base, -500.0, 500.0)))


def crosses(brackets: Brackets) -> Flags:
    """Return a mask of brackets in which another branch crosses."""
    return np.asarray(augmented(brackets.near, brackets.near) * augmented(brackets.far, brackets.near) < 0)


def branch_point(problem: Problem, bracket: Brackets) -> Brackets | None:
    """Return the branch point in one bracket, or None if it cannot be located or is a doubling of a shorter orbit.

    Newton's method fails at the point itself, where two solutions meet. The point is interpolated between orbits on
    both sides, which are no nearer than `CLEAR`.
    """
    bracket = _widened(problem, bracket)
    begin, row = bracket.near, bracket.near.tangent
    known = {0.0: begin, float(np.einsum("ij,ij->", row, bracket.far.u - begin.u)): bracket.far}
    values = {place: float(augmented(points, begin)[0]) for place, points in known.items()}
    for _ in range(BRANCH_STEPS):
        low, high = _ends(values)
        zero = _zero(values, low, high)
        if max(zero - low, high - zero) <= 2 * CLEAR:
            break
        wide = -1.0 if zero - low > high - zero else 1.0
        place = float(np.clip(zero + wide * max(CLEAR, 0.1 * (high - low)), low + 0.01 * CLEAR, high - 0.01 * CLEAR))
        guess = _between(known, row, place, low, high)[0]
        now = _corrected(problem, begin.family, guess, row, place + row @ begin.u[0])
        if now is None:
            return None
        known[place] = now
        values[place] = float(augmented(known[place], begin)[0])
    low, high = _ends(values)
    u, slope = _between(known, row, _zero(values, low, high), low, high)
    point = problem.evaluate(begin.family, u)
    for _ in range(POLISHING_STEPS):  # in all directions but those of the two branches
        w, sizes, right = np.linalg.svd(point.matrix[0], full_matrices=False)
        change = (w[:, :-1].T @ point.off[0]) / sizes[:-1] @ right[:-1]
        point = problem.evaluate(begin.family, point.u - change)
    point = point._replace(tangent=slope / np.linalg.norm(slope, axis=1, keepdims=True))
    if not point.residual[0] < CROSSED_RESIDUAL:
        return None
    half = problem.halves(point)
    same = np.linalg.norm(half) < SAME_HALVES * np.linalg.norm(point.u)
    if same or np.abs(multipliers(point.product) - 1).min(initial=np.inf) > CRITICAL_MULTIPLIER:
        return None
    return Brackets(np.array([BRANCH_POINT]), bracket.place, point, bracket.far)


def _corrected(problem: Problem, family: Index, guess: Unknowns, row: Unknowns, level: PerLane) -> Points | None:
    """Return the orbit on the plane row u = `level`, or None."""
    now, converged = problem.correct(family, guess, row, level)
    if not converged[0]:
        return None
    # The nearer the branch point, the more a residual displaces the orbit: one more Newton step removes it.
    step = solve_bordered(now.matrix, row, -np.column_stack([now.off, row @ now.u[0] - level]))
    return problem.evaluate(family, now.u + step).along(row)


def _widened(problem: Problem, bracket: Brackets) -> Brackets:
    """Return a bracket whose ends are farther from the branch point than `CLEAR`, if it is shorter."""
    near, row = bracket.near, bracket.near.tangent
    if np.einsum("ij,ij->", row, bracket.far.u - near.u) > 8 * CLEAR:
        return bracket
    ends = []
    for side in (-4 * CLEAR, 4 * CLEAR):
        guess = (near.u + bracket.far.u) / 2 + side * row
        ends.append(_corrected(problem, near.family, guess, row, row @ guess[0]))
    before, behind = ends
    if before is None or behind is None:
        return bracket
    wide = bracket._replace(near=before, far=behind)
    return wide if crosses(wide)[0] and not wide.changes_events[0] else bracket


def _ends(values: dict[float, float]) -> tuple[float, float]:
    """Return the places on both sides of the change of sign."""
    places = sorted(values)
    return next((a, b) for a, b in pairwise(places) if values[a] * values[b] <= 0)


def _zero(values: dict[float, float], low: float, high: float) -> float:
    """Return the zero of the values by inverse interpolation through up to four places around the change of sign."""
    nearest = sorted(values, key=lambda place: abs(place - (low + high) / 2))[:4]
    y = np.array([values[place] for place in nearest])
    terms = [
        place * np.prod([-y[m] / (y[k] - y[m]) for m in range(len(y)) if m != k]) for k, place in enumerate(nearest)
    ]
    zero = float(np.sum(terms))
    return zero if low < zero < high else (low + high) / 2


def _between(
    known: dict[float, Points], row: np.ndarray, place: float, low: float, high: float
) -> tuple[Unknowns, Unknowns]:
    """Return the unknowns at a place between two orbits, and their derivative along the places."""
    near, far, width = known[low], known[high], high - low
    from_near, from_far = (width * x.tangent / np.einsum("ij,ij->i", x.tangent, row)[:, None] for x in (near, far))
    share, small = np.array([(place - low) / width]), 1e-3
    ends = [interpolate(near.u, far.u, from_near, from_far, share + step) for step in (0.0, small, -small)]
    return ends[0], (ends[1] - ends[2]) / (2 * small * width)


def second_tangent(problem: Problem, point: Points) -> np.ndarray | None:
    """Return the tangent of the other branch at a branch point, from the algebraic bifurcation equation."""
    w, _, right = np.linalg.svd(point.matrix[0])
    null, psi, t = right[-2:], w[:, -1], point.tangent[0]
    d = null[0] - (null[0] @ t) * t, null[1] - (null[1] @ t) * t
    other = max(d, key=lambda x: float(np.linalg.norm(x)))
    other = other / np.linalg.norm(other)
    step = 1e-4

    def change(direction: np.ndarray) -> np.ndarray:
        u = point.u[0] + step * np.array([[1.0], [-1.0]]) * direction
        now = problem.evaluate(np.repeat(point.family, 2), u)
        return (now.matrix[0] - now.matrix[1]) / (2 * step)

    mixed, own = psi @ change(t) @ other, psi @ change(other) @ other
    share = -own / (2 * mixed) if mixed else 0.0
    tangent = other + (share if abs(share) < 10 else 0.0) * t
    return (tangent / np.linalg.norm(tangent))[None] if np.isfinite(tangent).all() else None
