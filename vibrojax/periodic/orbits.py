"""Periodic orbits of many lanes at once: Newton's method by multiple shooting between section crossings.

An orbit with p section crossings per period has p states s_k at the section. The return map P takes each state to the
next, and the last to the first. All segments are mapped in one batch. The Newton steps d_k of each lane solve the
block-cyclic system

    P'(s_k) d_k - d_{k+1} = s_{k+1} - P(s_k)

Even an orbit with large multipliers is thus integrated only from one section crossing to the next (Stoer and Bulirsch,
*Introduction to Numerical Analysis*, section 7.3.5).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Complex, Float, Int

from vibrojax.io.variables import ORBIT_REASONS, orbit_name
from vibrojax.lanes.inputs import Features, LaneInputs
from vibrojax.lanes.programs import LaneArguments
from vibrojax.lazy import jax
from vibrojax.measures.since_start import half_names, scale_names, stored_scales
from vibrojax.periodic.derivatives import NEUTRAL, NO_ORBIT, OrbitFeatures, differentiated
from vibrojax.periodic.margin import over_period
from vibrojax.periodic.measuring import ORBIT_ACCURACY, Measuring
from vibrojax.periodic.newton import (
    branch_determinant,
    chain,
    distance_of,
    images_by_lane,
    multipliers,
    newton_step,
    residual_of,
    same_branch,
)
from vibrojax.periodic.return_map import Segments, beyond_impacts, driving_values
from vibrojax.scenes import Scene
from vibrojax.stepping import Accuracy

NEWTON_RESIDUAL = 1e-12
"""Residual at which the iteration stops, because rounding errors dominate."""

ACCEPTED = 1e-10
"""Largest residual of an orbit that counts as converged."""

EXACT = 1e-14
"""Residual below which an orbit is not refined."""

MIN_RELATIVE_SWING = 1e-3
"""Smallest scale of a state, relative to its magnitude; the range of a state at rest is only rounding noise."""

NEWTON_MAX_ITERATIONS = 8

KINK_STEP, MOST_KINK = 1e-6, 1e-3
"""Scaled change of the states to both sides of an orbit on which two events happen at one instant, and the difference
of the slopes there from which on the map has no derivative: each order of the events then has a slope of its own."""

SAME_STATE = 1e-6
"""Scaled distance (in units of the states' scales) within which two states of an orbit count as equal."""

SAME_ORBIT = 1e-4
"""Scaled distance below which two orbits are the same; Newton's method finds orbits to 1e-10."""

PerOrbit = Float[np.ndarray, " orbits"]
Mask = Bool[np.ndarray, " orbits"]
Index = Int[np.ndarray, " _"]
States = Float[np.ndarray, "orbits cycles states"]
Scales = Float[np.ndarray, "orbits states"]


@cache
def _register_as_tree() -> None:
    """Register `Orbits` as a pytree. This waits for the first object because it imports jax."""
    jax.tree_util.register_dataclass(Orbits)


@dataclass(frozen=True, eq=False)
class Orbits:
    """Periodic orbits of a scene with equally many section crossings per period; some may not have converged.

    - `scene`; `parameters`: values by name, at least of the scene's driving part, to which the orbits belong.
    - `states`, `times` [s]: states at the section, and time from each state to the next; `scales`: of the states.
    - `residual`: greatest scaled difference between an image and the next state; infinite if an orbit did not return.
    - `product`: derivative of the map over one period of the motion.
    - `step`: next Newton step, which has not been applied; its size estimates the distance from the orbit.
    - `moved`: greatest scaled distance from the initial guess; infinite if it exceeded the limit `reach`.
    - `impacts`: number of impacts in one period; `steps`: number of steps to each next crossing.
    - `margin`: smallest grazing margin; `reach`: the margin that limits the validity of the derivative.
    - `lane`: index of the lane that each orbit comes from.
    """

    scene: Scene[Any] = field(metadata={"static": True})
    parameters: Mapping[str, PerOrbit]
    states: States
    scales: Scales
    times: Float[np.ndarray, "orbits cycles"]
    residual: PerOrbit
    product: Float[np.ndarray, "orbits states states"]
    step: States
    moved: PerOrbit
    impacts: PerOrbit
    margin: PerOrbit
    reach: PerOrbit
    steps: Float[np.ndarray, "orbits cycles"]
    lane: Index

    def __post_init__(self) -> None:
        _register_as_tree()

    @classmethod
    @np.errstate(all="ignore")
    def find(
        cls,
        scene: Scene[Any],
        parameters: Mapping[str, PerOrbit],
        guess: States,
        scales: Scales | None = None,
        within: PerOrbit | float = np.inf,
        go: Segments | None = None,
        enough: float = NEWTON_RESIDUAL,
        iterations: int = NEWTON_MAX_ITERATIONS,
        same_side: bool = False,
    ) -> "Orbits":
        """Return the orbits near the initial guesses, with the same number of section crossings as the guesses.

        **Arguments:**

        - `scales`: a NaN, as the default, is replaced by half the peak-to-peak range of the state along the motion
          from the guess, or by 1 if that range is zero.
        - `within`: scaled distance from the guess beyond which an orbit is no longer iterated.
        - `go`: the return map of the driving part, by default at its usual accuracy.
        - `enough`: residual at which the iteration of an orbit stops; `iterations`: their largest number.
        - `same_side`: whether det(I - A) must have the same sign at the guess and at the orbit. Otherwise the guess is
          beyond a point at which branches meet, such as a pitchfork, and the orbit may be on another branch.

        The derivative is evaluated at the states in the result, so callers may apply one more `step`.
        """
        count, cycles, rows = guess.shape
        go, own = go or Segments(scene.driving_part()), driving_values(scene, parameters)
        within = np.broadcast_to(np.asarray(within, float), count)

        def evaluate(states: States, orbits: Index) -> Any:
            index = np.repeat(orbits, cycles)
            mapped = go({name: x[index] for name, x in own.items()}, states.reshape(-1, rows).T)
            images = images_by_lane(mapped, len(states), cycles)
            return images._replace(jacobian=images.jacobian[..., :rows])  # without parameters of the map

        best = evaluate(guess, np.arange(count))
        side = branch_determinant(chain(best.jacobian))
        greatest, least = best.seen.greatest.max(axis=1), best.seen.least.min(axis=1)
        swing = np.maximum((greatest - least) / 2, MIN_RELATIVE_SWING * np.maximum(greatest, -least))
        swing = np.where(swing > 0, swing, 1.0)
        scales = swing if scales is None else np.where(np.isnan(scales), swing, scales)
        states, residual = guess.copy(), residual_of(guess, best, scales)
        outside, active = np.zeros(count, bool), np.flatnonzero((residual > enough) & np.isfinite(residual))
        iterate, now = guess[active], jax.tree.map(lambda x: x[active], best)
        for _ in range(iterations):
            iterate = iterate + newton_step(iterate, now, scales[active])
            # Far from the orbit, reaching the section may take thousands of steps.
            distance = distance_of(iterate, guess[active], scales[active])
            outside[active[distance > within[active]]] = True
            near = distance <= within[active]
            active, iterate = active[near], iterate[near]
            if not len(active):
                break
            now = evaluate(iterate, active)
            reached, before = residual_of(iterate, now, scales[active]), residual[active]
            better = reached < before
            kept = active[better]
            states[kept], residual[kept] = iterate[better], reached[better]
            _assign(best, kept, jax.tree.map(lambda x, better=better: x[better], now))
            # A small residual that hardly decreases is dominated by rounding errors.
            on = np.isfinite(reached) & (reached > enough) & ((reached < before / 2) | (reached > ACCEPTED))
            active, iterate, now = active[on], iterate[on], jax.tree.map(lambda x, on=on: x[on], now)
        product, (margin, reach) = chain(best.jacobian), over_period(best.seen.margin).T
        together = np.flatnonzero((reach == 0) & (residual <= ACCEPTED))
        if len(together):
            off, unit = KINK_STEP * np.sqrt(1.0 + np.arange(rows)), scales[together, None]
            ahead, behind = (evaluate(states[together] + sign * off * unit, together).state for sign in (1.0, -1.0))
            kink = np.abs(ahead + behind - 2 * jax.tree.map(lambda x: x[together], best).state) / unit
            smooth = kink.max(axis=(1, 2)) < MOST_KINK * KINK_STEP
            reach[together] = np.where(smooth, margin[together], 0.0)
        outside |= same_side & (side * branch_determinant(product) < 0)
        return cls(
            scene=scene,
            parameters={name: np.asarray(x, float) for name, x in parameters.items()},
            states=states,
            scales=scales,
            times=best.time,
            residual=residual,
            product=product,
            step=newton_step(states, best, scales),
            moved=np.where(outside, np.inf, distance_of(states, guess, scales)),
            impacts=best.seen.impacts.sum(axis=1),
            margin=margin,
            reach=reach,
            steps=best.seen.steps,
            lane=np.arange(count),
        )

    @classmethod
    def trace(
        cls,
        scene: Scene[Any],
        parameters: Mapping[str, PerOrbit],
        begin: Scales,
        cycles: int,
        go: Segments | None = None,
    ) -> "Orbits":
        """Return known orbits with `cycles` crossings per period, from one state of each at the section."""
        go, states = go or Segments(scene.driving_part()), [begin]
        for _ in range(cycles - 1):
            states.append(np.asarray(go(driving_values(scene, parameters), states[-1].T).state).T)
        return cls.find(scene, parameters, np.stack(states, axis=1), go=go, iterations=0)

    def __len__(self) -> int:
        return len(self.states)

    def of(self, index: Index | Mask | Sequence[int]) -> "Orbits":
        """Return a subset of the orbits."""
        return jax.tree.map(lambda x: x[np.asarray(index)], self)

    @staticmethod
    def joined(parts: "Iterable[Orbits]") -> "Orbits":
        """Return the orbits of all `parts`, which have equally many section crossings per period."""
        return jax.tree.map(lambda *x: np.concatenate(x), *parts)

    @property
    def converged(self) -> Mask:
        """Mask of the orbits that solve the equations."""
        return np.asarray((self.residual <= ACCEPTED) & np.isfinite(self.moved))

    @property
    def determinant(self) -> PerOrbit:
        """Determinant of I - A, where A is the derivative of the map over one period; zero where branches meet."""
        return branch_determinant(self.product)

    @property
    def stable(self) -> Mask:
        """Mask of the orbits whose multipliers have moduli below 1."""
        return np.abs(self.multipliers[:, 0]) < 1

    @property
    def multipliers(self) -> Complex[np.ndarray, "orbits states"]:
        """Multipliers by decreasing modulus; NaN where the derivative is not finite."""
        return multipliers(self.product)

    @property
    def neutral(self) -> Mask:
        """Mask of the orbits with a multiplier of 1, which do not depend smoothly on the parameters."""
        return ~(np.abs(1 - self.multipliers).min(axis=1) >= NEUTRAL)

    def minimal_cycles(self, within: float = SAME_STATE) -> Int[np.ndarray, " orbits"]:
        """Return the least number of section crossings per period of each orbit, a divisor of its number of states.

        States within this scaled distance count as equal.
        """
        repeat = self.states.shape[1]
        minimal = np.full(len(self), repeat)
        for divisor in (q for q in range(repeat - 1, 0, -1) if repeat % q == 0):
            apart = np.abs(np.roll(self.states, divisor, axis=1) - self.states) / self.scales[:, None]
            minimal[np.max(apart, axis=(1, 2)) <= within] = divisor
        return minimal

    def refined(self, mask: Mask | None = None) -> "Orbits":
        """Return the orbits after one more Newton step, by default of those that converged.

        The step leaves nothing but rounding errors. Exact states, such as rest, are left alone.
        """
        if mask is None:
            mask = self.converged & (self.residual > EXACT) & np.isfinite(self.step).all(axis=(1, 2))
        return replace(self, states=self.states + np.where(mask[:, None, None], self.step, 0.0))

    def contain(
        self, states: Float[np.ndarray, "lanes states"], within: float = SAME_ORBIT
    ) -> Bool[np.ndarray, " lanes"]:
        """Return which states at the section are on the orbits, each on its own or all on a single one."""
        apart = np.abs(states[:, None] - self.states) / self.scales[:, None]
        return np.asarray(apart.max(axis=2).min(axis=1) < within)

    def same_as(self, other: "Orbits", within: float = SAME_ORBIT) -> Mask:
        """Return which orbits are those of `other`, each its own or all a single one.

        An orbit is the same as that of half its period which it has become in a period doubling.
        """
        return other.contain(self.states[:, 0], within)

    def carry_to(
        self,
        parameters: Mapping[str, PerOrbit],
        *,
        within: float,
        least: float,
        first: float = 1.0,
        cautious: float = 0.0,
        by: Sequence[str] = (),
        slopes: OrbitFeatures | None = None,
        accept: "Callable[[Orbits], Mask]" = lambda orbits: orbits.converged,
        scales: Scales | None = None,
        go: Segments | None = None,
    ) -> "tuple[Orbits, Mask]":
        """Return the orbits that these become at other parameters, and a mask of those that arrive there.

        The parameters vary along straight lines. States are predicted from the slopes at the last orbit, or from the
        last step, and corrected by Newton's method. After an orbit that is not accepted the step is halved, otherwise
        doubled. Where a rigid impact passes the section on the way, the state at the section jumps, and the orbit is
        continued from its other side. Orbits that do not arrive are returned at the last point at which they were
        accepted.

        With `by`, a step must agree with the slopes at both of its ends (see `same_branch`), so that it does not lead
        to another branch, however near this is.

        **Arguments:**

        - `within`: scaled distance from the prediction beyond which an orbit counts as another one.
        - `first`, `least`: first and least step, as fractions of the way.
        - `cautious`: step below which a step is doubled only after two accepted orbits, since the branch probably ends.
        - `by`, `slopes`: parameters that vary, and the derivatives of these orbits with respect to them. Without `by`,
          predictions use the last step, and a step may lead to another branch.
        - `accept`: mask of the orbits that count as a continuation, of orbits that have converged.
        - `scales`: unit of distances from predictions; by default the half swings, as in `find`.
        """
        here = self.of(np.arange(len(self)))
        rate, trend = np.zeros_like(self.states), np.zeros(len(self))
        if by:
            way = np.stack([parameters[name] - self.parameters[name] for name in by], axis=1)
            rate, trend = (self.derivatives((), by) if slopes is None else slopes).along(way)
        done, step, halved = np.zeros(len(self)), np.full(len(self), first), np.zeros(len(self), bool)
        active = np.arange(len(self))

        def correct(lanes: Index, goal: Mapping[str, PerOrbit], guess: States) -> tuple[Orbits, Mask]:
            unit = None if scales is None else scales[lanes]
            orbit = Orbits.find(self.scene, goal, guess, unit, within, go, same_side=True).refined()
            return orbit, orbit.converged & (orbit.moved <= within) & accept(orbit)

        while len(active):
            advance = np.minimum(step[active], 1 - done[active])
            share = done[active] + advance
            ends = {name: (x[active], parameters[name][active]) for name, x in self.parameters.items()}
            goal = {name: np.where(share < 1, x + share * (end - x), end) for name, (x, end) in ends.items()}
            guess = here.states[active] + rate[active] * advance[:, None, None]
            orbit, good = correct(active, goal, guess)
            jumps, failed = np.zeros(len(active), bool), np.flatnonzero(~good)
            other, passed = beyond_impacts(self.scene, {name: x[failed] for name, x in goal.items()}, guess[failed])
            if len(failed := failed[passed]):
                beyond, sound = correct(active[failed], {name: x[failed] for name, x in goal.items()}, other[passed])
                good[failed] = jumps[failed] = sound
                _assign(orbit, failed[sound], beyond.of(sound))
            if by:
                new = np.flatnonzero(good)
                lanes, ahead, h = active[new], orbit.of(new), advance[new]
                rates, trends = ahead.derivatives((), by).along(way[lanes])
                off = ahead.states - here.states[lanes] - (rate[lanes] + rates) / 2 * h[:, None, None]
                d = here.of(lanes).determinant, ahead.determinant
                off = np.abs(off) / here.scales[lanes, None]
                good[new] = same = same_branch(off, d, (trend[lanes] * h, trends * h), jumps[new])
                rate[lanes[same]], trend[lanes[same]] = rates[same], trends[same]
            accepted, rejected = active[good], active[~good]
            if not by:
                moved = np.where(jumps[:, None, None], 0.0, orbit.states - here.states[active])
                rate[accepted] = moved[good] / advance[good, None, None]
            _assign(here, accepted, replace(orbit.of(good), lane=self.lane[accepted]))
            done[accepted] = share[good]
            waits = halved[accepted] & (advance[good] < cautious)
            step[accepted], step[rejected] = np.where(waits, 1, 2) * advance[good], advance[~good] / 2
            halved[active] = ~good
            active = active[(done[active] < 1) & (step[active] >= least)]
        return here, done >= 1

    @np.errstate(all="ignore")
    def derivatives(self, of: Sequence[str], by: Sequence[str]) -> OrbitFeatures:
        """Return the features `of` the orbits, and their derivatives with respect to the parameters `by`.

        `of`: names in [vibrojax.periodic.derivatives.orbit_variables][]. `parameters` must hold all of the scene's.
        """
        (count, cycles, rows), index = self.states.shape, np.flatnonzero(self.converged)
        result = OrbitFeatures(
            values=np.full((count, len(of)), np.nan),
            derivatives=np.full((count, len(of), len(by)), np.nan),
            reason=np.full((count, len(of)), NO_ORBIT),
            state_derivatives=np.full((count, cycles, rows, len(by)), np.nan),
            determinant_derivatives=np.full((count, len(by)), np.nan),
        )
        if len(index):
            own = {name: np.asarray(x, float)[index] for name, x in self.parameters.items()}
            orbit = self.states[index], self.scales[index], self.steps[index].sum(axis=1)
            for whole, part in zip(result, differentiated(self.scene, of, by, own, *orbit), strict=True):
                whole[index] = part
        return result

    def measured(
        self, measure: Measuring, inputs: LaneInputs | LaneArguments, accuracy: Accuracy = ORBIT_ACCURACY
    ) -> tuple[Features, Mask]:
        """Return the features over one period, and a mask of the orbits with the expected numbers of crossings.

        `inputs`: chunk of lanes, of which `lane` holds the indices. If lanes have impacts, the number of these must
        also be that of the orbit.
        """
        orbit = self.lane, self.states, self.times, self.steps.sum(axis=1)
        features, whole = measure(inputs, *orbit, accuracy)
        if "impacts" in features:
            features["impacts"] = np.round(features["impacts"] * self.states.shape[1])
            whole &= features["impacts"] == self.impacts
        return features, whole


def orbits_of(
    scene: Scene[Any],
    lanes: Mapping[str, np.ndarray] | xr.Dataset,
    parameters: Mapping[str, np.ndarray],
    index: Index | None = None,
) -> list[Orbits]:
    """Return the orbits of lanes, one batch for each number of section crossings per period.

    **Arguments:** `lanes`: variables of all lanes by name, such as a dataset with orbits; `parameters`: their values,
    in the same order; `index`: lanes, by default all with a found orbit.
    """

    def column(name: str) -> np.ndarray:
        return np.asarray(lanes[name]).ravel()

    if index is None:
        index = np.flatnonzero(column("orbit_reason") == ORBIT_REASONS.index("found"))
    driving = scene.driving_part()
    cycles, section = column("orbit_cycles").astype(int), driving.section
    batches = []
    for repeat in np.unique(cycles[index]).tolist():
        lane = index[cycles[index] == repeat]
        begin = np.stack([column(orbit_name(name))[lane] for name in driving.return_states], axis=1)
        values = {name: np.asarray(x, float)[lane] for name, x in parameters.items()}
        orbit = replace(Orbits.trace(scene, values, begin, repeat), lane=lane)
        if section is not None:
            names = list(map(orbit_name, scale_names(section))) or half_names(section)
            halves = [column(name)[lane] for name in names]
            compared = begin.T[: len(section.compared)]
            for k, scale in enumerate(stored_scales(section, halves, column("period")[lane], [*compared])):
                orbit.scales[:, k] = scale
        batches.append(orbit)
    return batches


def _assign(whole: Any, index: Index, part: Any) -> None:
    """Overwrite some entries of all arrays of `whole` by those of `part`."""
    for before, after in zip(jax.tree.leaves(whole), jax.tree.leaves(part), strict=True):
        before[index] = after
