"""Chunks of equally many lanes, whose size bounds the memory, and lanes that carry on from their neighbours."""

from collections.abc import Callable
from functools import partial, reduce
from itertools import chain

import numpy as np
from jaxtyping import Float

from vibrojax.compile.xla import workers
from vibrojax.lanes.batch import Batch, Engine, Features, PerLane, Report, unreported
from vibrojax.lanes.drift import drift, drift_under_pulses, ends_differ, rock_error, sensitive
from vibrojax.lanes.programs import END
from vibrojax.lanes.underway import (
    OBSERVING,
    SETTLED,
    EarlyStopping,
    Ended,
    ReadyLanes,
    checkpoints,
    run_together,
)
from vibrojax.maps.sweep import DIRECTIONS, Sweep
from vibrojax.measures import recorder_for
from vibrojax.measures.labels import LABELLED_BY
from vibrojax.measures.repeats import INTERVAL
from vibrojax.progress import Portions, timed
from vibrojax.stepping import Accuracy

CHUNK, CHUNK_SHARING_ORBITS = 4096, 2048
"""Default number of lanes per chunk. In a sweep whose lanes stop on orbits of other lanes of the same chunk, results
depend on this number; the second one applies."""

ERROR_FLOOR = 0.03
"""Smallest error estimate, as a fraction of the tolerance. If most steps end at events, the check run takes almost the
same steps, and the difference between the runs underestimates the error."""

DRIFT_MARGIN = 1.25
"""Safety factor on the drift, which assumes a linear return map. One estimate in ten is off by 10 %."""

LOAD_MARGIN = 10.0
"""Multiple of the distance of the states from their limit by which the greatest force of the rock may still change, as
a fraction of the yield force."""

COMPARED = {*LABELLED_BY, "period", "impact_velocity", "rate_of_penetration"}
"""Features by which the check run is compared with the main run."""

PostProcessor = Callable[[int, int, Features], Features]
"""`beyond(first, end, features)` returns features to add or replace, for the lanes from `first` (inclusive) to `end`
(exclusive)."""


