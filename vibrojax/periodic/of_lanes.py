"""The orbits of a sweep's lanes: from their last returns by Newton's method, with multipliers, and measured."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.io.variables import ORBIT_REASONS, orbit_name
from vibrojax.measures.kept_returns import TIME, state_name
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import REPEATS_WITHIN, scales
from vibrojax.models.scenes import Scene
from vibrojax.periodic.margin import GRAZING, HOW
from vibrojax.periodic.measured import Begun, Measuring, begun, joined
from vibrojax.periodic.newton import ACCEPTED, States, orbits, repeats_after
from vibrojax.periodic.segments import STEPS, Segments
from vibrojax.periodic.under_pulses import repeats
from vibrojax.sweep.engine.batch import Features, Index
from vibrojax.sweep.input.definition import Sweep

NEAR, FAR = 1e-2, 0.5
"""Least and greatest distance, over the scales, within which an orbit may be a lane's own."""

DRIFTS = 10.0
"""The same between them, in drift estimates: these are good to a factor of a few for lanes far from their orbits."""

MULTIPLIER_ERROR = 1e-7
"""Greatest error of a multiplier: an orbit with a modulus above 1 by less may be neutral or stable."""

STILL = 64 * 1e4
"""Roundings by which the returns of a lane that stays on an unstable orbit differ at most from repeat to repeat."""

OF_THE_LANE = frozenset(
    {"finite", "finished", "steps", "returns", "trend", "cycles", "impacts", "settling_time", "pulses", "yields"}
)
"""Features of the lane itself, which its orbit does not replace; `impacts` are the same."""

PerLane = Float[np.ndarray, " lanes"]
WhichLanes = Bool[np.ndarray, " lanes"]


def reason(name: str) -> int:
    """The flag of `orbit_reason` that means `name`."""
    return ORBIT_REASONS.index(name)


class Orbits:
    """Finds the orbits of lanes that repeat, chunk by chunk."""

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._scene = sweep.system.driving_part()
        self._measure = Measuring(sweep)
        self._map = Segments(self._scene)

    @property
    def described(self) -> dict[str, object]:
        """What the attribute `orbits` of a dataset says: states, accuracy, limits, and how margins are scaled."""
        return {
            "states": list(self._scene.return_states),
            "tolerance": STEPS.tolerance,
            "accepted_residual": ACCEPTED,
            "grazing_limit": GRAZING,
            "grazing_margin": HOW,
        }

    def __call__(self, first: int, end: int, features: Features) -> Features:
        """The variables of orbits for the lanes from `first` to before `end`, and what is measured over them.

        `features` are those of the lanes, by name, among them their last returns (lanes, returns); not changed.
        """
        lanes, rows = end - first, len(self._scene.return_states)
        found: Features = {
            "multiplier_abs": np.full((lanes, rows), np.nan),
            "multiplier_arg": np.full((lanes, rows), np.nan),
            "stable": np.full(lanes, -1),
            "orbit_residual": np.full(lanes, np.nan),
            "grazing_margin": np.full(lanes, np.nan),
            **{orbit_name(name): np.full(lanes, np.nan) for name in self._scene.return_states},
            "orbit_cycles": np.zeros(lanes),
            "orbit_reason": np.full(lanes, reason("not-repeating")),
            "error_estimate": features["error_estimate"].copy(),
        }
        found |= {name: features[name].copy() for name in ("drift_estimate",) if name in features}
        parameters, _ = self._sweep.lane_values(first, end)
        parameters = {name: parameters[name] for name in self._scene.parameters()}
        parts: list[Begun] = []
        with np.errstate(all="ignore"):
            if self._scene.section is None:
                features = features | repeats(self._scene, features, self._map.of(parameters))
            cycles = np.nan_to_num(features["cycles"]).astype(int)
            sound = features["finite"] & features["finished"] & (cycles > 0)
            for repeat in range(1, MOST_CYCLES + 1):
                some = np.flatnonzero(sound & (cycles == repeat))
                if len(some):
                    parts.append(self._find(some, repeat, parameters, features, found))
            return found | (self._measured(first, end, joined(parts), features, found) if parts else {})

    def _find(
        self, lanes: Index, repeat: int, parameters: dict[str, np.ndarray], features: Features, found: Features
    ) -> Begun:
        """Enter in `found` the orbits of `lanes`, which all repeat after so many returns; those that were found."""
        begin, scale = last_returns(self._scene, lanes, repeat, features)
        drift = features["drift_estimate"][lanes]
        reach = np.where(np.isnan(drift), NEAR, np.clip(DRIFTS * drift, NEAR, FAR))
        given = {name: x[lanes] for name, x in parameters.items()}
        one, of_lane = _distinct([begin, scale, reach, *given.values()])
        given = {name: x[one] for name, x in given.items()}
        orbit = orbits(begin[one], scale[one], reach[one], self._map.of(given)).of(of_lane)
        converged, own = orbit.residual <= ACCEPTED, orbit.moved <= reach
        if "impacts" in features:
            own &= orbit.impacts == features["impacts"][lanes]
        rules = {
            "not-converged": ~converged & np.isfinite(orbit.moved),
            "another-orbit": ~own,
            "near-grazing": orbit.margin < GRAZING,
        }
        found["orbit_reason"][lanes] = np.select(list(rules.values()), list(map(reason, rules)), reason("found"))
        found["orbit_residual"][lanes] = np.where(np.isfinite(orbit.residual), orbit.residual, np.nan)
        found["grazing_margin"][lanes] = np.where(converged & own, orbit.margin, np.nan)
        found["orbit_cycles"][lanes] = np.where(converged & own, repeats_after(orbit), 0)
        for name, x in zip(self._scene.return_states, orbit.states[:, 0].T, strict=True):
            found[orbit_name(name)][lanes] = np.where(converged & own, x, np.nan)
        right = np.flatnonzero(found["orbit_reason"][lanes] == reason("found"))
        values = np.linalg.eigvals(orbit.product[right])
        values = np.take_along_axis(values, np.argsort(-np.abs(values), axis=1, kind="stable"), axis=1)
        found["multiplier_abs"][lanes[right]] = np.abs(values)
        found["multiplier_arg"][lanes[right]] = np.abs(np.angle(values))
        found["stable"][lanes[right]] = np.abs(values[:, 0]) < 1
        growth = np.log(np.abs(values[:, 0]))
        leaves = growth > MULTIPLIER_ERROR
        some = right[leaves]
        leaves[leaves] = ~_stays(self._scene, lanes[some], orbit.scales[some], repeat, growth[leaves], features)
        self._leave(lanes[right[leaves]], found)
        right = right[~leaves]
        return begun(lanes[right], orbit.states[right], orbit.times[right], orbit.steps[right])

    def _leave(self, lanes: Index, found: Features) -> None:
        """Enter in `found` that `lanes` are near an unstable orbit: where they settle is not known."""
        self._lose(lanes, found)
        for name in ("error_estimate", "drift_estimate"):
            if name in found:
                found[name][lanes] = np.inf

    def _lose(self, lanes: Index, found: Features) -> None:
        """Enter in `found` that the orbit is not that of the `lanes`."""
        found["orbit_reason"][lanes] = reason("another-orbit")
        found["stable"][lanes], found["orbit_cycles"][lanes] = -1, 0
        states = map(orbit_name, self._scene.return_states)
        for name in ("multiplier_abs", "multiplier_arg", "grazing_margin", *states):
            found[name][lanes] = np.nan

    def _measured(self, first: int, end: int, orbit: Begun, own: Features, found: Features) -> Features:
        """The features of the chunk, of lanes with an orbit measured over it; one that it does not bear out is lost."""
        if not len(orbit.lanes):
            return {}
        parameters, _ = self._sweep.lane_values(first, end)
        one, of_lane = _distinct([orbit.state.T, orbit.steps, *(x[orbit.lanes] for x in parameters.values())])
        again, whole = self._measure(first, end, Begun(*(x[..., one] for x in orbit)))
        again, whole = {name: x[of_lane] for name, x in again.items()}, whole[of_lane]
        if "impacts" in own:
            whole &= np.abs(again["impacts"] * orbit.cycles - own["impacts"][orbit.lanes]) < 0.5
        kept = orbit.lanes[whole]
        self._lose(orbit.lanes[~whole], found)
        if "period" in again:
            again["period"] = orbit.length / orbit.cycles
        lane = OF_THE_LANE | {state_name(name) for name in self._scene.return_states}
        measured = {name: own[name].copy() for name in again if again[name].ndim == 1 and name not in lane}
        for name, x in measured.items():
            x[kept] = again[name][whole]
        return measured


