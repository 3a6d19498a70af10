"""Chunks of lanes of one size, through the compiled programs; memory is bounded by the chunk."""

from collections.abc import Callable
from functools import reduce
from itertools import chain

import numpy as np
from jaxtyping import Float

from vibrojax.compile.devices import workers
from vibrojax.measures import recorder_for
from vibrojax.measures.kept_returns import INTERVAL
from vibrojax.measures.labels import LABELLED_BY
from vibrojax.progress import Portions, timed
from vibrojax.stepping import Accuracy
from vibrojax.sweep.engine.batch import Batch, Engine, Features, Report, unreported
from vibrojax.sweep.engine.drift import drift
from vibrojax.sweep.engine.sensitive import sensitive
from vibrojax.sweep.engine.underway import OBSERVING, SETTLED, EarlyStopping, Ended, ReadyLanes, looks, run_together
from vibrojax.sweep.input.definition import Sweep

CHUNK = 2048
"""Lanes per chunk by default."""

ERROR_FLOOR = 0.03
"""Least error estimate, as part of the tolerance: if most steps end at events, the check run takes almost the same."""

DRIFT_MARGIN = 1.25
"""Factor on the drift, which is that of a linear return map: one in ten is 10 % off."""

PostProcessor = Callable[[int, int, Features], Features]
"""`beyond(first, end, features)`: added or replaced features of the lanes from `first` to before `end`."""


