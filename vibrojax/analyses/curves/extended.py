"""Equations of a special point in two parameters: those of its orbit, and the condition of its kind.

The unknowns are the scaled states at the section and two scaled parameters. The last equation is one of these, each of
which is regular at the curve itself:

- fold and period doubling: the smallest singular value of the orbit's shooting matrix, periodic or antiperiodic, with
  the sign of its determinant;
- torus: that of C - 1, where C is the second compound of the monodromy matrix, whose eigenvalues are the products of
  two multipliers (Kuznetsov, *Elements of Applied Bifurcation Theory*, section 10.2);
- Hopf: the growth rate of the equilibrium ([vibrojax.analyses.curves.hopf][]);
- grazing and stick: the signed margin of the event ([vibrojax.analyses.curves.event_map][]).

The derivative of a singular value with the vectors w and v is w dA v. Second derivatives of the return map are
symmetric, so w dA v needs the derivative of the Jacobian along v only. Forward mode over forward mode takes 2.5 times
as long as the Jacobian, and a difference of two Jacobians twice as long, but the difference fails close to grazing.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.continuation.hopf import Field, moving_states
from vibrojax.analyses.continuation.problem import FAMILY_ACCURACY, Index, PerLane, Points, Problem, Unknowns
from vibrojax.analyses.curves.event_map import conditions_of, event_mapped
from vibrojax.analyses.curves.hopf import HopfEquations
from vibrojax.analyses.curves.singular import compound, compound_along, segment_product, signed_singular
from vibrojax.compile.xla import workers
from vibrojax.periodic.newton import chain, images_by_lane, shooting_matrix
from vibrojax.periodic.return_map import Segments, in_calls
from vibrojax.periodic.variations import DERIVATIVE_ACCURACY, second_variation
from vibrojax.stepping import Accuracy, Located

FLIP_STEP = 1e-3
"""Scaled difference of states from which third derivatives are taken. Second derivatives are exact."""

EVENTS = ("grazing", "stick")
"""Kinds of special points that are conditions on events, not on multipliers."""


def antiperiodic(shooting: Float[np.ndarray, "lanes n n"], rows: int) -> Float[np.ndarray, "lanes n n"]:
    """Return shooting matrices, with + instead of - the first state, which has `rows` numbers, at the end."""
    matrix = shooting.copy()
    matrix[:, -rows:, :rows] += 2 * np.eye(rows)
    return matrix


@dataclass(frozen=True, kw_only=True)
class CurveProblem(Problem):
    """Equations of curves, each of which takes the place of a family; `along` is the second parameter.

    - `other`: name of the first parameter, along which the special points were found; `other_unit` (curves,): its unit;
      `other_first`, `other_last` (curves,): its bounds.
    - `kinds` (curves,): kind of each curve; `chosen` (curves, conditions): its condition on an event, see
      [vibrojax.analyses.curves.event_map.conditions_of][].
    """

    other: str
    other_unit: PerLane
    other_first: PerLane
    other_last: PerLane
    kinds: np.ndarray
    chosen: Float[np.ndarray, "curves conditions"]

    @cached_property
    def _smooth_map(self) -> Segments:
        return Segments(self.scene, (self.other, self.along), FAMILY_ACCURACY, self.most_steps)

    def point(self, curve: Index, states: Float[np.ndarray, "lanes cycles states"], values: np.ndarray) -> Unknowns:
        """Return the unknowns of orbits at `values` (lanes, 2) of the two parameters."""
        scaled = (states / self.scales[curve][:, None]).reshape(len(curve), -1)
        return np.column_stack([scaled, values[:, 0] / self.other_unit[curve], values[:, 1] / self.unit[curve]])

    def with_states(
        self, family: Index, u: Unknowns, states: Float[np.ndarray, "lanes cycles states"]
    ) -> Float[np.ndarray, "lanes others"]:
        return self.point(family, states, self.values(family, u))

    def parameters_at(self, family: Index, u: Unknowns) -> dict[str, PerLane]:
        values = self.values(family, u).T
        return {name: x[family] for name, x in self.parameters.items()} | {self.other: values[0], self.along: values[1]}

    def states(self, curve: Index, u: Unknowns) -> Float[np.ndarray, "lanes cycles states"]:
        return u[:, :-2].reshape(len(u), (u.shape[1] - 2) // self.rows, self.rows) * self.scales[curve][:, None]

    def values(self, curve: Index, u: Unknowns) -> Float[np.ndarray, "lanes 2"]:
        """Return the two parameters of each lane."""
        return np.column_stack([u[:, -2] * self.other_unit[curve], u[:, -1] * self.unit[curve]])

    def evaluate(self, family: Index, u: Unknowns) -> Points:
        on_event, at_rest = np.isin(self.kinds[family], EVENTS), self.kinds[family] == "hopf"
        parts, order = [], []
        ways = (~on_event & ~at_rest, self._smooth), (on_event, self._on_event), (at_rest, self._at_rest)
        for mask, evaluated in ways:
            lanes = np.flatnonzero(mask)
            if len(lanes):
                parts.append(evaluated(family[lanes], u[lanes]))
                order.append(lanes)
        return Points.join(parts).of(np.argsort(np.concatenate(order)))

    def margins(self, curve: Index, u: Unknowns, chosen: np.ndarray) -> Float[np.ndarray, "lanes cycles"]:
        """Return the signed margins of the `chosen` conditions (lanes, conditions) between the section crossings."""
        images, _ = self._past_events(curve, u, chosen)
        return np.asarray(images.seen.margin[:, :, 0])

    def _inputs(self, curve: Index, u: Unknowns) -> tuple[dict[str, np.ndarray], np.ndarray]:
        states = self.states(curve, u)
        each, values = np.repeat(curve, states.shape[1]), np.repeat(self.values(curve, u), states.shape[1], axis=0)
        p = {name: x[each] for name, x in self.parameters.items()}
        return p | {self.other: values[:, 0], self.along: values[:, 1]}, states.reshape(-1, self.rows).T

    def _scaled(self, curve: Index, jacobian: np.ndarray) -> Float[np.ndarray, "lanes cycles states directions"]:
        """Return the scaled derivatives of images with respect to states and parameters."""
        columns = np.column_stack([self.scales[curve], self.other_unit[curve], self.unit[curve]])
        return jacobian * columns[:, None, None, :] / self.scales[curve][:, None, :, None]

    def _jacobian(self, curve: Index, u: Unknowns) -> tuple[Any, np.ndarray]:
        """Return the images of the states by lane, and their scaled derivatives."""
        images = images_by_lane(self._smooth_map(*self._inputs(curve, u)), len(u), (u.shape[1] - 2) // self.rows)
        return images, self._scaled(curve, images.jacobian)

    def _past_events(self, curve: Index, u: Unknowns, chosen: np.ndarray) -> tuple[Any, np.ndarray]:
        """Return the images of the states past grazes, and the scaled derivatives of the signed margins."""
        cycles = (u.shape[1] - 2) // self.rows
        p, states = self._inputs(curve, u)
        weights = np.repeat(chosen, cycles, axis=0).T
        accuracy, most_steps = Accuracy(*map(np.float64, FAMILY_ACCURACY)), np.float64(self.most_steps)

        def work(part: Any) -> Any:
            own = {name: p[name][part] for name in self.scene.parameters()}
            names = (self.other, self.along)
            return event_mapped(self.scene, names, own, states[:, part], weights[:, part], accuracy, most_steps)

        images, rate = in_calls(work, states.shape[1], workers())
        columns = np.column_stack([self.scales[curve], self.other_unit[curve], self.unit[curve]])
        rates = np.asarray(rate).T.reshape(len(u), cycles, -1) * columns[:, None]
        return images_by_lane(images, len(u), cycles), rates

    def _orbit(self, curve: Index, u: Unknowns, images: Any, jacobian: np.ndarray) -> Points:
        """Return the points with the orbits' equations only."""
        lanes, cycles, rows, _ = jacobian.shape
        off = (images.state - np.roll(self.states(curve, u), -1, axis=1)) / self.scales[curve][:, None]
        shooting = shooting_matrix(jacobian[..., :rows])
        by_parameters = jacobian[..., rows:].reshape(lanes, cycles * rows, 2)
        changes = images.seen.mode_changes.sum(axis=1)
        return Points(
            family=curve,
            u=u.copy(),
            tangent=np.full_like(u, np.nan),
            off=off.reshape(lanes, -1),
            matrix=np.concatenate([shooting, by_parameters], axis=2),
            times=np.where(images.seen.returned, images.time, np.inf),
            product=chain(jacobian[..., :rows]),
            impacts=images.seen.impacts.sum(axis=1),
            # The last row marks a second graze of the same event, see `_on_event`.
            mode_changes=np.concatenate([changes, np.zeros((lanes, 1, 3))], axis=1),
            margin=images.seen.margin.reshape(lanes, -1).min(axis=1),
        )

    def _with_condition(self, points: Points, value: PerLane, row: Unknowns) -> Points:
        off = np.column_stack([points.off, value])
        return points._replace(off=off, matrix=np.concatenate([points.matrix, row[:, None]], axis=1))

    def _on_event(self, curve: Index, u: Unknowns) -> Points:
        images, rates = self._past_events(curve, u, self.chosen[curve])
        lanes = np.arange(len(u))
        margins = np.asarray(images.seen.margin)  # (lanes, cycles, rows of `EventMargin`)
        first = np.abs(margins[..., 0]).argmin(axis=1)
        later = margins[..., 0].copy()
        later[lanes, first] = np.inf
        others = np.concatenate([later, margins[..., 2]], axis=1)
        second = others[lanes, np.abs(others).argmin(axis=1)]
        row = np.zeros_like(u)
        for k in range(self.rows):
            row[lanes, first * self.rows + k] = rates[lanes, first, k]
        row[:, -2:] = rates[lanes, first, self.rows :]
        seen = images.seen._replace(margin=margins[..., 1])
        points = self._orbit(curve, u, images._replace(seen=seen), self._scaled(curve, images.jacobian))
        for condition, (_, mode) in enumerate(conditions_of(self.scene)):
            if mode is not None:
                # At the curve itself, rounding errors decide whether the body sticks or reverses.
                switches = self.chosen[curve, condition] > 0
                points.mode_changes[switches, mode] = 0.0
                second[switches] = np.inf
        points.mode_changes[:, -1, 0] = second < 0
        points = points._replace(margin=np.minimum(points.margin, np.abs(second)))
        return self._with_condition(points, margins[lanes, first, 0], row)

    def _smooth(self, curve: Index, u: Unknowns) -> Points:
        images, jacobian = self._jacobian(curve, u)
        points = self._orbit(curve, u, images, jacobian)
        sound = np.isfinite(jacobian).all(axis=(1, 2, 3))
        jacobian = np.where(sound[:, None, None, None], jacobian, 0.0)
        value, row = np.full(len(u), np.nan), np.full(u.shape, np.nan)
        torus = self.kinds[curve] == "torus"
        for mask, condition in ((sound & ~torus, self._singular), (sound & torus, self._torus)):
            lanes = np.flatnonzero(mask)
            if len(lanes):
                value[lanes], row[lanes] = condition(curve[lanes], u[lanes], jacobian[lanes])
        return self._with_condition(points, value, row)

    def _at_rest(self, curve: Index, u: Unknowns) -> Points:
        """Return the points of Hopf curves, whose equations are those of the equilibrium."""
        return Points.join([self._equilibrium(curve[[k]], u[[k]]) for k in range(len(u))])

    def _equilibrium(self, curve: Index, u: Unknowns) -> Points:
        lanes, rows, modes = 1, self.rows, max(len(self.scene.modes), 1)
        if int(curve[0]) not in self._fields:
            states = dict(zip(self.scene.return_states, self.states(curve, u)[0, 0], strict=True))
            begin = np.array([states.get(name, 0.0) for name in moving_states(self.scene)])
            fixed = {name: x[curve[0]] for name, x in self.parameters.items()}
            self._fields[int(curve[0])] = Field(self.scene, fixed, begin)
        hopf = HopfEquations(self.scene, self._fields[int(curve[0])], (self.other, self.along), self.scales[curve[0]])
        units = np.array([self.other_unit[curve[0]], self.unit[curve[0]]])
        equilibrium, by_parameters = hopf.at(self.values(curve, u)[0], units)
        by_states = np.vstack([np.eye(rows), np.zeros(rows)])
        matrix = np.column_stack([by_states, np.vstack([-by_parameters[:rows], by_parameters[rows:]])])
        off = np.append(u[0, :rows] - equilibrium.states, equilibrium.growth)
        return Points(
            family=curve,
            u=u.copy(),
            tangent=np.full_like(u, np.nan),
            off=off[None],
            matrix=matrix[None],
            times=np.full((lanes, 1), equilibrium.period),
            product=equilibrium.product[None],
            impacts=np.zeros(lanes),
            mode_changes=np.zeros((lanes, modes + 1, 3)),
            margin=np.ones(lanes),
        )

    @cached_property
    def _fields(self) -> dict[int, Field]:
        return {}

    def _along(self, curve: Index, u: Unknowns, direction: Float[np.ndarray, "lanes cycles states"]) -> np.ndarray:
        """Return the derivative of the scaled Jacobian along directions of the scaled states, by forward mode twice."""
        lanes, cycles, rows = direction.shape
        p, states = self._inputs(curve, u)
        first = (direction * self.scales[curve][:, None]).reshape(-1, rows).T
        segment, column = np.repeat(np.arange(lanes * cycles), rows + 2), np.tile(np.arange(rows + 2), lanes * cycles)
        second = (np.arange(rows)[:, None] == column) + 0.0
        changes = {self.other: (column == rows) + 0.0, self.along: (column == rows + 1) + 0.0}
        accuracy, most_steps = Accuracy(*map(np.float64, DERIVATIVE_ACCURACY)), np.float64(self.most_steps)

        def work(part: Any) -> Any:
            own = {name: p[name][segment[part]] for name in self.scene.parameters()}
            pairs = {name: (x, changes[name][part] if name in changes else 0.0 * x) for name, x in own.items()}
            begin = states[:, segment[part]], first[:, segment[part]], second[:, part]
            return second_variation(self.scene, Located(), pairs, *begin, accuracy, most_steps)[1][2]

        slopes = np.asarray(in_calls(work, len(segment), workers()))
        return self._scaled(curve, np.moveaxis(slopes.reshape(rows, lanes, cycles, rows + 2), 0, 2))

    def _singular(self, curve: Index, u: Unknowns, jacobian: np.ndarray) -> tuple[PerLane, Unknowns]:
        """Return the signed smallest singular value of the shooting matrices, and its derivatives."""
        lanes, cycles, rows, _ = jacobian.shape
        matrix = shooting_matrix(jacobian[..., :rows])
        doubles = self.kinds[curve] == "period-doubling"
        matrix[doubles] = antiperiodic(matrix[doubles], rows)
        value, w, v = signed_singular(matrix)
        change = self._along(curve, u, v.reshape(lanes, cycles, rows))
        by_block = np.einsum("lki,lkij->lkj", w.reshape(lanes, cycles, rows), change)
        row = np.concatenate([by_block[..., :rows].reshape(lanes, -1), by_block[..., rows:].sum(axis=1)], axis=1)
        return value, row

    def flip_coefficient(self, points: Points) -> PerLane:
        """Return the cubic coefficient c of the normal form xi -> -xi + c xi^3 at period doublings.

        Doubled orbits are stable where c is positive, if the other multipliers are inside the unit circle. On the
        centre manifold x + xi v + xi^2/2 h, h satisfies h' = A h + B(v, v) between section crossings. The coefficient c
        follows from the third order, which must be orthogonal to the left null vector w (Kuznetsov, *Elements of
        Applied Bifurcation Theory*, section 5.4.2). B is exact, and C(v, v, v) is a difference of B(v, v) along v.
        """
        curve, u, rows = points.family, points.u, self.rows
        shooting = points.matrix[:, : u.shape[1] - 2, : u.shape[1] - 2]
        _, *vectors = signed_singular(antiperiodic(shooting, rows))
        w, v = (x.reshape(len(u), -1, rows) for x in vectors)
        step = np.zeros_like(u)
        step[:, :-2] = FLIP_STEP * vectors[1]
        before, here, behind = (self._along(curve, x, v)[..., :rows] for x in (u - step, u, u + step))
        bent = np.einsum("lkij,lkj->lki", here, v)
        h = np.linalg.solve(shooting, -bent.reshape(len(u), -1, 1)).reshape(v.shape)
        third = np.einsum("lkij,lkj->lki", (behind - before) / (2 * FLIP_STEP), v)
        third += 3 * np.einsum("lkij,lkj->lki", here, h)
        return np.asarray(np.einsum("lki,lki->l", w, third) / (6 * np.einsum("li,li->l", w[:, -1], v[:, 0])))

    def _torus(self, curve: Index, u: Unknowns, jacobian: np.ndarray) -> tuple[PerLane, Unknowns]:
        """Return the signed smallest singular value of the compounds, and its derivatives."""
        lanes, cycles, rows, _ = jacobian.shape
        product = chain(jacobian[..., :rows])
        slopes = np.zeros((lanes, u.shape[1], rows, rows))
        for column in range(rows):
            direction = np.zeros((lanes, cycles, rows))
            direction[:, :, column] = 1.0
            # All cycles change together, because block k depends on the states of cycle k only.
            change = self._along(curve, u, direction)
            for k in range(cycles):
                before, after = (
                    segment_product(jacobian[..., :rows], 0, k),
                    segment_product(jacobian[..., :rows], k + 1, cycles),
                )
                part = np.einsum("lai,lij,lb->ljab", after, change[:, k], before[:, column])
                slopes[:, k * rows : (k + 1) * rows] += part[:, :rows]
                slopes[:, -2:] += part[:, rows:]
        value, w, v = signed_singular(compound(product) - np.eye(rows * (rows - 1) // 2))
        moved = compound_along(product, slopes)
        return value, np.einsum("li,ljik,lk->lj", w, moved, v)
