"""Newton's method for the orbits of many lanes at once: multiple shooting from return to return.

An orbit of p returns has p states s_k at the section, each of which the return map P takes to the next and the last to
the first. All segments go through the map together, and each lane's block-cyclic system

    P'(s_k) d_k - d_{k+1} = s_{k+1} - P(s_k)

gives the step; so that a map that stretches is never followed for longer than one return (Stoer and Bulirsch,
*Introduction to Numerical Analysis*, section 7.3.5).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.periodic.return_map import Mapped, Seen

CONVERGED = 1e-12
"""Residual at which nothing is left to gain but roundings."""

ACCEPTED = 1e-10
"""Residual of an orbit that counts as found."""

LEAST_SWING = 1e-3
"""Part of its size that a state's half swing is taken for at least: one that stands still moves by its roundings."""

MOST_ITERATIONS = 8

SAME = 1e-6
"""Distance over the scales within which two states of an orbit are one."""

States = Float[np.ndarray, "lanes cycles states"]
Index = Int[np.ndarray, " some"]
ReturnMap = Callable[[Index, Float[np.ndarray, "states segments"]], Mapped]
"""`return_map(lanes, states)`: the next return of segments, each of one of the lanes, by index."""


class Found(NamedTuple):
    """What Newton's method came to, over lanes that repeat after the same number of returns.

    - `states`: at the section; `scales` (lanes, states) of them; `times` (lanes, cycles) [s]: from each to the next.
    - `residual` (lanes,): greatest return - state, over the scales; infinite where a lane did not return.
    - `product` (lanes, states, states): derivative of the map over the whole repeat.
    - `step`: Newton's step from there, which was not taken; its size is about the distance from the orbit.
    - `moved` (lanes,): greatest distance from where it began, over the scales; infinite where it left the reach.
    - `impacts` in the repeat, the least `margin`, and the `steps` of it, each (lanes,).
    """

    states: States
    scales: Float[np.ndarray, "lanes states"]
    times: Float[np.ndarray, "lanes cycles"]
    residual: Float[np.ndarray, " lanes"]
    product: Float[np.ndarray, "lanes states states"]
    step: States
    moved: Float[np.ndarray, " lanes"]
    impacts: Float[np.ndarray, " lanes"]
    margin: Float[np.ndarray, " lanes"]
    steps: Float[np.ndarray, " lanes"]

    def of(self, lanes: Index) -> "Found":
        """Those of some of the lanes, by index."""
        return Found(*(x[lanes] for x in self))


class _Evaluated(NamedTuple):
    """The map at the states of lanes: where it leads, times, derivatives, and what it saw; all (lanes, cycles, ...)."""

    there: States
    times: Float[np.ndarray, "lanes cycles"]
    jacobian: Float[np.ndarray, "lanes cycles states states"]
    seen: Any


def orbits(
    begin: States,
    scales: Float[np.ndarray, "lanes states"],
    reach: np.ndarray,
    go: ReturnMap,
    enough: float = CONVERGED,
    most: int = MOST_ITERATIONS,
) -> Found:
    """The orbits near the states `begin` of lanes that repeat after as many returns as these have.

    **Arguments:**

    - `scales`: of the states; those that are NaN are half the swing on the way from return to return.
    - `reach` (lanes,): how far, over the scales, a lane may be moved; it is left alone beyond.
    - `enough`: residual at which a lane is done; `most`: iterations, at most.

    What was found stands where its derivative was taken, so that one more step may be taken by it (`Found.step`).
    """
    lanes = len(begin)
    best = _evaluated(begin, np.arange(lanes), go)
    scales = np.where(np.isnan(scales), _swings(best.seen), scales)
    states, residual = begin.copy(), _residual(begin, best, scales)
    at, now = begin, best
    left = np.zeros(lanes, bool)
    active = np.arange(lanes)
    for _ in range(most):
        on = (residual[active] > enough) & np.isfinite(residual[active])
        active, at, now = active[on], at[on], _of(now, on)
        if not len(active):
            break
        at = at + _step(at, now, scales[active])
        # From far away it may take thousands of steps to return.
        distance = _distance(at, begin[active], scales[active])
        left[active[distance > reach[active]]] = True
        on = distance <= reach[active]
        active, at = active[on], at[on]
        if not len(active):
            break
        now = _evaluated(at, active, go)
        found = _residual(at, now, scales[active])
        before = residual[active]
        better = found < before
        kept = active[better]
        states[kept], residual[kept] = at[better], found[better]
        for whole, part in zip(_leaves(best), _leaves(now), strict=True):
            whole[kept] = part[better]
        # What no longer comes closer by much stands at its roundings, or has no orbit here.
        on = np.isfinite(found) & ((found < before / 2) | (found > ACCEPTED))
        active, at, now = active[on], at[on], _of(now, on)
    return Found(
        states=states,
        scales=scales,
        times=best.times,
        residual=residual,
        product=_product(best.jacobian),
        step=_step(states, best, scales),
        moved=np.where(left, np.inf, _distance(states, begin, scales)),
        impacts=best.seen.impacts.sum(axis=1),
        margin=best.seen.margin.min(axis=1),
        steps=best.seen.steps.sum(axis=1),
    )


