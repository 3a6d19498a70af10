"""Equations of periodic orbits of an autonomous system, by multiple shooting over equal parts of the period.

The unknowns are the states at the beginning of each part, the period, and one or two parameters, all scaled. The
equations require that the flow over a part takes each state to the next, and the last to the first. A shift in time
along the orbit is another solution. The last row of the equations therefore fixes the phase: steps and tangents are
orthogonal to that shift, so that the phase condition moves along with the orbit (Doedel, Keller and Kernevez, *Int. J.
Bifurcation and Chaos* 1, 1991, 745). No section is needed, so that families do not end where orbits leave one.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.flow_map import flowed
from vibrojax.periodic.newton import chain, images_by_lane, shooting_matrix
from vibrojax.periodic.problem import FAMILY_ACCURACY, Flags, Index, PerLane, Points, Problem, Unknowns
from vibrojax.periodic.return_map import Segments
from vibrojax.scenes import Scene

LONG = 10.0
"""Period, relative to that of the first orbit, from which on the longest step grows with the period."""

NO_SWING = 1e-3
"""Amplitude, relative to that of the point before, below which a step has led to an equilibrium."""


@dataclass(frozen=True, kw_only=True)
class TimedProblem(Problem):
    """Families of one autonomous system over one parameter; see [vibrojax.periodic.problem.Problem][].

    - `scales` (families, states): scales of all moving states.
    - `period_unit` (families,): unit of the period [s]; `parts`: number of parts of a period of the first orbits.
    """

    at_section: ClassVar[bool] = False
    closes: ClassVar[bool] = False
    period_unit: PerLane
    parts: int

    @cached_property
    def flow(self) -> Segments:
        return Segments(self.scene, self.along, FAMILY_ACCURACY, program=flowed)

    def cycles(self, u: Unknowns) -> int:
        """Return the number of parts."""
        return (u.shape[1] - 1 - len(self.along)) // self.rows

    @property
    def weight(self) -> float:
        """Factor of the unknown states, so that the norm of a change does not grow with the number of parts."""
        return float(self.parts) ** -0.5

    @classmethod
    def of(
        cls, problem: Problem, families: Index, scales: Float[np.ndarray, "orbits states"], period: PerLane, parts: int
    ) -> "TimedProblem":
        """Return the equations without a section; `scales`, `period`: of one orbit for each of `families`."""
        count = len(problem.scales)
        every, unit = np.ones((count, scales.shape[1])), np.ones(count)
        every[families], unit[families] = scales, period
        return cls(
            scene=problem.scene, along=problem.along, parameters=problem.parameters, scales=every, unit=problem.unit,
            first=problem.first, last=problem.last, refused=problem.refused, period_unit=unit, parts=parts,
            # In the plane, orbits do not cross.
            impossible=("period-doubling", "torus") if scales.shape[1] == 2 else (),
        )  # fmt: skip

    def timed_unknowns(
        self,
        family: Index,
        states: Float[np.ndarray, "lanes parts states"],
        period: PerLane,
        values: Float[np.ndarray, "lanes varied"],
    ) -> Unknowns:
        scaled = states / self.scales[family][:, None] * self.weight
        periods = period / self.period_unit[family]
        return np.column_stack([scaled.reshape(len(family), -1), periods, values / self.unit[family]])

    def states(self, family: Index, u: Unknowns) -> Float[np.ndarray, "lanes parts states"]:
        own = u[:, : -1 - len(self.along)].reshape(len(u), self.cycles(u), self.rows)
        return own * self.scales[family][:, None] / self.weight

    def period(self, family: Index, u: Unknowns) -> PerLane:
        return np.asarray(u[:, -1 - len(self.along)] * self.period_unit[family])

    def left_branch(self, last: Points, now: Points) -> Flags:
        return super().left_branch(last, now) | (now.swing < NO_SWING * last.swing)

    def stretch(self, points: Points) -> PerLane:
        return np.asarray(np.maximum(points.u[:, -1 - len(self.along)] / LONG, 1.0))

    def shift(self, points: Points) -> Unknowns:
        return points.matrix[:, -1]

    def evaluate(self, family: Index, u: Unknowns) -> Points:
        states, parts = self.states(family, u), self.cycles(u)
        period = self.period(family, u)
        parameters = {name: np.repeat(x, parts) for name, x in self.parameters_at(family, u).items()}
        duration = np.repeat(np.maximum(period, 0.0) / parts, parts)
        images = images_by_lane(self.flow(parameters, states.reshape(-1, self.rows).T, duration), len(u), parts)
        lanes, rows = len(u), self.rows
        scale, weight = self.scales[family], self.weight
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
            product=transverse(by_states, images.rate / scale[:, None]),
            impacts=np.zeros(lanes),
            mode_changes=np.asarray(images.mode_changes.sum(axis=1)),
            margin=np.full(lanes, np.inf),
            swing=swing.max(axis=1),
        )


def transverse(
    jacobian: Float[np.ndarray, "lanes parts states states"], rate: Float[np.ndarray, "lanes parts states"]
) -> Float[np.ndarray, "lanes others others"]:
    """Return the derivative of the map over one period, without the direction of the flow, whose multiplier is 1.

    Each part is projected onto the directions across the flow (`rate`, at its beginning). Removing the direction once,
    from the product, would leave errors that have grown over the whole period.
    """
    states = rate.shape[-1]
    along = np.where(np.linalg.norm(rate, axis=2, keepdims=True) > 0, rate, np.eye(states)[0])
    every = np.broadcast_to(np.eye(states), (*rate.shape, states))
    basis = np.linalg.qr(np.concatenate([along[..., None], every], axis=3))[0]
    # One orientation everywhere: in the plane, the multiplier is then positive as it must be.
    sign = np.sign(np.einsum("ijk,ijk->ij", basis[..., 0], along) * np.linalg.det(basis))
    basis[..., -1] *= sign[..., None]
    across = basis[..., 1:]
    return chain(np.swapaxes(np.roll(across, -1, axis=1), 2, 3) @ jacobian @ across)


def has_free_phase(scene: Scene[Any]) -> bool:
    """Return whether the motions of a scene can be followed without a section: autonomous, and without events."""
    return bool(scene.autonomous) and not scene.guard_names and not scene.redundant and scene.section is not None
