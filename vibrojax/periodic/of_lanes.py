"""The orbits of a sweep's lanes: from their last returns by Newton's method, with multipliers, and measured."""

from dataclasses import replace
from typing import Any

import numpy as np

from vibrojax.devices import precision, workers
from vibrojax.engine.batch import Engine, Features, Index
from vibrojax.engine.parallel import in_parallel
from vibrojax.engine.programs import Given
from vibrojax.input.definition import Sweep
from vibrojax.measure import recorder_for
from vibrojax.measure.kept_returns import TIME, state_name
from vibrojax.measure.ledger import MOST_CYCLES
from vibrojax.measure.section import scales
from vibrojax.periodic.newton import ACCEPTED, Found, orbits
from vibrojax.periodic.return_map import Mapped, mapped
from vibrojax.stepping import Accuracy, LOCATED_STRIDE, Located
from vibrojax.store.variables import ORBIT_REASONS

STEPS = Accuracy(tolerance=1e-12, stride=LOCATED_STRIDE, step=np.inf)
"""Of the return map: multipliers to 1e-7, and periods to 1e-11, where nothing grazes."""

MEASURED = Accuracy(tolerance=1e-10, stride=LOCATED_STRIDE, step=np.inf)
"""Of the steps in which an orbit is measured."""

GRAZING = 1e-5
"""Margin below which multipliers are not given. Beside a graze the map goes as a root, so that its derivative holds over
a distance of about the margin squared: here that of the residual which is accepted, 1e-10."""

SAME = 1e-6
"""Distance over the scales within which two states of an orbit are one."""

NEAR = 1e-2
"""Distance over the scales, at least, that the lane's own orbit may be away from it."""

DRIFTS = 100.0
"""The same in distances that the lane itself has from where it settles, by its estimate."""

FAR = 0.5
"""The same at most."""

DRIVEN_RETURNS = 4
"""Returns that what is only driven has to come to the orbit's motion."""

SEGMENTS = 512
"""Returns per call of the map."""

NOT_MEASURED = frozenset({"finite", "finished", "steps", "returns", "trend", "cycles", "impacts", "settling_time"})
"""Features of the lane itself, which its orbit does not replace."""


def described(sweep: Sweep) -> dict[str, object]:
    """What the attribute `orbits` says: accuracy, limits, and how margins are scaled."""
    from vibrojax.periodic.margin import HOW

    return {
        "tolerance": STEPS.tolerance,
        "accepted_residual": ACCEPTED,
        "grazing_limit": GRAZING,
        "grazing_margin": HOW,
        "states": list(sweep.system.driving_part().return_states),
    }