def repeats_after(orbit: Found, same: float = SAME) -> Int[np.ndarray, " lanes"]:
    """Returns after which orbits repeat: as many as they have states, or fewer, which divide that.

    States that are no farther apart than `same`, over the scales, are taken for one.
    """
    repeat = orbit.states.shape[1]
    found = np.full(len(orbit.states), repeat)
    for sooner in (q for q in range(repeat - 1, 0, -1) if repeat % q == 0):
        apart = np.abs(np.roll(orbit.states, sooner, axis=1) - orbit.states) / orbit.scales[:, None]
        found[np.max(apart, axis=(1, 2)) <= same] = sooner
    return found


def _evaluated(states: States, lanes: Index, go: ReturnMap) -> _Evaluated:
    """The map at every state of lanes."""
    count, cycles, rows = states.shape
    flat = states.reshape(-1, rows).T
    mapped = go(np.repeat(lanes, cycles), flat)

    def by_lane(x: Any) -> np.ndarray:
        return np.moveaxis(np.array(x), -1, 0).reshape(count, cycles, *np.shape(x)[:-1])

    seen = Seen(*map(by_lane, mapped.seen))
    return _Evaluated(by_lane(mapped.state), by_lane(mapped.time), by_lane(mapped.jacobian), seen)


def _leaves(evaluated: _Evaluated) -> list[np.ndarray]:
    return [*evaluated[:3], *evaluated.seen]


def _of(evaluated: _Evaluated, lanes: Bool[np.ndarray, " lanes"]) -> _Evaluated:
    first, second, third, *seen = (one[lanes] for one in _leaves(evaluated))
    return _Evaluated(first, second, third, Seen(*seen))


def _swings(seen: Any) -> Float[np.ndarray, "lanes states"]:
    """Half the swings over the repeat; of what hardly moves a part of its size, and 1 for what is zero all the way."""
    most, least = seen.greatest.max(axis=1), seen.least.min(axis=1)
    half = np.maximum((most - least) / 2, LEAST_SWING * np.maximum(most, -least))
    return np.where(half > 0, half, 1.0)


def _residual(states: States, now: _Evaluated, scales: np.ndarray) -> Float[np.ndarray, " lanes"]:
    off = np.abs(now.there - np.roll(states, -1, axis=1)) / scales[:, None]
    found = np.where(now.seen.returned.all(axis=1), off.max(axis=(1, 2)), np.inf)
    return np.where(np.isnan(found), np.inf, found)


def _distance(states: States, begin: States, scales: np.ndarray) -> Float[np.ndarray, " lanes"]:
    return np.max(np.abs(states - begin) / scales[:, None], axis=(1, 2))


def _step(states: States, now: _Evaluated, scales: np.ndarray) -> States:
    """Newton's step; solved over the scales, so that all unknowns are alike in size."""
    lanes, cycles, rows = states.shape
    jacobian = now.jacobian * scales[:, None, None, :] / scales[:, None, :, None]
    off = (np.roll(states, -1, axis=1) - now.there) / scales[:, None]
    blocks = np.zeros((lanes, cycles, rows, cycles, rows))
    for k in range(cycles):
        blocks[:, k, :, k] += jacobian[:, k]
        blocks[:, k, :, (k + 1) % cycles] -= np.eye(rows)
    matrix: np.ndarray = blocks.reshape(lanes, cycles * rows, cycles * rows)
    right = off.reshape(lanes, cycles * rows, 1)
    sound = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=(1, 2))
    matrix = np.where(sound[:, None, None], matrix, np.eye(cycles * rows))
    # Exactly at a fold there is no step; what others take must not depend on such a lane beside them.
    singular = np.linalg.slogdet(matrix)[0] == 0
    step = np.linalg.solve(np.where(singular[:, None, None], np.eye(cycles * rows), matrix), right)
    step[singular] = np.nan
    return step.reshape(states.shape) * scales[:, None]


def _product(jacobian: Float[np.ndarray, "lanes cycles states states"]) -> Float[np.ndarray, "lanes states states"]:
    product = jacobian[:, 0]
    for k in range(1, jacobian.shape[1]):
        product = jacobian[:, k] @ product
    return product
