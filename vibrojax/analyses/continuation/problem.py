"""The equations of a family of periodic orbits: p states at the section and one parameter, over their scales.

The unknowns u of a lane are the states s_1 ... s_p over the scales, and the parameter over its unit. The return map
takes each state to the next and the last to the first: as many equations as states, so that the solutions are curves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.models.scenes import Scene
from vibrojax.periodic.return_map import MOST_STEPS
from vibrojax.periodic.segments import Segments
from vibrojax.stepping import LOCATED_STRIDE, Accuracy

STEPS = Accuracy(tolerance=1e-12, stride=LOCATED_STRIDE, step=np.inf)
"""Of the return map: special points follow from multipliers, to 1e-8."""

Index = Int[np.ndarray, " lanes"]
Unknowns = Float[np.ndarray, "lanes unknowns"]
PerLane = Float[np.ndarray, " lanes"]
Flags = Bool[np.ndarray, " lanes"]


class At(NamedTuple):
    """The equations at unknowns, and what the orbit does there; the first axis of all is the lanes'.

    - `u`: the unknowns; `off`: the equations' residuals; `matrix`: their derivatives by the unknowns.
    - `times` (lanes, p) [s]: from each state to the next; infinite where the section is not reached.
    - `product`: derivative of the map over the whole repeat, by the states over their scales.
    - `impacts` (lanes,) and `entered` (lanes, modes, 3): in the repeat, see [vibrojax.periodic.return_map.Seen][].
    - `margin` (lanes,): how far the order of events is from changing.
    """

    u: Unknowns
    off: Float[np.ndarray, "lanes equations"]
    matrix: Float[np.ndarray, "lanes equations unknowns"]
    times: Float[np.ndarray, "lanes cycles"]
    product: Float[np.ndarray, "lanes states states"]
    impacts: PerLane
    entered: Float[np.ndarray, "lanes modes 3"]
    margin: PerLane

    def of(self, lanes: Any) -> "At":
        """Some of the lanes, by index or mask."""
        return At(*(one[lanes] for one in self))

    def put(self, lanes: Any, other: "At") -> None:
        """Replace lanes by those of another."""
        for mine, new in zip(self, other, strict=True):
            mine[lanes] = new

    @property
    def residual(self) -> PerLane:
        """The greatest equation's; infinite where the section is not reached."""
        worst = np.abs(self.off).max(axis=1)
        return np.where(np.isfinite(worst) & np.isfinite(self.times).all(axis=1), worst, np.inf)

    @property
    def signature(self) -> Float[np.ndarray, "lanes counts"]:
        """What events the repeat consists of, as counts."""
        modes = self.entered.shape[1]
        return np.column_stack([self.impacts, self.entered.reshape(len(self.u), modes * 3)])


def joined_at(parts: Sequence[At]) -> At:
    """The lanes of all parts, which have as many unknowns."""
    return At(*(np.concatenate(some) for some in zip(*parts, strict=True)))