class Orbits:
    """Finds the orbits of lanes that repeat, chunk by chunk."""

    def __init__(self, sweep: Sweep) -> None:
        self.sweep = sweep
        self.scene = sweep.system.driving_part()
        exact = replace(sweep, run=replace(sweep.run, precision="float64", method="located"))
        self.engine = Engine(exact, Located(), recorder_for(sweep.system, sweep.run.keep_returns), workers())

    def __call__(self, first: int, end: int, features: Features) -> Features:
        """The variables of orbits for the lanes from `first` to before `end`, and what is measured over them.

        `features` are those of the lanes, among them their last returns (lanes, returns); not changed.
        """
        lanes, rows = end - first, len(self.scene.return_states)
        cycles = np.nan_to_num(features["cycles"]).astype(int)
        reason = np.full(lanes, ORBIT_REASONS.index("not-repeating"))
        found: Features = {
            "multiplier_abs": np.full((lanes, rows), np.nan),
            "multiplier_arg": np.full((lanes, rows), np.nan),
            "stable": np.full(lanes, -1),
            "orbit_residual": np.full(lanes, np.nan),
            "grazing_margin": np.full(lanes, np.nan),
            "orbit_cycles": np.zeros(lanes),
            "orbit_reason": reason,
        }
        measured = {
            name: x.astype(float, copy=True)
            for name, x in features.items()
            if x.ndim == 1 and name not in NOT_MEASURED
        }
        sound = features["finite"] & features["finished"] & (cycles > 0)
        parameters, _ = self.sweep.lane_values(first, end)
        with np.errstate(all="ignore"):
            for repeat in range(1, MOST_CYCLES + 1):
                some = np.flatnonzero(sound & (cycles == repeat))
                if len(some):
                    self._find(first, some, repeat, parameters, features, found, measured)
        return found | measured

    def _find(
        self,
        first: int,
        lanes: Index,
        repeat: int,
        parameters: dict[str, np.ndarray],
        features: Features,
        found: Features,
        measured: Features,
    ) -> None:
        """Enter what is found of `lanes`, which all repeat after so many returns."""
        begin, scale = self._begun(lanes, repeat, features)
        reach = np.clip(DRIFTS * features["drift_estimate"][lanes], NEAR, FAR)
        given = {name: parameters[name][lanes] for name in self.scene.parameters()}
        orbit = orbits(begin, scale, reach, lambda some, states: self._returns(given, some, states))
        own = orbit.moved <= reach
        if "impacts" in features:
            own &= orbit.impacts == features["impacts"][lanes]
        is_found = (orbit.residual <= ACCEPTED) & own
        again, agrees = self._measure(first, lanes[is_found], orbit, is_found, features)
        sooner = _repeats_after(orbit, scale)
        own[is_found] &= agrees
        here = lanes[is_found][agrees]
        for name, x in measured.items():
            if name in again:
                x[here] = again[name][agrees]
        measured["period"][here] = orbit.times.mean(axis=1)[is_found][agrees]
        close = orbit.margin < GRAZING
        rules = {"not-converged": ~(orbit.residual <= ACCEPTED), "another-orbit": ~own, "near-grazing": close}
        why = np.select(list(rules.values()), [ORBIT_REASONS.index(name) for name in rules], ORBIT_REASONS.index("found"))
        found["orbit_reason"][lanes] = why
        there = (orbit.residual <= ACCEPTED) & own
        found["orbit_residual"][lanes] = np.where(np.isfinite(orbit.residual), orbit.residual, np.nan)
        found["grazing_margin"][lanes] = np.where(there, orbit.margin, np.nan)
        found["orbit_cycles"][lanes] = np.where(there, sooner, 0)
        right = why == ORBIT_REASONS.index("found")
        values = np.linalg.eigvals(orbit.product[right])
        order = np.argsort(-np.abs(values), axis=1, kind="stable")
        values = np.take_along_axis(values, order, axis=1)
        found["multiplier_abs"][lanes[right]] = np.abs(values)
        found["multiplier_arg"][lanes[right]] = np.abs(np.angle(values))
        found["stable"][lanes[right]] = np.abs(values[:, 0]) < 1

    def _begun(self, lanes: Index, repeat: int, features: Features) -> tuple[np.ndarray, np.ndarray]:
        """States at the last returns (lanes, cycles, states), and their scales (lanes, states), NaN where unknown."""
        section = self.scene.section
        assert section is not None
        # Those that are not there yet stand first; the last return's own image is the first of the next repeat.
        rows = [features[state_name(name)][lanes][:, -repeat:] for name in self.scene.return_states]
        swings = tuple(features[swing.amplitude][lanes] for swing in section.swings)
        known = scales(swings, features["period"][lanes])
        more = [np.full(len(lanes), np.nan)] * (len(rows) - len(known))
        return np.stack(rows, axis=-1).astype(float), np.stack([*known, *more], axis=-1).astype(float)

    def _returns(self, given: dict[str, np.ndarray], lanes: Index, states: np.ndarray) -> Mapped:
        """The return map, by all workers."""
        items = np.array_split(np.arange(len(lanes)), max(1, -(-len(lanes) // SEGMENTS)))

        def work(_: Any, some: Index) -> Mapped:
            with precision("float64"):
                p = {name: x[lanes[some]] for name, x in given.items()}
                steps = Accuracy(*(np.float64(x) for x in STEPS))
                return mapped(self.scene, Located(), p, states[:, some], steps)

        parts: list[Any] = [None] * len(items)
        for index, part in in_parallel(work, items, self.engine.workers):
            parts[index] = part
        import jax

        return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *parts)

    def _measure(
        self, first: int, lanes: Index, orbit: Found, which: np.ndarray, own: Features
    ) -> tuple[Features, np.ndarray]:
        """What is measured over the orbits of `lanes`, `which` of those in `orbit`; and whether it agrees with them."""
        if not len(lanes):
            return {}, np.zeros(0, bool)
        states, times = orbit.states[which], orbit.times[which]
        count, repeat, rows = states.shape
        batch = self.engine.start(first + int(lanes.min()), first + int(lanes.max()) + 1, MEASURED).of(lanes - lanes.min())
        scene = self.sweep.system
        zero = np.zeros(count)
        named = dict(zip(self.scene.return_states, states[:, 0].T, strict=True))
        state = tuple(np.ascontiguousarray(named.get(name, zero)) for name in scene.state_names)
        back = -np.arange(MOST_CYCLES) % repeat
        length = times.sum(axis=1)
        ago = np.concatenate([np.zeros((count, 1)), np.cumsum(times[:, ::-1], axis=1)], axis=1)
        when = [-(ago[:, k % repeat] + (k // repeat) * length) for k in range(MOST_CYCLES)]
        compared = len(scene.section.compared)  # type: ignore[union-attr]
        past = np.moveaxis(states[:, back, :compared], 0, -1)
        # From between two returns to between two, so that it is clear how many are seen: three repeats and one more.
        settle, duration = np.zeros(count), 3 * length + times[:, 0] + times[:, 1 % repeat] / 2
        if scene is not self.scene:
            settle = -(-DRIVEN_RETURNS // repeat) * length - times[:, -1] / 2
            duration = 3 * length + (times[:, -1] + times[:, 0]) / 2
        batch = replace(batch, begin=settle, duration=duration, recent=orbit.steps[which].astype(np.int32))
        batch = self.engine.on_orbit(batch, state, past, np.stack(when), length / repeat)
        [batch] = self.engine.settle([batch])
        [features] = self.engine.observe([batch])
        cycles = features["cycles"]
        agrees = features["finished"] & features["finite"] & (cycles > 0) & (repeat % np.maximum(cycles, 1) == 0)
        if "impacts" in features:
            agrees &= features["impacts"] * repeat == own["impacts"][lanes] * cycles
        return features, agrees


def _repeats_after(orbit: Found, scale: np.ndarray) -> np.ndarray:
    """Returns after which orbits repeat: as many as they have states, or fewer, which divide that."""
    repeat = orbit.states.shape[1]
    found = np.full(len(orbit.states), repeat)
    for sooner in (q for q in range(repeat - 1, 0, -1) if repeat % q == 0):
        apart = np.abs(np.roll(orbit.states, sooner, axis=1) - orbit.states) / scale[:, None]
        found[np.nanmax(apart, axis=(1, 2)) <= SAME] = sooner
    return found
