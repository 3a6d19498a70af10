"""Families of orbits without a section: branch points, hopf points, and orbits of unbounded period."""

from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import newton

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.arclength import STALLED, STOPPED, Branches, Stop
from vibrojax.periodic.brackets import Brackets, TestFunction, interpolate
from vibrojax.periodic.families import MAX_BRANCHES, FamilyContinuation
from vibrojax.periodic.hopf import Field
from vibrojax.periodic.location import Locator
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import Flags, Index, PerLane, Points, Unknowns
from vibrojax.periodic.segments import ENDINGS, Mark, Segment
from vibrojax.periodic.timed_problem import TimedProblem, transverse

BRANCH_POINT = SPECIAL_KINDS.index("branch-point")
FOLD = SPECIAL_KINDS.index("fold")

LONGEST_PERIOD = 1e3
"""Period, relative to that of the first orbit, at which a family ends: it leads to an orbit to an equilibrium."""

SAME_CROSSING = 1e-4
"""Largest difference of the scaled parameter, the logarithm of the period, the amplitude and the multipliers between
two descriptions of one branch point."""

SAME_VALUE, CENTRE_POINTS = 1e-9, 60
"""Scaled change of the parameter that is none, and number of points without one at which a family ends: around a centre
there are orbits of every amplitude."""

NO_CHANGE = 1e-6
"""Component of the tangent along the parameter up to which rounding errors decide its sign."""

LONG_NOTE = "the period grows without limit"
CENTRE_NOTE = "a centre: orbits of every amplitude at one value"

CLEAR, BRANCH_STEPS = 1e-3, 20
"""Distance from a branch point at which orbits still are easily found, and limit of the orbits for its location."""

POLISHING_STEPS = 3
"""Newton steps that remove the error of interpolation."""

CRITICAL_MULTIPLIER = 1e-2
"""Largest distance of a multiplier from 1 at a branch point."""

SAME_HALVES = 1e-3
"""Difference between the halves of an orbit, relative to its unknowns, up to which they are equal."""


def augmented(points: Points, reference: Points) -> PerLane:
    """Return the determinant of the equations with the tangent as last row, relative to that of reference points.

    It changes sign where two branches cross, and not at folds (Doedel, Keller and Kernevez, 1991, section 3).
    """

    def of(x: Points) -> tuple[Any, Any]:
        return np.linalg.slogdet(np.concatenate([x.matrix, x.tangent[:, None]], axis=1))

    (sign, size), (_, base) = of(points), of(reference)
    return np.asarray(sign * np.exp(np.clip(size - base, -500.0, 500.0)))


class TimedLocator(Locator):
    """Location of special points of families without a section: branch points besides those of other families."""

    def __init__(self, problem: TimedProblem) -> None:
        super().__init__(problem)
        self._timed = problem
        self._crossed = np.zeros(0, int)

    def __call__(self, branches: Branches) -> Brackets:
        brackets = branches.brackets(np.arange(len(branches.lane) - 1))
        with np.errstate(all="ignore"):
            crossing = np.flatnonzero(crosses(brackets) & ~brackets.changes_events)
            found = [point for k in crossing if (point := self._branch_point(brackets.of([k]))) is not None]
        self._crossed = np.array([int(point.place[0]) for point in found], int)
        return Brackets.join([super().__call__(branches), *found])

    def accepted(self, brackets: Brackets, shrunk: Brackets, test: TestFunction, lanes: Index) -> Brackets:
        """Return the special points among shrunk brackets; where two branches cross, there is no fold."""
        along = np.maximum(*(np.abs(x.tangent[lanes, -1]) for x in (brackets.near, brackets.far)))
        crossed = np.isin(brackets.place[lanes], self._crossed)
        hidden = (shrunk.kind[lanes] == FOLD) & (crossed | (along < NO_CHANGE))
        return super().accepted(brackets, shrunk, test, lanes[~hidden])

    def _branch_point(self, bracket: Brackets) -> Brackets | None:
        """Return the branch point in one bracket, or None if it cannot be located or is a doubling of a shorter orbit.

        Newton's method fails at the point itself, where two solutions meet. The point is interpolated between orbits on
        both sides, which are no nearer than `CLEAR`.
        """
        problem, begin, row = self.problem, bracket.near, bracket.near.tangent
        known = {0.0: begin, float(np.einsum("ij,ij->", row, bracket.far.u - begin.u)): bracket.far}
        values = {place: float(augmented(points, begin)[0]) for place, points in known.items()}
        for _ in range(BRANCH_STEPS):
            low, high = _ends(values)
            zero = _zero(values, low, high)
            if max(zero - low, high - zero) <= 2 * CLEAR:
                break
            wide = -1.0 if zero - low > high - zero else 1.0
            place = float(
                np.clip(zero + wide * max(CLEAR, 0.1 * (high - low)), low + 0.01 * CLEAR, high - 0.01 * CLEAR)
            )
            guess = _between(known, row, place, low, high)[0]
            now, converged = problem.correct(begin.family, guess, row, np.array([place]) + (row @ begin.u[0]))
            if not converged[0]:
                return None
            known[place], values[place] = now.along(row), 0.0
            values[place] = float(augmented(known[place], begin)[0])
        low, high = _ends(values)
        u, slope = _between(known, row, _zero(values, low, high), low, high)
        point = problem.evaluate(begin.family, u)
        for _ in range(POLISHING_STEPS):  # in all directions but those of the two branches
            left, sizes, right = np.linalg.svd(point.matrix[0], full_matrices=False)
            change = (left[:, :-1].T @ point.off[0]) / sizes[:-1] @ right[:-1]
            point = problem.evaluate(begin.family, point.u - change)
        point = point._replace(tangent=slope / np.linalg.norm(slope, axis=1, keepdims=True))
        half = self._timed.halves(point)
        same = np.linalg.norm(half) < SAME_HALVES * np.linalg.norm(point.u)
        if same or np.abs(multipliers(point.product) - 1).min(initial=np.inf) > CRITICAL_MULTIPLIER:
            return None
        return Brackets(np.array([BRANCH_POINT]), bracket.place, point, bracket.far)


