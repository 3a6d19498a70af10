"""Families of equilibria of autonomous systems: folds, branch points and hopf points.

The unknowns are the scaled states and the scaled parameter, and the equations require that the rates vanish. The
derivative of one step of Euler's method, 1 + A/rate, takes the place of the return map's derivative, where A is the
derivative of the field: a multiplier 1 is an eigenvalue 0, and all that finds folds and branch points of orbits finds
those of equilibria.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import root

from vibrojax.compile.xla import precision
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.lazy import jax, jnp
from vibrojax.periodic.arclength import STOPPED, Stop
from vibrojax.periodic.brackets import Brackets, TestFunction
from vibrojax.periodic.branch_points import FamilyLocator
from vibrojax.periodic.families import FamilyContinuation
from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.location import TEST_FUNCTIONS, Test
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import Flags, Index, PerLane, Points, Problem, Unknowns
from vibrojax.periodic.segments import ENDINGS, Segment
from vibrojax.scenes import Scene

HOPF = SPECIAL_KINDS.index("hopf")

SOLVED = 1e-9
"""Largest rate of a scaled state, relative to the greatest derivative of the field, at an equilibrium."""

LARGEST_STATES = 50.0
"""Scaled states at which a family ends."""

FAR_NOTE, NONE_NOTE = (
    f"the states are over {LARGEST_STATES:g} times their scales",
    "no equilibrium is found any further",
)

SEPARATED = 1e-3
"""Scaled distance up to which special points next to each other are located one by one."""

DISPLACEMENTS = 10.0 ** np.arange(-12, 13)
"""Displacements of a state among which is its scale, if the equilibrium does not show it."""

FEWEST_LANES = 4
"""Smallest number of points that are evaluated together."""

LEAST_PRODUCT, ROUNDED = 1e-200, 1e-10
"""Value of a product of sums that is zero, and sum of two eigenvalues that may be a rounding error, relative to the
largest."""

TURNING = 1e-6
"""Imaginary part of an eigenvalue, relative to its modulus, above which a pair turns instead of being real."""


class EquilibriumField:
    """Rates of a scene's moving states, and their derivatives, at many points at once; `along`: varied parameters."""

    def __init__(self, scene: Scene[Any], along: tuple[str, ...]) -> None:
        names = moving_names(scene)

        def rates(x: Any, p: Any) -> Any:
            known = dict(zip(names, x[: len(names)], strict=True))
            whole = tuple(known.get(name, jnp.zeros_like(x[0])) for name in scene.state_names)
            c = scene.constants(dict(p) | dict(zip(along, x[len(names) :], strict=True)))
            c = scene.scaled(c, jax.lax.stop_gradient(whole))
            mode = jax.lax.stop_gradient(scene.mode_at(c, whole))
            by_name = dict(zip(scene.state_names, scene.field(c, mode, whole), strict=True))
            moves = jnp.stack([jnp.broadcast_to(by_name[name], x[0].shape) for name in names])
            return jnp.where(scene.has_no_field(c, mode, whole), jnp.nan, moves)

        self._both = jax.jit(jax.vmap(lambda x, p: (rates(x, p), jax.jacfwd(rates)(x, p))))

    def __call__(
        self, x: Float[np.ndarray, "lanes unknowns"], parameters: Mapping[str, PerLane]
    ) -> tuple[Float[np.ndarray, "lanes states"], Float[np.ndarray, "lanes states unknowns"]]:
        """Return the rates and their derivatives; `x`: states and varied parameters."""
        # Each number of lanes would be compiled: they are padded to a power of two.
        padded = np.resize(np.arange(len(x)), max(FEWEST_LANES, 1 << (len(x) - 1).bit_length()))
        with precision("float64"):
            both = self._both(x[padded], {name: np.asarray(value)[padded] for name, value in parameters.items()})
        rates, jacobian = (np.asarray(part)[: len(x)] for part in both)
        return rates, jacobian


@lru_cache(maxsize=64)
def field_of(scene: Scene[Any], along: tuple[str, ...]) -> EquilibriumField:
    """Return the field of a scene; it is compiled once in a process."""
    return EquilibriumField(scene, along)


