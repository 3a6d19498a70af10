"""Periodic orbits of a sweep's lanes: Newton's method from the last section crossings, multipliers, and features."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from vibrojax.io.variables import ORBIT_REASONS, orbit_name
from vibrojax.lanes.inputs import Features, Index, LaneInputs
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import REPEATS_WITHIN, TIME, state_name
from vibrojax.measures.since_start import half_names, scale_names, stored_scales
from vibrojax.periodic.margin import GRAZING, HOW, Measuring, OrbitStart, begun, joined
from vibrojax.periodic.newton import (
    ACCEPTED,
    MIN_RELATIVE_SWING,
    PerLane,
    States,
    held_states,
    multipliers,
    orbits,
    repeats_after,
    spectral_radius,
)
from vibrojax.periodic.return_map import STEPS, ReturnMap, Segments
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


class Orbits:
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
        parts: list[OrbitStart] = []
        with np.errstate(all="ignore"):
            if self._scene.section is None:
                features = features | _repeats_under_pulses(self._scene, features, self._map.of(parameters))
            cycles = np.nan_to_num(features["cycles"]).astype(int)
            sound = features["finite"] & features["finished"] & (cycles > 0)
            for repeat in range(1, MOST_CYCLES + 1):
                subset = np.flatnonzero(sound & (cycles == repeat))
                if len(subset):
                    parts.append(self._find(subset, repeat, parameters, features, result))
            return result | (self._measured(inputs, joined(parts), features, result) if parts else {})

    def _find(
        self, lanes: Index, repeat: int, parameters: dict[str, np.ndarray], features: Features, result: Features
    ) -> OrbitStart:
        """Enter the orbits of `lanes`, of `repeat` crossings per period, in `result`; return those to be measured."""
        guess, scale = last_returns(self._scene, lanes, repeat, features)
        drift = features["drift_estimate"][lanes]
        reach = np.where(np.isnan(drift), OWN_ORBIT_MIN, np.clip(DRIFT_FACTOR * drift, OWN_ORBIT_MIN, OWN_ORBIT_MAX))
        distinct, of_lane = _distinct([guess, scale, reach, *(x[lanes] for x in parameters.values())])
        go = self._map.of({name: x[lanes[distinct]] for name, x in parameters.items()})
        orbit = orbits(guess[distinct], scale[distinct], reach[distinct], go).of(of_lane)
        converged, own = orbit.residual <= ACCEPTED, orbit.moved <= reach
        if "impacts" in features:
            own &= orbit.impacts == features["impacts"][lanes]
        rules = {
            "not-converged": ~converged & np.isfinite(orbit.moved),
            "another-orbit": ~own,
            "near-grazing": orbit.reach < GRAZING,
        }
        result["orbit_reason"][lanes] = np.select(list(rules.values()), list(map(reason, rules)), reason("found"))
        result["orbit_residual"][lanes] = np.where(np.isfinite(orbit.residual), orbit.residual, np.nan)
        result["grazing_margin"][lanes] = np.where(converged & own, orbit.margin, np.nan)
        result["orbit_cycles"][lanes] = np.where(converged & own, repeats_after(orbit), 0)
        for name, x in zip(self._scene.return_states, orbit.states[:, 0].T, strict=True):
            result[orbit_name(name)][lanes] = np.where(converged & own, x, np.nan)
        right = np.flatnonzero(result["orbit_reason"][lanes] == reason("found"))
        values = multipliers(orbit.product[right])
        result["multiplier_abs"][lanes[right]] = np.abs(values)
        result["multiplier_arg"][lanes[right]] = np.abs(np.angle(values))
        # A held state neither returns nor departs after a perturbation; the others decide.
        moves = ~held_states(orbit.product[right])
        decisive = orbit.product[right] * moves[:, None, :] * moves[:, :, None]
        result["stable"][lanes[right]] = spectral_radius(decisive) < 1
        growth = np.log(np.abs(values[:, 0]))
        leaves = growth > MULTIPLIER_ERROR
        unstable = right[leaves]
        leaves[leaves] = ~_stays(self._scene, lanes[unstable], orbit.scales[unstable], repeat, growth[leaves], features)
        # A lane that leaves an unstable orbit settles elsewhere, with an unknown error.
        self._remove(lanes[right[leaves]], result)
        for name in ("error_estimate", "drift_estimate"):
            if name in result:
                result[name][lanes[right[leaves]]] = np.inf
        right = right[~leaves]
        return begun(lanes[right], orbit.states[right], orbit.times[right], orbit.steps[right])

    def _remove(self, lanes: Index, result: Features) -> None:
        """Record in `result` that the orbits found do not belong to the `lanes`."""
        result["orbit_reason"][lanes] = reason("another-orbit")
        result["stable"][lanes], result["orbit_cycles"][lanes] = -1, 0
        states = map(orbit_name, self._scene.return_states)
        for name in ("multiplier_abs", "multiplier_arg", "grazing_margin", *states):
            result[name][lanes] = np.nan

    def _measured(self, inputs: LaneInputs, orbit: OrbitStart, own: Features, result: Features) -> Features:
        """Return the chunk's features, measured on the orbits; remove orbits that the measurement contradicts."""
        if not len(orbit.lanes):
            return {}
        columns = [x[orbit.lanes] for x in inputs.parameters.values()]
        distinct, of_lane = _distinct([orbit.state.T, orbit.steps, *columns])
        measures, whole = self._measure(inputs, OrbitStart(*(x[..., distinct] for x in orbit)))
        measures, whole = {name: x[of_lane] for name, x in measures.items()}, whole[of_lane]
        if "impacts" in own:
            whole &= np.abs(measures["impacts"] * orbit.cycles - own["impacts"][orbit.lanes]) < 0.5
        kept = orbit.lanes[whole]
        self._remove(orbit.lanes[~whole], result)
        if "period" in measures:
            measures["period"] = orbit.length / orbit.cycles
        own_features = ("at_rest", *scale_names(self._scene.section), *map(state_name, self._scene.return_states))
        excluded = LANE_FEATURES.union(own_features)
        merged = {name: own[name].copy() for name, x in measures.items() if x.ndim == 1 and name not in excluded}
        for name, x in merged.items():
            x[kept] = measures[name][whole]
        return merged


def _stays(
    scene: Scene[Any], lanes: Index, scale: np.ndarray, repeat: int, growth: PerLane, features: Features
) -> Bool[np.ndarray, " lanes"]:
    """Return a mask of lanes that provably stay on an unstable orbit, for example because of an exact symmetry.

    Their last section crossings repeat within rounding errors. Since the lanes settled, a single rounding error would
    have grown to a visible difference. `growth`: logarithm of the orbit's greatest multiplier over one period.
    """
    if "settling_time" not in features:
        return np.zeros(len(lanes), bool)
    times = features[TIME][lanes].astype(float)
    returns, _ = last_returns(scene, lanes, times.shape[1], features)
    moved = np.nan_to_num(np.abs(returns[:, repeat:] - returns[:, :-repeat]) / scale[:, None])
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


def _repeats_under_pulses(scene: Scene[Any], features: Features, go: ReturnMap) -> Features:
    """Return `cycles`, `drift_estimate` and the last states at pulses (lanes, returns), newest last.

    The return map `go` is iterated from the state at the last pulse. `cycles` is the smallest number of pulses, up to
    8, after which every state is back to within 1e-3 of its swing; it is 0 if there is none.
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
        mapped = go(active, state[:, active])
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
