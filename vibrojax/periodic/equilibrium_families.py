"""Families of equilibria of autonomous systems: folds, branch points and hopf points.

The unknowns are the scaled states and the scaled parameter, and the equations require that the rates vanish. The
derivative of one step of Euler's method, 1 + A/rate, takes the place of the return map's derivative, where A is the
derivative of the field. A multiplier 1 is then an eigenvalue 0, so the same code finds folds and branch points of
orbits and of equilibria.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Complex

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.arclength import Branches, Stop
from vibrojax.periodic.brackets import Brackets, TestFunction
from vibrojax.periodic.branch_points import FOLD, FamilyLocator
from vibrojax.periodic.equilibria import Equilibrium, field_of, scales_at
from vibrojax.periodic.families import FamilyContinuation
from vibrojax.periodic.location import TEST_FUNCTIONS, Test
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import Flags, Index, PerLane, Points, Problem, Unknowns
from vibrojax.periodic.segments import SAME_POINT, Segment

HOPF = SPECIAL_KINDS.index("hopf")

LARGEST_STATES = 50.0
"""Scaled states at which a family ends."""

STEEPEST_FIELD = 1e6
"""Derivative of a scaled rate at which a family ends. The greatest one of the first equilibrium is 1."""

SEPARATED = 1e-3
"""Scaled distance up to which special points next to each other are located one by one."""

LEAST_PRODUCT, ROUNDED = 1e-200, 1e-10
"""Value of a product of sums that is zero, and sum of two eigenvalues that may be a rounding error, relative to the
largest."""

TURNING = 1e-6
"""Imaginary part of an eigenvalue, relative to its modulus, above which a pair turns instead of being real."""


@dataclass(frozen=True, kw_only=True)
class EquilibriumProblem(Problem):
    """Families of equilibria; `rate` (families,) [1/s]: the unit of the eigenvalues."""

    at_section: ClassVar[bool] = False
    most_growth: ClassVar[float] = np.inf
    noun: ClassVar[str] = "equilibrium"
    rate: PerLane

    @classmethod
    def through(
        cls, section: Problem, known: Mapping[int, Equilibrium]
    ) -> tuple["EquilibriumProblem", list[np.ndarray]]:
        """Return the equations of equilibria, and the unknowns of known ones, given by number of their family."""
        scene, [along], families = section.scene, section.along, np.array([*known])
        parameters = {name: x[families] for name, x in section.parameters.items()}
        bounds = np.column_stack([section.first[families, 0], section.last[families, 0]])
        states, jacobian = (np.array(x) for x in list(zip(*known.values(), strict=True))[:2])
        size = np.abs(states)
        for k, (low, high) in enumerate(bounds.tolist()):
            here = {name: float(x[k]) for name, x in parameters.items()}
            size[k] = np.maximum(size[k], scales_at(scene, along, here, states[k], (low, high)))
        values = parameters[along]
        slope = field_of(scene, (along,))(np.column_stack([states, values]), parameters).jacobian[..., -1]
        change = np.linalg.solve(jacobian, slope[..., None])[..., 0]
        size = np.maximum(size, np.abs(change) * np.diff(bounds) / 2)
        largest = size.max(axis=1, keepdims=True)
        scales, rate = np.ones((len(section.scales), states.shape[1])), np.ones(len(section.scales))
        scales[families] = own = np.where(size > 1e-3 * largest, size, np.where(largest > 0, largest, 1.0))
        rate[families] = np.abs(jacobian * own[:, None, :] / own[:, :, None]).max(axis=(1, 2))
        problem = cls(
            scene=scene, along=section.along, parameters=section.parameters, scales=scales, unit=section.unit,
            first=section.first, last=section.last, refused=section.refused, rate=rate,
        )  # fmt: skip
        return problem, list(problem.unknowns(families, states[:, None], values[:, None]))

    def eigenvalues(self, points: Points) -> Complex[np.ndarray, "lanes states"]:
        """Return the eigenvalues [1/s] of the field's derivative, in order of falling real part."""
        values = (multipliers(points.product) - 1) * self.rate[points.family, None]
        return np.take_along_axis(values, np.argsort(-values.real, axis=1, kind="stable"), axis=1)

    def halves(self, points: Points) -> Unknowns:
        return points.u

    def left_branch(self, last: Points, now: Points) -> Flags:
        """Return a mask of points on another branch, or behind special points that a shorter step may resolve.

        Several special points hide one another. Where a real eigenvalue changes sign, a step may also have led across a
        gap between two branches that nearly meet.
        """
        grows, turns = [], []
        for points in (last, now):
            values = multipliers(points.product) - 1
            grows.append((values.real > 0).sum(axis=1))
            turns.append(((values.real > 0) & (values.imag != 0)).sum(axis=1))
        more, turning = (np.abs(ends[1] - ends[0]) for ends in (grows, turns))
        several = (more > 2) | ((more > 0) & (turning == 0))
        several &= np.linalg.norm(now.u - last.u, axis=1) > SEPARATED
        return super().left_branch(last, now) | several

    def touching(self, points: Points) -> Flags:
        """Return a mask of all points: with an accepted residual, small changes of eigenvalues are rounding errors."""
        return np.ones(len(points.u), bool)

    def evaluate(self, family: Index, u: Unknowns) -> Points:
        """Evaluate the equations; where a guard is zero, the mode changes, and with it the formula of the field."""
        scale = np.column_stack([self.scales[family], self.unit[family]])
        here = field_of(self.scene, self.along)(u * scale, {name: x[family] for name, x in self.parameters.items()})
        unit = self.rate[family, None] * self.scales[family]
        matrix = here.jacobian * scale[:, None] / unit[..., None]
        slopes = np.linalg.norm(here.guard_slopes * scale[:, None], axis=2)
        with np.errstate(all="ignore"):
            distances = np.where(slopes > 0, np.abs(here.guards) / slopes, np.inf)
        lanes, states = len(u), self.rows
        modes = np.zeros((lanes, here.modes.shape[1], 3))
        modes[..., -1] = here.modes
        return Points(
            family=family,
            u=u.copy(),
            tangent=np.full_like(u, np.nan),
            off=here.rates / unit,
            matrix=matrix,
            times=np.ones((lanes, 1)),
            product=np.eye(states) + matrix[..., :states],
            impacts=np.zeros(lanes),
            mode_changes=modes,
            margin=distances.min(axis=1, initial=np.inf),
            swing=np.ones(lanes),
        )


