"""Branch points: orbits at which another branch crosses the one that is followed.

There the equations have two solution curves, and their matrix has two null vectors. The determinant of the equations
with the tangent as last row changes sign at such a point, and at no fold (Doedel, Keller and Kernevez, *Int. J.
Bifurcation and Chaos* 1, 1991, section 3).
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.arclength import Branches
from vibrojax.periodic.brackets import Brackets, TestFunction, interpolate
from vibrojax.periodic.location import Locator, Test
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import AT_CROSSING, Flags, Index, PerLane, Points, Problem

BRANCH_POINT, FOLD, DOUBLING = map(SPECIAL_KINDS.index, ("branch-point", "fold", "period-doubling"))

NO_CHANGE = 1e-6
"""Component of the tangent along the parameter up to which rounding errors decide its sign."""

SHORT, BRANCH_STEPS = 0.02, 20
"""Length of a bracket from which on Newton's method begins at its zero, and limit of the orbits that shorten it."""

ASIDE = 0.1
"""Distance of these orbits from the predicted zero, relative to the bracket."""

POLISHING_STEPS, POLISHED = 12, 1e-12
"""Largest number of Newton steps at a branch point, and their size at which they end."""

BESIDE = 0.1
"""Largest distance of a branch point from the zero at which Newton's method begins."""

AHEAD = 1e-3
"""Length up to which steps next to a branch point are short; points of a branch within this distance are left out."""

CURVATURE_STEP = 1e-4
"""Difference of the unknowns from which second derivatives follow."""

CRITICAL_MULTIPLIER = 1e-2
"""Largest distance of a multiplier from 1 at a branch point."""

CROSSED_RESIDUAL = 1e-7
"""Largest residual at a branch point. Where two branches only pass each other, it is larger."""

VANISHED_SWING = 1e-9
"""Relative amplitude up to which an orbit without a section is the equilibrium at the Hopf point where it begins."""

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
    """Return the branch point in one bracket, or None if it cannot be located.

    Where the halves of the orbit are equal, the orbit of half the period doubles, and the kind is that of a doubling.
    The corrector fails near the point, where two solutions meet: orbits beside it shorten the bracket, and Newton's
    method for the point itself begins at the zero between them.
    """
    begin, near, far = bracket.near, bracket.near, bracket.far
    # At a pitchfork, one of the branches turns, so sharply that tangents at the ends may be normal to the chord.
    row = (far.u - near.u) / np.linalg.norm(far.u - near.u)
    for step in range(BRANCH_STEPS + 1):
        chord = (far.u - near.u)[0]
        first, last = (float(augmented(x, begin)[0]) for x in (near, far))
        zero, width = first / (first - last), float(row[0] @ chord)
        if width <= SHORT or step == BRANCH_STEPS:
            break
        share = np.clip(zero + (ASIDE if zero < 0.5 else -ASIDE), ASIDE / 2, 1 - ASIDE / 2)
        ahead, behind = (width * x.tangent / np.einsum("ij,ij->i", x.tangent, row)[:, None] for x in (near, far))
        guess = interpolate(near.u, far.u, ahead, behind, np.array([share]))
        now, converged = problem.correct(begin.family, guess, row, np.einsum("ij,ij->i", row, guess))
        if not converged[0]:
            break
        now = now.along(row)
        near, far = (now, far) if augmented(now, begin)[0] * first > 0 else (near, now)
    u = near.u + zero * chord
    point = _polished(problem, problem.evaluate(begin.family, u))
    if point is None or not np.abs(point.u - u).max() < BESIDE:
        return None
    directions = _directions(problem, point)
    if directions is None:
        return None
    tangent = max(directions, key=lambda t: abs(float(t @ chord)))
    point = point._replace(tangent=(tangent * np.sign(tangent @ chord))[None])
    half = problem.halves(point)
    same = np.linalg.norm(half) < SAME_HALVES * np.linalg.norm(point.u)
    if np.abs(multipliers(point.product) - 1).min(initial=np.inf) > CRITICAL_MULTIPLIER:
        return None
    return Brackets(np.array([DOUBLING if same else BRANCH_POINT]), bracket.place, point, bracket.far, bracket.ends)


