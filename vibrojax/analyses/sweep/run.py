"""Run a sweep: to a dataset in memory, or to a file that loses nothing.

The road of the data: a sweep file is read and checked (`input`); its lanes go in chunks through compiled programs
(`engine`), which step the scene and measure it in the loop; features become labels and a dataset (`engine.labelled`),
which the store writes whole or not at all, its finished chunks kept meanwhile.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import ceil
from os import PathLike
from pathlib import Path

import xarray as xr

from vibrojax.analyses.sweep.joining import REGION, Read, WallTime, join
from vibrojax.analyses.sweep.workers.executor import Executor, Store, by_executor, check_executor
from vibrojax.analyses.sweep.workers.measured import Measured
from vibrojax.analyses.sweep.workers.member import Finished, compute_shared
from vibrojax.analyses.sweep.workers.order import by_cost
from vibrojax.analyses.sweep.workers.processes import by_processes
from vibrojax.analyses.sweep.workers.slurm import by_slurm
from vibrojax.analyses.sweep.workers.work import Work
from vibrojax.io.dataset import COMPRESSED, open_dataset
from vibrojax.io.finished import check_replaceable
from vibrojax.io.provenance import provenance
from vibrojax.io.shards import DamagedShard, Shards, report_damage
from vibrojax.io.targets import InMemory, file_target
from vibrojax.progress import Progress, timed
from vibrojax.sweep.engine.batch import Features
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.costs import by_the_clock, lane_bytes, packed_share, processor_time
from vibrojax.sweep.engine.resources import Cost, check_size
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.read import read_sweep

MEMORY = 450e6
"""Bytes that a process takes, what it imports and compiles."""

HOUR = 3600.0

DATASET = "dataset"
"""What who writes the dataset of several processes claims."""


def run_sweep(
    source: str | PathLike[str] | Mapping[str, object] | Sweep,
    progress: bool = True,
    executor: Executor | None = None,
) -> xr.Dataset:
    """Run a sweep and return its dataset.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "regime-map", or a dict of the same shape.
    - `progress`: whether to say on stderr how far it is.
    - `executor`: what computes the chunks: any `concurrent.futures.Executor` whose processes are spawned, such as
      `ProcessPoolExecutor(4, mp_context=multiprocessing.get_context("spawn"))`, `dask.distributed`'s
      `client.get_executor()`, loky's, MPI's; or submitit's. None: this process, by all its cores. The bits are equal.

    **Returns:** the dataset, over the grid's dimensions and `start`.

    **Raises:** `InputError`, before any work, where the sweep is not right or the computer too small for it.

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
    with Progress(sweep.lanes, "lanes", progress) as shown:
        _compute(sweep, work, range(work.chunks.count), parts.__setitem__, shown, executor)
    target = InMemory()
    join(sweep, work.chunks, parts.pop, target, lambda _: time.monotonic() - began)
    return target.dataset


def run_to_file(
    sweep: Sweep,
    out: Path,
    resume: bool = True,
    progress: bool = True,
    executor: Executor | None = None,
    processes: int = 0,
    jobs: int = 0,
) -> xr.Dataset:
    """Run a sweep into the file `out`, netCDF or Zarr; its finished chunks lie beside it until it is whole.

    **Arguments:**

    - `resume`: go on with the chunks that are there, if any; otherwise start over, and replace whatever `out` holds.
    - `executor`: what computes the chunks, see `run_sweep`; or so many `processes` that are spawned on this machine,
      or so many `jobs` of SLURM.

    **Returns:** the dataset that was written.

    **Raises:** `InputError` where the chunks that are there, or the dataset, are of another sweep, or the computer is
    too small for it.
    """
    if resume:
        check_replaceable(out, sweep.identity())
    check_size(sweep, estimate(sweep, to_file=True), out)
    began = time.monotonic()
    work = Work(sweep)
    with Progress(sweep.lanes, "lanes", progress) as shown, shards_of(sweep, work.chunks, out) as shards:
        missing = _missing(work, shards, resume, shown)
        if processes and missing:
            missing = _shared(by_processes, sweep, work, shards, missing, shown, processes)
        if jobs and missing:
            missing = _shared(by_slurm, sweep, work, shards, missing, shown, jobs)
        _compute(sweep, work, missing, shards.write, shown, executor)
        # Also what an interrupted run took; what lies between the runs does not count.
        write_joined(sweep, work, shards, out, lambda seconds: max(seconds, time.monotonic() - began))
        shards.remove()
    return open_dataset(out)


@contextmanager
def lanes_beside(sweep: Sweep, out: Path, resume: bool = True, progress: bool = True) -> Iterator[xr.Dataset]:
    """The dataset of a sweep, in memory, for what `out` is going to be made of: its finished chunks lie beside `out`
    until the block has come to its end.

    `resume`: go on with the chunks that are there, if any; otherwise start over.

    **Raises:** `InputError` where the chunks that are there are of another sweep, or the computer is too small for it.
    """
    check_size(sweep, estimate(sweep), out)
    began = time.monotonic()
    work = Work(sweep)
    with shards_of(sweep, work.chunks, out) as shards:
        with Progress(sweep.lanes, "lanes", progress) as shown:
            _compute(sweep, work, _missing(work, shards, resume, shown), shards.write, shown, None)
        target = InMemory()
        join(sweep, work.chunks, _reading(work, shards), target, lambda seconds: max(seconds, time.monotonic() - began))
        yield target.dataset
        shards.remove()


