"""Stages of a run that find periodic orbits: those of lanes with periodic motion, and stable ones near other lanes."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Int

from vibrojax.io.variables import ORBIT_REASONS, REASONS, orbit_name
from vibrojax.lanes.inputs import Features, Index, LaneInputs, PerLane
from vibrojax.measures import RETURNS_FOR_DRIFT
from vibrojax.measures.labels import FEWEST_RETURNS, REGIMES
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import REPEATS_WITHIN, TIME, state_name
from vibrojax.measures.since_start import half_names, scale_names, stored_scales
from vibrojax.periodic.margin import GRAZING, HOW
from vibrojax.periodic.measuring import Measuring
from vibrojax.periodic.newton import held_states, multipliers
from vibrojax.periodic.orbits import ACCEPTED, MIN_RELATIVE_SWING, Orbits, States
from vibrojax.periodic.return_map import STEPS, Segments
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings

OWN_ORBIT_MIN, OWN_ORBIT_MAX = 1e-2, 0.5
"""Bounds of the scaled distance within which an orbit is attributed to a lane."""

DRIFT_FACTOR = 10.0
"""The same distance as a multiple of the drift estimate. For lanes far from their orbits the estimate is accurate only
to a factor of a few."""

MULTIPLIER_ERROR = 1e-7
"""Bound of a multiplier's error. If the greatest modulus exceeds 1 by less, the orbit may be neutral or stable."""

STATIONARY_ROUNDINGS = 64 * 1e4
"""Largest difference between periods of a lane that stays on an unstable orbit, in units of the rounding error."""

LANE_FEATURES = frozenset(
    {"finite", "finished", "steps", "returns", "trend", "cycles", "impacts", "settling_time", "pulses", "yields"}
)
"""Features of the lane itself, which the features of its orbit do not replace; `impacts` are equal for both."""


def reason(name: str) -> int:
    """Return the flag value of `orbit_reason` with the meaning `name`."""
    return ORBIT_REASONS.index(name)


REACH = 0.5
"""Largest distance of the recorded section crossings from a nearby orbit, in units of the states' scales. Of 197 lanes
(beta 0.1 to 1.2, gamma 0.3 to 1.2) with such an orbit after 40 s, 194 were on it after 300 s. Half this distance finds
fewer orbits, none of them more reliable."""

RETURN_DISTANCE = 0.3
"""Largest distance between section crossings that may repeat, in the same units. Over the default map 468 of 1,184
lanes within this distance have a nearby orbit, but only 2 of 459 lanes at distances between this one and 0.5. Newton's
method takes equally long for every lane."""

NEARBY_MAX_ITERATIONS = 4

MOST_STEPS = 300.0
"""Step limit between two section crossings. A hundred steps are already many, and a diverging Newton iterate may never
return to the section."""

NEARBY_TOLERANCE = 1e-9
"""Tolerance of the step-size control in the return map."""


