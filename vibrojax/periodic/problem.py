"""Equations of a family of periodic orbits: p scaled states at the section and one or two scaled parameters.

The unknowns u of a lane are the states s_1 ... s_p divided by their scales, and the parameters divided by their units.
The equations require that the return map takes each state to the next, and the last to the first. There is one equation
fewer than unknowns (with two parameters, a further equation is added), so solutions form curves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.errors import Place, shown
from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.margin import over_period
from vibrojax.periodic.newton import chain, images_by_lane, multipliers, shooting_matrix, solve
from vibrojax.periodic.return_map import Segments
from vibrojax.scenes import SCENES, Scene
from vibrojax.stepping import LOCATED_STRIDE, Accuracy

FAMILY_ACCURACY = Accuracy(tolerance=1e-12, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the return map, chosen so that multipliers, which determine special points, are accurate to 1e-8."""

CORRECTOR_RESIDUAL = 1e-10
"""Largest residual of an accepted point; another Newton step would reduce the residual to about its square."""

STEEP_EQUATION = 1e4
"""Slope of an equation in scaled unknowns above which rounding errors may exceed `CORRECTOR_RESIDUAL`."""

CORRECTOR_MAX_ITERATIONS = 8

CRITICAL = 0.3
"""Distance of a multiplier from 1 below which another branch may be so near that a step can lead to it."""

AT_CROSSING = 1e-7
"""Largest value of the least singular value of the equations' matrix at a branch point, where steps back lead to either
branch."""

BACK_ITERATIONS, BACK_RESIDUAL, OTHER_ORBIT = 6, 1e-6, 1e-2
"""Newton steps back to the point before; residual up to which they have found an orbit; and distance of that orbit from
the point before, relative to the step, from which on it is another one."""

MAX_MULTIPLIER = 1e7
"""Multiplier modulus up to which branches are continued. Beyond it, rounding errors grow to visible differences within
a few periods."""

UNITS_PER_SPAN = 8
"""Number of units of a scaled parameter between its bounds, which weights parameter steps against state steps."""

Index = Int[np.ndarray, " lanes"]
Unknowns = Float[np.ndarray, "lanes unknowns"]
PerLane = Float[np.ndarray, " lanes"]
PerSegment = Float[np.ndarray, " segments"]
Flags = Bool[np.ndarray, " lanes"]


def check_changes_orbits(place: Place, scene: Scene[Any], name: str) -> None:
    """Raise `InputError` at `place` if the parameter `name` acts only on what the scene's driving part drives."""
    if name not in scene.driving_part().parameters():
        coupled = f"coupled-{scene.name}"
        other = f", or use {coupled}, where it does" if coupled in SCENES else ""
        fault = f"{name} does not act on the orbits of scene {shown(scene.name)}"
        raise place.error(f"{fault}: no orbit changes along it; vary it in a sweep{other}")


OF_STATES = ("beyond-a-stop", "negative-normal-force", "not-finite")
"""Faults that depend on the state at which a motion begins."""


def refusals(scene: Scene[Any], parameters: Mapping[str, PerLane]) -> list[str]:
    """Return for each lane why `simulate` refuses its parameters whatever the start, or ""."""
    count = len(next(iter(parameters.values())))
    refused, state = scene.refused(parameters), (np.zeros(count),) * len(scene.start_states)
    faults = [] if refused is None else [refused]
    faults += [(reason, mask) for reason, _, mask in scene.start_faults(parameters, state)]
    found = [""] * count
    for reason, mask in ((reason, mask) for reason, mask in faults if reason not in OF_STATES):
        for k in np.flatnonzero(np.broadcast_to(np.asarray(mask), count)).tolist():
            found[k] = found[k] or reason.replace("-", " ")
    return found


