"""Lanes in chunks of one size through one compiled program; memory is bounded by the chunk."""

import time

import jax
import numpy as np

from vibrojax.devices import precision, use_cores
from vibrojax.measure import recorder_for
from vibrojax.stepping import Located, Smoothed
from vibrojax.sweep._accuracy import Accuracy, accuracy_for
from vibrojax.sweep._program import lanes_per_round, mesh, place, run_chunk
from vibrojax.sweep._sweep import Sweep

CHUNK = 1024
"""Lanes per chunk where the user does not say."""

MOST_STEPS = 2e6
"""Steps after which a lane is given up."""

# The check run's tolerance or width is this many times coarser; the share of the difference that is the finer run's
# error follows from the order of the method in it.
COARSER = {"located": 100.0, "smoothed": 2.0}


class Chunks:
    """The chunks of a sweep, ready to be computed one by one, on all devices."""

    def __init__(self, sweep: Sweep):
        use_cores()
        self.sweep = sweep
        self.mesh = mesh()
        least = lanes_per_round(self.mesh.size)
        wanted = min(sweep.run.chunk or CHUNK, sweep.lanes)
        self.size = -(-wanted // least) * least
        self.count = -(-sweep.lanes // self.size)
        self.dtype = np.dtype(sweep.run.precision)
        self.method = Located() if sweep.run.method == "located" else Smoothed()
        self.accuracy = accuracy_for(sweep.run)
        self._recorder = recorder_for(sweep.machine, sweep.run.keep_returns)
        self._starts = sweep.starts

    def lanes(self, index: int) -> tuple[int, int]:
        """First lane of a chunk, and the one after its last."""
        return index * self.size, min((index + 1) * self.size, self.sweep.lanes)

    def width(self, index: int) -> int:
        """Number of lanes of a chunk, without those that only fill it up."""
        first, last = self.lanes(index)
        return last - first

    def compute(self, index: int) -> dict:
        """Features of a chunk's lanes, by name: (lanes,), or (lanes, rows) for returns that are kept."""
        first, last = self.lanes(index)
        values, start = self.sweep.lane_values(first, last)
        fill = self.size - (last - first)
        p = {name: np.pad(x, (0, fill), mode="edge") for name, x in values.items()}
        start = np.pad(start.astype(np.int32), (0, fill), mode="edge")
        real = np.arange(self.size) < last - first
        with precision(self.sweep.run.precision):
            placed = place(self.mesh, (p, start, real), self.dtype)
            fine = self._run(placed, self.accuracy)
            coarse = self._run(placed, self.accuracy.coarser(COARSER[self.sweep.run.method]))
        fine["error_estimate"] = error_estimate(fine, coarse, self.sweep.run.method, self.dtype)
        return {name: np.moveaxis(x, -1, 0)[: last - first] for name, x in fine.items()}

    def _run(self, placed, accuracy: Accuracy) -> dict:
        run = self.sweep.run
        settings = {
            "settle": run.settle,
            "observe": run.observe,
            "most_steps": MOST_STEPS,
        } | accuracy.settings()
        settings = {name: np.asarray(value, self.dtype) for name, value in settings.items()}
        out = run_chunk(self.sweep.machine, self.method, self._recorder, self._starts, self.mesh, *placed, settings)
        return {name: np.asarray(x) for name, x in _waited(out).items()}


def _waited(features: dict) -> dict:
    """The features once they are computed; an interrupt is heard while they are not."""
    while not all(x.is_ready() for x in features.values()):
        time.sleep(0.01)
    return features


def error_estimate(fine: dict, coarse: dict, method: str, dtype) -> np.ndarray:
    """Estimated relative error of period and impact velocity, the larger; NaN where a lane does not repeat.

    The coarser run's error is `factor` times the finer one's where the error follows the tolerance, so most of their
    difference is the coarser one's. A quarter decade is kept in hand. A lane whose repeat differs between the two has
    no bound: infinite.
    """
    share = {"located": 0.08, "smoothed": 1.0}[method]
    if "cycles" not in fine:  # penetration
        return share * _relative(fine["rate_of_penetration"], coarse["rate_of_penetration"]) + 4 * np.finfo(dtype).eps
    names = [name for name in ("period", "impact_velocity") if name in fine]
    errors = [np.abs(coarse[name] / fine[name] - 1) for name in names]
    with np.errstate(invalid="ignore"):
        error = share * np.fmax.reduce(errors) + 4 * np.finfo(dtype).eps
    periodic = fine["cycles"] > 0
    agree = (coarse["cycles"] == fine["cycles"]) & (coarse.get("impacts", 0) == fine.get("impacts", 0))
    return np.where(periodic, np.where(agree, error, np.inf), np.nan)


def _relative(fine, coarse):
    """Relative difference, 0 where both are zero and infinite where only one is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(fine == coarse, 0.0, np.abs(coarse / fine - 1))


def devices_text() -> str:
    """The devices lanes run on, in words."""
    devices = jax.devices()
    return f"{len(devices)} {devices[0].platform}"
