"""Lanes in chunks of one size through the compiled programs; memory is bounded by the chunk."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vibrojax.devices import workers
from vibrojax.label import LABELLED_BY
from vibrojax.measure import recorder_for
from vibrojax.stepping import Located, Smoothed
from vibrojax.sweep._accuracy import Accuracy, accuracy_for
from vibrojax.sweep._passage import Passage, Programs, Told
from vibrojax.sweep._progress import Worked
from vibrojax.sweep._settled import settled
from vibrojax.sweep._sweep import Sweep

CHUNK = 2048
"""Lanes per chunk where the user does not say."""

COARSER = {"located": 10.0, "smoothed": 2.0}
"""The check run's tolerance or width is this many times coarser."""

SHARES = {"located": 0.4, "smoothed": 3.5}
"""Part of the two runs' difference that the finer one's error is taken for.

Located: order 10/9 in the tolerance would leave 10^(-10/9) = 0.08 of it; smoothed: order 3/4 in the width, 1.5. Both
are large enough for 95 % of periodic lanes to be within.
"""

OBSERVING = 2.0
"""Work of a second under observation, that of a second before being 1."""

LOOKS = (0.25, 0.5, 1.0)
"""Parts of the way to half-way at which lanes that have settled are found, and the others are sorted by their pace."""

SETTLED = 0.01
"""Part of the accepted error that a lane observed early may still be away from where it settles, where steps have no
tolerance; else it may be as much as that."""

CHECKED = 0.5
"""The check run of a lane that has settled settles anew for this part of the time that it took."""


class Part(NamedTuple):
    """Some lanes of a chunk as far as one run serves both.

    - `lanes`: which, by index (lanes,).
    - `fine`, `check`: them, for either run.
    - `away`: their relative distance from where they settle, of those that end early (lanes,).
    """

    lanes: np.ndarray
    fine: Passage
    check: Passage
    away: np.ndarray