def crosses(brackets: Brackets) -> Flags:
    """Return a mask of brackets in which another branch crosses."""
    return np.asarray(augmented(brackets.near, brackets.near) * augmented(brackets.far, brackets.near) < 0)


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


class TimedContinuation(FamilyContinuation):
    """Continuation of the families of a `TimedProblem`."""

    def __init__(self, problem: TimedProblem, cycles: int) -> None:
        super().__init__(problem, cycles)
        self._locator = TimedLocator(problem)
        self._timed = problem
        self._crossings: dict[int, list[np.ndarray]] = {}

    def stop(self, segments: list[Segment]) -> Stop:
        """Return the condition that the amplitude passes zero, that a period is too long, or that branches join."""
        begin = Points.join([segment.begin for segment in segments])
        deviations, halves = self._deviations(begin), self._timed.halves(begin)
        first, count = begin.u[:, -1].copy(), np.zeros(len(begin.u), int)
        doubled = np.array([segment.departure is not None for segment in segments])

        def ends(lanes: Index, now: Points) -> Flags:
            own = self._deviations(now)
            turned = np.einsum("ij,ij->i", own, deviations[lanes]) < 0
            other = self._timed.halves(now)
            joins = doubled[lanes] & (np.einsum("ij,ij->i", other, halves[lanes]) < 0)
            deviations[lanes], halves[lanes] = own, other
            count[lanes] = np.where(np.abs(now.u[:, -1] - first[lanes]) < SAME_VALUE, count[lanes] + 1, 0)
            return joins | turned | self._is_long(now) | (count[lanes] >= CENTRE_POINTS)

        return ends

    def finish(self, segments: list[Segment]) -> list[Segment]:
        following = []
        rest = []
        for segment in segments:
            last = segment.points.of(slice(-2, None))
            deviations = self._deviations(last)
            if len(last.u) == 2 and deviations[0] @ deviations[1] < 0:
                segment.points = segment.points.of(slice(0, -1))
                inside = segment.special.place < len(segment.points.u) - 1
                self._add_marks(segment, segment.special.of(inside))
                hopf = self._hopf(last)
                if hopf is None:
                    segment.mark("end", "the amplitude shrinks to zero")
                else:
                    segment.marks.append(Mark(hopf, "hopf", "the amplitude is zero", len(segment.points.u) - 1))
                following += self._doubled_branches([segment])
            else:
                rest.append(segment)
        following += super().finish(rest) if rest else []
        for segment in rest:
            last = segment.points.of([-1])
            if segment.status == STOPPED and segment.departure is None:
                note = LONG_NOTE if self._is_long(last)[0] else CENTRE_NOTE
                segment.marks = [x._replace(note=note) if x.note == ENDINGS[STOPPED] else x for x in segment.marks]
        return following + self._crossing_branches(segments)

    def _is_long(self, points: Points) -> Flags:
        return points.period > LONGEST_PERIOD * self._timed.period_unit[points.family]

    def _deviations(self, points: Points) -> np.ndarray:
        """Return the scaled states relative to their mean, flattened."""
        size = len(points.u), self._problem.cycles(points.u), self._problem.rows
        own = points.u[:, : -1 - len(self._problem.along)].reshape(size)
        return np.asarray((own - own.mean(axis=1, keepdims=True)).reshape(size[0], size[1] * size[2]))

    def _pass_stalls(self, segments: list[Segment]) -> list[Segment]:
        """Mark the ends of segments; there are no events beyond which they go on."""
        for segment in segments:
            segment.mark("end", ENDINGS[STALLED])
        return []

    def _end_at_doublings(self, segments: list[Segment]) -> None:
        """Doubled branches end before the doubling at which they join another branch; the mark says so."""

    def _hopf(self, pair: Points) -> Points | None:
        """Return the Hopf point between two orbits on opposite sides of an equilibrium."""
        problem, [along] = self._timed, self._problem.along
        family = pair.family[:1]
        number = int(family[0])
        values = problem.values(pair.family, pair.u)[:, 0]
        mean = problem.states(pair.family, pair.u).mean(axis=(0, 1))
        parameters = {name: x[number] for name, x in problem.parameters.items()}
        field = Field(problem.scene, parameters, mean, float(problem.scales[number].max()))
        multiple = pair.times.shape[1]
        frequency = 2 * np.pi / float(pair.period.mean() / multiple)

        def growth(at: float) -> float:
            known = field.equilibrium({along: at})
            return np.nan if known is None else known.pair(frequency)[0].real

        unit = float(problem.unit[number, 0])
        a, b = values
        if abs(a - b) < 1e-9 * unit:
            b = a + 1e-6 * unit
        with np.errstate(all="ignore"):
            located, _ = newton(growth, a, x1=b, tol=1e-14 * unit, maxiter=60, full_output=True, disp=False)
            known = field.equilibrium({along: located}) if np.isfinite(located) else None
        if known is None or abs(located - values.mean()) > 0.5 * unit:
            return None
        eigenvalue, vector = known.pair(frequency)
        period = multiple * 2 * np.pi / eigenvalue.imag
        parts = problem.cycles(pair.u)
        states = np.repeat(known.states[None, None], parts, axis=1)
        u = problem.unknowns_of(family, states, np.array([period]), np.array([[located]]))
        last, scale = pair.of([0]), problem.scales[number]
        whole = expm(known.jacobian * period) * scale / scale[:, None]
        product = transverse(whole[None, None], (vector.real / scale)[None])
        times, off = np.full_like(last.times, period / multiple), np.zeros_like(last.off)
        return last._replace(u=u, off=off, times=times, product=product)

    def _is_known(self, family: int, orbit: Points) -> bool:
        """Return whether a branch point was found before, from another branch; else remember it."""
        values = np.sort_complex(multipliers(orbit.product)[0])
        mine = np.concatenate([orbit.u[0, -1:], np.log(orbit.period), orbit.swing, values.real, values.imag])
        known = self._crossings.setdefault(family, [])
        if any(np.abs(mine - other).max() < SAME_CROSSING for other in known):
            return True
        known.append(mine)
        return False

    def _crossing_branches(self, segments: list[Segment]) -> list[Segment]:
        """Return the first segments, in both directions, of the branches that cross at branch points."""
        crossing = []
        for segment in segments:
            for mark in segment.marks:
                if mark.kind != "branch-point" or self._branches[segment.family] >= MAX_BRANCHES:
                    continue
                if self._is_known(segment.family, mark.orbit):
                    continue
                tangent = second_tangent(self._timed, mark.orbit)
                if tangent is None:
                    continue
                branch = self._branches[segment.family]
                self._branches[segment.family] += 1
                for sign in (1, -1):
                    begin = mark.orbit._replace(tangent=sign * tangent)
                    crossing.append(Segment(segment.family, branch, sign, begin, parent=segment))
        return crossing


def second_tangent(problem: TimedProblem, point: Points) -> np.ndarray | None:
    """Return the tangent of the other branch at a branch point, from the algebraic bifurcation equation."""
    left, _, right = np.linalg.svd(point.matrix[0])
    null, psi, t = right[-2:], left[:, -1], point.tangent[0]
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