@dataclass(frozen=True, kw_only=True)
class EquilibriumProblem(Problem):
    """Families of equilibria; `rate` (families,) [1/s]: the unit of the eigenvalues."""

    at_section: ClassVar[bool] = False
    most_growth: ClassVar[float] = np.inf
    rate: PerLane

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

    def evaluate(self, family: Index, u: Unknowns) -> Points:
        scale = np.column_stack([self.scales[family], self.unit[family]])
        rates, jacobian = field_of(self.scene, self.along)(
            u * scale, {name: x[family] for name, x in self.parameters.items()}
        )
        unit = self.rate[family, None] * self.scales[family]
        matrix = jacobian * scale[:, None] / unit[..., None]
        lanes, states = len(u), self.rows
        return Points(
            family=family,
            u=u.copy(),
            tangent=np.full_like(u, np.nan),
            off=rates / unit,
            matrix=matrix,
            times=np.ones((lanes, 1)),
            product=np.eye(states) + matrix[..., :states],
            impacts=np.zeros(lanes),
            mode_changes=np.zeros((lanes, len(self.scene.modes), 3)),
            margin=np.full(lanes, np.inf),
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

    def tests(self, family: Index) -> Iterable[tuple[int, Flags, Test]]:
        every = np.ones(len(family), bool)
        return [
            (SPECIAL_KINDS.index("fold"), every, TEST_FUNCTIONS["fold"]),
            (HOPF, every, sums_of_pairs),
        ]

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

    def __init__(self, problem: EquilibriumProblem) -> None:
        super().__init__(problem, cycles=1)
        self._locator = EquilibriumLocator(problem)

    def stop(self, segments: list[Segment]) -> Stop:
        return lambda lanes, now: np.abs(now.u[:, :-1]).max(axis=1) > LARGEST_STATES

    def finish(self, segments: list[Segment]) -> list[Segment]:
        following = super().finish(segments)
        for segment in segments:
            segment.marks = [x._replace(note=FAR_NOTE) if x.note == ENDINGS[STOPPED] else x for x in segment.marks]
        return following

    def _pass_stalls(self, segments: list[Segment]) -> list[Segment]:
        for segment in segments:
            segment.mark("end", NONE_NOTE)
        return []


def equilibrium_near(
    scene: Scene[Any], parameters: Mapping[str, float], guess: Float[np.ndarray, " states"]
) -> tuple[Float[np.ndarray, " states"], Float[np.ndarray, "states states"]] | None:
    """Return an equilibrium of the moving states near `guess` and the derivative of the field there, or None."""
    field = field_of(scene, ())
    own = {name: np.array([x]) for name, x in parameters.items()}

    def both(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rates, jacobian = field(x[None], own)
        return rates[0], jacobian[0]

    with np.errstate(all="ignore"):
        found = root(both, guess, jac=True, method="hybr", tol=1e-13)
        states = np.asarray(found.x)
        for _ in range(3):
            rates, jacobian = both(states)
            if not np.isfinite(jacobian).all() or np.linalg.matrix_rank(jacobian) < len(states):
                return None
            states = states - np.linalg.solve(jacobian, rates)
        rates, jacobian = both(states)
    size = np.abs(jacobian).max() * max(np.abs(states).max(), np.abs(guess).max(), 1e-300)
    return (states, jacobian) if np.abs(rates).max() <= SOLVED * size else None


def scales_at(
    scene: Scene[Any],
    along: str,
    parameters: Mapping[str, float],
    states: Float[np.ndarray, " states"],
    bounds: tuple[float, float],
) -> Float[np.ndarray, " states"]:
    """Return the displacement of each state by which an eigenvalue changes as much as along the parameter's bounds.

    It is 0 if no displacement changes an eigenvalue by that, and by the eigenvalue itself. Eigenvalues do not depend on
    units of the states.
    """
    size = len(states)
    displaced = states + (DISPLACEMENTS[:, None, None] * np.eye(size)).reshape(-1, size)
    values = np.append([parameters[along], *bounds], np.full(len(displaced), parameters[along]))
    unknowns = np.column_stack([np.concatenate([np.tile(states, (3, 1)), displaced]), values])
    known = {name: np.full(len(values), x) for name, x in parameters.items()}
    jacobian = field_of(scene, (along,))(unknowns, known)[1][..., :size]
    finite = np.isfinite(jacobian).all(axis=(1, 2))
    every = np.linalg.eigvals(np.where(finite[:, None, None], jacobian, jacobian[0]))
    change = np.abs(every[:, :, None] - every[0]).min(axis=1)
    needed = np.maximum(np.abs(every[0]), change[1:3].max(axis=0))
    enough = ((change[3:] >= needed) & (needed > 0)).any(axis=1).reshape(len(DISPLACEMENTS), size)
    return np.where(enough.any(axis=0), DISPLACEMENTS[enough.argmax(axis=0)], 0.0)