class Chunks:
    """The chunks of a sweep, computed one by one, by all workers.

    `beyond`: adds features to observed lanes; `ends`: the search for lanes that need no more steps.
    `ends_on_orbits`: True if there is such a search.
    """

    def __init__(self, sweep: Sweep, beyond: PostProcessor | None = None, ends: EarlyStopping | None = None) -> None:
        self.sweep, self._beyond, self._ends, self.ends_on_orbits = sweep, beyond, ends, ends is not None
        self.stepper = sweep.run.stepper
        self.accuracy = sweep.run.accuracy(sweep.system)
        recorder = recorder_for(sweep.system, sweep.run.keep_returns)
        self.engine = Engine(sweep, self.stepper, recorder, workers())
        self.size = sweep.run.chunk or max(CHUNK, self.engine.programs.block)
        self.count = -(-sweep.lanes // self.size)
        self._compiled = False

    def lanes(self, index: int) -> tuple[int, int]:
        """Return the first lane of a chunk, and the one after its last."""
        return index * self.size, min((index + 1) * self.size, self.sweep.lanes)

    def width(self, index: int) -> int:
        """Return the number of lanes of a chunk."""
        first, end = self.lanes(index)
        return end - first

    def compute(self, index: int, report: Report = unreported) -> Features:
        """Return the features of a chunk's lanes by name: (lanes,), or (lanes, returns) for stored returns.

        `report` is called with the number of finished lanes as work goes on.
        """
        first, end = self.lanes(index)
        portions = Portions(end - first, report)
        self.compile()
        features = self.measured(self.engine.start(first, end, self.accuracy), portions)
        portions.finish()
        return self.finished(index, features)

    def measured(self, batch: Batch, portions: Portions) -> Features:
        """Return the features, with error estimates, of lanes that stand at t = 0."""
        run, coarse = self.sweep.run, self.stepper.coarser(self.accuracy)
        tolerance = self.accuracy.tolerance or SETTLED * run.error

        def report(seconds: float) -> Report:
            return _portion(portions, self._share(seconds))

        items = list(run_together(self.engine, batch, coarse, tolerance, self.ends_early, self._ends, report))
        parts = [item for item in items if isinstance(item, ReadyLanes)]
        ended = [item for item in items if isinstance(item, Ended)]
        observed = self._observed([part.fine for part in parts] + [part.check for part in parts], portions)
        features = [item.features for item in ended]
        if parts:
            features.insert(0, self._certified(joined(observed[: len(parts)]), joined(observed[len(parts) :])))
        order = np.argsort(np.concatenate([part.lanes for part in parts] + [item.lanes for item in ended]))
        whole = {name: x[order] for name, x in joined(features).items()}
        if "cycles" in whole:
            whole["sensitive"] = sensitive(self.engine, batch, whole)
        return whole

    def finished(self, index: int, features: Features) -> Features:
        """Return the stored features of a chunk's lanes, without returns that are not kept, and those of `beyond`."""
        first, end = self.lanes(index)
        kept = self.sweep.run.keep_returns
        stored = {name: x[:, x.shape[1] - kept :] if x.ndim == 2 else x for name, x in features.items()}
        stored = {name: x for name, x in stored.items() if x.size and name != INTERVAL}
        return stored | (self._beyond(first, end, features) if self._beyond is not None else {})

    def at(self, accuracy: Accuracy, index: int = 0) -> Features:
        """Return the features (lanes,) of a chunk's lanes at another `accuracy`.

        All lanes are stepped to their end, without the check run.
        """
        batches = [self.engine.start(*self.lanes(index), accuracy)]
        for now in chain(*looks(self.sweep.run)):
            batches = self.engine.settle(batches, now)
        return self._observed(batches, Portions(self.width(index), unreported))[0]

    def compile(self) -> None:
        """Compile the programs, once."""
        if not self._compiled:
            with timed("compile"):
                self.engine.compile(self.accuracy)
            self._compiled = True

    @property
    def ends_early(self) -> bool:
        """True if lanes are checked for having settled: not under pulses, nor if the last returns are stored.

        Nor on an accelerator, where a step of a few lanes costs as much as one of many.
        """
        run, scene = self.sweep.run, self.sweep.system
        return run.end_early and not run.keep_returns and scene.autonomous and not self.engine.accelerated

    def _share(self, settling: float, observing: float = 0.0) -> float:
        """Return the part of a lane's work, the check run's included, of these times [s]."""
        run = self.sweep.run
        return (settling + OBSERVING * observing) / (1.5 * (run.settle + OBSERVING * run.observe))

    def _observed(self, batches: list[Batch], portions: Portions) -> list[Features]:
        """Return the features of lanes that are underway."""
        run, rounds = self.sweep.run, looks(self.sweep.run)
        settling = self._share(run.settle - (rounds[-1][-1] if rounds else 0.0))
        batches = self.engine.settle(batches, report=_portion(portions, settling))
        return self.engine.observe(batches, _portion(portions, self._share(0.0, run.observe)))

    def _certified(self, fine: Features, check: Features) -> Features:
        """Return the features of observed lanes, with drift and error estimates."""
        run, section, tolerance = self.sweep.run, self.sweep.system.section, self.accuracy.tolerance
        if section is not None:
            fine = fine | {"drift_estimate": drift(fine, section, run.precision, tolerance)}
        least = 4 * float(np.finfo(run.precision).eps) + ERROR_FLOOR * tolerance
        return certified(fine, check, self.stepper.error_share, least)


def certified(fine: Features, check: Features, share: float, least: float) -> Features:
    """Return the features of lanes with their `error_estimate`, and the features that label the check run."""
    labelling = {f"check_{name}": check[name] for name in LABELLED_BY if name in check}
    return fine | labelling | {"error_estimate": error_estimate(fine, check, share, least)}


def error_estimate(fine: Features, coarse: Features, share: float, least: float) -> Float[np.ndarray, " lanes"]:
    """Return the estimated relative error of period and impact velocity, the larger; NaN if a lane does not repeat.

    It concerns the values on which the lane settles: a `share` of the difference between the two runs, `least` in case
    that is small by chance, and the remaining distance, `drift_estimate`. It is infinite for a lane whose repeat
    differs between the runs, or whose drift has no bound.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        if "cycles" not in fine:  # penetration
            rate, check = fine["rate_of_penetration"], coarse["rate_of_penetration"]
            return share * np.where(rate == check, 0.0, np.abs(check / rate - 1)) + least
        names = [name for name in ("period", "impact_velocity") if name in fine]
        differences = [np.abs(coarse[name] / fine[name] - 1) for name in names]
        error = share * reduce(np.fmax, differences) + least + DRIFT_MARGIN * fine["drift_estimate"]
    agree = coarse["cycles"] == fine["cycles"]
    if "impacts" in fine:
        agree &= coarse["impacts"] == fine["impacts"]
    return np.where(fine["cycles"] > 0, np.where(agree, error, np.inf), np.nan)


def joined(parts: list[Features]) -> Features:
    """Return the features of the lanes of all parts."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _portion(portions: Portions, each: float) -> Report:
    """Return a report that adds `each` part of a lane's work for every lane."""
    return lambda lanes: portions.add(lanes * each)
