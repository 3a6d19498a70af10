"""Runs of lanes: the steps shared by main run and check run, both runs, certificates, stages, and labels."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from vibrojax.compile.xla import workers
from vibrojax.lanes.certificate import (
    ERROR_FLOOR,
    certified,
    drift,
    drift_under_pulses,
    ends_differ,
    error_under_pulses,
    sensitive,
)
from vibrojax.lanes.engine import Batch, Engine
from vibrojax.lanes.inputs import Features, LaneInputs, LaneResult, Plan, Report, Stage, unreported
from vibrojax.lanes.labels import labelled
from vibrojax.lanes.programs import END
from vibrojax.lanes.settled import OBSERVING, SETTLED, Ended, ReadyLanes, StopRule, checkpoints, run_together
from vibrojax.measures import recorder_for
from vibrojax.measures.repeats import INTERVAL
from vibrojax.measures.since_start import scale_names
from vibrojax.progress import Portions, quiet, timed
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import Accuracy
from vibrojax.threads import by_drivers


class LaneRun:
    """A run of lanes of one scene on all cores. Its programs are compiled once, at its first chunk.

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

    def chunks(
        self, parts: Sequence[Callable[[], LaneInputs]], report: Report = unreported
    ) -> Iterator[tuple[int, LaneResult]]:
        """Yield (index, results) of chunks of lanes as soon as each is finished, in any order.

        Each of as many threads as there are cores computes a chunk of its own. `parts` return the lanes of the chunks.
        """
        with quiet():
            if parts:
                self.compile(parts[0]())
            yield from by_drivers(partial(self.chunk, report=report), parts, len(self.engine.workers))

    def chunk(self, lanes: LaneInputs | Callable[[], LaneInputs], report: Report = unreported) -> LaneResult:
        """Return the results of lanes that are computed together; `lanes` may return them when their turn comes.

        `report` is called with the number of lanes finished since its last call.
        """
        began, inputs = time.monotonic(), lanes() if callable(lanes) else lanes
        self.compile(inputs)
        if inputs.row:
            features = self._rows(inputs, report)
        else:
            portions = Portions(len(inputs), report)
            features = self._measured(self.engine.start(inputs, self.accuracy), portions)
            portions.finish()
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
        results = dict(self.chunks(parts, report))
        features, variables, _ = zip(*(results[index] for index in range(len(parts))), strict=True)
        return LaneResult(joined(list(features)), joined(list(variables)))

    def at(self, inputs: LaneInputs, accuracy: Accuracy) -> Features:
        """Return the features of lanes at another `accuracy`, without check run and early stopping."""
        batch = self._stepped(self.engine.start(inputs, accuracy), checkpoints(self.settings))
        return self._observed([batch], Portions(len(inputs), unreported))[0]

    def before_observation(self, inputs: LaneInputs) -> Batch:
        """Return lanes at the last checkpoint, up to which main run and check run share their steps."""
        self.compile(inputs)
        rounds = checkpoints(self.settings, self.stop is not None)
        return self._stepped(self.engine.start(inputs, self.accuracy), rounds)

    def _stepped(self, batch: Batch, rounds: Iterable[Iterable[float]]) -> Batch:
        for now in chain(*rounds):
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

    def _measured(self, batch: Batch, portions: Portions) -> Features:
        """Step lanes from t = 0 and return their features with error estimates."""
        run, coarse = self.settings, self.stepper.coarser(self.accuracy)
        tolerance = self.accuracy.tolerance or SETTLED * run.error
        report = partial(_reporter, run, portions)
        items = list(run_together(self.engine, batch, coarse, tolerance, self.ends_early, self.stop, report))
        parts = [item for item in items if isinstance(item, ReadyLanes)]
        ended = [item for item in items if isinstance(item, Ended)]
        observed = self._observed([part.fine for part in parts] + [part.check for part in parts], portions)
        features, apart = [item.features for item in ended], np.zeros(0, int)
        if parts:
            if (section := self.scene.section) is not None:
                pairs = zip(parts, observed[: len(parts)], observed[len(parts) :], strict=True)
                apart = np.concatenate(
                    [part.fine.lanes[ends_differ(fine, check, section)] for part, fine, check in pairs]
                )
            features.insert(0, self._certified(joined(observed[: len(parts)]), joined(observed[len(parts) :])))
        if not run.keep_returns and not self.stages:  # the crossings are needed only for the estimate
            features = [{name: x for name, x in one.items() if x.ndim == 1 or name == END} for one in features]
        order = np.argsort(np.concatenate([part.fine.lanes for part in parts] + [item.lanes for item in ended]))
        whole = {name: x[order] for name, x in joined(features).items()}
        if "cycles" in whole:
            numbers = np.searchsorted(batch.lanes, apart)
            whole["sensitive"] = sensitive(self.engine, batch, whole, numbers, self.plan.lanes)
        return whole

    def _rows(self, inputs: LaneInputs, report: Report) -> Features:
        """Return the features of whole rows, which advance in parallel from one lane of each row to the next."""
        assert inputs.upwards is not None
        whole = self.engine.start(inputs, self.accuracy)
        rows = np.arange(len(inputs)).reshape(-1, inputs.row)
        order = np.where(inputs.upwards[:, None], rows, rows[:, ::-1])
        runs: list[Features] = []
        ended = None
        for lanes in order.T:
            portions = Portions(len(lanes), report)
            batch = whole.of(lanes)
            if ended is not None:
                # A failed lane has no final state. The next lane of its row begins in its own initial state.
                assert batch.underway is not None
                usable = np.isfinite(ended).all(axis=1)
                initial = zip(ended.T, batch.underway.lane.state, strict=True)
                batch = self.engine.carried(batch, tuple(np.where(usable, new, old) for new, old in initial))
            features = self._measured(batch, portions)
            portions.finish()
            ended = features.pop(END)
            runs.append(features)
        place = np.argsort(order.T.ravel())
        return {name: x[place] for name, x in joined(runs).items()}

    def _observed(self, batches: list[Batch], portions: Portions) -> list[Features]:
        """Settle the lanes to the beginning of their observation, observe them, and return their features."""
        run, rounds = self.settings, checkpoints(self.settings)
        settling = run.settle - (rounds[-1][-1] if rounds else 0.0)
        batches = self.engine.settle(batches, report=_reporter(run, portions, settling))
        return self.engine.observe(batches, _reporter(run, portions, 0.0, run.observe))

    def _certified(self, fine: Features, check: Features) -> Features:
        """Return the features of observed lanes, with drift and error estimates."""
        precision, section, tolerance = self.settings.precision, self.scene.section, self.accuracy.tolerance
        least = 4 * float(np.finfo(precision).eps) + ERROR_FLOOR * tolerance
        least += self.stepper.error_floor(self.accuracy)
        if section is None:
            away = drift_under_pulses(fine, self.scene.return_states, precision, tolerance)
            return fine | {"error_estimate": error_under_pulses(fine, check, away, self.stepper.error_share, least)}
        fine = fine | {"drift_estimate": drift(fine, section, precision, tolerance)}
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
            "devices": f"{cores} cpu cores" if device.platform == "cpu" else f"{cores} {device.device_kind}",
            "steps": steps,
            **self.accuracy.described(),
        }


def _reporter(run: RunSettings, portions: Portions, settling: float, observing: float = 0.0) -> Report:
    """Return a callback that reports the work of lanes for these settling and observation times [s]."""
    # As a fraction of a lane's total work, check run included.
    each = (settling + OBSERVING * observing) / (1.5 * (run.settle + OBSERVING * run.observe))
    return lambda lanes: portions.add(lanes * each)


def joined(parts: list[Features]) -> Features:
    """Return the concatenated features of all parts."""
    return parts[0] if len(parts) == 1 else {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}
