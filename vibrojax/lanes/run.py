"""Runs of lanes: the steps shared by main run and check run, both runs, certificates, stages, and labels."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from vibrojax.compile.xla import workers
from vibrojax.lanes.certificate import ERROR_FLOOR, certified, ends_differ, error_under_pulses, sensitive
from vibrojax.lanes.drift import drift, drift_under_pulses
from vibrojax.lanes.engine import Batch, Engine
from vibrojax.lanes.inputs import Features, Index, LaneInputs, LaneResult, Plan, Report, Stage, unreported
from vibrojax.lanes.labels import labelled
from vibrojax.lanes.programs import END
from vibrojax.lanes.settled import OBSERVING, SETTLED, Ended, StopRule, checkpoints, settled
from vibrojax.measures import recorder_for
from vibrojax.measures.repeats import INTERVAL
from vibrojax.measures.since_start import scale_names
from vibrojax.progress import Portions, quiet, timed
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import Accuracy
from vibrojax.threads import by_drivers


class FirstHalf(NamedTuple):
    """Lanes after the steps that main run and check run share.

    - `fine`, `check`: batches to observe, the same lanes in both runs.
    - `ended`: lanes that need no more steps.
    """

    fine: list[Batch]
    check: list[Batch]
    ended: list[Ended]


class LaneRun:
    """A run of lanes of one scene. Its programs are compiled once, at its first chunk.

    `inputs`: lanes, which determine scene, settings and names of initial conditions; `stop`: rule by which lanes end
    before their time, besides having settled; `stages`: add features to observed lanes, in this order.
    """

    def __init__(
        self, inputs: LaneInputs, plan: Plan, stop: StopRule | None = None, stages: Sequence[Stage] = ()
    ) -> None:
        self.plan, self.stop, self.stages = plan, stop, stages
        self.scene, self.settings = inputs.scene, inputs.run
        self.stepper = self.settings.stepper
        self.accuracy = self.settings.accuracy(self.scene)
        recorder = recorder_for(self.scene, self.settings.keep_returns)
        names = inputs.start_names
        self.engine = Engine(self.scene, self.settings, names, self.stepper, recorder, workers())
        self._compiled = False

    def compile(self, inputs: LaneInputs) -> None:
        """Compile the programs at the first call."""
        if not self._compiled:
            with timed("compile"):
                self.engine.compile(inputs, self.accuracy)
            self._compiled = True

    def chunk(self, lanes: LaneInputs | Callable[[], LaneInputs], report: Report = unreported) -> LaneResult:
        """Return the results of lanes that are computed together; `lanes` may return them when their turn comes.

        Rows advance in parallel from one lane of each row to the next. `report` is called with the number of lanes
        finished since its last call.
        """
        began, inputs = time.monotonic(), lanes() if callable(lanes) else lanes
        self.compile(inputs)
        whole, steps = self.engine.start(inputs, self.accuracy), _steps_of_rows(inputs)
        measured: list[Features] = []
        state = None
        for places in steps:
            portions = Portions(len(places), report)
            batch = whole.of(places)
            if state is not None:
                # A failed lane has no final state. The next lane of its row begins in its own initial state.
                assert batch.underway is not None
                usable = np.isfinite(state).all(axis=1)
                initial = zip(state.T, batch.underway.lane.state, strict=True)
                batch = self.engine.carried(batch, tuple(np.where(usable, new, old) for new, old in initial))
            measured.append(self._second_half(batch, self._first_half(batch, portions), portions))
            portions.finish()
            state = measured[-1].pop(END, None)
        order = np.argsort(np.concatenate(steps))
        features = {name: x[order] for name, x in joined(measured).items()}
        kept = self.settings.keep_returns
        stored = {name: x[:, x.shape[1] - kept :] if x.ndim == 2 else x for name, x in features.items()}
        stored = {name: x for name, x in stored.items() if x.size and name != INTERVAL}
        added: Features = {}
        for stage in self.stages:
            added |= stage(inputs, features | added)
        variables = labelled(inputs, stored | added)
        return LaneResult(features | added, variables, time.monotonic() - began)

    def all(self, inputs: LaneInputs, report: Report = unreported) -> LaneResult:
        """Return the results of independent lanes, which are computed in chunks."""
        firsts = range(0, len(inputs), self.plan.chunk)
        ends = [*firsts[1:], len(inputs)]
        parts = [partial(inputs.of, np.arange(first, end)) for first, end in zip(firsts, ends, strict=True)]
        with quiet():
            self.compile(parts[0]())
            results = dict(by_drivers(partial(self.chunk, report=report), parts, len(self.engine.workers)))
        features, variables, _ = zip(*(results[index] for index in range(len(parts))), strict=True)
        return LaneResult(joined(list(features)), joined(list(variables)))

    def at(self, inputs: LaneInputs, accuracy: Accuracy) -> Features:
        """Return the features of lanes at another `accuracy`, without check run and early stopping."""
        batch = self._stepped(self.engine.start(inputs, accuracy), False)
        return self.engine.observe(self.engine.settle([batch]))[0]

    def before_observation(self, inputs: LaneInputs) -> Batch:
        """Return lanes at the last checkpoint, up to which main run and check run share their steps."""
        self.compile(inputs)
        return self._stepped(self.engine.start(inputs, self.accuracy), self.stop is not None)

    def _stepped(self, batch: Batch, on_orbits: bool) -> Batch:
        for now in chain(*checkpoints(self.settings, on_orbits)):
            [batch] = self.engine.settle([batch], now)
        return batch

    @property
    def ends_early(self) -> bool:
        """True if lanes stop early once they have settled.

        False under pulses, if the last section crossings are stored, and on an accelerator, where a step of a few lanes
        costs as much as a step of many.
        """
        run = self.settings
        return run.end_early and not run.keep_returns and self.scene.autonomous and not self.engine.accelerated

    def _first_half(self, active: Batch, portions: Portions) -> FirstHalf:
        """Step lanes from t = 0 until main run and check run separate; set those aside that stop early.

        The computation is interrupted at the same times even without early stopping. Lanes that never settle thus have
        the same values with and without early stopping.
        """
        run, early, coarse = self.settings, self.ends_early, self.stepper.coarser(self.accuracy)
        tolerance = self.accuracy.tolerance or SETTLED * run.error
        rule = self.stop.for_chunk() if early and self.stop is not None else None
        half, before = FirstHalf([], [], []), 0.0
        for times in checkpoints(run, self.stop is not None):
            near: list[Batch] = []
            for now in times:
                if len(active.lanes):
                    [active] = self.engine.settle([active], now, _reporter(run, portions, now - before))
                before = now
                if rule is not None:
                    candidates, active = active.split(rule.near(active))
                    near.append(candidates)
            if early:
                assert active.underway is not None
                returns, end = active.underway.carry, run.settle + run.observe
                done, duration = settled(returns, now, end, run.observe, tolerance)
                if done.any():
                    leaving, active = active.split(done)
                    fine = leaving.observed(now, duration[done])
                    half.fine.append(fine)
                    begin = (1 + self.stepper.check_settles) * now
                    half.check.append(replace(fine, accuracy=coarse, is_check=True).observed(begin, duration[done]))
            if rule is not None:
                candidates = near[0].joined(near[1:])
                ended = rule.ended(candidates)
                half.ended.extend(ended)
                lanes = np.concatenate([np.zeros(0, int), *(part.lanes for part in ended)])
                active = active.joined([candidates.split(np.isin(candidates.lanes, lanes))[1]])
            if not len(active.lanes):
                return half
        half.fine.append(active)
        half.check.append(replace(active, accuracy=coarse, is_check=True))
        return half

    def _second_half(self, batch: Batch, half: FirstHalf, portions: Portions) -> Features:
        """Observe both runs of a batch and return its features, in order, with error estimates.

        `batch`: the lanes at t = 0.
        """
        run, engine, rounds = self.settings, self.engine, checkpoints(self.settings)
        settling = _reporter(run, portions, run.settle - (rounds[-1][-1] if rounds else 0.0))
        observing = _reporter(run, portions, 0.0, run.observe)
        observed = engine.observe(engine.settle(half.fine + half.check, report=settling), observing)
        fine, check = observed[: len(half.fine)], observed[len(half.fine) :]
        features, apart = [part.features for part in half.ended], np.zeros(0, int)
        if fine:
            if (section := self.scene.section) is not None:
                pairs = zip(half.fine, fine, check, strict=True)
                apart = np.concatenate([part.lanes[ends_differ(x, y, section)] for part, x, y in pairs])
            features.insert(0, self._certified(joined(fine), joined(check)))
        if not run.keep_returns and not self.stages:  # the crossings are needed only for the estimate
            features = [{name: x for name, x in part.items() if x.ndim == 1 or name == END} for part in features]
        lanes = [*(part.lanes for part in half.fine), *(part.lanes for part in half.ended)]
        order = np.argsort(np.concatenate(lanes))
        whole = {name: x[order] for name, x in joined(features).items()}
        if "cycles" in whole:
            numbers = np.searchsorted(batch.lanes, apart)
            whole["sensitive"] = sensitive(engine, batch, whole, numbers, self.plan.lanes)
        return whole

    def _certified(self, fine: Features, check: Features) -> Features:
        """Return the features of observed lanes, with drift and error estimates."""
        precision, section, tolerance = self.settings.precision, self.scene.section, self.accuracy.tolerance
        least = 4 * float(np.finfo(precision).eps) + ERROR_FLOOR * tolerance
        least += self.stepper.error_floor(self.accuracy)
        if section is None:
            away = drift_under_pulses(fine, self.scene.return_states, precision, tolerance)
            return fine | {"error_estimate": error_under_pulses(fine, check, away, self.stepper.error_share, least)}
        fine = fine | {"drift_estimate": drift(fine, section, precision, tolerance)}
        if not self.stepper.check_settles:
            coarser = self.stepper.coarser(self.accuracy).tolerance
            check = check | {"drift_estimate": drift(check, section, precision, coarser)}
        # A period that a forcing sets has no error.
        names = scale_names(section) if self.scene.autonomous or "impacts" in fine else []
        states = [name.removesuffix("_scale") for name in names]
        return certified(fine, check, self.stepper.error_share, least, states)

    def described(self, steps: int) -> dict[str, Any]:
        """Return how lanes were stepped, with the total number of `steps`, for the dataset's attribute `solver`."""
        device, cores = self.engine.workers[0], len(self.engine.workers)
        return {
            "method": self.stepper.name,
            "order": self.stepper.order,
            "precision": self.settings.precision,
            "compiler": self.engine.programs.compiler,
            "devices": f"{cores} cpu cores" if device is None else f"{cores} {device.device_kind}",
            "steps": steps,
            **self.accuracy.described(),
        }


def _steps_of_rows(inputs: LaneInputs) -> list[Index]:
    """Return the lanes that are computed at the same time: all, or one of each row after another."""
    if not inputs.row:
        return [np.arange(len(inputs))]
    assert inputs.upwards is not None
    rows = np.arange(len(inputs)).reshape(-1, inputs.row)
    return list(np.where(inputs.upwards[:, None], rows, rows[:, ::-1]).T)


def _reporter(run: RunSettings, portions: Portions, settling: float, observing: float = 0.0) -> Report:
    """Return a callback that reports the work of lanes for these settling and observation times [s]."""
    # As a fraction of a lane's total work, check run included.
    each = (settling + OBSERVING * observing) / (1.5 * (run.settle + OBSERVING * run.observe))
    return lambda lanes: portions.add(lanes * each)


def joined(parts: list[Features]) -> Features:
    """Return the concatenated features of all parts."""
    return parts[0] if len(parts) == 1 else {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}
