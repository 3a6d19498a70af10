"""Lanes in chunks of one size through one compiled program; memory is bounded by the chunk."""

from collections.abc import Callable

import jax
import numpy as np

from vibrojax.devices import precision, workers
from vibrojax.label import LABELLED_BY
from vibrojax.measure import recorder_for
from vibrojax.stepping import Located, Smoothed
from vibrojax.sweep._accuracy import Accuracy, accuracy_for
from vibrojax.sweep._parallel import in_parallel
from vibrojax.sweep._program import BLOCK, BLOCK_ON_ACCELERATOR, run_lanes
from vibrojax.sweep._sweep import Sweep

CHUNK = 1024
"""Lanes per chunk where the user does not say."""

MOST_STEPS = 2e6
"""Steps after which a lane is given up, beyond those that its longest step asks for."""

COARSER = {"located": 100.0, "smoothed": 2.0}
"""The check run's tolerance or width is this many times coarser."""

SHARES = {"located": 0.028, "smoothed": 3.5}
"""Part of the two runs' difference that the finer one's error is taken for.

Located: order 8/7 in the tolerance would leave 100^(-8/7) = 0.005 of it; smoothed: order 3/4 in the width, 1.5. Both
are large enough for 95 % of periodic lanes to be within.
"""


class Chunks:
    """The chunks of a sweep, ready to be computed one by one, by all workers."""

    def __init__(self, sweep: Sweep):
        self.sweep = sweep
        self.size = sweep.run.chunk or CHUNK
        self.count = -(-sweep.lanes // self.size)
        self.dtype = np.dtype(sweep.run.precision)
        self.method = Located() if sweep.run.method == "located" else Smoothed()
        self.accuracy = accuracy_for(sweep.run)
        self.most_steps = MOST_STEPS
        self.workers = workers()
        self.block = BLOCK if self.workers[0].platform == "cpu" else BLOCK_ON_ACCELERATOR
        self._recorder = recorder_for(sweep.machine, sweep.run.keep_returns)
        self._compiled = False

    def lanes(self, index: int) -> tuple[int, int]:
        """First lane of a chunk, and the one after its last."""
        return index * self.size, min((index + 1) * self.size, self.sweep.lanes)

    def width(self, index: int) -> int:
        """Number of lanes of a chunk."""
        first, last = self.lanes(index)
        return last - first

    def compute(self, index: int, told: Callable[[int], None] = lambda lanes: None) -> dict:
        """Features of a chunk's lanes, by name: (lanes,), or (lanes, rows) for returns that are kept.

        `told` is called with the number of lanes that have just been finished.
        """
        coarse = self.accuracy.coarser(COARSER[self.sweep.run.method])
        first, last = self.lanes(index)
        blocks = [(at, min(at + self.block, last)) for at in range(first, last, self.block)]
        items = [(*block, accuracy) for block in blocks for accuracy in (self.accuracy, coarse)]
        self.compile()
        found: list[dict] = [{} for _ in items]
        for item, features in in_parallel(self._run, items, self.workers):
            found[item] = features
            if found[item ^ 1]:  # the block's other run
                told(items[item][1] - items[item][0])
        fine = {name: np.concatenate([part[name] for part in found[::2]]) for name in found[0]}
        check = {name: np.concatenate([part[name] for part in found[1::2]]) for name in found[0]}
        fine["error_estimate"] = error_estimate(fine, check, self.sweep.run.method, self._least_error)
        return fine | {f"check_{name}": check[name] for name in LABELLED_BY if name in check}

    def compile(self) -> None:
        """Compile the program, once, and not by every thread."""
        if not self._compiled:
            for worker in dict.fromkeys(self.workers):
                self._run(worker, (0, 0, self.accuracy))
            self._compiled = True

    def at(self, accuracy: Accuracy, index: int = 0) -> dict:
        """Features of a chunk's lanes at an `accuracy` of the caller's, by name (lanes,), without the check run."""
        first, last = self.lanes(index)
        items = [(at, min(at + self.block, last), accuracy) for at in range(first, last, self.block)]
        found = dict(in_parallel(self._run, items, self.workers))
        return {name: np.concatenate([found[item][name] for item in range(len(items))]) for name in found[0]}

    @property
    def _least_error(self) -> float:
        return 4 * float(np.finfo(self.dtype).eps) + 0.03 * self.accuracy.tolerance

    def _run(self, worker, item: tuple[int, int, Accuracy]) -> dict:
        """Features of the lanes from `first` to before `last`, by name."""
        first, last, accuracy = item
        run = self.sweep.run
        values, start = self.sweep.lane_values(first, max(last, first + 1))
        asked = 2 * (run.settle + run.observe) / accuracy.step
        settings = {"settle": run.settle, "observe": run.observe, "most_steps": self.most_steps + asked}
        settings |= accuracy.settings()
        with precision(run.precision), jax.default_device(worker):
            found = run_lanes(
                self.sweep.machine,
                self.method,
                self._recorder,
                self.sweep.starts,
                {name: self._filled(x.astype(self.dtype)) for name, x in values.items()},
                self._filled(start.astype(np.int32)),
                np.int32(last - first),
                {name: np.asarray(value, self.dtype) for name, value in settings.items()},
            )
            return {name: np.moveaxis(np.asarray(x), -1, 0)[: last - first] for name, x in found.items()}

    def _filled(self, x: np.ndarray) -> np.ndarray:
        """Values (lanes,) with copies of the last one up to a whole block."""
        return np.pad(x, (0, self.block - len(x)), mode="edge")


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
    device, count = chunks.workers[0], len(chunks.workers)
    return f"{count} cpu cores" if device.platform == "cpu" else f"{count} {device.device_kind}"
