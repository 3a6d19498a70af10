"""Processes that share the chunks of a sweep in a folder: spawned on this machine, or jobs of SLURM."""

import multiprocessing
import os
import pickle
import shutil
import signal
import stat
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from vibrojax.analyses.sweep.workers.executor import pickled
from vibrojax.analyses.sweep.workers.lifetime import on_leaving, work_for_parent
from vibrojax.analyses.sweep.workers.work import Finished, Job, WorkersDied
from vibrojax.compile.xla import usable_cores
from vibrojax.errors import InputError, counted
from vibrojax.io.shards import Shards
from vibrojax.progress import LOG
from vibrojax.sweep.input.definition import Sweep

DEATHS = 3
"""The run is aborted after more worker deaths in a row, without a finished chunk in between, than this number plus the
number of workers."""

_START_PATIENCE = 2.0
"""Time [s] that stopping all workers waits for a worker that is just being started."""

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_SPAWN = multiprocessing.get_context("spawn")


def by_processes(sweep: Sweep, shards: Shards, order: Sequence[int], count: int, finished: Finished) -> list[int]:
    """Compute the chunks of `order` with `count` processes, each of which uses an equal part of the cores.

    A worker that dies is replaced, and another worker computes its chunk. All workers end with this process, even if
    this process is killed.

    **Returns:** the indices of the chunks whose computation raised an exception in a worker.

    **Raises:** `InputError` if the sweep cannot be pickled; `WorkersDied` if workers keep dying.
    """
    missing, failed, deaths = set(order), set[int](), 0
    workers = _Workers(sweep, shards, order, count)
    began = time.monotonic()
    busy: defaultdict[int, float] = defaultdict(float)
    last: dict[int, float] = {}
    with on_leaving(workers.end):
        try:
            for _ in range(min(count, len(order))):
                workers.start()
            # Do not wait until the workers have exited: an interpreter takes some time to shut down.
            while workers.running and missing:
                for connection in wait(list(workers.running)):
                    assert isinstance(connection, Connection)
                    process = workers.running[connection].pid or 0
                    try:
                        index, seconds = connection.recv()
                    except (EOFError, OSError, pickle.UnpicklingError):  # it has ended, perhaps while sending
                        status = workers.join(connection)
                        deaths += bool(status)
                        if deaths > DEATHS + count:
                            raise WorkersDied(
                                f"workers die before they finish a chunk (the last one with status {status}: "
                                "is there too little memory for this number?)"
                            ) from None
                        if status:
                            workers.start()
                        continue
                    missing.discard(index)
                    if seconds is None:
                        failed.add(index)
                        continue
                    deaths = 0
                    busy[process] += seconds
                    last[process] = time.monotonic()
                    finished(index, seconds)
        finally:
            workers.end()
    ended = time.monotonic()
    times = [f"{busy[process]:.1f} s, idle at the end for {ended - last[process]:.1f} s" for process in last]
    LOG.info("workers: %d in %.1f s; busy for %s", len(last), ended - began, "; for ".join(times))
    return sorted(failed)


