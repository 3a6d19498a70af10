"""Computation of chunks by an executor: any `concurrent.futures.Executor`, an object with its `submit`, or SLURM."""

import os
import pickle
import shutil
import stat
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from threading import Lock
from typing import Any, Protocol, runtime_checkable

import numpy as np

from vibrojax.compile.xla import usable_cores, with_threads
from vibrojax.errors import InputError, Place, first_line
from vibrojax.lanes.inputs import Features, Report, unreported
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.dataset import stored
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.lane_stages import lane_run
from vibrojax.progress import quiet
from vibrojax.threads import by_drivers, on_leaving

AHEAD = 256
"""Number of chunks submitted at once to an executor with an unknown number of workers."""

QUEUED = 2
"""Number of chunks submitted at once per known worker, so that no worker waits for its next chunk."""

SLURM_LIMIT_MINUTES = 24 * 60
"""Time limit of a job of SLURM [min] if SBATCH_TIMELIMIT is not set; sites have their own limits."""

_COMPILING = Lock()


@runtime_checkable
class Executor(Protocol):
    """An object that computes chunks: an executor of Python, dask, loky or MPI, or of submitit (same `submit`)."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        """Schedule `fn(*args)`; return a future with `done()`, `result()` and `cancel()`."""


def check_executor(executor: object) -> None:
    """Raise `InputError` if the object cannot compute chunks."""
    if not callable(getattr(executor, "submit", None)):
        raise InputError(
            f"executor: {type(executor).__name__} has no submit; give a concurrent.futures.Executor, "
            "like ProcessPoolExecutor(mp_context=multiprocessing.get_context('spawn'))"
        )
    context = getattr(executor, "_mp_context", None)
    if isinstance(executor, ProcessPoolExecutor) and context is not None and context.get_start_method() == "fork":
        raise InputError(
            "executor: its processes are forked, and jax hangs in such; "
            "make it with mp_context=multiprocessing.get_context('spawn')"
        )


def compute(
    sweep: Sweep,
    run: LaneRun,
    indices: Sequence[int],
    report: Report = unreported,
    executor: Executor | None = None,
    compiled: Callable[[], object] = lambda: None,
) -> Iterator[tuple[int, Features]]:
    """Compute chunks, and yield (index, arrays to store) as soon as each is finished, in any order.

    Each of as many threads as there are cores computes a chunk of its own. `report` is called with the number of lanes
    finished since its last call. `executor`: see `run_sweep`; this process computes what the executor fails to deliver.
    `compiled` is called once before lanes are stepped, when all modules that this takes are imported.
    """
    if executor is not None:
        compiled()
        indices = yield from _by_executor(sweep, executor, indices, report)
    if not indices:
        return
    parts = [partial(sweep.inputs, *sweep.chunk(index)) for index in indices]
    cores = len(run.engine.workers)
    at_once = min(cores, len(indices))  # these chunks share the cores
    with quiet():
        run.compile(parts[0]())
        if executor is None:
            compiled()
        for place, result in by_drivers(partial(run.chunk, report=report), parts, cores):
            yield indices[place], stored(result, result.seconds / at_once)


def _by_executor(
    sweep: Sweep, executor: Executor, indices: Sequence[int], report: Report
) -> Generator[tuple[int, Features], None, list[int]]:
    """Compute chunks in the workers of an executor; yield each one as soon as it is finished.

    **Returns:** the chunks that the executor has not delivered: those whose worker raised, and, if it broke down (a
    process of Python's own pool died, or the scheduler is gone), all that remained.

    **Raises:** `InputError` from a worker, or if the executor is unsuitable or the sweep cannot be pickled.
    """
    check_executor(executor)
    try:
        task = pickle.dumps(sweep)
    except Exception as error:  # pickling parts of a user's scene may raise any exception
        raise Place(sweep.file).error(
            f"cannot be sent to other processes ({_named(error)}); "
            "let functions of your own scene or law be defined in a module of their own, not be lambdas"
        ) from None
    count = getattr(executor, "_max_workers", None)
    workers = count if isinstance(count, int) and count > 0 else 0  # 0: the executor does not state their number
    # The workers of these share this machine. The cores of any other worker are not known here, and may be one.
    local_pools = ProcessPoolExecutor, ThreadPoolExecutor
    is_local = isinstance(executor, local_pools) or type(executor).__module__.startswith("loky.")
    threads = max(1, usable_cores() // workers) if workers and is_local else 1
    waiting, failed, running = deque(indices), list[int](), dict[Any, int]()

    def fail(index: int, error: Exception, broken: bool) -> None:
        if isinstance(error, InputError):
            raise error
        if not broken or waiting or not failed:
            what = "the executor broke down" if broken else f"chunk {index} failed with a worker"
            rest = "the rest" if broken else "it"
            print(f"vibrojax: warning: {what} ({_named(error)}); {rest} is computed here", file=sys.stderr)
        failed.extend([index, *waiting] if broken else [index])
        if broken:
            waiting.clear()

    def cancel() -> None:
        for future in list(running):
            with suppress(Exception):
                future.cancel()

    with on_leaving(cancel):
        try:
            while waiting or running:
                while waiting and len(running) < (workers * QUEUED or AHEAD):
                    index = waiting.popleft()
                    try:
                        running[executor.submit(compute_chunk, task, index, threads)] = index
                    except Exception as error:
                        fail(index, error, broken=True)
                if all(isinstance(future, Future) for future in running):
                    wait(running, return_when=FIRST_COMPLETED)
                done = [future for future in running if future.done()]
                if running and not done:  # futures of another library
                    time.sleep(0.2)
                for future in done:
                    index = running.pop(future)
                    try:
                        arrays = future.result()
                    except Exception as error:
                        fail(index, error, isinstance(error, (BrokenExecutor, CancelledError)))
                    else:
                        report(int(np.subtract(*sweep.chunk(index)[::-1])))
                        yield index, arrays
        finally:
            cancel()
    return failed


def compute_chunk(task: bytes, index: int, threads: int | None) -> Features:
    """Compute a chunk in a worker; `task`: the pickled sweep."""
    with with_threads(threads):
        with _COMPILING:
            sweep, run = _compiled(task, threads)
        return next(compute(sweep, run, [index]))[1]


@lru_cache(maxsize=2)
def _compiled(task: bytes, threads: int | None) -> tuple[Sweep, LaneRun]:
    """Return a sweep and its run on this number of `threads`; its programs are compiled once per worker."""
    sweep: Sweep = pickle.loads(task)
    inputs = sweep.inputs(*sweep.chunk(0))
    run = lane_run(inputs, sweep.plan)
    run.compile(inputs)
    return sweep, run


def _named(error: BaseException) -> str:
    name = type(error).__name__
    return f"{name}: {first_line(error)}" if str(error) else name


@contextmanager
def slurm_executor(folder: Path, jobs: int) -> Iterator[Executor]:
    """Yield an executor that runs each call in a job of SLURM, twice as many as `jobs` at a time.

    Further options of SLURM (partition, account, memory, time) are read from the environment variables SBATCH_*.

    `folder`: the folder of the jobs, which all machines can access; it is removed at the end unless a job has failed.

    **Raises:** `InputError` if no job can be submitted, or if other users can write to the folder.
    """
    place = "--workers slurm"
    try:
        import submitit
    except ImportError:
        raise InputError(f'{place}: submitit is not installed; pip install "vibrojax[slurm]"') from None
    missing = [program for program in ("sbatch", "srun") if shutil.which(program) is None]
    if missing:
        raise InputError(f"{place}: there is no {' and no '.join(missing)} here; run it where SLURM takes jobs")
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    shared = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if status.st_uid != os.geteuid() or shared or not stat.S_ISDIR(status.st_mode):  # files there are unpickled
        raise InputError(f"{folder}: others can write to it, and could run code in the jobs; remove it")
    executor: Any = submitit.AutoExecutor(folder=folder, cluster="slurm")
    executor.update_parameters(name="vibrojax", timeout_min=SLURM_LIMIT_MINUTES, cpus_per_task=1)
    executor._max_workers = jobs  # `_by_executor` reads the number of workers
    yield executor
    shutil.rmtree(folder, ignore_errors=True)