class Points(NamedTuple):
    """Points at which the equations are evaluated; the first axis of all arrays is the lane.

    - `family`: index of the family; `u`: unknowns.
    - `tangent`: unit tangent of the solution curve; NaN where it has not been computed.
    - `off`: residuals of the equations; `matrix`: their derivatives with respect to the unknowns.
    - `times` (lanes, p) [s]: time from each state to the next; infinite where the section is not reached.
    - `product`: derivative of the map over one period of the motion, in scaled states; its eigenvalues are the
      multipliers.
    - `impacts` (lanes,), `mode_changes` (lanes, modes, 3): see [vibrojax.periodic.return_map.ReturnEvents][]; a mode
      that never changes counts 1/2 at its value.
    - `margin` (lanes,): grazing margin.
    - `swing` (lanes,): largest amplitude of a state, relative to its scale.
    """

    family: Index
    u: Unknowns
    tangent: Unknowns
    off: Float[np.ndarray, "lanes equations"]
    matrix: Float[np.ndarray, "lanes equations unknowns"]
    times: Float[np.ndarray, "lanes cycles"]
    product: Float[np.ndarray, "lanes states states"]
    impacts: PerLane
    mode_changes: Float[np.ndarray, "lanes modes 3"]
    margin: PerLane
    swing: PerLane

    def of(self, lanes: Any) -> "Points":
        return Points(*(x[lanes] for x in self))

    def put(self, lanes: Any, other: "Points") -> None:
        """Replace the given lanes by the lanes of `other`, in place."""
        for mine, new in zip(self, other, strict=True):
            mine[lanes] = new

    @staticmethod
    def join(parts: "Sequence[Points]") -> "Points":
        return Points(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))

    def along(self, direction: Unknowns) -> "Points":
        """Return the points with the unit tangents that form an acute angle with `direction`."""
        right = np.zeros_like(direction)
        right[:, -1] = 1.0
        tangent = solve_bordered(self.matrix, direction, right)
        return self._replace(tangent=tangent / np.linalg.norm(tangent, axis=1, keepdims=True))

    @property
    def residual(self) -> PerLane:
        """Greatest absolute residual; infinite where the section is not reached.

        Next to a graze slopes grow without limit, and rounding errors with them: residuals of steep equations are
        divided by the slope relative to `STEEP_EQUATION`.
        """
        steepness = np.linalg.norm(self.matrix, axis=2) / STEEP_EQUATION
        worst = (np.abs(self.off) / np.maximum(steepness, 1.0)).max(axis=1)
        return np.where(np.isfinite(worst) & np.isfinite(self.times).all(axis=1), worst, np.inf)

    @property
    def signature(self) -> Float[np.ndarray, "lanes counts"]:
        """Numbers of events of each kind in one period of the motion."""
        modes = self.mode_changes.shape[1]
        return np.column_stack([self.impacts, self.mode_changes.reshape(len(self.u), modes * 3)])

    @property
    def period(self) -> PerLane:
        """Duration of one period of the motion, over all p section crossings [s]."""
        return self.times.sum(axis=1)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Families of one scene over one parameter, or curves over two.

    - `along`: names of the varied parameters; a continuation ends at the bounds of the last one.
    - `parameters`: the scene's parameters by name, each (families,); the values of `along` are unused.
    - `scales` (families, states): scales of the states.
    - `unit`, `first`, `last` (families, varied parameters): units and bounds of the varied parameters.
    - `refused`: why motions are refused behind a bound, by number of the family, and True for the last bound.
    - `at_section`: whether an orbit is described by its states at the section.
    - `closes`: whether equal orbits have equal unknowns, so that a branch can be seen to be back where it began.
    - `noun`: word for a solution in notes; `weight`: factor of the scaled states among the unknowns.
    - `most_growth`: modulus of a multiplier beyond which a branch ends; `impossible`: kinds of special points that the
      motions cannot have.
    """

    at_section: ClassVar[bool] = True
    closes: ClassVar[bool] = True
    most_growth: ClassVar[float] = MAX_MULTIPLIER
    noun: ClassVar[str] = "orbit"
    impossible: tuple[str, ...] = ()
    scene: Scene[Any]
    along: tuple[str, ...]
    parameters: Mapping[str, PerLane]
    scales: Float[np.ndarray, "families states"]
    unit: Float[np.ndarray, "families varied"]
    first: Float[np.ndarray, "families varied"]
    last: Float[np.ndarray, "families varied"]
    refused: Mapping[tuple[int, bool], str] = field(default_factory=dict)

    @cached_property
    def _map(self) -> Segments:
        return Segments(self.scene, self.along, FAMILY_ACCURACY)

    @property
    def rows(self) -> int:
        return self.scales.shape[1]

    @property
    def weight(self) -> float:
        return 1.0

    @cached_property
    def moving(self) -> list[str]:
        """Names of the states that move."""
        return moving_names(self.scene)

    @property
    def state_names(self) -> Sequence[str]:
        """Names of the states in the equations."""
        return self.scene.return_states if self.at_section else self.moving

    @property
    def places(self) -> list[int]:
        """Indices of the equations' states among those that move."""
        return [self.moving.index(name) for name in self.state_names]

    def cycles(self, u: Unknowns) -> int:
        """Return the number of section crossings per period that belongs to the number of unknowns."""
        return (u.shape[1] - len(self.along)) // self.rows

    def unknowns(
        self, family: Index, states: Float[np.ndarray, "lanes cycles states"], values: Float[np.ndarray, "lanes varied"]
    ) -> Unknowns:
        scaled = states / self.scales[family][:, None]
        return np.column_stack([scaled.reshape(len(family), -1), values / self.unit[family]])

    def states(self, family: Index, u: Unknowns) -> Float[np.ndarray, "lanes cycles states"]:
        """Return the states at the section that belong to the unknowns `u`."""
        return u[:, : -len(self.along)].reshape(len(u), self.cycles(u), self.rows) * self.scales[family][:, None]

    def values(self, family: Index, u: Unknowns) -> Float[np.ndarray, "lanes varied"]:
        """Return the varied parameters."""
        return u[:, -len(self.along) :] * self.unit[family]

    def parameters_at(self, family: Index, u: Unknowns) -> dict[str, PerLane]:
        """Return all parameters of lanes, by name."""
        varied = dict(zip(self.along, self.values(family, u).T, strict=True))
        return {name: x[family] for name, x in self.parameters.items()} | varied

    def segments(
        self, family: Index, u: Unknowns
    ) -> tuple[dict[str, PerSegment], Float[np.ndarray, "states segments"]]:
        """Return the parameters and the initial states of the segments between section crossings."""
        states = self.states(family, u)
        parameters = {name: np.repeat(x, states.shape[1]) for name, x in self.parameters_at(family, u).items()}
        return parameters, states.reshape(-1, self.rows).T

    def scaled(
        self, family: Index, jacobian: Float[np.ndarray, "lanes cycles rows columns"]
    ) -> Float[np.ndarray, "lanes cycles rows columns"]:
        """Return scaled derivatives of images with respect to the scaled states and parameters."""
        scale = self.scales[family][:, None]
        return jacobian / scale[..., None] * np.column_stack([self.scales[family], self.unit[family]])[:, None, None]

    def halves(self, points: Points) -> Unknowns:
        """Return the difference of the two halves of orbits; of an odd number of returns, the unknowns."""
        half, odd = divmod(self.cycles(points.u), 2)
        half *= self.rows
        return points.u if odd else points.u[:, :half] - points.u[:, half : 2 * half]

    def doubled(self, points: Points) -> tuple[Unknowns, Unknowns]:
        """Return the unknowns of orbits gone round twice, and the tangents of the branches of twice the period.

        The tangent is the eigenvector of the multiplier -1: after one period of the original orbit, a neighbouring
        state is on the opposite side of that orbit.
        """
        parts, rows = self.cycles(points.u), self.rows
        size = parts * rows
        blocks = points.matrix[:, :size, :size].reshape(len(points.u), parts, rows, parts, rows) * self.weight
        own = np.stack([blocks[:, k, :, k] for k in range(parts)], axis=1)
        values, vectors = np.linalg.eig(points.product if self.at_section else chain(own))
        nearest = np.abs(values + 1).argmin(axis=1)
        steps = [np.take_along_axis(vectors, nearest[:, None, None], axis=2)[..., 0].real]
        for k in range(parts - 1):
            steps.append(np.einsum("ijk,ik->ij", own[:, k], steps[-1]))
        half, others = np.concatenate(steps, axis=1), points.u[:, size:].copy()
        others[:, : -len(self.along)] *= 2  # the period, if it is among the unknowns
        u = np.concatenate([points.u[:, :size], points.u[:, :size], others], axis=1)
        tangent = np.concatenate([half, -half, np.zeros_like(others)], axis=1)
        return u, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)

    def halved(self, points: Points) -> Points:
        """Return the orbits of half the period, of orbits that go round twice."""
        size = self.cycles(points.u) * self.rows
        others = points.u[:, size:].copy()
        others[:, : -len(self.along)] /= 2  # the period, if it is among the unknowns
        return self.evaluate(points.family, np.concatenate([points.u[:, : size // 2], others], axis=1))

    def shift(self, points: Points) -> Unknowns:
        """Return the direction along which orbits are the same but for their phase: none at a section."""
        return np.zeros_like(points.u)

    def stretch(self, points: Points) -> PerLane:
        """Return the factor of the longest step behind points."""
        return np.ones(len(points.u))

    def left_branch(self, last: Points, now: Points) -> Flags:
        """Return a mask of points from which a step back does not lead to the point before: they are on another branch.

        Where a multiplier is near 1, another branch may be so near that a step leads to it.
        """
        near = np.minimum(*(np.abs(multipliers(x.product) - 1).min(axis=1, initial=np.inf) for x in (last, now)))
        lanes = np.flatnonzero((near < CRITICAL) & (now.signature == last.signature).all(axis=1))
        departed = np.zeros(len(now.u), bool)
        lanes = lanes[np.linalg.svd(last.matrix[lanes], compute_uv=False)[:, -1] > AT_CROSSING]
        if not len(lanes):
            return departed
        back, target, row = now.of(lanes), last.u[lanes], now.tangent[lanes]
        level = np.einsum("ij,ij->i", row, target)
        u = back.u + (level - np.einsum("ij,ij->i", row, back.u))[:, None] * row
        for _ in range(BACK_ITERATIONS):
            point = self.evaluate(back.family, u)
            short = np.einsum("ij,ij->i", row, u) - level
            u = u + np.nan_to_num(solve_bordered(point.matrix, row, -np.column_stack([point.off, short])))
        off, shift = u - target, self.shift(point)
        off = np.linalg.norm(off - np.einsum("ij,ij->i", off, shift)[:, None] * shift, axis=1)
        step = np.linalg.norm(now.u[lanes] - target, axis=1)
        departed[lanes] = (point.residual < BACK_RESIDUAL) & (off > OTHER_ORBIT * step)
        return departed

    def evaluate(self, family: Index, u: Unknowns) -> Points:
        """Evaluate the equations at the unknowns `u` of lanes; `family`: index of each lane's family."""
        parameters, states = self.segments(family, u)
        images = images_by_lane(self._map(parameters, states), len(u), self.cycles(u))
        return self.orbit(family, u, images, self.scaled(family, images.jacobian))

    def orbit(self, family: Index, u: Unknowns, images: Any, jacobian: np.ndarray) -> Points:
        """Return the points with the equations of the orbits; `jacobian`: scaled derivatives of the `images`."""
        lanes, cycles, rows, _ = jacobian.shape
        off = (images.state - np.roll(self.states(family, u), -1, axis=1)) / self.scales[family][:, None]
        swing = (images.seen.greatest.max(axis=1) - images.seen.least.min(axis=1)) / (2 * self.scales[family])
        changes = images.seen.mode_changes.sum(axis=1)
        held = ~changes.any(axis=-1, keepdims=True)
        by_parameters = jacobian[..., rows:].reshape(lanes, cycles * rows, -1)
        return Points(
            family=family,
            u=u.copy(),
            tangent=np.full_like(u, np.nan),
            off=off.reshape(lanes, -1),
            matrix=np.concatenate([shooting_matrix(jacobian[..., :rows]), by_parameters], axis=2),
            times=np.where(images.seen.returned, images.time, np.inf),
            product=chain(jacobian[..., :rows]),
            impacts=images.seen.impacts.sum(axis=1),
            mode_changes=changes + 0.5 * held * images.seen.modes[:, 0],
            margin=over_period(images.seen.margin)[:, 0],
            swing=swing.max(axis=1),
        )

    def correct(self, family: Index, guess: Unknowns, row: Unknowns, value: PerLane) -> tuple[Points, Flags]:
        """Return the orbits near `guess` that satisfy row u = `value`, and a mask of the orbits that have converged.

        The orbits are computed by Newton's method; their tangents form an acute angle with `row`.
        """
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
            step = solve_bordered(now.matrix, row[active], -np.column_stack([now.off, short]))
            sound = np.isfinite(step).all(axis=1)
            active = active[sound]
            if not len(active):
                break
            best.put(active, self.evaluate(family[active], now.u[sound] + step[sound]))
        best.put(converged, self.off_stops(best.of(converged), row[converged], value[converged]))
        return best.along(row), converged

    def touching(self, points: Points) -> Flags:
        """Return a mask of orbits whose margin is not above the accepted residual; curves follow such orbits."""
        return (points.margin <= CORRECTOR_RESIDUAL) & self.at_section & (len(self.along) == 1)

    def off_stops(self, points: Points, row: Unknowns, value: PerLane) -> Points:
        """Return accepted points, improved where the margin is not above the accepted residual.

        Such a residual may put a state that rests or sticks at a stop into the stop, which it then strikes.
        """
        lanes = np.flatnonzero(self.touching(points))
        if len(lanes):
            now, row = points.of(lanes), row[lanes]
            short = np.einsum("ij,ij->i", row, now.u) - value[lanes]
            step = solve_bordered(now.matrix, row, -np.column_stack([now.off, short]))
            again = self.evaluate(now.family, now.u + np.nan_to_num(step))
            better = again.residual < now.residual
            points.put(lanes[better], again.of(better))
        return points


def solve_bordered(matrix: Float[np.ndarray, "lanes equations unknowns"], row: Unknowns, right: Unknowns) -> Unknowns:
    """Solve matrix x = `right[:-1]`, row x = `right[-1]` for x in each lane; x is NaN if the system is singular."""
    return solve(np.concatenate([matrix, row[:, None]], axis=1), right[..., None])[..., 0]


def towards(u: Unknowns, sign: PerLane | float) -> Unknowns:
    """Return the direction along the parameter, increasing or decreasing by `sign`."""
    direction = np.zeros_like(u)
    direction[:, -1] = sign
    return direction