def sums_of_pairs(points: Points, _: Points) -> PerLane:
    """Return the product of the sums of all pairs of eigenvalues, which changes sign at hopf points.

    Zero counts as positive, so that a family that begins at a hopf point has it. See Kuznetsov, *Elements of Applied
    Bifurcation Theory*, section 10.2.
    """
    values = multipliers(points.product) - 1
    first, second = np.triu_indices(values.shape[1], 1)
    product = np.prod(values[:, first] + values[:, second], axis=1).real
    return np.asarray(np.where(product == 0, LEAST_PRODUCT, product))


def critical_pair(points: Points) -> tuple[PerLane, PerLane]:
    """Return size and imaginary part of the two eigenvalues whose sum is smallest, relative to the largest modulus.

    The size is that of the sum.
    """
    values = multipliers(points.product) - 1
    first, second = np.triu_indices(values.shape[1], 1)
    sums, size = np.abs(values[:, first] + values[:, second]), np.abs(values).max(axis=1)
    lanes, nearest = np.arange(len(values)), sums.argmin(axis=1)
    return sums[lanes, nearest] / size, np.abs(values[lanes, first[nearest]].imag) / size


class EquilibriumLocator(FamilyLocator):
    """Location of the special points of equilibria."""

    def __call__(self, branches: Branches) -> Brackets:
        """Return the special points; at a fold, a pair whose frequency vanishes is no hopf point (Bogdanov-Takens)."""
        segments = super().__call__(branches)
        folds = segments.near.u[segments.kind == FOLD]
        apart = np.abs(segments.near.u[:, None] - folds[None]).max(axis=2).min(axis=1, initial=np.inf)
        return segments.of((segments.kind != HOPF) | (apart > SAME_POINT))

    def tests(self, family: Index) -> Iterable[tuple[int, Flags, Test]]:
        every = np.ones(len(family), bool)
        return [(FOLD, every, TEST_FUNCTIONS["fold"]), (HOPF, every, sums_of_pairs)]

    def accepted(self, brackets: Brackets, shrunk: Brackets, test: TestFunction, lanes: Index) -> Brackets:
        """Return folds, and hopf points; two real eigenvalues of equal size and opposite sign are no special point."""
        hopf = shrunk.kind[lanes] == HOPF
        own = lanes[hopf]
        turns = np.zeros(len(own), bool)
        if len(own):
            # In conservative systems, the sums are rounding errors all along.
            ends = (critical_pair(x.of(own))[0] for x in (brackets.near, brackets.far))
            turns = (critical_pair(shrunk.near.of(own))[1] > TURNING) & (np.maximum(*ends) > ROUNDED)
        return Brackets.join([super().accepted(brackets, shrunk, test, lanes[~hopf]), shrunk.of(own[turns])])


class EquilibriumContinuation(FamilyContinuation):
    """Continuation of families of equilibria."""

    locator = EquilibriumLocator

    def stop(self, segments: list[Segment]) -> Stop:
        return lambda lanes, now: (np.abs(now.u[:, :-1]).max(axis=1) > LARGEST_STATES) | is_steep(now)

    def stop_note(self, segment: Segment) -> str:
        if is_steep(segment.points.of([-1]))[0]:
            return "the field's derivative grows without limit: an edge of its domain"
        return f"the states are over {LARGEST_STATES:g} times their scales"


def is_steep(points: Points) -> Flags:
    """Return a mask of the points next to an edge of the field's domain, such as the zero of a square root."""
    return np.asarray(np.linalg.norm(points.matrix, axis=2).max(axis=1) > STEEPEST_FIELD)