def branch_point_ahead(problem: Problem, points: Points) -> tuple[Points, Points] | None:
    """Return the points of a branch before a branch point next to which steps are short, and the branch point, or None.

    Next to a branch point the equations are nearly singular: rounding errors lead from one branch to the other.
    """
    least = np.linalg.svd(np.nan_to_num(points.matrix), compute_uv=False)[:, -1]
    short = np.linalg.norm(np.diff(points.u, axis=0), axis=1) < AHEAD
    near = np.flatnonzero(short & (least[1:] < AT_CROSSING))
    point = _polished(problem, points.of([near[0] + 1])) if near.size else None
    if point is None or np.abs(multipliers(point.product) - 1).min(initial=np.inf) > CRITICAL_MULTIPLIER:
        return None
    directions, before = _directions(problem, point), points.of(slice(0, near[0] + 1))
    before = before.of(np.linalg.norm(before.u - point.u, axis=1) > AHEAD)
    if directions is None or not len(before.u):
        return None
    # Along a parabola about one of the directions, the tangent turns away from it twice as fast as the chord.
    last = np.stack([point.u[0] - before.u[-1], before.tangent[-1]], axis=1)
    chord, slope = np.linalg.lstsq(directions.T, last, rcond=None)[0].T
    turn = slope[::-1] * chord - 2 * slope * chord[::-1]
    own = int(np.abs(turn).argmin())
    return before, point._replace(tangent=np.sign(chord[own]) * directions[[own]])


def _polished(problem: Problem, point: Points) -> Points | None:
    """Return the branch point near a point, None if Newton's method finds none.

    With the matrix A of the equations f, it solves f + b w = 0, A' w = 0 and w' w = 1 for the unknowns, w and b. The
    solution is regular although A is not of full rank, and b = 0 where two branches cross (Moore, *Numerical Functional
    Analysis and Optimization* 2, 1980; Govaerts, *Numerical Methods for Bifurcations of Dynamical Equilibria*).
    """
    w, b = np.linalg.svd(point.matrix[0])[0][:, -1], 0.0
    for _ in range(POLISHING_STEPS):
        a, (rows, columns) = point.matrix[0], point.matrix[0].shape
        bend = _curvature(problem, point, w)
        jacobian = np.zeros((rows + columns + 1, columns + rows + 1))
        jacobian[:rows] = np.hstack([a, b * np.eye(rows), w[:, None]])
        jacobian[rows:-1, :-1] = np.hstack([bend, a.T])
        jacobian[-1, columns:-1] = 2 * w
        off = np.concatenate([point.off[0] + b * w, a.T @ w, [w @ w - 1]])
        if not np.isfinite(jacobian).all() or not np.isfinite(off).all():
            return None
        change = np.linalg.lstsq(jacobian, -off, rcond=None)[0]
        point = problem.evaluate(point.family, point.u + change[:columns])
        w, b = w + change[columns:-1], b + change[-1]
        if np.abs(change[:columns]).max() < POLISHED:
            break
    crossed = abs(b) < CROSSED_RESIDUAL and point.residual[0] < CROSSED_RESIDUAL
    return point if crossed and (problem.at_section or point.swing[0] > VANISHED_SWING) else None


def _curvature(problem: Problem, point: Points, w: np.ndarray) -> np.ndarray:
    """Return the second derivatives (unknowns, unknowns) of w f, by central differences."""
    size = point.u.shape[1]
    moves = CURVATURE_STEP * np.eye(size)
    now = problem.evaluate(np.repeat(point.family, 2 * size), point.u + np.concatenate([moves, -moves]))
    rows = np.einsum("i,kij->kj", w, now.matrix)
    return np.asarray((rows[:size] - rows[size:]).T / (2 * CURVATURE_STEP))


def _directions(problem: Problem, point: Points) -> np.ndarray | None:
    """Return the unit tangents (2, unknowns) of the branches that cross at a branch point, or None.

    They solve the algebraic bifurcation equation, which is quadratic in the null space of the equations' matrix.
    """
    w, _, right = np.linalg.svd(point.matrix[0])
    sizes, axes = np.linalg.eigh(right[-2:] @ _curvature(problem, point, w[:, -1]) @ right[-2:].T)
    if not sizes[0] < 0 < sizes[1]:
        return None
    along = np.sqrt([sizes[1], -sizes[0]]) * np.array([[1.0, 1.0], [1.0, -1.0]]) @ axes.T @ right[-2:]
    return np.asarray(along / np.linalg.norm(along, axis=1, keepdims=True))


def second_tangent(problem: Problem, point: Points) -> np.ndarray | None:
    """Return the tangent (1, unknowns) of the other branch at a branch point, or None."""
    directions = _directions(problem, point)
    return None if directions is None else min(directions, key=lambda t: abs(float(t @ point.tangent[0])))[None]
