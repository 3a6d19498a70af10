"""Equations of a special point in two parameters: those of its orbit, and the condition of its kind.

The unknowns are the scaled states at the section and two scaled parameters. The last equation is one of these, each of
which is regular at the curve itself:

- fold and period doubling: the smallest singular value of the orbit's shooting matrix, periodic or antiperiodic, with
  the sign of its determinant;
- torus: that of C - 1, where C is the second compound of the monodromy matrix, whose eigenvalues are the products of
  two multipliers (Kuznetsov, *Elements of Applied Bifurcation Theory*, section 10.2);
- Hopf: the growth rate of the equilibrium ([vibrojax.periodic.hopf][]);
- grazing and stick: the signed margin of the event ([vibrojax.periodic.event_map][]).

The derivative of a singular value with the vectors w and v is w dA v. Second derivatives of the return map are
symmetric, so w dA v needs the derivative of the Jacobian along v only. Forward mode over forward mode takes 2.5 times
as long as the Jacobian, and a difference of two Jacobians twice as long, but the difference fails close to grazing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.equilibria import equilibrium_near, section_product
from vibrojax.periodic.event_map import conditions_of, event_mapped
from vibrojax.periodic.newton import (
    chain,
    compound,
    compound_along,
    images_by_lane,
    segment_product,
    shooting_matrix,
    signed_singular,
    solve,
)
from vibrojax.periodic.problem import FAMILY_ACCURACY, Index, PerLane, Points, Problem, Unknowns
from vibrojax.periodic.return_map import MOST_STEPS, bounds_of, over_segments
from vibrojax.periodic.variations import DERIVATIVE_ACCURACY, second_variation
from vibrojax.stepping import Varied

FLIP_STEP = 1e-3
"""Scaled difference of states from which third derivatives are taken. Second derivatives are exact."""

HOPF_STEP = 1e-5
"""Scaled step of the differences with respect to the parameters, of exact equilibria and eigenvalues."""

EVENTS = ("grazing", "stick")
"""Kinds of special points that are conditions on events, not on multipliers."""


def antiperiodic(shooting: Float[np.ndarray, "lanes n n"], rows: int) -> Float[np.ndarray, "lanes n n"]:
    """Return shooting matrices, with + instead of - the first state, which has `rows` numbers, at the end."""
    matrix = shooting.copy()
    matrix[:, -rows:, :rows] += 2 * np.eye(rows)
    return matrix


@dataclass(frozen=True, kw_only=True)
class CurveProblem(Problem):
    """Equations of curves, each of which takes the place of a family, over two parameters.

    - `kinds` (curves,): kind of each curve; `chosen` (curves, conditions): its condition on an event, see
      [vibrojax.periodic.event_map.conditions_of][].
    """

    kinds: np.ndarray
    chosen: Float[np.ndarray, "curves conditions"]

    def evaluate(self, family: Index, u: Unknowns) -> Points:
        on_event, at_rest = np.isin(self.kinds[family], EVENTS), self.kinds[family] == "hopf"
        parts, order = [], []
        for mask, evaluated in ((~on_event & ~at_rest, self._smooth), (on_event, self._on_event)):
            if mask.any():
                parts.append(evaluated(family[mask], u[mask]))
                order.append(np.flatnonzero(mask))
        for lane in np.flatnonzero(at_rest):
            parts.append(self._equilibrium(family[[lane]], u[[lane]]))
            order.append(np.array([lane]))
        return Points.join(parts).of(np.argsort(np.concatenate(order)))

    def margins(self, curve: Index, u: Unknowns, chosen: np.ndarray) -> Float[np.ndarray, "lanes cycles"]:
        """Return the signed margins of the `chosen` conditions (lanes, conditions) between the section crossings."""
        images, _ = self._past_events(curve, u, chosen)
        return np.asarray(images.seen.margin[:, :, 0])

    def _past_events(self, curve: Index, u: Unknowns, chosen: np.ndarray) -> tuple[Any, np.ndarray]:
        """Return the images of the states past grazes, and the scaled derivatives of the signed margins."""
        p, states = self.segments(curve, u)
        cycles = self.cycles(u)
        own = {name: p[name] for name in self.scene.parameters()}, states, np.repeat(chosen, cycles, axis=0).T
        bounds = bounds_of(FAMILY_ACCURACY, MOST_STEPS)
        images, rate = over_segments(lambda *part: event_mapped(self.scene, self.along, *part, *bounds), *own)
        columns = np.column_stack([self.scales[curve], self.unit[curve]])
        rates = np.asarray(rate).T.reshape(len(u), cycles, -1) * columns[:, None]
        return images_by_lane(images, len(u), cycles), rates

    def scaled(
        self, family: Index, jacobian: Float[np.ndarray, "lanes cycles rows columns"]
    ) -> Float[np.ndarray, "lanes cycles rows columns"]:
        # Multiplied first, unlike in families: steps near the ends of fold curves depend on the last bits.
        columns = np.column_stack([self.scales[family], self.unit[family]])
        return jacobian * columns[:, None, None] / self.scales[family][:, None, :, None]

    def orbit(self, family: Index, u: Unknowns, images: Any, jacobian: np.ndarray) -> Points:
        """Return the points with the equations of the orbits only."""
        points = super().orbit(family, u, images, jacobian)
        # The last row marks a second graze of the same event, see `_on_event`.
        return points._replace(mode_changes=np.pad(points.mode_changes, ((0, 0), (0, 1), (0, 0))))

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
        ends = np.pad(margins[..., [1, 1]], ((0, 0), (0, 0), (0, 3)), constant_values=np.inf)
        seen = images.seen._replace(margin=ends)
        points = self.orbit(curve, u, images._replace(seen=seen), self.scaled(curve, images.jacobian))
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
        p, states = self.segments(curve, u)
        images = images_by_lane(self._map(p, states), len(u), self.cycles(u))
        jacobian = self.scaled(curve, images.jacobian)
        points = self.orbit(curve, u, images, jacobian)
        sound = np.isfinite(jacobian).all(axis=(1, 2, 3))
        jacobian = np.where(sound[:, None, None, None], jacobian, 0.0)
        value, row = np.full(len(u), np.nan), np.full(u.shape, np.nan)
        torus = self.kinds[curve] == "torus"
        for mask, condition in ((sound & ~torus, self._singular), (sound & torus, self._torus)):
            lanes = np.flatnonzero(mask)
            if len(lanes):
                value[lanes], row[lanes] = condition(curve[lanes], u[lanes], jacobian[lanes])
        return self._with_condition(points, value, row)

    def _equilibrium(self, curve: Index, u: Unknowns) -> Points:
        number, rows, modes = int(curve[0]), self.rows, max(len(self.scene.modes), 1)
        guess, values = np.zeros(len(self.moving)), self.values(curve, u)[0]
        guess[self.places] = self.states(curve, u)[0, 0]
        here, period, product = self._critical(number, guess, values)
        slopes = []
        for step in HOPF_STEP * np.diag(self.unit[number]):
            ahead, behind = (self._critical(number, guess, values + sign * step)[0] for sign in (1.0, -1.0))
            slopes.append((ahead - behind) / (2 * HOPF_STEP))
        return Points(
            family=curve,
            u=u.copy(),
            tangent=np.full_like(u, np.nan),
            off=(np.append(u[0, :rows], 0.0) - here)[None],
            matrix=np.column_stack([np.eye(rows + 1)[:, :rows], -np.column_stack(slopes)])[None],
            times=np.full((1, 1), period),
            product=product[None],
            impacts=np.zeros(1),
            mode_changes=np.zeros((1, modes + 1, 3)),
            margin=np.ones(1),
            swing=np.ones(1),
        )

    def _critical(self, number: int, guess: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """Return states and negative growth rate of an equilibrium, period, and derivative of the return map.

        States are scaled, and the growth rate is relative to the frequency; NaN without an oscillating equilibrium.
        """
        rows, scale = self.rows, self.scales[number]
        parameters = {name: float(x[number]) for name, x in self.parameters.items()}
        parameters |= dict(zip(self.along, values.tolist(), strict=True))
        known = equilibrium_near(self.scene, parameters, guess, float(scale.max()))
        pair = None if known is None else known.pair()
        if known is None or pair is None:
            return np.full(rows + 1, np.nan), np.inf, np.full((rows, rows), np.nan)
        product = section_product(self.scene, known, *pair, scale)
        growth = -pair[0].real / pair[0].imag
        return np.append(known.states[self.places] / scale, growth), 2 * np.pi / pair[0].imag, product

    def _along(self, curve: Index, u: Unknowns, direction: Float[np.ndarray, "lanes cycles states"]) -> np.ndarray:
        """Return the derivative of the scaled Jacobian along directions of the scaled states, by forward mode twice."""
        lanes, cycles, rows = direction.shape
        p, states = self.segments(curve, u)
        first = (direction * self.scales[curve][:, None]).reshape(-1, rows).T
        segment, column = np.repeat(np.arange(lanes * cycles), rows + 2), np.tile(np.arange(rows + 2), lanes * cycles)
        second = (np.arange(rows)[:, None] == column) + 0.0
        changes = {name: (column == rows + k) + 0.0 for k, name in enumerate(self.along)}
        own = {name: p[name][segment] for name in self.scene.parameters()}
        pairs = {name: (x, changes.get(name, 0.0 * x)) for name, x in own.items()}
        begin, bounds = (states[:, segment], first[:, segment], second), bounds_of(DERIVATIVE_ACCURACY, MOST_STEPS)

        def moved(*part: Any) -> Any:
            return second_variation(self.scene, Varied(), *part, *bounds)[1][2]

        slopes = np.asarray(over_segments(moved, pairs, *begin))
        return self.scaled(curve, np.moveaxis(slopes.reshape(rows, lanes, cycles, rows + 2), 0, 2))

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
        h = solve(shooting, -bent.reshape(len(u), -1, 1)).reshape(v.shape)
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
