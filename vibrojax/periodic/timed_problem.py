"""Equations of periodic orbits of an autonomous system, by multiple shooting over equal parts of the period.

The unknowns are the states at the beginning of each part, the period, and one or two parameters, all scaled. The
equations require that the flow over a part takes each state to the next, and the last to the first. A shift in time
along the orbit is another solution. The last row of the equations therefore fixes the phase: steps and tangents are
orthogonal to that shift, so that the phase condition moves along with the orbit (Doedel, Keller and Kernevez, *Int. J.
Bifurcation and Chaos* 1, 1991, 745). No section is needed, so that families do not end where orbits leave one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.flow_map import Flow, Flowed, moving_names
from vibrojax.periodic.newton import chain, images_by_lane, multipliers, shooting_matrix
from vibrojax.periodic.problem import (
    FAMILY_ACCURACY,
    Flags,
    Index,
    PerLane,
    Points,
    Problem,
    Unknowns,
    solve_bordered,
)
from vibrojax.scenes import Scene

GROWTH = 30.0
"""Largest growth of a small distance over a part of the first orbit; along the family it may become greater."""

LEAST_PARTS, MOST_PARTS = 4, 64

CRITICAL = 0.3
"""Distance of a multiplier from 1 below which another branch may be so near that a step can lead to it."""

NO_SWING = 1e-3
"""Amplitude, relative to that of the point before, below which a step has led to an equilibrium."""

BACK_ITERATIONS, BACK_RESIDUAL, OTHER_ORBIT = 6, 1e-6, 1e-2
"""Newton steps back to the point before; residual up to which they have found an orbit; and distance of that orbit from
the point before, relative to the step, from which on it is another one."""


@dataclass(frozen=True, kw_only=True)
class TimedProblem(Problem):
    """Families of one autonomous system over one parameter; see [vibrojax.periodic.problem.Problem][].

    - `scales` (families, states): scales of all moving states.
    - `period_unit` (families,): unit of the period [s]; `parts`: number of parts of a period of the first orbits.
    """

    at_section: ClassVar[bool] = False
    period_unit: PerLane
    parts: int

    @cached_property
    def flow(self) -> Flow:
        return Flow(self.scene, self.along, FAMILY_ACCURACY, self.most_steps)

    def cycles(self, u: Unknowns) -> int:
        """Return the number of parts."""
        return (u.shape[1] - 1 - len(self.along)) // self.rows

    @property
    def _weight(self) -> float:
        """Factor of the unknown states, so that the norm of a change does not grow with the number of parts."""
        return float(self.parts) ** -0.5

    def unknowns_of(
        self,
        family: Index,
        states: Float[np.ndarray, "lanes parts states"],
        period: PerLane,
        values: Float[np.ndarray, "lanes varied"],
    ) -> Unknowns:
        scaled = states / self.scales[family][:, None] * self._weight
        periods = period / self.period_unit[family]
        return np.column_stack([scaled.reshape(len(family), -1), periods, values / self.unit[family]])

    def states(self, family: Index, u: Unknowns) -> Float[np.ndarray, "lanes parts states"]:
        own = u[:, : -1 - len(self.along)].reshape(len(u), self.cycles(u), self.rows)
        return own * self.scales[family][:, None] / self._weight

    def period(self, family: Index, u: Unknowns) -> PerLane:
        return np.asarray(u[:, -1 - len(self.along)] * self.period_unit[family])

    def halves(self, points: Points) -> np.ndarray:
        """Return the difference of the two halves of orbits, which changes its sign where they become equal."""
        half = self.cycles(points.u) // 2 * self.rows
        return np.asarray(points.u[:, :half] - points.u[:, half : 2 * half])

    def left_branch(self, last: Points, now: Points) -> Flags:
        near = np.minimum(*(np.abs(multipliers(x.product) - 1).min(axis=1, initial=np.inf) for x in (last, now)))
        lanes = np.flatnonzero(near < CRITICAL)
        left = now.swing < NO_SWING * last.swing
        if not len(lanes):
            return np.asarray(left)
        back, target, row = now.of(lanes), last.u[lanes], now.tangent[lanes]
        level = np.einsum("ij,ij->i", row, target)
        u = back.u + (level - np.einsum("ij,ij->i", row, back.u))[:, None] * row
        for _ in range(BACK_ITERATIONS):
            at = self.evaluate(back.family, u)
            short = np.einsum("ij,ij->i", row, u) - level
            u = u + np.nan_to_num(solve_bordered(at.matrix, row, -np.column_stack([at.off, short])))
        off = u - target
        off = np.linalg.norm(off - np.einsum("ij,ij->i", off, at.matrix[:, -1])[:, None] * at.matrix[:, -1], axis=1)
        left[lanes] |= (at.residual < BACK_RESIDUAL) & (
            off > OTHER_ORBIT * np.linalg.norm(now.u[lanes] - target, axis=1)
        )
        return np.asarray(left)

    def doubled(self, points: Points) -> tuple[Unknowns, Unknowns]:
        """Return the unknowns of orbits gone round twice, and the tangents of the branches of twice the period."""
        parts, rows = self.cycles(points.u), self.rows
        size = parts * rows
        blocks = points.matrix[:, :size, :size].reshape(len(points.u), parts, rows, parts, rows) * self._weight
        own = np.stack([blocks[:, k, :, k] for k in range(parts)], axis=1)
        values, vectors = np.linalg.eig(chain(own))
        nearest = np.abs(values + 1).argmin(axis=1)
        steps = [np.take_along_axis(vectors, nearest[:, None, None], axis=2)[..., 0].real]
        for k in range(parts - 1):
            steps.append(np.einsum("ijk,ik->ij", own[:, k], steps[-1]))
        half, others = np.concatenate(steps, axis=1), points.u[:, size:]
        u = np.concatenate([points.u[:, :size], points.u[:, :size], 2 * others[:, :1], others[:, 1:]], axis=1)
        tangent = np.concatenate([half, -half, np.zeros_like(others)], axis=1)
        return u, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)

    def evaluate(self, family: Index, u: Unknowns) -> Points:
        states, parts = self.states(family, u), self.cycles(u)
        period = self.period(family, u)
        parameters = {name: np.repeat(x, parts) for name, x in self.parameters_at(family, u).items()}
        duration = np.repeat(np.maximum(period, 0.0) / parts, parts)
        images = images_by_lane(self.flow(parameters, states.reshape(-1, self.rows).T, duration), len(u), parts)
        return self.timed_orbit(family, u, states, period, images)

    def timed_orbit(self, family: Index, u: Unknowns, states: Any, period: PerLane, images: Flowed) -> Points:
        """Return the points with the equations of the orbits."""
        lanes, parts, rows = states.shape
        scale, weight = self.scales[family], self._weight
        off = (images.state - np.roll(states, -1, axis=1)) / scale[:, None]
        jacobian = images.jacobian / scale[:, None, :, None]
        by_states = jacobian[..., :rows] * scale[:, None, None, :]
        by_period = jacobian[..., rows] * (self.period_unit[family] / parts)[:, None, None]
        by_values = jacobian[..., rows + 1 :] * self.unit[family][:, None, None, :]
        others = np.concatenate([by_period[..., None], by_values], axis=3).reshape(lanes, parts * rows, -1)
        matrix = np.concatenate([shooting_matrix(by_states) / weight, others], axis=2)
        shift = images.rate / scale[:, None] * period[:, None, None]
        phase = np.zeros((lanes, 1, u.shape[1]))
        size = np.linalg.norm(shift.reshape(lanes, -1), axis=1)[:, None]
        phase[:, 0, : parts * rows] = shift.reshape(lanes, -1) / np.where(size > 0, size, 1.0)
        swing = (images.greatest.max(axis=1) - images.least.min(axis=1)) / (2 * scale)
        multiple = max(parts // self.parts, 1)
        times = np.repeat((period / multiple)[:, None], multiple, axis=1)
        reached = images.reached.all(axis=1) & (period > 0)
        return Points(
            family=family,
            u=u.copy(),
            tangent=np.full_like(u, np.nan),
            off=np.concatenate([off.reshape(lanes, -1), np.zeros((lanes, 1))], axis=1),
            matrix=np.concatenate([matrix, phase], axis=1),
            times=np.where(reached[:, None], times, np.inf),
            product=transverse(by_states, images.rate[:, 0] / scale),
            impacts=np.zeros(lanes),
            mode_changes=np.asarray(images.mode_changes.sum(axis=1)),
            margin=np.full(lanes, np.inf),
            swing=swing.max(axis=1),
        )


def transverse(
    jacobian: Float[np.ndarray, "lanes parts states states"], rate: Float[np.ndarray, "lanes states"]
) -> Float[np.ndarray, "lanes others others"]:
    """Return the derivative of the map over one period, without the direction of the flow, whose multiplier is 1."""
    product = chain(jacobian)
    first = np.where(np.linalg.norm(rate, axis=1, keepdims=True) > 0, rate, np.eye(rate.shape[1])[0])
    basis = np.linalg.qr(
        np.concatenate([first[..., None], np.broadcast_to(np.eye(rate.shape[1]), product.shape)], axis=2)
    )[0]
    whole = np.swapaxes(basis, 1, 2) @ product @ basis
    return np.asarray(whole[:, 1:, 1:])


def has_free_phase(scene: Scene[Any]) -> bool:
    """Return whether the motions of a scene can be followed without a section: autonomous, and without events."""
    return bool(scene.autonomous) and not scene.guard_names and not scene.redundant and scene.section is not None


def free_problem(
    problem: Problem, families: Index, unknowns: Sequence[np.ndarray]
) -> tuple[TimedProblem, list[np.ndarray]]:
    """Return the equations without a section, and the unknowns of the same orbits.

    **Arguments:** `problem`, `unknowns`: equations with the states at the section, and the orbits of `families`.
    """
    scene, [along], names = problem.scene, problem.along, moving_names(problem.scene)
    count = len(problem.scales)
    begin, period = np.zeros((count, len(names))), np.ones(count)
    parameters = {name: x.copy() for name, x in problem.parameters.items()}
    for number, u in zip(families.tolist(), unknowns, strict=True):
        point = problem.evaluate(np.array([number]), u[None])
        section = dict(zip(scene.return_states, problem.states(point.family, point.u)[0, 0], strict=True))
        begin[number] = [section.get(name, 0.0) for name in names]
        period[number] = point.period[0]
        parameters[along][number] = problem.values(point.family, point.u)[0, 0]
    known = {name: x[families] for name, x in parameters.items()}
    parts, size = _mesh(problem, known, begin[families], period[families])
    scales = np.ones((count, len(names)))
    scales[families] = size
    timed = TimedProblem(
        scene=scene, along=problem.along, parameters=parameters, scales=scales, unit=problem.unit, first=problem.first,
        last=problem.last, most_steps=problem.most_steps, period_unit=period, parts=parts,
    )  # fmt: skip
    states = [begin[families].T]
    for _ in range(parts - 1):
        states.append(np.asarray(timed.flow(known, states[-1], period[families] / parts).state))
    values = parameters[along][families, None]
    u = timed.unknowns_of(families, np.stack([x.T for x in states], axis=1), period[families], values)
    return timed, list(u)


def _mesh(
    problem: Problem, parameters: Mapping[str, PerLane], begin: Float[np.ndarray, "orbits states"], period: PerLane
) -> tuple[int, Float[np.ndarray, "orbits states"]]:
    """Return the number of parts in which no distance grows by more than `GROWTH`, and the scales of the states."""
    flow, rows = Flow(problem.scene, problem.along, FAMILY_ACCURACY, problem.most_steps), begin.shape[1]
    parts = LEAST_PARTS
    while True:
        state, growth = begin.T, 1.0
        least, greatest = state.copy(), state.copy()
        for _ in range(parts):
            end = flow(parameters, state, period / parts)
            state = np.asarray(end.state)
            least, greatest = np.fmin(least, end.least), np.fmax(greatest, end.greatest)
            swing = (greatest - least) / 2
            own = np.moveaxis(np.asarray(end.jacobian)[:, :rows], -1, 0)
            relative = own * swing.T[:, None, :] / np.maximum(swing.T[:, :, None], 1e-300)
            growth = max(growth, float(np.nan_to_num(np.linalg.norm(relative, ord=2, axis=(1, 2))).max()))
        if growth <= GROWTH or parts >= MOST_PARTS:
            break
        parts *= 2
    largest = swing.max(axis=0)
    return parts, np.where(swing > 1e-6 * largest, swing, largest).T