class OrbitStage:
    """Search for the orbits of lanes with periodic motion, one chunk of lanes at a time: a stage of a run."""

    attribute = "orbits"

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...]) -> None:
        self._scene = scene.driving_part()
        self._measure = Measuring(scene, run, start_names)
        self._map = Segments(self._scene)

    @property
    def described(self) -> dict[str, object]:
        """Entries for the dataset's attribute `orbits`."""
        return {
            "states": list(self._scene.return_states),
            "tolerance": STEPS.tolerance,
            "accepted_residual": ACCEPTED,
            "grazing_limit": GRAZING,
            "grazing_margin": HOW,
        }

    def __call__(self, inputs: LaneInputs, features: Features) -> Features:
        """Return the orbit variables of lanes, and the features of the orbits.

        `features`: features of these lanes, including their last section crossings (lanes, returns); not modified.
        """
        lanes, rows = len(inputs), len(self._scene.return_states)
        result: Features = {
            "multiplier_abs": np.full((lanes, rows), np.nan),
            "multiplier_arg": np.full((lanes, rows), np.nan),
            "stable": np.full(lanes, -1),
            "orbit_residual": np.full(lanes, np.nan),
            "grazing_margin": np.full(lanes, np.nan),
            **{orbit_name(name): np.full(lanes, np.nan) for name in self._scene.return_states},
            **{orbit_name(name): features[name].copy() for name in scale_names(self._scene.section)},
            "orbit_cycles": np.zeros(lanes),
            "orbit_reason": np.full(lanes, reason("not-repeating")),
            "error_estimate": features["error_estimate"].copy(),
        }
        result |= {name: features[name].copy() for name in ("drift_estimate",) if name in features}
        parameters = inputs.driving_parameters
        merged: Features = {}
        with np.errstate(all="ignore"):
            if self._scene.section is None:
                features = features | _repeats_under_pulses(self._scene, features, self._map, parameters)
            cycles = np.nan_to_num(features["cycles"]).astype(int)
            sound = features["finite"] & features["finished"] & (cycles > 0)
            for repeat in range(1, MOST_CYCLES + 1):
                subset = np.flatnonzero(sound & (cycles == repeat))
                if len(subset):
                    orbit = self._find(subset, repeat, parameters, features, result)
                    self._measure_on(orbit, inputs, features, result, merged)
        return result | merged

    def _find(
        self, lanes: Index, repeat: int, parameters: dict[str, np.ndarray], features: Features, result: Features
    ) -> Orbits:
        """Enter the orbits of `lanes`, of `repeat` crossings per period, in `result`; return those to be measured."""
        guess, scale = last_returns(self._scene, lanes, repeat, features)
        drift = features["drift_estimate"][lanes]
        reach = np.where(np.isnan(drift), OWN_ORBIT_MIN, np.clip(DRIFT_FACTOR * drift, OWN_ORBIT_MIN, OWN_ORBIT_MAX))
        distinct, of_lane = _distinct([guess, scale, reach, *(x[lanes] for x in parameters.values())])
        p = {name: x[lanes[distinct]] for name, x in parameters.items()}
        orbit = Orbits.find(self._scene, p, guess[distinct], scale[distinct], reach[distinct], self._map)
        orbit = replace(orbit.of(of_lane), lane=lanes)
        own = orbit.moved <= reach
        if "impacts" in features:
            own &= orbit.impacts == features["impacts"][lanes]
        rules = {
            "not-converged": ~orbit.converged & np.isfinite(orbit.moved),
            "another-orbit": ~own,
            "near-grazing": orbit.reach < GRAZING,
        }
        known = orbit.converged & own
        result["orbit_reason"][lanes] = np.select(list(rules.values()), list(map(reason, rules)), reason("found"))
        result["orbit_residual"][lanes] = np.where(np.isfinite(orbit.residual), orbit.residual, np.nan)
        result["grazing_margin"][lanes] = np.where(known, orbit.margin, np.nan)
        result["orbit_cycles"][lanes] = np.where(known, orbit.minimal_cycles(), 0)
        for name, x in zip(self._scene.return_states, orbit.states[:, 0].T, strict=True):
            result[orbit_name(name)][lanes] = np.where(known, x, np.nan)
        orbit = orbit.of(result["orbit_reason"][lanes] == reason("found"))
        values = orbit.multipliers
        result["multiplier_abs"][orbit.lane] = np.abs(values)
        result["multiplier_arg"][orbit.lane] = np.abs(np.angle(values))
        # A held state neither returns nor departs after a perturbation; the others decide.
        moves = ~held_states(orbit.product)
        decisive = multipliers(orbit.product * moves[:, None, :] * moves[:, :, None])
        result["stable"][orbit.lane] = np.abs(decisive[:, 0]) < 1
        growth = np.log(np.abs(values[:, 0]))
        leaves = growth > MULTIPLIER_ERROR
        leaves[leaves] = ~_stays(orbit.of(leaves), growth[leaves], features)
        # A lane that leaves an unstable orbit settles elsewhere, with an unknown error.
        self._remove(orbit.lane[leaves], result)
        for name in ("error_estimate", "drift_estimate"):
            if name in result:
                result[name][orbit.lane[leaves]] = np.inf
        return orbit.of(~leaves)

    def _remove(self, lanes: Index, result: Features) -> None:
        """Record in `result` that the orbits found do not belong to the `lanes`."""
        result["orbit_reason"][lanes] = reason("another-orbit")
        result["stable"][lanes], result["orbit_cycles"][lanes] = -1, 0
        states = map(orbit_name, self._scene.return_states)
        for name in ("multiplier_abs", "multiplier_arg", "grazing_margin", *states):
            result[name][lanes] = np.nan

    def _measure_on(self, orbit: Orbits, inputs: LaneInputs, own: Features, result: Features, merged: Features) -> None:
        """Replace features of lanes in `merged` by those of their orbits; remove orbits that these contradict."""
        if not len(orbit):
            return
        distinct, of_lane = _distinct(
            [orbit.states[:, 0], orbit.steps, *(x[orbit.lane] for x in inputs.parameters.values())]
        )
        measures, whole = orbit.of(distinct).measured(self._measure, inputs)
        whole = whole[of_lane]
        self._remove(orbit.lane[~whole], result)
        if "period" in measures:
            measures["period"] = (orbit.times.sum(axis=1) / orbit.times.shape[1])[distinct]
        own_features = ("at_rest", *scale_names(self._scene.section), *map(state_name, self._scene.return_states))
        excluded = LANE_FEATURES.union(own_features)
        for name, x in measures.items():
            if x.ndim == 1 and name not in excluded:
                merged.setdefault(name, own[name].copy())[orbit.lane[whole]] = x[of_lane][whole]


