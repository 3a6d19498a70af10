"""Newton's method for the periodic orbits of many lanes at once, by multiple shooting between section crossings.

An orbit with p section crossings per period has p states s_k at the section. The return map P takes each state to the
next, and the last to the first. All segments are mapped in one batch. The Newton steps d_k of each lane solve the
block-cyclic system

    P'(s_k) d_k - d_{k+1} = s_{k+1} - P(s_k)

Even an orbit with large multipliers is thus integrated only from one section crossing to the next (Stoer and Bulirsch,
*Introduction to Numerical Analysis*, section 7.3.5).
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int

from vibrojax.periodic.return_map import Mapped, ReturnMap

NEWTON_RESIDUAL = 1e-12
"""Residual at which the iteration stops, because rounding errors dominate."""

ACCEPTED = 1e-10
"""Largest residual of an orbit that counts as converged."""

MIN_RELATIVE_SWING = 1e-3
"""Smallest scale of a state, relative to its magnitude; the range of a state at rest is only rounding noise."""

NEWTON_MAX_ITERATIONS = 8

SAME_STATE = 1e-6
"""Scaled distance (in units of the states' scales) within which two states of an orbit count as equal."""

States = Float[np.ndarray, "lanes cycles states"]
PerLane = Float[np.ndarray, " lanes"]
Index = Int[np.ndarray, " some"]


class PeriodicOrbits(NamedTuple):
    """Results of Newton's method for lanes with the same number of section crossings; some may not have converged.

    - `states`, `times` [s]: states at the section, and time from each state to the next.
    - `residual`: greatest scaled difference between an image and the next state; infinite if a lane did not return.
    - `product`: derivative of the map over one period of the motion.
    - `step`: next Newton step, which has not been applied; its size estimates the distance from the orbit.
    - `moved`: greatest scaled distance from the initial guess; infinite if it exceeded the limit `reach`.
    - `impacts`, `steps`: numbers of impacts and steps in one period; `margin`: smallest grazing margin; `reach`: the
      margin that limits the validity of the derivative.
    """

    states: States
    scales: Float[np.ndarray, "lanes states"]
    times: Float[np.ndarray, "lanes cycles"]
    residual: PerLane
    product: Float[np.ndarray, "lanes states states"]
    step: States
    moved: PerLane
    impacts: PerLane
    margin: PerLane
    reach: PerLane
    steps: PerLane

    def of(self, lanes: Index) -> "PeriodicOrbits":
        """Return the orbits of a subset of the lanes, by index."""
        return PeriodicOrbits(*(x[lanes] for x in self))


def orbits(
    begin: States,
    scales: Float[np.ndarray, "lanes states"],
    reach: np.ndarray,
    go: ReturnMap,
    enough: float = NEWTON_RESIDUAL,
    most: int = NEWTON_MAX_ITERATIONS,
) -> PeriodicOrbits:
    """Return the orbits near the initial guesses `begin`, with the same number of section crossings as the guesses.

    **Arguments:**

    - `scales`: a NaN is replaced by half the peak-to-peak range of the state along the motion from the initial guess,
      or by 1 if that range is zero.
    - `reach` (lanes,): scaled distance from the initial guess beyond which a lane is no longer iterated.
    - `go`: the return map. `enough`: residual at which the iteration of a lane stops.
    - `most`: largest number of iterations.

    The derivative is evaluated at the states in the result, so callers may apply one more step, `PeriodicOrbits.step`.
    """
    lanes = len(begin)

    def evaluate(states: States, lanes: Index) -> Any:
        count, cycles, rows = states.shape
        return images_by_lane(go(np.repeat(lanes, cycles), states.reshape(-1, rows).T), count, cycles)

    best = evaluate(begin, np.arange(lanes))
    greatest, least = best.seen.greatest.max(axis=1), best.seen.least.min(axis=1)
    swing = np.maximum((greatest - least) / 2, MIN_RELATIVE_SWING * np.maximum(greatest, -least))
    scales = np.where(np.isnan(scales), np.where(swing > 0, swing, 1.0), scales)
    states, residual = begin.copy(), _residual(begin, best, scales)
    iterate, now = begin, best
    outside = np.zeros(lanes, bool)
    active = np.arange(lanes)
    for _ in range(most):
        on = (residual[active] > enough) & np.isfinite(residual[active])
        active, iterate, now = active[on], iterate[on], jax.tree.map(lambda x, on=on: x[on], now)
        if not len(active):
            break
        iterate = iterate + _newton_step(iterate, now, scales[active])
        # Far from the orbit, reaching the section may take thousands of steps.
        distance = _distance(iterate, begin[active], scales[active])
        outside[active[distance > reach[active]]] = True
        on = distance <= reach[active]
        active, iterate = active[on], iterate[on]
        if not len(active):
            break
        now = evaluate(iterate, active)
        reached = _residual(iterate, now, scales[active])
        before = residual[active]
        better = reached < before
        kept = active[better]
        states[kept], residual[kept] = iterate[better], reached[better]
        for whole, part in zip(jax.tree.leaves(best), jax.tree.leaves(now), strict=True):
            whole[kept] = part[better]
        # A small residual that hardly decreases is dominated by rounding errors.
        on = np.isfinite(reached) & ((reached < before / 2) | (reached > ACCEPTED))
        active, iterate, now = active[on], iterate[on], jax.tree.map(lambda x, on=on: x[on], now)
    return PeriodicOrbits(
        states=states,
        scales=scales,
        times=best.time,
        residual=residual,
        product=chain(best.jacobian),
        step=_newton_step(states, best, scales),
        moved=np.where(outside, np.inf, _distance(states, begin, scales)),
        impacts=best.seen.impacts.sum(axis=1),
        margin=best.seen.margin.min(axis=1),
        reach=best.seen.reach.min(axis=1),
        steps=best.seen.steps.sum(axis=1),
    )


def repeats_after(orbit: PeriodicOrbits, same: float = SAME_STATE) -> Int[np.ndarray, " lanes"]:
    """Return the minimal number of section crossings per period of each orbit, a divisor of its number of states.

    States within the scaled distance `same` count as equal.
    """
    repeat = orbit.states.shape[1]
    minimal = np.full(len(orbit.states), repeat)
    for divisor in (q for q in range(repeat - 1, 0, -1) if repeat % q == 0):
        apart = np.abs(np.roll(orbit.states, divisor, axis=1) - orbit.states) / orbit.scales[:, None]
        minimal[np.max(apart, axis=(1, 2)) <= same] = divisor
    return minimal


def multipliers(product: Float[np.ndarray, "lanes states states"]) -> Complex[np.ndarray, "lanes states"]:
    """Return the eigenvalues in order of decreasing modulus; NaN where the derivative is not finite."""
    sound = np.isfinite(product).all(axis=(1, 2))
    values = np.linalg.eigvals(np.where(sound[:, None, None], product, 0.0)).astype(complex)
    values[~sound] = np.nan
    return np.take_along_axis(values, np.argsort(-np.abs(values), axis=1, kind="stable"), axis=1)


def held_states(jacobian: Float[np.ndarray, "... states states"]) -> Bool[np.ndarray, "... states"]:
    """Return a mask of the states that a map holds, such as the position of a body that sticks for good."""
    return np.all(jacobian == np.eye(jacobian.shape[-1]), axis=-1)


def spectral_radius(product: Float[np.ndarray, "lanes states states"]) -> PerLane:
    """Return the greatest modulus of each lane's multipliers; NaN where the derivative is not finite."""
    return np.abs(multipliers(product)[:, 0])


def solve(
    matrix: Inexact[np.ndarray, "lanes n n"], right: Inexact[np.ndarray, "lanes n columns"]
) -> Inexact[np.ndarray, "lanes n columns"]:
    """Solve matrix x = `right` in each lane; x is NaN where the matrix is singular, for example at a fold."""
    sound = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=(1, 2))
    matrix = np.where(sound[:, None, None], matrix, np.eye(matrix.shape[1]))
    # For a single singular matrix, NumPy would raise for the whole batch.
    sound &= np.linalg.slogdet(matrix)[0] != 0
    matrix = np.where(sound[:, None, None], matrix, np.eye(matrix.shape[1]))
    return np.where(sound[:, None, None], np.linalg.solve(matrix, right), np.nan)


