"""Run a sweep: in memory, or to a file without ever losing a finished chunk.

A sweep file is read and checked (`maps.read`). Its lanes are computed in chunks (`lanes`) by compiled
programs, which step the scene and measure its motion inside the time loop. `lanes.labelled` turns the resulting
features into labels and a dataset. `io` writes the dataset completely or not at all, and keeps the finished chunks
until then.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from math import ceil
from os import PathLike
from pathlib import Path

import xarray as xr

from vibrojax.io.dataset import COMPRESSED, open_dataset
from vibrojax.io.manifest import check_replaceable
from vibrojax.io.ownership import check_ours
from vibrojax.io.provenance import provenance
from vibrojax.io.targets import InMemory, Target, file_target
from vibrojax.lanes.batch import Features
from vibrojax.lanes.chunks import Chunks
from vibrojax.maps.costs import PACKED, Cost, check_size, lane_bytes, processor_time
from vibrojax.maps.executor import Executor, Store, by_executor, check_executor
from vibrojax.maps.joining import REGION, WallTime, join
from vibrojax.maps.read import read_sweep
from vibrojax.maps.shards import CHUNKS, DamagedShard, Shards, report_damage
from vibrojax.maps.sweep import Sweep
from vibrojax.maps.work import MeasuredCosts, Work, by_cost
from vibrojax.progress import Progress, timed

MEMORY = 450e6
"""Memory [bytes] that a process needs for imported and compiled code."""

HOUR = 3600.0


def run_sweep(
    source: str | PathLike[str] | Mapping[str, object] | Sweep,
    progress: bool = True,
    executor: Executor | None = None,
) -> xr.Dataset:
    """Run a sweep and return its dataset.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "regime-map", or a dict with the structure of such a file.
    - `progress`: whether to report progress on stderr.
    - `executor`: the object that computes the chunks: any `concurrent.futures.Executor` with spawned processes, such as
      `ProcessPoolExecutor(4, mp_context=multiprocessing.get_context("spawn"))`, `dask.distributed`'s
      `client.get_executor()`, or an executor of loky, MPI or submitit. None: this process, on all its cores. The
      results are bitwise equal.

    **Returns:** the dataset, over the grid's dimensions and `start`.

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
    check_size(sweep, estimate(sweep))
    began = time.monotonic()
    work = Work(sweep)
    parts: dict[int, Features] = {}
    with Progress(sweep.lanes, "lanes", progress) as bar:
        _compute(sweep, work, range(work.chunks.count), parts.__setitem__, bar, executor)
    target = InMemory()
    join(sweep, work.chunks, parts.pop, target, lambda _: time.monotonic() - began)
    return target.dataset


def run_to_file(
    sweep: Sweep,
    out: Path,
    resume: bool = True,
    progress: bool = True,
    executor: Executor | None = None,
) -> xr.Dataset:
    """Run a sweep and write its dataset to the file `out`, netCDF or Zarr.

    Finished chunks are kept next to `out` until the dataset is complete. With `resume`, existing chunks are continued;
    otherwise the run starts over and replaces `out`, whatever result of the package it holds. `executor`: see
    `run_sweep`.

    **Returns:** the dataset that was written.

    **Raises:** `InputError` if the existing chunks or the existing dataset belong to another sweep, or if memory or
    disk are too small.
    """
    if resume:
        check_replaceable(out, sweep.identity())
    check_ours(out)
    check_size(sweep, estimate(sweep, to_file=True), out)
    with (
        _computed(sweep, out, resume, progress, executor) as write,
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
    check_size(sweep, estimate(sweep), out)
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
) -> Iterator[Callable[[Target], None]]:
    """Compute the missing chunks next to `out`, and yield a function that writes the dataset to a target.

    The chunks are deleted when the block ends without an error.
    """
    began = time.monotonic()
    work = Work(sweep)
    with _shards(sweep, work.chunks, out) as shards:
        with Progress(sweep.lanes, "lanes", progress) as bar:
            shards.open(resume)
            finished = shards.finished()
            bar.resume(sum(map(work.chunks.width, finished)))
            missing = sorted(set(range(work.chunks.count)) - finished)
            _compute(sweep, work, missing, shards.write, bar, executor)
        # The wall time includes interrupted runs, but not the time between runs.
        yield partial(_write, sweep, work, shards, wall_time=lambda seconds: max(seconds, time.monotonic() - began))
        shards.remove()


def _shards(sweep: Sweep, chunks: Chunks, out: Path) -> Shards:
    manifest = sweep.identity() | provenance() | {"chunk size": chunks.size}
    return Shards(out.with_name(out.name + CHUNKS), manifest)


def _write(sweep: Sweep, work: Work, shards: Shards, target: Target, wall_time: WallTime) -> None:
    """Write the dataset from the finished chunks; recompute a chunk whose file has been damaged."""

    def read(index: int) -> Features:
        try:
            return shards.read(index)
        except DamagedShard as damage:
            report_damage(damage)
            return work.compute(index)

    join(sweep, work.chunks, read, target, wall_time)


def _compute(
    sweep: Sweep, work: Work, indices: Sequence[int], store: Store, bar: Progress, executor: Executor | None
) -> None:
    """Compute the chunks with these indices, and store each one as soon as it is finished."""
    with timed("compile and step"):
        if executor is None:
            for index, features in work.compute_each(indices, bar.add):
                store(index, features)
            return
        check_executor(executor)

        def store_and_report(index: int, features: Features) -> None:
            store(index, features)
            bar.add(work.chunks.width(index))

        by_executor(sweep, executor, by_cost(work.chunks, indices), store_and_report)


def estimate(sweep: Sweep, to_file: bool = False, measured: MeasuredCosts | None = None) -> Cost:
    """Estimate the cost of a sweep before running it; the time is rough (see [vibrojax.maps.costs][]).

    **Arguments:**

    - `to_file`: whether finished chunks are stored on the disk, as in `run_to_file`, or in memory.
    - `measured`: measured costs of some lanes of the sweep, see [vibrojax.maps.work][], for a
      better estimate.
    """
    chunks = Work(sweep).chunks
    in_chunk, in_file = map(float, lane_bytes(sweep))
    packed = PACKED if sweep.lanes > COMPRESSED else 1.0
    processor, cores = processor_time(chunks), len(chunks.engine.workers)
    if measured is not None:
        in_chunk, in_file = measured.chunk_bytes, measured.file_bytes
        processor = processor._replace(compile=measured.compile_s, step=measured.lane_s * sweep.lanes)
    elapsed = processor._replace(step=processor.step / cores)
    before = elapsed.start + elapsed.compile
    # The time loop holds some 500 numbers per lane. The array regions of `join` hold features, variables, and
    # variables being written.
    memory = MEMORY + min(cores, chunks.count) * chunks.size * 8 * 500
    memory += 3 * min(REGION, sweep.lanes) * (in_chunk + in_file) if to_file else sweep.lanes * (in_chunk + in_file)
    return Cost(
        lanes=sweep.lanes,
        chunks=chunks.count,
        memory_bytes=memory,
        disk_bytes=ceil(sweep.lanes * (in_chunk + packed * in_file)),
        file_bytes=ceil(sweep.lanes * packed * in_file),
        hour_workers=ceil(min(chunks.count, processor.step / (HOUR - before))) if before < HOUR else 0,
        time_s=sum(elapsed),
        compile_s=before,
        step_s=elapsed.step,
        processor_s=sum(processor),
    )
