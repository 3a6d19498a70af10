"""Equations of a family of periodic orbits: p scaled states at the section and one scaled parameter.

The unknowns u of a lane are the states s_1 ... s_p over their scales, and the parameter over its unit. The return map
takes each state to the next and the last to the first. That is one equation less than unknowns: solutions are curves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.models.scenes import Scene
from vibrojax.periodic.newton import chain, images_by_lane, shooting_matrix
from vibrojax.periodic.return_map import MOST_STEPS
from vibrojax.periodic.segments import Segments
from vibrojax.stepping import LOCATED_STRIDE, Accuracy

FAMILY_ACCURACY = Accuracy(tolerance=1e-12, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the return map: special points follow from multipliers, to 1e-8."""

CORRECTOR_RESIDUAL = 1e-10
"""Residual of an accepted point; the next Newton step would leave its square."""

CORRECTOR_MAX_ITERATIONS = 8

Index = Int[np.ndarray, " lanes"]
Unknowns = Float[np.ndarray, "lanes unknowns"]
PerLane = Float[np.ndarray, " lanes"]
Flags = Bool[np.ndarray, " lanes"]


class Evaluation(NamedTuple):
    """The equations evaluated at unknowns; the first axis of all arrays is that of the lanes.

    - `u`: unknowns; `off`: residuals of the equations; `matrix`: their derivatives by the unknowns.
    - `times` (lanes, p) [s]: from each state to the next; infinite where the section is not reached.
    - `product`: derivative of the map over the whole repeat, in scaled states; its eigenvalues are the multipliers.
    - `impacts` (lanes,), `mode_changes` (lanes, modes, 3): see [vibrojax.periodic.return_map.ReturnEvents][].
    - `margin` (lanes,): grazing margin.
    """

    u: Unknowns
    off: Float[np.ndarray, "lanes equations"]
    matrix: Float[np.ndarray, "lanes equations unknowns"]
    times: Float[np.ndarray, "lanes cycles"]
    product: Float[np.ndarray, "lanes states states"]
    impacts: PerLane
    mode_changes: Float[np.ndarray, "lanes modes 3"]
    margin: PerLane

    def of(self, lanes: Any) -> "Evaluation":
        """Return the given lanes, by index or mask."""
        return Evaluation(*(x[lanes] for x in self))

    def put(self, lanes: Any, other: "Evaluation") -> None:
        """Replace the given lanes by those of `other`."""
        for mine, new in zip(self, other, strict=True):
            mine[lanes] = new

    @staticmethod
    def join(parts: "Sequence[Evaluation]") -> "Evaluation":
        """Concatenate the lanes of parts with the same number of unknowns."""
        return Evaluation(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))

    @property
    def residual(self) -> PerLane:
        """Greatest absolute residual; infinite where the section is not reached."""
        worst = np.abs(self.off).max(axis=1)
        return np.where(np.isfinite(worst) & np.isfinite(self.times).all(axis=1), worst, np.inf)

    @property
    def signature(self) -> Float[np.ndarray, "lanes counts"]:
        """Numbers of events of each kind in the repeat."""
        modes = self.mode_changes.shape[1]
        return np.column_stack([self.impacts, self.mode_changes.reshape(len(self.u), modes * 3)])

    @property
    def period(self) -> PerLane:
        """Time of the whole repeat [s]."""
        return self.times.sum(axis=1)


