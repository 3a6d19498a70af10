"""Derivatives of the return map along families of periodic orbits: second derivatives of the map, and of multipliers.

An orbit with the states s_k at the section satisfies P(s_k, p) = s_{k+1}. Along a family of orbits, therefore

    P_s(s_k) ds_k/dp - ds_{k+1}/dp = -P_p(s_k)

The derivative of a simple eigenvalue with right and left eigenvectors v and w, w v = 1, is w (dA/dp) v (Kato,
*Perturbation Theory for Linear Operators*, II.2).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Inexact

from vibrojax.compile.xla import workers
from vibrojax.models.arrays import Array, Lanes
from vibrojax.models.scenes import Scene
from vibrojax.periodic.newton import PeriodicOrbits, PerLane, shooting_matrix
from vibrojax.periodic.return_map import MOST_STEPS, at_section, in_calls, one_return
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Located
from vibrojax.sweep.engine.compiler import lane_function

DERIVATIVE_ACCURACY = Accuracy(tolerance=1e-12, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps; the series of tangents converge more slowly than those of the motion."""

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
        driving: Scene[Any], by: Sequence[str], parameters: Mapping[str, PerLane], orbit: PeriodicOrbits
    ) -> "Variations":
        """Return the variations of the map along all states and parameters, combined by the implicit function theorem.

        Each direction has lanes of its own, so that one compiled program serves all parameters.
        """
        lanes, cycles, rows = orbit.states.shape
        count = rows + len(by)
        index = np.repeat(np.arange(lanes), cycles * count)
        states = np.repeat(orbit.states.reshape(-1, rows), count, axis=0).T
        direction = np.tile(np.arange(count), lanes * cycles)
        unit = {
            name: (direction == rows + by.index(name)) + 0.0 if name in by else 0.0 * direction for name in parameters
        }
        basis = (direction == np.arange(rows)[:, None]) + 0.0

        def work(part: Any) -> Any:
            p = {name: parameters[name][index[part]] for name in driving.parameters()}
            along = {name: unit[name][part] for name in p}
            accuracy = Accuracy(*map(np.float64, DERIVATIVE_ACCURACY))
            most = np.float64(MOST_STEPS)
            return _variation(driving, Located(), p, states[:, part], along, basis[:, part], accuracy, most)

        map_and_slopes = jax.tree.map(
            lambda x: np.moveaxis(np.asarray(x), -1, 0).reshape(lanes, cycles, count, *np.shape(x)[:-1]),
            in_calls(work, len(index), workers()),
        )
        (_, times, jacobian, margin, impacts), slopes = map_and_slopes
        jacobian = jacobian[:, :, 0]
        by_image = np.moveaxis(slopes[0][:, :, rows:], 2, -1)
        scale = orbit.scales
        scaled = jacobian * scale[:, None, None, :] / scale[:, None, :, None]
        right = -by_image / scale[:, None, :, None]
        d_states = _solve(shooting_matrix(scaled), right.reshape(lanes, cycles * rows, len(by)))
        d_states = d_states.reshape(lanes, cycles, rows, len(by)) * scale[:, None, :, None]

        def total(slope: np.ndarray) -> np.ndarray:
            by_state, by_parameter = np.moveaxis(slope[:, :, :rows], 2, -1), np.moveaxis(slope[:, :, rows:], 2, -1)
            return np.einsum("lk...i,lkij->lk...j", by_state, d_states) + by_parameter

        _, d_times, d_jacobian, d_margin, _ = (total(slope) for slope in slopes)
        return Variations(
            times[:, :, 0],
            jacobian,
            margin[:, :, 0],
            impacts[:, :, 0].sum(axis=1),
            d_states,
            d_times,
            d_jacobian,
            d_margin,
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


def _solve(matrix: Inexact[np.ndarray, "lanes n n"], right: Inexact[np.ndarray, "lanes n by"]) -> np.ndarray:
    """Solve matrix x = `right` in each lane; x is NaN if the matrix is singular."""
    sound = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=(1, 2))
    eye = np.eye(matrix.shape[1])
    matrix = np.where(sound[:, None, None], matrix, eye)
    sound &= np.linalg.slogdet(matrix)[0] != 0
    matrix = np.where(sound[:, None, None], matrix, eye)
    return np.where(sound[:, None, None], np.linalg.solve(matrix, right), np.nan)


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
    left = _solve(vectors, np.broadcast_to(eye, vectors.shape))
    slopes = np.einsum("lia,labj,lbi->lij", left, slope, vectors)
    moduli = np.abs(values)
    small = EQUAL_MODULI * moduli[:, :1, None]
    near = np.abs(moduli[:, :, None] - moduli[:, None, :]) < small
    # Moduli of a conjugate pair are equal, and stay equal unless the pair is about to meet on the real axis.
    pair = np.abs(values[:, :, None] - np.conj(values)[:, None, :]) < 1e-9 * moduli[:, :1, None]
    apart = np.abs(values[:, :, None] - values[:, None, :]) >= small
    alike = (near & ~(pair & apart) & ~np.eye(product.shape[1], dtype=bool)).any(axis=2) & (moduli > ZERO_MULTIPLIER)
    values[~sound] = np.nan
    return values, slopes, alike


@lane_function(static=2, derives=True)
def _variation(
    scene: Scene[Any],
    stepper: Located,
    p: dict[str, Lanes],
    state: Array,
    along_p: dict[str, Lanes],
    along_state: Array,
    accuracy: Accuracy,
    most_steps: Any,
) -> Any:
    """Return (image, time, derivative, margin, impacts) of the map, and their derivatives along a direction per lane.

    The direction is in the space of parameters and states. The map's own derivative is that with respect to the state.
    """
    fixed = jax.lax.stop_gradient(state)

    def image(p: dict[str, Lanes], state: Array) -> Any:
        c = scene.scaled(scene.constants(p), at_section(scene, fixed))
        (there, time), seen = one_return(scene, stepper, c, state, accuracy, most_steps, derives_margin=True)
        return there, (time, seen.margin, seen.impacts)

    def everything(p: dict[str, Lanes], state: Array) -> Any:
        def derivative(tangent: Array) -> Any:
            there, moved, rest = jax.jvp(lambda s: image(p, s), (state,), (tangent,), has_aux=True)
            return there, moved, rest

        basis = jnp.broadcast_to(jnp.eye(len(state), dtype=state.dtype)[:, :, None], (len(state), *state.shape))
        there, moved, (time, margin, impacts) = jax.vmap(derivative, out_axes=(None, 1, None))(basis)
        return there, time, moved, margin, impacts

    return jax.jvp(everything, (p, state), (along_p, along_state))
