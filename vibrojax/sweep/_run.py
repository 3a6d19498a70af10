"""Run a sweep: to a dataset in memory, or to a file that loses nothing."""

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import ceil
from pathlib import Path

import jax
import numpy as np
import xarray as xr

from vibrojax.store.dataset import write_dataset
from vibrojax.store.provenance import source
from vibrojax.store.shards import DamagedShard, Shards, tell
from vibrojax.store.variables import VARIABLES
from vibrojax.sweep._chunks import Chunks, devices_text
from vibrojax.sweep._dataset import dataset_of
from vibrojax.sweep._progress import Progress
from vibrojax.sweep._read import read_sweep
from vibrojax.sweep._size import check_size
from vibrojax.sweep._sweep import Sweep

SECONDS_PER_STEP = 0.15e-6
STEPS_PER_SECOND = 120.0
"""What a step of a lane takes on one core, and how many there are in a simulated second, located, both runs together:
roughly, for estimates only."""


def run_sweep(source, progress: bool = True) -> xr.Dataset:
    """Run a sweep and return its dataset (contract: dataset).

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "regime-map", or a dict of the same shape.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** the dataset, over the grid's dimensions and `start`.

    **Raises:** `InputError`, before any work, where the sweep is not right or the machine too small for it.
    """
    sweep = source if isinstance(source, Sweep) else read_sweep(source)
    check_size(sweep, estimate(sweep))
    began = time.monotonic()
    chunks = Chunks(sweep)
    told = Progress(sweep.lanes, progress)
    parts = []
    for index in range(chunks.count):
        with _untold():
            parts.append(chunks.compute(index, told.add))
    return _assembled(sweep, chunks, parts, time.monotonic() - began)


def run_to_file(sweep: Sweep, out: Path, resume: bool = True, progress: bool = True) -> xr.Dataset:
    """Run a sweep into the netCDF file `out`; its finished chunks lie beside it until it is whole.

    **Arguments:**

    - `resume`: go on with the chunks that are there, if any; otherwise start over.

    **Returns:** the dataset that was written.

    **Raises:** `InputError` where the chunks that are there are of another sweep, or the machine is too small for it.
    """
    check_size(sweep, estimate(sweep), out)
    began = time.monotonic()
    chunks = Chunks(sweep)
    manifest = sweep.identity() | {"source": source(), "jax": jax.__version__, "chunk size": chunks.size}
    with Shards(out.with_name(out.name + ".chunks"), manifest) as shards:
        shards.open(resume)
        finished = shards.finished()
        told = Progress(sweep.lanes, progress)
        told.resume(sum(chunks.width(index) for index in finished))
        for index in sorted(set(range(chunks.count)) - finished):
            shards.write(index, _timed(chunks, index, told.add))
        parts = [_read_or_compute(shards, chunks, index) for index in range(chunks.count)]
        seconds = [float(part.pop("seconds")) for part in parts]
        # Also what an interrupted run took; what lies between the runs does not count.
        dataset = _assembled(sweep, chunks, parts, max(sum(seconds), time.monotonic() - began))
        write_dataset(dataset, out)
        shards.remove()
    return dataset


def _read_or_compute(shards: Shards, chunks: Chunks, index: int) -> dict:
    """A finished chunk from its file; computed again where that has been damaged meanwhile."""
    try:
        return shards.read(index)
    except DamagedShard as damage:
        tell(damage)
        return _timed(chunks, index)


def _timed(chunks: Chunks, index: int, told: Callable[[int], None] = lambda lanes: None) -> dict:
    """A chunk's features, and the `seconds` that they took."""
    began = time.monotonic()
    with _untold():
        features = chunks.compute(index, told)
    return features | {"seconds": np.array(time.monotonic() - began)}


@contextmanager
def _untold() -> Iterator[None]:
    """Lanes that blow up are flagged: numpy's warnings beside, from any thread, would be a storm."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def estimate(sweep: Sweep) -> dict:
    """What a sweep will take, before any work: lanes, chunks, memory_bytes, disk_bytes, time_s (rough)."""
    chunks = Chunks(sweep)
    per_lane = 8 * (len(VARIABLES) + 6 * sweep.run.keep_returns)
    seconds = sweep.run.settle + sweep.run.observe
    steps = STEPS_PER_SECOND + 1.5 / chunks.accuracy.step  # the check run's steps are twice as long
    return {
        "lanes": sweep.lanes,
        "chunks": chunks.count,
        # A lane in the loop carries some 300 numbers; the results are held once to be labelled and written.
        "memory_bytes": 400e6 + chunks.size * 8 * 300 + 3 * sweep.lanes * per_lane,
        "disk_bytes": ceil(sweep.lanes * per_lane),
        "time_s": 8 + SECONDS_PER_STEP * steps * sweep.lanes * seconds / len(chunks.programs.workers),
    }


def _assembled(sweep: Sweep, chunks: Chunks, parts: list[dict], wall_time: float) -> xr.Dataset:
    features = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    solver = {
        "method": sweep.run.method,
        "order": getattr(chunks.method, "order", 4),
        "precision": sweep.run.precision,
        "devices": devices_text(chunks),
        "steps": int(features["steps"].sum()),
        **chunks.accuracy.described(),
    }
    with _untold():
        return dataset_of(sweep, features, solver, wall_time)
