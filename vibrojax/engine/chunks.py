"""Lanes in chunks of one size through the compiled programs; memory is bounded by the chunk."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.devices import workers
from vibrojax.engine.batch import Batch, Engine, Features, Index, Report, unreported
from vibrojax.engine.drift import drift
from vibrojax.engine.settled import settled
from vibrojax.input.definition import Sweep
from vibrojax.label import LABELLED_BY
from vibrojax.measure import recorder_for
from vibrojax.measure.kept_returns import INTERVAL
from vibrojax.progress import Portions
from vibrojax.stepping import Accuracy, Stepper
from vibrojax.timings import timed

CHUNK = 2048
"""Lanes per chunk where the user does not say."""

OBSERVING = 2.0
"""Work of a second under observation, that of a second before being 1."""

LEAST = 0.03
"""Part of the tolerance that the error is taken for at least: where most steps end at events, those of the check run
are all but the same."""

DRIFT_MARGIN = 1.25
"""The drift is that of a linear return map; a tenth off, one in ten."""

LOOKS = (0.25, 0.5, 1.0)
"""Parts of the way to half-way at which lanes that have settled are looked for, and the others sorted by their pace."""

SETTLED = 0.01
"""Part of the accepted error that a lane observed early may still be away from where it settles, where steps have no
tolerance; else it may be as much as that."""

CHECKED = 0.5
"""The check run of a lane that has settled settles anew for this part of the time that it took."""


Beyond = Callable[[int, int, Features], Features]
"""`beyond(first, end, features)`: more features of the lanes from `first` to before `end`, or other ones."""


class Part(NamedTuple):
    """Some lanes of a chunk as far as one run serves both: which, by index, and the batches of either run."""

    lanes: Index
    fine: Batch
    check: Batch


class Chunks:
    """The chunks of a sweep, ready to be computed one by one, by all workers.

    `beyond`: what else is to be found of lanes that have been observed.
    """

    def __init__(self, sweep: Sweep, beyond: Beyond | None = None) -> None:
        self.sweep, self._beyond = sweep, beyond
        self.stepper = sweep.run.stepper
        self.accuracy = sweep.run.accuracy(sweep.system)
        recorder = recorder_for(sweep.system, sweep.run.keep_returns)
        self.engine = Engine(sweep, self.stepper, recorder, workers())
        self.size = sweep.run.chunk or max(CHUNK, self.engine.programs.block)
        self.count = -(-sweep.lanes // self.size)
        self._compiled = False

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
        fine, check = self.both_runs(self.engine.start(first, end, self.accuracy), portions)
        portions.finish()
        return self.finished(index, fine, check)

    def both_runs(self, batch: Batch, portions: Portions) -> tuple[Features, Features]:
        """Features of lanes that stand at t = 0, and those by the check run."""
        parts = list(self._underway(batch, self.stepper.coarser(self.accuracy), portions))
        observed = self._observed([part.fine for part in parts] + [part.check for part in parts], portions)
        order = np.argsort(np.concatenate([part.lanes for part in parts]))
        fine, check = (
            {name: np.concatenate([some[name] for some in run])[order] for name in run[0]}
            for run in (observed[: len(parts)], observed[len(parts) :])
        )
        return fine, check

    def finished(self, index: int, fine: Features, check: Features) -> Features:
        """The features of a chunk's lanes with what follows from them, by both runs."""
        first, end = self.lanes(index)
        certified = self._certified(fine, check)
        return certified | self._beyond(first, end, fine) if self._beyond is not None else certified

    def at(self, accuracy: Accuracy, index: int = 0) -> Features:
        """Features of a chunk's lanes at an `accuracy` of the caller's, by name (lanes,), all stepped to their end,
        without the check run."""
        batches = [self.engine.start(*self.lanes(index), accuracy)]
        for now in self._looks:
            batches = self.engine.settle(batches, now)
        return self._observed(batches, Portions(self.width(index), unreported))[0]

    def compile(self) -> None:
        """Compile the programs, once."""
        if not self._compiled:
            with timed("compile"):
                self.engine.compile(self.accuracy)
            self._compiled = True

    @property
    def _looks(self) -> list[float]:
        """Times [s] at which lanes are looked at; the last is half-way, or when they are observed.

        Half-way half of the work is left.
        """
        run = self.sweep.run
        half = min(run.settle, (run.settle + OBSERVING * run.observe) / 2)
        return [share * half for share in LOOKS] if half > 0 else []

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

    def _underway(self, batch: Batch, coarse: Accuracy, portions: Portions) -> Iterator[Part]:
        """The lanes of a batch as far as one run serves both; those that have settled come first."""
        run, lanes = self.sweep.run, np.arange(len(batch.begin))
        close = self.accuracy.tolerance or SETTLED * run.error
        before = 0.0
        for now in self._looks:
            [batch] = self.engine.settle([batch], now, _portion(portions, self._share(now - before)))
            before = now
            if self.ends_early:
                assert batch.underway is not None
                done, duration = settled(batch.underway.carry, now, run.settle + run.observe, run.observe, close)
                if done.any():
                    fine = batch.of(np.flatnonzero(done)).observed(now, duration[done])
                    check = replace(fine, accuracy=coarse).observed((1 + CHECKED) * now, duration[done])
                    yield Part(lanes[done], fine, check)
                    lanes, batch = lanes[~done], batch.of(np.flatnonzero(~done))
                    if done.all():
                        return
        yield Part(lanes, batch, replace(batch, accuracy=coarse))

    def _observed(self, batches: list[Batch], portions: Portions) -> list[Features]:
        """The features of lanes that are underway."""
        run, looks = self.sweep.run, self._looks
        settling = self._share(run.settle - (looks[-1] if looks else 0.0))
        batches = self.engine.settle(batches, report=_portion(portions, settling))
        return self.engine.observe(batches, _portion(portions, self._share(0.0, run.observe)))

    def _certified(self, fine: Features, check: Features) -> Features:
        """The features with their error estimates, what the check run's labels need, and the returns to be stored."""
        run, section = self.sweep.run, self.sweep.system.section
        if section is not None:
            fine["drift_estimate"] = drift(fine, section, run.precision, self.accuracy.tolerance)
        least = 4 * float(np.finfo(run.precision).eps) + LEAST * self.accuracy.tolerance
        fine["error_estimate"] = error_estimate(fine, check, self.stepper, least)
        stored = {name: x[:, x.shape[1] - run.keep_returns :] if x.ndim == 2 else x for name, x in fine.items()}
        return {
            **{name: x for name, x in stored.items() if x.size and name != INTERVAL},
            **{f"check_{name}": check[name] for name in LABELLED_BY if name in check},
        }


def error_estimate(fine: Features, coarse: Features, stepper: Stepper, least: float) -> Float[np.ndarray, " lanes"]:
    """Estimated relative error of period and impact velocity, the larger; NaN where a lane does not repeat.

    It is that of the values which the lane settles on: the stepper's share of the difference between the two runs,
    `least`, for where that is small by chance, and how far the lane still is on its way, its `drift_estimate`. A lane
    whose repeat differs between the runs, or whose drift has no bound, has none: infinite.
    """
    share = stepper.error_share
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


def _relative(fine: Float[np.ndarray, " lanes"], coarse: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, " lanes"]:
    """Relative difference, 0 where both are zero and infinite where only one is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(fine == coarse, 0.0, np.abs(coarse / fine - 1))


def _portion(portions: Portions, each: float) -> Report:
    """Adds `each` part of the work of every lane that is reported."""
    return lambda lanes: portions.add(lanes * each)