def _stays(
    scene: Scene[Any], lanes: Index, scale: np.ndarray, repeat: int, growth: PerLane, features: Features
) -> WhichLanes:
    """Return which lanes have been shown to stay on an unstable orbit, as an exact symmetry makes them.

    Their last returns repeat to rounding, although a single rounding would have become a visible difference since they
    settled. `scale` (lanes, states) is that of the return map's states, and `growth` the logarithm of the orbit's
    greatest multiplier over the `repeat`.
    """
    if "settling_time" not in features:
        return np.zeros(len(lanes), bool)
    times = features[TIME][lanes].astype(float)
    returns, _ = last_returns(scene, lanes, times.shape[1], features)
    moved = np.nan_to_num(np.abs(returns[:, repeat:] - returns[:, :-repeat]) / scale[:, None])
    rounding = float(np.finfo(features["period"].dtype).eps)
    still = np.max(moved, axis=(1, 2), initial=0.0) <= STILL * rounding
    repeats = (times[:, -1] - features["settling_time"][lanes]) / (repeat * features["period"][lanes])
    return still & (growth * repeats > np.log(REPEATS_WITHIN / rounding))


def _distinct(columns: list[np.ndarray]) -> tuple[Int[np.ndarray, " distinct"], Index]:
    """The first of all lanes that are alike to the last bit in all columns, (lanes, ...), and of each lane its number.

    Lanes that ended on an orbit which they share are: what follows from them need be found once.
    """
    rows = np.concatenate([x.reshape(len(x), -1).astype(float) for x in columns], axis=1)
    numbers: dict[bytes, int] = {}
    of_lane = np.array([numbers.setdefault(row.tobytes(), len(numbers)) for row in rows], int)
    return np.unique(of_lane, return_index=True)[1], of_lane


def last_returns(scene: Any, lanes: Index, repeat: int, features: Features) -> tuple[States, np.ndarray]:
    """States at the last returns (lanes, cycles, states), and their scales (lanes, states); NaN: labels have none."""
    rows = [features[state_name(name)][lanes][:, -repeat:].astype(float) for name in scene.return_states]
    known: list[Any] = []
    if scene.section is not None:
        swings = tuple(features[swing.amplitude][lanes] for swing in scene.section.swings)
        known = scales(swings, features["period"][lanes])
    unknown = [np.full(len(lanes), np.nan)] * (len(rows) - len(known))
    return np.stack(rows, axis=-1), np.stack([*known, *unknown], axis=-1).astype(float)