def run_share(sweep: Sweep, out: Path, part: tuple[int, int], progress: bool = True) -> Path | None:
    """Compute the chunks `part[0]`, `part[0] + part[1]`, ... (counted from 1) into the folder beside `out`, which other
    processes share; write `out` where all chunks are there.

    **Returns:** `out` where it is whole, else None.

    **Raises:** `InputError` where the chunks that are there, or the dataset, are of another sweep, or a process has the
    folder for itself.
    """
    began = time.monotonic()
    check_replaceable(out, sweep.identity())
    check_size(sweep, estimate(sweep, to_file=True), out)
    work = Work(sweep)
    number, of = part
    mine = range(number - 1, work.chunks.count, of)
    with shards_of(sweep, work.chunks, out) as shards:
        if out.exists() and not shards.folder.exists():
            return out
        shards.share()
        with Progress(sum(map(work.chunks.width, mine)), "lanes", progress) as shown, timed("compile and step"):
            shown.resume(sum(work.chunks.width(index) for index in mine if shards.has(index)))
            compute_shared(shards, work, mine, report=shown.add)
        if len(shards.there()) < work.chunks.count or not shards.claims.take(DATASET):
            return out if out.exists() and not shards.folder.exists() else None
        write_joined(sweep, work, shards, out, lambda seconds: max(seconds / of, time.monotonic() - began))
        shards.remove()
    return out


def shards_of(sweep: Sweep, chunks: Chunks, out: Path) -> Shards:
    """The finished chunks beside `out`."""
    manifest = sweep.identity() | provenance() | {"chunk size": chunks.size}
    title = sweep.title or f"{sweep.scene}: {sweep.name}"
    about = {"title": title, "lanes": sweep.lanes, "chunks": chunks.count, "size": chunks.size}
    return Shards(out.with_name(out.name + ".chunks"), manifest, about)


def write_joined(sweep: Sweep, work: Work, shards: Shards, out: Path, wall_time: WallTime) -> None:
    """Write the dataset `out` from the finished chunks; one that has been damaged meanwhile is computed again."""
    with timed("write"), file_target(out) as target:
        join(sweep, work.chunks, _reading(work, shards), target, wall_time)


def _missing(work: Work, shards: Shards, resume: bool, shown: Progress) -> list[int]:
    """Take the folder of the chunks; those that are not finished."""
    shards.open(resume)
    finished = shards.finished()
    shown.resume(sum(work.chunks.width(index) for index in finished))
    return sorted(set(range(work.chunks.count)) - finished)


def _reading(work: Work, shards: Shards) -> Read:
    """Reads finished chunks; one that has been damaged meanwhile is computed again."""

    def read(index: int) -> Features:
        try:
            return shards.read(index)
        except DamagedShard as damage:
            report_damage(damage)
            return work.compute(index)

    return read


def _shared(
    by: Callable[[Sweep, Shards, Sequence[int], int, Finished], list[int]],
    sweep: Sweep,
    work: Work,
    shards: Shards,
    missing: Sequence[int],
    shown: Progress,
    count: int,
) -> list[int]:
    """Have chunks computed by so many processes that share the folder; the indices of those that they could not."""
    for index in missing:
        shards.discard(index)

    def finished(index: int, _: float) -> None:
        shown.add(work.chunks.width(index))

    with timed("compile and step"):
        return by(sweep, shards, by_cost(work.chunks, missing), count, finished)


def _compute(
    sweep: Sweep, work: Work, indices: Sequence[int], store: Store, shown: Progress, executor: Executor | None
) -> None:
    """Have the chunks of these indices computed, and stored when they are done."""
    with timed("compile and step"):
        if executor is None:
            for index in indices:
                store(index, work.compute(index, shown.add))
            return
        check_executor(executor)

        def stored(index: int, features: Features) -> None:
            store(index, features)
            shown.add(work.chunks.width(index))

        by_executor(sweep, executor, by_cost(work.chunks, indices), stored)


def estimate(sweep: Sweep, to_file: bool = False, processes: int = 0, measured: Measured | None = None) -> Cost:
    """What a sweep will take, before any work; the time is rough (see [vibrojax.sweep.engine.costs][]).

    **Arguments:**

    - `to_file`: whether its chunks go to the disk, as in `run_to_file`, or stay in memory.
    - `processes`: how many processes on this machine compute it; 0: this one.
    - `measured`: what some of its lanes took, see [vibrojax.analyses.sweep.workers.measured][], which is less rough.
    """
    chunks = Work(sweep).chunks
    in_chunk, in_file = map(float, lane_bytes(sweep))
    packed = packed_share(sweep) if sweep.lanes > COMPRESSED else 1.0
    processor, cores = processor_time(chunks), processes or len(chunks.engine.workers)
    if measured is not None:
        in_chunk, in_file, packed = measured.chunk_bytes, measured.file_bytes, measured.packed
        processor = processor._replace(compile=measured.compile_s, step=measured.lane_s * sweep.lanes)
    passing = by_the_clock(processor, cores)
    before = passing.start + passing.compile
    # A lane in the loop carries some 500 numbers; of a region the features, the variables, and those being written.
    memory = MEMORY * (1 + processes) + max(1, processes) * chunks.size * 8 * 500
    memory += 3 * min(REGION, sweep.lanes) * (in_chunk + in_file) if to_file else sweep.lanes * (in_chunk + in_file)
    return Cost(
        lanes=sweep.lanes,
        chunks=chunks.count,
        memory_bytes=memory,
        disk_bytes=ceil(sweep.lanes * (in_chunk + packed * in_file)),
        file_bytes=ceil(sweep.lanes * packed * in_file),
        hour_workers=ceil(min(chunks.count, processor.step / (HOUR - before))) if before < HOUR else 0,
        time_s=sum(passing),
        compile_s=before,
        step_s=passing.step,
        processor_s=sum(processor),
    )