class _Workers:
    """The `running` workers, by the connection through which each sends messages."""

    def __init__(self, sweep: Sweep, shards: Shards, order: Sequence[int], count: int) -> None:
        self.running: dict[Connection, SpawnProcess] = {}
        self._claims, self._threads = shards.claims, max(1, usable_cores() // count)
        job = Job(pickled(sweep), str(shards.folder), shards.manifest, list(order), self._threads)
        self._job = pickle.dumps(job)
        self._starting, self._ended = threading.Lock(), False

    def start(self) -> None:
        with self._starting, _settings_of_workers(self._threads):
            if self._ended:
                return
            ours, theirs = _SPAWN.Pipe(duplex=False)
            worker = _SPAWN.Process(target=work_for_parent, args=(self._job, theirs), daemon=True)
            worker.start()
            theirs.close()
            self.running[ours] = worker

    def join(self, connection: Connection) -> int | None:
        """Wait until a worker has ended, release its claims, and return its exit status."""
        worker = self.running.pop(connection)
        worker.join()
        connection.close()
        with suppress(OSError):
            self._claims.release_of(worker.pid or 0)
        return worker.exitcode

    def end(self) -> None:
        """Kill all workers; their unfinished chunks are lost, finished chunks are kept."""
        # A worker that is just being started would print an error if its parent ended without sending its start-up
        # data.
        acquired = self._starting.acquire(timeout=_START_PATIENCE)
        self._ended = True
        for connection, worker in list(self.running.items()):
            worker.kill()
            self.join(connection)
        if acquired:
            self._starting.release()


@contextmanager
def _settings_of_workers(threads: int) -> Iterator[None]:
    """Block Ctrl-C in processes started within this context, and limit their linear algebra to `threads` threads.

    A terminal sends Ctrl-C to all processes, but these processes end with this process.
    """
    resource_tracker.ensure_running()  # if the first worker started the tracker, the tracker would unblock interrupts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    unset = [name for name in _THREAD_VARIABLES if name not in os.environ]
    os.environ |= dict.fromkeys(unset, str(threads))
    try:
        yield
    finally:
        for name in unset:
            os.environ.pop(name, None)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


LIMIT_MINUTES = 24 * 60
"""Time limit of a job [min] if SBATCH_TIMELIMIT is not set; sites have their own limits."""

CHUNK_POLL_SECONDS = 2.0
"""Interval [s] between two checks for finished chunks."""


def check_slurm(name: str) -> None:
    """Raise `InputError` if no job can be submitted; `name`: the option that requests jobs."""
    try:
        import submitit  # noqa: F401
    except ImportError:
        raise InputError(f'{name}: submitit is not installed; pip install "vibrojax[slurm]"') from None
    missing = [program for program in ("sbatch", "srun") if shutil.which(program) is None]
    if missing:
        raise InputError(
            f"{name}: there is no {' and no '.join(missing)} on this machine; "
            "run it where jobs are handed to SLURM, or give a number of processes"
        )


def by_slurm(
    sweep: Sweep, shards: Shards, order: Sequence[int], count: int, finished: Finished, cluster: str = "slurm"
) -> list[int]:
    """Compute the chunks of `order` with `count` jobs, which write them to a folder that all machines can access.

    Further SLURM options (partition, account, memory, time) are read from the environment variables SBATCH_*. An
    interrupt of this process cancels the jobs; if this process is killed, the jobs continue.

    **Returns:** the indices of the chunks whose computation raised an exception in a job.

    **Raises:** `WorkersDied` if the jobs end before all chunks exist; `InputError` if other users can write to the
    jobs' folder.
    """
    import submitit

    logs = shards.folder.with_suffix(".jobs").absolute()
    _make_private(logs)
    executor = submitit.AutoExecutor(folder=logs, cluster=cluster)
    executor.update_parameters(name="vibrojax", timeout_min=LIMIT_MINUTES, cpus_per_task=1)
    task = Job(pickled(sweep), str(shards.folder.absolute()), shards.manifest, list(order))
    with executor.batch():  # a job records the failure of a chunk, which the caller then computes
        jobs = [executor.submit(task) for _ in range(min(count, len(order)))]

    def cancel() -> None:
        for job in jobs:
            if not job.done():
                job.cancel(check=False)

    unfinished, ended = set(order), False
    with on_leaving(cancel):
        try:
            while unfinished and not ended:
                ended = all(job.done() for job in jobs)  # before the chunks are checked for the last time
                new = unfinished & shards.there()
                for index in sorted(new):
                    finished(index, 0.0)
                unfinished -= new
                if unfinished and not ended:
                    time.sleep(CHUNK_POLL_SECONDS)
        except BaseException:
            cancel()
            raise
    failed = {index for index in unfinished if shards.has_failed(index)}
    if unfinished - failed:
        of = f"of {len(order)} chunks"
        raise WorkersDied(
            f"the jobs ended, and {counted(len(unfinished), f'{of} is', f'{of} are')} not there; what they said: {logs}"
        )
    cancel()
    shutil.rmtree(logs, ignore_errors=True)
    return sorted(failed)


def _make_private(folder: Path) -> None:
    """Create a folder that only this user can write to, since jobs and this process unpickle its files."""
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    shared = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if status.st_uid != os.geteuid() or shared or not stat.S_ISDIR(status.st_mode):
        raise InputError(f"{folder}: others can write to it, and could run code in the jobs; remove it")