@dataclass(frozen=True)
class Problem:
    """Families of one scene over one parameter.

    - `along`: its name; `parameters`: of the scene by name, each (families,), that of `along` not being asked for.
    - `scales` (families, states): of the states; `unit` (families,): of the parameter.
    - `first`, `last` (families,): the bounds of the parameter, `first` < `last`.
    - `most_steps`: after which an orbit is taken not to return.
    """

    scene: Scene[Any]
    along: str
    parameters: Mapping[str, PerLane]
    scales: Float[np.ndarray, "families states"]
    unit: PerLane
    first: PerLane
    last: PerLane
    most_steps: float = MOST_STEPS

    def __post_init__(self) -> None:
        object.__setattr__(self, "_map", Segments(self.scene, (self.along,), STEPS, self.most_steps))

    @property
    def rows(self) -> int:
        """Number of states."""
        return self.scales.shape[1]

    def cycles(self, unknowns: int) -> int:
        """Returns of a repeat that so many unknowns belong to."""
        return (unknowns - 1) // self.rows

    def unknowns(self, family: Index, states: Float[np.ndarray, "lanes cycles states"], value: PerLane) -> Unknowns:
        """The unknowns of orbits."""
        scaled = states / self.scales[family][:, None]
        return np.column_stack([scaled.reshape(len(family), -1), value / self.unit[family]])

    def states(self, family: Index, u: Unknowns) -> Float[np.ndarray, "lanes cycles states"]:
        """The states at the section."""
        return u[:, :-1].reshape(len(u), -1, self.rows) * self.scales[family][:, None]

    def value(self, family: Index, u: Unknowns) -> PerLane:
        """The parameter."""
        return u[:, -1] * self.unit[family]

    def at(self, family: Index, u: Unknowns) -> At:
        """The equations at unknowns of lanes, each of one of the families."""
        lanes, cycles, rows = len(u), self.cycles(u.shape[1]), self.rows
        states, scale = self.states(family, u), self.scales[family]
        each = np.repeat(family, cycles)
        given = {name: x[each] for name, x in self.parameters.items()}
        given[self.along] = np.repeat(self.value(family, u), cycles)
        mapped = self._map(given, states.reshape(-1, rows).T)  # type: ignore[attr-defined]

        def by_lane(x: Any) -> np.ndarray:
            return np.moveaxis(np.asarray(x), -1, 0).reshape(lanes, cycles, *np.shape(x)[:-1])

        seen = mapped.seen
        off = (by_lane(mapped.state) - np.roll(states, -1, axis=1)) / scale[:, None]
        jacobian = by_lane(mapped.jacobian) / scale[:, None, :, None]
        jacobian[..., :rows] *= scale[:, None, None, :]
        jacobian[..., rows:] *= self.unit[family][:, None, None, None]
        blocks = np.zeros((lanes, cycles, rows, cycles, rows))
        for k in range(cycles):
            blocks[:, k, :, k] += jacobian[:, k, :, :rows]
            blocks[:, k, :, (k + 1) % cycles] -= np.eye(rows)
        matrix = np.concatenate(
            [blocks.reshape(lanes, cycles * rows, -1), jacobian[..., rows:].reshape(lanes, cycles * rows, 1)], axis=2
        )
        product = jacobian[:, 0, :, :rows]
        for k in range(1, cycles):
            product = jacobian[:, k, :, :rows] @ product
        return At(
            u=u.copy(),
            off=off.reshape(lanes, -1),
            matrix=matrix,
            times=np.where(by_lane(seen.returned), by_lane(mapped.time), np.inf),
            product=product,
            impacts=by_lane(seen.impacts).sum(axis=1),
            entered=by_lane(seen.entered).sum(axis=1),
            margin=by_lane(seen.margin).min(axis=1),
        )


def solved(matrix: Float[np.ndarray, "lanes equations unknowns"], row: Unknowns, right: Unknowns) -> Unknowns:
    """The solution x of matrix x = right but for its last, row x = the last of `right`; NaN where there is none."""
    square = np.concatenate([matrix, row[:, None]], axis=1)
    sound = np.isfinite(square).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    square = np.where(sound[:, None, None], square, np.eye(square.shape[1]))
    # What others come to must not depend on a lane without a solution beside them.
    sound &= np.linalg.slogdet(square)[0] != 0
    square = np.where(sound[:, None, None], square, np.eye(square.shape[1]))
    return np.where(sound[:, None], np.linalg.solve(square, right[..., None])[..., 0], np.nan)


def tangent(matrix: Float[np.ndarray, "lanes equations unknowns"], along: Unknowns) -> Unknowns:
    """The unit tangent of the curve of solutions, on the side of the direction `along`."""
    right = np.zeros_like(along)
    right[:, -1] = 1.0
    found = solved(matrix, along, right)
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def corrected(
    problem: Problem, family: Index, guess: Unknowns, row: Unknowns, value: PerLane, within: float = 1e-10
) -> tuple[At, Flags]:
    """The orbits near `guess` for which row u = `value`, by Newton's method; and which of them were found."""
    best = problem.at(family, guess)
    found = np.zeros(len(guess), bool)
    active = np.arange(len(guess))
    before = np.full(len(guess), np.inf)
    for _ in range(8):
        now = best.of(active)
        short = np.einsum("ij,ij->i", row[active], now.u) - value[active]
        residual = np.maximum(now.residual, np.abs(short))
        done = residual <= within
        found[active[done]] = True
        on = ~done & (residual < np.maximum(before[active], 1e-3)) & np.isfinite(residual)
        before[active] = residual
        active, now, short = active[on], now.of(on), short[on]
        if not len(active):
            break
        step = solved(now.matrix, row[active], -np.column_stack([now.off, short]))
        sound = np.isfinite(step).all(axis=1)
        active = active[sound]
        if not len(active):
            break
        best.put(active, problem.at(family[active], now.u[sound] + step[sound]))
    return best, found
