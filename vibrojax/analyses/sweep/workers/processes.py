"""Workers on this machine: spawned processes that share the chunks of a sweep, and end with their parent process."""

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from vibrojax.analyses.sweep.workers.executor import pickled
from vibrojax.analyses.sweep.workers.member import Finished, Job, WorkersDied
from vibrojax.analyses.sweep.workers.shutdown import on_leaving
from vibrojax.analyses.sweep.workers.spawned import work
from vibrojax.compile.xla import usable_cores
from vibrojax.errors import InputError
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

    **Raises:** `InputError` if the sweep cannot be pickled or a chunk raises it; `WorkersDied` if workers keep dying.
    """
    failed: set[int] = set()
    workers = _Workers(sweep, shards, order, count)
    began, deaths = time.monotonic(), 0
    busy: defaultdict[int, float] = defaultdict(float)
    last: dict[int, float] = {}
    with on_leaving(workers.end):
        try:
            for _ in range(min(count, len(order))):
                workers.start()
            missing = set(order)
            # Do not wait until the workers have exited: an interpreter takes some time to shut down.
            while workers.running and missing:
                for process, kind, content, seconds in workers.receive():
                    if kind == "finished":
                        deaths = 0
                        missing.discard(content)
                        busy[process] += seconds
                        last[process] = time.monotonic()
                        finished(content, seconds)
                    elif kind == "failed":
                        failed.add(content)
                        missing.discard(content)
                    elif kind == "input":
                        raise InputError(content)
                    else:
                        deaths += 1
                        if deaths > DEATHS + count:
                            raise WorkersDied(
                                f"workers die before they finish a chunk (the last one with status {content}: "
                                "is there too little memory for this number?)"
                            )
                        workers.start()
        finally:
            workers.end()
    ended = time.monotonic()
    times = [f"{busy[process]:.1f} s, idle at the end for {ended - last[process]:.1f} s" for process in last]
    LOG.info("workers: %d in %.1f s; busy for %s", len(last), ended - began, "; for ".join(times))
    return sorted(failed)


class _Workers:
    """The `running` workers, each with the connection through which it sends messages."""

    def __init__(self, sweep: Sweep, shards: Shards, order: Sequence[int], count: int) -> None:
        self.running: list[tuple[SpawnProcess, Connection]] = []
        self._claims, self._threads = shards.claims, max(1, usable_cores() // count)
        self._job = pickle.dumps(
            Job(pickled(sweep), str(shards.folder), shards.manifest.values, list(order), self._threads)
        )
        self._starting, self._ended = threading.Lock(), False

    def start(self) -> None:
        """Start one more worker."""
        with self._starting, _limited_threads(self._threads), _without_interrupts():
            if self._ended:
                return
            ours, theirs = _SPAWN.Pipe(duplex=False)
            worker = _SPAWN.Process(target=work, args=(self._job, theirs), daemon=True)
            worker.start()
            theirs.close()
            self.running.append((worker, ours))

    def receive(self) -> Iterator[tuple[int, str, Any, float]]:
        """Wait for messages, and yield each as (process, kind, content, seconds).

        The kinds are "finished" and "failed" (content: the chunk's index), "input" (content: an error message), and
        "died" (content: the exit status). A worker that ends normally yields nothing.
        """
        ready = wait([connection for _, connection in self.running])
        for worker, connection in list(self.running):
            if connection not in ready:
                continue
            try:
                yield worker.pid or 0, *connection.recv()
            except (EOFError, OSError, pickle.UnpicklingError):  # the worker has ended, perhaps while sending
                self.running.remove((worker, connection))
                self._join(worker, connection)
                if worker.exitcode:
                    yield worker.pid or 0, "died", worker.exitcode, 0.0

    def end(self) -> None:
        """Kill all workers; their unfinished chunks are lost, finished chunks are kept."""
        # A worker that is just being started would print an error if its parent ended without sending its start-up
        # data.
        acquired = self._starting.acquire(timeout=_START_PATIENCE)
        self._ended = True
        for worker, connection in self.running:
            worker.kill()
            self._join(worker, connection)
        self.running.clear()
        if acquired:
            self._starting.release()

    def _join(self, worker: SpawnProcess, connection: Connection) -> None:
        worker.join()
        connection.close()
        with suppress(OSError):
            self._claims.release_of(worker.pid or 0)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block Ctrl-C in processes started within this context.

    A terminal sends Ctrl-C to all processes, but these processes end with this process.
    """
    resource_tracker.ensure_running()  # if the first worker started the tracker, the tracker would unblock interrupts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _limited_threads(threads: int) -> Iterator[None]:
    """Limit the linear algebra libraries, too, to `threads` threads in processes started within this context."""
    unset = [name for name in _THREAD_VARIABLES if name not in os.environ]
    os.environ |= dict.fromkeys(unset, str(threads))
    try:
        yield
    finally:
        for name in unset:
            os.environ.pop(name, None)