@dataclass(frozen=True)
class Problem:
    """Families of one scene over one parameter.

    - `along`: name of the parameter; `parameters`: of the scene by name, each (families,); that of `along` is unused.
    - `scales` (families, states) of the states; `unit` (families,) of the parameter.
    - `first`, `last` (families,): bounds of the parameter, `first` < `last`.
    - `most_steps`: an orbit that takes more steps counts as not returning.
    """

    scene: Scene[Any]
    along: str
    parameters: Mapping[str, PerLane]
    scales: Float[np.ndarray, "families states"]
    unit: PerLane
    first: PerLane
    last: PerLane
    most_steps: float = MOST_STEPS

    @cached_property
    def _map(self) -> Segments:
        return Segments(self.scene, (self.along,), FAMILY_ACCURACY, self.most_steps)

    @property
    def rows(self) -> int:
        """Number of states of the return map."""
        return self.scales.shape[1]

    def unknowns(self, family: Index, states: Float[np.ndarray, "lanes cycles states"], value: PerLane) -> Unknowns:
        """Return the unknowns of orbits from their states and the parameter's value."""
        scaled = states / self.scales[family][:, None]
        return np.column_stack([scaled.reshape(len(family), -1), value / self.unit[family]])

    def states(self, family: Index, u: Unknowns) -> Float[np.ndarray, "lanes cycles states"]:
        """Return the states at the section."""
        return u[:, :-1].reshape(len(u), -1, self.rows) * self.scales[family][:, None]

    def value(self, family: Index, u: Unknowns) -> PerLane:
        """Return the parameter's value."""
        return u[:, -1] * self.unit[family]

    def evaluate(self, family: Index, u: Unknowns) -> Evaluation:
        """Evaluate the equations at unknowns of lanes, each of the family with the given index."""
        lanes, rows = len(u), self.rows
        states, scale = self.states(family, u), self.scales[family]
        cycles = states.shape[1]
        each = np.repeat(family, cycles)
        parameters = {name: x[each] for name, x in self.parameters.items()}
        parameters[self.along] = np.repeat(self.value(family, u), cycles)
        images = images_by_lane(self._map(parameters, states.reshape(-1, rows).T), lanes, cycles)
        off = (images.state - np.roll(states, -1, axis=1)) / scale[:, None]
        jacobian = images.jacobian / scale[:, None, :, None]
        jacobian[..., :rows] *= scale[:, None, None, :]
        jacobian[..., rows:] *= self.unit[family][:, None, None, None]
        by_parameter = jacobian[..., rows:].reshape(lanes, cycles * rows, 1)
        return Evaluation(
            u=u.copy(),
            off=off.reshape(lanes, -1),
            matrix=np.concatenate([shooting_matrix(jacobian[..., :rows]), by_parameter], axis=2),
            times=np.where(images.seen.returned, images.time, np.inf),
            product=chain(jacobian[..., :rows]),
            impacts=images.seen.impacts.sum(axis=1),
            mode_changes=images.seen.mode_changes.sum(axis=1),
            margin=images.seen.margin.min(axis=1),
        )

    def correct(self, family: Index, guess: Unknowns, row: Unknowns, value: PerLane) -> tuple[Evaluation, Flags]:
        """Return the orbits near `guess` with row u = `value`, by Newton's method, and which of them have converged."""
        best = self.evaluate(family, guess)
        converged = np.zeros(len(guess), bool)
        active = np.arange(len(guess))
        before = np.full(len(guess), np.inf)
        for _ in range(CORRECTOR_MAX_ITERATIONS):
            now = best.of(active)
            short = np.einsum("ij,ij->i", row[active], now.u) - value[active]
            residual = np.maximum(now.residual, np.abs(short))
            done = residual <= CORRECTOR_RESIDUAL
            converged[active[done]] = True
            on = ~done & (residual < np.maximum(before[active], 1e-3)) & np.isfinite(residual)
            before[active] = residual
            active, now, short = active[on], now.of(on), short[on]
            if not len(active):
                break
            step = solve_bordered(now.matrix, row[active], -np.column_stack([now.off, short]))
            sound = np.isfinite(step).all(axis=1)
            active = active[sound]
            if not len(active):
                break
            best.put(active, self.evaluate(family[active], now.u[sound] + step[sound]))
        return best, converged


def solve_bordered(matrix: Float[np.ndarray, "lanes equations unknowns"], row: Unknowns, right: Unknowns) -> Unknowns:
    """Solve for x: matrix x and row x are the first and the last entries of `right`; NaN where that is singular."""
    square = np.concatenate([matrix, row[:, None]], axis=1)
    sound = np.isfinite(square).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    square = np.where(sound[:, None, None], square, np.eye(square.shape[1]))
    # NumPy raises on one singular matrix, and the other lanes would have no solution either.
    sound &= np.linalg.slogdet(square)[0] != 0
    square = np.where(sound[:, None, None], square, np.eye(square.shape[1]))
    return np.where(sound[:, None], np.linalg.solve(square, right[..., None])[..., 0], np.nan)


def unit_tangent(matrix: Float[np.ndarray, "lanes equations unknowns"], along: Unknowns) -> Unknowns:
    """Return the unit tangent of the solution curve on the side of the direction `along`."""
    right = np.zeros_like(along)
    right[:, -1] = 1.0
    tangent = solve_bordered(matrix, along, right)
    return tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
