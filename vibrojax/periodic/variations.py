"""Derivatives of the return map along families of periodic orbits: second derivatives of the map, and of multipliers.

An orbit with the states s_k at the section satisfies P(s_k, p) = s_{k+1}. Along a family of orbits, therefore

    P_s(s_k) ds_k/dp - ds_{k+1}/dp = -P_p(s_k)

The derivative of a simple eigenvalue with right and left eigenvectors v and w, w v = 1, is w (dA/dp) v (Kato,
*Perturbation Theory for Linear Operators*, II.2).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.lanes.compiler import lane_function
from vibrojax.lazy import jax
from vibrojax.periodic.margin import Margin
from vibrojax.periodic.newton import PerLane, shooting_matrix, solve
from vibrojax.periodic.return_map import MOST_STEPS, ReturnLoop, bounds_of, map_state, over_segments
from vibrojax.physics.arrays import Array, Lanes
from vibrojax.scenes import Scene
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Located, Varied

DERIVATIVE_ACCURACY = Accuracy(tolerance=1e-12, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps; the series of tangents converge more slowly than the series of the motion."""

EQUAL_MODULI = 1e-3
"""Difference of two multipliers (or of their moduli), relative to the largest modulus, below which they count as equal.
The derivative of a multiplier then holds over a parameter range of about the square of the difference."""

ZERO_MULTIPLIER = 1e-7
"""Modulus below which a multiplier counts as zero. It stays zero while the bit sticks once in each period."""


class Variations(NamedTuple):
    """The return map between the crossings of orbits, and derivatives along the families of orbits.

    `d_` marks derivatives with respect to the parameters, which are the last axis. `margin` (lanes, cycles, 2): grazing
    margin of switches and of other guards.
    """

    times: Float[np.ndarray, "lanes cycles"]
    jacobian: Float[np.ndarray, "lanes cycles states states"]
    margin: Float[np.ndarray, "lanes cycles 2"]
    impacts: PerLane
    d_states: Float[np.ndarray, "lanes cycles states by"]
    d_times: Float[np.ndarray, "lanes cycles by"]
    d_jacobian: Float[np.ndarray, "lanes cycles states states by"]
    d_margin: Float[np.ndarray, "lanes cycles 2 by"]

    @staticmethod
    def of(
        driving: Scene[Any],
        by: Sequence[str],
        parameters: Mapping[str, PerLane],
        begin: Float[np.ndarray, "lanes cycles states"],
        scale: Float[np.ndarray, "lanes states"],
    ) -> "Variations":
        """Return the variations of the map along all states and parameters, combined by the implicit function theorem.

        Each pair of a state and a direction, in which the map is differentiated once and twice, has lanes of its own,
        so that one small compiled program serves all parameters.
        """
        lanes, cycles, rows = begin.shape
        count = rows + len(by)
        shape = (lanes, cycles, rows, count)
        lane, crossing, column, direction = (index.ravel() for index in np.indices(shape))
        states = begin[lane, crossing].T
        basis = np.arange(rows)[:, None]
        own = states, (basis == column) + 0.0, (basis == direction) + 0.0
        p = {
            name: (parameters[name][lane], (direction == rows + by.index(name)) + 0.0 if name in by else 0.0 * lane)
            for name in driving.parameters()
        }
        bounds = bounds_of(DERIVATIVE_ACCURACY, MOST_STEPS)
        derivatives = jax.tree.map(
            lambda x: np.moveaxis(np.asarray(x), -1, 0).reshape(*shape, *np.shape(x)[:-1]),
            over_segments(lambda *part: second_variation(driving, Varied(), *part, *bounds), p, *own),
        )
        (_, times, moved, margin, impacts), slopes = derivatives
        jacobian = np.swapaxes(moved[:, :, :, 0], 2, 3)
        by_image, by_time, by_margin = (slopes[k][:, :, 0] for k in (0, 1, 3))
        by_jacobian = np.moveaxis(slopes[2], 2, -1)  # (lanes, cycles, directions, images, columns)
        scaled = jacobian * scale[:, None, None, :] / scale[:, None, :, None]
        right = -np.swapaxes(by_image[:, :, rows:], 2, 3) / scale[:, None, :, None]
        d_states = solve(shooting_matrix(scaled), right.reshape(lanes, cycles * rows, len(by)))
        d_states = d_states.reshape(lanes, cycles, rows, len(by)) * scale[:, None, :, None]

        def total(slope: np.ndarray) -> np.ndarray:
            """Return derivatives along the families from those (lanes, cycles, directions, ...)."""
            by_state = np.einsum("lki...,lkij->lk...j", slope[:, :, :rows], d_states)
            return by_state + np.moveaxis(slope[:, :, rows:], 2, -1)

        return Variations(
            times[:, :, 0, 0],
            jacobian,
            margin[:, :, 0, 0],
            impacts[:, :, 0, 0].sum(axis=1),
            d_states,
            total(by_time),
            total(by_jacobian),
            total(by_margin),
        )

    @property
    def d_product(self) -> Float[np.ndarray, "lanes states states by"]:
        """Derivative of the map's derivative over one period of the motion."""
        product, slope = self.jacobian[:, 0], self.d_jacobian[:, 0]
        for k in range(1, self.jacobian.shape[1]):
            slope = np.einsum("lab,lbcj->lacj", self.jacobian[:, k], slope)
            slope = slope + np.einsum("labj,lbc->lacj", self.d_jacobian[:, k], product)
            product = self.jacobian[:, k] @ product
        return slope