class Chunks:
    """Chunks of a sweep, each of which is computed by all workers.

    `beyond`: function that adds features to observed lanes; `ends`: search for lanes on known orbits, which can stop
    early.
    """

    def __init__(self, sweep: Sweep, beyond: PostProcessor | None = None, ends: EarlyStopping | None = None) -> None:
        self.sweep, self._beyond, self.ends = sweep, beyond, ends
        self.stepper = sweep.run.stepper
        self.accuracy = sweep.run.accuracy(sweep.system)
        recorder = recorder_for(sweep.system, sweep.run.keep_returns)
        self.engine = Engine(sweep, self.stepper, recorder, workers())
        usual = CHUNK if ends is None or not ends.shared else CHUNK_SHARING_ORBITS
        self.size = sweep.run.chunk or max(usual, self.engine.programs.block)
        self.count = -(-sweep.lanes // self.size)
        self._compiled = False

    def lanes(self, index: int) -> tuple[int, int]:
        return index * self.size, min((index + 1) * self.size, self.sweep.lanes)

    def width(self, index: int) -> int:
        first, end = self.lanes(index)
        return end - first

    def compute(self, index: int, report: Report = unreported) -> Features:
        """Return the features of a chunk's lanes by name: (lanes,), or (lanes, returns) for stored section crossings.

        `report` is called with the number of lanes finished since its last call.
        """
        first, end = self.lanes(index)
        portions = Portions(end - first, report)
        self.compile()
        features = self.measured(self.engine.start(first, end, self.accuracy), portions)
        portions.finish()
        return self.finished(index, features)

    def measured(self, batch: Batch, portions: Portions) -> Features:
        """Step lanes from t = 0 and return their features with error estimates."""
        run, coarse = self.sweep.run, self.stepper.coarser(self.accuracy)
        tolerance = self.accuracy.tolerance or SETTLED * run.error
        report = partial(self._reporter, portions)
        items = list(run_together(self.engine, batch, coarse, tolerance, self.ends_early, self.ends, report))
        parts = [item for item in items if isinstance(item, ReadyLanes)]
        ended = [item for item in items if isinstance(item, Ended)]
        observed = self._observed([part.fine for part in parts] + [part.check for part in parts], portions)
        features, apart = [item.features for item in ended], np.zeros(0, int)
        if parts:
            if (section := self.sweep.system.section) is not None:
                pairs = zip(parts, observed[: len(parts)], observed[len(parts) :], strict=True)
                apart = np.concatenate(
                    [part.fine.lanes[ends_differ(fine, check, section)] for part, fine, check in pairs]
                )
            check = [{name: x for name, x in one.items() if name in COMPARED} for one in observed[len(parts) :]]
            features.insert(0, self._certified(joined(observed[: len(parts)]), joined(check)))
        if not run.keep_returns and self._beyond is None:  # the crossings are needed only for the estimate
            features = [{name: x for name, x in one.items() if x.ndim == 1 or name == END} for one in features]
        order = np.argsort(np.concatenate([part.fine.lanes for part in parts] + [item.lanes for item in ended]))
        whole = {name: x[order] for name, x in joined(features).items()}
        if "cycles" in whole:
            whole["sensitive"] = sensitive(self.engine, batch, whole, np.searchsorted(batch.lanes, apart))
        return whole

    def finished(self, index: int, features: Features) -> Features:
        """Return the features to be stored, with those of `beyond`, and only the requested crossings."""
        first, end = self.lanes(index)
        kept = self.sweep.run.keep_returns
        stored = {name: x[:, x.shape[1] - kept :] if x.ndim == 2 else x for name, x in features.items()}
        stored = {name: x for name, x in stored.items() if x.size and name != INTERVAL}
        return stored | (self._beyond(first, end, features) if self._beyond is not None else {})

    def at(self, accuracy: Accuracy, index: int = 0) -> Features:
        """Return the features of a chunk at another `accuracy`, without check run and early stopping."""
        batches = [self.engine.start(*self.lanes(index), accuracy)]
        for now in chain(*checkpoints(self.sweep.run)):
            batches = self.engine.settle(batches, now)
        return self._observed(batches, Portions(self.width(index), unreported))[0]

    def compile(self) -> None:
        """Compile the programs at the first call."""
        if not self._compiled:
            with timed("compile"):
                self.engine.compile(self.accuracy)
            self._compiled = True

    @property
    def ends_early(self) -> bool:
        """True if lanes stop early once they have settled.

        False under pulses, if the last section crossings are stored, and on an accelerator, where a step of a few lanes
        costs as much as a step of many.
        """
        run, scene = self.sweep.run, self.sweep.system
        return run.end_early and not run.keep_returns and scene.autonomous and not self.engine.accelerated

    def _reporter(self, portions: Portions, settling: float, observing: float = 0.0) -> Report:
        """Return a callback that reports the work of lanes for these settling and observation times [s]."""
        run = self.sweep.run
        # As a fraction of a lane's total work, check run included.
        each = (settling + OBSERVING * observing) / (1.5 * (run.settle + OBSERVING * run.observe))
        return lambda lanes: portions.add(lanes * each)

    def _observed(self, batches: list[Batch], portions: Portions) -> list[Features]:
        """Settle the lanes to the beginning of their observation, observe them, and return their features."""
        run, rounds = self.sweep.run, checkpoints(self.sweep.run)
        settling = run.settle - (rounds[-1][-1] if rounds else 0.0)
        batches = self.engine.settle(batches, report=self._reporter(portions, settling))
        return self.engine.observe(batches, self._reporter(portions, 0.0, run.observe))

    def _certified(self, fine: Features, check: Features) -> Features:
        """Return the features of observed lanes, with drift and error estimates."""
        run, section, tolerance = self.sweep.run, self.sweep.system.section, self.accuracy.tolerance
        least = 4 * float(np.finfo(run.precision).eps) + ERROR_FLOOR * tolerance
        least += self.stepper.error_floor(self.accuracy)
        if section is None:
            away = drift_under_pulses(fine, self.sweep.system.return_states, run.precision, tolerance)
            return fine | {"error_estimate": error_under_pulses(fine, check, away, self.stepper.error_share, least)}
        fine = fine | {"drift_estimate": drift(fine, section, run.precision, tolerance)}
        return certified(fine, check, self.stepper.error_share, least)


def certified(fine: Features, check: Features, share: float, least: float) -> Features:
    """Return the features of lanes with `error_estimate` and the features that determine the check run's label.

    `share`, `least`: see `error_estimate`.
    """
    labelling = {f"check_{name}": check[name] for name in LABELLED_BY if name in check}
    return fine | labelling | {"error_estimate": error_estimate(fine, check, share, least)}


def error_estimate(fine: Features, coarse: Features, share: float, least: float) -> Float[np.ndarray, " lanes"]:
    """Return the estimated relative error of period, impact velocity and rate of penetration, whichever is largest.

    It is the error of the limits that the lane approaches, the sum of four parts: the fraction `share` of the
    difference between the two runs; `least`, in case this difference is small by chance; a multiple of the remaining
    distance from the limit, `drift_estimate`; and the error of a bit that still moves on the rock. It is NaN if a lane
    is not periodic. It is infinite if the number of section crossings or impacts per period differs between the runs,
    or if the drift is unbounded.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        names = [name for name in ("period", "impact_velocity", "rate_of_penetration") if name in fine]
        differences = [
            np.where(coarse[name] == fine[name], 0.0, np.abs(coarse[name] / fine[name] - 1)) for name in names
        ]
        error = share * reduce(np.fmax, differences) + least + DRIFT_MARGIN * fine["drift_estimate"] + rock_error(fine)
    agree = coarse["cycles"] == fine["cycles"]
    if "impacts" in fine:
        agree &= coarse["impacts"] == fine["impacts"]
    return np.where(fine["cycles"] > 0, np.where(agree, error, np.inf), np.nan)


def error_under_pulses(
    fine: Features, coarse: Features, away: PerLane, share: float, least: float
) -> Float[np.ndarray, " lanes"]:
    """Return the estimated relative error of the rate of penetration, as `error_estimate` does.

    The rate is a mean over the pulses of the observation. Its distance `away` from the limit therefore also contains
    the error of a mean over incomplete periods. A rate of zero has no relative error. It is certified if the force of
    the rock stays below its yield force by a multiple of this distance, else its error is infinite.
    """
    rate, check = fine["rate_of_penetration"], coarse["rate_of_penetration"]
    with np.errstate(invalid="ignore", divide="ignore"):
        error = share * np.where(rate == check, 0.0, np.abs(check / rate - 1)) + least + DRIFT_MARGIN * away
        yields = (fine.get("load", np.nan) + LOAD_MARGIN * away) >= 1
    return np.where((rate == 0) & yields, np.inf, error)


def joined(parts: list[Features]) -> Features:
    """Return the concatenated features of all parts."""
    return parts[0] if len(parts) == 1 else {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}


CARRIED_MIN_ROWS = 64
"""Minimum number of rows per chunk. Rows run in parallel, and fewer would leave blocks of lanes partly empty."""


class Carried(Chunks):
    """Chunks of a sweep with continuation along an axis. Each chunk consists of complete rows.

    A row consists of all lanes along this axis, for one direction and one value of each other axis. All rows advance in
    parallel from one value of the axis to the next.
    """

    def __init__(self, sweep: Sweep, beyond: PostProcessor | None = None) -> None:
        super().__init__(sweep, beyond)
        assert sweep.run.carry is not None
        self._values = len(sweep.axes[sweep.run.carry])
        size = sweep.run.chunk or max(CHUNK, CARRIED_MIN_ROWS * self._values)
        self.size = max(size // self._values, 1) * self._values
        self.count = -(-sweep.lanes // self.size)

    def compute(self, index: int, report: Report = unreported) -> Features:
        first, end = self.lanes(index)
        self.compile()
        whole = self.engine.start(first, end, self.accuracy)
        rows = np.arange(end - first).reshape(-1, self._values)
        up = (first + rows[:, 0]) // self._values % len(DIRECTIONS) == DIRECTIONS.index("up")
        order = np.where(up[:, None], rows, rows[:, ::-1])
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
            features = self.measured(batch, portions)
            portions.finish()
            ended = features.pop(END)
            runs.append(features)
        place = np.argsort(order.T.ravel())
        return self.finished(index, {name: x[place] for name, x in joined(runs).items()})