def images_by_lane(mapped: Mapped, lanes: int, cycles: int) -> Any:
    """Return a copy of `mapped` with arrays of shape (lanes, cycles, ...) instead of (..., segments)."""
    return jax.tree.map(lambda x: np.moveaxis(np.array(x), -1, 0).reshape(lanes, cycles, *np.shape(x)[:-1]), mapped)


def shooting_matrix(
    jacobian: Float[np.ndarray, "lanes cycles states states"],
) -> Float[np.ndarray, "lanes equations equations"]:
    """Return the block-cyclic matrix of multiple shooting."""
    lanes, cycles, rows, _ = jacobian.shape
    blocks = np.zeros((lanes, cycles, rows, cycles, rows))
    for k in range(cycles):
        blocks[:, k, :, k] += jacobian[:, k]
        blocks[:, k, :, (k + 1) % cycles] -= np.eye(rows)
    return blocks.reshape(lanes, cycles * rows, cycles * rows)


def chain(jacobian: Float[np.ndarray, "lanes cycles states states"]) -> Float[np.ndarray, "lanes states states"]:
    """Return the derivative of the map over one period of the motion, the product of the segments' derivatives."""
    product = jacobian[:, 0]
    for k in range(1, jacobian.shape[1]):
        product = jacobian[:, k] @ product
    return product


def _residual(states: States, images: Any, scales: np.ndarray) -> PerLane:
    off = np.abs(images.state - np.roll(states, -1, axis=1)) / scales[:, None]
    residual = np.where(images.seen.returned.all(axis=1), off.max(axis=(1, 2)), np.inf)
    return np.where(np.isnan(residual), np.inf, residual)


def _distance(states: States, begin: States, scales: np.ndarray) -> PerLane:
    return np.max(np.abs(states - begin) / scales[:, None], axis=(1, 2))


def _newton_step(states: States, images: Any, scales: np.ndarray) -> States:
    """Return the Newton steps, computed in scaled unknowns; NaN where the matrix is singular.

    A state that the map holds keeps its value: every value belongs to an orbit, so the matrix would be singular.
    """
    lanes, cycles, rows = states.shape
    jacobian = images.jacobian * scales[:, None, None, :] / scales[:, None, :, None]
    off = (np.roll(states, -1, axis=1) - images.state) / scales[:, None]
    matrix, off = shooting_matrix(jacobian), off.reshape(lanes, cycles * rows, 1)
    lane, held = np.nonzero(held_states(images.jacobian).all(axis=1))
    last = (cycles - 1) * rows + held
    matrix[lane, last], off[lane, last] = 0.0, 0.0
    matrix[lane, last, held] = 1.0
    step = solve(matrix, off)
    return step.reshape(states.shape) * scales[:, None]