class NearbyStage:
    """Search for stable orbits near lanes that have not settled, the probable limits of long transients: a stage.

    Each number of section crossings up to eight is tried as the period of the motion. A number qualifies if all
    recorded crossings nearly repeat after it, the later crossings more closely than the earlier ones. Newton's method
    begins at the crossings that repeat most closely. An orbit is accepted if it is stable, if all recorded crossings
    are near it, and if a simulation confirms its number of impacts.
    """

    attribute = "orbits"

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...]) -> None:
        self._scene = scene.driving_part()
        self._measure = Measuring(scene, run, start_names)
        self._map = Segments(self._scene, steps=STEPS._replace(tolerance=NEARBY_TOLERANCE), most=MOST_STEPS)

    @property
    def described(self) -> dict[str, object]:
        """Entries for the dataset's attribute `orbits`."""
        return {"nearby_reach": REACH}

    def __call__(self, inputs: LaneInputs, features: Features) -> Features:
        """Return `nearby_cycles`, `nearby_impacts` and `nearby_distance` of lanes.

        `features`: features of these lanes, including their last section crossings (lanes, returns). The result is
        empty for scenes driven by pulses, because no criterion shows that such a lane has not settled.
        """
        section = self._scene.section
        if section is None:
            return {}
        without = {"nearby_cycles": 0.0, "nearby_impacts": np.nan, "nearby_distance": np.nan}
        result = {name: np.full(len(inputs), none) for name, none in without.items()}
        settled = (np.nan_to_num(features["cycles"]) > 0) & (features["trend"] == 0)
        lanes = np.flatnonzero(features["finite"] & features["finished"] & ~settled)
        parameters = inputs.driving_parameters
        with np.errstate(all="ignore"):
            returns, scale = last_returns(self._scene, lanes, RETURNS_FOR_DRIFT, features)
            compared = returns[..., : len(section.compared)] / scale[:, None, : len(section.compared)]
            for repeat in range(1, MOST_CYCLES + 1):
                back = np.max(np.abs(compared[:, :-repeat] - compared[:, repeat:]), axis=2)
                enough = np.isfinite(back).sum(axis=1) >= max(FEWEST_RETURNS - 1, 2 * repeat)
                half = back.shape[1] // 2
                closer = np.nanmax(back[:, half:], axis=1) < np.nanmax(back[:, :half], axis=1)
                comes_back = enough & closer & (np.nanmax(back, axis=1) < RETURN_DISTANCE)
                subset = np.flatnonzero(comes_back & (result["nearby_cycles"][lanes] == 0))
                if not len(subset):
                    continue
                closest = np.nanargmin(back[subset], axis=1)
                guess = np.stack([returns[subset, closest + k] for k in range(repeat)], axis=1)
                p = {name: x[lanes[subset]] for name, x in parameters.items()}
                near = guess, scale[subset], REACH
                orbit = Orbits.find(self._scene, p, *near, self._map, ACCEPTED, NEARBY_MAX_ITERATIONS)
                # The greatest scaled distance of a section crossing from the nearest state of the orbit.
                on_orbit = (orbit.states / orbit.scales[:, None])[..., : compared.shape[2]]
                apart = np.max(np.abs(compared[subset][:, :, None] - on_orbit[:, None]), axis=3)
                distance = np.nanmax(np.min(apart, axis=2), axis=1)
                kept = self._confirmed(inputs, replace(orbit, lane=lanes[subset]), distance)
                result["nearby_cycles"][lanes[subset[kept]]] = repeat
                result["nearby_impacts"][lanes[subset[kept]]] = orbit.impacts[kept]
                result["nearby_distance"][lanes[subset[kept]]] = distance[kept]
        return result

    def _confirmed(self, inputs: LaneInputs, orbit: Orbits, distance: PerLane) -> Int[np.ndarray, " kept"]:
        """Return the indices of the orbits that are stable, near their lane, and confirmed by a simulation."""
        right = orbit.converged & orbit.stable & (orbit.margin >= GRAZING) & (distance < REACH)
        sure = np.flatnonzero(right & (orbit.minimal_cycles() == orbit.states.shape[1]))
        return sure[orbit.of(sure).measured(self._measure, inputs)[1]] if len(sure) else sure


