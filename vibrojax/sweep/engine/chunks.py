"""Lanes in chunks of one size through the compiled programs; memory is bounded by the chunk."""

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
from vibrojax.sweep.engine.underway import OBSERVING, SETTLED, Ended, Ends, Part, Underway, looks
from vibrojax.sweep.input.definition import Sweep

CHUNK = 2048
"""Lanes per chunk where the user does not say."""

LEAST = 0.03
"""Part of the tolerance that the error is taken for at least: where most steps end at events, those of the check run
are all but the same."""

DRIFT_MARGIN = 1.25
"""The drift is that of a linear return map; a tenth off, one in ten."""


Beyond = Callable[[int, int, Features], Features]
"""`beyond(first, end, features)`: more features of the lanes from `first` to before `end`, or other ones."""


class Chunks:
    """The chunks of a sweep, ready to be computed one by one, by all workers.

    `beyond`: what else is to be found of lanes that have been observed; `ends`: finds those that need no more steps.

    `ends_on_orbits`: whether any are looked for.
    """

    def __init__(self, sweep: Sweep, beyond: Beyond | None = None, ends: Ends | None = None) -> None:
        self.sweep, self._beyond, self.ends_on_orbits = sweep, beyond, ends is not None
        self.stepper = sweep.run.stepper
        self.accuracy = sweep.run.accuracy(sweep.system)
        recorder = recorder_for(sweep.system, sweep.run.keep_returns)
        self.engine = Engine(sweep, self.stepper, recorder, workers())
        self.size = sweep.run.chunk or max(CHUNK, self.engine.programs.block)
        self.count = -(-sweep.lanes // self.size)
        self._compiled = False
        close = self.accuracy.tolerance or SETTLED * sweep.run.error
        self._underway = Underway(sweep.run, self.stepper.coarser(self.accuracy), close, self.ends_early, ends)

    def lanes(self, index: int) -> tuple[int, int]:
        """First lane of a chunk, and the one after its last."""
        return index * self.size, min((index + 1) * self.size, self.sweep.lanes)

    def width(self, index: int) -> int:
        """Number of lanes of a chunk."""
        first, end = self.lanes(index)
        return end - first

    def compute(self, index: int, report: Report = unreported) -> Features:
        """Features of a chunk's lanes, by name: (lanes,), or (lanes, returns) for returns that are stored.

        `report` is called with the number of lanes that are done as work goes on.
        """
        first, end = self.lanes(index)
        portions = Portions(end - first, report)
        self.compile()
        features = self.measured(self.engine.start(first, end, self.accuracy), portions)
        portions.finish()
        return self.finished(index, features)

    def measured(self, batch: Batch, portions: Portions) -> Features:
        """The features of lanes that stand at t = 0, with their error estimates."""
        found = list(self._underway(self.engine, batch, lambda seconds: _portion(portions, self._share(seconds))))
        parts = [part for part in found if isinstance(part, Part)]
        ended = [part for part in found if isinstance(part, Ended)]
        observed = self._observed([part.fine for part in parts] + [part.check for part in parts], portions)
        runs = (observed[: len(parts)], observed[len(parts) :])
        features = [self._certified(*map(joined, runs))] if parts else []
        order = np.argsort(np.concatenate([part.lanes for part in parts] + [one.lanes for one in ended]))
        whole = {name: x[order] for name, x in joined(features + [one.features for one in ended]).items()}
        if "cycles" in whole:
            whole["sensitive"] = sensitive(self.engine, batch, whole)
        return whole

    def finished(self, index: int, features: Features) -> Features:
        """The features of a chunk's lanes that are stored, with what follows from them."""
        first, end = self.lanes(index)
        return self._stored(features) | (self._beyond(first, end, features) if self._beyond is not None else {})

    def at(self, accuracy: Accuracy, index: int = 0) -> Features:
        """Features of a chunk's lanes at an `accuracy` of the caller's, by name (lanes,), all stepped to their end,
        without the check run."""
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
        """Whether lanes are looked at for having settled: not where pulses drive, or the last returns are stored.

        Nor on an accelerator, where a step of a few lanes costs as much as one of many.
        """
        run, scene = self.sweep.run, self.sweep.system
        return run.end_early and not run.keep_returns and scene.autonomous and not self.engine.accelerated

    def _share(self, settling: float, observing: float = 0.0) -> float:
        """Part of a lane's work, the check run's included, that such times [s] of it take."""
        run = self.sweep.run
        return (settling + OBSERVING * observing) / (1.5 * (run.settle + OBSERVING * run.observe))

    def _observed(self, batches: list[Batch], portions: Portions) -> list[Features]:
        """The features of lanes that are underway."""
        run, seen = self.sweep.run, looks(self.sweep.run)
        settling = self._share(run.settle - (seen[-1][-1] if seen else 0.0))
        batches = self.engine.settle(batches, report=_portion(portions, settling))
        return self.engine.observe(batches, _portion(portions, self._share(0.0, run.observe)))

    def _certified(self, fine: Features, check: Features) -> Features:
        """The features of lanes that have been observed, with their error estimates, and what labels the check run."""
        run, section, tolerance = self.sweep.run, self.sweep.system.section, self.accuracy.tolerance
        if section is not None:
            fine = fine | {"drift_estimate": drift(fine, section, run.precision, tolerance)}
        least = 4 * float(np.finfo(run.precision).eps) + LEAST * tolerance
        return certified(fine, check, self.stepper.error_share, least)

    def _stored(self, features: Features) -> Features:
        """The features without the returns that are not to be stored."""
        kept = self.sweep.run.keep_returns
        stored = {name: x[:, x.shape[1] - kept :] if x.ndim == 2 else x for name, x in features.items()}
        return {name: x for name, x in stored.items() if x.size and name != INTERVAL}


def certified(fine: Features, check: Features, share: float, least: float) -> Features:
    """The features of lanes with their `error_estimate`, and with what labels the check run."""
    labelling = {f"check_{name}": check[name] for name in LABELLED_BY if name in check}
    return fine | labelling | {"error_estimate": error_estimate(fine, check, share, least)}


def error_estimate(fine: Features, coarse: Features, share: float, least: float) -> Float[np.ndarray, " lanes"]:
    """Estimated relative error of period and impact velocity, the larger; NaN where a lane does not repeat.

    It is that of the values which the lane settles on: a `share` of the difference between the two runs, `least`, for
    where that is small by chance, and how far the lane still is on its way, its `drift_estimate`. A lane whose repeat
    differs between the runs, or whose drift has no bound, has none: infinite.
    """
    if "cycles" not in fine:  # penetration
        return share * _relative(fine["rate_of_penetration"], coarse["rate_of_penetration"]) + least
    names = [name for name in ("period", "impact_velocity") if name in fine]
    with np.errstate(invalid="ignore", divide="ignore"):
        differences = [np.abs(coarse[name] / fine[name] - 1) for name in names]
        error = share * reduce(np.fmax, differences) + least + DRIFT_MARGIN * fine["drift_estimate"]
    periodic = fine["cycles"] > 0
    agree = coarse["cycles"] == fine["cycles"]
    if "impacts" in fine:
        agree &= coarse["impacts"] == fine["impacts"]
    return np.where(periodic, np.where(agree, error, np.inf), np.nan)


def joined(parts: list[Features]) -> Features:
    """The features of all lanes of the parts."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _relative(fine: Float[np.ndarray, " lanes"], coarse: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, " lanes"]:
    """Relative difference, 0 where both are zero and infinite where only one is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(fine == coarse, 0.0, np.abs(coarse / fine - 1))


def _portion(portions: Portions, each: float) -> Report:
    """Adds `each` part of the work of every lane that is reported."""
    return lambda lanes: portions.add(lanes * each)
