"""Run a sweep: in memory, or to a file without ever losing a finished chunk.

A sweep file is read and checked (`maps.read`). Its lanes are computed and labelled in chunks (`lanes.run`) by compiled
programs, which step the scene and measure its motion inside the time loop. `maps.dataset` makes a dataset of the
chunks. `io` writes the dataset completely or not at all, and `maps.store` keeps the finished chunks until then.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

import xarray as xr

from vibrojax.io.dataset import open_dataset
from vibrojax.io.files import provenance
from vibrojax.io.identity import check_ours, check_replaceable
from vibrojax.io.writers import InMemory, Target, file_target
from vibrojax.lanes.inputs import Features
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.cost import check_size
from vibrojax.maps.dataset import join
from vibrojax.maps.executor import Executor, compute
from vibrojax.maps.read import read_sweep
from vibrojax.maps.store import CHUNKS, open_store
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.lane_stages import lane_run
from vibrojax.progress import Progress, timed


def run_sweep(
    source: str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True, executor: Executor | None = None
) -> xr.Dataset:
    """Run a sweep and return its dataset.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "regime-map", or a dict with the structure of such a file.
    - `executor`: the object that computes the chunks of the sweep: any `concurrent.futures.Executor` with spawned
      processes, such as `ProcessPoolExecutor(4, mp_context=multiprocessing.get_context("spawn"))`, `dask.distributed`'s
      `client.get_executor()`, or an executor of loky, MPI or submitit. By default, the calling process computes the
      sweep on all cores. The results of all executors are bitwise equal.

    **Returns:** the dataset of the sweep; its dimensions are the axes of the grid and `start`.

    **Raises:** `InputError`, before any computation, if the sweep is invalid or needs more memory than is available.

    **Example:**

    >>> axes = {"gamma": [0.6, 0.75], "delta": [-0.005, 0.005]}
    >>> ds = vj.run_sweep({"scene": "vibro-impact", "parameters": {"beta": 0.4}, "grid": axes}, progress=False)
    >>> dict(ds.sizes)
    {'gamma': 2, 'delta': 2, 'start': 2}
    >>> ds.impact_velocity.sel(gamma=0.75, delta=0.005).round(2).to_pandas().to_dict()  # m/s: two motions at one point
    {'drive': 0.21, 'stuck': 2.24}
    """
    sweep = source if isinstance(source, Sweep) else read_sweep(source)
    check_size(sweep)
    began = time.monotonic()
    run = lane_run(sweep.inputs(0, 1), sweep.plan)
    with Progress(sweep.lanes, "lanes", progress) as bar:
        with timed("compile and step"):
            chunks = dict(compute(sweep, run, range(sweep.chunks), bar.add, executor))
        return joined(sweep, run, chunks, began)


def joined(sweep: Sweep, run: LaneRun, chunks: dict[int, Features], began: float) -> xr.Dataset:
    """Return the dataset of a sweep from its chunks by index, which are removed; `began` [s]: monotonic time."""
    target = InMemory()
    join(sweep, run, chunks.pop, target, began)
    return target.dataset


def run_to_file(
    sweep: Sweep,
    out: Path,
    resume: bool = True,
    progress: bool = True,
    executor: Executor | None = None,
    meanwhile: Callable[[], object] = lambda: None,
) -> xr.Dataset:
    """Run a sweep and write its dataset to the file `out`, netCDF or Zarr.

    Finished chunks are kept next to `out` until the dataset is complete. With `resume`, existing chunks are continued;
    otherwise the run starts over and replaces `out`, whatever result of the package it holds. `executor`: see
    `run_sweep`. `meanwhile` is called in a thread of its own while lanes are stepped.

    **Returns:** the dataset that was written.

    **Raises:** `InputError` if the existing chunks or the existing dataset belong to another sweep, or if memory or
    disk are too small.
    """
    if resume:
        check_replaceable(out, sweep.identity())
    check_ours(out)
    check_size(sweep, out, to_file=True)
    with (
        _computed(sweep, out, resume, progress, executor, meanwhile) as write,
        timed("write"),
        file_target(out) as target,
    ):
        write(target)
    return open_dataset(out)


@contextmanager
def lanes_beside(sweep: Sweep, out: Path, resume: bool = True, progress: bool = True) -> Iterator[xr.Dataset]:
    """Run a sweep for a `with` block that creates the file `out` from the sweep's dataset, which is in memory.

    The finished chunks are stored on disk next to `out`. They are deleted when the block ends without an error.
    `resume`: whether to continue with existing chunks; otherwise start over.

    **Raises:** `InputError` if the existing chunks belong to another sweep, or if memory or disk are too small.
    """
    check_size(sweep, out)
    target = InMemory()
    with _computed(sweep, out, resume, progress) as write:
        write(target)
        yield target.dataset


@contextmanager
def _computed(
    sweep: Sweep,
    out: Path,
    resume: bool,
    progress: bool,
    executor: Executor | None = None,
    meanwhile: Callable[[], object] = lambda: None,
) -> Iterator[Callable[[Target], None]]:
    """Compute the missing chunks next to `out`, and yield a function that writes the dataset to a target.

    The chunks are deleted when the block ends without an error.
    """
    began = time.monotonic()
    run = lane_run(sweep.inputs(0, 1), sweep.plan)
    aside = threading.Thread(target=meanwhile, daemon=True)
    manifest = sweep.identity() | provenance() | {"chunk size": sweep.plan.chunk}
    with open_store(out.with_name(out.name + CHUNKS), manifest, resume) as store:
        with Progress(sweep.lanes, "lanes", progress) as bar:
            finished = store.finished()
            bar.resume(sum(end - first for first, end in map(sweep.chunk, finished)))
            missing = sorted(set(range(sweep.chunks)) - finished)
            with timed("compile and step"):
                for index, arrays in compute(sweep, run, missing, bar.add, executor, aside.start):
                    store.write(index, arrays)

        def read(index: int) -> Features:
            arrays = store.read(index)
            return next(compute(sweep, run, [index]))[1] if arrays is None else arrays

        yield lambda target: join(sweep, run, read, target, began)
        store.remove()