class Chunks:
    """The chunks of a sweep, ready to be computed one by one, by all workers."""

    def __init__(self, sweep: Sweep):
        self.sweep = sweep
        self.method = Located() if sweep.run.method == "located" else Smoothed()
        self.accuracy = accuracy_for(sweep.run, sweep.machine)
        recorder = recorder_for(sweep.machine, sweep.run.keep_returns)
        self.programs = Programs(sweep, self.method, recorder, workers())
        self.size = sweep.run.chunk or max(CHUNK, self.programs.block)
        self.count = -(-sweep.lanes // self.size)
        self._compiled = False

    def lanes(self, index: int) -> tuple[int, int]:
        """First lane of a chunk, and the one after its last."""
        return index * self.size, min((index + 1) * self.size, self.sweep.lanes)

    def width(self, index: int) -> int:
        """Number of lanes of a chunk."""
        first, last = self.lanes(index)
        return last - first

    def compute(self, index: int, told: Told = lambda lanes: None) -> dict:
        """Features of a chunk's lanes, by name: (lanes,), or (lanes, rows) for returns that are kept.

        `told` is called with the number of lanes that are done as work goes on.
        """
        coarse = self.accuracy.coarser(COARSER[self.sweep.run.method])
        first, last = self.lanes(index)
        worked = Worked(last - first, told)
        self.compile()
        parts = list(self._on_their_way(first, last, coarse, worked))
        found = self._observed([one.fine for one in parts] + [one.check for one in parts], worked)
        worked.finish()
        order = np.argsort(np.concatenate([one.lanes for one in parts]))
        fine, check = (
            {name: np.concatenate([some[name] for some in run])[order] for name in run[0]}
            for run in (found[: len(parts)], found[len(parts) :])
        )
        away = np.concatenate([one.away for one in parts])[order]
        least = 4 * float(np.finfo(self.sweep.run.precision).eps) + 0.01 * self.accuracy.tolerance
        fine["error_estimate"] = error_estimate(fine, check, self.sweep.run.method, least + away)
        return fine | {f"check_{name}": check[name] for name in LABELLED_BY if name in check}

    def at(self, accuracy: Accuracy, index: int = 0) -> dict:
        """Features of a chunk's lanes at an `accuracy` of the caller's, by name (lanes,), all stepped to their end,
        without the check run."""
        passages = [self.programs.start(*self.lanes(index), accuracy)]
        for now in self._looks:
            passages = self.programs.settle(passages, now)
        return self._observed(passages, Worked(self.width(index), lambda lanes: None))[0]

    def compile(self) -> None:
        """Compile the programs, once."""
        if not self._compiled:
            self.programs.compile(self.accuracy)
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
    def _ends_early(self) -> bool:
        """Whether lanes are looked at for having settled: not where pulses drive, or the last returns are kept.

        Nor on an accelerator, where a step of a few lanes costs as much as one of many.
        """
        run, scene = self.sweep.run, self.sweep.machine
        return run.end_early and not run.keep_returns and scene.autonomous and not self.programs.accelerated

    def _share(self, settling: float, observing: float = 0.0) -> float:
        """Part of a lane's work, the check run's included, that such times [s] of it take."""
        run = self.sweep.run
        return (settling + OBSERVING * observing) / (1.5 * (run.settle + OBSERVING * run.observe))

    def _on_their_way(self, first: int, last: int, coarse: Accuracy, worked: Worked) -> Iterator[Part]:
        """The lanes from `first` to before `last` as far as one run serves both; those that have settled come first."""
        run, lanes = self.sweep.run, np.arange(last - first)
        passage = self.programs.start(first, last, self.accuracy)
        close = self.accuracy.tolerance or SETTLED * run.error
        before = 0.0
        for now in self._looks:
            share = self._share(now - before)
            [passage] = self.programs.settle([passage], now, lambda lanes, each=share: worked.add(lanes * each))
            before = now
            if self._ends_early:
                done, lasts, away = settled(passage.moving[1], now, run.settle + run.observe, run.observe, close)
                if done.any():
                    fine = passage.of(np.flatnonzero(done)).observed(now, lasts[done])
                    check = replace(fine, accuracy=coarse).observed((1 + CHECKED) * now, lasts[done])
                    yield Part(lanes[done], fine, check, away[done])
                    lanes, passage = lanes[~done], passage.of(np.flatnonzero(~done))
                    if done.all():
                        return
        yield Part(lanes, passage, replace(passage, accuracy=coarse), np.zeros(len(lanes)))

    def _observed(self, passages: list[Passage], worked: Worked) -> list[dict]:
        """The features of lanes that are on their way."""
        run, looks = self.sweep.run, self._looks
        settling = self._share(run.settle - (looks[-1] if looks else 0.0))
        observing = self._share(0.0, run.observe)
        passages = self.programs.settle(passages, told=lambda lanes: worked.add(lanes * settling))
        return self.programs.observe(passages, lambda lanes: worked.add(lanes * observing))


def error_estimate(fine: dict, coarse: dict, method: str, least: float) -> np.ndarray:
    """Estimated relative error of period and impact velocity, the larger; NaN where a lane does not repeat.

    A share of the difference between the two runs, see `SHARES`, and `least`, for where that is small by chance. A lane
    whose repeat differs between them has no bound: infinite.
    """
    share = SHARES[method]
    if "cycles" not in fine:  # penetration
        return share * _relative(fine["rate_of_penetration"], coarse["rate_of_penetration"]) + least
    names = [name for name in ("period", "impact_velocity") if name in fine]
    errors = [np.abs(coarse[name] / fine[name] - 1) for name in names]
    with np.errstate(invalid="ignore"):
        error = share * np.fmax.reduce(errors) + least
    periodic = fine["cycles"] > 0
    agree = (coarse["cycles"] == fine["cycles"]) & (coarse.get("impacts", 0) == fine.get("impacts", 0))
    return np.where(periodic, np.where(agree, error, np.inf), np.nan)


def _relative(fine, coarse):
    """Relative difference, 0 where both are zero and infinite where only one is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(fine == coarse, 0.0, np.abs(coarse / fine - 1))


def devices_text(chunks: Chunks) -> str:
    """What lanes run on, in words."""
    device, count = chunks.programs.workers[0], len(chunks.programs.workers)
    return f"{count} cpu cores" if device.platform == "cpu" else f"{count} {device.device_kind}"
