"""Workers on this machine: processes that are spawned, share the chunks of a sweep, and end with the one that began."""

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from vibrojax.analyses.sweep.workers.executor import pickled
from vibrojax.analyses.sweep.workers.member import Finished
from vibrojax.analyses.sweep.workers.shutdown import on_leaving
from vibrojax.analyses.sweep.workers.spawned import work
from vibrojax.compile.devices import usable_cores
from vibrojax.errors import InputError
from vibrojax.io.shards import Shards
from vibrojax.progress import LOG
from vibrojax.sweep.input.definition import Sweep

DEATHS = 3
"""Workers that may die one after the other, no chunk being finished in between, before it is given up."""

_PATIENCE = 2.0
"""Seconds that the start of a worker may take, where all is to end."""

_ONE_THREAD_EACH = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_SPAWN = multiprocessing.get_context("spawn")


class WorkersDied(OSError):
    """Workers die as soon as they are started."""


def by_processes(sweep: Sweep, shards: Shards, order: Sequence[int], count: int, finished: Finished) -> list[int]:
    """Have the chunks of `order` computed by `count` processes, each with its share of the cores.

    One that dies is replaced, and its chunk taken by another. When this process ends, however it ends, so do they.

    **Returns:** the indices of chunks that raised with a worker.

    **Raises:** `InputError` where the sweep cannot be sent to other processes, or as a chunk does; `WorkersDied` where
    they cannot live.
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
            left = set(order)
            while workers.running and left:  # they are not waited for to end: an interpreter takes its time
                for process, kind, *said in workers.heard():
                    if kind == "finished":
                        deaths = 0
                        left.discard(said[0])
                        busy[process] += said[1]
                        last[process] = time.monotonic()
                        finished(*said)
                    elif kind == "failed":
                        failed.add(said[0])
                        left.discard(said[0])
                    elif kind == "input":
                        raise InputError(said[0])
                    elif kind == "died":
                        deaths += 1
                        if deaths > DEATHS + count:
                            raise WorkersDied(
                                f"workers die before they finish a chunk (the last one with status {said[0]}: "
                                "is there not enough memory for so many?)"
                            )
                        workers.start()
        finally:
            workers.end()
    _tell(began, busy, last)
    return sorted(failed)


def _tell(began: float, busy: Mapping[int, float], last: Mapping[int, float]) -> None:
    """How long each worker computed, and how long it had nothing left to do at the end: to the log."""
    ended = time.monotonic()
    each = [f"{busy[one]:.1f} s, idle at the end for {ended - last[one]:.1f} s" for one in last]
    LOG.info("workers: %d in %.1f s; busy for %s", len(last), ended - began, "; for ".join(each))


class _Workers:
    """The processes that are at work: `running`, each with what it says."""

    def __init__(self, sweep: Sweep, shards: Shards, order: Sequence[int], count: int) -> None:
        self.running: list[tuple[SpawnProcess, Connection]] = []
        self._shards, self._share = shards, max(1, usable_cores() // count)
        self._given = (pickled(sweep), str(shards.folder), dict(shards.manifest), list(order), self._share)
        self._starting, self._over = threading.Lock(), False

    def start(self) -> None:
        """One more."""
        with self._starting, _one_thread_each(self._share), _without_interrupts():
            if self._over:
                return
            ours, theirs = _SPAWN.Pipe(duplex=False)
            worker = _SPAWN.Process(target=work, args=(*self._given, theirs), daemon=True)
            worker.start()
            theirs.close()
            self.running.append((worker, ours))

    def heard(self) -> Iterator[tuple[Any, ...]]:
        """What some of them say now, one of them at least: its process, and ("finished", index, seconds), ("failed",
        index), ("input", text) or ("died", status); nothing where one has come to its end."""
        ready = wait([connection for _, connection in self.running])
        for worker, connection in list(self.running):
            if connection not in ready:
                continue
            try:
                yield worker.pid, *connection.recv()
            except (EOFError, OSError, pickle.UnpicklingError):  # it has ended, perhaps in the middle of a word
                self.running.remove((worker, connection))
                self._gone(worker, connection)
                if worker.exitcode:
                    yield worker.pid, "died", worker.exitcode

    def end(self) -> None:
        """Kill all of them: what they are at is lost, what is finished is not."""
        # One that is being started would complain that nobody tells it what to do.
        in_time = self._starting.acquire(timeout=_PATIENCE)
        self._over = True
        for worker, connection in self.running:
            worker.kill()
            self._gone(worker, connection)
        self.running.clear()
        if in_time:
            self._starting.release()

    def _gone(self, worker: SpawnProcess, connection: Connection) -> None:
        worker.join()
        connection.close()
        with suppress(OSError):
            self._shards.claims.release_of(worker.pid or 0)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """What is started here does not hear Ctrl-C, which a terminal sends to all; it ends with this process."""
    resource_tracker.ensure_running()  # which would let interrupts through again, when a worker first asks for it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _one_thread_each(share: int) -> Iterator[None]:
    """What is started here leaves the other cores to the others, in libraries of linear algebra too."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD_EACH}
    os.environ |= {name: str(share) for name in _ONE_THREAD_EACH if name not in os.environ}
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