def _stays(orbit: Orbits, growth: PerLane, features: Features) -> Bool[np.ndarray, " lanes"]:
    """Return a mask of lanes that provably stay on an unstable orbit, for example because of an exact symmetry.

    Their last section crossings repeat within rounding errors. Since the lanes settled, a single rounding error would
    have grown to a visible difference. `growth`: logarithm of the orbit's greatest multiplier over one period.
    """
    lanes, repeat = orbit.lane, orbit.states.shape[1]
    if "settling_time" not in features:
        return np.zeros(len(lanes), bool)
    times = features[TIME][lanes].astype(float)
    returns, _ = last_returns(orbit.scene, lanes, times.shape[1], features)
    moved = np.nan_to_num(np.abs(returns[:, repeat:] - returns[:, :-repeat]) / orbit.scales[:, None])
    rounding = float(np.finfo(features["period"].dtype).eps)
    still = np.max(moved, axis=(1, 2), initial=0.0) <= STATIONARY_ROUNDINGS * rounding
    repeats = (times[:, -1] - features["settling_time"][lanes]) / (repeat * features["period"][lanes])
    return still & (growth * repeats > np.log(REPEATS_WITHIN / rounding))


def _distinct(columns: list[np.ndarray]) -> tuple[Int[np.ndarray, " distinct"], Index]:
    """Return the first lane of each group with bitwise equal columns (lanes, ...), and the group of each lane.

    Lanes that stopped early on a shared orbit form such groups, whose results are computed once.
    """
    rows = np.concatenate([x.reshape(len(x), -1).astype(float) for x in columns], axis=1)
    numbers: dict[bytes, int] = {}
    of_lane = np.array([numbers.setdefault(row.tobytes(), len(numbers)) for row in rows], int)
    return np.unique(of_lane, return_index=True)[1], of_lane


def last_returns(scene: Any, lanes: Index, repeat: int, features: Features) -> tuple[States, np.ndarray]:
    """Return the states at the last section crossings (lanes, cycles, states), and their scales (lanes, states).

    The scale is NaN for states that labels do not compare.
    """
    rows = [features[state_name(name)][lanes][:, -repeat:].astype(float) for name in scene.return_states]
    known: list[Any] = []
    if scene.section is not None:
        halves = [features[name][lanes] for name in half_names(scene.section)]
        newest = [row[:, -1] for row in rows[: len(scene.section.compared)]]
        known = stored_scales(scene.section, halves, features["period"][lanes], newest)
    unknown = [np.full(len(lanes), np.nan)] * (len(rows) - len(known))
    return np.stack(rows, axis=-1), np.stack([*known, *unknown], axis=-1).astype(float)


def _repeats_under_pulses(scene: Scene[Any], features: Features, go: Segments, parameters: Features) -> Features:
    """Return `cycles`, `drift_estimate` and the last states at pulses (lanes, returns), newest last.

    The return map `go` is iterated from the state at the last pulse. `cycles` is the smallest number of pulses, up to
    8, after which every state is back to within 1e-3 of its amplitude; it is 0 if there is none.
    """
    names = [state_name(name) for name in scene.return_states]
    begin = np.stack([features[name][:, -1] for name in names]).astype(float)
    rows, count = begin.shape
    passed = np.full((rows, count, MOST_CYCLES), np.nan)
    cycles = np.zeros(count)
    least, greatest, state = begin.copy(), begin.copy(), begin.copy()
    active = np.flatnonzero(np.isfinite(begin).all(axis=0))
    for pulses in range(1, MOST_CYCLES + 1):
        if not len(active):
            break
        passed[:, active] = np.roll(passed[:, active], -1, axis=-1)
        passed[:, active, -1] = state[:, active]
        mapped = go({name: x[active] for name, x in parameters.items()}, state[:, active])
        state[:, active] = mapped.state
        least[:, active] = np.minimum(least[:, active], mapped.seen.least)
        greatest[:, active] = np.maximum(greatest[:, active], mapped.seen.greatest)
        size = np.maximum(greatest[:, active], -least[:, active])
        swing = np.maximum((greatest[:, active] - least[:, active]) / 2, MIN_RELATIVE_SWING * size)
        back = np.all(np.abs(mapped.state - begin[:, active]) <= REPEATS_WITHIN * swing, axis=0)
        cycles[active[back & mapped.seen.returned]] = pulses
        active = active[~back & mapped.seen.returned]
    unknown = np.full(count, np.nan)
    return {"cycles": cycles, "drift_estimate": unknown, **dict(zip(names, passed, strict=True))}


def why_no_orbit(lane: xr.Dataset) -> str:
    """Return the end of a sentence about the motion of one lane: why the dataset holds no orbit of it."""
    reason = ORBIT_REASONS[int(lane["orbit_reason"])]
    if reason == "refused":
        return f"cannot be run ({REASONS[int(lane['reason'])].replace('-', ' ')})"
    if reason == "not-repeating":
        settle = json.loads(str(lane.attrs["run"]))["settle"]
        return f"does not repeat ({REGIMES[int(lane['regime'])]} after {settle:g} s)"
    return f"repeats, but its orbit is not known ({reason.replace('-', ' ')})"