def eigenvalues(
    product: Float[np.ndarray, "lanes n n"], slope: Float[np.ndarray, "lanes n n by"], scales: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return eigenvalues by decreasing modulus, their derivatives, and a mask of those that equal another one."""
    product = product * scales[:, None, :] / scales[:, :, None]
    slope = slope * scales[:, None, :, None] / scales[:, :, None, None]
    sound = np.isfinite(product).all(axis=(1, 2)) & np.isfinite(slope).all(axis=(1, 2, 3))
    values, vectors = np.linalg.eig(np.where(sound[:, None, None], product, 0.0))
    values, vectors = values.astype(complex), vectors.astype(complex)
    order = np.argsort(-np.abs(values), axis=1, kind="stable")
    values = np.take_along_axis(values, order, axis=1)
    vectors = np.take_along_axis(vectors, order[:, None, :], axis=2)
    eye = np.eye(product.shape[1]).astype(complex)
    inverse = solve(vectors, np.broadcast_to(eye, vectors.shape))
    slopes = np.einsum("lia,labj,lbi->lij", inverse, slope, vectors)
    moduli = np.abs(values)
    small = EQUAL_MODULI * moduli[:, :1, None]
    near = np.abs(moduli[:, :, None] - moduli[:, None, :]) < small
    # Moduli of a conjugate pair are equal, and stay equal unless the pair is about to meet on the real axis.
    pair = np.abs(values[:, :, None] - np.conj(values)[:, None, :]) < 1e-9 * moduli[:, :1, None]
    apart = np.abs(values[:, :, None] - values[:, None, :]) >= small
    alike = (near & ~(pair & apart) & ~np.eye(product.shape[1], dtype=bool)).any(axis=2) & (moduli > ZERO_MULTIPLIER)
    values[~sound] = np.nan
    return values, slopes, alike


@lane_function(static=2)
def second_variation(
    scene: Scene[Any],
    stepper: Located,
    p: dict[str, tuple[Lanes, Lanes]],
    state: Array,
    first: Array,
    second: Array,
    accuracy: Accuracy,
    most_steps: Any,
) -> Any:
    """Return (image, time, derivative of the image, margin, impacts) of the map, and derivatives of the first four.

    The image is differentiated along the change `first` of the state; the results, along the change `second` of the
    state and that of the parameters. `p`: values and changes of the parameters. Changes are different for each lane.
    """
    loop = ReturnLoop(scene, stepper, accuracy, most_steps, lambda c: Margin(scene, scene.section, c, True))
    values, changes = {name: pair[0] for name, pair in p.items()}, {name: pair[1][None] for name, pair in p.items()}
    once = loop.as_loop(lambda x: loop.begin_at(*x)).with_tangents((dict.fromkeys(p), first[None], None))
    twice = once.with_tangents((changes, second[None], second[None]))
    (flight, moved), (slopes, d_moved) = twice.run((values, state, state))

    def results(flight: Any, moved: Any) -> tuple[Array, ...]:
        return map_state(scene, flight.lane), flight.time, map_state(scene, moved.lane), flight.seen.margin[..., :2, :]

    # The single directions of both derivatives have axes of their own, before that of the lanes.
    image, time, derivative, margin = results(flight, moved)
    d_image, d_time, d_derivative, d_margin = results(slopes, d_moved)
    return (image, time, derivative[:, 0], margin, flight.seen.impacts), (
        d_image[:, 0],
        d_time[0],
        d_derivative[:, 0, 0],
        d_margin[0],
    )
